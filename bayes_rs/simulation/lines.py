"""The line simulator: radial velocities of a scan's beams drawn from their own covariances, with no volume."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from bayes_rs._validation import FloatArray, as_generator, check_choice, check_count, check_finite, check_positive
from bayes_rs.errors import InputError, NotPositiveDefiniteError
from bayes_rs.geometry.scan import Scan
from bayes_rs.progress import progress
from bayes_rs.theory.probed import probed_covariance
from bayes_rs.theory.sonic_theory import sonic_moments
from bayes_rs.turbulence.log_transform import ComplexArray
from bayes_rs.turbulence.mann import MannTurbulence

EMBEDDINGS: tuple[str, ...] = ("auto", "dense", "circulant")
"""How the covariance matrix of a record is factored."""

LARGEST_NEGATIVE_PART = 1e-3
"""Largest share of a beam's variance that the negative eigenvalues of a covariance may add; above it is an error."""

LARGEST_NEGATIVE_PART_OF_PROBES = 1e-2
"""The same for beams with a probe volume, whose covariances are less exact (`bayes_rs.geometry.probe.PROBE_ERROR`)."""

_ENLARGE_ABOVE, _ENLARGE_PROBES_ABOVE = 1e-6, 1e-3  # a period whose negative part is larger is doubled
_WORTH_DOUBLING = 0.7  # with a probe volume: a doubled period must lower the negative part so far
_LARGEST_PERIOD = 64  # records
_DENSE = 1000  # samples of all beams together: fewer are factored as one matrix
_DENSE_IF_NEEDED = 4000  # so many can be, in half a minute, where no period up to the largest will do
_MAX_BYTES = 3 * 2**29  # 1.5 GiB for the factors
_CHUNK = 1_500_000  # covariances computed at a time: some 100 MiB of working arrays
_CHUNK_BYTES = 2**26  # of matrices factored at a time
_BLOCK = 16  # records drawn together, always so many, so that a record's rounding does not depend on how many follow
_SINGULAR = "The covariance of the beams of scan {scan!r} has eigenvalues below zero that would add {part:.2g} of a \
variance, more than the {bound:g} allowed: {cure}."


class _Factors(NamedTuple):
    """Hermitian roots of the spectral matrices, upper triangles, shape (n_frequency, n_pair), and what they cost."""

    root: ComplexArray
    period: int
    negative_part: float


class LineMaker:
    """Makes records of the radial velocities of a scan's beams; covariances are computed and factored once.

    Parameters
    ----------
    scan : Scan
        The scan, with its timing: beam b is sampled at beam_time_b + i · scan_duration.
    turbulence : MannTurbulence
        The turbulence.
    wind_speed : float
        Mean wind speed U, m/s.
    n_sample : int
        Number of samples N of each beam in a record.
    yaw : float, optional
        Wind direction relative to the lidar axis ψ, rad; the mounting's own if not given.
    tolerance : float
        Largest error of a velocity covariance, relative to the variance of u.
    embedding : str
        ``"dense"`` factors the covariance matrix of all samples of a record as it is, ``"circulant"`` that of a longer,
        periodic record; ``"auto"`` takes the first for up to 1000 samples of all beams together, and for up to 4000
        where the second fails, as it does for records much shorter than the eddies.

    Attributes
    ----------
    embedding : str
        ``"dense"`` or ``"circulant"``.
    period : int
        Number of samples of the periodic record; 0 if dense.
    negative_part : float
        Share of a beam's variance that was added by setting eigenvalues below zero to zero, the largest of all beams;
        rounding alone gives some 1e-16.

    Raises
    ------
    InputError
        If an argument is not valid, or the factors would need more than 1.5 GiB.
    NotPositiveDefiniteError
        If the negative part is above `LARGEST_NEGATIVE_PART`, or above `LARGEST_NEGATIVE_PART_OF_PROBES` for beams with
        a probe volume.

    Notes
    -----
    The radial velocities v_a,i of a record are Gaussian with mean zero and

        Cov[v_a,i, v_b,j] = C_ab(j − i) = n_a · C(Δx_ab − U (t_b,j − t_a,i), Δy_ab, Δz_ab) n_b,

    the same covariances of frozen turbulence in an infinite domain that the theory of the noise uses, with the scan's
    probe volume (`probed_covariance`). The matrix of all of them is block-Toeplitz. Circulant embedding (Chan and Wood
    1999) draws M ≥ 2N samples of a periodic process with these covariances up to lag M/2: its spectral matrices

        S_ab(f) = Σ_{h = −M/2}^{M/2 − 1} C_ab(h) exp(−2πi f h / M),

    of one row and column a beam, are independent from frequency to frequency; C_ab(−M/2) stands for the mean of
    C_ab(M/2) and C_ab(−M/2). With X_f = (M S_f*)^{1/2} ξ_f and ξ_f complex Gaussian of unit variance (real at f = 0 and
    M/2), the first N samples of v_j = (1/M) Σ_f X_f exp(2πi f j / M) are a record, exact but for the errors of C if no
    S has a negative eigenvalue. Where one has, M is doubled, up to 64 N; what then stays below zero is set to zero.
    That adds the variance (1/M) Σ_f [S_f⁻]_bb to beam b, which `negative_part` measures, and no more to a covariance
    (Cauchy and Schwarz). All roots are Hermitian, hence unique: records depend continuously on scan and turbulence,
    and not on how a library orders degenerate eigenvectors.

    Each record has its own stream of random numbers, so that a record is the same to the last bit however many follow.

    References
    ----------
    Chan and Wood (1999), Statistics and Computing 9, 265–268, doi:10.1023/A:1008903804954.
    Wood and Chan (1994), J. Comput. Graph. Stat. 3, 409–432, doi:10.1080/10618600.1994.10474655.

    Examples
    --------
    >>> from bayes_rs.turbulence.mann import load_turbulence
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> maker = LineMaker(load_scan("staring"), load_turbulence("fu-2022"), wind_speed=10.0, n_sample=600)
    >>> float(maker.make(1000, seed=1).var(axis=-1).mean().round(1))  # 1.37 m² s⁻² less what the mean removes
    1.2
    """

    def __init__(
        self,
        scan: Scan,
        turbulence: MannTurbulence,
        *,
        wind_speed: float,
        n_sample: int,
        yaw: float | None = None,
        tolerance: float = 1e-4,
        embedding: str = "auto",
    ) -> None:
        self.scan = scan
        self.turbulence = turbulence
        self.wind_speed = check_positive(wind_speed, what="wind_speed", unit="m/s")
        self.n_sample = check_count(n_sample, what="n_sample", minimum=2)
        self.yaw = scan.yaw if yaw is None else check_finite(yaw, what="yaw", unit="rad", quantity="wind_yaw")
        self.tolerance = tolerance
        check_choice(embedding, EMBEDDINGS, what="embedding")
        self.embedding = embedding
        self._row, self._column = np.triu_indices(scan.n_beam)
        self.period, self.negative_part = 0, 0.0
        self._root: ComplexArray | None = None  # upper triangles, (n_frequency, n_pair)
        self._dense_root: FloatArray | None = None  # (n_beam n_sample, n_beam n_sample)
        together = scan.n_beam * self.n_sample
        if embedding == "dense" or (embedding == "auto" and together <= _DENSE):
            self._factor_dense()
            return
        try:
            self._factor_circulant()
        except NotPositiveDefiniteError:
            if embedding == "circulant" or together > _DENSE_IF_NEEDED:
                raise
            self._factor_dense()

    def make(self, n_records: int, seed: int | np.random.Generator) -> FloatArray:
        """Make records; the same seed gives the same records, of which the first do not depend on how many are made.

        Parameters
        ----------
        n_records : int
            Number of records, independent of each other.
        seed : int or numpy.random.Generator
            Same seed, same numbers.

        Returns
        -------
        velocity : ndarray, shape (n_records, n_beam, n_sample)
            Fluctuations of radial velocity n·u, m/s, at t = beam_time + i · scan_duration.
        """
        check_count(n_records, what="n_records")
        entropy = [int(part) for part in as_generator(seed).integers(0, 2**63, size=2)]
        streams = np.random.SeedSequence(entropy).spawn(n_records)
        velocity = np.empty((n_records, self.scan.n_beam, self.n_sample))
        starts = range(0, n_records, _BLOCK)
        for first in progress(starts, len(starts), "records"):
            block, some = velocity[first : first + _BLOCK], streams[first : first + _BLOCK]
            if self._dense_root is not None:
                block[:] = self._draw_dense(self._dense_root, some)[: len(block)]
            elif self._root is not None:
                block[:] = self._draw_circulant(self._root, some)[: len(block)]
        return velocity

    def truth(self) -> dict[str, Any]:
        """Return what the records hold and how they were made, as plain JSON values.

        Returns
        -------
        truth : dict
            The turbulence; ``stresses`` (6,) of an infinite domain and ``stresses_record`` (6,), those expected of a
            record with its own mean removed, m² s⁻²; the embedding, its period and ``negative_part``.
        """
        moments = sonic_moments(
            self.scan.select(self.scan.beam[:1]),
            self.turbulence,
            wind_speed=self.wind_speed,
            duration=self.n_sample * self.scan.scan_duration,
            yaw=self.yaw,
            tolerance=self.tolerance,
        )
        return {
            "method": "lines",
            "dissipation": self.turbulence.dissipation,
            "length_scale": self.turbulence.length_scale,
            "gamma": self.turbulence.gamma,
            "turbulence": self.turbulence.name,
            "embedding": self.embedding,
            "period": self.period,
            "negative_part": self.negative_part,
            "tolerance": self.tolerance,
            "probe": self.scan.probe.parameters(),
            "stresses": self.turbulence.stresses().tolist(),
            "stresses_record": moments.mean.tolist(),
        }

    def covariances(self, pair: NDArray[np.int64], lag: NDArray[np.int64]) -> FloatArray:
        """Return the covariances C_ab(h) of pairs of beams: the one place where covariances come from.

        Parameters
        ----------
        pair : ndarray of int, shape (n,)
            Numbers of the pairs a ≤ b, in the order of `numpy.triu_indices`.
        lag : ndarray of int, shape (n_lag,)
            Lags h of beam b behind beam a, in scans.

        Returns
        -------
        covariance : ndarray, shape (n, n_lag)
            C_ab(h), m² s⁻².
        """
        direction = self.scan.at_yaw(self.yaw)
        place = direction * self.scan.focus_distance[:, np.newaxis]
        place[:, 0] -= self.wind_speed * self.scan.beam_time
        first, second = self._row[pair], self._column[pair]
        apart = place[second] - place[first]
        return probed_covariance(
            direction[first],
            direction[second],
            apart[:, 1:],
            apart[:, :1] - self.wind_speed * self.scan.scan_duration * lag,
            self.turbulence,
            probe=self.scan.probe,
            lengths=np.stack([self.scan.probe_length[first], self.scan.probe_length[second]], axis=-1),
            tolerance=self.tolerance,
        )

    def _variances(self) -> FloatArray:
        own = np.flatnonzero(self._row == self._column)
        return self.covariances(own, np.zeros(1, dtype=np.int64))[:, 0]

    def _factor_dense(self) -> None:
        self.embedding, self.period, self._root = "dense", 0, None
        n_beam, n = self.scan.n_beam, self.n_sample
        self._check_memory((n_beam * n) ** 2 * 8)
        lag = np.subtract.outer(np.arange(n), np.arange(n)).T  # j − i
        by_lag = self.covariances(np.arange(len(self._row)), np.arange(1 - n, n))
        matrix = np.empty((n_beam, n, n_beam, n))
        for pair, (a, b) in enumerate(zip(self._row, self._column, strict=True)):
            matrix[a, :, b] = by_lag[pair, lag + n - 1]
            matrix[b, :, a] = matrix[a, :, b].T
        roots, added = _hermitian_roots(matrix.reshape(1, n_beam * n, n_beam * n))
        self._dense_root = np.asarray(roots[0], dtype=np.float64)
        self.negative_part = float(np.max(added.reshape(n_beam, n).max(axis=-1) / self._variances()))
        self._check_negative_part("ask for a smaller tolerance")

    def _factor_circulant(self) -> None:
        self.embedding = "circulant"
        period = 2 * int(scipy.fft.next_fast_len(self.n_sample, real=True))
        self._check_memory(self._bytes(period))
        best = self._factors(period)
        enough = _ENLARGE_ABOVE if self._sees_points else _ENLARGE_PROBES_ABOVE
        while best.negative_part > enough:
            period *= 2
            if period > _LARGEST_PERIOD * self.n_sample or self._bytes(period) > _MAX_BYTES:
                break
            longer = self._factors(period)
            if not self._sees_points and longer.negative_part > _WORTH_DOUBLING * best.negative_part:
                break  # what is left are errors of the covariances, which no period cures
            best = longer
        self._root, self.period, self.negative_part = best
        self._check_negative_part("use fewer beams or fewer samples, or longer records")

    def _bytes(self, period: int) -> int:
        return 16 * (period // 2 + 1) * len(self._row)

    def _check_memory(self, needed: int) -> None:
        if needed > _MAX_BYTES:
            raise InputError(
                f"Records of {self.n_sample} samples of each of {self.scan.n_beam} beams of scan {self.scan.name!r} "
                f"need {needed / 2**30:.1f} GiB for their covariances, more than {_MAX_BYTES / 2**30:g} GiB: choose a "
                "shorter duration or select fewer beams."
            )

    @property
    def _sees_points(self) -> bool:
        return not bool(np.any(self.scan.probe_length > 0.0))

    def _check_negative_part(self, cure: str) -> None:
        bound = LARGEST_NEGATIVE_PART if self._sees_points else LARGEST_NEGATIVE_PART_OF_PROBES
        if self.negative_part > bound:
            raise NotPositiveDefiniteError(
                _SINGULAR.format(scan=self.scan.name, part=self.negative_part, bound=bound, cure=cure),
                smallest_eigenvalue=-self.negative_part,
            )

    def _factors(self, period: int) -> _Factors:
        """Return the Hermitian roots of the spectral matrices of one period."""
        packed = self._spectra(period)
        added = np.zeros(self.scan.n_beam)
        chunk = max(1, _CHUNK_BYTES // (16 * self.scan.n_beam**2))
        starts = range(0, len(packed), chunk)
        for first in progress(starts, len(starts), "spectra"):
            part = slice(first, min(first + chunk, len(packed)))
            roots, negative = _hermitian_roots(self._unpack(packed[part]))
            packed[part] = roots[:, self._row, self._column]
            twice = np.full(len(negative), 2.0)
            twice[np.isin(np.arange(part.start, part.stop), (0, period // 2))] = 1.0
            added += twice @ negative
        return _Factors(packed, period, float(np.max(added / (period * self._variances()))))

    def _spectra(self, period: int) -> ComplexArray:
        """Return conj S_ab(f), f = 0 … M/2, of all pairs of beams, shape (n_frequency, n_pair)."""
        half = period // 2
        lag = np.arange(-half, half + 1)
        packed = np.empty((half + 1, len(self._row)), dtype=np.complex128)
        parts = np.array_split(np.arange(len(self._row)), -(-len(self._row) * len(lag) // _CHUNK))
        for pair in progress(parts, len(parts), "covariances"):
            covariance = self.covariances(pair, lag)
            covariance[:, 0] = 0.5 * (covariance[:, 0] + covariance[:, -1])
            packed[:, pair] = scipy.fft.rfft(np.roll(covariance[:, :-1], -half, axis=1), axis=1).conj().T
        return packed

    def _unpack(self, packed: ComplexArray) -> ComplexArray:
        """Return Hermitian matrices from their upper triangles."""
        full = np.empty((len(packed), self.scan.n_beam, self.scan.n_beam), dtype=np.complex128)
        full[:, self._column, self._row] = packed.conj()
        full[:, self._row, self._column] = packed
        return full

    def _draw_dense(self, root: FloatArray, streams: list[np.random.SeedSequence]) -> FloatArray:
        normal = np.zeros((_BLOCK, len(root)))
        for record, stream in enumerate(streams):
            normal[record] = np.random.default_rng(stream).standard_normal(normal.shape[1])
        return np.asarray((normal @ root).reshape(_BLOCK, self.scan.n_beam, self.n_sample))

    def _draw_circulant(self, root: ComplexArray, streams: list[np.random.SeedSequence]) -> FloatArray:
        n_frequency, n_beam = len(root), self.scan.n_beam
        amplitude = np.zeros((n_frequency, n_beam, _BLOCK), dtype=np.complex128)
        for record, stream in enumerate(streams):
            normal = np.random.default_rng(stream).standard_normal((n_frequency, n_beam, 2))
            normal[1:-1] *= np.sqrt(0.5)
            normal[[0, -1], :, 1] = 0.0
            amplitude[..., record] = normal.view(np.complex128)[..., 0]
        chunk = max(1, _CHUNK_BYTES // (16 * n_beam**2))
        for first in range(0, n_frequency, chunk):
            part = slice(first, first + chunk)
            amplitude[part] = self._unpack(root[part]) @ amplitude[part]
        velocity = scipy.fft.irfft(amplitude, n=self.period, axis=0)[: self.n_sample]
        return np.asarray(np.sqrt(self.period) * velocity.transpose(2, 1, 0))


def _hermitian_roots(matrices: NDArray[Any]) -> tuple[NDArray[Any], FloatArray]:
    """Return the roots A^{1/2} of Hermitian matrices without their negative parts, and the diagonals of those parts.

    Shapes (n, m, m) and (n, m).
    """
    values, vectors = np.linalg.eigh(matrices)
    roots = (vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis]) @ vectors.conj().transpose(0, 2, 1)
    weight = np.abs(vectors) ** 2
    return roots, np.einsum("fbe,fe->fb", weight, np.maximum(-values, 0.0))
