"""The samples of a block of pixels: the one program that every frame, count and profile goes through.

Arrays have the shape (VERSIONS, segments): row v holds the pixels that use version v of the samples' table,
so that a row multiplies plain numbers.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from sssfit.frames import mipmap, points, surface
from sssfit.frames.points import VERSIONS, Samples, density
from sssfit.sampling import disk, hashes, prefilter

#: Shares of red, green and blue in the luminance, Rec. 709.
_LUMINANCE = (0.2126, 0.7152, 0.0722)


class Pixels(NamedTuple):
    """What is known of a block's pixels before they are sampled, arrays of (VERSIONS, segments)."""

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
    # Random words of each pixel, (3, VERSIONS, segments).
    words: Array


class Scene(eqx.Module):
    """What samples fall on; pixels row by row, in which those that do not count are dark and far away.

    Attributes:
        light: of each channel, (pixels, C).
        last: whether the pixel counts, or the depth of the surface there, (pixels,).
        slopes: how that depth changes by column and by row, two of (pixels,), or none.
        filtered: prefiltered copies of the light, where the settings ask for them.
        height, width: of the frame.
    """

    light: Array
    last: Array
    slopes: tuple[Array, ...]
    filtered: mipmap.Mipmap | None
    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)


def pixels_of(segment, per_row, seen, counts, random, settings):
    """The pixels of segments, and which place in its segment each has."""
    depth, normal, camera = seen.depth, seen.normal, seen.camera
    height, width = depth.shape
    # Which version a pixel uses is a permutation of the segment, drawn for each: no stripes.
    bits = hashes.pcg3d(segment, random.frame, random.seed ^ jnp.uint32(0x85EBCA6B))[0] % VERSIONS
    within = jnp.arange(VERSIONS)[:, None] ^ bits.astype(jnp.int32)
    row, column = jnp.broadcast_arrays(segment // per_row, (segment % per_row) * VERSIONS + within)
    valid = (row < height) & (column < width)
    at = jnp.minimum(row, height - 1), jnp.minimum(column, width - 1)
    count = jnp.where(valid, counts[at], 0)
    away = jnp.where(count > 0, depth[at], 1)
    middle = column + 0.5, row + 0.5
    place = camera.coordinates(*middle, away)
    words = hashes.pcg3d(column, row, random.seed + random.frame * jnp.uint32(0x9E3779B9))
    facing = jnp.ones_like(away)
    tangent, bitangent = (1.0, 0.0), (0.0, 1.0)
    if settings.plane == "tangent":
        facing = surface.facing(normal[at], *middle, camera)
        usable = facing >= surface.MIN_COSINE
        toward = jnp.where(usable[..., None], normal[at], jnp.array([0.0, 0.0, 1.0]))
        facing = jnp.where(usable, facing, 1)
        tangent, bitangent = (tuple(jnp.moveaxis(v, -1, 0)) for v in disk.basis(toward))
    # Fresh angles need no turning.
    turned = jnp.float32(settings.points == "table")
    cosine, sine = disk.rotation(_to_unit(words[0]) * turned)
    first = tuple(cosine * t + sine * b for t, b in zip(tangent, bitangent, strict=True))
    second = tuple(cosine * b - sine * t for t, b in zip(tangent, bitangent, strict=True))
    across, up = camera.pixels_per_mm(away)
    steps = (across * first[0], across * second[0]), (-up * first[1], -up * second[1])
    area = 1 / (across * up * facing)
    return Pixels(*middle, away, count, first, second, place, *steps, area, words), within


def mean_of_samples(scene, pixels, most, draw, d, camera, settings):
    """Mean of a block's samples, (VERSIONS, segments, C)."""
    channels = len(d)
    sums = channels * (2 if settings.estimator == "ratio" else 1)

    def add(total, values):
        return [a + b for a, b in zip(total, values, strict=True)]

    totals = _accumulated(scene, pixels, most, draw, d, camera, settings, sums, add)
    if settings.estimator == "ratio":
        # Where nothing was hit, all that is known is the pixel itself.
        column, row = (place.astype(jnp.int32) for place in (pixels.column, pixels.row))
        own = scene.light.at[row * scene.width + column].get(mode="clip")
        totals = [
            jnp.where(b > 0, a / jnp.where(b > 0, b, 1), own[..., c])
            for c, (a, b) in enumerate(zip(totals[:channels], totals[channels:], strict=True))
        ]
    else:
        totals = [total / jnp.maximum(pixels.count, 1) for total in totals]
    return jnp.stack(totals, axis=-1)


def variance_of_samples(scene, pixels, most, draw, d, camera, settings):
    """Variance of what one sample adds to the luminance / pi of the estimate, (VERSIONS, segments, 1)."""
    channels = len(d)
    values = channels * (2 if settings.estimator == "ratio" else 1)
    pairs = [(i, j) for i in range(values) for j in range(i + 1)]

    def add(total, found):
        return [a + b for a, b in zip(total, [*found, *(found[i] * found[j] for i, j in pairs)], strict=True)]

    totals = _accumulated(scene, pixels, most, draw, d, camera, settings, values + len(pairs), add)
    count = jnp.maximum(pixels.count, 1).astype(jnp.float32)
    mean = [total / count for total in totals[:values]]
    slope = [jnp.full_like(count, share / jnp.pi) for share in _LUMINANCE[:channels]]
    if settings.estimator == "ratio":
        # The delta method: how the ratio of two means changes with each of them.
        below = [1 / jnp.where(weight > 0, weight, 1) for weight in mean[channels:]]
        slope = [a * b for a, b in zip(slope, below, strict=True)]
        slope += [-a * lit * b for a, lit, b in zip(slope, mean[:channels], below, strict=True)]
    variance = 0.0
    for (i, j), product in zip(pairs, totals[values:], strict=True):
        covariance = (product - count * mean[i] * mean[j]) / jnp.maximum(count - 1, 1)
        variance += slope[i] * slope[j] * covariance * (1 if i == j else 2)
    return jnp.maximum(variance, 0)[..., None]


class Draw(NamedTuple):
    """Samples in two steps: by number, and from what the first step found."""

    aimed: Callable
    weighed: Callable


def from_table(table):
    """Samples from a table of (samples, VERSIONS)."""

    def row(number):
        return jax.tree.map(lambda v: jax.lax.dynamic_index_in_dim(v, number, keepdims=False)[:, None], table)

    return Draw(row, lambda row: row)


def fresh(pixels, count, d, settings, beyond):
    """Samples of each pixel's own."""
    return Draw(
        lambda number: points.aimed(number, pixels.words, d, settings, count=count, beyond=beyond),
        lambda aim: points.weighed(aim, d, settings, beyond),
    )


def _accumulated(scene, pixels, most, draw: Draw, d, camera, settings, sums, add):
    """The sums that `add` makes of what a block's samples find."""

    def weighed(aim):
        sample = draw.weighed(aim)
        return sample, _index(scene, pixels, sample, camera)

    def one(state):
        number, totals, (sample, index), aim = state
        found = _found(scene, pixels, sample, index, d, camera, settings)
        taken = number < pixels.count
        totals = add(totals, [jnp.where(taken, value, 0) for value in found])
        # Each step is a turn of the loop ahead of the next: XLA fuses what is found with where it is found,
        # number by number, and computes again what several results need, unless a turn lies between.
        return number + 1, totals, weighed(aim), draw.aimed(number + 2)

    nothing = [jnp.zeros(pixels.count.shape, jnp.float32)] * sums
    start = jnp.int32(0), nothing, weighed(draw.aimed(0)), draw.aimed(1)
    return jax.lax.while_loop(lambda state: state[0] < most, one, start)[1]


def _index(scene, pixels, sample: Samples, camera):
    """The pixel that a sample hits, -1 for none."""
    column, row, _ = _hit(pixels, sample, camera)
    inside = (column >= 0) & (column < scene.width) & (row >= 0) & (row < scene.height)
    column, row = (jnp.where(inside, place, 0).astype(jnp.int32) for place in (column, row))
    return jnp.where(inside, row * scene.width + column, -1)


def _found(scene, pixels, sample: Samples, index, d, camera, settings):
    """What a sample adds: weight times light of each channel, then for the ratio the weights."""

    def at(layer):
        return layer.at[jnp.maximum(index, 0)].get(mode="promise_in_bounds", wrap_negative_indices=False)

    column, row, offset = _hit(pixels, sample, camera)
    lit = at(scene.light)
    light = [lit[..., c] for c in range(len(d))]
    last = at(scene.last)
    if scene.slopes:
        across, down = (place - jnp.floor(place) - 0.5 for place in (column, row))
        last = last + at(scene.slopes[0]) * across + at(scene.slopes[1]) * down
    if scene.filtered is not None:
        light, coverage = _filtered(scene.filtered, pixels, sample, column, row, settings)
        if settings.distance == "plane":
            last = coverage
        else:
            # Whether the surface is hit is known of the sample's own pixel alone.
            light = [value / jnp.where(coverage > 0, coverage, 1) for value in light]
    weights = list(sample.weights)
    if settings.distance == "surface":
        weights = _weights(pixels, last, offset, sample, d, camera, settings)
    # Beyond the frame nothing is hit; light that does not count is 0 already.
    weights = [jnp.where(index >= 0, weight, 0) for weight in weights]
    lit = [weight * value for weight, value in zip(weights, light, strict=True)]
    if settings.estimator == "unbiased":
        return lit
    return lit + ([w * last for w in weights] if settings.distance == "plane" else weights)


def _hit(pixels, sample: Samples, camera):
    """Where a sample falls, in pixels, and the offset in space."""
    x, y = sample.x, sample.y
    offset = tuple(x * a + y * b for a, b in zip(pixels.first, pixels.second, strict=True))
    if camera.projection == "perspective" and len(offset) == 3:
        away = jnp.maximum(pixels.depth - offset[2], 1e-3 * pixels.depth)
        column = camera.cx + (pixels.place[0] + offset[0]) * (camera.fx / away)
        row = camera.cy - (pixels.place[1] + offset[1]) * (camera.fy / away)
    else:
        column = pixels.column + (x * pixels.across[0] + y * pixels.across[1])
        row = pixels.row + (x * pixels.down[0] + y * pixels.down[1])
    return column, row, offset


def _filtered(filtered, pixels, sample, column, row, settings):
    """The prefiltered light of each channel around a place, and how much of its surroundings counts."""
    around = sample.spacing * (2 * jnp.pi) * sample.radius
    count = jnp.maximum(pixels.count, 1)
    bias = prefilter.bias_from_scale(settings.prefilter)
    density = jnp.where(around > 0, 1 / jnp.where(around > 0, around, 1), jnp.inf)
    level = prefilter.level(density, count, pixels.plane_area, bias=bias)
    texel = mipmap.premultiplied(filtered, column, row, level)
    return [texel[..., c] for c in range(texel.shape[-1] - 1)], texel[..., -1]


def _weights(pixels, last, offset, sample, d, camera, settings):
    """Weight of a sample in each channel, by the distance of the surface that it hits."""
    moved, area = offset[:2], pixels.plane_area
    if camera.projection == "perspective":
        # The place met lies on the ray through the sample, and the plane meets rays at other depths too.
        away = pixels.depth - offset[2] if len(offset) == 3 else pixels.depth
        stretch = last / away
        moved = [v * stretch + p * (stretch - 1) for v, p in zip(moved, pixels.place[:2], strict=True)]
        if len(offset) == 3:
            area = area * (away / pixels.depth) ** 3
    distance = jnp.sqrt(jnp.square(moved[0]) + jnp.square(moved[1]) + jnp.square(pixels.depth - last))
    weights = [sample.spacing * density(distance, shape, settings.cutoff) for shape in d]
    weights = [sample.of_channel(c, weight, len(d)) for c, weight in enumerate(weights)]
    if settings.estimator == "ratio":
        return weights
    # From the plane's area to the surface's, which the light carries, and to its larger distance.
    change = sample.radius / (jnp.maximum(distance, 1e-12) * area)
    return [w * change for w in weights]


def _to_unit(words):
    return (words >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
