"""A second generator of lidar records: air that the package's own simulators did not make.

It shares the description of a scan with the package (beams, distances, times, weighting of the probe) and no theory:
cross-spectra come from a quadrature of its own, and aliasing at a scan's true sampling times is exact. Beside Mann's
model at any length scale and anisotropy (0: von Kármán's isotropic air) it has Kaimal's spectra with exponential
coherence, air whose strength wanders (intermittency), fronts, trends, a wake in one sector, noise that nobody declares,
a lidar that points elsewhere, and beams that are dead or wrongly numbered.

    series, truth = make_series("6-beam", MannAir(0.05, 61.0, 3.2), n_record=200, wind_speed=10.0, seed=1)
    files, truth = make_files("folder", "6-beam", KaimalAir(), n_record=200, wind_speed=10.0, seed=1)
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.special import hyp2f1

import bayes_rs as brs
from bayes_rs.geometry.scan import Scan

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

FIRST_RECORD = np.datetime64("2024-03-01T00:00:00", "ns")
ORDER = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # uu, vv, ww, uv, uw, vw

_N_RADIUS, _N_ANGLE, _RADIUS_STEP = 72, 48, 0.2
_NODES_PER_DECADE = 20
_COHERENT = 9.0  # k1 times the distance across the wind at which beams are taken to be independent
_LARGEST_COHERENT = 20.0  # rad/m; for beams at one place across the wind
_LARGEST = 2000.0  # rad/m; what is beyond adds to no beam more than 1e-4 of its variance
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Beams:
    """Points that are measured: position (m), unit vector and probe of each, in the mean-wind frame."""

    position: FloatArray
    direction: FloatArray
    probe: tuple[tuple[FloatArray, FloatArray] | None, ...]
    """The transfer function of each probe as a table over |k·n| (rad/m); None for a point."""

    def transfer(self, beam: int, along: FloatArray) -> FloatArray | float:
        """Return by how much a beam's probe shrinks waves of the wave number `along` (rad/m) along it."""
        table = self.probe[beam]
        return 1.0 if table is None else np.interp(np.abs(along), *table)


@dataclass(frozen=True)
class MannAir:
    """Mann's uniform-shear turbulence: αε^(2/3) (m^(4/3) s⁻²), L (m), Γ; Γ = 0 is von Kármán's isotropic air."""

    dissipation: float = 0.05
    length_scale: float = 61.0
    gamma: float = 3.2

    def root(self, k1: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return k2, k3, shape (n,), and w A, shape (n, 3, 3): ∫∫Φ e^(ik·r) dk2 dk3 = Σ w² A Aᵀ e^(i(k2 Δy + k3 Δz)).

        Rings of radii in a geometric series, each turned against the last by the golden angle so that the oscillations
        of e^(ik·r) at large radii average out.
        """
        across = np.sqrt(k1 * k1 + self.length_scale**-2.0)
        radius = across * np.exp(_RADIUS_STEP * (np.arange(_N_RADIUS) - 0.52 * _N_RADIUS))
        angle = 2.0 * np.pi * (np.arange(_N_ANGLE) + (_GOLDEN * np.arange(_N_RADIUS)[:, None] % 1.0)) / _N_ANGLE
        weight = np.repeat(radius**2 * _RADIUS_STEP * 2.0 * np.pi / _N_ANGLE, _N_ANGLE)
        k2, k3 = (radius[:, None] * np.cos(angle)).ravel(), (radius[:, None] * np.sin(angle)).ravel()
        return k2, k3, np.sqrt(weight)[:, None, None] * self.amplitude(k1, k2, k3)

    def amplitude(self, k1: float, k2: FloatArray, k3: FloatArray) -> FloatArray:
        """Return a matrix A with Φ(k) = A Aᵀ, shape (n, 3, 3), m^(5/2) s⁻¹: Mann (1998), Eq. (A1), here for k1 > 0."""
        length = self.length_scale
        k = np.sqrt(k1 * k1 + k2 * k2 + k3 * k3)
        lifetime = self.gamma * (k * length) ** (-2.0 / 3.0)
        beta = lifetime / np.sqrt(hyp2f1(1.0 / 3.0, 17.0 / 6.0, 4.0 / 3.0, -((k * length) ** -2.0)))
        k30 = k3 + beta * k1
        k0 = np.sqrt(k1 * k1 + k2 * k2 + k30 * k30)
        flat = k1 * k1 + k2 * k2
        c1 = beta * k1**2 * (k0**2 - 2.0 * k30**2 + beta * k1 * k30) / (k**2 * flat)
        turned = np.arctan2(beta * k1 * np.sqrt(flat), k0**2 - k30 * k1 * beta)
        c2 = k2 * k0**2 / flat**1.5 * turned
        zero, one = np.zeros_like(k2), np.ones_like(k2)
        distorted = np.array(
            [
                [one, zero, c1 - k2 / k1 * c2],
                [zero, one, k2 / k1 * c1 + c2],
                [zero, zero, k0**2 / k**2],
            ]
        )
        turn = np.array([[zero, k30, -k2], [-k30, zero, k1 * one], [k2, -k1 * one, zero]])
        energy = self.dissipation * length ** (5.0 / 3.0) * (k0 * length) ** 4 / (1.0 + (k0 * length) ** 2) ** (17 / 6)
        return np.einsum("ijn,jln->nil", distorted, turn * np.sqrt(energy / (4.0 * np.pi)) / k0**2)

    def matrix(self, k1: float, beams: Beams) -> ComplexArray:
        """Return F_ab(k1), m³ s⁻², two-sided: the beams' cross-spectra without the phase of their distance along x."""
        k2, k3, root = self.root(k1)
        rows = []
        for beam, (place, n) in enumerate(zip(beams.position, beams.direction, strict=True)):
            shrunk = beams.transfer(beam, k1 * n[0] + k2 * n[1] + k3 * n[2])
            wave = shrunk * np.exp(1j * (k2 * place[1] + k3 * place[2]))
            rows.append((wave[:, None] * np.einsum("i,nij->nj", n, root)).ravel())
        factor = np.array(rows)
        return factor @ factor.conj().T

    def scale(self, k1: FloatArray) -> FloatArray:
        """Return what spectra roughly follow, so that little is left to interpolate."""
        return np.asarray((1.0 + (k1 * self.length_scale) ** 2) ** (-5.0 / 6.0))

    def smallest(self) -> float:
        """Return the wave number below which the spectra are taken to be flat, rad/m."""
        return 0.003 / self.length_scale

    def stresses(self) -> FloatArray:
        """Return R, shape (6,): in closed form for Γ = 0, by quadrature over k1 otherwise."""
        if self.gamma == 0.0:
            variance = 0.6883439 * self.dissipation * self.length_scale ** (2.0 / 3.0)
            return variance * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        return _integrate(self, np.inf)


@dataclass(frozen=True)
class OtherCoherence(MannAir):
    """Air whose eddies reach otherwise than Mann's: v and w of a third of the length, vv doubled in large eddies, or
    large horizontal eddies beside.

    Parameters
    ----------
    across : float
        Length scale of v and w over that of u.
    slow_v : float
        By how much large eddies (k₁L well below 1) have more vv; falls as 1/(1 + (2 k₁L)⁴).
    flat : (float, float)
        Variance of u, and of v, m² s⁻², and length scale, m, of two-dimensional eddies, the same at all heights:
        E(κ) = 4 σ² κ³ L⁴/(1 + (κL)²)³.
    """

    across: float = 1.0
    slow_v: float = 0.0
    flat: tuple[float, float] = (0.0, 500.0)

    def root(self, k1: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return nodes and roots; see `MannAir.root`."""
        k2, k3, found = super().root(k1)
        if self.across != 1.0:
            weight = found / np.where(whole := self.amplitude(k1, k2, k3), whole, 1.0)
            weight = np.max(np.abs(weight), axis=(1, 2), keepdims=True)
            shorter = MannAir(self.dissipation, self.across * self.length_scale, self.gamma)
            found[:, 1:] = (weight * shorter.amplitude(k1, k2, k3))[:, 1:]
        found[:, 1] *= np.sqrt(1.0 + self.slow_v / (1.0 + (2.0 * k1 * self.length_scale) ** 4))
        variance, length = self.flat
        if variance == 0.0:
            return k2, k3, found
        side = np.sqrt(k1 * k1 + length**-2.0) * np.geomspace(1e-3, 1e3, 400)
        along = np.concatenate([-side[::-1], side])
        width = np.gradient(along)
        size = np.hypot(k1, along)
        energy = 4.0 * variance * size**3 * length**4 / (1.0 + (size * length) ** 2) ** 3
        level = np.sqrt(energy / (np.pi * size) * width) / size
        more = np.zeros((len(along), 3, 3))
        more[:, 0, 0], more[:, 1, 0] = -along * level, k1 * level
        return np.concatenate([k2, along]), np.concatenate([k3, np.zeros(len(along))]), np.concatenate([found, more])

    def smallest(self) -> float:
        """Return the wave number below which the spectra are taken to be flat, rad/m."""
        return 0.003 / max(self.length_scale, self.flat[1] if self.flat[0] else 0.0)


@dataclass(frozen=True)
class KaimalAir:
    """Kaimal's spectra of u, v, w with exponential coherence across the wind (IEC 61400-1, Annex C), and a uw.

    One-sided f S/σ² = 4n/(1 + 6n)^(5/3), n = f Λ/U; coherence exp(−decay √((fΔ/U)² + (0.12 Δ/coherence_length)²)), the
    same for all components; cospectrum of u and w as Kaimal's, f C = uw · 13.44 n/(1 + 9.6 n)^2.4, n = f cospectrum/U.
    A probe is taken along x: it sees the beams' own air along them, and nothing is lost across the wind.
    """

    sigma: tuple[float, float, float] = (1.5, 1.2, 0.75)
    length: tuple[float, float, float] = (340.2, 113.4, 27.72)
    uw: float = -0.4
    cospectrum: float = 60.0
    decay: float = 12.0
    coherence_length: float = 340.2

    def one_point(self, k1: float) -> FloatArray:
        """Return the two-sided spectra of the components, shape (3, 3), m³ s⁻²."""
        frequency = k1 / (2.0 * np.pi)  # at U = 1 m/s
        length = np.array(self.length)
        auto = np.array(self.sigma) ** 2 * 2.0 * length / (1.0 + 6.0 * frequency * length) ** (5.0 / 3.0)
        spectra = np.diag(auto)
        cross = 0.5 * self.uw * 13.44 * self.cospectrum / (1.0 + 9.6 * frequency * self.cospectrum) ** 2.4
        spectra[0, 2] = spectra[2, 0] = cross
        if cross**2 >= auto[0] * auto[2]:
            raise ValueError(f"Invalid uw {self.uw:g}: at k1 = {k1:g} rad/m its cospectrum is above √(S_u S_w).")
        return spectra / (2.0 * np.pi)

    def matrix(self, k1: float, beams: Beams) -> ComplexArray:
        """Return F_ab(k1); see `MannAir.matrix`."""
        n = beams.direction
        away = np.linalg.norm(beams.position[:, None, 1:] - beams.position[None, :, 1:], axis=-1)
        rate = np.sqrt((k1 / (2.0 * np.pi)) ** 2 + (0.12 / self.coherence_length) ** 2)
        shrunk = np.array([float(beams.transfer(b, np.asarray(k1 * n[b, 0]))) for b in range(len(n))])
        spectra = n @ self.one_point(k1) @ n.T * np.exp(-self.decay * rate * away)
        return np.asarray(spectra * np.outer(shrunk, shrunk), dtype=np.complex128)

    def scale(self, k1: FloatArray) -> FloatArray:
        """Return what spectra roughly follow."""
        return np.asarray((1.0 + 0.95 * k1 * float(np.min(self.length))) ** (-5.0 / 3.0))

    def smallest(self) -> float:
        """Return the wave number below which the spectra are taken to be flat, rad/m."""
        return 0.003 / max(self.length)

    def stresses(self) -> FloatArray:
        """Return R, shape (6,), in closed form."""
        return np.array([*np.square(self.sigma), 0.0, self.uw, 0.0])


Air = MannAir | KaimalAir


def make_series(
    scan: str | Scan,
    air: Air,
    *,
    n_record: int,
    wind_speed: ArrayLike,
    seed: int,
    duration: float = 600.0,
    size: ArrayLike = 1.0,
    spread: float = 0.0,
    modulation: tuple[float, float] | None = None,
    front: float = 0.0,
    trend: float = 0.0,
    changed_every: int = 1,
    noise: float = 0.0,
    wake: tuple[float, float, float] | None = None,
    dead: Sequence[int] = (),
    swapped: Sequence[tuple[int, int]] = (),
    tilt_deg: float = 0.0,
    yaw_deg: float = 0.0,
) -> tuple[xr.Dataset, dict[str, Any]]:
    """Make radial velocities of independent records, as `bayes_rs.read` would give them, and the truth about them.

    Parameters
    ----------
    scan : str or Scan
        The scan; beams are sampled at its times.
    air : MannAir or KaimalAir
        The turbulence, in frozen transport.
    n_record : int
        Number of records, each of a realization of its own, at least twice as long and cut.
    wind_speed : array_like, shape () or (n_record,)
        Mean wind speeds, m/s; each different one costs some time, so round them.
    seed : int
        Seed.
    duration : float
        Length of a record, s.
    size : array_like, shape () or (n_record,)
        Factor of R in each record, such as (U/10)² for one turbulence intensity.
    spread : float
        Standard deviation of ln R from record to record; their mean is that of the air.
    modulation : (float, float), optional
        Depth s and time scale (s) of exp(s g − s²), which all beams share, with g an Ornstein–Uhlenbeck process: R
        stays, the kurtosis is 3 exp(4 s²).
    front : float
        A step of the wind, m/s, smoothed over 10 s, of either sign, at any time in the middle 80 % of every record.
    trend : float
        A linear change of the wind over each record, m/s, of either sign.
    changed_every : int
        Front and trend are in every record (1), every second one (2), and so on.
    noise : float
        Standard deviation of white noise in every velocity, m/s.
    wake : (float, float, float), optional
        From and to which angle on the y–z plane (degrees from y, towards z) beams see a wake, and the share by which it
        enlarges their variance.
    dead : sequence of int
        Numbers of beams that see a window or a wall: 0 m/s and 0.05 m/s of noise.
    swapped : sequence of (int, int)
        Pairs of beams whose numbers are exchanged.
    tilt_deg, yaw_deg : float
        By how much the lidar's true tilt and yaw are above those of the scan, degrees.

    Returns
    -------
    series : Dataset
        Radial velocities, m/s, positive away.
    truth : dict
        ``stresses`` (6,): R of the ensemble; ``stresses_record`` (n_record, 6): what a sonic measures in such a record
        on average, its mean removed (target ``record``), without front, trend, wake and noise; ``stresses_sonic``
        (n_record, 6): what one at the lidar's place would have measured in each; ``wind_speed`` (n_record,), and all
        arguments.
    """
    of = brs.load_scan(scan) if isinstance(scan, str) else scan
    rng = np.random.default_rng(seed)
    speeds = np.broadcast_to(np.asarray(wind_speed, dtype=np.float64), (n_record,))
    seen = _beams(of, tilt_deg, yaw_deg)
    step = of.scan_duration
    time = np.concatenate([of.beam_time, np.zeros(3)])
    n_sample = int(np.ceil(duration / step - 1e-9))
    n_long = 2 * int(np.ceil(_period_ratio(air, speeds, duration) * n_sample / 2))
    nodes, matrices = _tabulate(air, seen)

    velocity = np.empty((n_record, len(time), n_sample))
    for speed in np.unique(speeds):
        chosen = np.flatnonzero(speeds == speed)
        factor = _factor(air, nodes, matrices, seen, time, step=step, n_long=n_long, speed=float(speed))
        for first in range(0, len(chosen), 16):
            part = chosen[first : first + 16]
            velocity[part] = _draw(factor, len(part), n_long, rng)[:, :, :n_sample]
    strength = np.exp(spread * rng.standard_normal(n_record) - 0.5 * spread**2)
    strength = strength * np.broadcast_to(np.asarray(size, dtype=np.float64), (n_record,))
    velocity *= np.sqrt(strength)[:, None, None]
    when = time[:, None] + step * np.arange(n_sample)
    if modulation is not None:
        velocity *= _modulation(when, n_record, *modulation, rng)
    sonic = velocity[:, -3:]
    sonic = sonic - sonic.mean(axis=-1, keepdims=True)
    products = np.einsum("rit,rjt->rij", sonic, sonic) / n_sample

    velocity, when, n = velocity[:, :-3], when[:-3], seen.direction[:-3]
    if wake is not None:
        velocity[:, _in_sector(n, wake[0], wake[1])] *= np.sqrt(1.0 + wake[2])
    wind = np.broadcast_to(speeds[:, None, None], (n_record, *when.shape)).copy()
    changed = np.arange(n_record) % changed_every == 0
    sign = (rng.choice([-1.0, 1.0], n_record) * changed)[:, None, None]
    late = when[None] - seen.position[:-3, None, 0] / speeds[:, None, None]  # what is upwind changes earlier
    if front:
        moment = duration * rng.uniform(0.1, 0.9, n_record)[:, None, None]
        wind += front * sign * np.clip((late - moment) / 10.0 + 0.5, 0.0, 1.0)
    if trend:
        wind += trend * sign * (late / duration - 0.5)
    velocity = velocity + n[:, 0][:, None] * wind + noise * rng.standard_normal(velocity.shape)
    for number in dead:
        index = int(np.flatnonzero(of.beam == number)[0])
        velocity[:, index] = 0.05 * rng.standard_normal((n_record, n_sample))
    numbers = of.beam.copy()
    for one, other in swapped:
        first, second = int(np.flatnonzero(of.beam == one)[0]), int(np.flatnonzero(of.beam == other)[0])
        numbers[[first, second]] = numbers[[second, first]]

    truth: dict[str, Any] = {
        "air": repr(air),
        "stresses": air.stresses(),
        "stresses_record": strength[:, None] * _record_stresses(air, speeds, duration, modulation),
        "stresses_sonic": np.stack([products[:, i, j] for i, j in ORDER], axis=-1),
        "wind_speed": speeds.copy(),
        "modulation": modulation,
        "front": front,
        "trend": trend,
        "changed_every": changed_every,
        "noise": noise,
        "wake": wake,
        "dead": list(dead),
        "swapped": list(swapped),
        "tilt_deg": tilt_deg,
        "yaw_deg": yaw_deg,
        "spread": spread,
        "duration": duration,
    }
    return _dataset(of, velocity, when, numbers, duration), truth


def make_files(
    folder: str | Path, scan: str | Scan, air: Air, *, kind: str = "netcdf", **options: Any
) -> tuple[list[Path], dict[str, Any]]:
    """Write what `make_series` makes as files of a day that ``bayes-rs fit FILES --scan NAME`` reads.

    Parameters
    ----------
    folder : str or Path
        Where to; made if it is not there.
    scan, air, **options
        See `make_series`.
    kind : str
        ``"netcdf"``, or ``"csv"`` in the columns, sign and status of the scan's own files.

    Returns
    -------
    files : list of Path
        The files, in the order of time.
    truth : dict
        See `make_series`.
    """
    of = brs.load_scan(scan) if isinstance(scan, str) else scan
    series, truth = make_series(of, air, **options)
    Path(folder).mkdir(parents=True, exist_ok=True)
    day = series["time"].values.astype("datetime64[D]")
    files = []
    for index, one in enumerate(np.unique(day)):
        part = series.isel(sample=np.flatnonzero(day == one))
        name = f"{index:03d}-{one}"
        if kind == "netcdf":
            files.append(Path(folder) / f"{name}.nc")
            part["radial_velocity"].encoding = {"dtype": "float32"}
            part["time"].encoding = {"units": "nanoseconds since 2024-03-01", "dtype": "int64"}
            part.to_netcdf(files[-1], engine="h5netcdf")
        else:
            files.append(Path(folder) / f"{name}.csv")
            _as_table(part, of).to_csv(files[-1], index=False, float_format="%.4f")
    return files, truth


def _as_table(series: xr.Dataset, scan: Scan) -> pd.DataFrame:
    columns = {name: name for name in ("time", "beam", "radial_velocity")} | dict(scan.file_format.get("columns", {}))
    sign = -1.0 if scan.file_format.get("positive") == "towards" else 1.0
    table = {
        columns["time"]: pd.DatetimeIndex(series["time"].values).strftime("%Y-%m-%dT%H:%M:%S.%f"),
        columns["beam"]: series["beam"].values,
        columns["radial_velocity"]: sign * series["radial_velocity"].values,
    }
    if "status_valid" in scan.file_format and "status" in columns:
        table[columns["status"]] = np.full(series.sizes["sample"], int(scan.file_format["status_valid"]))
    return pd.DataFrame(table)


def _dataset(
    scan: Scan, velocity: FloatArray, when: FloatArray, numbers: NDArray[np.int64], duration: float
) -> xr.Dataset:
    inside = when < duration - 1e-9
    order = np.argsort(when[inside], kind="stable")
    n_record, per_record = len(velocity), int(inside.sum())
    start = FIRST_RECORD + (np.round(duration * 1e9) * np.arange(n_record)).astype("timedelta64[ns]")
    offset = np.round(when[inside][order] * 1e9).astype("timedelta64[ns]")
    beam = np.broadcast_to(numbers[:, None], when.shape)[inside][order]
    return xr.Dataset(
        {
            "radial_velocity": (
                "sample",
                velocity[:, inside][:, order].ravel(),
                {"units": "m s-1", "positive": "away", "long_name": "radial velocity, positive away from the lidar"},
            )
        },
        coords={
            "time": ("sample", (start[:, None] + offset).ravel()),
            "beam": ("sample", np.broadcast_to(beam, (n_record, per_record)).ravel()),
        },
        attrs={"scan": scan.name, "scan_key": scan.key, "source_files": json.dumps(["second generator"])},
    )


def _beams(scan: Scan, tilt_deg: float, yaw_deg: float) -> Beams:
    """Return a scan's beams in the mean-wind frame, and after them u, v, w at the lidar."""
    tilt, yaw = scan.tilt + np.deg2rad(tilt_deg), scan.yaw + np.deg2rad(yaw_deg)
    raise_beams = [[np.cos(tilt), 0.0, -np.sin(tilt)], [0.0, 1.0, 0.0], [np.sin(tilt), 0.0, np.cos(tilt)]]
    turn = [[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    n = scan.beam_direction @ np.array(raise_beams) @ np.array(turn)
    tables: dict[float, tuple[FloatArray, FloatArray] | None] = {}
    for distance in np.unique(scan.focus_distance):
        tables[float(distance)] = _transfer_table(scan, float(distance))
    return Beams(
        position=np.concatenate([scan.focus_distance[:, None] * n, np.zeros((3, 3))]),
        direction=np.concatenate([n, np.eye(3)]),
        probe=(*(tables[float(distance)] for distance in scan.focus_distance), None, None, None),
    )


def _transfer_table(scan: Scan, distance: float) -> tuple[FloatArray, FloatArray] | None:
    """Return the cosine transform of the weighting along a beam, over the wave number along it."""
    length = float(scan.probe.length(distance))
    if length == 0.0:
        return None
    wave = np.concatenate([[0.0], np.geomspace(1e-3, 60.0, 700)]) / length
    if scan.probe.kind == "continuous-wave":
        return wave, np.exp(-wave * length)  # the transform of a Lorentzian; sums over its tails converge slowly
    s = length * np.linspace(-8.0, 8.0, 4001)
    weight = np.asarray(scan.probe.weighting(s, distance))
    return wave, (np.cos(wave[:, None] * s) @ weight) / weight.sum()


def _in_sector(n: FloatArray, low: float, high: float) -> NDArray[np.bool_]:
    angle = np.rad2deg(np.arctan2(n[:, 2], n[:, 1]))
    return np.asarray(np.mod(angle - low, 360.0) <= np.mod(high - low, 360.0))


def _period_ratio(air: Air, speeds: FloatArray, duration: float) -> float:
    """Return how many records a realization is long: at least 2, and 250 times the largest eddies."""
    largest = air.length_scale if isinstance(air, MannAir) else max(air.length) / 5.0
    return max(2.0, 1.0 + 250.0 * largest / float(np.min(speeds)) / duration)


def _tabulate(air: Air, beams: Beams) -> tuple[FloatArray, ComplexArray]:
    """Return wave numbers (rad/m) and F/scale at them: whole matrices where beams are coherent, diagonals beyond."""
    low, high = air.smallest(), _LARGEST
    nodes = np.geomspace(low, high, int(np.ceil(_NODES_PER_DECADE * np.log10(high / low))))
    matrices = np.array([air.matrix(float(k1), beams) / air.scale(np.asarray(k1)) for k1 in nodes])
    return nodes, matrices


def _interpolate(nodes: FloatArray, table: Any, at: FloatArray) -> Any:
    """Interpolate between neighbours over ln k1: a mean of matrices that are positive is positive."""
    place = np.clip(np.interp(np.log(np.maximum(at, nodes[0])), np.log(nodes), np.arange(len(nodes))), 0, None)
    below = np.minimum(place.astype(int), len(nodes) - 2)
    share = (place - below).reshape(-1, *(1,) * (table.ndim - 1))
    return (1.0 - share) * table[below] + share * table[below + 1]


def _factor(
    air: Air,
    nodes: FloatArray,
    matrices: ComplexArray,
    beams: Beams,
    time: FloatArray,
    *,
    step: float,
    n_long: int,
    speed: float,
) -> ComplexArray:
    """Return roots of the spectral matrices of the sampled beams at frequencies j/(n step), with all that is aliased.

    S_ab(f) = Σ_m (2π/U) F_ab(k1) exp(i k1 (U (t_a − t_b) − (x_a − x_b))), k1 = 2π (f + m/step)/U, over all m.
    """
    frequency = np.arange(n_long // 2 + 1) / (n_long * step)
    fold = 2.0 * np.pi / (speed * step)
    late = speed * time - beams.position[:, 0]
    n_fold = int(np.ceil(_coherent_up_to(beams) / fold)) + 1
    rest = _beyond(nodes, np.real(np.einsum("kbb->kb", matrices)) * air.scale(nodes)[:, None], (n_fold + 0.5) * fold)
    roots = []
    for some in np.array_split(frequency, -(-len(frequency) // 400)):
        total = np.tile(np.diag(2.0 * rest / fold).astype(np.complex128), (len(some), 1, 1))
        for m in range(-n_fold, n_fold + 1):
            k1 = 2.0 * np.pi * some / speed + m * fold
            size = np.abs(k1)
            part = _interpolate(nodes, matrices, size) * air.scale(size)[:, None, None]
            part = np.where((k1 > 0.0)[:, None, None], part.conj(), part)
            phase = np.exp(1j * k1[:, None] * late)
            total += phase[:, :, None] * part * phase.conj()[:, None, :]
        total *= 2.0 * np.pi / speed / (n_long * step)
        real = (some == 0.0) | (some == frequency[-1])
        total[real] = total[real].real
        values, vectors = np.linalg.eigh(total)
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])
    return np.concatenate(roots)


def _coherent_up_to(beams: Beams) -> float:
    """Return k1 (rad/m) above which all beams are independent; the last three, at the lidar, count as one place."""
    apart = np.linalg.norm(beams.position[:, None, 1:] - beams.position[None, :, 1:], axis=-1)[:-2, :-2]
    nearest = float(np.min(apart[~np.eye(len(apart), dtype=bool)]))
    return min(_COHERENT / max(nearest, 1e-9), _LARGEST_COHERENT)


def _beyond(nodes: FloatArray, auto: FloatArray, start: float) -> FloatArray:
    """Return the integrals of spectra (n_node, n_beam) over k1 from `start` on, shape (n_beam,)."""
    above = np.concatenate([[start], nodes[nodes > start]])
    values = _interpolate(nodes, auto * nodes[:, None], above)
    return np.asarray(np.sum(0.5 * np.diff(np.log(above))[:, None] * (values[1:] + values[:-1]), axis=0))


def _draw(factor: ComplexArray, n_record: int, n_long: int, rng: np.random.Generator) -> FloatArray:
    n_frequency, n_beam, _ = factor.shape
    white = rng.standard_normal((n_record, 2, n_frequency, n_beam))
    draw = (white[:, 0] + 1j * white[:, 1]) * np.sqrt(0.5)
    draw[:, [0, -1]] = white[:, 0][:, [0, -1]]  # real there
    waves = np.einsum("fab,rfb->raf", factor, draw, optimize=True)
    return np.asarray(np.fft.irfft(waves, n=n_long, axis=-1) * n_long)


def _modulation(
    when: FloatArray, n_record: int, depth: float, time_scale: float, rng: np.random.Generator
) -> FloatArray:
    """Return exp(s g − s²) at the times of all samples, shape (n_record, n_beam, n_sample)."""
    moments, back = np.unique(when, return_inverse=True)
    decay = np.exp(-np.diff(moments) / time_scale)
    g = np.empty((n_record, len(moments)))
    g[:, 0] = rng.standard_normal(n_record)
    shocks = rng.standard_normal((len(decay), n_record))
    for index, keep in enumerate(decay):
        g[:, index + 1] = keep * g[:, index] + np.sqrt(1.0 - keep**2) * shocks[index]
    return np.exp(depth * g - depth**2)[:, back.reshape(when.shape)]


def _record_stresses(
    air: Air, speeds: FloatArray, duration: float, modulation: tuple[float, float] | None
) -> FloatArray:
    """Return R less the variance of a record's mean, shape (n_record, 6)."""
    found = np.empty((len(speeds), 6))
    for speed in np.unique(speeds):
        found[speeds == speed] = _integrate(air, duration * float(speed), modulation, float(speed))
    return found


@lru_cache(maxsize=8)
def _at_lidar(air: Air) -> tuple[FloatArray, FloatArray]:
    """Return wave numbers and the one-point spectra there, shape (n, 6), m³ s⁻²."""
    sonic = Beams(np.zeros((3, 3)), np.eye(3), (None, None, None))
    nodes = air.smallest() * np.geomspace(1e-3, 3e6, 200)
    spectra = np.array([air.matrix(float(max(k1, air.smallest())), sonic).real for k1 in nodes])
    return nodes, np.stack([spectra[:, i, j] for i, j in ORDER], axis=-1)


def _integrate(
    air: Air, travelled: float, modulation: tuple[float, float] | None = None, speed: float = 1.0
) -> FloatArray:
    """Return R, or with `travelled` = U T (m) what is left of it when the mean over that length is taken out."""
    nodes, spectra = _at_lidar(air)
    step = np.log(nodes[1] / nodes[0])

    def total(of: FloatArray) -> FloatArray:
        return np.asarray(2.0 * step * np.sum(of * nodes[:, None], axis=0))

    closed = air.stresses() if isinstance(air, KaimalAir) or air.gamma == 0.0 else None
    whole = total(spectra) if closed is None else closed
    if closed is None:
        whole += 2.0 * np.array([1.5, 1.5, 1.5, 0.0, 0.0, 0.0]) * spectra[-1] * nodes[-1]  # k^(-5/3) beyond the last
    if not np.isfinite(travelled):
        return whole
    lag = (np.arange(1500) + 0.5) * travelled / 1500  # the variance of a mean is 2/T ∫(1 − τ/T) C(τ) dτ
    covariance = np.empty((len(lag), 6))
    fine = np.geomspace(nodes[0], 20.0 / (lag[1] - lag[0]), 3000)
    values = np.stack([np.interp(np.log(fine), np.log(nodes), spectra[:, c]) for c in range(6)], axis=-1)
    weight = np.gradient(fine)
    for first in range(0, len(lag), 500):
        part = lag[first : first + 500]
        covariance[first : first + 500] = 2.0 * np.cos(part[:, None] * fine) @ (weight[:, None] * values)
    share = np.ones_like(lag)
    if modulation is not None:
        depth, time_scale = modulation
        share = np.exp(depth**2 * (np.exp(-lag / speed / time_scale) - 1.0))
    of_mean = 2.0 / len(lag) * ((1.0 - lag / travelled) * share) @ covariance
    return np.asarray(whole - of_mean)
