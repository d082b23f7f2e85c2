"""The result: one DataTree in ArviZ's layout, and its flags."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs._version import __version__
from bayes_rs.errors import InputError
from bayes_rs.fits.batch import RecordDraws
from bayes_rs.geometry.forward import sight
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.noise import Noise
from bayes_rs.posteriors.nuisance import UNITS
from bayes_rs.posteriors.sampling.chains import N_WALKER
from bayes_rs.priors.registry import Prior

FLAGS: dict[str, int] = {
    "no_usable_beam": 1,
    "no_wind": 2,
    "beam_left_out": 4,
    "yaw_not_seen": 8,
    "short_chain": 16,
    "ensembles_differ": 32,
    "weights_uneven": 64,
    "contradicts_model": 128,
    "not_stationary": 256,
    "low_wind": 512,
    "likelihood_failed": 1024,
    "excluded": 2048,
}
"""Bits of a record's flag in the result."""

UNFITTED = FLAGS["no_usable_beam"] | FLAGS["no_wind"] | FLAGS["likelihood_failed"] | FLAGS["excluded"]
"""Flags of a record that was not fitted."""

N_PRIOR_DRAW = 10_000
"""Draws of the prior that go with a result, for its outline in figures and for contraction."""
PRIOR_SEED = 0


def flag_words(flag: int) -> str:
    """Return a record's flag in words, joined by semicolons; empty if nothing is wrong.

    Parameters
    ----------
    flag : int
        Bit mask from ``sample_stats/flag`` of a result.

    Returns
    -------
    words : str
        Names of the bits that are set, as in `FLAGS`.

    Examples
    --------
    >>> flag_words(20)
    'beam_left_out;short_chain'
    """
    return ";".join(word for word, bit in FLAGS.items() if int(flag) & bit)


def assemble(
    records: xr.Dataset,
    scan: Scan,
    noise: Noise,
    prior: Prior,
    *,
    fitted: NDArray[np.int64],
    usable: NDArray[np.bool_],
    draws: RecordDraws | None,
    flag: NDArray[np.int64],
    attributes: dict[str, Any],
    yaw_sd: FloatArray | None = None,
) -> xr.DataTree:
    """Put draws, diagnostics and what they came from into one DataTree; records that were not fitted are NaN."""
    n_record = len(usable)
    coords: dict[str, Any] = {"record": np.arange(n_record)}
    if "time" in records.coords:
        coords["time"] = ("record", records["time"].values)
    stress_coords = {**coords, "component": list(STRESSES)}
    beam_coords = {**coords, "beam": scan.beam}

    def spread(values: NDArray[Any], axis: int) -> NDArray[Any]:
        """Put values of fitted records among all records, which become axis `axis`."""
        full = np.full((n_record, *values.shape[1:]), np.nan)
        full[fitted] = values
        return np.moveaxis(full, 0, axis)

    groups: dict[str, xr.Dataset] = {}
    unit = {"units": "m2 s-2"}
    if draws is not None:
        chains = draws.chains
        n_chain, n_draw = chains.stress.shape[1:3]
        chain = {"chain": np.arange(n_chain), "ensemble": ("chain", np.arange(n_chain) // N_WALKER)}
        groups["posterior"] = xr.Dataset(
            {
                "stress": (("chain", "draw", "record", "component"), spread(chains.stress, 2), unit),
                **{
                    name: (("chain", "draw", "record"), spread(values, 2), {"units": UNITS[name]})
                    for name, values in draws.nuisances.items()
                },
            },
            coords={**stress_coords, **chain, "draw": np.arange(n_draw)},
        )
        groups["posterior_predictive"] = xr.Dataset(
            {"variance": (("chain", "draw", "record", "beam"), spread(draws.predicted, 2), unit)},
            coords={**beam_coords, **chain, "draw": np.arange(draws.predicted.shape[2])},
        )
        groups["sample_stats"] = xr.Dataset(
            {
                "ess_bulk": (("record", "component"), spread(chains.ess_bulk, 0)),
                "ess_tail": (("record", "component"), spread(chains.ess_tail, 0)),
                "r_hat": (("record", "component"), spread(chains.r_hat, 0)),
                "autocorrelation_time": (
                    ("record", "component"),
                    spread(chains.autocorrelation_time, 0),
                    {"units": "sampler steps"},
                ),
                "acceptance_rate": (("record",), spread(chains.acceptance, 0)),
                "n_step": (("record",), spread(chains.n_step.astype(np.float64), 0)),
                "pareto_k": (("record",), spread(chains.pareto_k, 0)),
                "misfit": (("record",), spread(draws.misfit, 0), {"units": "standard deviations"}),
                "sampler": (("record",), _named(chains.sampler, fitted, n_record)),
            },
            coords=stress_coords,
        )
    else:
        groups["posterior"] = xr.Dataset(
            {"stress": (("chain", "draw", "record", "component"), np.full((4, 4, n_record, 6), np.nan), unit)},
            coords=stress_coords,
        )
        groups["sample_stats"] = xr.Dataset(coords=stress_coords)
    groups["sample_stats"]["flag"] = (
        ("record",),
        flag,
        {"flag_masks": list(FLAGS.values()), "flag_meanings": " ".join(FLAGS)},
    )
    groups["prior"] = xr.Dataset(
        {"stress": (("chain", "draw", "component"), prior.draw(N_PRIOR_DRAW, PRIOR_SEED)[None], unit)},
        coords={"component": list(STRESSES)},
    )
    groups["observed_data"] = xr.Dataset(
        {
            "variance": (("record", "beam"), np.asarray(records["variance"].values, dtype=np.float64), unit),
            "used": (("record", "beam"), usable.astype(np.int8)),
            "wind_speed": (("record",), np.asarray(records["wind_speed"].values, dtype=np.float64), {"units": "m s-1"}),
            "yaw": (("record",), np.asarray(records["yaw"].values, dtype=np.float64), {"units": "degree"}),
            **({} if yaw_sd is None else {"yaw_sd": (("record",), yaw_sd, {"units": "degree"})}),
        },
        coords=beam_coords,
    )
    tree = xr.DataTree.from_dict({"/": xr.Dataset(), **{f"/{name}": group for name, group in groups.items()}})
    tree.attrs = {
        **attributes,
        "created_by": f"bayes_rs {__version__}",
        "scan": scan.name,
        "scan_key": scan.key,
        "sight": sight(scan).in_words(),
        "prior": prior.in_words(),
        "prior_name": prior.name,
        "noise": json.dumps(noise_summary(noise)),
    }
    return tree


def _named(names: NDArray[np.str_], fitted: NDArray[np.int64], n_record: int) -> NDArray[np.object_]:
    """Put the samplers' names among all records; empty for records that were not fitted."""
    full = np.full(n_record, "", dtype=object)
    full[fitted] = names.astype(object)
    return full


def group(result: xr.DataTree, name: str) -> xr.Dataset:
    """Return one group of a result as a Dataset."""
    return result.children[name].to_dataset()


def check_result(result: xr.DataTree) -> xr.DataTree:
    """Return the result if it has the groups that `fit` writes; else say what is missing."""
    for group, variable in (
        ("posterior", "stress"),
        ("prior", "stress"),
        ("observed_data", "variance"),
        ("sample_stats", "flag"),
    ):
        if group not in result.children or variable not in result[group]:
            raise InputError(f"Not a result of bayes_rs: it has no {group}/{variable}; make one with bayes_rs.fit.")
    return result


def noise_summary(noise: Noise) -> dict[str, Any]:
    """Return which noise it is, as plain numbers and texts."""
    realizations = float(noise.n_realizations[0])
    return {
        "method": noise.method,
        "turbulence": noise.turbulence.name,
        "length_scales": sorted({round(float(scale), 6) for scale in noise.length_scale}),
        "gammas": sorted({round(float(gamma), 6) for gamma in noise.gamma}),
        "duration": noise.duration,
        "wind_speeds": sorted({round(float(speed), 6) for speed in noise.wind_speed}),
        "yaws_deg": sorted({round(float(np.rad2deg(yaw)), 6) for yaw in noise.yaw}),
        "n_realizations": realizations if np.isfinite(realizations) else None,
    }
