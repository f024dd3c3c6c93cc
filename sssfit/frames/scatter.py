"""Monte Carlo scattering of whole frames, at a cost that follows the samples.

A frame is cut into segments of sixteen pixels of a row. They are sorted by the largest count in each, and go
through one program, block by block, which draws as many samples as the block's largest count: the time is
that of the samples, whatever the mean count. Each profile has a pass of its own over its own pixels, so that
no sample asks which profile it hit, and profiles cannot bleed into each other.
"""

import functools
import os
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames import surface
from sssfit.frames._block import STRIDE, mean_of_samples, pixels_of
from sssfit.frames.camera import Camera
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import VERSIONS, Settings, table

DEFAULT = Settings()
#: Pixels of one block.
_BLOCK = 8192
#: Depth in mm of what is outside the mask; its square is a float32.
_FAR = 1e15


def scatter(
    irradiance: ArrayLike,
    depth: ArrayLike,
    camera: Camera,
    *,
    d: ArrayLike | Sequence[float],
    counts: ArrayLike,
    mask: ArrayLike | None = None,
    normal: ArrayLike | None = None,
    settings: Settings = DEFAULT,
    most: int | None = None,
    seed: int = 0,
    frame: int = 0,
) -> Array:
    """Scatter the pixels of one profile.

    Args:
        irradiance: (H, W, C), linear, of any unit; finite within the mask.
        depth: (H, W), mm along the viewing axis, > 0 within the mask.
        camera: of the frame.
        d: shape parameter of each channel, mm, (C,), >= 0; a channel of 0 keeps its irradiance.
        counts: samples of each pixel, integers, (H, W) or one number; a pixel without samples (0 or below)
            keeps its irradiance.
        mask: (H, W), the pixels with this profile; the others give nothing and keep their irradiance.
            By default all.
        normal: (H, W, 3) in camera space, of length 1; not needed where `settings.distance` is "plane" and
            `settings.plane` is "screen", nor for the ratio on a screen plane.
        settings: see `points.Settings`; each needs a program of its own.
        most: the largest count, on the host; by default that of `counts`, which then must be known.
        seed, frame: integers; other ones give independent samples.

    Returns:
        (H, W, C) float32, in the irradiance's unit, for albedo 1. What a pixel gets depends on its own count,
        place, seed and frame alone, not on the other counts or the frame's blocks. Differentiable forward
        (`jax.jvp`), not in reverse: how many samples are drawn is known when they are drawn.

    Raises:
        ValueError: shapes that do not fit, an unknown setting, or a normal that is missing.

    Source: Xie et al. 2020, Eq 19 to 24; the area's Jacobian and the balance heuristic are own derivations.

    Example:
        >>> from sssfit.frames.camera import orthographic
        >>> lit = jnp.ones((64, 64, 3))
        >>> found = scatter(lit, jnp.full((64, 64), 500.0), orthographic(64, 64, 0.5), d=[0.5, 0.3, 0.2],
        ...                 counts=64, settings=Settings(distance="plane"))
        >>> 0.9 < float(found[32, 32, 0]) < 1.1
        True
    """
    settings.check()
    irradiance, depth = jnp.asarray(irradiance, jnp.float32), jnp.asarray(depth, jnp.float32)
    shape = depth.shape
    d = jnp.asarray(d, jnp.float32)
    if irradiance.ndim != 3 or irradiance.shape[:2] != shape or d.shape != irradiance.shape[2:]:
        raise ValueError(
            "irradiance must have the shape (H, W, C), depth (H, W) and d (C,), "
            f"got {irradiance.shape}, {shape} and {d.shape}"
        )
    if most is None:
        most = int(np.max(np.asarray(counts), initial=0))
    counts = jnp.broadcast_to(jnp.asarray(counts, jnp.int32), shape)
    mask = jnp.ones(shape, bool) if mask is None else jnp.asarray(mask, bool)
    needs_normal = settings.plane == "tangent" or (
        settings.distance == "surface" and settings.estimator == "unbiased"
    )
    if needs_normal and normal is None:
        raise ValueError(
            "normal must be given: the area that a pixel sees, or its tangent plane, follow from it"
        )
    used = normal is not None and (settings.distance == "surface" or needs_normal)
    normal = jnp.asarray(normal, jnp.float32) if used else None
    words = jnp.uint32(seed), jnp.uint32(frame)
    return _pass(irradiance, depth, normal, mask, counts, d, camera, words, settings, most, _lanes())


def every_profile(
    frame: Frame,
    profiles: Mapping[int, Any],
    *,
    counts: ArrayLike,
    settings: Settings = DEFAULT,
    seed: int = 0,
) -> Array:
    """Scatter a whole frame, a pass for each profile.

    Args:
        frame: see `gbuffer.Frame`.
        profiles: shape parameter of each channel, mm, (C,), by profile id; None where nothing scatters.
        counts, settings, seed: as for `scatter`.

    Returns:
        (H, W, C) float32; the background and profiles of None keep their irradiance.

    Raises:
        ValueError: as `scatter`, or the frame has a profile that is not among `profiles`.

    Source: as `scatter`.

    Example:
        >>> from sssfit.frames import procedural
        >>> profiles = {1: [1.0, 0.5, 0.3], 2: None}
        >>> found = every_profile(procedural.frame(width=64, height=36), profiles, counts=16)
        >>> found.shape
        (36, 64, 3)
    """
    ids = np.unique(np.asarray(frame.profile_id))
    unknown = [int(i) for i in ids if i != 0 and int(i) not in profiles]
    if unknown:
        known = ", ".join(map(str, sorted(profiles)))
        raise ValueError(
            f"profiles must name every id of the frame: {unknown[0]} is missing, there are {known}"
        )
    most = int(np.max(np.asarray(counts), initial=0))
    image = jnp.asarray(frame.irradiance, jnp.float32)
    for number in ids:
        d = profiles.get(int(number)) if number else None
        if d is not None:
            mask = jnp.asarray(frame.profile_id) == number
            found = scatter(
                frame.irradiance, frame.depth, frame.camera, d=d, counts=counts, mask=mask,
                normal=frame.normal, settings=settings, most=most, seed=seed,
            )  # fmt: skip
            image = jnp.where(mask[..., None], found, image)
    return image


@functools.partial(jax.jit, static_argnames=("settings", "most", "lanes"))
def _pass(irradiance, depth, normal, mask, counts, d, camera, words, settings, most, lanes):
    height, width = depth.shape
    counts = jnp.where(mask, counts, 0)
    # A channel that does not scatter is left as it is below; nothing may be divided by its shape.
    scatters, d = d != 0, jnp.where(d != 0, d, jnp.max(d))
    d = jnp.where(d != 0, d, 1)
    drawn = table(max(most, 1), d, settings, seed=words[0], frame=words[1])
    unused = -len(drawn.x) % STRIDE
    drawn = jax.tree.map(lambda v: jnp.pad(v, ((0, unused), (0, 0))), drawn._replace(d=None))._replace(d=d)
    source = _source(irradiance, depth, normal, mask, camera, settings)
    per_row = -(-width // VERSIONS)
    padded = jnp.pad(counts, ((0, 0), (0, per_row * VERSIONS - width)))
    largest = jnp.max(padded.reshape(-1, VERSIONS), axis=1)
    order = jnp.argsort(-largest)
    segments = _BLOCK // VERSIONS
    blocks = -(-len(order) // (segments * lanes)) * lanes
    order = jnp.pad(order, (0, blocks * segments - len(order)), constant_values=len(order))
    ordered = jnp.where(order < len(largest), largest[jnp.minimum(order, len(largest) - 1)], 0)
    order, ordered = (v.reshape(blocks, segments) for v in (order, ordered))

    def block(segment, most_here):
        pixels, versions = pixels_of(segment, per_row, depth, normal, counts, camera, words, settings)
        found = mean_of_samples(source, pixels, jnp.max(most_here), drawn, camera, (height, width), settings)
        # Back from the version that a pixel uses to its place in the segment.
        return jnp.take_along_axis(found, versions[..., None], axis=1)

    def lane(first):
        mine = order[first::lanes], ordered[first::lanes]
        used = jnp.sum(mine[1][:, 0] > 0)

        def one(at, results):
            return results.at[at].set(block(mine[0][at], mine[1][at]))

        results = jnp.zeros((blocks // lanes, segments, VERSIONS, len(d)), jnp.float32)
        return jax.lax.fori_loop(0, used, one, results)

    # Loops that do not depend on each other run at the same time.
    results = jnp.stack([lane(first) for first in range(lanes)], axis=1).reshape(-1, VERSIONS * len(d))
    places = jnp.zeros(blocks * segments + 1, jnp.int32).at[order.reshape(-1)].set(jnp.arange(order.size))
    image = results[places[: len(largest)]].reshape(height, per_row * VERSIONS, len(d))[:, :width]
    return jnp.where((counts > 0)[..., None] & scatters, image, irradiance)


def _source(irradiance, depth, normal, mask, camera, settings):
    """What a sample finds in a pixel, with a dark rim around the frame: (pixels, C + 1 or C + 3).

    The irradiance, times the area seen where the estimator needs it; then whether the pixel counts, or the
    depth of its tangent plane and how it changes by column and row.
    """
    if settings.distance == "plane":
        outside, last = 0.0, [mask.astype(jnp.float32)]
    else:
        outside, last = _FAR, [depth]
        if normal is not None:
            last += surface.depth_slopes(depth, normal, camera)
        if settings.estimator == "unbiased" and normal is not None:
            irradiance = irradiance * surface.pixel_area(depth, normal, camera)[..., None]
    layers = [(irradiance[..., k], 0.0) for k in range(irradiance.shape[-1])]
    layers += [(last[0], outside)] + [(slope, 0.0) for slope in last[1:]]
    padded = [jnp.pad(jnp.where(mask, v, fill), 1, constant_values=fill) for v, fill in layers]
    return jnp.stack(padded, axis=-1).reshape(-1, len(padded))


def _lanes() -> int:
    """How many blocks run at once: one for each core of a CPU, a single one elsewhere."""
    return min(os.cpu_count() or 1, 8) if jax.default_backend() == "cpu" else 1
