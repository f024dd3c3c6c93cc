"""Low-discrepancy points for the samples of a pixel, exact however long the sequence is.

Source: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018; Xie, dissertation, 2021,
Eq 5.7, whose print lacks the modulo.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

# 2^32 / phi and 2^32 / phi^2 for the root phi = 1.3247... of x^3 = x + 1, rounded: in float32, m times the
# ratio itself has lost its fraction after some ten thousand points.
_FIRST, _SECOND = 3242174889, 2447445414


def r2(index: ArrayLike, shift: ArrayLike) -> Array:
    """Points of the R2 sequence in the unit square, shifted on the torus.

    Args:
        index: number of the point, integer, >= 0, taken modulo 2^32, shape (...).
        shift: where the sequence starts, uint32 in units of 2^-32, shape (2, ...). Uniformly random bits
            make every point uniform in the unit square, and means over points unbiased.

    Returns:
        Shape (2, ...), in [0, 1 - 2^-24], float32. The step from point to point is within 2^-33 of the true
        one, so that the point of number m is within m 2^-33 + 2^-24 of its place.

    Source: Roberts 2018; dissertation Eq 5.7 with the modulo; shift: Cranley and Patterson, 1976.

    Example:
        >>> points = r2(jnp.arange(3), jnp.zeros((2, 1), jnp.uint32))
        >>> [[round(float(x), 4) for x in row] for row in points]
        [[0.0, 0.7549, 0.5098], [0.0, 0.5698, 0.1397]]
    """
    index, shift = jnp.asarray(index).astype(jnp.uint32), jnp.asarray(shift, jnp.uint32)
    moved = jnp.stack([shift[0] + index * jnp.uint32(_FIRST), shift[1] + index * jnp.uint32(_SECOND)])
    # 24 bits are what float32 holds below 1; more would round up to it.
    return (moved >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
