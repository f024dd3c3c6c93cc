"""Pictures of frames for people to look at: PNG, eight bits, display colours."""

import io

import numpy as np
from jax.typing import ArrayLike

from sssfit.frames.gbuffer import BACKGROUND_DEPTH, Frame


def png(colours: ArrayLike, *, white: float | None = None) -> bytes:
    """A picture of linear colours.

    Args:
        colours: (H, W, 3), linear; below 0 and NaN are shown black.
        white: the number shown as white; the 99.5 % quantile of the largest channel by default.

    Returns:
        A PNG file in sRGB; the same colours give the same bytes.

    Example:
        >>> png(np.ones((2, 2, 3)))[1:4]
        b'PNG'
    """
    colours = np.nan_to_num(np.asarray(colours, np.float64), nan=0.0)
    if white is None:
        white = float(np.quantile(colours.max(axis=-1), 0.995)) or 1.0
    return _encoded(_display(colours / white))


def layers(frame: Frame) -> bytes:
    """The layers of a frame in one picture.

    From the upper left: irradiance, albedo, profile id; depth (nearer is brighter), normal, motion (grey is
    none, red to the right, green down; brightest is the largest); black where the frame has no such layer.

    Args:
        frame: to be shown.

    Returns:
        A PNG file, three times as wide and twice as high as the frame.

    Example:
        >>> from sssfit.frames import procedural
        >>> layers(procedural.frame(width=16, height=9))[1:4]
        b'PNG'
    """
    ids = np.asarray(frame.profile_id)
    surface = (ids > 0)[..., None]
    nothing = np.zeros((*ids.shape, 3))
    irradiance = np.asarray(frame.irradiance, np.float64)
    albedo = nothing if frame.albedo is None else np.asarray(frame.albedo, np.float64)
    normal = nothing if frame.normal is None else surface * (0.5 + 0.5 * np.asarray(frame.normal, np.float64))
    motion = nothing.copy()
    if frame.motion is not None:
        moved = np.asarray(frame.motion, np.float64)
        motion[..., :2] = 0.5 + 0.5 * moved / (np.abs(moved).max() or 1.0)
        motion[..., 2] = 0.5
    upper = [_display(irradiance / (irradiance.max() or 1.0)), _display(albedo), _colours_of_ids(ids)]
    lower = [_brightness_of_depth(np.asarray(frame.depth, np.float64), ids), normal, surface * motion]
    return _encoded(np.concatenate([np.concatenate(row, axis=1) for row in (upper, lower)]))


def _display(linear: np.ndarray) -> np.ndarray:
    """Linear numbers in [0, 1] as sRGB."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _brightness_of_depth(depth: np.ndarray, ids: np.ndarray) -> np.ndarray:
    seen = (ids > 0) & (depth < 0.99 * BACKGROUND_DEPTH)
    near, far = (depth[seen].min(), depth[seen].max()) if seen.any() else (0.0, 1.0)
    shown = np.where(seen, 1 - 0.85 * (depth - near) / ((far - near) or 1.0), 0)
    return np.repeat(shown[..., None], 3, axis=-1)


def _colours_of_ids(ids: np.ndarray) -> np.ndarray:
    """Colours that differ from one id to the next; black is none."""
    hue = (ids[..., None] * 0.618034 + np.array([0.0, 1 / 3, 2 / 3])) % 1
    return np.where(ids[..., None] > 0, np.clip(np.abs(6 * hue - 3) - 1, 0.15, 0.9), 0)


def _encoded(display: np.ndarray) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.round(255 * np.clip(display, 0, 1)).astype(np.uint8)).save(stream, "png")
    return stream.getvalue()
