"""The one way to make noise: at states, in a net, for records, or for a record with gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from bayes_rs._validation import FloatArray, check_array, check_choice, check_positive, check_switch
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.noise.at_states import noise_at_states
from bayes_rs.noise.box_noise import Boxes
from bayes_rs.noise.choice import noise_for_records
from bayes_rs.noise.gaps import gap_noise
from bayes_rs.noise.net import TOLERANCE, refined_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.records.belief import believed
from bayes_rs.records.given import check_are_records
from bayes_rs.simulation.virtual import RecordState
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

METHODS = ("theory", "boxes")
"""How noise can be made: by closed forms of Gaussian turbulence, or by realizations of it in boxes."""


def calibrate(
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path = "fu-2022",
    *,
    records: xr.Dataset | None = None,
    wind_speed: float | Sequence[float] | None = None,
    yaw_deg: float | Sequence[float] | None = None,
    length_scale: float | Sequence[float] | None = None,
    gamma: float | Sequence[float] | None = None,
    duration: float = 600.0,
    method: str | Boxes = "theory",
    tolerance: float | None = None,
    present: ArrayLike | None = None,
    sonic: bool = False,
    cache: bool | str | Path = True,
    progress: bool | None = None,
) -> Noise:
    """Return the noise of a scan's beam variances: for records, or at wind speeds and directions that are given.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, its name or its file.
    turbulence : MannTurbulence, str or Path
        The turbulence, its name or its file.
    records : xarray.Dataset, optional
        Records, with ``wind_speed`` (m/s) and ``yaw`` (degrees): the noise is what they need, for their beams and
        duration, and for their ``length_scale`` and ``gamma`` if they have some. Give these or `wind_speed`.
    wind_speed : float or sequence of float, optional
        Mean wind speed, m/s.
    yaw_deg : float or sequence of float, optional
        Wind direction relative to the lidar axis, degrees; by default the scan's own yaw.
    length_scale, gamma : float or sequence of float, optional
        Length scale L, m, and anisotropy Γ; by default those of the turbulence. With `records`, numbers whose range the
        noise reaches over.
    duration : float
        Length of a record, s; with `records`, it is theirs.
    method : str or Boxes
        ``"theory"``: `theory`, exact for frozen Gaussian turbulence in an infinite domain. ``"boxes"`` or `Boxes`: a
        virtual lidar in boxes of Mann turbulence, which needs the extra ``boxes`` unless the noise is shipped or
        cached.
    tolerance : float, optional
        Largest relative error of K between states, by theory. With it, wind speeds, directions, L and Γ are ranges, and
        the states a net that is just fine enough (`refined_noise`); without it, every combination of them is a state.
        Noise for records is a net in any case, of 0.01 by default.
    present : array_like of bool, shape (n_beam, n_sample), optional
        Which samples of a record there are, by theory at one state: the noise of a record with gaps.
    sonic : bool
        Add the joint moments with the stresses of a sonic at the rotor's centre, which the target ``"sonic"`` of `fit`
        needs; by theory only.
    cache : bool, str or Path
        True to use the shipped noise and the user's cache folder, False for neither, or another folder for the cache.
    progress : bool, optional
        Show a progress bar; by default if stderr is a terminal.

    Returns
    -------
    noise : Noise
        Its states are every combination, wind speeds first. `Noise.in_words` says what it is.

    Raises
    ------
    InputError
        If a number is not valid, the method is unknown, or neither `records` nor `wind_speed` is given, or both.
    MissingExtraError
        If boxes are needed and hipersim is not installed.

    Notes
    -----
    From boxes, K_ab = ⟨(y_a/E_a − 1)(y_b/E_b − 1)⟩ over all records of all boxes, with the expectations E of the boxes
    known exactly from their spectrum; the mean is therefore not estimated, and nothing has to be subtracted for it. The
    records of a box are not independent, so the standard error comes from the scatter between boxes, and
    ``n_realizations`` is the number of independent records that would give that standard error.

    ``bias`` refers to the boxes' own tensor (`BoxMaker.tensor`, about zero, no mean removed), which lacks the eddies
    longer than the box: at the seed's flow and 600 s it is −0.10 for u where an infinite domain gives −0.12.

    Shipped noise is used with ``cache=True`` and the default seed, if it was made with at least as many boxes. The
    cache is in the folder that the environment variable ``BAYES_RS_CACHE`` names, or in ``bayes_rs`` under
    ``XDG_CACHE_HOME`` or under ``~/.cache``. Its key contains everything that the numbers depend on; a damaged file is
    computed again.

    What a box leaves out: eddies longer than the box or smaller than its grid, and the fine structure of the spectrum
    at wave lengths of its width. At the seed's flow, the relative standard deviation of the along-wind variance is
    0.266 in the boxes and 0.2585 in an infinite domain.

    Examples
    --------
    >>> noise = calibrate("staring", wind_speed=10.0)
    >>> noise.relative_error.round(2)
    array([[0.26]])

    Noise for wind speeds from 6 to 12 m/s, with an error of 1 % between its states:

    >>> noise = calibrate("staring", wind_speed=[6.0, 12.0], tolerance=0.01, cache=False)
    >>> len(noise), noise.interpolation_error < 0.01
    (3, True)
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    check_switch(sonic, what="sonic")
    if not isinstance(cache, (bool, str, Path)):
        raise InputError(f"Invalid cache {in_short(cache)}: it must be True, False or a folder.")
    boxes = method if isinstance(method, Boxes) else None
    if boxes is None and check_choice(str(method), METHODS, what="method of calibration") == "boxes":
        boxes = Boxes()
    if (records is None) == (wind_speed is None):
        given = "Neither records nor wind_speed is" if records is None else "Both records and wind_speed are"
        raise InputError(
            f"{given} given: give records, for the noise that they need, or wind_speed (m/s), for that of its states."
        )
    if boxes is not None:
        for name, value in (("records", records), ("tolerance", tolerance), ("present", present)):
            if value is not None:
                raise InputError(f"Invalid {name} with method 'boxes': only method='theory' has it; give wind_speed.")
    common: dict[str, Any] = {"cache": cache, "sonic": sonic, "progress": progress}
    if records is not None:
        check_are_records(records)
        records = believed(records)
        if yaw_deg is not None or present is not None:
            name = "yaw_deg" if present is None else "present"
            raise InputError(f"Invalid {name} with records: the noise is for all of them; leave it out.")
        return noise_for_records(
            records,
            scan.select(records["beam"].values) if "beam" in records.coords else scan,
            turbulence,
            length_scale=_range(length_scale, "length_scale"),
            gamma=_range(gamma, "gamma"),
            tolerance=TOLERANCE if tolerance is None else tolerance,
            **common,
        )
    if tolerance is not None and present is None:
        return refined_noise(
            scan,
            turbulence,
            wind_speed=_range(wind_speed, "wind_speed") or (),
            yaw_deg=_range(yaw_deg, "yaw_deg"),
            length_scale=_range(length_scale, "length_scale"),
            gamma=_range(gamma, "gamma"),
            duration=duration,
            tolerance=tolerance,
            **common,
        )
    check_positive(duration, what="duration", unit="s")
    speeds = _numbers(wind_speed, 0.0, "wind_speed")
    yaws = np.array([scan.yaw]) if yaw_deg is None else np.deg2rad(_numbers(yaw_deg, 0.0, "yaw_deg"))
    flows = [
        replace(turbulence, length_scale=float(scale), gamma=float(anisotropy))
        for scale in _numbers(length_scale, turbulence.length_scale, "length_scale")
        for anisotropy in _numbers(gamma, turbulence.gamma, "gamma")
    ]
    states = [RecordState(scan, float(speed), float(yaw), float(duration)) for speed, yaw in product(speeds, yaws)]
    if present is not None:
        if len(states) * len(flows) > 1 or sonic or tolerance is not None:
            raise InputError(
                "Invalid present with several states, a tolerance or a sonic: give one wind speed, direction, L and Γ, "
                "and neither tolerance nor sonic."
            )
        return gap_noise(scan, flows[0], present, wind_speed=speeds[0], duration=duration, yaw=float(yaws[0]))
    return Noise.join([noise_at_states(states, flow, boxes=boxes, **common) for flow in flows])


def _numbers(values: ArrayLike | None, default: float, name: str) -> FloatArray:
    """Return one or more numbers."""
    numbers = check_array(np.atleast_1d(np.asarray(default if values is None else values)), (None,), what=name)
    if len(numbers) == 0:
        raise InputError(f"Invalid {name} {values!r}: give a number or a sequence of numbers.")
    return numbers


def _range(values: float | Sequence[float] | None, name: str) -> list[float] | None:
    return None if values is None else [float(value) for value in _numbers(values, 0.0, name)]
