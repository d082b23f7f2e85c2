"""The groups of a fit as xarray Datasets, in ArviZ's layout."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
import xarray as xr

from bayes_rs.errors import InputError
from bayes_rs.fits.columns import CORRELATED
from bayes_rs.fits.fit_data import FitData
from bayes_rs.fits.fit_options import MOST_KEPT
from bayes_rs.fits.flags import FLAGS
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.posteriors.nuisance import UNITS
from bayes_rs.posteriors.sampling.chains import N_CHAIN, N_ENSEMBLE

_UNIT = {"units": "m2 s-2"}
_PER_RECORD = {
    "acceptance_rate": "",
    "n_step": "",
    "n_draw": "",
    "mc_error": "posterior standard deviations",
    "pareto_k": "",
    "misfit": "standard deviations",
    "beams_probability": "",
}


def posterior(fit: FitData) -> xr.Dataset:
    """Return the draws: ``stress`` (chain, draw, record, component), and nuisances (chain, draw, record)."""
    stress = fit.draws()
    n_chain, n_draw = stress.shape[1:3]
    nuisances = {name: fit.nuisance_draws(name) for name in fit.nuisance_names}
    return xr.Dataset(
        {
            "stress": (("chain", "draw", "record", "component"), np.moveaxis(stress, 0, 2), _UNIT),
            **{
                name: (("chain", "draw", "record"), np.moveaxis(values, 0, 2), {"units": UNITS[name]})
                for name, values in nuisances.items()
            },
        },
        coords={**_stress_coords(fit), **_chains(n_chain), "draw": np.arange(n_draw)},
    )


def posterior_predictive(fit: FitData) -> xr.Dataset:
    """Return radial variances that the posterior predicts: ``variance`` (chain, draw, record, beam)."""
    predicted = fit.predicted_draws()
    n_chain, n_draw = predicted.shape[1:3]
    return xr.Dataset(
        {"variance": (("chain", "draw", "record", "beam"), np.moveaxis(predicted, 0, 2), _UNIT)},
        coords={**_beam_coords(fit), **_chains(n_chain), "draw": np.arange(n_draw)},
    )


def prior(fit: FitData) -> xr.Dataset:
    """Return draws of the prior: ``stress`` (chain, draw, component)."""
    return xr.Dataset(
        {"stress": (("chain", "draw", "component"), fit.prior_draws[None], _UNIT)},
        coords={"component": list(STRESSES)},
    )


def observed_data(fit: FitData) -> xr.Dataset:
    """Return what the fit was of: variances, which of them were used, wind speed and direction."""
    from bayes_rs.fits.prepare import record_yaw_sd, used_beams  # noqa: PLC0415 - what opens a fit prepares none

    records, own = fit.records, fit.settings["fit"]
    yaw_sd = record_yaw_sd(records, own["nuisances"])
    return xr.Dataset(
        {
            "variance": (("record", "beam"), np.asarray(records["variance"].values, dtype=np.float64), _UNIT),
            "used": (("record", "beam"), used_beams(records, own["instrument_noise"]).astype(np.int8)),
            "wind_speed": (("record",), np.asarray(records["wind_speed"].values, dtype=np.float64), {"units": "m s-1"}),
            "yaw": (("record",), np.asarray(records["yaw"].values, dtype=np.float64), {"units": "degree"}),
            **({} if yaw_sd is None else {"yaw_sd": (("record",), yaw_sd, {"units": "degree"})}),
        },
        coords=_beam_coords(fit),
    )


def sample_stats(fit: FitData) -> xr.Dataset:
    """Return diagnostics and flags of the records."""
    rows, summary = fit.source.read("posterior"), fit.source.read("summary")
    stresses = summary[summary["stress"].isin(STRESSES)]
    n_record = len(rows)
    of_stress = {
        name: stresses[name].to_numpy(dtype=np.float64).reshape(n_record, len(STRESSES))
        for name in ("ess_bulk", "ess_tail", "r_hat")
    }
    of_stress["autocorrelation_time"] = rows[list(CORRELATED)].to_numpy(dtype=np.float64)
    return xr.Dataset(
        {
            **{
                name: (("record", "component"), values, {"units": "sampler steps"} if name not in summary else {})
                for name, values in of_stress.items()
            },
            **{
                name: (("record",), rows[name].to_numpy(dtype=np.float64), {"units": unit} if unit else {})
                for name, unit in _PER_RECORD.items()
            },
            "sampler": (("record",), rows["sampler"].to_numpy(dtype=object)),
            "flag": (
                ("record",),
                rows["flag_bits"].to_numpy(),
                {"flag_masks": list(FLAGS.values()), "flag_meanings": " ".join(FLAGS)},
            ),
        },
        coords=_stress_coords(fit),
    )


def log_likelihood(fit: FitData) -> xr.Dataset:
    """Return the log-likelihood of the draws: ``joint`` (chain, draw, record), and that of each datum, ``variance``
    (chain, draw, record, beam) or ``direction`` (chain, draw, record, number); see `log_likelihood_of`.

    Raises
    ------
    InputError
        If there is none.
    """
    if not has_log_likelihood(fit):
        raise InputError(
            "This fit has no log_likelihood: it is that of R, whose draws are not kept for the target 'sonic', and in "
            f"a folder it is there for up to {MOST_KEPT} records whose draws are kept."
        )
    found: xr.Dataset = fit.loaded.log_likelihood(fit)
    return with_places(fit, found)


def with_places(fit: FitData, found: xr.Dataset) -> xr.Dataset:
    """Return a log-likelihood with the coordinates of the fit."""
    coords = _beam_coords(fit) if "beam" in found.dims else _record_coords(fit)
    return found.assign_coords({**coords, **_chains(found.sizes["chain"]), "draw": np.arange(found.sizes["draw"])})


def has_log_likelihood(fit: FitData) -> bool:
    """Tell whether the log-likelihood of the draws is known."""
    return fit.has_draws and fit.settings["fit"]["target"] != "sonic" and bool(fit.loaded.has_log_likelihood())


GROUPS = {
    "posterior": posterior,
    "sample_stats": sample_stats,
    "log_likelihood": log_likelihood,
    "prior": prior,
    "observed_data": observed_data,
    "posterior_predictive": posterior_predictive,
}
"""The groups by name."""
_NEED_DRAWS = ("posterior", "log_likelihood", "posterior_predictive")


def group_names(fit: FitData) -> list[str]:
    """Return the names of the groups that a fit with draws has."""
    return [name for name in GROUPS if name != "log_likelihood" or has_log_likelihood(fit)]


def has_group(fit: FitData, name: object) -> bool:
    """Tell whether a fit has a group, with draws where it needs them."""
    return name in group_names(fit) and (fit.has_draws or name not in _NEED_DRAWS)


def tree_of(groups: Mapping[str, xr.Dataset], attrs: Mapping[str, Any]) -> xr.DataTree:
    """Return groups as one tree."""
    tree = xr.DataTree.from_dict({"/": xr.Dataset(), **{f"/{name}": group for name, group in groups.items()}})
    tree.attrs = dict(attrs)
    return tree


def of_one_record(groups: Mapping[str, xr.Dataset], record: int) -> dict[str, xr.Dataset]:
    """Return groups of one record, with the beams that it uses, and without numbers that it does not have."""
    used = groups["observed_data"]["used"].values[record] == 1
    found = {}
    for name, group in groups.items():
        own = group.isel(record=record) if "record" in group.dims else group
        if "beam" in own.dims:
            own = own.isel(beam=np.flatnonzero(used))
        if "number" in own.dims:
            own = own.dropna("number", how="all")
        found[name] = own
    return found


def as_arviz_takes(tree: xr.DataTree) -> Any:
    """Return a tree as the ArviZ that is installed works with it: before its version 1 as an InferenceData."""
    if int(version("arviz").split(".", maxsplit=1)[0]) >= 1:
        return tree
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ 0.23 announces its own refactoring when it is imported
        import arviz  # noqa: PLC0415 - it takes a second, and nothing else needs it
    groups: dict[str, Any] = {name: group.to_dataset() for name, group in tree.children.items()}
    return arviz.InferenceData(attrs=tree.attrs, **groups)


def group_of(fit: FitData, name: str) -> xr.Dataset:
    """Return one group of a fit.

    Raises
    ------
    InputError
        If there is no such group, or it needs draws that were not kept.
    """
    if name not in GROUPS:
        raise InputError(f"Unknown group {name!r} of a fit: it must be one of {', '.join(GROUPS)}.")
    return GROUPS[name](fit)


def attributes(fit: FitData) -> dict[str, Any]:
    """Return the attributes of a fit: what it was asked for, as plain numbers and texts."""
    run, own = fit.run, fit.settings["fit"]
    clipped = {}
    if own["target"] == "sonic":
        values = fit.source.read("posterior", ["record", "sonic_clipped"])["sonic_clipped"].to_numpy(dtype=np.float64)
        clipped = {"sonic_clipped": float(np.nanmax(values)) if np.isfinite(values).any() else 0.0}
    return {
        **{name: own[name] for name in ("target", "sampler", "likelihood", "instrument_noise", "seed", "target_ess")},
        **({} if own.get("monte_carlo_error") is None else {"monte_carlo_error": own["monte_carlo_error"]}),
        "nuisances": run["nuisances"],
        "n_outside_noise": fit.flags["outside_noise"],
        **clipped,
        "created_by": f"bayes_rs {run['bayes_rs']}",
        **{name: run[name] for name in ("scan", "scan_key", "sight", "prior", "prior_name")},
        "noise": json.dumps(run["noise"], sort_keys=True),
    }


def _stress_coords(fit: FitData) -> dict[str, Any]:
    return {**_record_coords(fit), "component": list(STRESSES)}


def _beam_coords(fit: FitData) -> dict[str, Any]:
    return {**_record_coords(fit), "beam": fit.records["beam"].values}


def _record_coords(fit: FitData) -> dict[str, Any]:
    coords: dict[str, Any] = {"record": np.arange(fit.n_record)}
    if "time" in fit.records.coords:
        coords["time"] = ("record", fit.records["time"].values)
    return coords


def _chains(n_chain: int) -> dict[str, Any]:
    return {"chain": np.arange(n_chain), "ensemble": ("chain", np.arange(n_chain) // (N_CHAIN // N_ENSEMBLE))}
