"""Errors of a lidar's turbulence intensity against a reference: the numbers that the industry accepts by."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayes_rs._validation import FloatArray

BIAS_LIMIT = 0.05
"""Mean relative bias error up to which DNV-RP-0661 accepts turbulence intensity for the verification of loads."""
RRMSE_LIMIT = 0.15
"""Relative root mean square error up to which it does."""
REPRESENTATIVE = 1.28
"""Standard deviations above the mean of a bin that representative turbulence has by IEC 61400-1: 90 % of a normal."""
METRIC_COLUMNS = (
    "bin", "wind_speed", "n_record", "measured", "reference", "mrbe", "mrbe_se", "rrmse", "coverage",
    "measured_representative", "reference_representative", "representative_error",
)  # fmt: skip
"""Columns of `intensity_errors`."""
ALL_SPEEDS = "all"


def mean_relative_bias(measured: FloatArray, reference: FloatArray) -> float:
    """Return the mean relative bias error, the mean of (measured − reference)/reference over the records."""
    return float(np.mean(measured / reference - 1.0))


def relative_rmse(measured: FloatArray, reference: FloatArray) -> float:
    """Return the relative root mean square error, the root of the mean of ((measured − reference)/reference)²."""
    return float(np.sqrt(np.mean((measured / reference - 1.0) ** 2)))


def representative_intensity(intensity: FloatArray) -> float:
    """Return the representative turbulence intensity of a bin, mean + 1.28 sd of the records; NaN for fewer than two.

    Examples
    --------
    >>> representative_intensity(np.array([0.10, 0.12, 0.14]))
    0.1456
    """
    if len(intensity) < 2:
        return float("nan")
    return float(intensity.mean() + REPRESENTATIVE * intensity.std(ddof=1))


def intensity_errors(
    measured: FloatArray, low: FloatArray, high: FloatArray, reference: FloatArray, wind_speed: FloatArray
) -> pd.DataFrame:
    r"""Return the errors of turbulence intensity over all records and in bins of wind speed.

    Parameters
    ----------
    measured, low, high : ndarray, shape (n_record,)
        The lidar's turbulence intensity of each record and the ends of its interval.
    reference : ndarray, shape (n_record,)
        That of the reference; NaN where there is none.
    wind_speed : ndarray, shape (n_record,)
        Mean wind speed that the records are sorted by, m/s.

    Returns
    -------
    table : DataFrame
        A row for all records and one for each bin of 1 m/s about a whole number that holds any: ``bin``,
        ``wind_speed`` (that of the bin), ``n_record``, means ``measured`` and ``reference``, ``mrbe`` with its standard
        error ``mrbe_se`` (NaN for one record), ``rrmse``, and ``coverage``, the share of the records whose interval
        holds the reference; in bins ``measured_representative``, ``reference_representative`` and the relative error
        ``representative_error`` of the first. Records that lack a number are left out.

    Notes
    -----
    With the relative error :math:`e_k = (I_k - I^\mathrm{ref}_k)/I^\mathrm{ref}_k` of record k of n,

    .. math::
        \mathrm{MRBE} = \frac{1}{n} \sum_k e_k , \qquad \mathrm{RRMSE} = \sqrt{\frac{1}{n} \sum_k e_k^2} .

    Representative turbulence intensity of a bin is :math:`\bar I + 1.28\, s_I` with the standard deviation s of its
    records. IEC 61400-1 has this for the standard deviation of the wind speed, where 1.28 makes the 90 % quantile of a
    normal distribution; of the intensity it is what comparisons of lidars with masts quote. Over all wind speeds it
    would be of the wind speeds, too, and is NaN. The medians of a lidar scatter by their own errors as well, and a
    prior draws them together: both are in its representative intensity.

    The standard error takes the records for independent, and is too small where neighbours are not. DNV-RP-0661 is for
    vertical profilers on the ground beside a mast: nacelle lidars are outside its scope.

    References
    ----------
    DNV (2023), Lidar-measured turbulence intensity for wind turbines, DNV-RP-0661, edition September 2023.
    IEC 61400-1:2019, Wind energy generation systems, part 1: design requirements.

    Examples
    --------
    >>> one = np.array([0.11, 0.22])
    >>> table = intensity_errors(one, 0.9 * one, 1.1 * one, np.array([0.10, 0.20]), np.array([8.0, 8.2]))
    >>> [round(float(table[name][0]), 3) for name in ("mrbe", "rrmse", "coverage")]
    [0.1, 0.1, 1.0]
    """
    known = np.all([np.isfinite(one) for one in (measured, low, high, reference, wind_speed)], axis=0) & (
        np.nan_to_num(reference) > 0.0
    )
    from bayes_rs.campaign.cells import bin_speed, speed_bin  # noqa: PLC0415 - a report without a reference needs none of it

    number = speed_bin(np.where(known, wind_speed, 0.0))
    parts = [(ALL_SPEEDS, np.nan, known)]
    for one in np.unique(number[known]).tolist():
        own = known & (number == one)
        parts.append((f"{max(one - 0.5, 0.0):g}-{one + 0.5:g} m/s", float(bin_speed(np.array([one]))[0]), own))
    rows = []
    for name, speed, own in parts:
        if not own.any():
            continue
        error, n = measured[own] / reference[own] - 1.0, int(own.sum())
        of_bin = name != ALL_SPEEDS
        ours, theirs = (representative_intensity(one[own]) if of_bin else np.nan for one in (measured, reference))
        rows.append(
            (
                name,
                speed,
                n,
                float(measured[own].mean()),
                float(reference[own].mean()),
                mean_relative_bias(measured[own], reference[own]),
                float(error.std(ddof=1) / np.sqrt(n)) if n > 1 else np.nan,
                relative_rmse(measured[own], reference[own]),
                float(np.mean((low[own] <= reference[own]) & (reference[own] <= high[own]))),
                ours,
                theirs,
                ours / theirs - 1.0,
            )
        )
    return pd.DataFrame(rows, columns=list(METRIC_COLUMNS))
