"""The three solvers on problems with known answers, inside boxes and on their walls."""

import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.fitting import solve

# Every solver compiles for every problem.
pytestmark = pytest.mark.slow

INFINITE = np.full(2, np.inf)


def exponential(parameters, data):
    x, y = data
    return parameters[0] * jnp.exp(-x / parameters[1]) - y


def rosenbrock(parameters, scale):
    a, b = parameters
    return scale * jnp.stack([10 * (b - a**2), 1 - a])


def planted(amplitude=2.0, length=0.7):
    x = np.linspace(0, 4, 40)
    return x, amplitude * np.exp(-x / length)


@pytest.mark.parametrize("solver", solve.SOLVERS)
@pytest.mark.parametrize("box", [(0.0, 10.0), (0.0, np.inf), (-np.inf, np.inf)])
def test_planted_parameters_are_recovered(solver, box):
    lower, upper = np.full(2, box[0]), np.full(2, box[1])
    found = solve.least_squares(exponential, planted(), np.ones(2), lower, upper, solver)
    assert found.converged, found.status
    np.testing.assert_allclose(found.parameters, [2.0, 0.7], rtol=1e-6)


@pytest.mark.parametrize("solver", solve.SOLVERS)
@pytest.mark.parametrize("shift", [-13.0, 0.0, 10.0])
def test_bounds_translate(solver, shift):
    def residuals(parameters, centre):
        return jnp.concatenate([parameters - centre, parameters**2 * 0])

    lower, upper = np.array([shift]), np.array([shift + 3.0])
    for centre, expected in ((shift + 2.0, shift + 2.0), (shift + 5.0, shift + 3.0), (shift - 5.0, shift)):
        found = solve.least_squares(residuals, centre, np.array([shift + 1.0]), lower, upper, solver)
        assert found.parameters[0] == pytest.approx(expected, abs=1e-6), found.status
        assert lower[0] <= found.parameters[0] <= upper[0]


@pytest.mark.parametrize("solver", ["optimistix", "jaxopt"])
@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_unit_of_the_residuals_does_not_matter(solver, scale):
    start, box = np.array([-1.2, 1.0]), (np.full(2, -3.0), np.full(2, 3.0))
    found = solve.least_squares(rosenbrock, scale, start, *box, solver)
    np.testing.assert_allclose(found.parameters, 1.0, atol=1e-5)


@pytest.mark.parametrize("solver", solve.SOLVERS)
def test_a_failure_is_told_not_raised(solver):
    found = solve.least_squares(
        lambda p, _: jnp.stack([p[0] * jnp.nan]), 0.0, np.ones(1), np.zeros(1), np.full(1, 2.0), solver
    )
    assert not found.converged
    assert found.status


def test_bounds_are_reached_exactly_by_the_sine_map():
    found = solve.least_squares(
        lambda p, _: p - 7.0, 0.0, np.array([0.5]), np.zeros(1), np.ones(1), "optimistix"
    )
    assert found.parameters[0] == pytest.approx(1.0, abs=1e-12)
