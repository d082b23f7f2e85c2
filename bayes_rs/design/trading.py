"""What a cone of beams would know of R against its opening angle, focus distance, number of beams and record length."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_rs._validation import FloatArray, check_array, check_choice, check_count, check_positive
from bayes_rs.design.comparing import posterior_rows, truth_of
from bayes_rs.design.trial_records import even_normals, trial_records
from bayes_rs.errors import InputError
from bayes_rs.geometry.forward import RANK_TOLERANCE, sight
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import cone_direction
from bayes_rs.geometry.stress import STRESSES
from bayes_rs.noise.by_theory import theory_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.priors.registry import Prior, make_prior
from bayes_rs.progress import progress
from bayes_rs.turbulence.mann import MannTurbulence, load_turbulence

COLUMNS = (
    "n_beams",
    "centre",
    "opening_angle_deg",
    "focus_distance",
    "duration",
    "stress",
    "truth",
    "width_50",
    "width_90",
    "ratio_50",
    "ratio_90",
    "prior_ratio_90",
    "bias_ratio",
    "rmse_ratio",
    "contraction_shape",
    "rank",
)
DESIGN = ("n_beams", "centre", "opening_angle_deg", "focus_distance", "duration")
"""The columns that say which scan and record length a row is for."""
ENOUGH = 0.02
"""More beams buy nothing where a width is within this of the width with the most beams."""
_FEWEST = 3
_SMALLEST = 1e-9  # eigenvalues of Σ below this part of the largest are rounding and the error of K


def trade_off(
    *,
    n_beams: int | Sequence[int] = 6,
    centre: bool | Sequence[bool] = True,
    opening_angle_deg: float | Sequence[float] = (10.0, 15.0, 20.0, 25.0, 30.0, 37.5, 45.0),
    focus_distance: float | Sequence[float] = (30.0, 49.0, 98.0, 150.0, 200.0, 300.0),
    duration: float | Sequence[float] = 600.0,
    turbulence: str | MannTurbulence = "fu-2022",
    wind_speed: float = 10.0,
    prior: str | Prior = "weak",
    stresses: Sequence[str] | None = None,
    scan_duration: float = 1.0,
    probe: Probe | None = None,
    n_records: int = 32,
    seed: int = 1,
    show_progress: bool | None = None,
) -> pd.DataFrame:
    """Tabulate the expected interval widths of beams on a cone, for every combination of what is given.

    Parameters
    ----------
    n_beams : int or sequence of int
        Number of all beams, a centre beam included; at least 3.
    centre : bool or sequence of bool
        Whether one of the beams points along the axis.
    opening_angle_deg : float or sequence of float
        Half-cone opening angle, degrees, above 0 and below 90.
    focus_distance : float or sequence of float
        Distance of the measured points from the lidar, m.
    duration : float or sequence of float
        Length of a record, s.
    turbulence : str or MannTurbulence
        The flow; its name or file, or itself.
    wind_speed : float
        Mean wind speed, m/s.
    prior : str or Prior
        The prior.
    stresses : sequence of str, optional
        Which stresses; by default all six.
    scan_duration : float
        Time for all beams once, s, whatever their number; they share it equally.
    probe : Probe, optional
        The probe volume of the beams; points if not given.
    n_records : int
        Records that are drawn for each scene, evenly, from its noise; the widths are their means.
    seed : int
        Same seed, same numbers.
    show_progress : bool, optional
        Progress bar on stderr; by default only on a terminal.

    Returns
    -------
    table : DataFrame
        One row for each combination and stress, with the columns of `COLUMNS`: the expected widths of the central 50
        and 90 % intervals (m² s⁻², and as ``ratio_50`` and ``ratio_90`` over the true uu of a record), that of the
        prior, bias and root mean square error of the posterior mean (over uu, too), how far the posterior of the shape
        R/tr R is narrower than the prior's (``contraction_shape``, 1 − ratio of variances), and the rank of the beams.
        If there are several `n_beams`, the attribute ``enough_beams`` holds
        what `enough_beams` returns, as a list of rows.

    Raises
    ------
    InputError
        If an argument is not valid; sequences must increase.

    Notes
    -----
    The beams start at the top of the cone and follow each other evenly, the centre beam last, as in the scan
    ``6-beam``. The noise is `theory_noise`: Gaussian frozen turbulence, without instrument noise. With Σ = ln(1 + K) of
    the noise and S_b = ∂ ln E[y_b]/∂R at the truth, the log-variances of the records are

        E[ln y] + Σ^(1/2) U Vᵀ z,     Σ^(-1/2) S = U s Vᵀ,

    with the same even z (Sobol, 6 numbers a record) for every scan, so that scans differ by what they are and little by
    the draw. This keeps the errors that some R explains, and leaves out those that none does: beyond six beams they
    change how well a record fits, and hardly the widths. With as many beams as the rank the records are distributed as
    those of ``compare(..., method="fast")``.

    Examples
    --------
    >>> table = trade_off(opening_angle_deg=(15.0, 30.0), focus_distance=98.0, stresses=["vv"], n_records=8)
    >>> table["ratio_90"].round(1).tolist()
    [1.0, 0.8]
    """
    counts = _beam_numbers(n_beams)
    kinds = _centres(centre)
    angles = _increasing(opening_angle_deg, "opening_angle_deg", "degree")
    if angles[-1] >= 90.0:
        raise InputError(
            f"Invalid opening_angle_deg {angles[-1]:g}: it must be below 90 degrees, since the beams are on a cone."
        )
    distances = _increasing(focus_distance, "focus_distance", "m")
    durations = _increasing(duration, "duration", "s")
    check_positive(scan_duration, what="scan_duration", unit="s")
    names = STRESSES if stresses is None else (stresses,) if isinstance(stresses, str) else tuple(stresses)
    if not names or len(set(names)) != len(names):
        raise InputError(f"Invalid stresses {list(names)}: name at least one, and each once.")
    for name in names:
        check_choice(name, STRESSES, what="stress")
    flow = load_turbulence(turbulence) if isinstance(turbulence, str) else turbulence
    check_positive(wind_speed, what="wind_speed", unit="m/s")
    check_count(n_records, what="n_records", minimum=2)
    chosen = make_prior(prior)
    cells = list(product(counts, kinds, angles, distances, durations))
    errors = even_normals(n_records, len(STRESSES), seed)  # the same for every scan, so that scans compare
    silent = None if show_progress is None else not show_progress
    rows: list[dict[str, Any]] = []
    for cell in progress(cells, len(cells), "trade-off", disable=silent):
        number, kind, angle, far, length = cell
        scan = cone_scan(
            number, centre=kind, opening_angle_deg=angle, focus_distance=far, scan_duration=scan_duration, probe=probe
        )
        widths = _widths(scan, flow, chosen, wind_speed, length, errors, seed)
        rows += [{**dict(zip(DESIGN, cell, strict=True)), **row} for row in widths if row["stress"] in names]
    table = pd.DataFrame(rows)[list(COLUMNS)]
    if len(counts) > 1:
        table.attrs["enough_beams"] = enough_beams(table).to_dict("records")
    return table


def _widths(
    scan: Scan,
    flow: MannTurbulence,
    prior: Prior,
    wind_speed: float,
    duration: float,
    errors: FloatArray,
    seed: int,
) -> list[dict[str, Any]]:
    """Return a row for each stress: what the posterior of a record of this scan is expected to be."""
    noise = theory_noise(scan, flow, wind_speed=wind_speed, duration=duration)
    truth = truth_of(scan, flow, wind_speed, duration, "record")
    records = _explained_records(scan, noise, truth, errors)
    found = posterior_rows(records, scan, noise, prior, "record", truth, seed, {"rank": sight(scan).rank}, 0.0)
    for row in found:
        row["ratio_50"], row["ratio_90"] = row["width_50"] / truth[0], row["width_90"] / truth[0]
        row["prior_ratio_90"] = row["prior_width_90"] / truth[0]
        row["bias_ratio"], row["rmse_ratio"] = row["bias"] / truth[0], row["rmse"] / truth[0]
    return found


def _explained_records(scan: Scan, noise: Noise, truth: FloatArray, errors: FloatArray) -> xr.Dataset:
    """Return records with the errors of their log-variances that some R explains, evenly; see `trade_off`."""
    log_covariance = np.log1p(noise.covariance[0])
    values, vectors = np.linalg.eigh(log_covariance)
    size = np.sqrt(np.maximum(values, _SMALLEST * values[-1]))
    root, whitened = (vectors * size) @ vectors.T, (vectors / size) @ vectors.T
    expected = noise.gain[0] @ truth
    left, seen, right = np.linalg.svd(whitened @ (noise.gain[0] / expected[:, np.newaxis]), full_matrices=False)
    kept = seen > RANK_TOLERANCE * seen[0]
    # the polar factor, unlike the singular vectors, changes as smoothly as the scan does
    spread = root @ left[:, kept] @ right[kept]
    variance = expected * np.exp(errors @ spread.T - 0.5 * np.diag(log_covariance))
    return trial_records(scan, noise, variance)


def cone_scan(
    n_beams: int,
    *,
    centre: bool,
    opening_angle_deg: float,
    focus_distance: float,
    scan_duration: float = 1.0,
    probe: Probe | None = None,
) -> Scan:
    """Return beams evenly on a cone, the first at its top, with or without one of them along the axis.

    Parameters
    ----------
    n_beams : int
        Number of all beams.
    centre : bool
        Whether the last of them points along the axis.
    opening_angle_deg : float
        Half-cone opening angle, degrees.
    focus_distance : float
        Distance of the measured points, m.
    scan_duration : float
        Time for all beams once, s.
    probe : Probe, optional
        The probe volume of the beams; points if not given.

    Returns
    -------
    scan : Scan
        The scan.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> cone_scan(6, centre=True, opening_angle_deg=15.0, focus_distance=98.0).key == load_scan("6-beam").key
    True
    """
    on_cone = n_beams - 1 if centre else n_beams
    phase = 0.5 * np.pi + 2.0 * np.pi * np.arange(on_cone) / on_cone
    opening = np.full(on_cone, np.deg2rad(opening_angle_deg))
    if centre:
        phase, opening = np.append(phase, 0.0), np.append(opening, 0.0)
    return Scan(
        name=f"{n_beams} beams {'with' if centre else 'without'} centre, {opening_angle_deg:g}°, {focus_distance:g} m",
        beam_direction=cone_direction(opening, phase),
        focus_distance=np.full(n_beams, focus_distance),
        beam_time=np.arange(n_beams, dtype=np.float64) * (scan_duration / n_beams),
        scan_duration=scan_duration,
        probe=PointProbe() if probe is None else probe,
    )


def enough_beams(table: pd.DataFrame, *, within: float = ENOUGH) -> pd.DataFrame:
    """Find the number of beams beyond which more of them buy nothing.

    Parameters
    ----------
    table : DataFrame
        From `trade_off`, for several numbers of beams.
    within : float
        How much wider than with the most beams an interval may be, relatively.

    Returns
    -------
    found : DataFrame
        A row for each centre, opening angle, focus distance, duration and stress: ``enough``, the smallest number of
        the table from which on all 90 % widths are within `within` of the last, and ``most``, the largest number.

    Raises
    ------
    InputError
        If the table holds one number of beams only.
    """
    check_positive(within, what="within", unit="")
    if table["n_beams"].nunique() < 2:
        raise InputError("The table holds one number of beams only: give trade_off several.")
    rows: list[dict[str, Any]] = []
    keys = [*DESIGN[1:], "stress"]
    for case, some in table.groupby(keys, sort=False):
        ordered = some.sort_values("n_beams")
        width, number = ordered["ratio_90"].to_numpy(), ordered["n_beams"].to_numpy()
        wide = np.flatnonzero(width > (1.0 + within) * width[-1])
        first = 0 if len(wide) == 0 else int(wide[-1]) + 1
        rows.append({**dict(zip(keys, case, strict=True)), "enough": int(number[first]), "most": int(number[-1])})
    return pd.DataFrame(rows)


def _beam_numbers(n_beams: int | Sequence[int]) -> tuple[int, ...]:
    given = np.atleast_1d(np.asarray(n_beams)).ravel().tolist()
    numbers = tuple(check_count(number, what="n_beams", minimum=_FEWEST) for number in given)
    _check_increasing(numbers, "n_beams")
    return numbers


def _centres(centre: bool | Sequence[bool]) -> tuple[bool, ...]:
    kinds = (centre,) if isinstance(centre, bool) else tuple(centre)
    if not kinds or len(set(kinds)) != len(kinds) or not all(isinstance(kind, bool) for kind in kinds):
        raise InputError(f"Invalid centre {centre!r}: it must be True, False or both, each once.")
    return kinds


def _increasing(values: float | Sequence[float], what: str, unit: str) -> tuple[float, ...]:
    numbers = tuple(check_array(np.atleast_1d(np.asarray(values, dtype=np.float64)), (None,), what=what).tolist())
    for number in numbers:
        check_positive(number, what=what, unit=unit)
    _check_increasing(numbers, what)
    return numbers


def _check_increasing(numbers: Sequence[float], what: str) -> None:
    if len(numbers) == 0:
        raise InputError(f"Invalid {what}: there is no value; give at least one.")
    for before, after in pairwise(numbers):
        if not after > before:
            raise InputError(f"Invalid {what}: {after:g} follows {before:g}; the values must increase, each once.")
