"""How many samples each pixel needs, as far as a first small pass over the frame can tell."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter


def counts(variance: ArrayLike, target_variance: float, least: int, most: int) -> np.ndarray:
    """Samples with which the mean of independent samples has the wanted variance.

    Args:
        variance: of one sample, (...), >= 0.
        target_variance: wanted of the mean, in the same unit, > 0.
        least, most: bounds of the result, 1 <= least <= most.

    Returns:
        ceil(variance / target_variance) within the bounds, int32, of the shape of `variance`.

    Raises:
        ValueError: a number out of its range.

    Source: the variance of a mean of n independent samples is that of one, divided by n.

    Example:
        >>> counts([0.0, 1.0, 100.0], 0.1, 2, 64)
        array([ 2, 10, 64], dtype=int32)
    """
    if not 0 < target_variance < math.inf:
        raise ValueError(f"target_variance must be a number above 0, got {target_variance:g}")
    if not 1 <= least <= most:
        raise ValueError(f"least and most must be 1 <= least <= most, got {least} and {most}")
    wanted = np.ceil(np.asarray(variance, np.float64) / target_variance)
    return np.clip(wanted, least, most).astype(np.int32)


def smoothed(variance: ArrayLike, profile_id: ArrayLike, width: int) -> np.ndarray:
    """Variances averaged over a square of pixels with the same profile.

    Args:
        variance: of one sample, (H, W), finite.
        profile_id: (H, W), whole numbers, 0 for the background.
        width: of the square, odd, in pixels; 1 changes nothing.

    Returns:
        (H, W) float64; 0 on the background. At the frame's edge the mean is that of what is inside.

    Raises:
        ValueError: `width` is not odd or below 1.

    Source: own; see docs/frames.md for what it gains.

    Example:
        >>> smoothed([[9.0, 0.0, 0.0]], [[1, 1, 2]], 3)
        array([[4.5, 4.5, 0. ]])
    """
    if width < 1 or width % 2 == 0:
        raise ValueError(f"width must be odd and at least 1, got {width}")
    values, ids = np.asarray(variance, np.float64), np.asarray(profile_id)
    found = np.zeros(values.shape)
    for number in np.unique(ids[ids > 0]):
        mask = ids == number
        total, share = (uniform_filter(np.where(mask, v, 0.0), width, mode="constant") for v in (values, 1.0))
        # A mean's running sum may round below 0, and no pixel is without itself.
        found[mask] = np.maximum(total[mask] / share[mask], 0)
    return found
