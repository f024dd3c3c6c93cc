"""A pass over a frame: blocks of segments with like counts, each through the program of `_block`."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from sssfit.frames import _block, _desk, _lanes, _order, _pairs, _spare, mipmap, points, split, surface
from sssfit.frames.camera import Camera
from sssfit.frames.points import VERSIONS, Settings

#: Depth in mm of what is outside the mask; its square is a float32.
_FAR = 1e15


class Seen(NamedTuple):
    """A frame as one profile's pass sees it: (H, W, C), (H, W), (H, W, 3) or None, (H, W)."""

    irradiance: Array
    depth: Array
    normal: Array | None
    mask: Array
    camera: Camera


class Random(NamedTuple):
    """What the samples are drawn from: the seed, the number of the frame, and the largest count."""

    seed: Array
    frame: Array
    most: Array


class Prepared(NamedTuple):
    """What all blocks share: counts by pixel, segments by block, and the place that each segment has got."""

    scene: _block.Scene
    table: points.Samples | None
    counts: Array
    order: Array
    largest: Array
    places: Array


def mean(seen: Seen, counts: Array, d: Array, random: Random, settings: Settings, rows: int) -> Array:
    """The scattered frame, (H, W, C); what is not sampled keeps its irradiance."""
    parts, counts, places = _every_block(_block.mean_of_samples, seen, counts, d, random, settings, rows)
    return _image(parts, counts, places, seen, d, settings.once_drawn())


def moments(
    seen: Seen, counts: Array, d: Array, random: Random, settings: Settings, rows: int
) -> tuple[Array, Array]:
    """The scattered frame, and the variance of one sample's luminance / pi, (H, W).

    The variance is 0 where fewer than two are drawn.
    """
    dark = seen._replace(irradiance=jnp.where(d != 0, seen.irradiance, 0))
    parts, counts, places = _every_block(_block.moments_of_samples, dark, counts, d, random, settings, rows)
    return _image_and_variance(parts, counts, places, seen, d, settings.once_drawn())


def _every_block(program, seen, counts, d, random, settings, rows):
    """Each lane's results; the counts of the pixels that are sampled, and where the results lie."""
    number, traced = _lanes.number(), _lanes.is_traced((seen, counts, d, random))
    drawn = settings.once_drawn()
    wanted = None if traced else jax.eval_shape(_scene, None, seen, drawn).layers
    spare = None if traced else _spare.take("scene", wanted, (seen, counts, d))
    prepared = prepare(spare, seen, counts, d, random, settings, rows, number)

    def lane(first, compiled):
        return compiled(program, prepared, first, seen, d, random, drawn, number)

    if number == 1 or traced:
        parts = [lane(first, _lane_within) for first in range(number)]
    else:
        parts = _lanes.at_once(lambda first: lane(first, _lane_alone), number)
    if spare is not None:
        _spare.keep("scene", prepared.scene.layers)
    return parts, prepared.counts, prepared.places


def prepare(spare, seen, counts, d, random, settings, rows, lanes):
    """`spare` is memory for the scene, or None. Programs apart: few settings matter to more than one."""
    table = _table(d, random, settings, rows) if settings.points == "table" else None
    split_settings = None if settings.split is None else settings
    return Prepared(
        _scene(spare, seen, settings.once_drawn()), table, *_ordered(seen, counts, d, split_settings, lanes)
    )


@functools.partial(jax.jit, static_argnames=("settings", "rows"))
def _table(d, random, settings, rows):
    of_all = {"count": random.most, "seed": random.seed, "frame": random.frame}
    return points.table(rows, positive(d), settings, **of_all)


@functools.partial(jax.jit, static_argnames=("settings", "lanes"))
def _ordered(seen, counts, d, settings, lanes):
    """Counts of the pixels that are sampled, and the order of their segments; settings for a split."""
    counts = jnp.where(seen.mask, counts, 0)
    if settings is not None:
        depth = jnp.where(seen.mask, seen.depth, 1)
        share = split.distant_share(depth, seen.camera, positive(d), settings)
        counts = jnp.where(share >= settings.split, counts, 0)
    return counts, *_order.of_segments(counts, lanes)


def _lane(program, prepared, first, seen, d, random, settings, lanes):
    """The results of every so manieth block, (blocks, segments, VERSIONS, ...)."""
    d = positive(d)
    blocks = len(prepared.order) // lanes
    per_row = -(-seen.depth.shape[1] // VERSIONS)

    def block(keep, at):
        segment = keep(prepared.order[at * lanes + first])
        pixels, within = _block.pixels_of(segment, per_row, seen, prepared.counts, random, settings, keep)
        if settings.points == "table":
            draw = _block.from_table(prepared.table)
        else:
            disc = None
            if settings.split is not None:
                disc = points.inner(split.radius(pixels.depth, seen.camera), d, settings)
            draw = _block.fresh(pixels, random.most, d, settings, disc)
        most = prepared.largest[at * lanes + first]
        found = program(prepared.scene, pixels, most, draw, d, seen.camera, settings)
        # Back from the version that a pixel uses to its place in the segment.
        return jnp.take_along_axis(found, within[..., None], axis=0).swapaxes(0, 1)

    def next_block(at, state):
        results, rows = state
        found, rows = _desk.at_work(block, rows, at)
        return results.at[at].set(found), rows

    shape = jax.eval_shape(lambda at: block(lambda value: value, at), 0).shape
    used = jnp.sum((prepared.largest > 0) & (jnp.arange(len(prepared.largest)) % lanes == first))
    start = jnp.zeros((blocks, *shape), jnp.float32), _desk.rows(block, 0)
    return jax.lax.fori_loop(0, used, next_block, start)[0]


_STATIC = ("program", "settings", "lanes")
_lane_within = jax.jit(_lane, static_argnames=_STATIC)
#: Not for use within another program, which has options of its own. Wider vectors are a fifth faster.
_lane_alone = jax.jit(_lane, static_argnames=_STATIC, compiler_options={"xla_cpu_prefer_vector_width": 512})


@functools.partial(jax.jit, static_argnames=("settings",))
def _image(parts, counts, places, seen, d, settings):
    return _composed(_assembled(parts, places, counts.shape), counts, seen, d, settings)


@functools.partial(jax.jit, static_argnames=("settings",))
def _image_and_variance(parts, counts, places, seen, d, settings):
    found = _assembled(parts, places, counts.shape)
    image = _composed(found[..., :-1], counts, seen, d, settings)
    return image, jnp.where(counts > 1, found[..., -1], 0)


def _composed(found, counts, seen, d, settings):
    """The samples' means, with each pixel's own share and what is not sampled."""
    scatters, d = d != 0, positive(d)
    drawn = counts > 0
    if settings.split is not None:
        disc = points.inner(split.radius(jnp.where(drawn, seen.depth, 1), seen.camera), d, settings)
        own = jnp.stack(disc.share, axis=-1)
        found = own * seen.irradiance + (found if settings.estimator == "unbiased" else (1 - own) * found)
    return jnp.where(drawn[..., None] & scatters, found, seen.irradiance)


def _assembled(parts, places, shape):
    """The blocks' results as an image, (H, W, ...)."""
    height, width = shape
    results = jnp.stack(parts, axis=1)
    found = results.reshape(-1, VERSIONS * results.shape[-1])[places]
    return found.reshape(height, -1, results.shape[-1])[:, :width]


def positive(d):
    """Shapes to divide by; a channel that does not scatter is left as it is at the end."""
    d = jnp.where(d != 0, d, jnp.max(d))
    return jnp.where(d != 0, d, 1)


@functools.partial(jax.jit, static_argnames="settings", donate_argnames="spare", keep_unused=True)
def _scene(spare: Array | None, seen: Seen, settings: Settings) -> _block.Scene:
    """What a sample finds in a pixel; `spare` is memory for its layers."""
    irradiance, depth, normal, mask, camera = seen
    surfaces: list[Array] = []
    if settings.distance == "surface":
        surfaces = [jnp.where(mask, depth, _FAR)]
        if normal is not None:
            slopes = surface.depth_slopes(depth, normal, camera)
            surfaces += [jnp.where(mask, slope, 0) for slope in slopes]
            if settings.estimator == "unbiased":
                irradiance = irradiance * surface.pixel_area(depth, normal, camera)[..., None]
    elif settings.estimator == "ratio":
        surfaces = [mask.astype(jnp.float32)]
    light = jnp.where(mask[..., None], irradiance, 0)
    filtered = None if settings.prefilter is None else mipmap.build(light, mask)
    outside = [0.0] * light.shape[-1] + [_FAR if settings.distance == "surface" else 0.0, 0.0, 0.0]
    layers = [
        jnp.pad(layer.reshape(-1), (0, 1), constant_values=value)
        for layer, value in zip([*jnp.moveaxis(light, -1, 0), *surfaces], outside, strict=False)
    ]
    return _block.Scene(_pairs.side_by_side(layers), filtered, len(layers), *depth.shape)
