"""What can be known of the sample counts before the first frame: targets, steady states, times.

Exact where a formula exists. The feedback of the count on its own variance has none, and the closed forms
here are those of small deviations, where the history is long and kappa small; how far off they are elsewhere
is measured in the documentation.

Source: Xie, dissertation, 2021, Eq 2.25-2.28 (the target); linearization of Xie and Olano 2021, Eq 5-10,
derived here.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.estimators import bias
from sssfit.estimators.sample_count import Controller


def target_variance(
    sample_variance: ArrayLike, max_spp: ArrayLike, *, confidence: ArrayLike = 0.95
) -> np.ndarray:
    """The target that a budget can keep: from the samples' variance and the most samples allowed.

    Args:
        sample_variance: largest variance of single samples to be met, with the divisor n, in the squared
            unit of what is sampled.
        max_spp: the most samples of a pixel, >= 2.
        confidence: probability, in (0, 1), that the mean of max_spp samples of that variance has at most
            the returned variance; for normal samples. It does not hold for two-valued ones.

    Returns:
        sample_variance / chi2.ppf(1 - confidence, max_spp - 1), a NumPy array or number.

    Raises:
        ValueError: max_spp is below 2 or confidence outside (0, 1).

    Source: dissertation Eq 2.27-2.28.

    Example:
        >>> round(float(target_variance(0.04, 64)), 7)
        0.0008745
    """
    from scipy.special import chdtri

    max_spp, confidence = np.asarray(max_spp), np.asarray(confidence)
    if np.any(max_spp < 2):
        raise ValueError(f"max_spp must be at least 2, got {max_spp}; one sample has no variance")
    if np.any((confidence <= 0) | (confidence >= 1)):
        raise ValueError(f"confidence must be in (0, 1), got {confidence}")
    # chdtri inverts the survival function, which is accurate for either tail.
    return np.asarray(sample_variance) / chdtri(max_spp - 1.0, confidence)


def neutral_count(population_variance: ArrayLike, *, target_variance: ArrayLike, alpha: ArrayLike) -> Array:
    """The count at which the controller neither adds nor takes away, were there no noise.

    Args:
        population_variance: variance of one sample.
        target_variance: the controller's, > 0.
        alpha: weight of the newest frame, in (0, 1].

    Returns:
        (2 - 2 alpha) / (2 - alpha) times population_variance / target_variance: the moving variance
        expects that share of the frames' variance, so the target is met with fewer samples than the
        count's ideal, population_variance / target_variance.

    Source: the expectation of Eq 6 of Xie and Olano 2021.

    Example:
        >>> round(float(neutral_count(0.27324, target_variance=0.08**2, alpha=0.2)), 2)
        37.95
    """
    alpha = jnp.asarray(alpha)
    return (2 - 2 * alpha) / (2 - alpha) * (jnp.asarray(population_variance) / target_variance)


class SteadyState(NamedTuple):
    """The count in the long run, without bounds and rounding, for small deviations.

    Attributes:
        neutral: `neutral_count`.
        mean: expected count.
        deviation: its standard deviation.
        response: factor of a deviation from one frame to the next; negative overshoots.
    """

    neutral: Array
    mean: Array
    deviation: Array
    response: Array


def steady_state(
    controller: Controller, population_variance: ArrayLike, *, excess_kurtosis: ArrayLike = 0.0
) -> SteadyState:
    """Mean and spread of the count that a controller settles at.

    Its relative deviation is a first-order autoregression z' = r z + b e with r = (1 - alpha)(1 - 2 kappa),
    b = alpha + 2 kappa (1 - alpha), and e the relative noise of the squared deviation of one frame. The mean
    is above the neutral count by the variance of z, to second order; and since counts are made by
    multiplying, their deviation is that of a log-normal distribution with the variance of z.

    Args:
        controller: with the metric "accumulated"; its bounds and rounding are left out.
        population_variance: variance of one sample.
        excess_kurtosis: of one sample; 0 for normal ones.

    Returns:
        A `SteadyState`: mean and deviation within 0.5 % and 2 % while deviation / mean is below 0.2, as for
        alpha and kappa up to 0.01. Above about 1/3, as for the papers' constants, bounds and large
        deviations rule, and it does not describe the count.

    Raises:
        ValueError: the metric has no such steady state.

    Source: linearization of Xie and Olano 2021, Eq 5-10, derived here.

    Example:
        >>> calm = steady_state(Controller(1e-3, alpha=0.01, kappa=0.0), 0.04)
        >>> [round(float(v), 3) for v in calm]
        [39.799, 40.199, 4.043, 0.99]
    """
    if controller.metric != "accumulated":
        raise ValueError(f"steady_state needs the metric 'accumulated', got {controller.metric!r}")
    alpha, kappa = jnp.asarray(controller.alpha), jnp.asarray(controller.kappa)
    neutral = neutral_count(population_variance, target_variance=controller.target_variance, alpha=alpha)
    kept = 1 - alpha
    response, gain = kept * (1 - 2 * kappa), alpha + 2 * kappa * kept
    spread = bias.emv_moments(alpha, kurtosis=3 + excess_kurtosis / neutral).deviation
    noise = jnp.square(spread) * (2 - alpha) / alpha
    variance = jnp.square(gain) * noise / (1 - jnp.square(response))
    # Variance of the history's relative deviation, in units of the count's.
    smoothed = alpha / (2 - alpha) * (1 + kept * response) / (1 - kept * response)
    lagging = 2 * alpha * response / (1 - kept * response)
    history = jnp.square(alpha / gain) * (1 + smoothed - lagging)
    mean = neutral * (1 + variance * (1 - gain / 2 * history))
    return SteadyState(neutral, mean, mean * jnp.sqrt(jnp.expm1(variance)), response)


def frames_to_forget(alpha: ArrayLike, share: ArrayLike) -> Array:
    """Frames until only a share of the past is left in a moving mean.

    Args:
        alpha: weight of the newest frame, in (0, 1].
        share: in (0, 1).

    Returns:
        Smallest whole n with (1 - alpha)^n <= share, as a float; 1 for alpha = 1.

    Source: dissertation Eq B.18.

    Example:
        >>> float(frames_to_forget(0.2, 0.08))
        12.0
    """
    frames = jnp.log(jnp.asarray(share)) / jnp.log1p(-jnp.asarray(alpha))
    whole = jnp.round(frames)
    # Where the share is a power of the decay, rounding of the logarithms decides on which side it falls.
    is_whole = jnp.abs(frames - whole) <= 4 * jnp.finfo(frames.dtype).eps * frames
    return jnp.maximum(jnp.where(is_whole, whole, jnp.ceil(frames)), 1)


def frames_to_converge(
    frame_variance: ArrayLike, mean: ArrayLike, *, target_variance: ArrayLike, alpha: ArrayLike
) -> Array:
    """Frames from a cold start until the expected moving variance is down to the target.

    A history of zeros takes the first frames for a change of the mean from 0; the variance that this
    leaves fades with it. The number of samples is taken to be constant, as it is at its upper bound.

    Args:
        frame_variance: variance of a frame's result, population variance / samples.
        mean: expected result of a frame.
        target_variance: > 0.
        alpha: weight of the newest frame, in (0, 1).

    Returns:
        Whole number of frames from which on it stays there, as a float; 1 where it never is above; inf
        where frame_variance is above what the target allows, target (2 - alpha) / (2 - 2 alpha).

    Source: expectation of Xie et al. 2020, Eq 9, from zero, derived here.

    Example:
        >>> float(frames_to_converge(0.27324 / 64, 1.0, target_variance=0.08**2, alpha=0.2))
        27.0
    """
    variance, alpha = jnp.asarray(frame_variance), jnp.asarray(alpha)
    square = jnp.square(jnp.asarray(mean))
    share = alpha / (2 - alpha)
    # Expected variance less the target, a w^2 + b w + c in the weight w = (1 - alpha)^n of the zeros.
    a, b, c = variance * share - square, square - variance, variance * (1 - share) - target_variance
    discriminant = jnp.square(b) - 4 * a * c
    root = jnp.sqrt(jnp.maximum(discriminant, 0))
    # The smaller weight, by the form that does not subtract near numbers.
    weight = jnp.where(b >= 0, -2 * c / (b + root), (root - b) / (2 * a))
    frames = jnp.ceil(jnp.log(jnp.where(weight > 0, weight, 1)) / jnp.log1p(-alpha))
    # The zeros count for so little that the expectation is below the target all the way.
    always_below = (discriminant <= 0) | (b <= 0)
    frames = jnp.where(always_below, 1, jnp.where(c == 0, jnp.inf, jnp.maximum(frames, 1)))
    return jnp.where(c > 0, jnp.inf, frames)
