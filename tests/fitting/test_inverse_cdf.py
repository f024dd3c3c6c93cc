"""The fit of c: published and reference values, three solvers, and integrals by SciPy's quadrature."""

from typing import Any

import jax
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from sssfit.fitting import inverse_cdf
from sssfit.fitting.inverse_cdf import fit_c, report

# Six objectives by three solvers.
pytestmark = pytest.mark.slow

# Minimizers found with mpmath or SciPy in plain NumPy, independently of this package.
REFERENCES = {
    "cdf_mse": 2.571500425201475819,
    "cdf_minimax": 2.595193,
    "relative_radius": 2.6044901901959422975,
    "radius": 2.7434199554125939806,
    "mean_radius": 8 / 3,
    "kl": 2.700249,
}
# The two references above with six digits are good to half a unit of the last one.
TOLERANCES = {"cdf_minimax": 1e-6, "kl": 1e-6}


def g(xi, c):
    return ((2 - c) * xi - 2) * np.log1p(-xi)


def cdf(x):
    return -0.25 * np.expm1(-x) - 0.75 * np.expm1(-x / 3)


def exact_radius(xi):
    return brentq(lambda x: cdf(x) - xi, 0, 200, xtol=1e-14)


@pytest.fixture(scope="module")
def fits():
    return {objective: fit_c(objective, "all") for objective in inverse_cdf.OBJECTIVES}


@pytest.mark.parametrize("objective", inverse_cdf.OBJECTIVES)
def test_every_solver_finds_the_reference(fits, objective):
    fit = fits[objective]
    assert fit.converged, fit.status
    assert [s.solver for s in fit.solutions] == ["optimistix", "jaxopt", "scipy"]
    for solution in fit.solutions:
        assert solution.parameters[0] == pytest.approx(
            REFERENCES[objective], abs=TOLERANCES.get(objective, 1e-7)
        )
    assert fit.disagreement < 1e-7


def test_published_constant_is_the_mean_square_of_the_cdf(fits):
    assert round(fits["cdf_mse"].c, 4) == 2.5715


def test_mean_square_matches_scipy(fits):
    def mean_square(c):
        return quad(lambda xi: (cdf(g(xi, c)) - xi) ** 2, 0, 1, epsabs=1e-13, limit=200)[0]

    found: Any = minimize_scalar(mean_square, bounds=(2.4, 2.8), method="bounded", options={"xatol": 1e-9})
    # A minimum located by values alone is good to the square root of their accuracy.
    assert fits["cdf_mse"].c == pytest.approx(found.x, abs=2e-5)
    assert fits["cdf_mse"].report.cdf_rms == pytest.approx(np.sqrt(found.fun), rel=1e-9)


@pytest.mark.parametrize("c", [2.0, 2.5715, 2.6, 3.0])
def test_report_matches_scipy(c):
    errors = report(c)

    def mean(f):
        # In s = -ln(1 - xi) the logarithm at xi = 1 is gone.
        return quad(lambda s: f(-np.expm1(-s)) * np.exp(-s), 0, 34, epsabs=1e-13, limit=400)[0]

    assert errors.cdf_rms == pytest.approx(np.sqrt(mean(lambda xi: (cdf(g(xi, c)) - xi) ** 2)), rel=1e-8)
    assert errors.mean_radius_bias == pytest.approx((0.5 + 0.75 * c) / 2.5 - 1, abs=1e-12)
    radius = mean(lambda xi: (g(xi, c) - exact_radius(xi)) ** 2)
    assert errors.radius_rms == pytest.approx(np.sqrt(radius), rel=1e-5)
    relative = mean(lambda xi: (g(xi, c) / exact_radius(xi) - 1) ** 2 if xi > 0 else 0.0)
    assert errors.relative_radius_rms == pytest.approx(np.sqrt(relative), rel=1e-5)
    xi = np.linspace(1e-6, 1 - 1e-6, 200_001)
    assert errors.cdf_max == pytest.approx(np.max(np.abs(cdf(g(xi, c)) - xi)), rel=1e-6)


def test_divergence_matches_scipy():
    def integrand(s):
        xi, u, c = -np.expm1(-s), np.exp(-s), 2.5715
        slope = (2 - c) * -s + (2 - (2 - c) * xi) / u
        x = g(xi, c)
        density = (np.exp(-x) + np.exp(-x / 3)) / 4
        return -np.log(density * slope) * u

    assert report(2.5715).kl == pytest.approx(quad(integrand, 0, 34, epsabs=1e-13, limit=400)[0], abs=1e-10)


def test_largest_errors_balance_at_the_minimax(fits):
    xi = np.linspace(1e-6, 1 - 1e-6, 400_001)
    errors = cdf(g(xi, fits["cdf_minimax"].c)) - xi
    assert errors.max() == pytest.approx(-errors.min(), rel=1e-5)


def test_result_ignores_the_precision_flag(fits):
    with jax.enable_x64(True):
        assert fit_c("cdf_mse").c == pytest.approx(fits["cdf_mse"].c, abs=1e-12)
    assert not jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]


def test_figures_are_plain_floats(fits):
    assert type(fits["kl"].c) is float
    assert all(type(value) is float for value in vars(fits["kl"].report).values())


def test_unknown_objective():
    with pytest.raises(ValueError, match="objective must be one of cdf_mse, .*, got 'mse'"):
        fit_c("mse")  # pyright: ignore[reportArgumentType]


def test_unknown_solver():
    with pytest.raises(
        ValueError, match="solver must be one of optimistix, jaxopt, scipy or all, got 'newton'"
    ):
        fit_c(solver="newton")  # pyright: ignore[reportArgumentType]


def test_report_refuses_a_radius_that_is_not_monotone():
    with pytest.raises(ValueError, match="c must be at least 2.*got 1.9"):
        report(1.9)
