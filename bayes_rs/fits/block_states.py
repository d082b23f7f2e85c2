"""What theory expects of the parts of records: at nodes of wind, direction and length scale, made once each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.errors import InputError
from bayes_rs.geometry.scan import Scan, ScanByKey
from bayes_rs.noise.noise import Noise
from bayes_rs.processor import one_thread
from bayes_rs.records.block_statistics import BLOCKS, blocks_of, chosen_beams, n_part
from bayes_rs.theory.block_theory import BlockTheory, block_theory
from bayes_rs.turbulence.mann import MannTurbulence

STATISTICS = ("part_beams", "part_wind", "part_wind_across", "block_scatter", "block_scatter_of_beams")
"""What records must hold for any of this."""
_SPEED_STEP, _LENGTH_STEP = 0.25, 0.3  # of ln U and ln L
_YAW_STEP = np.deg2rad(30.0)
_SPEEDS, _LENGTHS = (1.0, 50.0), (8.0, 600.0)  # m/s and m: what is beyond gets the theory of these
_MOST_PATTERNS = 8
_LEAST_WEIGHT = 0.02
_WIDEST = 2.5  # standard deviations of ln L that nodes reach to


@dataclass(frozen=True)
class State:
    """A state of the flow and the beams in use: what a theory is made for.

    Parameters
    ----------
    pattern : int
        Bits of the chosen beams in use.
    yaw, speed, length : int
        Number of the node of each.
    """

    pattern: int
    yaw: int
    speed: int
    length: int


@dataclass(frozen=True, eq=False)
class BlockStates:
    """The theory that the records' parts are compared with.

    Parameters
    ----------
    scan : Scan
        The scan of all the records' beams.
    turbulence : MannTurbulence
        Its Γ is that of all states.
    duration : float
        Length of a record, s.
    pattern, yaw, speed : ndarray of int, shape (n_record,)
        The node of each record; a pattern of 0 stands for a record that is not compared.
    weights : dict of int to ndarray, shape (n_record,)
        By node of ln L, its weight for each record.
    """

    scan: Scan
    turbulence: MannTurbulence
    duration: float
    pattern: NDArray[np.int64]
    yaw: NDArray[np.int64]
    speed: NDArray[np.int64]
    weights: dict[int, FloatArray]
    _made: dict[State, BlockTheory] = field(default_factory=dict)

    @property
    def compared(self) -> NDArray[np.bool_]:
        """Which records are compared, shape (n_record,)."""
        return np.asarray(self.pattern > 0)

    def groups(self) -> Iterator[tuple[State, NDArray[np.int64], FloatArray]]:
        """Yield each state with the numbers of its records and the weight that it has for them."""
        keys = np.column_stack([self.pattern, self.yaw, self.speed])
        for key in np.unique(keys[self.compared], axis=0):
            rows = np.flatnonzero(np.all(keys == key, axis=1))
            for length, weight in self.weights.items():
                some = rows[weight[rows] > 0.0]
                if len(some):
                    yield State(int(key[0]), int(key[1]), int(key[2]), length), some, weight[some]

    def theory(self, state: State) -> BlockTheory:
        """Return what theory expects in a state."""
        if state not in self._made:
            self._made[state] = _theory(
                _in_use(ScanByKey.of(self.scan), state.pattern),
                replace(self.turbulence, length_scale=float(np.exp(_LENGTH_STEP * state.length)), name="", source=""),
                float(np.exp(_SPEED_STEP * state.speed)),
                float(_YAW_STEP * state.yaw),
                self.duration,
            )
        return self._made[state]


@lru_cache(maxsize=256)
def _in_use(scan: ScanByKey, pattern: int) -> ScanByKey:
    """Return the scan of those of the chosen beams whose bits are in a pattern."""
    chosen = chosen_beams(scan.scan)
    return ScanByKey.of(
        chosen.select([beam for index, beam in enumerate(chosen.beam.tolist()) if pattern >> index & 1])
    )


@lru_cache(maxsize=1024)
@one_thread()  # what is kept must not depend on who asked for it first
def _theory(scan: ScanByKey, turbulence: MannTurbulence, wind_speed: float, yaw: float, duration: float) -> BlockTheory:
    return block_theory(
        scan.scan,
        turbulence,
        wind_speed=wind_speed,
        yaw=yaw,
        duration=duration,
        n_part=n_part(scan.scan, duration),
        blocks=blocks_of(scan.scan, duration),
    )


def block_states(records: xr.Dataset, scan: Scan, noise: Noise | MannTurbulence) -> BlockStates | None:
    """Return the theory for records; None if they hold no statistics of their parts.

    Parameters
    ----------
    records : Dataset
        From `make_records`; with ``length_scale`` and ``length_scale_log_sd`` where the records have their own.
    scan : Scan
        The scan that measured them.
    noise : Noise or MannTurbulence
        Has Γ, and the length scale of records that have none of their own.

    Returns
    -------
    states : BlockStates or None
        Records are given to the nearest node of ln U and of the direction, and to those of ln L between which theirs
        lies, or over which it spreads; such that L/U is the record's own.

    Raises
    ------
    InputError
        If the records are cut into other parts than those of the scan.
    """
    if any(name not in records for name in STATISTICS):
        return None
    turbulence, duration = (noise.turbulence, noise.duration) if isinstance(noise, Noise) else (noise, 600.0)
    duration = float(records.attrs.get("duration", duration))
    for name, size, expected in (
        ("parts", records.sizes["part"], n_part(scan, duration)),
        ("numbers of blocks", records.sizes["blocks"], len(BLOCKS)),  # those that are not told are empty
    ):
        if size != expected:
            raise InputError(
                f"The records have {size} {name} and those of {duration:g} s of scan {scan.name!r} have {expected}: "
                "make them anew with this scan."
            )
    speed, yaw = (np.asarray(records[name].values, dtype=np.float64) for name in ("wind_speed", "yaw"))
    pattern = np.asarray(records["part_beams"].values, dtype=np.int64).copy()
    of_beams = (pattern > 0) & (pattern < 1 << chosen_beams(scan).n_beam)
    pattern[~(of_beams & np.isfinite(speed) & (speed > 0.0) & np.isfinite(yaw))] = 0
    found, count = np.unique(pattern[pattern > 0], return_counts=True)
    usual = found[np.argsort(count)[::-1][:_MOST_PATTERNS]]
    pattern[~np.isin(pattern, usual)] = 0
    on = pattern > 0
    length_scale = np.median(noise.length_scale) * np.ones(len(speed))
    log_sd = np.zeros(len(speed))
    for name, into in (("length_scale", length_scale), ("length_scale_log_sd", log_sd)):
        if name in records:
            own = np.asarray(records[name].values, dtype=np.float64)
            into[:] = np.where(np.isfinite(own), own, into)
    log_speed = np.log(np.clip(np.where(on, speed, 10.0), *_SPEEDS))
    speed_node = np.rint(log_speed / _SPEED_STEP).astype(np.int64)
    # a record's eddies pass as fast as U/L: the length scale makes up for the wind speed of the node
    log_length = np.log(np.clip(length_scale, *_LENGTHS)) + _SPEED_STEP * speed_node - log_speed
    return BlockStates(
        scan=scan,
        turbulence=replace(turbulence, gamma=float(np.median(noise.gamma))),
        duration=duration,
        pattern=pattern,
        yaw=np.where(on, np.rint(np.deg2rad(np.where(on, yaw, 0.0)) / _YAW_STEP), 0).astype(np.int64),
        speed=speed_node,
        weights=_length_weights(log_length, log_sd),
    )


def _length_weights(log_length: FloatArray, log_sd: FloatArray) -> dict[int, FloatArray]:
    """Return the weights of the nodes of ln L: two beside a known one, those of a normal distribution over others."""
    place, width = log_length / _LENGTH_STEP, log_sd / _LENGTH_STEP
    first, last = (int(np.floor(np.log(end) / _LENGTH_STEP)) for end in _LENGTHS)
    node = np.arange(first - 1, last + 3)
    hat = np.maximum(1.0 - np.abs(place[:, None] - node), 0.0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        off = (node - place[:, None]) / width[:, None]
        spread = np.where(np.abs(off) < _WIDEST, np.exp(-0.5 * off**2), 0.0)
    weight = np.where(width[:, None] > 0.5, spread, hat)
    weight = np.where(weight > _LEAST_WEIGHT * weight.max(axis=1, keepdims=True), weight, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    return {int(node[column]): weight[:, column] for column in np.flatnonzero(weight.any(axis=0))}
