"""Light over time: intensities of frames, from a formula or from a CSV file.

An intensity is a factor on all of a scenario's light, 1 at rest. Four files of the kind that `load` reads are
shipped: static, sine, on_off and candle, ten seconds each at 60 frames a second.

Source: Xie and Olano 2021, section 4 and 7 (sine, switching, candles).
"""

import math
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np

from sssfit.files import csv_rows
from sssfit.files.errors import FileError
from sssfit.files.reading import read_bytes

#: Frames per second of a game.
FPS = 60.0


def static(frames: int, *, fps: float = FPS) -> np.ndarray:
    """Light that stays.

    Args:
        frames: how many, >= 1.
        fps: frames per second, which change nothing here.

    Returns:
        Ones, float64, shape (frames,).

    Source: Xie and Olano 2021, Fig 2b.

    Example:
        >>> static(3).tolist()
        [1.0, 1.0, 1.0]
    """
    return np.ones(_check(frames, fps))


def sine(frames: int, *, fps: float = FPS, frequency: float = 1.0, depth: float = 0.5) -> np.ndarray:
    """Light that swells and fades.

    Args:
        frames: how many, >= 1.
        fps: frames per second, > 0.
        frequency: cycles per second, >= 0.
        depth: in [0, 1]; at 1 the light goes out once a cycle.

    Returns:
        1 + depth sin(2 pi frequency t), t = 0, 1 / fps, ..., float64, shape (frames,).

    Raises:
        ValueError: an argument is out of its domain.

    Source: Xie and Olano 2021, Fig 2g, whose numbers are not stated.

    Example:
        >>> sine(4, fps=4.0).round(6).tolist()
        [1.0, 1.5, 1.0, 0.5]
    """
    phase = _phase(frames, fps, frequency, depth)
    return np.maximum(1 + depth * np.sin(2 * math.pi * phase), 0.0)


def on_off(frames: int, *, fps: float = FPS, frequency: float = 1.0, depth: float = 1.0) -> np.ndarray:
    """Light that is switched: on for half a cycle, then off.

    Args:
        frames: how many, >= 1.
        fps: frames per second, > 0.
        frequency: cycles per second, >= 0.
        depth: in [0, 1]: what is taken away when off.

    Returns:
        1 or 1 - depth, float64, shape (frames,).

    Raises:
        ValueError: an argument is out of its domain.

    Source: Xie and Olano 2021, section 7, "Regular lighting".

    Example:
        >>> on_off(4, fps=4.0).tolist()
        [1.0, 1.0, 0.0, 0.0]
    """
    phase = _phase(frames, fps, frequency, depth)
    # A switch that falls on a frame belongs to it, whatever rounding makes of the time.
    return np.where(np.floor(2 * phase + 1e-9) % 2 == 0, 1.0, 1.0 - depth)


def candle(frames: int, *, fps: float = FPS) -> np.ndarray:
    """The light of the shipped candle, which flickers.

    Args:
        frames: how many, >= 1; after ten seconds it begins anew.
        fps: frames per second, > 0.

    Returns:
        Intensities with mean 1 over the ten seconds, float64, shape (frames,).

    Raises:
        ValueError: an argument is out of its domain.

    Source: a synthetic flame, described in data/SOURCES.md; the use: Xie and Olano 2021, section 7.

    Example:
        >>> bool(0.2 < candle(600).min() < 1 < candle(600).max() < 2)
        True
    """
    return load(shipped("candle"), frames, fps=fps)


#: The lights that have a name.
LIGHTS: dict[str, Callable[..., np.ndarray]] = {
    "static": static,
    "sine": sine,
    "on_off": on_off,
    "candle": candle,
}


def shipped(name: str) -> Path:
    """Path of a shipped file of intensities.

    Args:
        name: one of `LIGHTS`.

    Raises:
        ValueError: there is no such file.

    Example:
        >>> shipped("candle").name
        'candle.csv'
    """
    if name not in LIGHTS:
        raise ValueError(f"light must be one of {', '.join(LIGHTS)}, got {name!r}")
    installed = Path(str(resources.files("sssfit") / "data" / "lights" / f"{name}.csv"))
    if installed.is_file():
        return installed
    return Path(__file__).resolve().parents[2] / "data" / "lights" / f"{name}.csv"


def load(path: str | Path, frames: int, *, fps: float = FPS) -> np.ndarray:
    """Intensities from a CSV file with the columns time (s, ascending from 0) and intensity (>= 0).

    Args:
        path: the file.
        frames: how many, >= 1.
        fps: frames per second, > 0.

    Returns:
        Interpolated linearly at 0, 1 / fps, ..., float64, shape (frames,). After the last time, one mean
        step later, the file begins anew.

    Raises:
        FileError: the file has a fault, which the message places.
        ValueError: frames or fps is out of its domain.

    Source: none; linear interpolation.

    Example:
        >>> load(shipped("static"), 2).tolist()
        [1.0, 1.0]
    """
    time = np.arange(_check(frames, fps)) / fps
    given, intensity = read_columns(path, "time", "intensity", start=0.0)
    period = given[-1] * len(given) / (len(given) - 1) if len(given) > 1 else 1.0
    # In the step before the file begins anew it goes back to its first intensity.
    closed = (np.append(given, period), np.append(intensity, intensity[0]))
    return np.interp(time % period, *closed)


def read_columns(
    path: str | Path, ascending: str, positive: str, *, start: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Two columns of a CSV file.

    Args:
        path: the file.
        ascending: name of a column whose numbers rise strictly.
        positive: name of a column whose numbers are not negative.
        start: what the first must begin with; None leaves it free.

    Returns:
        Both, float64, shape (rows,).

    Raises:
        FileError: the file, a column or a number is not as it must be.

    Example:
        >>> time, intensity = read_columns(shipped("on_off"), "time", "intensity")
        >>> time.shape, intensity.max()
        ((600,), np.float64(1.0))
    """
    name = Path(path).name
    columns, rows = csv_rows.parse(read_bytes(path), name)
    for column in (ascending, positive):
        if column not in columns:
            raise FileError(name, "row 1", f"there is no column {column!r}", f"name one of them {column!r}")
    first, second = (np.array([row.number(c) for row in rows]) for c in (ascending, positive))
    if start is not None and first[0] != start:
        raise rows[0].fault(f"{ascending} begins with {first[0]:g}", f"begin with {start:g}")
    for row, step in zip(rows[1:], np.diff(first), strict=True):
        if step <= 0:
            raise row.fault(f"{ascending} does not rise", "sort the rows and keep one of each")
    for row, number in zip(rows, second, strict=True):
        if number < 0:
            raise row.fault(f"{positive} is {number:g}", "write a number of at least 0")
    return first, second


def _check(frames: int, fps: float) -> int:
    if frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    if not 0 < fps < math.inf:
        raise ValueError(f"fps must be above 0, got {fps}")
    return frames


def _phase(frames: int, fps: float, frequency: float, depth: float) -> np.ndarray:
    """Cycles since the first frame."""
    if not 0 <= frequency < math.inf:
        raise ValueError(f"frequency must be at least 0, got {frequency}")
    if not 0 <= depth <= 1:
        raise ValueError(f"depth must be in [0, 1], got {depth}")
    return np.arange(_check(frames, fps)) * frequency / fps
