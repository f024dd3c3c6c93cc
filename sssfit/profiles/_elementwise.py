"""How elementwise functions of lengths treat dtypes and the ends of their domain."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

# Beyond this many shapes every density is zero in float64 too: exp(-3000 / 3) underflows.
_FAR = 3000.0


def broadcast(*arguments: ArrayLike) -> tuple[jnp.dtype, list[Array]]:
    """The result's dtype, and the arguments broadcast in the dtype to compute in."""
    dtype = jnp.result_type(float, *arguments)
    wide = jnp.promote_types(dtype, jnp.float32)
    return dtype, jnp.broadcast_arrays(*(jnp.asarray(a, wide) for a in arguments))


@jax.custom_jvp
def ratio(r: Array, d: Array) -> Array:
    """r / d for d > 0, with a derivative that does not overflow before 1 / d does."""
    return r / d


@ratio.defjvp
def _ratio_jvp(primals, tangents):
    (_, d), (dr, dd) = primals, tangents
    x = ratio(*primals)
    # JAX's own rule divides by d^2, which is 0 in float32 from d = 1e-23 down.
    return x, (dr - x * dd) / d


def on_support(
    function: Callable[[Array], Array], r: Array, d: Array, *, below: float, beyond: float
) -> Array:
    """function(r / d), with constants (and no gradient) off the ends of the domain.

    `below` holds for r < 0 and `beyond` for radii too many shapes away to matter, d = 0 included.
    """
    inside = (r >= 0) & (d > 0) & (r <= _FAR * d)
    x = ratio(jnp.where(inside, r, 0), jnp.where(inside, d, 1))
    # Not r >= 0, which XLA takes to be true of an absolute value, NaN or not.
    outside = jnp.where(jnp.isnan(r), jnp.nan, jnp.where(r < 0, below, beyond))
    outside = jnp.where(d >= 0, outside, jnp.nan)
    return jnp.where(inside, function(x), outside.astype(x.dtype))
