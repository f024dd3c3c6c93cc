"""Checked arguments of the table builders, and the axes they ask for."""

import numpy as np
from numpy.typing import ArrayLike

CHANNELS = ("R", "G", "B")


def within(name: str, values: ArrayLike, low: float, high: float = np.inf) -> np.ndarray:
    """Finite numbers in [low, high] as float64; ValueError that shows the first of the others."""
    array = np.asarray(values, np.float64)
    wrong = array[~((array >= low) & (array <= high) & np.isfinite(array))]
    if wrong.size:
        domain = f"at least {low:g} and finite" if high == np.inf else f"in [{low:g}, {high:g}]"
        raise ValueError(f"{name} must be {domain}, got {wrong[0]}")
    return array


def channels(name: str, values: ArrayLike, high: float = np.inf) -> np.ndarray:
    """One number in [0, high] for each of three channels, as `within`."""
    array = within(name, values, 0.0, high)
    if array.shape != (3,):
        raise ValueError(f"{name} must hold 3 numbers, one per channel, got shape {array.shape}")
    return array


def positive(name: str, value: float, unit: str) -> float:
    """A positive, finite number, or ValueError."""
    if not 0 < value < np.inf:
        raise ValueError(f"{name} must be positive and finite, in {unit}, got {value}")
    return float(value)


def uniform(name: str, count: int, low: float, high: float) -> np.ndarray:
    """`count` equally spaced nodes with both ends among them; ValueError below two."""
    if count < 2:
        raise ValueError(f"{name} must be at least 2, got {count}")
    return np.linspace(low, high, count)
