"""The virtual lidar: what the beams of a scan measure of turbulence that the mean wind carries past."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import (
    FloatArray,
    as_generator,
    check_array,
    check_choice,
    check_count,
    check_finite,
    check_positive,
)
from bayes_rs.errors import InputError
from bayes_rs.geometry.probe import PointProbe, Probe
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import pack_stress
from bayes_rs.progress import progress
from bayes_rs.simulation.boxes import Box, BoxGrid, BoxMaker, choose_grid, generator_name
from bayes_rs.simulation.lines import LineMaker
from bayes_rs.sizes import check_size
from bayes_rs.turbulence.mann import MannTurbulence, as_turbulence

FIRST_RECORD = np.datetime64("2000-01-01T00:00:00", "ns")
"""When the first simulated record starts, UTC."""

_POINT = PointProbe()

_BYTES_A_SAMPLE = 72.0
"""What a simulated sample takes while the series is put in order: velocity, time, beam, and their sorted copies."""
_LEVELS_AT_ONCE = 16
"""How many heights are interpolated in one matrix product: enough to be fast, few enough to need little memory."""


@dataclass(frozen=True)
class RecordState:
    """What fixes the noise of a record but the turbulence: scan, mean wind and record length.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan.
    wind_speed : float
        Mean wind speed U, m/s.
    yaw : float
        Wind direction relative to the lidar axis ψ, rad; the scan's own yaw is not used.
    duration : float
        Length of a record T, s.

    Raises
    ------
    InputError
        If a number is not positive or a record holds fewer than two scans.
    """

    scan: Scan
    wind_speed: float
    yaw: float
    duration: float

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_positive(self.wind_speed, what="wind_speed", unit="m/s")
        check_positive(self.duration, what="duration", unit="s")
        if self.n_sample < 2:
            raise InputError(
                f"Invalid duration {self.duration:g} s for scan {self.scan.name!r}: a record must hold at least two "
                f"scans of {self.scan.scan_duration:g} s."
            )

    @property
    def n_sample(self) -> int:
        """Number of samples N of each beam in a record."""
        return int(np.floor(self.duration / self.scan.scan_duration + 1e-9))

    @property
    def step(self) -> float:
        """How far the wind carries the air between two samples of a beam, m."""
        return self.wind_speed * self.scan.scan_duration

    @property
    def line_of_sight(self) -> FloatArray:
        """Unit vectors in the mean-wind frame, shape (n_beam, 3)."""
        return self.scan.at_yaw(self.yaw)

    @property
    def focus(self) -> FloatArray:
        """Focus points in the mean-wind frame, lidar at the origin, shape (n_beam, 3), m."""
        return self.scan.focus_distance[:, None] * self.line_of_sight

    @property
    def extent(self) -> float:
        """Largest distance between beams in y or in z, m."""
        return float(np.max(np.ptp(self.focus[:, 1:], axis=0)))

    def records_in(self, grid: BoxGrid) -> int:
        """Number of records that fit into a box end to end."""
        return int(np.floor(grid.size[0] / (self.step * self.n_sample) + 1e-9))

    def expected_variance(self, maker: BoxMaker) -> FloatArray:
        """Return E[y_b] in the boxes of a maker, exactly, shape (n_beam,), m² s⁻².

        Notes
        -----
        E[y_b] = Σ_{k₁} F_b(k₁) (1 − D_N(k₁ U Δ)²), where F_b is the spectrum of the beam's radial velocity
        (`BoxMaker.radial_spectrum`), with its probe volume, and D_N(φ) = sin(Nφ/2) / (N sin(φ/2)) is the response of
        the mean of N samples a time Δ apart: the variance less the variance of the mean.
        """
        spectrum = maker.radial_spectrum(self.line_of_sight, self.scan.probe, self.scan.focus_distance)
        return np.asarray(spectrum @ self._kept(maker))

    def record_tensor(self, maker: BoxMaker) -> FloatArray:
        """Return the expected stresses of a record at a point in the boxes of a maker, shape (3, 3), m² s⁻²."""
        return np.asarray(np.einsum("k,kij->ij", self._kept(maker), maker.spectrum))

    def _kept(self, maker: BoxMaker) -> FloatArray:
        """Return the part of the variance in each wave number k₁ that is left when a record's mean is removed."""
        return np.asarray(1.0 - scipy.special.diric(maker.wave_number * self.step, self.n_sample) ** 2)


def interpolation_weights(position: ArrayLike, count: int, spacing: float) -> FloatArray:
    """Return the weights of exact trigonometric interpolation on a periodic grid.

    Parameters
    ----------
    position : array_like, shape (n,)
        Where to interpolate, m; the grid's first point is at 0.
    count : int
        Number of grid points N, even.
    spacing : float
        Distance between grid points, m.

    Returns
    -------
    weights : ndarray, shape (n, count)
        Value at position = weights @ values on the grid.

    Notes
    -----
    w_j(y) = (1/N) [1 + 2 Σ_{m=1}^{N/2−1} cos(m φ_j) + cos(N φ_j / 2)] with φ_j = 2π (y − y_j) / (N spacing): exact for
    every wave that the grid can hold; the wave of wave length 2 × spacing is taken as a cosine about the grid's points.

    Examples
    --------
    >>> interpolation_weights([3.0], 4, 1.0).round(12) + 0.0
    array([[0., 0., 0., 1.]])
    """
    points = check_array(position, (None,), what="position")
    phase = 2.0 * np.pi * (points[:, None] / spacing - np.arange(count)) / count
    wave = np.arange(1, count // 2)
    inner = np.cos(wave * phase[..., None]).sum(axis=-1)
    return np.asarray((1.0 + 2.0 * inner + np.cos(0.5 * count * phase)) / count)


def beam_lines(
    box: Box,
    focus: ArrayLike,
    line_of_sight: ArrayLike,
    *,
    probe: Probe = _POINT,
    focus_distance: ArrayLike | None = None,
) -> FloatArray:
    """Return the radial velocity of beams whose focus points move along lines in x.

    Parameters
    ----------
    box : Box
        The box.
    focus : array_like, shape (n, 3)
        Focus points, m; y and z may be anywhere, the box is periodic.
    line_of_sight : array_like, shape (n, 3)
        Unit vectors.
    probe : Probe
        The probe volume; by default the beams see points.
    focus_distance : array_like, shape (n,), optional
        Distance of each focus point from its lidar, m, which a probe volume may depend on; not needed for points.

    Returns
    -------
    lines : ndarray, shape (n, n_x)
        n·u averaged over the probe volume, at the x of the grid and the y and z of each point, m/s; exact.

    Raises
    ------
    InputError
        If the shapes disagree, or there is a probe volume and no focus distance.

    Notes
    -----
    A point sees n·u(x) = Σ_i n_i Σ_jk w_j(y) w_k(z) u_i(x, y_j, z_k), with the weights of `interpolation_weights`. The
    box is a sum of waves, and a shift by s along n multiplies a wave by exp(i s k·n), so that a probe volume with the
    weighting φ(s) multiplies it by its transfer H(k·n), `Probe.transfer`:

        v(x) = Σ_k n·c(k) H(k·n) exp(i k·x),

    with the box's own amplitudes c: no integral along the beam is cut short or approximated. As on the way for points,
    a wave of two grid steps is a cosine about the grid's points; its two halves have each their own H. All points of a
    box are in its period: the tails of a probe longer than the box see the same air again.
    """
    points = check_array(focus, (None, 3), what="focus")
    direction = check_array(line_of_sight, (len(points), 3), what="line_of_sight")
    if not isinstance(probe, PointProbe):
        if focus_distance is None:
            raise InputError("Missing focus_distance of beams with a probe volume: give one for each focus point, m.")
        distance = check_array(focus_distance, (len(points),), what="focus_distance")
        return _probed_lines(box, points, direction, probe, distance)
    n_x, n_y, n_z = box.grid.shape
    kind = box.velocity.dtype
    across = interpolation_weights(points[:, 1], n_y, box.grid.spacing[1]).astype(kind)
    height, level = np.unique(np.round(np.remainder(points[:, 2], box.grid.size[2]), 12), return_inverse=True)
    upward = interpolation_weights(height, n_z, box.grid.spacing[2]).astype(kind)
    lines = np.zeros((len(points), n_x))
    for first in range(0, len(height), _LEVELS_AT_ONCE):
        block = upward[first : first + _LEVELS_AT_ONCE]
        for component in range(3):
            planes = (block @ box.velocity[component].reshape(n_x * n_y, n_z).T).reshape(len(block), n_x, n_y)
            for offset, plane in enumerate(planes):
                at_level = np.flatnonzero(level == first + offset)
                lines[at_level] += direction[at_level, component, None] * (across[at_level] @ plane.T)
    return lines


def _probed_lines(
    box: Box, focus: FloatArray, line_of_sight: FloatArray, probe: Probe, distance: FloatArray
) -> FloatArray:
    """Return `beam_lines` for a probe volume: the sum over the box's waves, a part of the k₁ at a time."""
    n_x, n_y, n_z = box.grid.shape
    amplitude, (_, k_2, k_3) = box.amplitude, box.grid.wave_number
    across, upward = _waves_at(focus[:, 1], k_2), _waves_at(focus[:, 2], k_3)
    phase = np.einsum("py,pz->pyz", across.astype(amplitude.dtype), upward.astype(amplitude.dtype))
    j, k = np.arange(-(n_y // 2), n_y // 2 + 1) % n_y, np.arange(-(n_z // 2), n_z // 2 + 1) % n_z
    kinds = np.round(np.column_stack([line_of_sight, probe.length(distance)]), 12)
    _, first, kind = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
    lines_of_kind = [np.flatnonzero(kind.ravel() == number) for number in range(len(first))]
    spectrum = np.empty((len(focus), n_x // 2 + 1), dtype=amplitude.dtype)
    for part in box.grid.parts():
        waves = np.ascontiguousarray(amplitude[:, part, j[:, None], k])
        numbers = waves.view(box.velocity.dtype).reshape(3, -1)  # real and imaginary parts in turn
        for beam, lines in zip(first, lines_of_kind, strict=True):
            seen = (line_of_sight[beam].astype(numbers.dtype) @ numbers).view(amplitude.dtype)
            transfer = box.grid.transfer(part, line_of_sight[beam], probe, float(distance[beam]))
            seen *= transfer.ravel().astype(numbers.dtype)
            spectrum[lines, part] = phase[lines].reshape(len(lines), -1) @ seen.reshape(waves.shape[1], -1).T
    return np.asarray(scipy.fft.irfft(spectrum, n_x, axis=1, norm="forward"), dtype=np.float64)


def _waves_at(place: FloatArray, wave_number: FloatArray) -> NDArray[np.complex128]:
    """Return exp(i k p), shape (n_place, n_k); half of it at both ends, which are one wave, a cosine about the grid."""
    wave = np.exp(1j * np.outer(place, wave_number))
    wave[:, [0, -1]] *= 0.5
    return np.asarray(wave)


def sample_lines(lines: ArrayLike, length: float, start: ArrayLike, step: float, count: int) -> FloatArray:
    """Sample periodic lines at evenly spaced positions, exactly.

    Parameters
    ----------
    lines : array_like, shape (n, n_x)
        Values on a periodic grid along x, n_x even.
    length : float
        Period, m.
    start : array_like, shape (n,)
        Position of the first sample on each line, m.
    step : float
        Distance between samples, m; negative to go towards smaller x.
    count : int
        Number of samples.

    Returns
    -------
    samples : ndarray, shape (n, count)
        Value at start + i · step, i = 0 … count − 1.

    Notes
    -----
    The trigonometric polynomial through the grid's points, v(x) = Re Σ_m c_m exp(2πi m x / length), is evaluated by a
    chirp transform: m i = (m² + i² − (i − m)²) / 2 turns the sum into a convolution, so that no interpolation error
    arises and the cost is that of three Fourier transforms.

    References
    ----------
    Bluestein (1970), IEEE Trans. Audio Electroacoust. 18, 451–455, doi:10.1109/TAU.1970.1162132.

    Examples
    --------
    >>> line = np.cos(2.0 * np.pi * np.arange(8) / 8.0)
    >>> sample_lines([line], 8.0, [0.0], -1.5, 3).round(6)
    array([[ 1.      ,  0.382683, -0.707107]])
    """
    values = check_array(lines, (None, None), what="lines")
    first = check_array(start, (len(values),), what="start")
    n_x = values.shape[1]
    wave = np.arange(n_x // 2 + 1)
    amplitude = scipy.fft.rfft(values, axis=1) / n_x
    amplitude[:, 1 : n_x // 2] *= 2.0
    amplitude = amplitude * np.exp(2j * np.pi * np.outer(first / length, wave))
    index = np.arange(count)
    chirp = np.exp(
        1j * np.pi * np.remainder(step / length * np.arange(max(len(wave), count), dtype=np.float64) ** 2, 2.0)
    )
    padded = int(scipy.fft.next_fast_len(len(wave) + count - 1))
    kernel = np.zeros(padded, dtype=np.complex128)
    kernel[index] = chirp[index].conj()
    kernel[padded - wave[1:]] = chirp[wave[1:]].conj()
    spectrum = scipy.fft.fft(amplitude * chirp[wave], padded, axis=1) * scipy.fft.fft(kernel)
    return np.asarray((scipy.fft.ifft(spectrum, axis=1)[:, :count] * chirp[index]).real)


def sample_records(lines: FloatArray, state: RecordState, grid: BoxGrid) -> FloatArray:
    """Sample the lines of a scan's beams as the wind carries the box past, all records end to end.

    Parameters
    ----------
    lines : ndarray, shape (n_beam, n_x)
        What `beam_lines` returns for the state's focus points.
    state : RecordState
        Scan, mean wind and record length.
    grid : BoxGrid
        The box's grid.

    Returns
    -------
    velocity : ndarray, shape (n_record, n_beam, n_sample)
        Fluctuations of radial velocity n·u(x − U t, y, z), m/s, at t = beam_time + i · scan_duration.

    Notes
    -----
    Frozen turbulence (Taylor): the box moves with the mean wind and does not change.
    """
    n_record = state.records_in(grid)
    start = state.focus[:, 0] - state.wind_speed * state.scan.beam_time
    samples = sample_lines(lines, grid.size[0], start, -state.step, n_record * state.n_sample)
    return np.asarray(np.moveaxis(samples.reshape(len(lines), n_record, state.n_sample), 0, 1))


def placements(grid: BoxGrid, length_scale: float) -> FloatArray:
    """Return where a scan can be put in a box to see nearly independent air.

    Parameters
    ----------
    grid : BoxGrid
        The box's grid.
    length_scale : float
        Length scale of the turbulence L, m.

    Returns
    -------
    shift : ndarray, shape (n, 3)
        Shifts in y and z, m, evenly spaced over the period, at least 4 L apart and at most 3 each way.
    """
    per_axis = [int(np.clip(size / (4.0 * length_scale) + 1e-9, 1, 3)) for size in grid.size[1:]]
    across, upward = (np.arange(count) * size / count for count, size in zip(per_axis, grid.size[1:], strict=True))
    corners = np.stack(np.meshgrid(across, upward, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.concatenate([np.zeros((len(corners), 1)), corners], axis=1)


def grid_for(states: list[RecordState], turbulence: MannTurbulence) -> BoxGrid:
    """Choose the grid of boxes that serve all of these states; see `choose_grid`."""
    longest = max(state.step * state.n_sample for state in states)
    return choose_grid(turbulence, record_length=longest, extent=max(state.extent for state in states))


def simulate(
    scan: Scan | str | Path,
    turbulence: MannTurbulence | str | Path,
    *,
    wind_speed: float,
    duration: float = 600.0,
    n_records: int = 1,
    seed: int | np.random.Generator,
    method: str = "lines",
    shear: float = 0.0,
) -> xr.Dataset:
    """Simulate what a lidar measures: radial velocities of known turbulence.

    Parameters
    ----------
    scan : Scan, str or Path
        The scan, with its own yaw.
    turbulence : MannTurbulence, str or Path
        The turbulence.
    wind_speed : float
        Mean wind speed U, m/s.
    duration : float
        Length of a record, s.
    n_records : int
        Number of records.
    seed : int or numpy.random.Generator
        Same seed, same numbers.
    method : str
        ``"lines"``: the beams' radial velocities, drawn from their covariances in an infinite domain; see `LineMaker`.
        ``"boxes"``: a virtual lidar in frozen, periodic boxes of Mann turbulence, which needs the extra ``boxes``.
    shear : float
        Vertical gradient of the mean wind dU/dz, 1/s; 0.0288 in the study of Fu et al. (2022).

    Returns
    -------
    series : xarray.Dataset
        Dimension ``sample``: ``radial_velocity`` v_r = n·(U + u), m/s, positive away, with the coordinates ``time``
        (UTC, windows of `duration` end to end from 2000-01-01) and ``beam``. The attribute ``truth`` holds, as JSON,
        the turbulence, how it was simulated, ``stresses``, and ``stresses_record``, the expected stresses of a record
        with its own mean removed, m² s⁻².

    Raises
    ------
    InputError
        If a number is not valid, the method is unknown, or the records do not fit into memory.
    NotPositiveDefiniteError
        If the covariances of lines are not those of any process to 10⁻³ of a variance.
    MissingExtraError
        If boxes are asked for and hipersim is not installed.

    Notes
    -----
    The mean wind at height z above the lidar is U + z dU/dz along x; the turbulence is frozen and carried everywhere
    with U, the mean wind at the lidar, as in the study of Fu et al. (2022). So shear changes the means of the
    beams and no variance. Each beam has as many samples as there are whole scans in `duration`. From window to window
    the series is not continuous. No instrument noise.

    Lines: records are independent of each other, and a record is the same however many follow. Boxes: a box provides
    as many records as fit end to end, in two places half a period apart in y and in z, at least 6 L each. Records of
    one box are nearly independent: at the seed's flow, variances of u in neighbouring records are correlated by 0.02,
    in the two places by 0.03; records of different boxes are independent. Beams with a probe volume see it in the boxes
    exactly (`beam_lines`); of the small eddies that it takes, the boxes lack some, so that it takes less.

    References
    ----------
    Fu, Sebastiani, Peña and Mann (2022), J. Phys.: Conf. Ser. 2265, 022016, doi:10.1088/1742-6596/2265/2/022016.

    Examples
    --------
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> flow = MannTurbulence(dissipation=0.05, length_scale=100.0, gamma=3.2)
    >>> series = simulate(load_scan("2-beam"), flow, wind_speed=10.0, duration=60.0, n_records=2, seed=1)
    >>> series.sizes["sample"]
    240
    """
    scan, turbulence = as_scan(scan), as_turbulence(turbulence)
    check_choice(method, tuple(SIMULATORS), what="method of simulation")
    count = check_count(n_records, what="n_records")
    gradient = check_finite(shear, what="shear", unit="1/s")
    state = RecordState(scan, wind_speed, scan.yaw, duration)
    check_size(
        f"{count} records of {scan.n_beam} beams with {state.n_sample} samples each",
        float(count) * scan.n_beam * state.n_sample * _BYTES_A_SAMPLE,
        "simulate fewer records, or shorter ones.",
    )
    fluctuation, truth = SIMULATORS[method](state, turbulence, count, as_generator(seed))
    truth = {**truth, "wind_speed": float(wind_speed), "duration": float(duration), "shear": gradient}
    mean_wind = wind_speed + gradient * state.focus[:, 2]
    velocity = fluctuation + (mean_wind * state.line_of_sight[:, 0])[:, None]
    offset = scan.beam_time[:, None] + scan.scan_duration * np.arange(state.n_sample)
    seconds = duration * np.arange(count)[:, None, None] + offset
    order = np.argsort(seconds, axis=None, kind="stable")
    beam = np.broadcast_to(scan.beam[:, None], seconds.shape)
    nanoseconds = np.round(seconds.ravel()[order] * 1e9).astype(np.int64).astype("timedelta64[ns]")
    return xr.Dataset(
        {
            "radial_velocity": (
                "sample",
                velocity.ravel()[order],
                {"units": "m s-1", "long_name": "radial velocity, positive away from the lidar"},
            )
        },
        coords={
            "time": ("sample", pd.DatetimeIndex(FIRST_RECORD + nanoseconds).values),
            "beam": ("sample", beam.ravel()[order]),
        },
        attrs={"scan": scan.name, "scan_key": scan.key, "truth": json.dumps(truth, sort_keys=True)},
    )


def _simulate_in_boxes(
    state: RecordState, turbulence: MannTurbulence, n_records: int, rng: np.random.Generator
) -> tuple[FloatArray, dict[str, Any]]:
    grid = grid_for([state], turbulence)
    maker = BoxMaker(turbulence, grid)
    shift = np.array([[0.0, 0.0, 0.0], [0.0, 0.5 * grid.size[1], 0.5 * grid.size[2]]])
    focus = np.concatenate([state.focus + one for one in shift])
    direction = np.tile(state.line_of_sight, (len(shift), 1))
    distance = np.tile(state.scan.focus_distance, len(shift))
    n_boxes = -(-n_records // (state.records_in(grid) * len(shift)))
    records: list[FloatArray] = []
    for seed in progress(box_seeds(rng, n_boxes), n_boxes, "boxes"):
        lines = beam_lines(maker.make(seed), focus, direction, probe=state.scan.probe, focus_distance=distance)
        groups = lines.reshape(len(shift), state.scan.n_beam, -1)
        records.extend(record for group in groups for record in sample_records(group, state, grid))
    truth = {
        "method": "boxes",
        "generator": generator_name(),
        "dissipation": turbulence.dissipation,
        "length_scale": turbulence.length_scale,
        "gamma": turbulence.gamma,
        "turbulence": turbulence.name,
        "grid_shape": list(grid.shape),
        "grid_spacing": list(grid.spacing),
        "stresses": pack_stress(maker.tensor).tolist(),
        "probe": state.scan.probe.parameters(),
        "stresses_record": pack_stress(state.record_tensor(maker)).tolist(),
    }
    return np.stack(records[:n_records]), truth


def _simulate_lines(
    state: RecordState, turbulence: MannTurbulence, n_records: int, rng: np.random.Generator
) -> tuple[FloatArray, dict[str, Any]]:
    maker = LineMaker(state.scan, turbulence, wind_speed=state.wind_speed, n_sample=state.n_sample, yaw=state.yaw)
    return maker.make(n_records, rng), maker.truth()


SIMULATORS: dict[str, Callable[..., tuple[FloatArray, dict[str, Any]]]] = {
    "lines": _simulate_lines,
    "boxes": _simulate_in_boxes,
}
"""Ways to simulate records, by name: (state, turbulence, n_records, rng) → velocities (record, beam, sample), truth."""


def box_seeds(rng: np.random.Generator, count: int) -> list[int]:
    """Draw the seeds of boxes; the first ones do not depend on how many are drawn."""
    return [int(rng.integers(0, 2**63)) for _ in range(count)]
