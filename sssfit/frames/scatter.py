"""Monte Carlo scattering of whole frames, at a cost that follows the samples.

A frame is cut into segments of sixteen pixels of a row. Those of a region are sorted by the largest count in
each, and all go through one program, block by block, which draws as many samples as the block's largest
count: the time is that of the samples, whatever the mean count. Each profile has a pass of its own over its
own pixels, so that no sample asks which profile it hit, and profiles cannot bleed into each other.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames import _pass
from sssfit.frames.camera import Camera
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import VERSIONS, Settings

DEFAULT = Settings()


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
        most: the largest count, on the host; by default that of `counts`, which then must be known. A
            program serves all from one power of two to the next.
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
    return _run(_pass.mean, irradiance, depth, camera, d, counts, mask, normal, settings, most, seed, frame)


def every_profile(
    frame: Frame,
    profiles: Mapping[int, Any],
    *,
    counts: ArrayLike,
    settings: Settings = DEFAULT,
    most: int | None = None,
    seed: int = 0,
    number: int = 0,
) -> Array:
    """Scatter a whole frame, a pass for each profile.

    Args:
        frame: see `gbuffer.Frame`.
        profiles: shape parameter of each channel, mm, (C,), by profile id; None where nothing scatters.
        counts, settings, most, seed: as for `scatter`.
        number: of the frame in a sequence; other ones give independent samples.

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
    start = jnp.asarray(frame.irradiance, jnp.float32)
    return _each_profile(_pass.mean, frame, profiles, counts, settings, most, seed, number, start)


def image_and_variance(
    frame: Frame,
    profiles: Mapping[int, Any],
    *,
    counts: ArrayLike,
    settings: Settings = DEFAULT,
    most: int | None = None,
    seed: int = 0,
    number: int = 0,
) -> tuple[Array, Array]:
    """The image of `every_profile`, and how much one sample varies at each pixel.

    Args:
        frame, profiles, counts, settings, most, seed, number: as for `every_profile`.

    Returns:
        The image, the same to rounding. And (H, W) float32: the variance of one sample's Rec. 709 luminance
        of the result / pi, in the irradiance's unit squared, with n - 1 in the denominator; a mean of n
        independent samples has 1 / n of it. For the ratio that of its linear approximation. 0 where nothing
        scatters or fewer than two samples are drawn.

    Raises:
        ValueError: as `every_profile`.

    Source: Xie et al. 2020, Section 3; the delta method for the ratio.

    Example:
        >>> from sssfit.frames import procedural
        >>> scene = procedural.frame(width=64, height=36)
        >>> image, variance = image_and_variance(scene, {1: [1.0, 0.5, 0.3], 2: None}, counts=8)
        >>> variance.shape
        (36, 64)
    """
    start = jnp.asarray(frame.irradiance, jnp.float32), jnp.zeros(frame.depth.shape, jnp.float32)
    return _each_profile(_pass.moments, frame, profiles, counts, settings, most, seed, number, start)


def variance_of_samples(
    frame: Frame,
    profiles: Mapping[int, Any],
    *,
    counts: ArrayLike,
    settings: Settings = DEFAULT,
    seed: int = 0,
) -> Array:
    """The variance of `image_and_variance` alone, for a pilot.

    Args:
        frame, profiles, counts, settings, seed: as there; counts >= 2 where an estimate is wanted.

    Returns:
        (H, W) float32.

    Raises:
        ValueError: as `every_profile`.

    Source: as `image_and_variance`.

    Example:
        >>> from sssfit.frames import procedural
        >>> scene = procedural.frame(width=64, height=36)
        >>> variance_of_samples(scene, {1: [1.0, 0.5, 0.3], 2: None}, counts=8).shape
        (36, 64)
    """
    return image_and_variance(frame, profiles, counts=counts, settings=settings, seed=seed)[1]


def whole_segments(counts: ArrayLike, mask: ArrayLike | None = None) -> Array:
    """Counts raised to the largest among the sixteen pixels that are sampled together.

    Pixels of a segment wait for the one with the most samples. With these counts they draw theirs meanwhile:
    a smaller error for almost no time, at the price of counts that are no longer each pixel's own.

    Args:
        counts: samples of each pixel, integers, (H, W).
        mask: (H, W), the pixels with a profile; the others count as 0. By default all.

    Returns:
        (H, W) int32; where there were no samples there are none.

    Source: the segments of this module.

    Example:
        >>> whole_segments(jnp.zeros((1, 32), int).at[0, :3].set(jnp.array([8, 0, 64])))[0, :17].tolist()[:4]
        [64, 0, 64, 0]
    """
    counts = jnp.asarray(counts, jnp.int32)
    own = counts if mask is None else jnp.where(jnp.asarray(mask, bool), counts, 0)
    height, width = own.shape
    segments = jnp.pad(own, ((0, 0), (0, -width % VERSIONS))).reshape(height, -1, VERSIONS)
    largest = jnp.repeat(jnp.max(segments, axis=-1), VERSIONS, axis=-1)[:, :width]
    return jnp.where(own > 0, largest, 0)


def _each_profile(of_pass, frame, profiles, counts, settings, most, seed, number, start):
    """The result of each profile's pass at its own pixels; `start` is what a pass has at all others."""
    ids = jnp.asarray(frame.profile_id)
    masks, known_and_there = _where(ids, tuple(jnp.int32(profile_id) for profile_id in profiles))
    known, *there = np.asarray(known_and_there)
    if not known:
        unknown = np.setdiff1d(ids, [0, *profiles])
        raise ValueError(
            f"profiles must name every id of the frame: {unknown[0]} is missing, "
            f"there are {', '.join(map(str, sorted(profiles)))}"
        )
    if most is None:
        most = int(np.max(np.asarray(counts), initial=0))
    result = None
    for (profile_id, d), mask, is_there in zip(profiles.items(), masks, there, strict=True):
        if profile_id != 0 and d is not None and is_there:
            found = _run(
                of_pass, frame.irradiance, frame.depth, frame.camera, d, counts, mask, frame.normal,
                settings, most, seed, number,
            )  # fmt: skip
            result = found if result is None else jax.tree.map(functools.partial(_at, mask), found, result)
    return start if result is None else result


def _at(mask, found, other):
    """One image at the pixels of a mask, and the other elsewhere."""
    return jnp.where(mask.reshape(mask.shape + (1,) * (found.ndim - 2)), found, other)


@jax.jit
def _where(ids, every_id):
    """The pixels of each profile; whether those are all pixels, and whether each has any."""
    masks = [ids == one for one in every_id]
    known = functools.reduce(jnp.logical_or, masks, ids == 0)
    return masks, jnp.stack([jnp.all(known), *map(jnp.any, masks)])


def _run(of_pass, irradiance, depth, camera, d, counts, mask, normal, settings, most, seed, frame):
    """A pass, after its arguments were looked at."""
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
    seen = _pass.Seen(irradiance, depth, normal, mask, camera)
    random = _pass.Random(jnp.uint32(seed), jnp.uint32(frame), jnp.int32(max(most, 1)))
    # Few programs for many counts: nothing is compiled anew when the largest of a frame changes a little.
    rows = 1 << (max(most, 1) - 1).bit_length()
    return of_pass(seen, counts, d, random, settings, rows)
