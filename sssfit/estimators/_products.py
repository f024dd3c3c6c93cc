"""The five moving statistics as lists: a sample's components, and which of their products are kept."""

from collections.abc import Sequence
from typing import Literal, get_args

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

Statistic = Literal["ema", "emv", "emc", "emcm", "ewma_covariance"]
STATISTICS: tuple[Statistic, ...] = get_args(Statistic)
#: Those of vectors on the last axis, with a matrix for a value.
MATRICES = ("emcm", "ewma_covariance")


def components_of(statistic: Statistic, x: ArrayLike | Sequence) -> list[Array]:
    """A sample's components as arrays of one shape and one floating dtype; half formats stay."""
    if statistic not in STATISTICS:
        raise ValueError(f"statistic must be one of {', '.join(STATISTICS)}, got {statistic!r}")
    if statistic == "emc":
        if not isinstance(x, tuple | list) or len(x) != 2:
            raise ValueError("a sample of 'emc' must be a pair (x, y)")
        pair = [floating(c) for c in x]
        dtype = jnp.result_type(*pair)
        return jnp.broadcast_arrays(*(c.astype(dtype) for c in pair))
    values = floating(x)
    if statistic not in MATRICES:
        return [values]
    if values.ndim == 0 or values.shape[-1] == 0:
        raise ValueError(
            f"a sample of {statistic!r} must have its vector on the last axis, got shape {values.shape}"
        )
    return [values[..., i] for i in range(values.shape[-1])]


def floating(x: ArrayLike | Sequence) -> Array:
    """An array of a floating dtype; integers and lists take JAX's default one."""
    values = jnp.asarray(x)
    if jnp.iscomplexobj(values):
        raise ValueError("samples must be real, got complex numbers; give their parts as components")
    return values.astype(jnp.result_type(float, values))


def product_pairs(statistic: Statistic, num_components: int) -> list[tuple[int, int]]:
    """Which products of components a statistic keeps; for matrices the upper triangle, row by row."""
    if statistic == "ema":
        return []
    if statistic == "emc":
        return [(0, 1)]
    return [(i, j) for i in range(num_components) for j in range(i, num_components)]


def matrix(upper: Sequence[Array], size: int, *, bounded: bool) -> Array:
    """The symmetric matrix of an upper triangle, on two new last axes."""
    index = {pair: k for k, pair in enumerate(product_pairs("emcm", size))}
    entries = list(upper)
    if bounded:
        entries = [
            _bounded(upper[k], upper[index[i, i]], upper[index[j, j]]) if i != j else upper[k]
            for (i, j), k in index.items()
        ]
    flat = [entries[index[min(i, j), max(i, j)]] for i in range(size) for j in range(size)]
    return jnp.stack(flat, axis=-1).reshape(*flat[0].shape, size, size)


def _bounded(covariance: Array, variance_x: Array, variance_y: Array) -> Array:
    """The covariance within +-sqrt(variance_x variance_y), rounded toward 0 so that it holds exactly."""
    dtype = covariance.dtype
    wide = jnp.promote_types(dtype, jnp.float32)
    # The product of the roots neither overflows nor underflows; three roundings, each up by half an ulp at
    # most, and the one of storing, which below the normal numbers is half a fixed step.
    info, is_half = jnp.finfo(dtype), wide != dtype
    shrunk = 1 - 4 * float(jnp.finfo(wide).eps) - (float(info.eps) if is_half else 0.0)
    step = float(info.smallest_subnormal) if is_half else 0.0
    vary = (variance_x != 0) & (variance_y != 0)
    # A root's slope is infinite at 0, also in the branch that is not taken.
    roots = (jnp.sqrt(jnp.where(vary, v.astype(wide), 1)) for v in (variance_x, variance_y))
    limit = jnp.where(vary, jnp.maximum(next(roots) * next(roots) * shrunk - step, 0), 0)
    return jnp.clip(covariance.astype(wide), -limit, limit).astype(dtype)


def stacked(statistic: Statistic, values: Sequence[Array]) -> Array:
    """Components as samples came: vectors on a last axis, a pair on a first one."""
    if statistic in MATRICES:
        return jnp.stack(values, axis=-1)
    return jnp.stack(values) if statistic == "emc" else values[0]
