"""Hash functions on 32-bit words: random bits that depend on nothing but the words that go in.

`pcg3d16` turns a pixel and a frame number into the bits its samples start from, `pcg3d` does so at full
quality, and `nested_scramble` permutes the digits of a low-discrepancy point. All are exact integer
arithmetic modulo 2^32, the same on every device.

Source: Jarzynski and Olano, "Hash functions for GPU rendering", JCGT 9(3), 2020; Burley, "Practical
hash-based Owen scrambling", JCGT 9(4), 2020; Laine and Karras, "Stratified sampling for stochastic
transparency", 2011.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike


def pcg3d(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
    """Three random words from three words, good in all 32 bits.

    Args:
        x, y, z: integers, taken modulo 2^32; they broadcast to shape (...).

    Returns:
        uint32, shape (3, ...).

    Source: Jarzynski and Olano 2020, pcg3d.

    Example:
        >>> [hex(word) for word in pcg3d(1, 2, 3).tolist()]
        ['0xfa9f79a6', '0x48f2f44c', '0x596f5ab1']
    """
    words = _mixed(*(word(a) * jnp.uint32(1664525) + jnp.uint32(1013904223) for a in (x, y, z)))
    return jnp.stack(_mixed(*(a ^ (a >> 16) for a in words)))


def pcg3d16(x: ArrayLike, y: ArrayLike, frame: ArrayLike) -> Array:
    """Three random 16-bit words of a pixel in a frame: what the papers start a pixel's samples from.

    They take the first word as the number of the pixel's first point in the R2 sequence. A shift on the
    torus of 32 bits has more values and is uniform: prefer `pcg3d` for that.

    Args:
        x: column of the pixel, integer, shape (...).
        y: row of the pixel.
        frame: number of the frame.

    Returns:
        uint32 below 2^16, shape (3, ...). Other code of this name differs: Unreal Engine's Rand3DPCG16
        keeps pcg3d's multiplier and increment.

    Source: Jarzynski and Olano 2020, pcg3d16; Xie, dissertation, 2021, Section 5.1.2.

    Example:
        >>> pcg3d16(1, 2, 3).tolist()
        [20732, 51808, 35516]
    """
    words = (word(a) * jnp.uint32(12829) + jnp.uint32(47989) for a in (x, y, frame))
    return jnp.stack(_mixed(*_mixed(*words))) >> 16


def nested_scramble(digits: ArrayLike, seed: ArrayLike) -> Array:
    """Owen's nested uniform scrambling of a binary fraction, by a hash in place of a tree of random bits.

    Whether a digit flips depends on the digits before it and on the seed, so that points which share their
    first k digits share them still: every elementary interval keeps its number of points.

    Args:
        digits: the fraction's binary digits, the first in bit 0, uint32, shape (...).
        seed: uniformly random bits, uint32; it broadcasts against the digits. Seeds that differ little
            scramble alike: take them from a generator or from `pcg3d`.

    Returns:
        The scrambled fraction in units of 2^-32, its first digit in bit 31, uint32. Over random seeds its
        first 16 digits are exactly uniform.

    Source: Burley 2020, with the hash that Cycles and pbrt-v4 use in place of Laine and Karras's: Vegdahl,
    "Building a better LK hash", 2021.

    Example:
        >>> [hex(int(nested_scramble(digits, 5))) for digits in (0, 1, 1 + 2**31)]
        ['0xe6ca1258', '0x81355fa', '0x81355fb']
    """
    n, bits = word(digits), word(seed)
    # Multiplying carries towards bit 31 alone, from first digits to later ones.
    n = n ^ (n * jnp.uint32(0x3D20ADEA))
    n = (n + bits) * ((bits >> 16) | jnp.uint32(1))
    n = n ^ (n * jnp.uint32(0x05526C56))
    return reversed_bits(n ^ (n * jnp.uint32(0x53A22864)))


def reversed_bits(words: ArrayLike) -> Array:
    """The bits of each word in reverse order: an integer's radical inverse in base 2, times 2^32.

    Args:
        words: integers, taken modulo 2^32.

    Returns:
        uint32, same shape.

    Source: van der Corput, 1935.

    Example:
        >>> reversed_bits(1).tolist() == 2**31, reversed_bits(2**31).tolist()
        (True, 1)
    """
    found = word(words)
    for width, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        kept = jnp.uint32(mask)
        found = ((found >> width) & kept) | ((found & kept) << width)
    return (found >> 16) | (found << 16)


def word(value: ArrayLike) -> Array:
    """An integer modulo 2^32.

    Args:
        value: integers of any width.

    Returns:
        uint32, same shape.

    Source: two's complement, as NumPy and XLA convert integers.

    Example:
        >>> word(2**32 + 5).tolist(), word(-1).tolist() == 2**32 - 1
        (5, True)
    """
    # On the host first, where a Python integer may have more than 32 bits.
    wide = value if isinstance(value, Array) else np.asarray(value)
    return jnp.asarray(wide.astype(np.uint32))


def _mixed(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    x = x + y * z
    y = y + z * x
    return x, y, z + x * y
