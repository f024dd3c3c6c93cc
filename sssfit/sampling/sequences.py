"""Points of the unit square for the samples of a pixel, each computed from its number and a random shift.

| function | which points | variance at an edge | variance, smooth |
| --- | --- | --- | --- |
| `hashed` | any | 1 | 1 |
| `r2` | any number from the first on | 0.19 | 0.13 |
| `hammersley` | all of a fixed count | 0.21 | 0.028 |
| `fibonacci` | all of a fixed count | 0.21 | 0.032 |
| `sobol` | a power of 2 from the first on | 0.28 | 0.0008 |

The variances are those of the mean of 64 points over random shifts, in units of that of independent points:
the share inside the inscribed disc, and the mean of x exp(y). All cost about the same.

All have one form, (index, shift) -> (2, ...), the fixed counts with the count between. With uniformly random
bits as shift every point is uniform in the unit square, and means over points are unbiased. The first
coordinate of `fibonacci` and `hammersley` is the one that is stratified finest: use it for the radius.

Source: Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018; Xie, dissertation, 2021,
Eq 5.7, whose print lacks the modulo; Jarzynski and Olano, "Hash functions for GPU rendering", 2020; Burley,
"Practical hash-based Owen scrambling", 2020.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.sampling import hashes

# 2^32 / phi and 2^32 / phi^2 for the root phi = 1.3247... of x^3 = x + 1, rounded: in float32, m times the
# ratio itself has lost its fraction after some ten thousand points.
_FIRST, _SECOND = 3242174889, 2447445414
# 2^32 / phi for the golden ratio phi, the root of x^2 = x + 1, rounded.
_GOLDEN = 2654435769


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
    index = hashes.word(index)
    return _shifted(index * jnp.uint32(_FIRST), index * jnp.uint32(_SECOND), shift)


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
    return _to_unit(hashes.pcg3d(shift[0], shift[1], index)[:2])


def hammersley(index: ArrayLike, count: ArrayLike, shift: ArrayLike) -> Array:
    """The Hammersley points (i / n, radical inverse of i in base 2), shifted on the torus.

    Args:
        index: number of the point i, integer, 0 to count - 1, shape (...).
        count: how many points n, integer, >= 1; fewer than all of them leave a gap. It may differ from pixel
            to pixel and broadcasts.
        shift: uint32 in units of 2^-32, shape (2, ...), uniformly random bits for unbiased means.

    Returns:
        Shape (2, ...), in [0, 1 - 2^-24], float32, within 6.1e-8 of their places for counts up to 2^24 and
        within 4.8e-7 up to 2^31.

    Source: Hammersley, "Monte Carlo methods for solving multivariable problems", 1960; shift: Cranley and
    Patterson, 1976.

    Example:
        >>> hammersley(jnp.arange(4), 4, jnp.zeros((2, 1), jnp.uint32)).tolist()
        [[0.0, 0.25, 0.5, 0.75], [0.0, 0.5, 0.25, 0.75]]
    """
    return _shifted(_ratio(index, count), hashes.reversed_bits(index), shift)


def fibonacci(index: ArrayLike, count: ArrayLike, shift: ArrayLike) -> Array:
    """The points ((i + 1/2) / n, i / phi modulo 1) of a sunflower, phi the golden ratio, shifted.

    A rank-1 lattice on the torus but for the seam at i = n; for n a Fibonacci number it is the Fibonacci
    lattice to within 1 / (sqrt(5) n). With the first coordinate as the radius' variate and the second as the
    angle in turns, samples lie in one spiral around the pixel, none behind another.

    Args:
        index: number of the point i, integer, 0 to count - 1, shape (...).
        count: how many points n, integer, >= 1; fewer than all of them leave a gap. It may differ from pixel
            to pixel and broadcasts.
        shift: uint32 in units of 2^-32, shape (2, ...), uniformly random bits for unbiased means.

    Returns:
        Shape (2, ...), in [0, 1 - 2^-24], float32. The first coordinate is within 6.1e-8 of its place
        for counts up to 2^24 and within 4.8e-7 up to 2^31, the second within i 2^-33 + 2^-24.

    Source: Vogel, "A better way to construct the sunflower head", 1979; shift: Cranley and Patterson, 1976.

    Example:
        >>> points = fibonacci(jnp.arange(4), 4, jnp.zeros((2, 1), jnp.uint32))
        >>> [[round(float(x), 3) for x in row] for row in points]
        [[0.125, 0.375, 0.625, 0.875], [0.0, 0.618, 0.236, 0.854]]
    """
    half = jnp.uint32(2**31) // _at_least_one(count)
    return _shifted(_ratio(index, count) + half, hashes.word(index) * jnp.uint32(_GOLDEN), shift)


def sobol(index: ArrayLike, shift: ArrayLike) -> Array:
    """The first two dimensions of Sobol's sequence, each with Owen's nested uniform scrambling by a hash.

    The reference for smooth integrands: any 2^k points from a multiple of 2^k on have exactly one in every
    elementary interval of area 2^-k (k <= 24), and the variance of means falls about with n^-3. Nothing is
    shifted on the torus, which would break the intervals. SciPy's `qmc.Sobol(scramble=True)` is something
    else: a random linear map of the digits and a digital shift.

    Args:
        index: number of the point, integer, >= 0, taken modulo 2^32, shape (...).
        shift: the seed of each dimension, uint32, shape (2, ...). Uniformly random bits make every point
            uniform in the unit square, and means over points unbiased.

    Returns:
        Shape (2, ...), in [0, 1 - 2^-24], float32.

    Source: Sobol', 1967; Owen, "Randomly permuted (t,m,s)-nets and (t,s)-sequences", 1995; Burley 2020, see
    `hashes.nested_scramble`.

    Example:
        >>> points = sobol(jnp.arange(4), jnp.array([[1234567891], [3141592653]], jnp.uint32))
        >>> jnp.sort(jnp.floor(points * 4)).tolist()
        [[0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0]]
    """
    first, shift = hashes.word(index), jnp.asarray(shift, jnp.uint32)
    # Digit i of the second dimension is the sum modulo 2 of the index's bits j with binomial(j, i) odd, which
    # are those that have i's bits among their own: Pascal's triangle, one bit of i and j at a time.
    second = first
    for width, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF), (16, 0xFFFF)):
        second = second ^ ((second >> width) & jnp.uint32(mask))
    scrambled = (
        hashes.nested_scramble(digits, seed) for digits, seed in zip((first, second), shift, strict=True)
    )
    return _to_unit(jnp.stack([*scrambled]))


def _ratio(index: ArrayLike, count: ArrayLike) -> Array:
    """index / count modulo 1 in units of 2^-32, for which the product alone would need 64 bits."""
    index, count = hashes.word(index), _at_least_one(count)
    # 2^32 = step count + rest; the rest's share is below the index, small enough for float32.
    step = jnp.uint32(2**32 - 1) // count
    rest = jnp.uint32(2**32 - 1) - step * count + jnp.uint32(1)
    share = rest.astype(jnp.float32) / count.astype(jnp.float32)
    return index * step + (index.astype(jnp.float32) * share).astype(jnp.uint32)


def _at_least_one(count: ArrayLike) -> Array:
    # A pixel without samples: its points are not used, and must not divide by zero.
    return jnp.maximum(hashes.word(count), jnp.uint32(1))


def _shifted(first: Array, second: Array, shift: ArrayLike) -> Array:
    shift = jnp.asarray(shift, jnp.uint32)
    # Each coordinate whole before they are stacked: one who uses them apart need not make the stack.
    return jnp.stack(jnp.broadcast_arrays(_to_unit(shift[0] + first), _to_unit(shift[1] + second)))


def _to_unit(words: Array) -> Array:
    # 24 bits are what float32 holds below 1; more would round up to it.
    return (words >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
