"""Linear least squares with weights that are not negative."""

import numpy as np
from numpy.typing import ArrayLike


def least_squares(table: ArrayLike, wanted: ArrayLike) -> np.ndarray:
    """Weights of a table's columns whose sum is nearest to what is wanted.

    Args:
        table: finite, shape (m, n).
        wanted: finite, shape (m,).

    Returns:
        The weights with the least sum of squared differences among those >= 0, float64, shape (n,). Columns
        may be of any size. Of columns that are multiples of each other some weights are 0; so are those of
        columns without anything.

    Raises:
        ValueError: shapes that do not fit.

    Source: Lawson and Hanson, "Solving least squares problems", 1974, chapter 23, by SciPy.

    Example:
        >>> least_squares([[1.0, 0.0], [1.0, 1.0]], [2.0, 1.0])
        array([1.5, 0. ])
    """
    from scipy.optimize import nnls

    table, wanted = np.asarray(table, np.float64), np.asarray(wanted, np.float64)
    if table.ndim != 2 or wanted.shape != table.shape[:1]:
        raise ValueError(
            f"table must have the shape (m, n) and wanted (m,), got {table.shape} and {wanted.shape}"
        )
    # The solver has one tolerance for all columns.
    size = np.max(np.abs(table), axis=0, initial=0)
    size = np.where(size > 0, size, 1)
    return nnls(table / size, wanted)[0] / size
