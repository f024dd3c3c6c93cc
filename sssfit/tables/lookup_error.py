"""What the size of a table costs: the error of looking it up instead of computing."""

from collections.abc import Callable

import numpy as np

from sssfit.tables.table import Table


def lookup_error(table: Table, evaluate: Callable[..., np.ndarray]) -> float:
    """Largest error of linear (or bilinear) interpolation between the entries of a table.

    The table is compared with the function it samples halfway between its entries: along each axis
    alone and along both at once, where the error of interpolating a smooth function peaks. The
    clamp at a table's border plays no part.

    Args:
        table: a table with one or two axes.
        evaluate: takes one array of coordinates per axis, in the axes' order and units, and returns
            exact values on their grid, of shape (*[len(c) for c in coordinates], len(channels)).

    Returns:
        Largest absolute difference over points and channels, in the table's unit.

    Example:
        >>> from sssfit.tables.table import Axis
        >>> x = np.array([0.0, 1.0, 2.0])
        >>> square = Table("square", "x squared.", (Axis("x", "1", x),), ("Y",), x[:, None] ** 2, "1")
        >>> lookup_error(square, lambda x: x[:, None] ** 2)
        0.25
    """
    interpolated = table.values
    for dimension in range(len(table.axes)):
        interpolated = _with_midpoints(interpolated, dimension)
    exact = evaluate(*(_with_midpoints(axis.values, 0) for axis in table.axes))
    return float(np.max(np.abs(interpolated - exact)))


def _with_midpoints(values: np.ndarray, dimension: int) -> np.ndarray:
    """The entries along one dimension with the mean of each neighbouring pair between them."""
    values = np.moveaxis(values, dimension, 0)
    refined = np.empty((2 * len(values) - 1, *values.shape[1:]))
    refined[0::2] = values
    refined[1::2] = (values[:-1] + values[1:]) / 2
    return np.moveaxis(refined, 0, dimension)
