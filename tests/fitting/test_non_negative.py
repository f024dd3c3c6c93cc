"""Weights that are not negative, against another method and the conditions of an optimum."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from sssfit.fitting import non_negative


def problem(seed, rows=12, columns=5):
    random = np.random.default_rng(seed)
    return random.normal(size=(rows, columns)), random.normal(size=rows)


@given(st.integers(0, 10_000))
def test_it_is_the_optimum_of_another_method(seed):
    table, wanted = problem(seed)
    found = non_negative.least_squares(table, wanted)
    rival = lsq_linear(table, wanted, (0, np.inf), tol=1e-14, method="bvls")
    np.testing.assert_allclose(found, rival.x, atol=1e-10)


@given(st.integers(0, 10_000), st.lists(st.floats(-30, 30), min_size=5, max_size=5))
def test_columns_may_be_of_any_size(seed, powers):
    table, wanted = problem(seed)
    size = 10.0 ** np.array(powers)
    np.testing.assert_allclose(
        size * non_negative.least_squares(table * size, wanted),
        non_negative.least_squares(table, wanted),
        rtol=1e-9,
        atol=1e-12,
    )


def test_columns_without_anything_weigh_nothing():
    table, wanted = problem(0)
    table[:, 2] = 0
    assert non_negative.least_squares(table, wanted)[2] == 0
    assert np.all(non_negative.least_squares(np.zeros((3, 2)), np.ones(3)) == 0)


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"table must have the shape \(m, n\) and wanted \(m,\), got"):
        non_negative.least_squares(np.ones((3, 2)), np.ones(2))
