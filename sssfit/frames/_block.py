"""The samples of a block of pixels: the one program that every frame, count and profile goes through."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from sssfit.frames import surface
from sssfit.frames.points import VERSIONS, density
from sssfit.sampling import disk, hashes

#: Samples between two looks at whether a block is done.
STRIDE = 8


class Pixels(NamedTuple):
    """What is known of a block's pixels before they are sampled, arrays of (segments, VERSIONS)."""

    column: Array
    row: Array
    depth: Array
    count: Array
    # Axes of the sampling plane, turned by the pixel's own angle, and the position: camera space. In the
    # screen's own plane the axes have no z.
    first: tuple[Array, ...]
    second: tuple[Array, ...]
    place: tuple[Array, ...]
    # Pixels for each mm along the two axes, across and down.
    across: tuple[Array, Array]
    down: tuple[Array, Array]
    # Area of the sampling plane in a pixel, up to the depth at which it is met.
    plane_area: Array


def pixels_of(segment, per_row, depth, normal, counts, camera, words, settings):
    """The pixels of segments, and the version of the table that each lane of a segment uses."""
    height, width = depth.shape
    # Which version a pixel uses is a permutation of the segment, drawn for each: no stripes.
    bits = hashes.pcg3d(segment, words[1], words[0] ^ jnp.uint32(0x85EBCA6B))[0] % VERSIONS
    versions = jnp.arange(VERSIONS) ^ bits[:, None].astype(jnp.int32)
    row, column = (segment // per_row)[:, None], (segment % per_row)[:, None] * VERSIONS + versions
    valid = (row < height) & (column < width)
    at = jnp.minimum(row, height - 1), jnp.minimum(column, width - 1)
    count = jnp.where(valid, counts[at], 0)
    away = jnp.where(count > 0, depth[at], 1)
    middle = column + 0.5, row + 0.5
    place = camera.coordinates(*middle, away)
    cosine, sine = disk.rotation(
        _to_unit(hashes.pcg3d(column, row, words[0] + words[1] * jnp.uint32(0x9E3779B9))[0])
    )
    facing = jnp.ones_like(away)
    tangent, bitangent = (1.0, 0.0), (0.0, 1.0)
    if settings.plane == "tangent":
        facing = surface.facing(normal[at], *middle, camera)
        usable = facing >= surface.MIN_COSINE
        toward = jnp.where(usable[..., None], normal[at], jnp.array([0.0, 0.0, 1.0]))
        facing = jnp.where(usable, facing, 1)
        tangent, bitangent = (tuple(jnp.moveaxis(v, -1, 0)) for v in disk.basis(toward))
    first = tuple(cosine * t + sine * b for t, b in zip(tangent, bitangent, strict=True))
    second = tuple(cosine * b - sine * t for t, b in zip(tangent, bitangent, strict=True))
    across, up = camera.pixels_per_mm(away)
    steps = (across * first[0], across * second[0]), (-up * first[1], -up * second[1])
    return Pixels(*middle, away, count, first, second, place, *steps, 1 / (across * up * facing)), versions


def mean_of_samples(source, pixels, most, drawn, camera, shape, settings):
    """Mean of a block's samples, (segments, VERSIONS, C)."""
    channels = len(drawn.d)
    zero = jnp.zeros(pixels.count.shape, jnp.float32)

    def stride(state):
        number, totals = state
        now = jax.tree.map(
            lambda v: jax.lax.dynamic_slice_in_dim(v, number, STRIDE)[:, None], drawn._replace(d=None)
        )
        index, offset, within = _hit(pixels, now.x, now.y, camera, shape)
        # Apart from each other, the arithmetic before and after a lookup is done on vectors; fused with it,
        # one number at a time.
        index = jax.lax.optimization_barrier(index)
        found = jax.lax.optimization_barrier(source.at[index].get(mode="promise_in_bounds"))
        last = _met(found[..., channels:], within, settings)
        weights = _weights(pixels, last, offset, now._replace(d=drawn.d), camera, settings)
        taken = number + jnp.arange(STRIDE)[:, None, None] < pixels.count
        weights = [jnp.where(taken, w, 0) for w in weights]
        lit = [w * found[..., c] for c, w in enumerate(weights)]
        if settings.estimator == "ratio":
            lit += weights
        return number + STRIDE, [
            total + jnp.sum(more, axis=0) for total, more in zip(totals, lit, strict=True)
        ]

    sums = channels * (2 if settings.estimator == "ratio" else 1)
    _, totals = jax.lax.while_loop(lambda state: state[0] < most, stride, (jnp.int32(0), [zero] * sums))
    if settings.estimator == "ratio":
        totals = [
            a / jnp.where(b > 0, b, 1) for a, b in zip(totals[:channels], totals[channels:], strict=True)
        ]
    else:
        totals = [total / jnp.maximum(pixels.count, 1) for total in totals]
    return jnp.stack(totals, axis=-1)


def _hit(pixels, x, y, camera, shape):
    """Where a sample falls: the pixel as an index into the source, the offset in space, the place in it."""
    offset = tuple(x * a + y * b for a, b in zip(pixels.first, pixels.second, strict=True))
    if camera.projection == "perspective" and len(offset) == 3:
        away = jnp.maximum(pixels.depth - offset[2], 1e-3 * pixels.depth)
        column = camera.cx + (pixels.place[0] + offset[0]) * (camera.fx / away)
        row = camera.cy - (pixels.place[1] + offset[1]) * (camera.fy / away)
    else:
        column = pixels.column + (x * pixels.across[0] + y * pixels.across[1])
        row = pixels.row + (x * pixels.down[0] + y * pixels.down[1])
    height, width = shape
    # Shifted by the rim before the rounding down.
    column, row = jnp.clip(column + 1, 0, width + 1.5), jnp.clip(row + 1, 0, height + 1.5)
    i, j = jnp.floor(column), jnp.floor(row)
    within = column - i - 0.5, row - j - 0.5
    return j.astype(jnp.int32) * (width + 2) + i.astype(jnp.int32), offset, within


def _met(last, within, settings):
    """The depth at which a sample meets the surface, or whether the pixel there counts."""
    met = last[..., 0]
    if settings.distance == "surface" and last.shape[-1] == 3:
        met = met + last[..., 1] * within[0] + last[..., 2] * within[1]
    return met


def _weights(pixels, last, offset, drawn, camera, settings):
    """Weight of samples in each channel."""
    if settings.distance == "plane":
        return [w * last for w in drawn.weights] if settings.estimator == "ratio" else drawn.weights
    moved, area = offset[:2], pixels.plane_area
    if camera.projection == "perspective":
        # The place met lies on the ray through the sample, and the plane meets rays at other depths too.
        away = pixels.depth - offset[2] if len(offset) == 3 else pixels.depth
        stretch = last / away
        moved = [v * stretch + p * (stretch - 1) for v, p in zip(moved, pixels.place[:2], strict=True)]
        if len(offset) == 3:
            area = area * (away / pixels.depth) ** 3
    distance = jnp.sqrt(jnp.square(moved[0]) + jnp.square(moved[1]) + jnp.square(pixels.depth - last))
    weights = [drawn.scale * density(distance, shape, settings.cutoff) for shape in drawn.d]
    if settings.estimator == "ratio":
        return weights
    # From the plane's area to the surface's, which the source carries, and to its larger distance.
    change = drawn.radius / (jnp.maximum(distance, 1e-12) * area)
    return [w * change for w in weights]


def _to_unit(words):
    return (words >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
