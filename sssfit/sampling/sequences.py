"""Points of the unit square for the samples of a pixel, each computed from its number and a random shift.

`r2` spreads them evenly, within 2e-5 of their places for the first hundred thousand points. `hashed` makes
them as good as independent, much faster than a cryptographic generator: draw the shift with that one, and
the points from it.

Source: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018; Xie, dissertation, 2021,
Eq 5.7, whose print lacks the modulo; Jarzynski and Olano, "Hash functions for GPU rendering", 2020.
"""

import jax.numpy as jnp
import numpy as np
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
    index, shift = _word(index), jnp.asarray(shift, jnp.uint32)
    moved = jnp.stack([shift[0] + index * jnp.uint32(_FIRST), shift[1] + index * jnp.uint32(_SECOND)])
    return _to_unit(moved)


def hashed(index: ArrayLike, shift: ArrayLike) -> Array:
    """Points of the unit square as good as independent, by the hash function pcg3d.

    Args:
        index: number of the point, integer, taken modulo 2^32, shape (...).
        shift: which stream of points, uint32, shape (2, ...): uniformly random bits make the streams of
            pixels and frames independent, so far as 64 bits can.

    Returns:
        Shape (2, ...), in [0, 1 - 2^-24], float32.

    Source: Jarzynski and Olano 2020, pcg3d.

    Example:
        >>> points = hashed(jnp.arange(1000), jnp.array([[1], [2]], jnp.uint32))
        >>> points.shape, 0.48 < float(points.mean()) < 0.52
        ((2, 1000), True)
    """
    shift = jnp.asarray(shift, jnp.uint32)
    words = (shift[0], shift[1], _word(index))
    x, y, z = (word * jnp.uint32(1664525) + jnp.uint32(1013904223) for word in words)
    x = x + y * z
    y = y + z * x
    z = z + x * y
    x, y, z = (word ^ (word >> 16) for word in (x, y, z))
    x = x + y * z
    return _to_unit(jnp.stack([x, y + z * x]))


def _word(index: ArrayLike) -> Array:
    # On the host first, where a Python integer may have more than 32 bits.
    wide = index if isinstance(index, Array) else np.asarray(index)
    return jnp.asarray(wide.astype(np.uint32))


def _to_unit(words: Array) -> Array:
    # 24 bits are what float32 holds below 1; more would round up to it.
    return (words >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
