"""What infinitely many samples converge to: Burley's profile applied to every pixel of a frame.

`convolve` is exact where depth is constant. `visible` sums over all visible pixels of a curved surface, with
straight-line distances; both take the irradiance of a pixel as constant over its square, as lookups of the
nearest pixel do.
"""

import functools
import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import fftconvolve

from sssfit.frames import pixel_kernel, surface
from sssfit.frames.camera import Camera

#: Where the profile ends, in d, unless another radius is asked for: the one of Cycles' references.
CUTOFF = 16.0
#: Depth in mm of what is outside the mask; its square is a float32.
_FAR = np.float32(1e15)
#: Pixels times pixels away in one piece of a sum: some tenths of a second.
_PIECE = 1 << 27


def convolve(
    irradiance: ArrayLike,
    d: ArrayLike,
    pixel_size: tuple[float, float],
    *,
    mask: ArrayLike | None = None,
    cutoff: float | None = CUTOFF,
) -> np.ndarray:
    """Scatter a flat frame: each channel's irradiance convolved with its profile, by FFT.

    Args:
        irradiance: (H, W, C), of any unit, linear; finite.
        d: shape parameter of each channel, mm, (C,); 0 keeps the channel as it is.
        pixel_size: height and width of a pixel, mm.
        mask: (H, W), the pixels that take part; the others give nothing and are 0 in the result.
        cutoff: radius in d beyond which the profile is zero, the rest scaled to integrate to 1; None for the
            whole profile.

    Returns:
        (H, W, C) float64, in the irradiance's unit. Beyond the frame's edge it is dark. A channel is off by
        up to some 1e-13 of its sum over the frame.

    Raises:
        ValueError: shapes that do not fit, or a value outside its domain.

    Source: Christensen and Burley 2015; the kernel is `pixel_kernel.kernel`, zero-padded.

    Example:
        >>> spot = np.zeros((9, 9, 1))
        >>> spot[4, 4] = 1
        >>> convolve(spot, [0.5], (1.0, 1.0))[4, 3:6, 0].round(4)
        array([0.0583, 0.4032, 0.0583])
    """
    irradiance, d = np.asarray(irradiance, float), np.asarray(d, float)
    lit = np.ones(irradiance.shape[:2], bool) if mask is None else np.asarray(mask, bool)
    _check(irradiance, d, lit)
    given = np.where(lit[..., None], irradiance, 0)
    channels = []
    for values, shape in zip(np.moveaxis(given, -1, 0), d, strict=True):
        reach = [n if cutoff is None else min(n, math.ceil(cutoff * shape / size) + 1)
                 for n, size in zip(lit.shape, pixel_size, strict=True)]  # fmt: skip
        quarter = pixel_kernel.kernel((reach[0], reach[1]), pixel_size, shape, cutoff=cutoff)
        whole = np.concatenate([quarter[:0:-1], quarter])
        whole = np.concatenate([whole[:, :0:-1], whole], axis=1)
        channels.append(fftconvolve(values, whole, mode="same"))
    return np.where(lit[..., None], np.stack(channels, axis=-1), 0)


class Visible(NamedTuple):
    """A frame scattered over its visible pixels.

    Attributes:
        scattered: (H, W, C), float32; 0 where the mask is False.
        left_out: (C,), share of the profile's light beyond `radius_limit` on a plane.
    """

    scattered: np.ndarray
    left_out: np.ndarray


def visible(
    irradiance: ArrayLike,
    depth: ArrayLike,
    normal: ArrayLike,
    camera: Camera,
    d: ArrayLike,
    *,
    mask: ArrayLike,
    cutoff: float | None = CUTOFF,
    radius_limit: float | None = None,
    step: Callable[[float], AbstractContextManager[Any]] = nullcontext,
) -> Visible:
    """Scatter a curved frame: the sum over all visible pixels of profile, area and irradiance.

    Each pixel is a patch of its tangent plane with constant irradiance, and distances are straight lines in
    space. Hidden parts of a surface give nothing.

    Args:
        irradiance: (H, W, C), finite.
        depth: (H, W), mm along the viewing axis, > 0 within the mask.
        normal: (H, W, 3) in camera space, of any length.
        camera: see `camera.Camera`.
        d: shape parameter of each channel, mm, (C,), > 0.
        mask: (H, W), the pixels that take part.
        cutoff: as for `convolve`.
        radius_limit: distance in mm beyond which pixels are left out. By default `cutoff` times the largest
            d, or 16 times where there is no cut-off. The time grows with its square.
        step: around each piece of the work, called with the piece's share of it; the shares sum to 1.

    Returns:
        `Visible`, computed in float32. The pixel's own patch is integrated to 1e-13, its three nearest rings
        with 8 x 8 points each, seven more with 3 x 3: on a plane within 1e-3 of `convolve` for any d.

    Raises:
        ValueError: shapes that do not fit, or a value outside its domain.

    Source: Xie, dissertation, 2021, Eq 2.38.

    Example:
        >>> from sssfit.frames.camera import orthographic
        >>> depth, facing = np.full((33, 33), 500.0), np.broadcast_to([0.0, 0.0, 1.0], (33, 33, 3))
        >>> camera, lit = orthographic(33, 33, 0.5), np.ones((33, 33, 1))
        >>> found = visible(lit, depth, facing, camera, [0.3], mask=lit[..., 0])
        >>> round(float(found.scattered[16, 16, 0]), 2)
        1.0
    """
    irradiance, d, lit = np.asarray(irradiance, np.float32), np.asarray(d, float), np.asarray(mask, bool)
    _check(irradiance, d, lit)
    if not np.all(d > 0):
        raise ValueError(f"d must be above 0 for a sum over pixels, got {d.tolist()}")
    reach = (np.inf if cutoff is None else cutoff) * d
    limits = np.minimum(reach, (16 * d).max() if radius_limit is None else radius_limit)
    left_out = np.where(limits < reach, np.exp(-limits / d) / 4 + 3 * np.exp(-limits / d / 3) / 4, 0)
    found = np.zeros(irradiance.shape, np.float32)
    if lit.any():
        at = _bounds(lit)
        part = np.asarray(depth, np.float32)[at], np.asarray(normal, np.float32)[at]
        with step(0.0):
            moved = eqx.tree_at(lambda c: (c.cx, c.cy), camera, _moved(camera, at))
            patches = _patches(*part, lit[at], moved)
        for channel, (shape, limit) in enumerate(zip(d, limits, strict=True)):
            given = np.where(lit[at], irradiance[at][..., channel], 0)
            whole = _scattered(given, patches, shape, limit, cutoff, lambda share: step(share / len(d)))
            found[at][..., channel] = np.where(lit[at], whole, 0)
    return Visible(found, left_out)


class _Patches(NamedTuple):
    """The surface in each pixel as a parallelogram of its tangent plane; far away where there is none."""

    camera: Camera
    depth: np.ndarray
    slopes: tuple[np.ndarray, np.ndarray]
    area: np.ndarray
    # The most rows and columns that 1 mm in space can span.
    pixels_per_mm: tuple[float, float]


def _bounds(lit: np.ndarray) -> tuple[slice, slice]:
    """The rows and columns that the mask touches."""
    spans = (np.flatnonzero(lit.any(axis=axis)) for axis in (1, 0))
    rows, columns = (slice(int(span[0]), int(span[-1]) + 1) for span in spans)
    return rows, columns


def _moved(camera: Camera, at: tuple[slice, slice]) -> tuple[float, float]:
    return camera.cx - at[1].start, camera.cy - at[0].start


def _patches(depth: np.ndarray, normal: np.ndarray, lit: np.ndarray, camera: Camera) -> _Patches:
    depth = np.where(lit, depth, _FAR)
    across, down = (np.where(lit, slope, 0) for slope in surface.depth_slopes(depth, normal, camera))
    area = np.where(lit, surface.pixel_area(depth, normal, camera), 0)
    across_mm, up_mm = (
        float(np.broadcast_to(np.asarray(n), lit.shape)[lit].max()) for n in camera.pixels_per_mm(depth)
    )
    corners = camera.coordinates(*np.meshgrid([0, camera.width], [0, camera.height]), np.float32(1))
    off_axis = np.hypot(*corners[:2]).max() if camera.projection == "perspective" else 0
    # A step towards a perspective camera moves a point off the axis too.
    stretch = math.hypot(1, float(off_axis))
    return _Patches(camera, depth, (across, down), area, (up_mm * stretch, across_mm * stretch))


def _scattered(given: np.ndarray, patches: _Patches, d: float, limit: float, cutoff: float | None, step):
    """One channel: what other pixels give, and what leaves where it entered."""
    reach = [limit * per_mm for per_mm in patches.pixels_per_mm]
    rows, columns = (min(n - 1, math.ceil(pixels)) for n, pixels in zip(given.shape, reach, strict=True))
    nodes = _nodes(rows, columns, reach).astype(np.float32)
    others, pieces = np.zeros(given.shape, np.float32), math.ceil(max(given.size * len(nodes) / _PIECE, 1))
    ends = [len(nodes) * piece // pieces for piece in range(pieces + 1)]
    for first, last in zip(ends, ends[1:], strict=False):
        with step(1 / pieces):
            others = np.asarray(
                _sum_of_others(
                    others, given * patches.area, *patches[1:3], patches.camera, d, limit, nodes,
                    first, last, rows, columns,
                )
            )  # fmt: skip
    scale = 1 if cutoff is None else float(pixel_kernel.cdf(np.array(cutoff)))
    with step(0.0):
        return np.asarray(others, float) / scale + given * _own_share(patches, d, cutoff)


def _own_share(patches: _Patches, d: float, cutoff: float | None) -> np.ndarray:
    """Share of a pixel's light that leaves where it entered: that in its own patch."""
    height, width = patches.depth.shape
    column, row = np.arange(width) + 0.5, np.arange(height)[:, None] + 0.5

    def side(right, down, slope):
        ends = (
            patches.camera.position(column + sign * right, row + sign * down, patches.depth + sign * slope)
            for sign in (0.5, -0.5)
        )
        return np.subtract(*(np.asarray(end, float) for end in ends))

    sides = side(1, 0, patches.slopes[0]), side(0, 1, patches.slopes[1])
    # A row at a time: the quadrature multiplies the memory by its nodes.
    return np.stack(
        [pixel_kernel.mass_in_parallelogram(*pair, d, cutoff=cutoff) for pair in zip(*sides, strict=True)]
    )


def _nodes(rows: int, columns: int, reach: list[float]) -> np.ndarray:
    """Rows and columns away, place within the pixel and weight of what is summed, (n, 5)."""
    down, right = np.meshgrid(np.arange(-rows, rows + 1), np.arange(-columns, columns + 1), indexing="ij")
    away = np.maximum(abs(down), abs(right))
    found = []
    for low, high, points in ((1, 3, 8), (4, 10, 3), (11, max(rows, columns, 11), 1)):
        at, weight = np.polynomial.legendre.leggauss(points)
        # Half a pixel more in either direction: part of such a pixel may be within reach.
        within = np.hypot((abs(down) - 0.5) / reach[0], (abs(right) - 0.5) / reach[1]) <= 1
        ring = (away >= low) & (away <= high) & within
        v, u = (n.ravel() / 2 for n in np.meshgrid(at, at, indexing="ij"))
        w = np.outer(weight, weight).ravel() / 4
        count = int(ring.sum())
        shifts = [np.repeat(n[ring], points**2) for n in (down, right)]
        found.append(np.stack([*shifts, np.tile(v, count), np.tile(u, count), np.tile(w, count)], axis=-1))
    return np.concatenate(found)


@functools.partial(jax.jit, static_argnames=("rows", "columns"))
def _sum_of_others(total, given, depth, slopes, camera, d, limit, nodes, first, last, rows, columns):
    """What other pixels give to each, before the cut-off's scale, added to a total: some of the nodes."""
    around = ((rows, rows), (columns, columns))
    filled = ((given, 0.0), (depth, _FAR), (slopes[0], 0.0), (slopes[1], 0.0))
    padded = [jnp.pad(jnp.asarray(v, jnp.float32), around, constant_values=c) for v, c in filled]
    column, row = jnp.arange(depth.shape[1]) + 0.5, jnp.arange(depth.shape[0])[:, None] + 0.5
    here = camera.coordinates(column, row, depth)
    factor = 1 / (8 * jnp.pi * d)
    nodes = jnp.asarray(nodes)

    def add(number, total):
        node = nodes[number]
        down, right = node[0].astype(jnp.int32), node[1].astype(jnp.int32)
        start = (rows + down, columns + right)
        light, away, by_column, by_row = (jax.lax.dynamic_slice(v, start, depth.shape) for v in padded)
        away = away + by_column * node[3] + by_row * node[2]
        place = camera.coordinates(column + right + node[3], row + down + node[2], away)
        r = jnp.sqrt(sum(jnp.square(a - b) for a, b in zip(place, here, strict=True)))
        slow = jnp.exp(r * (-1 / (3 * d)))
        profile = slow * (1 + jnp.square(slow)) / r
        return total + jnp.where(r <= limit, profile * light, 0) * (node[4] * factor)

    return jax.lax.fori_loop(first, last, add, total)


def _check(irradiance: np.ndarray, d: np.ndarray, lit: np.ndarray) -> None:
    if irradiance.ndim != 3 or d.shape != irradiance.shape[-1:] or lit.shape != irradiance.shape[:2]:
        raise ValueError(
            "irradiance must have the shape (H, W, C), d (C,) and mask (H, W), "
            f"got {irradiance.shape}, {d.shape} and {lit.shape}"
        )
    if not np.all(np.isfinite(irradiance[lit])):
        raise ValueError("irradiance must be finite within the mask; leave such pixels out of the mask")
    if not np.all(d >= 0):
        raise ValueError(f"d must be at least 0, got {d.tolist()}")
