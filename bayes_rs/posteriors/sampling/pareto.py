"""How heavy the tail of importance weights is, for many sets of weights at once."""

from __future__ import annotations

import numpy as np

from bayes_rs._validation import FloatArray


def pareto_k(log_weight: FloatArray) -> FloatArray:
    """Fit a generalized Pareto distribution to the largest importance weights.

    Parameters
    ----------
    log_weight : ndarray, shape (n_set, n_draw)
        Logarithms of the weights, up to a constant of the set.

    Returns
    -------
    k : ndarray, shape (n_set,)
        Shape parameter: below 0.7 the weighted means can be trusted, above 1 the weights have no mean. It is −∞ for
        weights that are all equal.

    Notes
    -----
    The tail is the largest min(n/5, 3 √n) weights. Its excesses over the weight before them are fitted by the empirical
    Bayes estimate of Zhang and Stephens (2009), with the weak prior of ten observations at k = ½ of Vehtari et al.

    References
    ----------
    Zhang and Stephens (2009), Technometrics 51, 316–325, doi:10.1198/tech.2009.08017, Eqs. 3 to 6.
    Vehtari, Simpson, Gelman, Yao and Gabry (2024), J. Mach. Learn. Res. 25(72), 1–58.
    """
    n_draw = log_weight.shape[-1]
    n_tail = int(np.ceil(min(0.2 * n_draw, 3.0 * np.sqrt(n_draw))))
    largest = np.sort(np.partition(log_weight, n_draw - n_tail - 1, axis=-1)[:, n_draw - n_tail - 1 :], axis=-1)
    scaled = np.exp(largest - largest[:, -1:])
    excess = scaled[:, 1:] - scaled[:, :1]
    equal = excess[:, -1] <= 0.0
    excess = np.where(equal[:, None], 1.0, excess)
    n_point = 30 + int(np.sqrt(n_tail))
    quartile = np.maximum(excess[:, int(n_tail / 4.0 + 0.5) - 1], np.finfo(np.float64).tiny)
    step = 1.0 - np.sqrt(n_point / (np.arange(1, n_point + 1) - 0.5))
    theta = step / (3.0 * quartile[:, None]) + 1.0 / excess[:, -1:]  # (n_set, n_point)
    product = -theta[:, :, None] * excess[:, None, :]
    shape = np.mean(np.log1p(product, out=product), axis=-1)
    profile = n_tail * (np.log(-theta / shape) - shape - 1.0)
    weight = np.exp(profile - profile.max(axis=1, keepdims=True))
    weight = weight / weight.sum(axis=1, keepdims=True)
    weight = np.where(weight >= 10.0 * np.finfo(np.float64).eps, weight, 0.0)
    best = np.sum(theta * weight, axis=1) / weight.sum(axis=1)
    k = np.mean(np.log1p(-best[:, None] * excess), axis=1)
    return np.where(equal, -np.inf, (k * n_tail + 5.0) / (n_tail + 10.0))
