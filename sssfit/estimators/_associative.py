"""The moving statistics for all times at once, by parallel prefix sums.

A stretch of samples is its share of the weight W, the factor D = 1 - W that it leaves to what was before,
and its mean; two stretches join into one. The deviations from those means then add up by a linear
recurrence. Means join by a step from one toward the other, which leaves a constant stream exactly as it is.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array, lax

from sssfit.estimators._products import Statistic, product_pairs
from sssfit.estimators._recursion import saturate


# Op by op, the log2(T) levels would each compile dozens of small programs.
@partial(jax.jit, static_argnums=0)
def moments(
    statistic: Statistic, components: list[Array], alpha: Array, valid: Array | None
) -> tuple[list[Array], list[Array], Array, Array]:
    """Means, products, debias and started after each sample, time on axis 0.

    Components and alpha are in the dtype to compute in; alpha and valid broadcast to one sample or all.
    """
    times = len(components[0])
    started, first = _starts(times, components[0].ndim, valid)
    if valid is not None:
        components = [jnp.where(valid, x, 0) for x in components]
    share = jnp.where(first, 1, alpha if valid is None else jnp.where(valid, alpha, 0))
    means = _means(share, components)
    deltas = [jnp.where(first, 0, x - _previous(mean)) for x, mean in zip(components, means, strict=True)]
    gain = share if statistic == "ewma_covariance" else share * (1 - share)

    def increments(i: int, j: int) -> Array:
        return gain * _counting(gain == 0, deltas[i] * deltas[j])

    pairs = product_pairs(statistic, len(components))
    products = [_decaying_sum(1 - share, increments(i, j), saturated=i != j) for i, j in pairs]
    debias = _decaying_sum((1 - share) ** 2, 2 * share * (1 - share), saturated=False)
    return means, products, debias, started


def _starts(times: int, ndim: int, valid: Array | None) -> tuple[Array, Array]:
    """Whether a valid sample has come by each time, and whether it is the first one."""
    time = jnp.arange(times).reshape(-1, *(1,) * (ndim - 1))
    if valid is None:
        return time >= 0, time == 0
    count = jnp.cumsum(valid, axis=0)
    return count > 0, valid & (count == 1)


def _previous(values: Array) -> Array:
    return jnp.concatenate([jnp.zeros_like(values[:1]), values[:-1]])


def _means(share: Array, components: list[Array]) -> list[Array]:
    def join(early, late):
        (kept_a, share_a, means_a), (kept_b, share_b, means_b) = early, late
        remaining = share_a * kept_b
        share = remaining + share_b
        total = jnp.where(share > 0, share, 1)
        gaps = [_counting(remaining == 0, a - b) for a, b in zip(means_a, means_b, strict=True)]
        # From the side that weighs more, as the sequential steps do.
        means = [
            jnp.where(share_b >= remaining, b + remaining / total * gap, a - share_b / total * gap)
            for a, b, gap in zip(means_a, means_b, gaps, strict=True)
        ]
        return _product(kept_a, kept_b), share, means

    return lax.associative_scan(join, (1 - share, share, components))[2]


def _decaying_sum(kept: Array, increments: Array, *, saturated: bool) -> Array:
    """s = kept s + increment over time, from 0."""

    def join(early, late):
        (kept_a, sum_a), (kept_b, sum_b) = early, late
        return _product(kept_a, kept_b), limit(kept_b * _counting(kept_b == 0, sum_a) + sum_b)

    def limit(total):
        return saturate(total, total.dtype) if saturated else total

    return lax.associative_scan(join, (kept, limit(increments)))[1]


def _counting(weightless: Array, value: Array) -> Array:
    """The value, but 0 where it has no weight and no finite size: a forgotten NaN or inf is none."""
    return jnp.where(weightless & ~jnp.isfinite(value), 0, value)


def _product(a: Array, b: Array) -> Array:
    """a b, which is 0 only where a factor is: what is forgotten and what has faded stay apart."""
    tiny = float(jnp.finfo(a.dtype).tiny)
    return jnp.where((a == 0) | (b == 0), a * b, jnp.maximum(a * b, tiny))
