"""The likelihood of ln L and of instrument noise given the octaves of a record's variances: a look-up in tables."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray
from bayes_rs.spectra.octave_information import Information
from bayes_rs.spectra.octave_theory import OctaveTheory, length_nodes

MOST_SHARE = 0.97
"""Largest share of a beam's variance that is taken for the instrument's noise."""
_LEAST = 1e-9  # of a beam's variance: octaves that are nothing but rounding
_RECORDS = 32  # at a time, so that what is calculated of them stays in the cache


@dataclass(frozen=True, eq=False)
class Octaves:
    """The octaves of records' variances, with what they are compared with.

    Parameters
    ----------
    energy : ndarray, shape (n_record, n_beam, n_octave)
        Octaves of the variances, m² s⁻².
    count : ndarray, shape (n_record, n_beam)
        Samples.
    used : ndarray of bool, shape (n_record, n_beam)
        Which beams count.
    wind_speed, yaw : ndarray, shape (n_record,)
        Mean wind, m/s, and its direction relative to the lidar axis, rad.
    theory : OctaveTheory
        Expected octaves of these beams.
    information : Information
        What they tell of L.
    """

    energy: FloatArray
    count: FloatArray
    used: NDArray[np.bool_]
    wind_speed: FloatArray
    yaw: FloatArray
    theory: OctaveTheory
    information: Information

    def __len__(self) -> int:
        """Return the number of records."""
        return len(self.energy)

    def take(self, rows: NDArray[np.int64] | slice) -> Octaves:
        """Return some of the records."""
        own = [f.name for f in fields(self) if isinstance(getattr(self, f.name), np.ndarray)]
        return replace(self, **{name: getattr(self, name)[rows] for name in own})

    @property
    def variance(self) -> FloatArray:
        """The mean variance of each record's sound beams, m² s⁻²; NaN where there is none."""
        total = np.sum(self.energy, axis=-1)
        sound = self._sound(total)
        many = np.count_nonzero(sound, axis=1)
        mean = np.sum(np.where(sound, total, 0.0), axis=1) / np.maximum(many, 1)
        return np.asarray(np.where(many > 0, mean, np.nan))

    def _sound(self, total: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(self.used & np.isfinite(total) & (total > 0.0))

    def log_likelihood(self, share: FloatArray) -> FloatArray:
        r"""Return the log-likelihood of ln L and the instrument's noise.

        Parameters
        ----------
        share : ndarray, shape (n_record, n_noise)
            Noise variances over each record's `variance`.

        Returns
        -------
        log_density : ndarray, shape (n_record, n_noise, n_length)
            At `length_nodes`; constant where no beam tells anything.

        Notes
        -----
        An octave of ν differences of expectation A_b ((1 − q) e_l + q w_l), e from theory and w that of white noise,
        each of sum 1, is taken for that times χ²_ν/ν. The size A_b of each beam is maximised over, so that R has no
        influence but through its anisotropy; the instrument's noise is the same for all beams. The sum over beams and
        octaves is raised to the power of `octave_information` at its own maximum.
        """
        nodes = length_nodes()
        found = np.empty((*share.shape, len(nodes)))
        for first in range(0, len(self), _RECORDS):
            rows = slice(first, first + _RECORDS)
            some = self.take(rows)
            independent = some._independent(share[rows])
            best = nodes[np.argmax(independent.max(axis=1), axis=-1)]
            power = self.information.at(best, some.wind_speed)
            found[rows] = power[:, np.newaxis, np.newaxis] * independent
        return found

    def _independent(self, share: FloatArray) -> FloatArray:
        """Return the log-likelihood as if octaves and beams were independent, shape (n_record, n_noise, n_length)."""
        theory = self.theory
        n_sample = theory.blocks.n_sample
        filled = theory.blocks.filled(np.clip(self.count / n_sample, 1.0 / n_sample, 1.0))
        dof = np.diff(filled)  # (n_record, n_beam, n_octave)
        white = dof / dof.sum(axis=-1, keepdims=True)
        shape = theory.expected(theory.correlation(self.wind_speed, self.yaw), filled[:, :, np.newaxis])
        shape /= shape.sum(axis=-1, keepdims=True)  # of the variance of a record, without what is slower than it
        total = np.sum(self.energy, axis=-1)
        sound = self._sound(total)
        half = np.where(sound[..., np.newaxis], 0.5 * dof, 0.0)
        all_half = half.sum(axis=-1)
        relative = np.where(sound[..., np.newaxis], self.energy / np.where(sound, total, 1.0)[..., np.newaxis], 0.0)
        of_beam = np.nan_to_num(self.variance)[:, np.newaxis] / np.where(sound, total, 1.0)
        # octaves come first and beams last, so that sums and factors run along many numbers
        shape = np.ascontiguousarray(np.transpose(shape, (3, 2, 0, 1)))  # (n_octave, n_length, n_record, n_beam)
        parts = (white, half, half * relative)
        white, half, weighted = (np.moveaxis(one, -1, 0)[:, np.newaxis].copy() for one in parts)
        density = np.empty((*share.shape, shape.shape[1]))
        mean, other = np.empty_like(shape), np.empty_like(shape)
        for index in range(share.shape[1]):
            part = np.clip(share[:, index, np.newaxis] * of_beam, 0.0, MOST_SHARE)
            np.multiply(1.0 - part, shape, out=mean)
            mean += part * white
            np.maximum(mean, _LEAST, out=mean)
            size = np.add.reduce(np.divide(weighted, mean, out=other))
            log_mean = np.log(mean, out=mean)
            log_mean *= half
            found = np.add.reduce(log_mean)
            found += all_half * np.log(np.where(sound, size, 1.0))
            np.negative(found.sum(axis=-1).T, out=density[:, index])
        return density


def averaged(log_density: FloatArray, log_weight: FloatArray) -> FloatArray:
    """Return the log-likelihood of ln L, less its maximum, averaged over noise.

    Parameters
    ----------
    log_density : ndarray, shape (n_record, n_noise, n_length)
        From `Octaves.log_likelihood`.
    log_weight : ndarray, shape (n_noise,) or (n_record, n_noise)
        Logarithms of the weights.

    Returns
    -------
    log_density : ndarray, shape (n_record, n_length)
        Zero everywhere where no beam tells anything.
    """
    joint = log_density + log_weight[..., np.newaxis]
    top = joint.max(axis=1, keepdims=True)
    found = np.log(np.sum(np.exp(joint - top), axis=1)) + top[:, 0]
    return np.asarray(found - found.max(axis=-1, keepdims=True))


def log_sum(log_values: FloatArray) -> FloatArray:
    """Return the logarithm of the sum of the exponentials of finite numbers over the last axis.

    To the last bit what `scipy.special.logsumexp` returns, which checks for much more and takes five times as long.
    """
    top = log_values.max(axis=-1, keepdims=True)
    largest = log_values == top
    part = np.exp(log_values - top)
    part[largest] = 0.0
    many = largest.sum(axis=-1, dtype=np.float64)
    return np.asarray(np.log1p(part.sum(axis=-1) / many) + np.log(many) + top[..., 0])
