"""Cameras: where a pixel lies in space, and the way back; read from JSON or made from the usual numbers.

Camera space has x to the right, y up and z towards the camera, in mm. Pixel coordinates run from the upper
left corner, rows downwards; the pixel in column i and row j has its centre at (i + 0.5, j + 0.5).
"""

import math
import os
from pathlib import Path
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from sssfit.files.errors import FileError
from sssfit.files.json_text import read_json

Projection = Literal["perspective", "orthographic"]


class Camera(eqx.Module):
    """A perspective or an orthographic camera without distortion.

    Attributes:
        projection: "perspective" or "orthographic".
        width: of the image, pixels.
        height: of the image, pixels.
        fx: perspective: focal length in pixels, so that x / depth of one is fx pixels wide; orthographic:
            pixels per mm.
        fy: the same along columns of the image.
        cx: pixel coordinate of the viewing axis, from the left edge.
        cy: the same from the upper edge.

    Example:
        >>> camera = perspective(640, 360, fx=1000.0)
        >>> camera.position(420.0, 80.0, 500.0)
        Array([  50.,   50., -500.], dtype=float32)
    """

    projection: Projection = eqx.field(static=True)
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    fx: float
    fy: float
    cx: float
    cy: float

    def __check_init__(self):  # noqa: D105
        if self.projection not in ("perspective", "orthographic"):
            raise ValueError(f"projection must be 'perspective' or 'orthographic', got {self.projection!r}")

    def pixels_per_mm(self, depth: ArrayLike) -> tuple[Array, Array]:
        """Pixels per mm across the viewing axis at a depth in mm, along rows and along columns."""
        depth = _floating(depth)
        if self.projection == "perspective":
            return self.fx / depth, self.fy / depth
        return jnp.full_like(depth, self.fx), jnp.full_like(depth, self.fy)

    def mm_per_pixel(self, depth: ArrayLike) -> tuple[Array, Array]:
        """Width and height in mm that a pixel has at a depth in mm, across the viewing axis."""
        depth = _floating(depth)
        away = depth if self.projection == "perspective" else jnp.ones_like(depth)
        return away * (1 / self.fx), away * (1 / self.fy)

    def coordinates(self, column: ArrayLike, row: ArrayLike, depth: ArrayLike) -> tuple[Array, Array, Array]:
        """The x, y and z of `position`, apart: for arithmetic that should not make a copy of them."""
        column, row, depth = map(_floating, (column, row, depth))
        away = depth if self.projection == "perspective" else 1.0
        return (column - self.cx) * (away / self.fx), (self.cy - row) * (away / self.fy), -depth

    def position(self, column: ArrayLike, row: ArrayLike, depth: ArrayLike) -> Array:
        """Point in camera space, mm, (..., 3), seen at pixel coordinates and at a depth in mm."""
        return jnp.stack(jnp.broadcast_arrays(*self.coordinates(column, row, depth)), axis=-1)

    def project(self, position: ArrayLike) -> tuple[Array, Array, Array]:
        """Pixel coordinates and depth of points in camera space, mm, (..., 3): the way back.

        A perspective camera says nothing sensible about points that are not in front of it.
        """
        x, y, z = jnp.moveaxis(_floating(position), -1, 0)
        per_x, per_y = self.pixels_per_mm(-z)
        return self.cx + x * per_x, self.cy - y * per_y, -z

    def pixel_centres(self, dtype: DTypeLike = float) -> tuple[Array, Array]:
        """Pixel coordinates of all centres, (width,) and (height, 1): they broadcast with an image."""
        return jnp.arange(self.width, dtype=dtype) + 0.5, jnp.arange(self.height, dtype=dtype)[:, None] + 0.5


def perspective(
    width: int,
    height: int,
    *,
    fx: float | None = None,
    fy: float | None = None,
    fov_x_degrees: float | None = None,
    cx: float | None = None,
    cy: float | None = None,
) -> Camera:
    """A perspective camera from its focal length in pixels or from its field of view.

    Args:
        width: of the image, pixels.
        height: of the image, pixels.
        fx: focal length, pixels.
        fy: the same along columns of the image; fx by default, which means square pixels.
        fov_x_degrees: angle between the left and the right edge of an image whose axis is in the middle; to
            be given where fx is not.
        cx: pixel coordinate of the viewing axis; the middle of the image by default.
        cy: the same from the upper edge.

    Raises:
        ValueError: no focal length, or two; a number out of its range.

    Example:
        >>> round(perspective(640, 360, fov_x_degrees=90.0).fx, 6)
        320.0
    """
    _check_size(width, height)
    if (fx is None) == (fov_x_degrees is None):
        given = "neither was given" if fx is None else "both were given"
        raise ValueError(f"a perspective camera needs its focal length: either fx or fov_x_degrees, {given}")
    if fov_x_degrees is not None:
        if not 0 < fov_x_degrees < 180:
            raise ValueError(f"fov_x_degrees must be between 0 and 180, got {fov_x_degrees:g}")
        fx = width / 2 / math.tan(math.radians(fov_x_degrees) / 2)
    assert fx is not None
    fy = fx if fy is None else fy
    return _camera("perspective", width, height, fx=fx, fy=fy, cx=cx, cy=cy)


def orthographic(width: int, height: int, mm_per_pixel: float) -> Camera:
    """An orthographic camera with square pixels and its axis in the middle of the image.

    Args:
        width: of the image, pixels.
        height: of the image, pixels.
        mm_per_pixel: size of a pixel, mm.

    Raises:
        ValueError: a number out of its range.

    Example:
        >>> orthographic(640, 360, 0.125).fx
        8.0
    """
    _check_size(width, height)
    if not 0 < mm_per_pixel < math.inf:
        raise ValueError(f"mm_per_pixel must be a number above 0, got {mm_per_pixel:g}")
    return _camera("orthographic", width, height, fx=1 / mm_per_pixel, fy=1 / mm_per_pixel)


def load(
    path: str | os.PathLike[str],
    frame_name: str | os.PathLike[str] | None = None,
    *,
    size: tuple[int, int] | None = None,
) -> Camera:
    """Read a frame's camera from a JSON file.

    The file has either the camera's numbers at its top level, or those of several frames as
    `gbuffer["<file name>"]["camera"]`, or as `frames[...]` with `file` and `camera`. The numbers of one
    camera are projection ("perspective" where it is missing), width and height; fx, fy or fov_x_deg, or,
    where it is orthographic, mm_per_pixel or ortho_width_mm; and cx, cy.

    Args:
        path: the JSON file.
        frame_name: the frame's file; only its name counts, not its folder.
        size: width and height of the frame, if known.

    Returns:
        The camera of that name; where there is none, the only camera (of that size).

    Raises:
        FileError: no such file, no camera for this frame or more than one, no focal length, or a number that
            is missing or out of its range.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "camera.json"
        ...     _ = path.write_text('{"width": 640, "height": 360, "fov_x_deg": 90}')
        ...     load(path).cx
        320.0
    """
    entries = _entries(read_json(path), path)
    name = None if frame_name is None else Path(frame_name).name
    if name in entries:
        return _from_json(entries[name], path, name or "")
    cameras = {entry: _from_json(numbers, path, entry) for entry, numbers in entries.items()}
    fitting = [c for c in cameras.values() if size is None or (c.width, c.height) == tuple(size)]
    # Frames of a sequence mostly share one lens.
    found = {tuple(vars(camera).values()): camera for camera in fitting}
    if len(found) == 1:
        return fitting[0]
    which = "" if name is None else f" for {name}"
    held = _shortened([f"{entry} ({c.width} x {c.height})".lstrip() for entry, c in cameras.items()])
    if found:
        raise FileError(path, "", f"does not say which camera is meant{which}", f"name one of {held}")
    wanted = "" if size is None else f" of {size[0]} x {size[1]} pixels"
    raise FileError(path, "", f"has no camera{which}{wanted}", f"it has {held}; give the frame's own camera")


def _entries(content: Any, path: object) -> dict[str, dict]:
    """The cameras' numbers by the name of their frame, "" for numbers at the top level."""
    found = {}
    if isinstance(content, dict):
        if isinstance(content.get("gbuffer"), dict):
            found.update(content["gbuffer"])
        if isinstance(content.get("frames"), list):
            named = [f for f in content["frames"] if isinstance(f, dict) and isinstance(f.get("file"), str)]
            found.update({frame["file"]: frame for frame in named})
        found = {n: f["camera"] for n, f in found.items() if isinstance(f, dict) and "camera" in f}
        if not found and any(key in content for key in ("projection", "width", "fx", "fov_x_deg")):
            found = {"": content}
    found = {name: numbers for name, numbers in found.items() if isinstance(numbers, dict)}
    if not found:
        remedy = "write projection, width, height and fx or fov_x_deg, or gbuffer with a camera per file"
        raise FileError(path, "", "holds no camera", remedy)
    return found


def _from_json(numbers: dict, path: object, where: str) -> Camera:
    def number(name: str) -> Any:
        value = numbers.get(name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise FileError(path, where, f"{name} is {value!r} where a number belongs", "write a number")
        return value

    width, height = number("width"), number("height")
    if width is None or height is None:
        raise FileError(path, where, "the camera has no width or no height", "write both, in pixels")
    projection = numbers.get("projection", "perspective")
    try:
        if projection == "orthographic":
            pitch, across = number("mm_per_pixel"), number("ortho_width_mm")
            if pitch is None and across is None:
                remedy = "write mm_per_pixel or ortho_width_mm"
                raise FileError(path, where, "the orthographic camera has no scale", remedy)
            _check_size(width, height)
            if pitch is None:
                pitch = across / width
            made = orthographic(width, height, pitch)
            cx, cy = number("cx"), number("cy")
            return _camera("orthographic", width, height, fx=made.fx, fy=made.fy, cx=cx, cy=cy)
        if projection != "perspective":
            problem = f"the projection is {projection!r}"
            raise FileError(path, where, problem, "only perspective and orthographic are known")
        fx, fov = number("fx"), number("fov_x_deg")
        if fx is None and fov is None:
            remedy = "write fx and fy in pixels, or fov_x_deg"
            raise FileError(path, where, "the perspective camera has no focal length", remedy)
        lens = {"fov_x_degrees": fov} if fx is None else {"fx": fx}
        return perspective(width, height, **lens, fy=number("fy"), cx=number("cx"), cy=number("cy"))
    except ValueError as error:
        raise FileError(path, where, f"the camera is not usable ({error})", "mend its numbers") from error


def _camera(
    projection: Projection, width: int, height: int, *, fx: float, fy: float, cx=None, cy=None
) -> Camera:
    """A camera with its numbers checked, and its axis in the middle unless told otherwise."""
    for name, value in (("fx", fx), ("fy", fy)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be a number above 0, got {value:g}")
    cx, cy = (middle / 2 if c is None else c for c, middle in ((cx, width), (cy, height)))
    for name, value in (("cx", cx), ("cy", cy)):
        if not math.isfinite(value):
            raise ValueError(f"{name} must be finite, got {value:g}")
    return Camera(projection, int(width), int(height), float(fx), float(fy), float(cx), float(cy))


def _check_size(width: float, height: float) -> None:
    for name, value in (("width", width), ("height", height)):
        if not (value >= 1 and value == int(value)):
            raise ValueError(f"{name} must be a whole number of at least 1, got {value:g}")


def _floating(values: ArrayLike) -> Array:
    return jnp.asarray(values, jnp.result_type(float, values))


def _shortened(names: list[str], most: int = 8) -> str:
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")
