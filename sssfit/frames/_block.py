"""The samples of a block of pixels: the one program that every frame, count and profile goes through.

Arrays have the shape (VERSIONS, segments): row v holds the pixels that use version v of the samples' table,
so that a row multiplies plain numbers.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from sssfit.frames import _desk, _pairs, mipmap, points, split, surface
from sssfit.frames.points import VERSIONS, Samples, density
from sssfit.sampling import disk, hashes, prefilter

#: Shares of red, green and blue in the luminance, Rec. 709.
LUMINANCE = (0.2126, 0.7152, 0.0722)


class Pixels(NamedTuple):
    """What is known of a block's pixels before they are sampled, arrays of (VERSIONS, segments)."""

    column: Array
    row: Array
    depth: Array
    count: Array
    # Axes of the sampling plane, turned by the pixel's own angle, in camera space; in the screen's own plane
    # they have no z, and where points have angles of their own there are none.
    first: tuple[Array, ...]
    second: tuple[Array, ...]
    # The position in camera space, and pixels for each mm of the screen's plane there, across and up.
    place: tuple[Array, ...]
    across: Array
    up: Array
    # Pixels for each mm^2 of the sampling plane, up to the depth at which it is met.
    per_area: Array
    # Random words of each pixel, (3, VERSIONS, segments).
    words: Array


class Scene(eqx.Module):
    """What samples fall on.

    Attributes:
        layers: words of each pixel, row by row (`_pairs.side_by_side`), in which those that do not count are
            dark and far away, and of one such pixel more: the light of each channel; then for a distance to
            the surface its depth, and how it changes by column and by row where that is known; or, for the
            ratio in the plane, whether the pixel counts.
        filtered: prefiltered copies of the light, where the settings ask for them.
        layers_count: how many layers there are; a word may have room for one more.
        height, width: of the frame.
    """

    layers: Array
    filtered: mipmap.Mipmap | None
    layers_count: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)


def pixels_of(segment, per_row, seen, counts, random, settings, keep):
    """The pixels of segments, and which place in its segment each has; `keep` as in `_desk`."""
    depth, normal, camera = seen.depth, seen.normal, seen.camera
    height, width = depth.shape
    # Which version a pixel uses is a permutation of the segment, drawn for each: no stripes.
    bits = hashes.pcg3d(segment, random.frame, random.seed ^ jnp.uint32(0x85EBCA6B))[0] % VERSIONS
    within = keep(jnp.arange(VERSIONS)[:, None] ^ bits.astype(jnp.int32))
    row, column = jnp.broadcast_arrays(segment // per_row, (segment % per_row) * VERSIONS + within)
    valid = (row < height) & (column < width)
    place = keep(jnp.minimum(row * width + column, height * width - 1))

    def own(layer):
        flat = layer.reshape(height * width, *layer.shape[2:])
        return keep(flat.at[place].get(mode="promise_in_bounds", wrap_negative_indices=False))

    count = jnp.where(valid, own(counts), 0)
    away = jnp.where(count > 0, own(depth), 1)
    # Whole numbers and a half would be float64 where that is on.
    middle = column.astype(jnp.float32) + 0.5, row.astype(jnp.float32) + 0.5
    position = camera.coordinates(*middle, away)
    words = keep(hashes.pcg3d(column, row, random.seed + random.frame * jnp.uint32(0x9E3779B9)))
    first, second, facing = _axes(settings, camera, words, middle, own, normal, keep)
    across, up = camera.pixels_per_mm(away)
    per_area = across * up * facing
    pixels = Pixels(*middle, away, count, first, second, position, across, up, per_area, words)
    return pixels, within


def _axes(settings, camera, words, middle, own, normal, keep):
    """The sampling plane's axes, and the cosine of its angle to the ray through the pixel."""
    turned = []
    if settings.points == "table":
        turned = [keep(part) for part in disk.rotation(_to_unit(words[0]))]
    if settings.plane == "screen":
        return (tuple(turned), (-turned[1], turned[0]), 1) if turned else ((), (), 1)
    normal = own(normal)
    column, row = middle
    facing = surface.facing(normal, column, row, camera)
    usable = facing >= surface.MIN_COSINE
    toward = jnp.where(usable[..., None], normal, jnp.array([0.0, 0.0, 1.0], normal.dtype))
    first, second = (tuple(jnp.moveaxis(axis, -1, 0)) for axis in disk.basis(toward))
    if turned:
        cosine, sine = turned
        pairs = list(zip(first, second, strict=True))
        first = tuple(cosine * t + sine * b for t, b in pairs)
        second = tuple(cosine * b - sine * t for t, b in pairs)
    return first, second, jnp.where(usable, facing, 1)


def mean_of_samples(scene, pixels, most, draw, d, camera, settings):
    """Mean of a block's samples, (VERSIONS, segments, C)."""
    values = _values(len(d), settings)
    totals = _accumulated(scene, pixels, most, draw, d, camera, settings, values, _sums)
    return jnp.stack(_means(scene, pixels, totals, settings), axis=-1)


def moments_of_samples(scene, pixels, most, draw, d, camera, settings):
    """The same, and the variance of what one sample adds to the luminance / pi, (..., C + 1)."""
    values = _values(len(d), settings)
    slope = [share / jnp.pi for share in LUMINANCE[: len(d)]]
    is_ratio = settings.estimator == "ratio"
    pairs = [(i, j) for i in range(values) for j in range(i + 1)] if is_ratio else []

    def add(total, found):
        if is_ratio:
            return _sums(total, [*found, *(found[i] * found[j] for i, j in pairs)])
        return _sums(total, [*found, jnp.square(_weighed(slope, found))])

    number = values + max(len(pairs), 1)
    totals = _accumulated(scene, pixels, most, draw, d, camera, settings, number, add)
    count = jnp.maximum(pixels.count, 1).astype(jnp.float32)
    mean, products = [total / count for total in totals[:values]], totals[values:]
    if is_ratio and settings.split is not None:
        # The mean of what goes beyond a pixel's own disc is weighted by its share.
        disc = points.inner(split.radius(pixels.depth, camera), d, settings)
        slope = [a * (1 - own) for a, own in zip(slope, disc.share, strict=True)]
    if is_ratio:
        variance = _ratio_variance(count, mean, products, pairs, slope)
    else:
        variance = (products[0] - count * jnp.square(_weighed(slope, mean))) / jnp.maximum(count - 1, 1)
    image = _means(scene, pixels, totals[:values], settings)
    return jnp.stack([*image, jnp.maximum(variance, 0)], axis=-1)


def _values(channels, settings):
    """How many sums make an image: for the ratio one more for each channel."""
    return channels * (2 if settings.estimator == "ratio" else 1)


def _sums(total, values):
    return [a + b for a, b in zip(total, values, strict=True)]


def _means(scene, pixels, totals, settings):
    """The image's channels."""
    if settings.estimator == "unbiased":
        return [total / jnp.maximum(pixels.count, 1) for total in totals]
    # Where nothing was hit, all that is known is the pixel itself.
    column, row = (place.astype(jnp.int32) for place in (pixels.column, pixels.row))
    at = jnp.clip(row * scene.width + column, 0, scene.width * scene.height)
    own, channels = _pairs.at(scene.layers, at), len(totals) // 2
    return [
        jnp.where(b > 0, a / jnp.where(b > 0, b, 1), own[c])
        for c, (a, b) in enumerate(zip(totals[:channels], totals[channels:], strict=True))
    ]


def _ratio_variance(count, mean, products, pairs, slope):
    """By the delta method: how the ratio of two means changes with each of them."""
    channels = len(slope)
    below = [1 / jnp.where(weight > 0, weight, 1) for weight in mean[channels:]]
    slopes = [a * b for a, b in zip(slope, below, strict=True)]
    slopes += [-a * lit * b for a, lit, b in zip(slopes, mean[:channels], below, strict=True)]
    variance = 0.0
    for (i, j), product in zip(pairs, products, strict=True):
        covariance = (product - count * mean[i] * mean[j]) / jnp.maximum(count - 1, 1)
        variance += slopes[i] * slopes[j] * covariance * (1 if i == j else 2)
    return variance


def _weighed(shares, values):
    return sum(share * value for share, value in zip(shares, values, strict=True))


def from_table(table):
    """Samples from a table of (samples, VERSIONS)."""

    def row(number, keep):
        return jax.tree.map(lambda v: jax.lax.dynamic_index_in_dim(v, number, keepdims=False)[:, None], table)

    return row


def fresh(pixels, count, d, settings, beyond):
    """Samples of each pixel's own."""

    def draw(number, keep):
        aim = points.aimed(number, pixels.words, d, settings, count=count, beyond=beyond, keep=keep)
        if settings.distance == "surface":
            # Needed for the place, and again for the distance of what is found there.
            aim = aim._replace(x=keep(aim.x), y=keep(aim.y))
        return points.weighed(aim, d, settings, beyond, keep)

    return draw


def _accumulated(scene, pixels, most, draw, d, camera, settings, sums, add):
    """The sums that `add` makes of what a block's samples find."""

    def step(keep, number, totals):
        sample = draw(number, keep)
        index = keep(_index(scene, pixels, number, sample, camera))
        return add(totals, _found(scene, pixels, sample, index, d, camera, settings, keep))

    def one(state):
        number, totals, rows = state
        totals, rows = _desk.at_work(step, rows, number, totals)
        return number + 1, totals, rows

    start = jnp.int32(0), [jnp.zeros(pixels.count.shape, jnp.float32)] * sums
    rows = _desk.rows(step, *start)
    return jax.lax.while_loop(lambda state: state[0] < most, one, (*start, rows))[1]


def _index(scene, pixels, number, sample: Samples, camera):
    """The pixel that a sample hits; the one after the last for none, or beyond a pixel's count."""
    column, row, _ = met(pixels, sample, camera)
    # What is left of 0 or far away becomes an unsigned number beyond the frame.
    column, row = (jnp.floor(place).astype(jnp.int32).astype(jnp.uint32) for place in (column, row))
    used = (column < scene.width) & (row < scene.height) & (number < pixels.count)
    return jnp.where(used, row * scene.width + column, scene.width * scene.height).astype(jnp.int32)


def _found(scene, pixels, sample: Samples, index, d, camera, settings, keep):
    """What a sample adds: weight times light of each channel, then for the ratio the weights."""
    column, row, offset = met(pixels, sample, camera)
    hit = _pairs.at(scene.layers, index, keep)
    light, ground = hit[: len(d)], hit[len(d) : scene.layers_count]
    weights = list(sample.weights)
    if settings.distance == "surface":
        across, down = (place - jnp.floor(place) - 0.5 for place in (column, row))
        depth = ground[0] if len(ground) == 1 else ground[0] + ground[1] * across + ground[2] * down
        weights = _weights(pixels, depth, offset, sample, d, camera, settings, keep)
    counts = ground[0] if settings.distance == "plane" and ground else None
    if scene.filtered is not None:
        light, coverage = _filtered(scene.filtered, pixels, sample, column, row, settings)
        weights = [jnp.where(index < scene.width * scene.height, weight, 0) for weight in weights]
        if settings.distance == "plane":
            counts = coverage
        else:
            # Whether the surface is hit is known of the sample's own pixel alone.
            light = [value / jnp.where(coverage > 0, coverage, 1) for value in light]
    lit = [weight * value for weight, value in zip(weights, light, strict=True)]
    if settings.estimator == "unbiased":
        return lit
    return lit + (weights if counts is None else [weight * counts for weight in weights])


def met(pixels, sample: Samples, camera):
    """Where a sample falls, in pixels, and the offset in space."""
    x, y = sample.x, sample.y
    offset = x, y
    if pixels.first:
        offset = tuple(x * a + y * b for a, b in zip(pixels.first, pixels.second, strict=True))
    if camera.projection == "perspective" and len(offset) == 3:
        away = jnp.maximum(pixels.depth - offset[2], 1e-3 * pixels.depth)
        column = camera.cx + (pixels.place[0] + offset[0]) * (camera.fx / away)
        row = camera.cy - (pixels.place[1] + offset[1]) * (camera.fy / away)
    else:
        column = pixels.column + offset[0] * pixels.across
        row = pixels.row - offset[1] * pixels.up
    return column, row, offset


def _filtered(filtered, pixels, sample, column, row, settings):
    """The prefiltered light of each channel around a place, and how much of its surroundings counts."""
    texel = mipmap.premultiplied(filtered, column, row, level(pixels, sample, settings))
    return [texel[..., c] for c in range(texel.shape[-1] - 1)], texel[..., -1]


def level(pixels, sample: Samples, settings, top: float = prefilter.TOP):
    """The level of the prefiltered light that a sample reads, at most the top one."""
    around = sample.spacing * (2 * jnp.pi) * sample.radius
    count = jnp.maximum(pixels.count, 1)
    bias = prefilter.bias_from_scale(settings.prefilter)
    density = jnp.where(around > 0, 1 / jnp.where(around > 0, around, 1), jnp.inf)
    return prefilter.level(density, count, 1 / pixels.per_area, bias=bias, top=top)


def _weights(pixels, last, offset, sample, d, camera, settings, keep):
    """Weight of a sample in each channel, by the distance of the surface that it hits."""
    moved, per_area = offset[:2], pixels.per_area
    if camera.projection == "perspective":
        # The place met lies on the ray through the sample, and the plane meets rays at other depths too.
        if len(offset) == 3:
            away = pixels.depth - offset[2]
            further = (last - away) / away
            per_area = per_area * (pixels.depth / away) ** 3
        else:
            # Nothing where depth is constant, to the last bit.
            further = (last - pixels.depth) * (pixels.across * (1 / camera.fx))
        moved = [v + (v + p) * further for v, p in zip(moved, pixels.place[:2], strict=True)]
    distance = keep(jnp.sqrt(jnp.square(moved[0]) + jnp.square(moved[1]) + jnp.square(pixels.depth - last)))
    if settings.estimator == "ratio":
        change = sample.spacing
    else:
        # From the plane's area to the surface's, which the light carries, and to its larger distance.
        change = keep(sample.spacing * sample.radius * per_area / jnp.maximum(distance, 1e-12))
    weights = [change * density(distance, shape, settings.cutoff) for shape in d]
    return [sample.of_channel(c, weight, len(d)) for c, weight in enumerate(weights)]


def _to_unit(words):
    return (words >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
