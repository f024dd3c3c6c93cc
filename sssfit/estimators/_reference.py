"""The moving moments by other means, to measure the recursions against: explicit weights, and filters."""

import numpy as np


def explicit(xs: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance after each sample by the weights' definition, in extended precision; O(T^2)."""
    xs, share = xs.astype(np.longdouble), np.longdouble(alpha)
    age = np.subtract.outer(np.arange(len(xs)), np.arange(len(xs)))
    decays = (1 - share) ** np.arange(len(xs))
    weights = np.where(age >= 0, share * decays[np.maximum(age, 0)], 0)
    # The first sample carries what all those before it would have.
    weights[:, 0] = decays
    mean = weights @ xs
    return mean, np.sum(weights * np.square(xs[None, :] - mean[:, None]), axis=1)


def filtered(xs: np.ndarray, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance after each sample by recursive filters in float64; O(T), for long streams."""
    from scipy.signal import lfilter

    start = float(xs[0])
    # Deviations from the first sample, so that the filter starts from 0.
    shifted = xs.astype(np.float64) - start
    mean = np.asarray(lfilter([alpha], [1, alpha - 1], shifted))
    before = np.concatenate([[0.0], mean[:-1]])
    variance = np.asarray(lfilter([alpha * (1 - alpha)], [1, alpha - 1], np.square(shifted - before)))
    return mean + start, variance
