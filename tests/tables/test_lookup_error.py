import numpy as np
import pytest

from sssfit.tables.lookup_error import lookup_error
from sssfit.tables.table import Axis, Table


def sampled(evaluate, *coordinates):
    axes = tuple(Axis(f"x{i}", "1", np.asarray(c, float)) for i, c in enumerate(coordinates))
    values = evaluate(*(axis.values for axis in axes))
    return Table("t", "A test.", axes, ("A", "B")[: values.shape[-1]], values, "1")


def test_linear_functions_cost_nothing():
    def plane(x, y):
        return np.stack([x[:, None] + 2 * y, 3 - y + 0 * x[:, None]], -1)

    assert lookup_error(sampled(plane, [0, 1, 3], [0, 0.5]), plane) <= 1e-15


def test_curved_functions_cost_an_eighth_of_the_second_difference():
    def parabola(x):
        return np.stack([0 * x, x**2], -1)

    # The wider of two unequal cells, in the second channel.
    assert lookup_error(sampled(parabola, [0, 1, 3]), parabola) == pytest.approx(1.0)


def test_rows_and_columns_and_both_count():
    def ridge(x, y):
        return (x[:, None] ** 2 + y**2)[:, :, None]

    assert lookup_error(sampled(ridge, [0, 1], [0, 2]), ridge) == pytest.approx(0.25 + 1.0)

    def corner(x, y):
        return (np.abs(x - 0.5)[:, None] * (y == 0))[:, :, None]

    # Wrong on the border between two rows only, where no cell has its centre.
    assert lookup_error(sampled(corner, [0, 1], [0, 1]), corner) == pytest.approx(0.5)
