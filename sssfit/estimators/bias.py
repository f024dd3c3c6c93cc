"""Bias of adaptive sampling, and what a moving variance of few samples is worth.

`pilot_bias` is the classic scheme's: keep the pilot samples when they are all alike, else take the truth.
`controller_bias` follows this package's controller through every sequence of outcomes that a small budget
allows. `emv_moments` tells how far the moving variance of a finite past is from the variance, on average
and from one history to another.

Source: Kirk and Arvo, "Unbiased sampling techniques for image synthesis", 1991; Xie, dissertation, 2021,
Eq 2.29-2.34, whose Eq 2.31 lacks the exponents; moments derived here.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.estimators import _recursion, sample_count

#: As many branches as fit comfortably in memory.
MAX_BRANCHES = 2_000_000


def pilot_bias(
    values: ArrayLike | Sequence[float], probabilities: ArrayLike | Sequence[float], pilot: ArrayLike
) -> Array:
    """Expected error of a mean that trusts its pilot samples when they are all the same.

    Args:
        values: the distinct values that a sample takes, shape (..., k).
        probabilities: their probabilities, >= 0 and summing to 1, shape (..., k).
        pilot: number of pilot samples n >= 1, a number or an array of the leading shape.

    Returns:
        sum of p^n (v - mean), of the leading shape: 0 for n = 1, not monotone in n (the dissertation's
        "diminishes consistently" fails from 1 to 2), and 0 again for many. In the values' unit.

    Raises:
        ValueError: the shapes differ, pilot is below 1, or probabilities known on the host are negative or
            do not sum to 1 within 1e-4.

    Source: dissertation Eq 2.34, after Kirk and Arvo 1991.

    Example:
        >>> round(float(pilot_bias([0.0, 1.0], [0.9, 0.1], 2)), 4)
        -0.072
    """
    _check_distribution(values, probabilities)
    values, probabilities = jnp.asarray(values), jnp.asarray(probabilities)
    dtype = jnp.result_type(float, values, probabilities)
    values, probabilities = values.astype(dtype), probabilities.astype(dtype)
    if isinstance(pilot, int | float | np.ndarray | np.generic) and np.any(np.less(pilot, 1)):
        raise ValueError(f"pilot must be at least 1, got {pilot}")
    pilot = jnp.asarray(pilot)[..., None]
    mean = jnp.sum(probabilities * values, axis=-1, keepdims=True)
    return jnp.sum(jnp.power(probabilities, pilot) * (values - mean), axis=-1)


def _check_distribution(values: ArrayLike | Sequence, probabilities: ArrayLike | Sequence) -> None:
    if np.shape(values) != np.shape(probabilities) or not np.shape(values):
        raise ValueError(
            "values and probabilities must have one shape with a last axis, got "
            f"{np.shape(values)} and {np.shape(probabilities)}"
        )
    if isinstance(probabilities, np.ndarray | list | tuple):
        known = np.asarray(probabilities, np.float64)
        if np.any(known < 0) or np.any(np.abs(known.sum(axis=-1) - 1) > 1e-4):
            raise ValueError(f"probabilities must be >= 0 and sum to 1, got {known.tolist()}")


# Branches differ in number from frame to frame; op by op each would compile dozens of programs.
_next_count, _update = jax.jit(sample_count.next_count), jax.jit(sample_count.update)


class ControllerBias(NamedTuple):
    """Expectations of each frame over all that can happen, arrays of the number of frames.

    Attributes:
        frame: bias of the frame's own mean: 0, since its count was fixed before it was sampled.
        moving_mean: bias of the moving mean, also 0.
        pooled_mean: bias of the mean over all samples so far, which is not 0: a lucky frame's samples
            weigh less than those which it saves, or more.
        count: expected samples.
        frame_variance: mean squared error of the frame's mean.
    """

    frame: np.ndarray
    moving_mean: np.ndarray
    pooled_mean: np.ndarray
    count: np.ndarray
    frame_variance: np.ndarray


class _Branch(NamedTuple):
    """All that can have happened so far, one row each."""

    probability: np.ndarray
    history: sample_count.History
    count: np.ndarray
    total: np.ndarray
    drawn: np.ndarray


def controller_bias(
    values: ArrayLike | Sequence[float],
    probabilities: ArrayLike | Sequence[float],
    controller: sample_count.Controller,
    frames: int,
) -> ControllerBias:
    """Exact bias of a controlled pixel by enumeration of every outcome, in float64.

    Args:
        values: the k distinct values that a sample takes, shape (k,).
        probabilities: their probabilities, shape (k,).
        controller: with a small `max_spp`, since n samples have C(n + k - 1, n) outcomes.
        frames: number of frames from a missing history on, >= 1.

    Returns:
        A `ControllerBias`, exact up to rounding.

    Raises:
        ValueError: there are more than 2,000,000 branches, a pixel draws no sample (min_spp is 0), frames
            is below 1, or the distribution is none.

    Source: the expectation over Algorithm 1 of Xie and Olano 2021, as derived here.

    Example:
        >>> small = sample_count.Controller(0.05, min_spp=1, max_spp=3)
        >>> found = controller_bias([0.0, 1.0], [0.9, 0.1], small, frames=3)
        >>> bool(abs(found.moving_mean).max() < 1e-12), bool(abs(found.pooled_mean[2]) > 1e-3)
        (True, True)
    """
    _check_distribution(values, probabilities)
    values, probabilities = np.asarray(values, np.float64), np.asarray(probabilities, np.float64)
    if frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    truth = float(values @ probabilities)
    with jax.enable_x64(True):
        history = sample_count.init(np.zeros(1))
        count = np.asarray(_next_count(history, controller))
        branch = _Branch(np.ones(1), history, count, np.zeros(1), np.zeros(1))
        rows = []
        for frame in range(frames):
            branch, means = _branch_out(branch, values, probabilities, controller, missing=frame == 0)
            weight = branch.probability
            moving = np.asarray(branch.history.mean)
            rows.append(
                (
                    weight @ means - truth,
                    weight @ moving - truth,
                    weight @ (branch.total / branch.drawn) - truth,
                    weight @ branch.count,
                    weight @ (means - truth) ** 2,
                )
            )
            branch = branch._replace(count=np.asarray(_next_count(branch.history, controller)))
    return ControllerBias(*np.array(rows).T)


def _branch_out(branch: _Branch, values, probabilities, controller, *, missing: bool):
    """Every branch followed by every outcome of its samples, and those outcomes' means."""
    size = len(probabilities)
    numbers, occurring = np.unique(branch.count, return_counts=True)
    if numbers[0] < 1:
        raise ValueError("a frame without samples has no mean; min_spp must be at least 1")
    ways = (math.comb(int(n) + size - 1, size - 1) for n in numbers)
    branches = sum(int(rows) * way for rows, way in zip(occurring, ways, strict=True))
    if branches > MAX_BRANCHES:
        raise ValueError(
            f"{branches} branches exceed {MAX_BRANCHES}; use fewer frames or values, or a smaller max_spp"
        )
    parts = []
    for count in numbers:
        counts, chances = _outcomes(int(count), probabilities)
        rows = np.flatnonzero(branch.count == count)
        parts.append(
            (np.repeat(rows, len(chances)), np.tile(counts @ values, len(rows)), np.tile(chances, len(rows)))
        )
    rows, sums, chances = (np.concatenate(part) for part in zip(*parts, strict=True))
    count = branch.count[rows]
    means = sums / count
    history = jax.tree.map(lambda part: part[rows], branch.history)
    history = _update(history, means, count, controller, missing=missing)
    following = _Branch(
        branch.probability[rows] * chances,
        history,
        count,
        branch.total[rows] + sums,
        branch.drawn[rows] + count,
    )
    return following, means


def _outcomes(count: int, probabilities: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How often each value can come among `count` samples, and how likely that is."""
    size = len(probabilities)
    grids = (
        np.indices((count + 1,) * (size - 1)).reshape(size - 1, -1).T if size > 1 else np.zeros((1, 0), int)
    )
    last = count - grids.sum(axis=1, keepdims=True)
    counts = np.concatenate([grids, last], axis=1)[last[:, 0] >= 0]
    ways = [math.factorial(count) // math.prod(math.factorial(int(n)) for n in row) for row in counts]
    return counts, np.array(ways, float) * np.prod(probabilities**counts, axis=1)


class EmvMoments(NamedTuple):
    """Moments of a moving variance, relative to the samples' variance.

    Attributes:
        mean: its expectation; 1 - mean is the bias, `moving.estimate(..., bias=False)` divides by it.
        deviation: standard deviation of the debiased one, from history to history.
    """

    mean: Array
    deviation: Array


def emv_moments(alpha: ArrayLike, num_samples: ArrayLike = jnp.inf, kurtosis: ArrayLike = 3.0) -> EmvMoments:
    """How a moving variance of independent samples is distributed around their variance.

    Args:
        alpha: weight of the newest sample, in (0, 1].
        num_samples: how many there have been, the first with weight 1; inf for a long past.
        kurtosis: fourth central moment over the squared variance: 3 for normal samples, and for the mean
            of n samples 3 plus their excess over n.

    Returns:
        `EmvMoments`, exact for every distribution of that kurtosis, within 8 eps. A long past at
        alpha = 0.2 has the mean 8/9, and for normal samples the deviation 0.479: a controller that trusts
        it errs by half.

    Source: moments of a weighted sample variance, derived here; num_samples and equal weights give
    the textbook's (kurtosis - (n - 3) / (n - 1)) / n.

    Example:
        >>> moments = emv_moments(0.2)
        >>> round(float(moments.mean), 4), round(float(moments.deviation), 3)
        (0.8889, 0.479)
    """
    _recursion.check_alpha(alpha)
    dtype = jnp.result_type(float, alpha, kurtosis)
    alpha, kurtosis = jnp.asarray(alpha, dtype), jnp.asarray(kurtosis, dtype)
    steps = jnp.asarray(num_samples, dtype) - 1
    mean = _decayed(alpha, steps, 2) * 2 * (1 - alpha) / (2 - alpha)
    squares, products = _form_sums(alpha, steps)
    return EmvMoments(mean, jnp.sqrt((kurtosis - 1) * squares + 2 * products) / mean)


def _form_sums(alpha: Array, steps: Array) -> tuple[Array, Array]:
    """For the variance as a form x' M x, M = diag(w) - w w': the sums of M_ii^2, and of M_ij^2 with i != j.

    Sums of like signs, which the same in powers of the weights is not: for a small alpha that cancels.
    """
    kept = 1 - alpha
    first = jnp.exp(_times(steps, _log_kept(alpha)))
    # Those between the first and the newest, whose 1 - w is `kept` without a subtraction.
    between = jnp.maximum(steps - 1, 0)
    share = alpha * kept
    squares = jnp.square(first * _decayed(alpha, steps, 1)) + jnp.where(steps > 0, jnp.square(share), 0)
    for power, times in ((2, 1), (3, -2), (4, 1)):
        squares += times * share**power * _geometric(alpha, between, power)
    pairs = jnp.square(share) * _geometric(alpha, between, 2) / (1 + jnp.square(kept))
    products = jnp.square(first) + pairs
    return squares, 2 * jnp.square(alpha) * _geometric(alpha, steps, 2) * products


def _times(steps: Array, log: Array) -> Array:
    """No step at all is no decay, also where alpha is 1 and the logarithm infinite."""
    return jnp.where(steps == 0, 0, steps * log)


def _log_kept(alpha: Array) -> Array:
    """ln(1 - alpha); for large weights not by XLA's log1p, which has lost digits there in float64."""
    large = alpha > 0.25
    return jnp.where(
        large, jnp.log(1 - jnp.where(large, alpha, 0.5)), jnp.log1p(-jnp.where(large, 0.0, alpha))
    )


def _decayed(alpha: Array, steps: Array, power: int) -> Array:
    """1 - (1 - alpha)^(power steps)."""
    return -jnp.expm1(_times(steps, power * _log_kept(alpha)))


def _geometric(alpha: Array, steps: Array, power: int) -> Array:
    """1 + k + k^2 + ..., as many terms as steps, k = (1 - alpha)^power."""
    return _decayed(alpha, steps, power) / -jnp.expm1(power * _log_kept(alpha))
