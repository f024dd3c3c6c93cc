"""Looking up the previous frame: where a pixel's point was, what was kept there, and whether it was seen.

Motion is that of `gbuffer.Frame.motion`: where a point was minus where it is, (x, y) in pixels, y down, so
that the point at the centre (i + 0.5, j + 0.5) of pixel (i, j) was at that centre plus the motion. It is 0
where nothing moves, whatever jitter the cameras of both frames have. All frames have one size.

No motion leads off the arrays. A place beyond the frame finds the pixel of the edge next to it, at any
distance and at infinity; a component that is NaN counts as 0. `off_screen` and `disoccluded` tell where that
happened. A motion is split into whole pixels and a fraction before anything is added to it, so that a motion
of whole pixels finds pixels exactly, and how large the frame is makes no difference.

Source: Nehab et al., "Accelerating real-time shading with reverse reprojection caching", 2007; Yang, Liu and
Salvi, "A survey of temporal antialiasing techniques", 2020, section 3.
"""

from functools import reduce
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames import _footprint


def nearest(history: Any, motion: ArrayLike | None) -> Any:
    """What the previous frame kept at the pixel that each pixel's point was in.

    Args:
        history: of the previous frame: any pytree of arrays of shape (H, W, ...), such as a controller's
            `History`, of any dtypes.
        motion: (H, W, 2), pixels; None where nothing moved.

    Returns:
        A pytree of the same structure, shapes and dtypes: values of the history, none of them mixed or
        rounded. The history itself without motion.

    Raises:
        ValueError: the motion has another shape, or an array of the history other pixels.

    Source: Xie, dissertation, 2021, section 4.5.1: the sampler of the local history.

    Example:
        >>> history = jnp.arange(4.0).reshape(1, 4)
        >>> nearest(history, jnp.full((1, 4, 2), jnp.array([1.4, 0.0]))).tolist()
        [[1.0, 2.0, 3.0, 3.0]]
    """
    return history if motion is None else _footprint.look_up(history, _footprint.nearest_place(motion))


def bilinear(image: ArrayLike, motion: ArrayLike | None, *, mask: ArrayLike | None = None) -> Array:
    """The previous image at each pixel's point, linear between the four nearest pixels.

    Between pixels it blurs, as a filter with a variance of up to 1/4 pixel^2 along each axis, and what is
    carried from frame to frame is blurred again in each: `catmull_rom` keeps more.

    Args:
        image: of the previous frame, (H, W, C).
        motion: (H, W, 2), pixels; None where nothing moved.
        mask: which pixels of the previous frame count, boolean, (H, W): their weights are divided by their
            sum, and what the others hold does not matter, NaN included. Where none of those with a weight
            counts, the result is the nearest pixel, whatever it holds. All count by default.

    Returns:
        Shape (H, W, C), in the image's dtype; computed in float32 at least. Between the smallest and the
        largest of the four to 4 eps. The derivative by the motion is that to the right and downwards.

    Raises:
        ValueError: shapes that do not fit.

    Source: see the module.

    Example:
        >>> image, motion = jnp.arange(3.0).reshape(1, 3, 1), jnp.full((1, 3, 2), jnp.array([0.25, 0.0]))
        >>> bilinear(image, motion)[..., 0].tolist()
        [[0.25, 1.25, 2.0]]
        >>> bilinear(image, motion, mask=jnp.array([[True, False, True]]))[..., 0].tolist()
        [[0.0, 2.0, 2.0]]
    """
    image, mask = _checked(image, mask)
    if motion is None:
        return image
    return _bilinear(image, _footprint.place(motion, image.shape[:2]), mask).astype(image.dtype)


def catmull_rom(
    image: ArrayLike, motion: ArrayLike | None, *, mask: ArrayLike | None = None, clamp: bool = True
) -> Array:
    """The previous image at each pixel's point, by a cubic through sixteen pixels that keeps detail.

    The weights along an axis are those of the Catmull-Rom spline. The two outer ones are negative (-1/16 half
    way between pixels), and so is up to 0.28 of all weights, so that a bright pixel rings: around it the
    filter may return negative light, and more than there is beside a dark one. `clamp` prevents both, at the
    price of a filter that is not linear.

    Args:
        image: of the previous frame, (H, W, C).
        motion: (H, W, 2), pixels; None where nothing moved.
        mask: as for `bilinear`. Where a pixel with a weight does not count, the lookup is bilinear: a share
            of weights of both signs may sum to nothing.
        clamp: keep each channel between the smallest and the largest of the pixels with a weight. The
            filter is linear without it.

    Returns:
        Shape (H, W, C), in the image's dtype; computed in float32 at least. Up to quadratic images are
        reproduced where all sixteen are inside the frame.

    Raises:
        ValueError: shapes that do not fit.

    Source: Catmull and Rom, "A class of local interpolating splines", 1974; Keys, "Cubic convolution
    interpolation for digital image processing", 1981 (a = -1/2); for histories: Yang, Liu and Salvi 2020.

    Example:
        >>> image, motion = jnp.eye(1, 5)[..., None], jnp.full((1, 5, 2), jnp.array([0.5, 0.0]))
        >>> catmull_rom(image, motion, clamp=False)[..., 0].tolist()
        [[0.5, -0.0625, 0.0, 0.0, 0.0]]
        >>> catmull_rom(image, motion)[..., 0].tolist()
        [[0.5, 0.0, 0.0, 0.0, 0.0]]
    """
    image, mask = _checked(image, mask)
    if motion is None:
        return image
    place = _footprint.place(motion, image.shape[:2])
    kept = image if mask is None else jnp.where(mask[..., None], image, 0)
    sixteen = _footprint.footprint(kept, place, -1, _footprint.spline)
    found = _footprint.total(sixteen)
    if clamp:
        found = jnp.clip(found, *_footprint.bounds(sixteen))
    if mask is not None:
        counted = _footprint.footprint(mask[..., None], place, -1, _footprint.spline)
        whole = _footprint.bounds(counted)[0] > 0
        found = jnp.where(whole, found, _bilinear(image, place, mask))
    return found.astype(image.dtype)


def off_screen(motion: ArrayLike) -> Array:
    """Where a pixel's point was not inside the previous frame, or nobody knows where.

    Args:
        motion: (H, W, 2), pixels. A pixel is off screen where it is NaN or infinite.

    Returns:
        Boolean, (H, W). The frame's left and upper edges belong to it, the others do not.

    Raises:
        ValueError: the motion has another shape.

    Source: Nehab et al. 2007.

    Example:
        >>> off_screen(jnp.array([[[-0.5, 0.0], [-2.0, 0.0], [0.0, jnp.nan]]])).tolist()
        [[False, True, True]]
    """
    row, column = _footprint.place(motion).nearest()
    height, width = row.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return ~inside | jnp.isnan(jnp.asarray(motion)).any(axis=-1)


def disoccluded(
    depth: ArrayLike,
    profile_id: ArrayLike,
    previous_depth: ArrayLike,
    previous_profile_id: ArrayLike,
    motion: ArrayLike | None,
    *,
    depth_tolerance: ArrayLike = 0.02,
) -> Array:
    """Where the previous frame did not see a pixel's point, so that it has no history.

    A motion of two components says where the point was on the screen and not how far it was. All that can
    be asked is whether what was seen there is about as far as the point is now: the tolerance is what a
    point may come nearer in a frame and what its surface may rise within half a pixel, and it is relative
    since a pixel's width grows with depth. So a camera that moves along its axis by more than the tolerance
    times the depth loses every history there (at the default 8 mm of 400 mm), a surface seen at a sharp
    angle may lose its own, and what comes into view within the tolerance behind another part of the same
    profile is taken for that part.

    Args:
        depth: along the viewing axis, mm, > 0, (H, W). NaN is disoccluded.
        profile_id: which profile is seen, 0 for the background, (H, W). The background is tested as
            everything else is.
        previous_depth, previous_profile_id: the same of the previous frame.
        motion: (H, W, 2), pixels; NaN and infinities are disoccluded. None where nothing moved.
        depth_tolerance: largest difference over the pixel's depth, >= 0; inf looks at the ids alone.

    Returns:
        Boolean, (H, W): True where the point was off screen, or where the nearest pixel of the previous
        frame has another id or a depth off by more than the tolerance. Depths that are equal, infinite ones
        included, are never off.

    Raises:
        ValueError: shapes that differ, or a tolerance known to be below 0.

    Source: Nehab et al. 2007 for the comparison of depths, with the depth that a point has now.

    Example:
        >>> depth, ids = jnp.array([[400.0, 400.0, 500.0]]), jnp.array([[1, 1, 1]])
        >>> disoccluded(depth, ids, depth, ids, jnp.full((1, 3, 2), jnp.array([-1.0, 0.0]))).tolist()
        [[True, False, True]]
    """
    check_tolerance(depth_tolerance)
    now, then = (depth, profile_id), (previous_depth, previous_profile_id)
    shape = jnp.shape(depth)
    names = ("depth", "profile_id", "previous_depth", "previous_profile_id")
    for name, given in zip(names, (*now, *then), strict=True):
        if len(shape) != 2 or jnp.shape(given) != shape:
            raise ValueError(f"{name} must have shape (H, W), all four the same, got {jnp.shape(given)}")
    seen_depth, seen_id = nearest(then, motion)
    # Tolerances of a per cent are lost in half precision.
    wide = jnp.promote_types(jnp.result_type(float, depth, previous_depth), jnp.float32)
    here, seen_depth = jnp.asarray(depth, wide), jnp.asarray(seen_depth, wide)
    limit = jnp.asarray(depth_tolerance, wide) * jnp.abs(here)
    near = (seen_depth == here) | (jnp.abs(seen_depth - here) <= limit)
    lost = ~near | (jnp.asarray(seen_id) != jnp.asarray(profile_id))
    return lost if motion is None else lost | off_screen(motion)


def check_tolerance(tolerance: ArrayLike) -> None:
    """Refuse a `depth_tolerance` that is known to be out of its domain; a traced one passes.

    Args:
        tolerance: as for `disoccluded`.

    Raises:
        ValueError: it is below 0 or NaN.

    Example:
        >>> check_tolerance(0.02)
    """
    known = isinstance(tolerance, int | float | np.ndarray | np.generic)
    # Written so that NaN is refused too.
    if known and not np.all(np.asarray(tolerance) >= 0):
        raise ValueError(f"depth_tolerance must be at least 0, got {tolerance}")


def _checked(image: ArrayLike, mask: ArrayLike | None) -> tuple[Array, Array | None]:
    image = jnp.asarray(image, jnp.result_type(float, image))
    if image.ndim != 3 or 0 in image.shape[:2]:
        raise ValueError(f"image must have shape (H, W, C) and at least one pixel, got {image.shape}")
    if mask is not None:
        mask = jnp.asarray(mask, bool)
        if mask.shape != image.shape[:2]:
            raise ValueError(f"mask must have the image's shape {image.shape[:2]}, got {mask.shape}")
    return image, mask


def _bilinear(image: Array, place: _footprint.Place, mask: Array | None) -> Array:
    """As `bilinear`, in the dtype that it is computed in."""
    four = _footprint.footprint(image, place, 0, _footprint.linear)
    if mask is None:
        return _footprint.total(four)
    counted = _footprint.footprint(mask[..., None], place, 0, _footprint.linear)
    weights = [jnp.where(c > 0, w, 0) for c, w in zip(counted.values, four.weights, strict=True)]
    covered = reduce(jnp.add, weights)
    # Below the smallest normal number, a weight has no digits left to divide.
    some = covered > float(jnp.finfo(covered.dtype).tiny)
    # Divided before they are summed: small weights times small values would be lost.
    shares = [w / jnp.where(some, covered, 1) for w in weights]
    found = _footprint.total(_footprint.Footprint(four.values, shares))
    return jnp.where(some, found, _footprint.pixels(image, *place.nearest()))
