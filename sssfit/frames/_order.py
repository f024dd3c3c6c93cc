"""The order in which a frame's segments are sampled: blocks of like counts, near each other."""

import jax.numpy as jnp
from jax import Array

from sssfit.frames.points import VERSIONS

#: Pixels of one block.
BLOCK = 4096
#: Rows, and segments in a row, whose pixels are sampled one after the other.
_TILE = (32, 8)
#: Tiles, down and across, whose segments are sorted by their counts.
_REGION = (4, 2)


def of_segments(counts: Array, lanes: int) -> tuple[Array, Array, Array]:
    """Segments in blocks of like counts; the blocks' largest; where each segment went.

    Every so manieth block is a lane's, from the first on.
    """
    height, width = counts.shape
    per_row = -(-width // VERSIONS)
    largest = jnp.pad(counts, ((0, 0), (0, per_row * VERSIONS - width)))
    largest = jnp.max(largest.reshape(height, per_row, VERSIONS), axis=-1)
    none = height * per_row
    number = jnp.arange(none, dtype=jnp.int32).reshape(height, per_row)
    # Segments beyond the frame hold no pixel, and nothing is drawn for them.
    number, sought = _regions(number, none), _regions(largest, 0)
    # A falling count and a place in one word sort three times as fast as a key and a place.
    size = number.shape[1]
    bits = (size - 1).bit_length()
    most = (1 << (32 - bits)) - 1
    words = (most - jnp.minimum(sought, most)).astype(jnp.uint32) << bits
    words = jnp.sort(words | jnp.arange(size, dtype=jnp.uint32), axis=1) & jnp.uint32(size - 1)
    # Within a block in the order of the tiles, so that what neighbours look up is still in a cache.
    blocks = jnp.sort(words.astype(jnp.int32).reshape(len(words), -1, BLOCK // VERSIONS), axis=-1)
    blocks = jnp.take_along_axis(number[:, None], blocks, axis=2).reshape(-1, BLOCK // VERSIONS)
    blocks = jnp.pad(blocks, ((0, -len(blocks) % lanes), (0, 0)), constant_values=none)
    in_block = jnp.max(jnp.pad(largest.reshape(-1), (0, 1))[blocks], axis=1)
    # Lanes take turns from the largest on, so that each has as much to do; a lane's own blocks follow each
    # other as they lie in the frame, for the same reason as segments do, and those without samples come last.
    rank = jnp.argsort(-in_block).reshape(-1, lanes)
    rank = jnp.sort(jnp.where(in_block[rank] > 0, rank, rank + rank.size), axis=0).reshape(-1) % rank.size
    blocks = blocks[rank]
    places = (
        jnp.zeros(none + 1, jnp.int32).at[blocks.reshape(-1)].set(jnp.arange(blocks.size, dtype=jnp.int32))
    )
    return blocks, in_block[rank], places[:-1]


def _regions(layer, value):
    """What is known of the segments, region by region and in each tile by tile."""
    rows, columns = (many * tile for many, tile in zip(_REGION, _TILE, strict=True))
    unused = tuple((0, -length % step) for length, step in zip(layer.shape, (rows, columns), strict=True))
    layer = jnp.pad(layer, unused, constant_values=value)
    layer = layer.reshape(-1, _REGION[0], _TILE[0], layer.shape[1] // columns, _REGION[1], _TILE[1])
    return layer.transpose(0, 3, 1, 4, 2, 5).reshape(-1, rows * columns)
