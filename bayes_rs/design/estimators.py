"""The classic point estimators of the stresses from radial variances, which a posterior is compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from bayes_rs._validation import FloatArray, check_array, check_choice, check_non_negative
from bayes_rs.errors import InputError, NotPositiveDefiniteError, in_short
from bayes_rs.geometry.forward import design_matrix
from bayes_rs.geometry.scan import Scan
from bayes_rs.geometry.scan_file import as_scan
from bayes_rs.geometry.stress import STRESSES, is_realizable
from bayes_rs.likelihoods.least_squares import Solved, pseudo_inverse
from bayes_rs.noise.given import given_noise
from bayes_rs.noise.noise import Noise
from bayes_rs.records.belief import believed
from bayes_rs.records.layout import check_layout

BoolArray = NDArray[np.bool_]

WEIGHTS = ("none", "noise")
IEC_RATIOS = (0.64, 0.25)
"""vv/uu and ww/uu of IEC 61400-1: standard deviations of 0.8 and 0.5 times that of u."""

_CHUNK_NUMBERS = 4_000_000
"""Entries of the arrays of records that are solved together: 32 MB an array."""
_IDENTITY = np.eye(len(STRESSES))


@dataclass(frozen=True, eq=False)
class StressForm:
    """What an estimator takes for granted of R: stresses = basis @ unknowns.

    Parameters
    ----------
    basis : ndarray, shape (6, n_unknown)
        Stresses that each unknown stands for.
    estimated : tuple of str
        The stresses that it estimates; the others follow from the assumption alone.
    assumption : str
        The same in words.
    """

    basis: FloatArray
    estimated: tuple[str, ...]
    assumption: str


def _form_of(estimated: tuple[str, ...], assumption: str) -> StressForm:
    """Return the form in which these stresses are free and the others are zero."""
    return StressForm(_IDENTITY[:, [STRESSES.index(name) for name in estimated]], estimated, assumption)


def _form_of_ratios(vv: float, ww: float, assumption: str) -> StressForm:
    """Return the form with uu alone unknown, vv and ww in proportion to it, and no covariances."""
    return StressForm(np.array([[1.0], [vv], [ww], [0.0], [0.0], [0.0]]), ("uu",), assumption)


ESTIMATORS: dict[str, Callable[[float, float], StressForm]] = {
    "lsq": lambda _vv, _ww: _form_of(STRESSES, "nothing"),
    "lsq-no-cross": lambda _vv, _ww: _form_of(("uu", "vv", "ww", "uw"), "uv = vw = 0"),
    "lsq-reduced": lambda _vv, _ww: _form_of(("uu", "uv", "uw", "vw"), "vv = ww = 0"),
    "lsp": lambda _vv, _ww: _form_of(("uu",), "vv = ww = uv = uw = vw = 0"),
    "isotropy": lambda _vv, _ww: _form_of_ratios(1.0, 1.0, "vv = ww = uu, uv = uw = vw = 0"),
    "ratio": lambda vv, ww: _form_of_ratios(vv, ww, f"vv = {vv:g} uu, ww = {ww:g} uu, uv = uw = vw = 0"),
}
"""The estimators by name; each call takes the assumed vv/uu and ww/uu, which only ``ratio`` uses."""


def estimate(
    records: xr.Dataset,
    scan: Scan | str | Path,
    *,
    method: str = "lsq",
    weights: str = "none",
    noise: Noise | str | Path | None = None,
    ratio_vv: float = IEC_RATIOS[0],
    ratio_ww: float = IEC_RATIOS[1],
    combinations: Mapping[str, ArrayLike] | None = None,
) -> xr.Dataset:
    r"""Estimate the stresses of every record by least squares on its radial variances: no prior, no posterior.

    Parameters
    ----------
    records : Dataset, dims (record, beam)
        From `make_records`: ``variance`` (m² s⁻²), ``flag``, and per record ``yaw`` (degree); ``wind_speed`` (m/s) if
        there is `noise`. Beams with a flag are left out of their record.
    scan : Scan, str or Path
        The scan that measured them, or its name or file. Each record is solved at its own yaw.
    method : str
        What is taken for granted:

        - ``"lsq"``: nothing; all six stresses.
        - ``"lsq-no-cross"``: uv = vw = 0; uu, vv, ww and uw, as for 4 and 5 beams in the paper.
        - ``"lsq-reduced"``: vv = ww = 0, neglected; uu, uv, uw and vw.
        - ``"lsp"``: all but uu are zero: projection on the line of sight.
        - ``"isotropy"``: vv = ww = uu, no covariances; uu is the mean of the radial variances.
        - ``"ratio"``: vv = `ratio_vv` uu, ww = `ratio_ww` uu, no covariances.
    weights : str
        ``"none"``: all beams count the same. ``"noise"``: generalized least squares with the covariance of `noise`.
    noise : Noise, str or Path, optional
        From `noise.calibrate`, or its file; made for this scan and record length. Gives standard errors,
        and weights if asked for. Its bias and its gain are not used: the beams are taken as points.
    ratio_vv, ratio_ww : float
        Assumed vv/uu and ww/uu, for the method ``"ratio"`` only.
    combinations : mapping of str to array_like, shape (6,), optional
        Coefficients of linear combinations of uu, vv, ww, uv, uw, vw to estimate, too, by name: some are determined
        where the stresses in them are not.

    Returns
    -------
    estimates : Dataset, dims (record, component)
        ``stress``, m² s⁻², in the order uu, vv, ww, uv, uw, vw; ``identified``, whether the record's beams determine
        it; ``realizable`` (record), whether the method's tensor, with what it assumes, is realizable; false, too, where
        it is not determined; with noise ``standard_error``, m² s⁻². With `combinations`, ``combination``,
        ``combination_identified`` and ``combination_standard_error`` over (record, name).

    Raises
    ------
    InputError
        If records and scan do not belong together, or an argument is invalid.
    NoiseMismatchError
        If the noise was made for another scan.
    NotPositiveDefiniteError
        If the covariance that weights are asked from is singular.

    Notes
    -----
    With A the design matrix and B the stresses per unknown (`StressForm`), the unknowns c and the stresses are

    .. math::
        \hat c = \arg\min_c \, (y - A B c)^T W (y - A B c), \qquad \hat R = B \hat c .

    With W = 1 and B = 1 this is Eqs. (5) to (7) of [1]_, with the sum over the beams for the integral. ``"lsp"`` is
    Eq. (7) with all stresses but uu zero, and ``"isotropy"`` the mean of the radial variances, Sect. 2.2 of [1]_:

    .. math::
        \widehat{uu}_{LSP} = \frac{\sum_b n_{b1}^2 y_b}{\sum_b n_{b1}^4}, \qquad
        \widehat{uu}_{iso} = \frac{1}{N_b} \sum_b y_b ,

    so that uu_iso = cos²φ · uu_LSP for beams on one cone of half-angle φ about the wind, without noise the ends of
    0 ≤ (vv + ww)/2 ≤ uu where the beams are evenly spaced. Table 1 of [1]_ follows, where beams differ in angle, not
    the mean but Σ n₁² y / Σ n₁², the first of Eqs. (7) for isotropic stresses. ``"lsq-no-cross"`` is the fit of
    Fig. 6 of [1]_. ``"lsq-reduced"`` is the simplified estimate of [2]_, with the signs of n·R n where its formula
    has a minus before uv and uw.

    What the beams do not determine is NaN, never a minimum-norm solution: a linear combination v·R of the stresses is
    determined if vᵀB is in the row space of A B, to 1e-7. A stress that a method only assumes is NaN as well.
    ``"lsq-reduced"`` neglects vv and ww, and zeros there are realizable only if there are no covariances.

    Standard errors are of first order: with ĉ = M y,

    .. math::
        \mathrm{Cov}[\hat R] = B M \, \mathrm{diag}(m) \, K \, \mathrm{diag}(m) \, M^T B^T, \qquad m = A B \hat c_{W=1},

    the noise's relative covariance K times the variances of the unweighted fit; for W = (diag(m) K diag(m))⁻¹ too. A
    record that this fit gives a used beam a variance not above zero, or that has no wind speed, has no standard error,
    and with ``weights="noise"`` no estimate. They hold the scatter about what the method gives on average, not its
    bias from a wrong assumption. The estimates are of R of the record, its own mean removed.

    The default ratios are those of the standard deviations σ_v = 0.8 σ_u, σ_w = 0.5 σ_u, which IEC 61400-1 allows with
    the Kaimal spectrum, as told in [3]_.

    References
    ----------
    .. [1] Fu, Sebastiani, Peña and Mann (2022), J. Phys.: Conf. Ser. 2265, 022016, doi:10.1088/1742-6596/2265/2/022016.
    .. [2] Vogt, Jakobsen, Snæbjörnsson, Li, Obhrai and Roemer (2024), Flow observations using nacelle lidars,
       EERA DeepWind Conference, Trondheim (slides).
    .. [3] Burton, Sharpe, Jenkins and Bossanyi (2001), Wind Energy Handbook, Wiley, p. 22.

    Examples
    --------
    One cone sees uu only together with vv + ww:

    >>> from bayes_rs.geometry.forward import radial_variance
    >>> from bayes_rs.geometry.scan_file import load_scan
    >>> scan = load_scan("50-beam")
    >>> variance = radial_variance(scan, [[1.8, 0.9, 0.5, 0.1, -0.4, 0.0]])
    >>> records = xr.Dataset(
    ...     {
    ...         "variance": (("record", "beam"), variance),
    ...         "flag": (("record", "beam"), np.zeros(variance.shape, dtype=int)),
    ...         "yaw": ("record", [0.0]),
    ...     },
    ...     coords={"beam": scan.beam},
    ... )
    >>> estimate(records, scan)["stress"].values.round(6) + 0.0
    array([[ nan,  nan,  nan,  0.1, -0.4,  0. ]])
    >>> [round(float(estimate(records, scan, method=name)["stress"][0, 0]), 3) for name in ("isotropy", "ratio", "lsp")]
    [1.726, 1.793, 1.85]
    """
    scan = _checked_scan(records, as_scan(scan))
    records = believed(records)
    form = _chosen_form(method, ratio_vv, ratio_ww)
    wanted = _coefficients(combinations)
    if check_choice(weights, WEIGHTS, what="weights") == "noise" and noise is None:
        raise InputError("Invalid weights 'noise' without noise: give noise=, as bayes_rs.noise.calibrate returns it.")
    found = given_noise(noise)
    noise = None if found is None else _checked_noise(records, scan, found)

    variance = np.asarray(records["variance"].values, dtype=np.float64)
    yaw = np.deg2rad(np.asarray(records["yaw"].values, dtype=np.float64))
    used = (records["flag"].values == 0) & (variance > 0.0) & np.isfinite(variance) & np.isfinite(yaw)[:, None]
    # the tensor's six rows come last: realizability needs them, the method's own stresses are among them
    rows = np.concatenate([wanted, _IDENTITY])
    solved = Solved.empty(len(variance), len(rows))
    n_outside = 0
    size = max(1, _CHUNK_NUMBERS // (scan.n_beam * (len(STRESSES) if noise is None else scan.n_beam)))
    for start in range(0, len(variance), size):
        part = slice(start, start + size)
        design = np.where(used[part, :, None], design_matrix(scan.at_yaw(np.nan_to_num(yaw[part]))), 0.0) @ form.basis
        data = np.where(used[part], variance[part], 0.0)
        inverse, seen = pseudo_inverse(design)
        mean = np.einsum("rbp,rpc,rc->rb", design, inverse, data)
        covariance = None
        if noise is not None:
            known = _has_noise(records, part, used[part], mean)
            relative, outside = _relative_covariance(noise, records, part, yaw[part], known)
            n_outside += outside
            scale = np.where(used[part], np.where(known[:, None], mean, 1.0), 1.0)
            if weights == "noise":
                inverse = _weighted_inverse(design, scale, relative, used[part], known)
                inverse[~known] = np.nan
            covariance = np.where(known[:, None, None], scale[:, :, None] * relative * scale[:, None, :], np.nan)
        solved.put(part, rows @ form.basis, inverse, seen, data, covariance)
    names = list(combinations or {})
    return _dataset(records, form, solved, names, has_noise=noise is not None).assign_attrs(
        {
            "method": method,
            "assumption": form.assumption,
            "weights": weights,
            "scan": scan.name,
            "scan_key": scan.key,
            **({} if noise is None else {"n_outside_noise": n_outside}),
        }
    )


def _weighted_inverse(
    design: FloatArray, scale: FloatArray, relative: FloatArray, used: BoolArray, known: BoolArray
) -> FloatArray:
    """Return M of ĉ = M y for W = (diag(m) K diag(m))⁻¹; `scale` holds m, K has unit pivots at unused beams."""
    pairs = used[:, :, None] & used[:, None, :] & known[:, None, None]
    matrix = np.where(pairs, relative, np.eye(used.shape[1]))
    size = np.sqrt(np.einsum("rbb->rb", matrix))
    smallest = np.linalg.eigvalsh(matrix / (size[:, :, None] * size[:, None, :]))[:, 0]
    worst = int(np.argmin(smallest))
    if not smallest[worst] > used.shape[1] * np.finfo(np.float64).eps:
        raise NotPositiveDefiniteError(
            f"The noise's correlation matrix is singular: its smallest eigenvalue is {smallest[worst]:.3g} and must be "
            "positive; use weights='none', or noise from theory.",
            smallest_eigenvalue=float(smallest[worst]),
        )
    root = np.linalg.cholesky(matrix)
    whitening = np.linalg.solve(root, np.eye(used.shape[1]) / scale[:, None, :])
    return np.asarray(pseudo_inverse(whitening @ design)[0] @ whitening)


def _has_noise(records: xr.Dataset, part: slice, used: BoolArray, mean: FloatArray) -> BoolArray:
    """Tell which records have a wind speed, a beam, and a fit that gives no used beam a variance of zero or less."""
    speed = np.asarray(records["wind_speed"].values[part], dtype=np.float64)
    positive = np.where(used, mean > 0.0, True).all(axis=1)
    return np.asarray((speed > 0.0) & np.isfinite(speed) & used.any(axis=1) & positive)


def _relative_covariance(
    noise: Noise, records: xr.Dataset, part: slice, yaw: FloatArray, known: BoolArray
) -> tuple[FloatArray, int]:
    """Return K of each record, zeros where it is not known, and how many records are outside the noise."""
    relative = np.zeros((len(yaw), noise.n_beam, noise.n_beam))
    if not known.any():
        return relative, 0
    speed = np.asarray(records["wind_speed"].values[part], dtype=np.float64)[known]
    own = {
        name: np.asarray(records[name].values[part], dtype=np.float64)[known]
        for name in ("length_scale", "gamma")
        if name in records
    }
    at_record = noise.for_records(speed, yaw[known], **own)
    relative[known] = at_record.covariance
    return relative, int(np.count_nonzero(at_record.outside))


def _chosen_form(method: str, ratio_vv: float, ratio_ww: float) -> StressForm:
    ratios = (
        check_non_negative(ratio_vv, what="ratio_vv", unit=""),
        check_non_negative(ratio_ww, what="ratio_ww", unit=""),
    )
    make = ESTIMATORS[check_choice(method, tuple(ESTIMATORS), what="method of estimation")]
    if method != "ratio" and ratios != IEC_RATIOS:
        raise InputError(
            f"Invalid ratio_vv {ratio_vv!r} and ratio_ww {ratio_ww!r} for the method {method!r}: only 'ratio' assumes "
            "them; use it, or leave them out."
        )
    return make(*ratios)


def _coefficients(combinations: Mapping[str, ArrayLike] | None) -> FloatArray:
    if combinations is not None and not isinstance(combinations, Mapping):
        raise InputError(
            f"Invalid combinations {in_short(combinations)}: it must be a mapping from names to six coefficients."
        )
    rows = [
        check_array(row, (len(STRESSES),), what=f"coefficients of the combination {name!r}")
        for name, row in (combinations or {}).items()
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, len(STRESSES))


def _checked_scan(records: xr.Dataset, scan: Scan) -> Scan:
    """Check the records and return the scan with only the beams that they hold."""
    check_layout(records, "variance", "flag", "yaw")
    return scan.select(records["beam"].values)


def _checked_noise(records: xr.Dataset, scan: Scan, noise: Noise) -> Noise:
    """Check that the noise was made for the records; return that of their beams."""
    if "wind_speed" not in records or records["wind_speed"].dims != ("record",):
        raise InputError(
            "The records have no wind_speed with dims ('record',), which noise depends on: make them with "
            "bayes_rs.make_records."
        )
    chosen = noise.select(scan.beam)
    chosen.check_scan(scan)
    of_records = float(records.attrs.get("duration", chosen.duration))
    if not np.isclose(of_records, chosen.duration):
        raise InputError(
            f"The records last {of_records:g} s and the noise is for records of {chosen.duration:g} s: "
            "calibrate the noise for the records' duration."
        )
    return chosen


def _dataset(records: xr.Dataset, form: StressForm, solved: Solved, names: list[str], *, has_noise: bool) -> xr.Dataset:
    """Lay out the estimates: first those of the named combinations, then those of the six stresses."""
    count = len(names)
    of_stresses = solved.take(slice(count, None), np.isin(STRESSES, form.estimated))
    variables = _variables(of_stresses, "component", "stress", "", has_noise=has_noise)
    variables["realizable"] = (("record",), _realizable(form, solved.take(slice(count, None), True)), {})
    coords: dict[str, object] = {"component": list(STRESSES)}
    if names:
        of_names = solved.take(slice(0, count), True)
        variables |= _variables(of_names, "name", "combination", "combination_", has_noise=has_noise)
        coords["name"] = names
    if "time" in records.coords:
        coords["time"] = records["time"]
    return xr.Dataset(variables, coords=coords)


def _variables(
    solved: Solved, dim: str, name: str, prefix: str, *, has_noise: bool
) -> dict[str, tuple[tuple[str, ...], NDArray[np.generic], dict[str, str]]]:
    dims, unit = ("record", dim), {"units": "m2 s-2"}
    words = {"long_name": "whether the record's beams determine it, given what the method assumes"}
    variables: dict[str, tuple[tuple[str, ...], NDArray[np.generic], dict[str, str]]] = {
        name: (dims, solved.value, unit),
        f"{prefix}identified": (dims, solved.identified, words),
    }
    return variables | ({f"{prefix}standard_error": (dims, solved.error, unit)} if has_noise else {})


def _realizable(form: StressForm, solved: Solved) -> BoolArray:
    """Tell which records have a tensor, zero where the method says so, and a realizable one."""
    stated = np.any(form.basis, axis=1)
    tensor = np.where(stated, solved.value, 0.0)
    whole = np.isfinite(tensor).all(axis=1)
    realizable = np.zeros(len(tensor), dtype=np.bool_)
    realizable[whole] = is_realizable(tensor[whole])
    return realizable
