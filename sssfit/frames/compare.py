"""How far an image is from a reference that itself has noise.

A reference comes as the mean `sss` of two independent halves a and b and half their difference, `diff`. The
mean of (f - a) (f - b) is the squared error of the image f without the reference's noise, for the errors of a
and b average out of the product. As a difference of large numbers it may come out below 0 or below its own
standard error: then nothing but the reference's noise was measured, and the result says so.

All is summed in float64 on the host, over the pixels of a mask.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jax.typing import ArrayLike

#: Fewer replicates than this make no standard error worth the name.
LEAST_REPLICATES = 8


@dataclass(frozen=True)
class Comparison:
    """An image measured against a reference.

    Attributes:
        pixels: how many were compared.
        mse: mean squared error over pixels and channels, free of the reference's noise; may be negative.
        mse_se: its standard error, over pixels as a sample; the three channels of a pixel count as one.
        mse_below_error: whether mse is below mse_se, so that the image is as good as the reference can tell.
        psnr: 10 log10(psnr_peak^2 / mse), dB; infinite for mse <= 0.
        psnr_peak: largest value of the reference in the mask, over all channels.
        relative_l2: per channel, sqrt(mse of the channel / mean of a b); 0 where that mse is negative, NaN
            where the mean of a b is not positive.
        relative_l2_below_error: per channel, whether its mse is below its own standard error.
        raw_mse: mean of (f - sss)^2 over pixels and channels, the reference's noise included.
        raw_psnr: psnr of raw_mse.
        raw_relative_l2: per channel, sqrt(mean of (f - sss)^2 / mean of sss^2).
        bias: per channel, mean of f - sss.
        bias_se: per channel, standard error of bias from the image's noise and the reference's; None
            without replicates.

    Example:
        >>> reference = np.full((4, 4, 3), 2.0)
        >>> found = compare(reference + 0.5, reference, np.zeros((4, 4, 3)), np.ones((4, 4), bool))
        >>> found.mse, found.bias, found.relative_l2
        (0.25, (0.5, 0.5, 0.5), (0.25, 0.25, 0.25))
    """

    pixels: int
    mse: float
    mse_se: float
    mse_below_error: bool
    psnr: float
    psnr_peak: float
    relative_l2: tuple[float, ...]
    relative_l2_below_error: tuple[bool, ...]
    raw_mse: float
    raw_psnr: float
    raw_relative_l2: tuple[float, ...]
    bias: tuple[float, ...]
    bias_se: tuple[float, ...] | None


def compare(
    image: ArrayLike,
    sss: ArrayLike,
    diff: ArrayLike,
    mask: ArrayLike,
    *,
    replicates: Iterable[ArrayLike] | None = None,
) -> Comparison:
    """Measure an image against a reference.

    Args:
        image: the image f, shape (H, W, 3).
        sss: the reference, the mean of its halves, same shape and unit.
        diff: half the difference of the reference's halves, same shape; zeros for one without noise.
        mask: the pixels to compare, boolean, shape (H, W). The others may hold anything.
        replicates: independent runs of the settings that made the image, with other random numbers, at
            least 8, each of the image's shape; an array (K, H, W, 3), or made one at a time. None where the
            image has no randomness to repeat. The image itself is not one of them, nor their mean.

    Returns:
        `Comparison`. The standard error of the bias takes the image's from the spread of the replicates'
        means, which holds whatever the noise of pixels has in common, and the reference's from diff, whose
        pixels it takes to be independent.

    Raises:
        ValueError: shapes that differ, an empty mask, values in the mask that are not finite (how many and
            where), or fewer than 8 replicates.

    Source: cross validation of two halves, as in the frames' own description; Bessel's correction.

    Example:
        >>> sss, mask = np.ones((2, 2, 3)), np.ones((2, 2), bool)
        >>> runs = np.random.default_rng(1).normal(1, 0.1, (9, 2, 2, 3))
        >>> found = compare(runs[0], sss, 0 * sss, mask, replicates=runs[1:])
        >>> found.bias_se is not None and all(0.01 < error < 0.1 for error in found.bias_se)
        True
    """
    chosen = _mask(mask)
    f = _pixels("image", image, chosen)
    mean, half = _pixels("sss", sss, chosen), _pixels("diff", diff, chosen)
    a, b = mean + half, mean - half
    product = (f - a) * (f - b)
    mse, mse_se = _mean_and_error(product.mean(axis=1))
    channels = [_mean_and_error(product[:, c]) for c in range(3)]
    peak, raw_mse = float(mean.max()), float(np.mean(np.square(f - mean)))
    raw = np.mean(np.square(f - mean), axis=0)
    return Comparison(
        pixels=len(f),
        mse=mse,
        mse_se=mse_se,
        mse_below_error=mse < mse_se,
        psnr=_decibels(peak, mse),
        psnr_peak=peak,
        relative_l2=tuple(
            _root_ratio(channel, power)
            for (channel, _), power in zip(channels, np.mean(a * b, axis=0), strict=True)
        ),
        relative_l2_below_error=tuple(channel < error for channel, error in channels),
        raw_mse=raw_mse,
        raw_psnr=_decibels(peak, raw_mse),
        raw_relative_l2=tuple(
            _root_ratio(channel, power)
            for channel, power in zip(raw, np.mean(np.square(mean), axis=0), strict=True)
        ),
        bias=tuple(np.mean(f - mean, axis=0).tolist()),
        bias_se=None if replicates is None else _bias_error(replicates, half, chosen),
    )


def _bias_error(replicates: Iterable[ArrayLike], half: np.ndarray, mask: np.ndarray) -> tuple[float, ...]:
    """Standard error of the mean of image - reference, per channel."""
    # One at a time: all of them may not fit in memory.
    means = np.array([_pixels(f"replicate {k}", run, mask).mean(axis=0) for k, run in enumerate(replicates)])
    if len(means) < LEAST_REPLICATES:
        raise ValueError(f"replicates must be at least {LEAST_REPLICATES} images, got {len(means)}")
    of_reference = np.square(half).sum(axis=0) / len(half) ** 2
    return tuple(np.sqrt(means.var(axis=0, ddof=1) + of_reference).tolist())


def _mask(mask: ArrayLike) -> np.ndarray:
    chosen = np.asarray(mask)
    if chosen.ndim != 2 or chosen.dtype != bool:
        raise ValueError(f"mask must be boolean of shape (H, W), got {chosen.dtype} of {chosen.shape}")
    if not chosen.any():
        raise ValueError("mask must hold at least one pixel, got none")
    return chosen


def _pixels(name: str, image: ArrayLike, mask: np.ndarray) -> np.ndarray:
    """The masked pixels of an image in float64, shape (P, 3)."""
    array = np.asarray(image)
    if array.shape != (*mask.shape, 3):
        raise ValueError(f"{name} must have shape {(*mask.shape, 3)} as the mask has, got {array.shape}")
    pixels = array[mask].astype(np.float64)
    wrong = ~np.isfinite(pixels).all(axis=1)
    if wrong.any():
        row, column = np.argwhere(mask)[wrong][0].tolist()
        raise ValueError(
            f"{name} must be finite in the mask, got {int(wrong.sum())} pixels that are not, "
            f"the first at column {column}, row {row}"
        )
    return pixels


def _mean_and_error(sample: np.ndarray) -> tuple[float, float]:
    """Mean and its standard error; of a single number the error is not known and infinite."""
    error = sample.std(ddof=1) / math.sqrt(len(sample)) if len(sample) > 1 else math.inf
    return float(sample.mean()), float(error)


def _decibels(peak: float, mse: float) -> float:
    if mse <= 0:
        return math.inf
    return 20 * math.log10(peak) - 10 * math.log10(mse) if peak > 0 else -math.inf


def _root_ratio(squared: float, power: float) -> float:
    return math.sqrt(max(squared, 0.0) / power) if power > 0 else math.nan
