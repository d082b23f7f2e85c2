"""The fit of Mann spectra to those of radial velocities: length scale, dissipation and instrument noise of records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, as_numbers, check_choice, check_count, check_log_normal, check_non_negative
from bayes_rs.errors import InputError, in_short
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.progress import progress as progress_bar
from bayes_rs.spectra.beam_theory import scaled_autocovariance
from bayes_rs.spectra.information import information_ratio
from bayes_rs.spectra.lag_window import lag_windows, ordinates
from bayes_rs.spectra.radial_spectrum import check_spectra
from bayes_rs.spectra.whittle import Profile, profile_likelihood

BEAMS = ("together", "each")
"""Whether a record's beams share one length scale, dissipation and instrument noise, or have their own."""

NOISE_SHARE = 0.2
"""Standard deviation of the floor's prior, as a share of the variance of the beams, where none is given."""

_NODE_STEP, _REACH = 0.12, 3.0  # of ln L; standard deviations of the prior
_FINE_STEP = 0.01  # of ln L, for sums over the posterior
_TOLERANCE = 1e-4  # of velocity covariances, relative to the variance of u
_UNITS = {
    "length_scale": "m",
    "length_scale_log_sd": "1",
    "dissipation": "m4/3 s-2",
    "dissipation_log_sd": "1",
    "instrument_noise": "m2 s-2",
    "instrument_noise_sd": "m2 s-2",
    "gamma": "1",
    "gamma_sd": "1",
}
"""What is fitted, and its unit."""
_UNLIKELY = -700.0  # log-density below the maximum at which a node has no weight


def fit_spectra(
    spectra: xr.Dataset,
    scan: Scan | str | Path,
    *,
    gamma: ArrayLike = 3.2,
    length_scale_prior: tuple[float, float] = (60.0, 0.8),
    instrument_noise: float = 0.0,
    instrument_noise_sd: float | None = None,
    beams: str = "together",
    max_beams: int = 6,
    progress: bool | None = None,
) -> xr.Dataset:
    r"""Fit length scale, dissipation and instrument noise to the spectra of every record.

    Parameters
    ----------
    spectra : xarray.Dataset
        From `radial_spectra`.
    scan : Scan, str or Path
        The scan that measured them, with its probe volume.
    gamma : float or array_like, shape (n_gamma,)
        Anisotropy parameter Γ; if several, they are equally likely a priori, and Γ is averaged over.
    length_scale_prior : tuple of float
        Median of the length scale L, m, and standard deviation of ln L: log-normal, cut off at three of them.
    instrument_noise : float
        Mean of the prior of the instrument's noise variance, m² s⁻².
    instrument_noise_sd : float, optional
        Its standard deviation, m² s⁻²; 0 if it is known, and 20 % of the variance of the beams if not given.
    beams : str
        ``"together"``: a record has one L, dissipation and noise. ``"each"``: every beam has its own.
    max_beams : int
        Of a scan with more beams, so many are fitted, evenly chosen: neighbours tell little more.
    progress : bool, optional
        Progress bar on stderr; by default only on a terminal.

    Returns
    -------
    fit : xarray.Dataset
        With the dimension ``record``, and ``beam`` for ``"each"``: ``length_scale`` (m), the exponential of the
        posterior mean of ln L, and ``length_scale_log_sd``; ``dissipation`` αε^(2/3) (m^(4/3) s⁻²) and
        ``dissipation_log_sd``; ``instrument_noise`` and ``instrument_noise_sd`` (m² s⁻²); ``gamma`` and ``gamma_sd``;
        NaN where a record has no spectrum or no wind. ``expected`` (record, beam, frequency), the fitted spectrum as
        this record would show it, m² s⁻² Hz⁻¹. ``log_density`` (…, gamma_node, length_node), for `pool_length_scale`.
        Attributes: ``information_ratio``, see Notes.

    Raises
    ------
    InputError
        If spectra and scan do not belong together, or an option is not valid.

    Notes
    -----
    By Taylor's hypothesis the autocovariance of beam b at lag τ is C_b(τ) = n·[∫Φ(k)|H(k·n)|² exp(−ik₁Uτ) d³k]n, with
    the probe's transfer H. The expected spectrum of the record is q C + s q₀ (`lag_windows`): exact in aliasing,
    leakage, gaps and the removed mean; s is the instrument's noise. The log-likelihood is Whittle's,

    .. math:: \ell = -\sum_{b,k} w_k (\ln S_{bk} + I_{bk}/S_{bk}), \qquad S = A\,q c(L, Γ) + s q_0,

    A = αε^(2/3) L^(2/3). At each L (and Γ) of a grid it is maximised over ln A and s, and integrated over them by
    Laplace's method; so the posterior of ln L need not be normal.

    Beams of a record see the same eddies, and tapered estimates overlap. The likelihood is therefore raised to the
    power by which it overstates the information on ln L at the median state of the records, for Gaussian velocities
    (`information_ratio`), times the share of samples that are there.

    The noise may come out negative: its prior is normal, so that averages over records are not biased. Where the
    Nyquist frequency lies in the inertial range, floor and spectrum look alike, and the noise's posterior is its prior.

    References
    ----------
    Sykulski, Olhede, Guillaumin, Lilly and Early (2019), Biometrika 106, 251–266, doi:10.1093/biomet/asy071.
    Mann (1994), J. Fluid Mech. 273, 141–168, doi:10.1017/S0022112094001886.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")  # L is 61 m
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=20, seed=1)
    >>> spectra = brs.spectra.radial_spectra(series, scan, brs.make_records(series, scan))
    >>> fit = fit_spectra(spectra, scan, progress=False)
    >>> pooled = pool_length_scale(fit)
    >>> bool(45.0 < pooled["length_scale"][0] < 80.0), bool(pooled["length_scale_log_sd"][0] < 0.15)
    (True, True)
    """
    scan = as_scan(scan)
    check_spectra(spectra)
    used = scan.select(spectra["beam"].values)
    kept = _fitted_beams(used.n_beam, beams, max_beams)
    gammas = _gammas(gamma)
    median, width = check_log_normal(
        length_scale_prior, what="length_scale_prior", unit="m", width="length_scale_log_sd"
    )
    check_non_negative(instrument_noise, what="instrument_noise", unit="m² s⁻²")
    if instrument_noise_sd is not None:
        check_non_negative(instrument_noise_sd, what="instrument_noise_sd", unit="m² s⁻²")
    n_node = 2 * int(np.ceil(_REACH * width / _NODE_STEP)) + 1
    log_node = np.log(median) + np.linspace(-_REACH * width, _REACH * width, n_node)
    prior = -0.5 * ((log_node - np.log(median)) / width) ** 2
    groups = [kept] if beams == "together" else [np.array([b]) for b in kept]
    n_record = spectra.sizes["record"]
    shape = (n_record, len(groups))
    states = _States(spectra, used, gammas, log_node, instrument_noise, instrument_noise_sd)
    found: dict[tuple[int, int], _Found] = {}
    for r in progress_bar(
        list(range(n_record)), n_record, "spectra", disable=None if progress is None else not progress
    ):
        for g, members in enumerate(groups):
            one = states.fit(r, members)
            if one is not None:
                found[r, g] = one
    if not found:
        raise InputError("No record has a spectrum and a wind speed, so there is nothing to fit: check the flags.")
    ratios = np.ones((len(groups), 3))
    for g, members in enumerate(groups):
        some = [one for (_, group), one in found.items() if group == g]
        if some:
            ratios[g] = states.ratio(members, some, prior)
    log_density = np.full((*shape, len(gammas), n_node), np.nan)
    columns = {name: np.full(shape, np.nan) for name in _UNITS}
    expected = np.full((n_record, used.n_beam, spectra.sizes["frequency"]), np.nan)
    for (r, g), one in found.items():
        ratio = ratios[g] * one.share
        log_density[r, g] = one.marginal(ratio[1])
        for name, value in _moments(one, log_density[r, g] + prior, log_node, gammas, ratio).items():
            columns[name][r, g] = value
        at_best = states.expected(
            r, groups[g], float(columns["length_scale"][r, g]), float(gammas[np.argmax(log_density[r, g].max(axis=1))])
        )
        expected[r, groups[g]] = at_best
    return _fit_dataset(spectra, columns, log_density, expected, gammas, np.exp(log_node), beams).assign_attrs(
        scan=scan.name,
        scan_key=scan.key,
        beams=beams,
        length_scale_prior=[float(median), float(width)],
        instrument_noise_prior=[
            float(instrument_noise),
            np.nan if instrument_noise_sd is None else float(instrument_noise_sd),
        ],
        information_ratio=ratios[:, 1].tolist(),
        fitted_beams=spectra["beam"].values[kept].tolist(),
    )


def _fitted_beams(n_beam: int, beams: str, max_beams: int) -> NDArray[np.int64]:
    """Return the places of the beams that are fitted."""
    check_choice(beams, BEAMS, what="beams")
    check_count(max_beams, what="max_beams")
    if beams == "together" and n_beam > max_beams:
        return np.unique(np.round(np.linspace(0, n_beam - 1, max_beams)).astype(np.int64))
    return np.arange(n_beam)


def _gammas(gamma: ArrayLike) -> FloatArray:
    gammas = np.atleast_1d(as_numbers(gamma, what="gamma"))
    if gammas.ndim != 1 or not np.all(np.isfinite(gammas) & (gammas >= 0.0)) or len(np.unique(gammas)) != len(gammas):
        raise InputError(f"Invalid gamma {in_short(gamma)}: it must be a number, zero or above, or different ones.")
    return gammas


def _fit_dataset(
    spectra: xr.Dataset,
    columns: Mapping[str, FloatArray],
    log_density: FloatArray,
    expected: FloatArray,
    gammas: FloatArray,
    length_scales: FloatArray,
    beams: str,
) -> xr.Dataset:
    """Lay out what `fit_spectra` found, along records, and along beams where each has its own."""
    dims = ("record", "beam") if beams == "each" else ("record",)
    size = log_density.shape[:2] if beams == "each" else log_density.shape[:1]
    return xr.Dataset(
        {
            **{name: (dims, values.reshape(size), {"units": _UNITS[name]}) for name, values in columns.items()},
            "log_density": (
                (*dims, "gamma_node", "length_node"),
                log_density.reshape(*size, len(gammas), len(length_scales)),
                {"long_name": "logarithm of the marginal likelihood of gamma and length scale, less its maximum"},
            ),
            "expected": (
                ("record", "beam", "frequency"),
                expected,
                {"units": "m2 s-2 Hz-1", "long_name": "fitted spectrum as the record shows it"},
            ),
        },
        coords={
            "time": ("record", spectra["time"].values),
            "beam": ("beam", spectra["beam"].values),
            "frequency": ("frequency", spectra["frequency"].values, {"units": "Hz"}),
            "gamma_node": gammas,
            "length_node": ("length_node", length_scales, {"units": "m"}),
        },
    )


def pool_length_scale(fit: xr.Dataset, groups: Sequence[object] | NDArray[np.generic] | None = None) -> xr.Dataset:
    """Return one length scale for many records: of a day, a wind-speed bin, or all.

    Parameters
    ----------
    fit : xarray.Dataset
        From `fit_spectra`, with ``beams="together"``.
    groups : sequence, length n_record, optional
        A label for each record; records of one label share L and Γ. All records if not given.

    Returns
    -------
    pooled : xarray.Dataset
        Dimension ``group``: ``length_scale`` (m), ``length_scale_log_sd``, ``gamma``, ``gamma_sd`` and ``n_record``,
        the records with a fit.

    Raises
    ------
    InputError
        If `fit` is not of records, or the labels do not fit.

    Notes
    -----
    The marginal log-likelihoods of the records are added, and the prior counts once. Records are taken as independent.
    Where L differs from record to record, the spread of L is not in ``length_scale_log_sd``.

    Examples
    --------
    See `fit_spectra`.
    """
    if "log_density" not in fit or fit["log_density"].dims != ("record", "gamma_node", "length_node"):
        raise InputError("The fit has no length scale of each record: make it with fit_spectra(beams='together').")
    density = fit["log_density"].values
    labels = np.zeros(len(density), dtype=np.int64) if groups is None else np.asarray(groups)
    if labels.shape != (len(density),):
        raise InputError(f"Invalid groups of shape {labels.shape}: one label for each of the {len(density)} records.")
    median, width = (float(value) for value in fit.attrs["length_scale_prior"])
    log_node, gammas = np.log(fit["length_node"].values), fit["gamma_node"].values
    prior = -0.5 * ((log_node - np.log(median)) / width) ** 2
    known = np.isfinite(density).any(axis=(1, 2))
    names = np.unique(labels)
    columns = {
        name: np.full(len(names), np.nan) for name in ("length_scale", "length_scale_log_sd", "gamma", "gamma_sd")
    }
    count = np.zeros(len(names), dtype=np.int64)
    for index, name in enumerate(names):
        members = known & (labels == name)
        count[index] = int(members.sum())
        if count[index]:
            mean, sd, gamma, gamma_sd = _scale_moments(density[members].sum(axis=0) + prior, log_node, gammas)
            for column, value in zip(columns, (np.exp(mean), sd, gamma, gamma_sd), strict=True):
                columns[column][index] = value
    return xr.Dataset(
        {**{name: ("group", values) for name, values in columns.items()}, "n_record": ("group", count)},
        coords={"group": names},
        attrs={name: fit.attrs[name] for name in ("scan", "length_scale_prior")},
    )


def with_length_scale(records: xr.Dataset, fit: xr.Dataset, pooled: xr.Dataset | None = None) -> xr.Dataset:
    """Return records with the length scale (and Γ, if it was fitted) of their spectra, for their noise.

    Parameters
    ----------
    records : xarray.Dataset
        From `make_records`.
    fit : xarray.Dataset
        From `fit_spectra` of these records, with ``beams="together"``.
    pooled : xarray.Dataset, optional
        From `pool_length_scale` with one group: all records get its L.

    Returns
    -------
    records : xarray.Dataset
        With ``length_scale`` (record), m, ``length_scale_log_sd`` (record), and ``gamma`` (record) if several were
        given to `fit_spectra`. `fit` takes each record's noise at them from noise that spans them,
        ``noise.calibrate(scan, records=records)``. Records without a fitted spectrum get the pooled
        L of the others; the attribute ``length_scale_from_others`` counts them.

    Raises
    ------
    InputError
        If the fit is not of these records, or `pooled` has several groups.

    Examples
    --------
    >>> import bayes_rs as brs
    >>> scan, flow = brs.load_scan("staring"), brs.load_turbulence("fu-2022")
    >>> series = brs.simulate(scan, flow, wind_speed=10.0, n_records=2, seed=1)
    >>> records = brs.make_records(series, scan)
    >>> fitted = fit_spectra(brs.spectra.radial_spectra(series, scan, records), scan, progress=False)
    >>> "length_scale" in with_length_scale(records, fitted)
    True
    """
    if "length_scale" not in fit or fit["length_scale"].dims != ("record",):
        raise InputError("The fit has no length scale of each record: make it with fit_spectra(beams='together').")
    if fit.sizes["record"] != records.sizes["record"] or not np.array_equal(fit["time"].values, records["time"].values):
        raise InputError(
            "The fit is not of these records: they start at other times; fit the spectra of these records."
        )
    common = pool_length_scale(fit) if pooled is None else pooled
    if common.sizes["group"] != 1:
        raise InputError(f"Invalid pooled length scale of {common.sizes['group']} groups: it must be of one group.")
    added = {}
    missing = ~np.isfinite(fit["length_scale"].values)
    names = ("length_scale", "length_scale_log_sd", *(("gamma",) if fit.sizes["gamma_node"] > 1 else ()))
    for name in names:
        one = float(common[name].values[0])
        values = np.where(missing, one, fit[name].values) if pooled is None else np.full(len(missing), one)
        added[name] = ("record", values, {"units": "m" if name == "length_scale" else "1"})
    return records.assign(added).assign_attrs(length_scale_from_others=int(missing.sum()))


class _Found(NamedTuple):
    """The profiles of one record (one for each Γ), and what its numbers are relative to."""

    profiles: list[Profile]
    share: float
    floor_sd: float

    def marginal(self, power: float) -> FloatArray:
        """Return the log-likelihood of Γ and ln L, size and floor integrated over, less its maximum."""
        rows = []
        for profile in self.profiles:
            size = profile.covariance[:, 0, 0]
            if self.floor_sd > 0.0:
                size = np.linalg.det(profile.covariance)
            rows.append(power * profile.log_density + 0.5 * np.log(size))
        table = np.stack(rows)
        return np.asarray(table - np.max(table))


class _States:
    """What all records of a fit share."""

    def __init__(
        self,
        spectra: xr.Dataset,
        scan: Scan,
        gammas: FloatArray,
        log_node: FloatArray,
        floor: float,
        floor_sd: float | None,
    ) -> None:
        self.scan, self.gammas, self.log_node = scan, gammas, log_node
        self.spectrum = spectra["spectrum"].values
        self.present = np.isfinite(spectra["radial_velocity"].values)
        self.variance = spectra["variance"].values
        self.speed, self.yaw = spectra["wind_speed"].values, np.deg2rad(spectra["yaw"].values)
        self.interval, self.tapers = float(spectra.attrs["interval"]), int(spectra.attrs["tapers"])
        self.floor, self.floor_sd = floor, floor_sd
        self.n_slot = self.present.shape[-1]
        _, sides = ordinates(self.n_slot)
        self.weight = 0.5 * max(self.tapers, 1) * sides
        self._full: FloatArray | None = None

    def windows(self, present: NDArray[np.bool_]) -> FloatArray:
        """Return the lag windows of a beam; those of a record without gaps once for all."""
        if not present.all():
            return lag_windows(present, self.interval, self.tapers)
        if self._full is None:
            self._full = lag_windows(present, self.interval, self.tapers)
        return self._full

    def usable(self, r: int, members: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the beams of a record that have a spectrum; none where the wind is not known."""
        if not (self.speed[r] > 0.0 and np.isfinite(self.yaw[r])):
            return members[:0]
        known: NDArray[np.bool_] = np.isfinite(self.spectrum[r, members, 0]) & (self.variance[r, members] > 0.0)
        return members[known]

    def shapes(self, r: int, beam: int, length_scale: FloatArray, gamma: float) -> tuple[FloatArray, FloatArray]:
        """Return the expected spectra of unit size, and that of white noise, of one beam of a record.

        Where a probe volume leaves next to nothing, errors of the covariances can make a spectrum negative: it is at
        least that of white noise of their tolerance.
        """
        windows = self.windows(self.present[r, beam])
        covariance = scaled_autocovariance(
            self.scan.at_yaw(self.yaw[r])[beam],
            self.speed[r] * self.interval * np.arange(self.n_slot),
            length_scale,
            gamma=gamma,
            probe=self.scan.probe,
            probe_length=float(self.scan.probe_length[beam]),
            tolerance=_TOLERANCE,
        )
        white = windows[:, 0]
        return np.maximum(covariance @ windows.T, _TOLERANCE * covariance[:, :1] * white), white

    def profile(
        self, r: int, beams: NDArray[np.int64], length_scale: FloatArray, gamma: float
    ) -> tuple[Profile, list[FloatArray], list[FloatArray], float]:
        """Return the profile of the likelihood of some beams of a record, and what it was made of."""
        parts = [self.shapes(r, int(b), length_scale, gamma) for b in beams]
        floor_sd = self.floor_sd
        if floor_sd is None:
            floor_sd = NOISE_SHARE * float(np.mean(self.variance[r, beams]))
        found = profile_likelihood(
            np.concatenate([self.spectrum[r, b] for b in beams]),
            np.tile(self.weight, len(beams)),
            np.concatenate([shape for shape, _ in parts], axis=1),
            np.concatenate([white for _, white in parts]),
            floor=self.floor,
            floor_sd=floor_sd,
        )
        return found, [shape for shape, _ in parts], [white for _, white in parts], floor_sd

    def fit(self, r: int, members: NDArray[np.int64]) -> _Found | None:
        """Return the profiles of one record, or None if it has no spectrum."""
        beams = self.usable(r, members)
        if len(beams) == 0:
            return None
        floor_sd = 0.0
        profiles = []
        for gamma in self.gammas:
            found, _, _, floor_sd = self.profile(r, beams, np.exp(self.log_node), float(gamma))
            profiles.append(found)
        if not any(np.isfinite(one.log_density).any() for one in profiles):
            return None
        return _Found(profiles, float(np.mean(self.present[r, beams])), floor_sd)

    def expected(self, r: int, members: NDArray[np.int64], length_scale: float, gamma: float) -> FloatArray:
        """Return the expected spectra of the beams of a record at its length scale, NaN for those not used."""
        beams = self.usable(r, members)
        found, shapes, whites, _ = self.profile(r, beams, np.array([length_scale]), gamma)
        out = np.full((len(members), self.spectrum.shape[-1]), np.nan)
        for b, shape, white in zip(beams, shapes, whites, strict=True):
            out[members == b] = np.exp(found.log_size[0]) * shape[0] + found.floor[0] * white
        return out

    def ratio(self, members: NDArray[np.int64], some: list[_Found], prior: FloatArray) -> FloatArray:
        """Return the information ratio at the median state of the records."""
        middle = len(self.gammas) // 2
        best = [int(np.argmax(one.profiles[middle].log_density + prior)) for one in some]
        size = np.array([one.profiles[middle].log_size[k] for one, k in zip(some, best, strict=True)])
        floor = np.array([one.profiles[middle].floor[k] for one, k in zip(some, best, strict=True)])
        known = (self.speed > 0.0) & np.isfinite(self.yaw)
        direction = np.exp(1j * self.yaw[known])
        return information_ratio(
            self.scan.select(self.scan.beam[members]),
            wind_speed=float(np.median(self.speed[known])),
            yaw=float(np.angle(np.mean(direction))),
            length_scale=float(np.exp(np.median(self.log_node[best]))),
            gamma=float(self.gammas[middle]),
            interval=self.interval,
            n_slot=self.n_slot,
            tapers=self.tapers,
            floor=max(float(np.median(floor * np.exp(-size))), 0.0),
            floor_sd=float(np.median([one.floor_sd for one in some] * np.exp(-size))),
        )


def _moments(
    one: _Found, log_posterior: FloatArray, log_node: FloatArray, gammas: FloatArray, ratio: FloatArray
) -> dict[str, float]:
    """Return means and standard deviations of a record's parameters."""
    mean, sd, gamma, gamma_sd = _scale_moments(log_posterior, log_node, gammas)
    weight = np.exp(log_posterior - np.max(log_posterior))
    weight /= weight.sum()
    log_size = np.stack([profile.log_size - 2.0 / 3.0 * log_node for profile in one.profiles])
    floor = np.stack([profile.floor for profile in one.profiles])
    size_variance = np.stack([profile.covariance[:, 0, 0] for profile in one.profiles])
    floor_variance = np.stack([profile.covariance[:, 1, 1] for profile in one.profiles])
    log_dissipation, noise = float(np.sum(weight * log_size)), float(np.sum(weight * floor))
    spread = np.sum(weight * ((log_size - log_dissipation) ** 2 + size_variance / ratio[0]))
    noise_spread = np.sum(weight * ((floor - noise) ** 2 + floor_variance / min(ratio[2], 1.0)))
    return {
        "length_scale": float(np.exp(mean)),
        "length_scale_log_sd": sd,
        "dissipation": float(np.exp(log_dissipation)),
        "dissipation_log_sd": float(np.sqrt(spread)),
        "instrument_noise": noise,
        "instrument_noise_sd": float(np.sqrt(noise_spread)),
        "gamma": gamma,
        "gamma_sd": gamma_sd,
    }


def _scale_moments(
    log_posterior: FloatArray, log_node: FloatArray, gammas: FloatArray
) -> tuple[float, float, float, float]:
    """Return mean and standard deviation of ln L and of Γ, of a log-posterior (n_gamma, n_node)."""
    fine = np.arange(log_node[0], log_node[-1] + 0.5 * _FINE_STEP, _FINE_STEP)
    top = float(np.max(log_posterior))
    clipped = np.maximum(log_posterior - top, _UNLIKELY)
    between = np.stack([scipy.interpolate.CubicSpline(log_node, row)(fine) for row in clipped])
    weight = np.exp(between - np.max(between))
    weight /= weight.sum()
    mean, gamma = float(np.sum(weight * fine)), float(np.sum(weight * gammas[:, np.newaxis]))
    sd = np.sqrt(np.sum(weight * (fine - mean) ** 2))
    gamma_sd = np.sqrt(np.sum(weight * (gammas[:, np.newaxis] - gamma) ** 2))
    return mean, float(sd), gamma, float(gamma_sd)
