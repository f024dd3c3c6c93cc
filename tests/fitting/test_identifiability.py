"""Standard errors against textbook least squares and against a simulation of correlated misfit."""

import numpy as np
import pytest

from sssfit.fitting.identifiability import analyse, interval_factor


def test_independent_signs_give_the_textbook_covariance():
    rng = np.random.default_rng(7)
    x = np.linspace(0, 1, 400)
    jacobian = np.stack([np.ones_like(x), x], axis=1)
    residuals = np.where(np.arange(400) % 2 == 0, 1.0, -1.0) * rng.uniform(0.5, 1.5, 400)
    found = analyse(jacobian, residuals, 1.0)
    textbook = np.sum(residuals**2) / 400 * np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(found.covariance, textbook, rtol=1e-10)
    assert found.condition_number == pytest.approx(np.linalg.cond(jacobian))


@pytest.mark.parametrize("refinement", [1, 4, 16])
def test_intervals_do_not_shrink_when_the_grid_is_refined(refinement):
    def standard_error(points):
        x = (np.arange(points) + 0.5) / points
        root = np.sqrt(1 / points)
        return analyse(root * np.ones((points, 1)), root * 0.1 * np.sin(6 * np.pi * x), 1.0).standard_error[0]

    assert standard_error(64 * refinement) == pytest.approx(standard_error(64), rel=1e-2)


def test_units_of_the_data_do_not_matter():
    x = np.linspace(0.1, 1, 50)
    jacobian, residuals = np.stack([x, x**2], axis=1), 0.01 * np.sin(20 * x)
    here, there = analyse(jacobian, residuals, 3.0), analyse(1e9 * jacobian, 1e9 * residuals, 3e9)
    np.testing.assert_allclose(here.standard_error, there.standard_error, rtol=1e-9)
    np.testing.assert_allclose(here.singular_values, there.singular_values, rtol=1e-9)


def test_a_parameter_without_effect_is_not_determined():
    x = np.linspace(0, 1, 20)
    found = analyse(np.stack([x, 0 * x], axis=1), 0.1 * np.sin(9 * x), 1.0)
    assert found.determined.tolist() == [True, False]
    assert np.isfinite(found.standard_error[0])
    assert np.isinf(found.standard_error[1])
    assert np.isinf(found.condition_number)


def test_a_product_leaves_both_factors_undetermined():
    x = np.linspace(0.1, 1, 20)
    found = analyse(np.stack([x, x], axis=1), 0.1 * np.sin(9 * x), 1.0)
    assert not found.determined.any()


def test_interval_factor_is_the_normal_one():
    assert float(interval_factor(1.0)) == pytest.approx(np.exp(1.959963984540054))
