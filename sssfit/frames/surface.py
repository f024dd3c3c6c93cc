"""The surface that a frame's pixels see: how much of it, and which way it faces."""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames.camera import Camera

#: Pixels that see a surface at a sharper angle count as if they saw it at this cosine: shading normals at
#: silhouettes can face away, and areas would grow without bound.
MIN_COSINE = 0.05


def facing(normal: ArrayLike, column: ArrayLike, row: ArrayLike, camera: Camera) -> Array:
    """Cosine between a normal and the direction to the camera, times that direction's length for depth 1.

    Args:
        normal: in camera space, of length 1, shape (..., 3).
        column, row: where it is seen, pixels; a pixel's centre is at a half.
        camera: see `camera.Camera`.

    Returns:
        Shape (...). For an orthographic camera it is the normal's z.

    Source: the area of a pixel's footprint is depth^2 / (fx fy facing).

    Example:
        >>> from sssfit.frames.camera import orthographic
        >>> float(facing(jnp.array([0.0, 0.6, 0.8]), 3.5, 2.5, orthographic(8, 4, 0.1))).__round__(3)
        0.8
    """
    normal = jnp.asarray(normal)
    if camera.projection == "orthographic":
        return normal[..., 2]
    across = (column - camera.cx) / camera.fx
    up = (camera.cy - row) / camera.fy
    return normal[..., 2] - normal[..., 0] * across - normal[..., 1] * up


def pixel_area(depth: ArrayLike, normal: ArrayLike, camera: Camera) -> Array:
    """Area of the surface that each pixel of a frame sees.

    Args:
        depth: (H, W), mm along the viewing axis.
        normal: (H, W, 3) in camera space, of length 1.
        camera: see `camera.Camera`.

    Returns:
        (H, W), mm^2, from the tangent plane at the pixel's centre; at cosines below `MIN_COSINE` that of
        this cosine.

    Source: solid angle of a pixel over the cosine, own derivation.

    Example:
        >>> from sssfit.frames.camera import orthographic
        >>> flat = jnp.zeros((4, 8, 3)).at[..., 2].set(1)
        >>> area = pixel_area(jnp.full((4, 8), 500.0), flat, orthographic(8, 4, 0.1))
        >>> float(area[0, 0]).__round__(4)
        0.01
    """
    depth = jnp.asarray(depth)
    rows, columns = depth.shape
    at = facing(normal, jnp.arange(columns) + 0.5, jnp.arange(rows)[:, None] + 0.5, camera)
    wide, high = camera.mm_per_pixel(depth)
    return wide * high * (1 / jnp.maximum(at, MIN_COSINE))


def depth_slopes(depth: ArrayLike, normal: ArrayLike, camera: Camera) -> tuple[Array, Array]:
    """How the depth of each pixel's tangent plane changes from pixel to pixel.

    Args:
        depth: (H, W), mm along the viewing axis.
        normal: (H, W, 3) in camera space, of length 1.
        camera: see `camera.Camera`.

    Returns:
        mm per column and mm per row, each (H, W), at the pixel's centre; at cosines below `MIN_COSINE` as at
        this cosine.

    Source: the plane through the pixel's position, depth = n.P / n.q along the ray q; own derivation.

    Example:
        >>> from sssfit.frames.camera import orthographic
        >>> leaning = jnp.broadcast_to(jnp.array([0.6, 0.0, 0.8]), (4, 8, 3))
        >>> by_column, by_row = depth_slopes(jnp.full((4, 8), 500.0), leaning, orthographic(8, 4, 0.1))
        >>> round(float(by_column[0, 0]), 4), abs(float(by_row[0, 0]))
        (0.075, 0.0)
    """
    depth, normal = jnp.asarray(depth), jnp.asarray(normal)
    rows, columns = depth.shape
    at = facing(normal, jnp.arange(columns) + 0.5, jnp.arange(rows)[:, None] + 0.5, camera)
    # Divided once, as for the area.
    lean = 1 / jnp.maximum(at, MIN_COSINE)
    wide, high = camera.mm_per_pixel(depth)
    return normal[..., 0] * wide * lean, -normal[..., 1] * high * lean
