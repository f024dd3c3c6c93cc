"""How fitted parameters move, against fits anew: optima, falloffs, weights of c, and errors of a table."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar, root

from sssfit.fitting import (
    falloff_sensitivity,
    inverse_cdf,
    measured,
    measured_many,
    sensitivity,
    separable_to_burley,
)
from sssfit.fitting.separable_to_burley import Domain
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET
from sssfit.tables import transmittance

# --- optimum

X = np.linspace(0.0, 3.0, 6)
#: Far from any exponential: the residuals' own curvature matters.
Y = np.array([1.0, 0.9, 0.1, 0.5, -0.3, 0.4])


def residuals(p, problem):
    y, weights = problem
    return weights * (p[0] * jnp.exp(-p[1] * X) - y)


def refitted(y, weights, held=None):
    """The optimum where the gradient is 0, of the first parameter alone where the second is held."""
    square = np.square(weights)
    if held is not None:
        shape = np.exp(-held * X)
        return np.array([np.sum(square * shape * y) / np.sum(square * shape**2)])

    def gradient(p):
        shape = np.exp(-p[1] * X)
        left = square * (p[0] * shape - y) * shape
        return np.sum(left), -np.sum(left * X)

    return root(gradient, (1.0, 0.7), tol=1e-14).x


def by_differences(function, x, step=1e-4):
    columns = [
        (function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(len(x))
    ]  # fmt: skip
    return np.stack(columns, axis=-1)


WEIGHTS = np.array([1.0, 0.5, 2.0, 1.0, 0.7, 1.3])


def test_optimum_moves_as_fits_anew(x64):
    found = refitted(Y, WEIGHTS)
    by_y = by_differences(lambda y: refitted(y, WEIGHTS), Y)
    by_weights = by_differences(lambda w: refitted(Y, w), WEIGHTS)

    def optimum(y, weights):
        return sensitivity.optimum(residuals, (y, weights), found)

    np.testing.assert_array_equal(optimum(Y, WEIGHTS), found)
    for jacobian in (jax.jacfwd, jax.jacrev):
        in_y, in_weights = jax.jit(jacobian(optimum, argnums=(0, 1)))(jnp.array(Y), jnp.array(WEIGHTS))
        # The reference: differences of 1e-4, of fits that are good to about 1e-13.
        np.testing.assert_allclose(in_y, by_y, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(in_weights, by_weights, rtol=1e-5, atol=1e-6)
    # Gauss and Newton's approximation of the curvature would be off by far more.
    slopes = np.stack([np.exp(-found[1] * X), -found[0] * X * np.exp(-found[1] * X)], 1) * WEIGHTS[:, None]
    assert np.max(np.abs(np.linalg.solve(slopes.T @ slopes, slopes.T * WEIGHTS) - by_y)) > 0.02


def test_gradient_of_what_follows(x64):
    found = refitted(Y, WEIGHTS)

    def area(y):
        p = sensitivity.optimum(residuals, (y, WEIGHTS), found)
        return p[0] / p[1]

    expected = by_differences(lambda y: np.divide(*refitted(y, WEIGHTS)), Y)
    np.testing.assert_allclose(jax.grad(area)(jnp.array(Y)), expected, rtol=1e-5, atol=1e-6)


def test_many_optima_at_once(x64):
    data = jnp.array(Y + np.array([0.0, 0.05, -0.1])[:, None])
    found = jnp.array([refitted(np.asarray(y), WEIGHTS) for y in data])

    def moved(y, p):
        return jax.jacrev(lambda y: sensitivity.optimum(residuals, (y, WEIGHTS), p))(y)

    alone = jnp.stack([moved(y, p) for y, p in zip(data, found, strict=True)])
    np.testing.assert_allclose(jax.jit(jax.vmap(moved))(data, found), alone, rtol=1e-10, atol=1e-13)


def test_what_is_held_does_not_move_and_others_move_without_it(x64):
    first = refitted(Y, WEIGHTS, held=0.9)
    found = np.array([first[0], 0.9])
    free = np.array([True, False])
    moved = jax.jacrev(lambda y: sensitivity.optimum(residuals, (y, WEIGHTS), found, free))(jnp.array(Y))
    expected = by_differences(lambda y: refitted(y, WEIGHTS, held=0.9), Y)[0]
    np.testing.assert_allclose(moved[0], expected, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(moved[1], 0)


def test_a_flat_misfit_has_no_finite_derivative(x64):
    def flat(p, y):
        return jnp.stack([p[0] + p[1] - y])

    moved = jax.jacrev(lambda y: sensitivity.optimum(flat, y, jnp.array([0.5, 0.5])))(1.0)
    assert not np.any(np.isfinite(moved))


# --- falloffs


@pytest.mark.parametrize(
    "reading, power", [("radial", 2), pytest.param("as_coded", 1, marks=pytest.mark.slow)]
)
def test_slopes_obey_the_laws_of_scale(reading, power):
    found = separable_to_burley.fit(0.37, reading=reading)
    moved = falloff_sensitivity.slopes(found)
    phi = 0.37 + FALLOFF_OFFSET
    assert moved.d * phi / found.d == pytest.approx(1, rel=1e-6)
    assert moved.albedo * phi / found.albedo == pytest.approx(power, rel=1e-6)
    # dmfp = d (3.5 + 100 (albedo - .33)^4)
    scale = 3.5 + 100 * (found.albedo - 0.33) ** 4
    by_albedo = found.d * 400 * (found.albedo - 0.33) ** 3
    assert moved.dmfp == pytest.approx(moved.d * scale + by_albedo * moved.albedo, rel=1e-9)


@pytest.mark.parametrize(
    "falloff, objective, reading, domain",
    [
        (0.5, "difference", "radial", Domain(0.3, 2.5, 40, "uniform")),
        pytest.param(0.5, "ratio", "as_coded", None, marks=pytest.mark.slow),
        pytest.param(0.4, "derivative", "as_coded", None, marks=pytest.mark.slow),
        # Here the albedo is held by its bound.
        pytest.param(0.9, "difference", "as_coded", None, marks=pytest.mark.slow),
    ],
)
def test_slopes_are_differences_of_fits(falloff, objective, reading, domain):
    step = 1e-3
    low, middle, high = (
        separable_to_burley.fit(falloff + e, objective, reading=reading, domain=domain)
        for e in (-step, 0.0, step)
    )
    moved = falloff_sensitivity.slopes(middle, domain=domain)
    for name, slope in moved._asdict().items():
        expected = (getattr(high, name) - getattr(low, name)) / (2 * step)
        # The fits are good to about 1e-8, which the step magnifies to 1e-5.
        assert slope == pytest.approx(expected, rel=1e-4, abs=1e-5), name
    assert middle.at_bound == (moved.albedo == 0)


def test_what_no_fit_determined_has_no_slopes():
    found = separable_to_burley.fit(0.37, "derivative", reading="radial")
    assert np.isnan(falloff_sensitivity.slopes(found)).all()


# --- c

# The mean over xi of a square, by a rule of our own in s = -ln(1 - xi).
POINTS, MASSES = np.polynomial.legendre.leggauss(400)
S, MASSES = 20 * (POINTS + 1), 20 * MASSES * np.exp(-20 * (POINTS + 1))
XI = -np.expm1(-S)


def log_beyond(r):
    return np.logaddexp(-r, -r / 3 + np.log(3)) - np.log(4)


def radius_beyond(s):
    return brentq(lambda r: log_beyond(r) + s, 0, 3 * s + 3, xtol=1e-14)


RADII = np.array([radius_beyond(s) for s in S])


def g(c):
    return (2 - (2 - c) * XI) * S


ERRORS = {
    "cdf_mse": lambda c: np.exp(-S) - np.exp(log_beyond(g(c))),
    "relative_radius": lambda c: g(c) / RADII - 1,
    "radius": lambda c: g(c) - RADII,
}


@pytest.mark.parametrize("objective", ERRORS)
@pytest.mark.parametrize("shape", [lambda xi: xi, lambda xi: np.cos(9 * xi)], ids=["line", "wave"])
def test_weights_move_c_as_fits_anew(objective, shape):
    def fitted(extra):
        def cost(c):
            return np.sum(MASSES * (1 + extra * shape(XI)) * np.square(ERRORS[objective](c)))

        found = minimize_scalar(cost, bounds=(2, 4), method="bounded", options={"xatol": 1e-10})
        return float(found.x)  # pyright: ignore[reportAttributeAccessIssue]

    step = 0.03
    expected = (fitted(step) - fitted(-step)) / (2 * step)
    c = inverse_cdf.fit_c(objective).c
    assert fitted(0) == pytest.approx(c, abs=1e-6)
    xi, moved = inverse_cdf.weight_sensitivity(objective, c)
    found = np.trapezoid(moved * shape(xi), xi)
    # Third derivatives of a step of 3 %, and a minimum that is found to 1e-7.
    assert found == pytest.approx(expected, rel=1e-2, abs=1e-5)


@pytest.mark.parametrize("objective", ["cdf_mse", "relative_radius", "radius", "kl"])
def test_more_weight_everywhere_changes_nothing(objective):
    xi, moved = inverse_cdf.weight_sensitivity(objective, inverse_cdf.fit_c(objective).c)
    assert xi.shape == moved.shape and np.all(np.diff(xi) >= 0)
    assert abs(np.trapezoid(moved, xi)) < 1e-3 * np.trapezoid(np.abs(moved), xi)


@pytest.mark.parametrize("objective", ["cdf_minimax", "mean_radius", "square"])
def test_objectives_without_weights_are_refused(objective):
    with pytest.raises(ValueError, match=f"objective must be an integral over xi, got '{objective}'"):
        inverse_cdf.weight_sensitivity(objective, 2.57)


# --- into a table


def test_errors_of_a_table_are_those_of_fits_anew(x64):
    r, number = np.geomspace(0.1, 20, 48), 400
    albedo, d, thickness = 0.6, 1.2, np.array([0.0, 0.5, 2.0, 6.0, 15.0])
    clean = albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r)
    sigma = 0.05 * clean
    values = clean + sigma * np.random.default_rng(8).normal(size=(number, 48))

    many = measured_many.fit(r, values, sigma=sigma)
    passed = [
        transmittance.evaluate(thickness, np.full(3, d), np.full(3, a))[:, 0] for a, d in many.parameters
    ]
    spread = np.std(passed, axis=0, ddof=1)

    fit = measured.fit(r, clean, sigma=sigma)

    def table(p):
        return transmittance.evaluate(thickness, np.full(3, np.exp(p[1])), np.full(3, p[0]))[:, 0]

    slopes = by_differences(table, np.array([albedo, np.log(d)]))
    propagated = np.sqrt(np.einsum("ti,ij,tj->t", slopes, fit.covariance, slopes))
    # A standard deviation of 400 has a standard error of 3.5 %; that the propagation is linear costs less.
    np.testing.assert_allclose(spread / propagated, 1, atol=4 / np.sqrt(2 * (number - 1)))
    # Through each value instead: what an error of it does to the fit, and so to the table.
    by_value = slopes @ fit.influence[:, :, 0]
    np.testing.assert_allclose(np.sqrt(np.square(by_value) @ np.square(sigma)), propagated, rtol=1e-6)
