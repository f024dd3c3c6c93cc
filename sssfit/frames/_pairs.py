"""Two float32 in one word of 64 bits, which a CPU looks up as fast as one of them.

A word is a float64 by name alone: it may be moved, and not computed with. Its tangent is the word of the two
tangents, so that what is looked up can be differentiated. Where a float64 is made of two float32, as on a
TPU, it would not keep the bits: there each number is a word of its own.
"""

import jax
import jax.numpy as jnp
from jax import Array


@jax.custom_jvp
def pack(first: Array, second: Array) -> Array:
    """Words of two float32 arrays of one shape."""
    with jax.enable_x64(True):
        low, high = (jax.lax.bitcast_convert_type(v, jnp.uint32).astype(jnp.uint64) for v in (first, second))
        return jax.lax.bitcast_convert_type(low | (high << jnp.uint64(32)), jnp.float64)


@pack.defjvp
def _(values, tangents):
    return pack(*values), pack(*tangents)


@jax.custom_jvp
def unpack(words: Array) -> tuple[Array, Array]:
    """The two arrays."""
    with jax.enable_x64(True):
        bits = jax.lax.bitcast_convert_type(words, jnp.uint64)
        low, high = bits.astype(jnp.uint32), (bits >> jnp.uint64(32)).astype(jnp.uint32)
        return (
            jax.lax.bitcast_convert_type(low, jnp.float32),
            jax.lax.bitcast_convert_type(high, jnp.float32),
        )


@unpack.defjvp
def _(values, tangents):
    return unpack(*values), unpack(*tangents)


def side_by_side(layers: list[Array]) -> Array:
    """Words of all layers, two by two and the words of a pixel next to each other, (pixels, K)."""
    words = list(layers)
    if jax.default_backend() != "tpu":
        filled = [*layers, *[jnp.zeros_like(layers[0])] * (len(layers) % 2)]
        words = [pack(*filled[k : k + 2]) for k in range(0, len(filled), 2)]
    with jax.enable_x64(True):
        # A selection is written in one go, where a concatenation writes each word by itself.
        number = jax.lax.broadcasted_iota(jnp.int32, (len(layers[0]), len(words)), 1)
        found = words[-1][:, None]
        for k, word in enumerate(words[:-1]):
            found = jnp.where(number == k, word[:, None], found)
        return jnp.broadcast_to(found, number.shape)


def at(table: Array, index: Array, keep=lambda word: word) -> list[Array]:
    """What the layers of `side_by_side` hold at pixels; the last may be one too many.

    Args:
        table: see `side_by_side`.
        index: pixels, known to be among those of the table, integers.
        keep: what is applied to the words as they are found.
    """
    count = table.shape[-1]
    wide = table.dtype.itemsize == 8
    with jax.enable_x64(wide or jax.config.read("jax_enable_x64")):
        flat = table.reshape(-1)
        words = [
            keep(flat.at[index * count + k].get(mode="promise_in_bounds", wrap_negative_indices=False))
            for k in range(count)
        ]
    return [value for word in words for value in unpack(word)] if wide else words
