"""What a check of beams found, in words: which beams, how far off, how often."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_rs.alarms.beam_check import CAMPAIGN_LEVEL, BeamCheck, Evidence

DEAD = 0.1
"""A beam with less than this of the variance that the others explain looks dead."""
_SHARP_TILT = 2.5
_LEAST_TILT = 1.0
_NEAR_ONE = 0.3
"""A scatter whose logarithm is nearer to 0 than this, or whose interval holds 1, is not worth a line."""
_HALF = 0.5
_MANY, _BY_CHANCE = 50, 0.02
"""Of so many records, this share may be flagged by chance, which is worth no line."""
_NEARLY_ALL = 0.9


def beam_words(beams: Sequence[int], sector: tuple[float, float]) -> str:
    """Name beams by their numbers, and neighbours around a cone by their sector, too.

    Examples
    --------
    >>> beam_words([3], (45.0, 45.0))
    'beam 3'
    >>> beam_words([12, 13, 14], (86.4, 100.8))
    'beams 12 to 14 (sector 86° to 101°)'
    """
    if len(beams) == 1:
        return f"beam {beams[0]}"
    steps = np.diff(beams)
    runs = f"{beams[0]} to {beams[-1]}" if len(beams) > 2 and np.all(steps == 1) else _listed(beams)
    return f"beams {runs} (sector {sector[0]:.0f}° to {sector[1]:.0f}°)"


def _listed(beams: Sequence[int]) -> str:
    return f"{', '.join(map(str, beams[:-1]))} and {beams[-1]}"


def shift_words(kind: str, beams: Sequence[int], sector: tuple[float, float], shift: float) -> str:
    """Say by how much beams are off: `shift` is of ln variance, or of the mean over the wind speed."""
    name, verb = beam_words(beams, sector), "has" if len(beams) == 1 else "have"
    if kind == "mean":
        return f"{name} {verb} a mean velocity that is {abs(100.0 * shift):.0f} % of the wind off what the others say"
    factor = float(np.exp(shift))
    if factor < DEAD and len(beams) == 1:
        return f"{name} looks dead: {100.0 * factor:.2g} % of the variance that the others explain"
    if factor < 1.0:
        return f"{name} {verb} {100.0 * (1.0 - factor):.0f} % less variance than the others explain"
    if factor < 2.0:
        return f"{name} {verb} {100.0 * (factor - 1.0):.0f} % more variance than the others explain"
    return f"{name} {verb} {factor:.2g} times the variance that the others explain"


class CheckWords:
    """What a check says about each record, and about all.

    Parameters
    ----------
    check : BeamCheck
        The check.
    beam : ndarray of int, shape (n_beam,)
        Numbers of the beams that were looked at.
    length_scale : float
        Length scale that the noise was made for, m.
    """

    def __init__(self, check: BeamCheck, beam: NDArray[np.int64], length_scale: float) -> None:
        self.check, self.beam, self.length_scale = check, beam, length_scale

    def _members(self, pattern: int) -> tuple[list[int], tuple[float, float]]:
        return self.beam[self.check.patterns.members(pattern)].tolist(), self.check.patterns.sector[pattern]

    def of_record(self, index: int) -> str:
        """Name the fault of one record; empty if its beams agree."""
        check = self.check
        if not check.disagree[index]:
            return ""
        best = max(abs(one.score[index]) / np.sqrt(one.excess) for one in check.kinds.values())
        first, second, fall = check.exchange[index]
        if check.exchanged[index] and fall > _HALF * best**2 and fall > best**2 - check.exchange_limit:
            return self._exchange(int(first), int(second))
        kind, found = self.worst(index)
        if found.p_pattern[index] * len(check.kinds) * 2.0 > check.level:
            return "the beams disagree in no simple pattern"
        return shift_words(kind, *self._members(int(found.pattern[index])), float(found.shift[index]))

    def worst(self, index: int) -> tuple[str, Evidence]:
        """Return the kind of data with the larger score; variances where both are far off: they say more."""
        kinds = self.check.kinds
        kind = max(kinds, key=lambda name: abs(kinds[name].score[index]) / np.sqrt(kinds[name].excess))
        variance = kinds["variance"]
        same = "mean" in kinds and variance.pattern[index] == kinds["mean"].pattern[index]
        if same and variance.p_pattern[index] < self.check.level / 4.0:
            kind = "variance"
        return kind, kinds[kind]

    def _exchange(self, first: int, second: int) -> str:
        low, high = sorted((int(self.beam[first]), int(self.beam[second])))
        return f"beams {low} and {high} look exchanged"

    @property
    def records(self) -> NDArray[np.object_]:
        """What is wrong with each record, shape (n_record,); empty where nothing is."""
        words = np.full(len(self.check.misfit), "", dtype=object)
        for index in np.flatnonzero(self.check.disagree).tolist():
            words[index] = self.of_record(index)
        return words

    def of_all(self) -> tuple[list[str], list[str]]:
        """Say what all records together show, and what those that were flagged have most often, each in lines."""
        often, key, share = self._most_often()
        lines = self._exchange_of_all() or [
            self._level(kind, found, key if share < _NEARLY_ALL else "") for kind, found in self.check.kinds.items()
        ]
        return [*(line for line in lines if line), *self._tilt(), *self._scatter()], often

    def _exchange_of_all(self) -> list[str]:
        """Name two beams that all records together want exchanged."""
        check = self.check
        first, second, fall = check.exchange_together
        together = [found.together.score for found in check.kinds.values() if found.together is not None]
        best = max((float(np.max(score**2)) for score in together), default=0.0)
        if fall <= check.exchange_limit or fall <= max(_HALF * best, best - check.exchange_limit):
            return []
        return [f"all records together: {self._exchange(first, second)}"]

    def _level(self, kind: str, found: Evidence, known: str) -> str:
        """Name the beams that all records together find at fault, unless it is what some of the records say already."""
        if found.together is None or not found.p_together() < CAMPAIGN_LEVEL:
            return ""
        best = int(np.argmax(np.abs(found.together.score[0])))
        beams, sector = self._members(best)
        if beam_words(beams, sector) == known:
            return ""
        words = shift_words(kind, beams, sector, float(found.together.shift[0, best]))
        return f"all records together: {words} ({abs(found.together.score[0, best]):.1f} standard deviations)"

    def _most_often(self) -> tuple[list[str], str, float]:
        """Say which fault the flagged records have most often, what it is called, and the share of them all."""
        wrong = np.flatnonzero(self.check.disagree)
        total = len(self.check.misfit)
        if not len(wrong) or (total >= _MANY and len(wrong) <= _BY_CHANCE * total):
            return [], "", 1.0
        kind_of = {index: self._key(index) for index in wrong.tolist()}
        names, counts = np.unique(list(kind_of.values()), return_counts=True)
        most = str(names[int(np.argmax(counts))])
        own = [index for index, name in kind_of.items() if name == most]
        example = self.of_record(own[len(own) // 2])
        alike = "" if len(wrong) == 1 else f", {len(own)} times as in this"
        return [f"beams disagree in {len(wrong)} of {total} records{alike}: {example}"], most, len(wrong) / total

    def _key(self, index: int) -> str:
        """Return what tells faults apart when they are counted: the beams, not by how much they are off."""
        words = self.of_record(index)
        for start in (" has ", " have ", " looks dead"):
            words = words.split(start)[0]
        return words

    def _tilt(self) -> list[str]:
        mean = self.check.kinds.get("mean")
        if mean is None or mean.tilt is None or mean.p_together() < CAMPAIGN_LEVEL:
            return []  # a beam at fault would pass for a tilt
        angle, sd = np.degrees(mean.tilt)
        if not abs(angle) > max(_SHARP_TILT * sd, _LEAST_TILT):
            return []
        words = f"the beams' means say that the lidar is tilted by {angle:+.1f}° more than the records say"
        return [f"{words} (standard deviation {sd:.1f}°)"]

    def _scatter(self) -> list[str]:
        found = self.check.scatter
        if found is None:
            return []
        factor, low, high = found
        if low <= 1.0 <= high or np.exp(-_NEAR_ONE) < factor < np.exp(_NEAR_ONE):
            return []
        made_for = f"those that the noise was made for (L = {self.length_scale:.3g} m)"
        why = f"eddies are larger than {made_for}, or the wind is not steady"
        if factor > 1.0:
            why = f"eddies are smaller than {made_for}, the air is intermittent, or the instrument adds noise"
        words = (
            f"the beams' variances scatter against each other {factor:.2f} ({low:.2f} to {high:.2f}) times as much as"
        )
        return [f"{words} the noise says: {why}"]

    def numbers(self) -> dict[str, Any]:
        """Return what `run.json` holds, as plain values."""
        check = self.check
        tilt = check.kinds["mean"].tilt if "mean" in check.kinds else None
        together, often = self.of_all()
        return {
            "words": [*together, *often],
            "together": together,
            "level": check.level,
            "looked_at": int(np.count_nonzero(np.isfinite(check.probability))),
            "disagree": int(np.count_nonzero(check.disagree)),
            "scatter": None
            if check.scatter is None
            else dict(zip(("factor", "low", "high"), check.scatter, strict=True)),
            "excess": {kind: found.excess for kind, found in check.kinds.items()},
            "p_together": {
                kind: found.p_together() for kind, found in check.kinds.items() if found.together is not None
            },
            "tilt_deg": None if tilt is None else [float(np.degrees(value)) for value in tilt],
        }
