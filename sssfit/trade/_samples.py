"""Which texels the samples of a profile's pass read, by the passes' own code."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.frames import _block, _pass, points, split
from sssfit.frames.points import VERSIONS, Settings
from sssfit.trade.texture import Texture


class Prepared(NamedTuple):
    """A pass before its samples.

    Attributes:
        pixels: see `_block.Pixels`; all of the frame in one axis, those that use the first version first.
        places: where each pixel of the frame is in that axis, int32, (H W,).
        counts: samples of each pixel, int32, (H W,).
        table: of the samples, or None.
        d: mm, (C,), > 0.
        most: the largest count.
        camera: that saw the frame.
    """

    pixels: _block.Pixels
    places: np.ndarray
    counts: np.ndarray
    table: points.Samples | None
    d: Array
    most: Array
    camera: Any


def prepared(frame, d, mask, counts, most: int, settings: Settings, seed: int, number: int) -> Prepared:
    """What `scatter` knows of the frame before it samples."""
    height, width = frame.depth.shape
    normal = frame.normal if settings.plane == "tangent" else None
    if settings.plane == "tangent" and normal is None:
        raise ValueError("normal must be given: the tangent plane follows from it")
    seen = _pass.Seen(frame.irradiance, frame.depth, normal, mask, frame.camera)
    random = _pass.Random(jnp.uint32(seed), jnp.uint32(number), jnp.int32(max(most, 1)))
    rows = 1 << (max(most, 1) - 1).bit_length()
    pixels, drawn, table = _before_samples(seen, counts, d, random, settings, rows)
    column, row = (np.floor(np.asarray(v)).astype(int) for v in (pixels.column, pixels.row))
    places, inside = np.zeros(height * width, np.int32), column < width
    places[row[inside] * width + column[inside]] = np.flatnonzero(inside)
    flat = np.asarray(drawn).reshape(-1)
    return Prepared(pixels, places, flat, table, _pass.positive(d), random.most, frame.camera)


@functools.partial(jax.jit, static_argnames=("settings", "rows"))
def _before_samples(seen, counts, d, random, settings, rows):
    """All pixels in one axis, their counts, and the table; nothing else that a pass prepares is computed."""
    found = _pass.prepare(None, seen, counts, d, random, settings, rows, 1)
    height, width = seen.depth.shape
    per_row = -(-width // VERSIONS)
    pixels, _ = _block.pixels_of(
        jnp.arange(height * per_row), per_row, seen, found.counts, random, settings, lambda value: value
    )
    shape = pixels.column.shape
    flat = jax.tree.map(
        lambda value: jnp.broadcast_to(value, shape).reshape(-1), pixels._replace(words=jnp.zeros(shape))
    )
    return flat._replace(words=pixels.words.reshape(3, -1)), found.counts, found.table


@functools.partial(jax.jit, static_argnames=("settings", "texture", "bilinear"))
def addresses(
    of: Prepared,
    place: Array,
    number: Array,
    level: Array | None,
    settings: Settings,
    texture: Texture,
    bilinear: bool,
) -> Array:
    """Bytes that samples read, -1 for those that read nothing.

    Args:
        of: see `Prepared`.
        place: of each thread's pixel among the pixels, (requests, threads), -1 for none.
        number: of the sample, (requests, 1).
        level: that all samples read, a number; None for that of the prefilter.
        settings: see `points.Settings`.
        texture: see `texture.Texture`.
        bilinear: of a given level: the four texels around the place, or else the one that it is in.

    Returns:
        int32, (requests, threads times the texels of each).
    """
    own = jax.tree.map(lambda value: value[..., place], of.pixels)
    if settings.points == "table":
        assert of.table is not None
        version = place // (len(of.pixels.column) // VERSIONS)
        sample = jax.tree.map(lambda value: value[number, version], of.table)
    else:
        disc = None
        if settings.split is not None:
            disc = points.inner(split.radius(own.depth, of.camera), of.d, settings)
        sample = _block.fresh(own, of.most, of.d, settings, disc)(number, lambda value: value)
    column, row, _ = _block.met(own, sample, of.camera)
    used = (place >= 0) & (number < own.count)
    used = used & (column >= 0) & (column < texture.width) & (row >= 0) & (row < texture.height)
    if level is not None:
        found = _texels(jnp.broadcast_to(level, place.shape), row, column, texture, bilinear)
    else:
        fine = jnp.floor(_block.level(own, sample, settings, top=len(texture.sizes) - 1)).astype(jnp.int32)
        # As the lookup of a prefiltered image does: both levels, whatever their weights.
        coarse = jnp.minimum(fine + 1, len(texture.sizes) - 1)
        found = [a for one in (fine, coarse) for a in _texels(one, row, column, texture, True)]
    return jnp.concatenate([jnp.where(used, address, -1) for address in found], axis=-1)


def _texels(level, row, column, texture, bilinear):
    """The addresses around a place of the image, in one level."""
    scale = jnp.asarray([0.5**number for number in range(len(texture.sizes))], jnp.float32)[level]
    row, column = row * scale, column * scale
    if not bilinear:
        return [texture.address(level, jnp.floor(row), jnp.floor(column))]
    row, column = jnp.floor(row - 0.5).astype(jnp.int32), jnp.floor(column - 0.5).astype(jnp.int32)
    return [texture.address(level, row + down, column + across) for down in (0, 1) for across in (0, 1)]
