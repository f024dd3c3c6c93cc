"""Curves from an image of what a point, a beam, a line or an edge of light shows on a flat surface."""

import math
import os
from pathlib import Path
from typing import Literal

import numpy as np

from sssfit.files.errors import FileError
from sssfit.fitting.measurement import CHANNELS, Measurement, is_turned
from sssfit.fitting.responses import Response

Axis = Literal["x", "y"]

#: Rings that an image is averaged to at most, and pixels in each at least.
MOST_RINGS = 1024
FEWEST_PIXELS = 16

# Rings to either side whose scatter is averaged. That of one ring alone goes with its mean where the noise
# is skewed, as that of renderers is: dark rings would count too much, and lengths become too small.
_NEIGHBOURS = 4
# What a response is computed to, as a share of the brightest value.
_ACCURACY = 1e-8


def load_image(
    path: str | os.PathLike[str],
    *,
    pixel_mm: float,
    response: Response,
    layer: str | None = None,
    center: tuple[float, float] | None = None,
    axis: Axis = "x",
    flip: bool = False,
    irradiance: float = 1.0,
) -> Measurement:
    """Average an image to curves with standard errors.

    Around a point or a beam, pixels are averaged in rings of equal numbers of pixels; a ring's distance is
    the mean of theirs. Across a line or an edge, the pixels of a column (or row) are. The standard error is
    from their scatter, averaged over neighbouring rings or columns, and never below rounding. Where fewer
    than 16 pixels are averaged it is not known. Pixels that are NaN or infinite are left out.

    Args:
        path: an EXR file, linear, seen straight from above.
        pixel_mm: width of a pixel, mm, > 0.
        response: what the light is.
        layer: with the channels .R, .G, .B; by default R, G, B, or else the only layer that has them, or
            else the only channel.
        center: of the point or the beam, or the line or edge, column and row in pixels; the pixel in column
            i and row j has its own at (i + 0.5, j + 0.5). By default the middle of the image.
        axis: in which distance from a line or an edge grows, "x" (to the right) or "y" (down).
        flip: the other way.
        irradiance: what values are divided by, > 0.

    Returns:
        The curves, in float64; distances from a line or an edge are signed.

    Raises:
        FileError: the file has a fault, or not the layer; no pixel, or too few of them, can be used; no value
            is above 0; or the lit side of an edge does not lie below 0.
        ValueError: a number is out of its domain.

    Example:
        >>> import tempfile
        >>> from sssfit.files.exr import encode_exr
        >>> image = np.exp(-np.abs(np.arange(64) - 31.5)).astype(np.float32) * np.ones((32, 1), np.float32)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "line.exr"
        ...     _ = path.write_bytes(encode_exr({"Y": image}, {}))
        ...     found = load_image(path, pixel_mm=0.1, response="line")
        >>> found.r[32:34].round(3), found.values[32:34, 0].round(3)
        (array([0.05, 0.15]), array([0.607, 0.223]))
    """
    for name, number in (("pixel_mm", pixel_mm), ("irradiance", irradiance)):
        if not 0 < number < np.inf:
            raise ValueError(f"{name} must be above 0, got {number:g}")
    if axis not in ("x", "y"):
        raise ValueError(f"axis must be x or y, got {axis!r}")
    if center is not None and not np.all(np.isfinite(center)):
        raise ValueError(f"center must be two finite numbers of pixels, got {center}")
    channels, pixels = _layer(Path(path), layer)
    rounding = float(np.finfo(pixels.dtype).eps) / math.sqrt(12)
    # Divided in float64: halves end at 65504.
    pixels = pixels.astype(np.float64) / irradiance
    height, width = pixels.shape[:2]
    column, row = center or (width / 2, height / 2)
    x, y = (np.arange(width) + 0.5 - column) * pixel_mm, (np.arange(height) + 0.5 - row) * pixel_mm
    good = np.isfinite(pixels).all(axis=-1)
    if not good.any():
        raise FileError(path, "", "no pixel holds finite numbers", "render it again")
    if not np.all(np.any(pixels[good] > 0, axis=0)):
        raise FileError(path, "", "a channel is nowhere above 0", "give an image of the light, or its layer")
    notes = () if good.all() else (f"{np.sum(~good)} pixels that are NaN or infinite are left out",)
    if response in ("radial", "beam"):
        distance = np.hypot(x, y[:, None])[good]
        parts, fewest = min(MOST_RINGS, max(len(distance) // FEWEST_PIXELS, 1)), FEWEST_PIXELS
    else:
        along = (x if axis == "x" else y[:, None]) * (-1 if flip else 1)
        distance = np.broadcast_to(along, good.shape)[good]
        parts, fewest = good.shape[1 if axis == "x" else 0], 1
    found = _averaged(distance, pixels[good], parts, fewest, rounding)
    if len(found[0]) < 2:
        raise FileError(path, "", "too few pixels are left to see a profile in", "give a larger image")
    measurement = Measurement(*found, channels, notes)
    if is_turned(measurement, response):
        remedy = "turn it by flip (--flip), or check axis and center"
        raise FileError(path, "", "the brighter side of the edge lies above 0", remedy)
    return measurement


def _layer(path: Path, layer: str | None) -> tuple[tuple[str, ...], np.ndarray]:
    """Names of the curves, and pixels of shape (height, width, channels)."""
    from sssfit.files.exr import read_exr

    held, _ = read_exr(path)
    prefixes = [name[:-1] for name in held if name.split(".")[-1] == "R"]
    prefixes = [p for p in prefixes if all(f"{p}{c}" in held for c in "RGB")]
    if layer is not None:
        chosen = [f"{layer}.{c}" for c in "RGB"] if f"{layer}." in prefixes else [layer]
    elif "" in prefixes or len(prefixes) == 1:
        chosen = [f"{'' if '' in prefixes else prefixes[0]}{c}" for c in "RGB"]
    else:
        chosen = list(held) if len(held) == 1 else []
    known = ", ".join([p.rstrip(".") or "R, G, B" for p in prefixes] or sorted(held))
    if not chosen or any(name not in held for name in chosen):
        problem = f"there is no layer {layer!r}" if layer else "it is not clear which layer is meant"
        raise FileError(path, "", problem, f"name one of its layers by layer (--layer): {known}")
    if any(held[name].dtype.kind != "f" for name in chosen):
        raise FileError(path, f"layer {layer}", "holds whole numbers", "give a layer of light")
    kind = np.result_type(*(held[name] for name in chosen))
    names = CHANNELS if len(chosen) == 3 else ("",)
    return names, np.stack([held[name].astype(kind) for name in chosen], axis=-1)


def _averaged(distance: np.ndarray, pixels: np.ndarray, parts: int, fewest: int, rounding: float):
    """Mean distances (m,), means and standard errors (m, channels) of pixels in the order of distance."""
    order = np.argsort(distance, kind="stable")
    distance, pixels = distance[order], pixels[order]
    begins = _begins(distance, parts, fewest)
    count = np.diff(begins, append=len(distance))[:, None]
    r = np.add.reduceat(distance, begins) / count[:, 0]
    mean = np.add.reduceat(pixels, begins) / count
    if np.median(count) < FEWEST_PIXELS:
        return r, mean, None
    deviation = pixels - np.repeat(mean, count[:, 0], axis=0)
    variance = np.add.reduceat(np.square(deviation), begins) / np.maximum(count - 1, 1)
    error = np.sqrt(_smoothed(variance) / count)
    floor = np.maximum(np.abs(mean) * rounding, _ACCURACY * np.max(mean))
    # Where nothing arrived in a pixel, one arrival would have been of the size of the smallest that did.
    smallest = np.min(pixels, where=pixels > 0, initial=np.inf, axis=0) / count
    has_nothing = np.add.reduceat(pixels == 0, begins) > 0
    floor = np.where(has_nothing, np.maximum(floor, smallest), floor)
    enough = count[:, 0] >= FEWEST_PIXELS
    return r[enough], mean[enough], np.maximum(error, floor)[enough]


def _begins(distance: np.ndarray, parts: int, fewest: int) -> np.ndarray:
    """Where to cut ascending distances into parts of about equal numbers, never between equal ones."""
    farthest = np.max(np.abs(distance))
    changes = np.concatenate([[0], np.flatnonzero(np.diff(distance) > 1e-9 * farthest) + 1])
    wanted = np.searchsorted(changes, np.arange(parts) * len(distance) / parts)
    begins = [0]
    for place in changes[np.minimum(wanted, len(changes) - 1)]:
        if place - begins[-1] >= fewest and len(distance) - place >= fewest:
            begins.append(int(place))
    return np.array(begins)


def _smoothed(variance: np.ndarray) -> np.ndarray:
    """Each row's mean with its neighbours."""
    padded = np.pad(variance, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0)
    return windows.mean(axis=-1)
