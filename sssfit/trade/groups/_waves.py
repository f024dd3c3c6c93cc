"""A moving image in closed form, for the groups that look up the frame before."""

import numpy as np

#: Pixels a frame that it moves at most, along each axis.
FASTEST = 2.0
# Cycles a pixel: periods of 50 down to 4 pixels, in different directions.
_WAVES = ((0.02, 0.0), (0.03, 0.05), (-0.1, 0.06), (0.14, 0.14), (0.05, -0.25))


def motions(frames: int) -> np.ndarray:
    """Motion in each frame, pixels, (frames, 2), with fractions that are spread evenly."""
    turns = np.arange(1, frames + 1)[:, None] * (0.7548776662, 0.5698402910)
    return FASTEST * (turns % 1)


def image(size: int, shift: np.ndarray) -> np.ndarray:
    """Waves around a brightness of 1, never below 0, seen from a place that is moved, (size, size, 3)."""
    x, y = np.arange(size) + shift[0], (np.arange(size) + shift[1])[:, None]
    cycles = [across * x + down * y for across, down in _WAVES]
    channels = [sum(np.sin(2 * np.pi * (c + k * hue / 7)) for k, c in enumerate(cycles)) for hue in range(3)]
    return 1 + np.stack(channels, axis=-1) / len(_WAVES)


def error(found: np.ndarray, wanted: np.ndarray, frames: int) -> float:
    """Root mean square error over that of what is wanted, where no lookup has met the frame's edge."""
    border = round((FASTEST + 2) * frames)
    inner = (slice(border, -border), slice(border, -border))
    off = np.asarray(found, np.float64)[inner] - wanted[inner]
    return float(np.sqrt(np.mean(np.square(off)) / np.mean(np.square(wanted[inner]))))
