"""What many seeds of a scenario say: counts, delivered variance, errors, and the regret against the oracle.

`collect` reads records chunk by chunk and keeps sums over the seeds, so that memory does not grow with them
except for two numbers per seed and frame. Steady figures leave out the first frames. The variance that a
frame delivers is, given its count, the exact variance of a sample over the count: it has no noise of its
own, and holds for independent samples. Squared errors against the truth hold for every sequence.
"""

from collections.abc import Callable, Iterable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sssfit.scenarios.driver import Record, World

#: The first frame, from 0, of what is called steady.
STEADY = 50
_ROUNDING = 1e-9
#: What a regret compares.
Level = Literal["mean", "q95"]


class Target(NamedTuple):
    """What is aimed at.

    Attributes:
        variance: of a frame's result, > 0.
        min_spp, max_spp: bounds of the count.
    """

    variance: float
    min_spp: float = 8
    max_spp: float = 64


class Statistics(NamedTuple):
    """Means over the seeds, float64; pixels are flattened to one axis.

    Attributes:
        seeds: how many.
        count_by_seed, error_by_seed: mean count and squared error of each seed and frame, (seeds, frames).
        count, count_squared: mean and mean square of the count, (frames, pixels).
        value, variance, coefficient: means of the record's, (frames, pixels).
        squared_error: mean squared error of the result, (frames, pixels).
        inverse_count: mean of 1 / count, (frames, pixels); a count of 0 counts as 1.
        mean_squared_error: mean squared error of the moving mean, (frames, pixels).
        histogram: how often each count occurred in each frame, over all pixels, (frames, largest + 1).
        truth, sample_variance: the world's, (frames, pixels).
        target: what was aimed at.
        independent: whether the samples were; if not, delivered variances are squared errors.
        first: the first frame of what the figures of `summarize` are made of.
        delivered_q95: the delivered variance that 95 % of the pixels and frames keep where the target
            decides the oracle's count, mean over the seeds; NaN where none is, or samples are not
            independent.
    """

    seeds: int
    count_by_seed: np.ndarray
    error_by_seed: np.ndarray
    count: np.ndarray
    count_squared: np.ndarray
    value: np.ndarray
    variance: np.ndarray
    coefficient: np.ndarray
    squared_error: np.ndarray
    inverse_count: np.ndarray
    mean_squared_error: np.ndarray
    histogram: np.ndarray
    truth: np.ndarray
    sample_variance: np.ndarray
    target: Target
    independent: bool
    first: int
    delivered_q95: float

    @property
    def delivered(self) -> np.ndarray:
        """Mean variance of a frame's result, given its count if samples are independent, (frames, pixels)."""
        return self.sample_variance * self.inverse_count if self.independent else self.squared_error


def collect(
    records: Iterable[Record],
    world: World,
    target: Target,
    *,
    first: int = STEADY,
    independent: bool = True,
    progress: Callable[[int], None] = lambda seeds: None,
) -> Statistics:
    """Means over the seeds of all records.

    Args:
        records: as `driver.chunks` yields them.
        world: whose records they are.
        target: what was aimed at.
        first: the first frame, from 0, that counts in `summarize`; below the number of frames.
        independent: whether the samples are; points of low discrepancy are not.
        progress: called with the seeds so far after each.

    Returns:
        `Statistics`.

    Raises:
        ValueError: there is no record, or no frame is left.

    Example:
        >>> import jax
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle, driver
        >>> world, fixed = circle.uniform(3), policies.named("fixed", spp=16)
        >>> records = driver.chunks(jax.random.key(0), world, fixed, seeds=4)
        >>> found = collect(records, world, Target(0.01), first=0)
        >>> found.count.ravel().tolist()
        [16.0, 16.0, 16.0]
    """
    frames = world.truth.shape[0]
    if not 0 <= first < frames:
        raise ValueError(
            f"frames must be more than {first} for figures from frame {first + 1} on, got {frames}"
        )
    truth, sample_variance = (
        np.asarray(a, np.float64).reshape(frames, -1) for a in (world.truth, world.sample_variance)
    )
    unclamped = is_unclamped(sample_variance[first:], target)
    seeds, sums, by_seed, kept, histogram = 0, None, [], [], np.zeros((frames, 1), np.int64)
    for record in records:
        # float64 a record at a time; the records themselves are float32.
        flat = {name: _flat(leaf, frames) for name, leaf in record._asdict().items()}
        count, error = flat["count"], np.square(flat["value"] - truth)
        inverse = 1 / np.maximum(count, 1)
        parts = (
            *(count, np.square(count), flat["value"], flat["variance"], flat["coefficient"], error),
            *(inverse, np.square(flat["mean"] - truth)),
        )
        kept.append(_kept(sample_variance[first:] * inverse[:, first:], unclamped))
        added = [part.sum(axis=0) for part in parts]
        sums = added if sums is None else [old + new for old, new in zip(sums, added, strict=True)]
        by_seed.append((count.mean(axis=2), error.mean(axis=2)))
        histogram = _add(histogram, count)
        seeds += len(count)
        progress(seeds)
    if sums is None:
        raise ValueError("records must hold at least one seed, got none")
    means = [part / seeds for part in sums]
    counts, errors = (np.concatenate(parts) for parts in zip(*by_seed, strict=True))
    q95 = float(np.concatenate(kept).mean()) if independent else float("nan")
    rest = (histogram, truth, sample_variance, target, independent, first, q95)
    return Statistics._make((seeds, counts, errors, *means, *rest))


def is_unclamped(sample_variance: ArrayLike, target: Target) -> np.ndarray:
    """Where the target itself decides the oracle's count, and not a bound.

    Args:
        sample_variance: of one sample.
        target: the target.

    Returns:
        Booleans: more than the least count and less than the largest would be taken.

    Source: none; two comparisons.

    Example:
        >>> is_unclamped([0.001, 0.01, 1.0], Target(1e-3)).tolist()
        [False, True, False]
    """
    ideal = np.asarray(sample_variance, np.float64) / target.variance
    return (ideal > target.min_spp) & (ideal < target.max_spp)


def oracle_count(sample_variance: ArrayLike, target: Target) -> np.ndarray:
    """The count that the target takes, within its bounds and not rounded.

    Args:
        sample_variance: of one sample.
        target: the target.

    Returns:
        sample_variance / target.variance between the bounds, float64.

    Source: Xie and Olano 2021, Eq 10, with the exact variance.

    Example:
        >>> oracle_count([0.0, 0.04], Target(1e-3)).tolist()
        [8.0, 40.0]
    """
    ideal = np.asarray(sample_variance, np.float64) / target.variance
    return np.clip(ideal, target.min_spp, target.max_spp)


class Summary(NamedTuple):
    """Figures of a scenario; errors are standard errors over the seeds, NaN for one seed.

    Attributes:
        mean_count, mean_count_se: samples per pixel.
        oracle_count: of the oracle, not rounded.
        count_over_oracle: mean count over the oracle's.
        delivered_over_target: mean delivered variance over the target where the oracle is within its
            bounds; NaN where it never is.
        image_rmse, image_rmse_se: root of the mean squared error of a frame's result.
        regret: samples over those of an oracle whose mean delivered variance is the same.
        regret_q95: the same for the variance that 95 % of the pixels and frames keep where the target
            decides the oracle's count.
    """

    mean_count: float
    mean_count_se: float
    oracle_count: float
    count_over_oracle: float
    delivered_over_target: float
    image_rmse: float
    image_rmse_se: float
    regret: float
    regret_q95: float


def summarize(found: Statistics) -> Summary:
    """The figures of a scenario, of the frames from `found.first` on.

    Args:
        found: the statistics of many seeds.

    Returns:
        `Summary`; regrets are NaN for samples that are not independent, which the oracle's are.

    Example:
        >>> import jax
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle, driver
        >>> world, policy = circle.uniform(60), policies.named("oracle", target_variance=0.0064)
        >>> found = collect(driver.chunks(jax.random.key(0), world, policy, seeds=2), world, Target(0.0064))
        >>> round(summarize(found).oracle_count, 2)
        42.69
    """
    first, target = found.first, found.target
    count, error = (by_seed[:, first:].mean(axis=1) for by_seed in (found.count_by_seed, found.error_by_seed))
    variance, delivered = found.sample_variance[first:], found.delivered[first:]
    oracle, inside = oracle_count(variance, target), is_unclamped(variance, target)
    rmse = float(np.sqrt(error.mean()))
    return Summary(
        float(count.mean()),
        standard_error(count),
        float(oracle.mean()),
        float(count.mean() / oracle.mean()),
        float(delivered[inside].mean() / target.variance) if inside.any() else float("nan"),
        rmse,
        standard_error(error) / (2 * rmse) if rmse > 0 else 0.0,
        regret(found),
        regret(found, level="q95"),
    )


def regret(found: Statistics, *, level: Level = "mean") -> float:
    """Samples spent over the samples of an oracle that delivers the same.

    The oracle has the same bounds and knows the variance of every pixel's samples; its target is what is
    looked for. By the mean alone a fixed count does as well as the oracle where neither is clamped, since
    both spend mean(variance) / mean delivered; a quantile tells them apart. Neither is the cheapest way to
    its own level, so that a ratio may be below 1: the oracle also serves those above the quantile.

    Args:
        found: the statistics of many seeds of independent samples.
        level: compare the "mean", or "q95", the variance that 95 % of the pixels and frames keep where
            the target decides the oracle's count.

    Returns:
        The ratio, 1 for the oracle itself up to rounding of its counts. NaN where no oracle within the
        bounds delivers as much or as little.

    Source: derived here.

    Example:
        >>> import jax
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle, driver
        >>> world, fixed = circle.uniform(60), policies.named("fixed", spp=16)
        >>> found = collect(driver.chunks(jax.random.key(0), world, fixed, seeds=2), world, Target(0.0064))
        >>> round(regret(found), 6)
        1.0
    """

    target = found.target
    variance, spent = found.sample_variance[found.first :], float(found.count[found.first :].mean())
    unclamped = is_unclamped(variance, target)

    def measured(delivered: np.ndarray) -> float:
        return float(delivered.mean() if level == "mean" else _kept(delivered[None], unclamped)[0])

    wanted = measured(found.delivered[found.first :]) if level == "mean" else found.delivered_q95
    least, most = (measured(variance / count) for count in (target.max_spp, target.min_spp))
    # Rounding must not decide at the bounds themselves.
    if not found.independent or not 0 < least * (1 - _ROUNDING) <= wanted <= most * (1 + _ROUNDING):
        return float("nan")
    wanted = min(max(wanted, least), most)
    # Between all at the largest count and all at the least; of equals the cheapest, the largest target.
    low = variance[variance > 0].min() / target.max_spp / 2
    high = variance.max() / target.min_spp * 2
    for _ in range(100):
        middle = np.sqrt(low * high)
        there = measured(variance / oracle_count(variance, target._replace(variance=middle)))
        low, high = (middle, high) if there <= wanted * (1 + 1e-14) else (low, middle)
    return spent / float(oracle_count(variance, target._replace(variance=low)).mean())


def standard_error(by_seed: np.ndarray) -> float:
    """Standard error of the mean over independent seeds.

    Args:
        by_seed: shape (seeds,).

    Returns:
        Deviation over the root of the number; NaN for one seed.

    Source: textbook.

    Example:
        >>> standard_error(np.array([1.0, 3.0]))
        1.0
    """
    if len(by_seed) < 2:
        return float("nan")
    return float(np.std(by_seed, ddof=1) / np.sqrt(len(by_seed)))


def count_quantiles(histogram: np.ndarray, shares: ArrayLike) -> np.ndarray:
    """Quantiles of the counts of each frame.

    Args:
        histogram: as in `Statistics`, (frames, counts).
        shares: in [0, 1], shape (k,).

    Returns:
        The smallest counts that at least these shares of pixels do not exceed, (frames, k).

    Source: textbook.

    Example:
        >>> count_quantiles(np.array([[0, 3, 1]]), [0.5, 0.9]).tolist()
        [[1, 2]]
    """
    cumulative = np.cumsum(histogram, axis=1) / histogram.sum(axis=1, keepdims=True)
    below = cumulative[:, :, None] < np.asarray(shares) - 1e-12
    return below.sum(axis=1)


def _kept(delivered: np.ndarray, unclamped: np.ndarray) -> np.ndarray:
    """What 95 % of the unclamped pixels and frames keep, of each seed."""
    if not unclamped.any():
        return np.full(len(delivered), np.nan)
    return np.quantile(delivered[:, unclamped], 0.95, axis=1)


def _flat(leaf: ArrayLike, frames: int) -> np.ndarray:
    leaf = np.asarray(leaf, np.float64)
    return leaf.reshape(len(leaf), frames, -1)


def _add(histogram: np.ndarray, count: np.ndarray) -> np.ndarray:
    """The histogram with the counts (seeds, frames, pixels) added, wider where they need it."""
    whole = count.astype(np.int64)
    width = max(histogram.shape[1], int(whole.max()) + 1)
    frames = np.arange(whole.shape[1])[:, None] * width
    new = np.bincount(
        (whole.swapaxes(0, 1).reshape(len(frames), -1) + frames).ravel(), minlength=width * len(frames)
    )
    return np.pad(histogram, ((0, 0), (0, width - histogram.shape[1]))) + new.reshape(len(frames), width)
