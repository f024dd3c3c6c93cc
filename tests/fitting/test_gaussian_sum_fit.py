"""Sums of Gaussians: published errors, planted sums found again, laws, agreement of the solvers, refusals."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from sssfit.fitting.gaussian_sum import AGREEMENT, fit, fit_profile
from sssfit.fitting.solve import SolverChoice
from sssfit.profiles import burley, dipole, gaussian_sum

# Reduced scattering and absorption of marble, 1/mm, at a refractive index of 1.5.
MARBLE = {"R": (2.19, 0.0021), "G": (2.62, 0.0041), "B": (3.00, 0.0071)}

# Percent of error with the weight r from 1e-4 to 400 mm, found in plain NumPy and SciPy, independently.
ERRORS = {
    ("G", 1): 26.556,
    ("G", 2): 9.5561,
    ("G", 3): 3.2597,
    ("G", 4): 1.2535,
    ("G", 6): 0.1967,
    ("G", 8): 0.0340,
    ("R", 4): 1.3548,
    ("R", 8): 0.0409,
    ("B", 4): 1.1565,
    ("B", 8): 0.0285,
}
FOUR = {
    "variances": [0.036286, 0.146147, 0.911426, 7.009642],
    "weights": [0.070363, 0.183888, 0.206040, 0.288166],
}
EIGHT = {
    "variances": [0.018917, 0.045377, 0.113179, 0.307816, 0.980559, 3.123668, 10.222126, 40.341582],
    "weights": [0.010529, 0.063535, 0.112661, 0.114296, 0.116069, 0.162042, 0.145104, 0.064984],
}

# Marked for what compiles: a k that no quicker test has.
CASES = [
    pytest.param(*case, marks=[] if case[1] in (2, 4) else pytest.mark.slow, id="".join(map(str, case)))
    for case in ERRORS
]


def marble(channel, k, solver: SolverChoice = "optimistix"):
    return fit_profile(lambda r: dipole.profile(r, *MARBLE[channel], 1.5), k, 1e-4, 400.0, solver=solver)


def summed(r, variances, weights):
    variances = np.asarray(variances)
    return np.exp(-(r[:, None] ** 2) / (2 * variances)) / (2 * np.pi * variances) @ np.asarray(weights)


@pytest.mark.parametrize("channel, k", CASES)
def test_errors_of_the_dipole(channel, k):
    result = marble(channel, k)
    assert result.converged, result.status
    # To the last digit in print.
    digits = 3 if k == 1 else 4
    assert round(100 * result.relative_error, digits) == ERRORS[channel, k]
    assert np.all(np.diff(result.variances) > 0)


@pytest.mark.parametrize("k, table", [(4, FOUR), pytest.param(8, EIGHT, marks=pytest.mark.slow)])
def test_gaussians_of_the_dipole(k, table):
    result = marble("G", k)
    # Half a digit in print, and the solvers' tolerance.
    np.testing.assert_allclose(result.variances, table["variances"], atol=6e-7, rtol=2e-6)
    np.testing.assert_allclose(result.weights, table["weights"], atol=6e-7, rtol=2e-6)
    # The weights are free: their sum is not the profile's energy.
    assert result.weights.sum() < 0.999 * float(dipole.diffuse_reflectance(*MARBLE["G"], 1.5))


def test_relative_error_is_that_of_the_curves():
    result = marble("G", 2)

    def integral(square):
        return quad(lambda s: np.exp(2 * s) * square(np.exp(s)), np.log(1e-4), np.log(400), limit=400)[0]

    with jax.enable_x64(True):
        exact = jax.jit(lambda r: dipole.profile(r, *MARBLE["G"], 1.5))
        misfit = integral(
            lambda r: (float(exact(r)) - summed(np.array([r]), result.variances, result.weights)[0]) ** 2
        )
        error = np.sqrt(misfit / integral(lambda r: float(exact(r)) ** 2))
    assert result.relative_error == pytest.approx(error, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("channel, k", [*(("G", k) for k in (2, 4, 6, 8)), ("R", 8), ("B", 8)])
def test_the_three_solvers_agree(channel, k):
    result = marble(channel, k, "all")
    assert result.converged, result.status
    assert [solution.solver for solution in result.solutions] == ["optimistix", "jaxopt", "scipy"]
    assert result.disagreement < AGREEMENT
    assert "away" not in result.status
    for solution in result.solutions:
        np.testing.assert_allclose(np.exp(solution.parameters), result.variances, rtol=AGREEMENT)


@pytest.mark.slow
def test_one_more_gaussian_is_better():
    errors = [marble("G", k).relative_error for k in range(1, 9)]
    assert np.all(np.diff(np.log(errors)) < np.log(0.6))


@settings(max_examples=20)
@given(
    narrow=st.floats(0.01, 10),
    ratio=st.floats(2, 50),
    weights=st.tuples(st.floats(0.05, 1), st.floats(0.05, 1)),
    first=st.sampled_from([0.0, 0.05]),
)
def test_two_planted_gaussians_are_found_again(narrow, ratio, weights, first):
    variances = np.array([narrow, narrow * ratio])
    r = np.linspace(first * np.sqrt(narrow), 5 * np.sqrt(variances[-1]), 200)
    result = fit(r, summed(r, variances, weights), 2)
    assert result.converged, result.status
    assert result.relative_error < 1e-9
    np.testing.assert_allclose(result.variances, variances, rtol=1e-6)
    np.testing.assert_allclose(result.weights, weights, rtol=1e-6)


def random_sum(rng, k):
    steps = rng.uniform(np.log(2), np.log(8), k - 1)
    return np.exp(rng.uniform(-3, 3) + np.append(0, np.cumsum(steps))), rng.uniform(0.1, 1, k)


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [np.linspace, np.geomspace])
@pytest.mark.parametrize("k", range(1, 7))
def test_planted_gaussians_are_found_again(k, spacing):
    rng = np.random.default_rng(k)
    for _ in range(10):
        variances, weights = random_sum(rng, k)
        r = spacing(0.1 * np.sqrt(variances[0]), 5 * np.sqrt(variances[-1]), 250)
        result = fit(r, summed(r, variances, weights), k)
        np.testing.assert_allclose(result.variances, variances, rtol=1e-6)
        np.testing.assert_allclose(result.weights, weights, rtol=1e-6)
        assert result.relative_error < 1e-9


@pytest.mark.slow
def test_six_published_gaussians_of_skin():
    variances, weights = gaussian_sum.SKIN_VARIANCES, gaussian_sum.SKIN_WEIGHTS[:, 0]
    r = np.geomspace(1e-3, 20, 256)
    with jax.enable_x64(True):
        values = np.asarray(gaussian_sum.profile(r, variances, weights))
    result = fit(r, values, 6)
    np.testing.assert_allclose(result.variances, variances, rtol=1e-6)
    np.testing.assert_allclose(result.weights, weights, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2, 4, 8])
def test_burley_is_fitted_at_any_width(k):
    # r R is steep at 0, so that ever narrower Gaussians help, as far down as the distances go.
    results = [
        fit_profile(lambda r, d=d: burley.profile(r, d, 0.5), k, 1e-3 * d, 60 * d) for d in (0.01, 1.0, 30.0)
    ]
    for result, d in zip(results, (0.01, 1.0, 30.0), strict=True):
        assert result.converged, result.status
        assert result.relative_error == pytest.approx(results[1].relative_error, rel=1e-6)
        np.testing.assert_allclose(result.variances / d**2, results[1].variances, rtol=1e-5)


def test_units_do_not_matter():
    r = np.linspace(0, 10, 100)
    values = np.exp(-r) / (1 + r)
    result = fit(r, values, 2)
    for length, height in ((1e-3, 1.0), (1.0, 1e-9), (1e3, 1e9)):
        other = fit(length * r, height * values, 2)
        assert other.relative_error == pytest.approx(result.relative_error, rel=1e-9)
        np.testing.assert_allclose(other.variances, length**2 * result.variances, rtol=1e-7)
        np.testing.assert_allclose(other.weights, height * length**2 * result.weights, rtol=1e-7)


def test_weights_pick_the_part_that_matters():
    r = np.linspace(0, 10, 100)
    values = np.exp(-r)
    near, far = fit(r, values, 2, weights=r < 2), fit(r, values, 2, weights=r > 3)
    assert near.variances[-1] < 0.5 * far.variances[-1]
    # The default is r dr by the trapezoid rule.
    dr = np.gradient(r)
    dr[[0, -1]] /= 2
    np.testing.assert_allclose(fit(r, values, 2, weights=r * dr).variances, fit(r, values, 2).variances)


def test_weights_may_turn_negative():
    # A ring: light that is missing in the middle.
    r = np.linspace(0, 8, 100)
    variances, weights = np.array([0.5, 2.0]), np.array([-0.3, 1.0])
    result = fit(r, summed(r, variances, weights), 2)
    np.testing.assert_allclose(result.weights, weights, rtol=1e-6)


def test_a_gaussian_too_many_does_no_harm():
    r = np.linspace(0, 8, 100)
    result = fit(r, summed(r, [1.0], [0.7]), 2)
    assert result.relative_error < 1e-7
    np.testing.assert_allclose(
        summed(r, result.variances, result.weights), summed(r, [1.0], [0.7]), atol=1e-7
    )


def test_a_variance_on_its_bound_is_told():
    # What is flat as far as it is known has no width.
    result = fit(np.linspace(0, 1, 50), np.ones(50), 2)
    assert "at the end of the range that the distances allow" in result.status


def test_result_ignores_the_precision_flag():
    r = np.linspace(0, 8, 100)
    with jax.enable_x64(True):
        inside = fit(r, np.exp(-r), 2)
    outside = fit(r, np.exp(-r), 2)
    np.testing.assert_array_equal(outside.variances, inside.variances)
    assert outside.variances.dtype == np.float64


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"k": 0}, "k must be from 1 to 8, got 0"),
        ({"k": 9}, "k must be from 1 to 8, got 9"),
        ({"k": 2.5}, "k must be from 1 to 8, got 2.5"),
        ({"r": [1.0, 2.0, 3.0]}, r"r must be a list of at least 2 k = 4 distances, got shape \(3,\)"),
        ({"r": np.ones((2, 5))}, r"r must be a list of at least 2 k = 4 distances, got shape \(2, 5\)"),
        ({"r": [3.0, 2.0, 1.0, 0.0, 4.0]}, "r must be >= 0 and ascending, got 3.0 to 4.0 in steps from -1.0"),
        ({"r": [0.0, 1.0, 1.0, 2.0, 4.0]}, "r must be >= 0 and ascending"),
        ({"r": [-1.0, 0.0, 1.0, 2.0, 4.0]}, "r must be >= 0 and ascending, got -1.0 to 4.0"),
        ({"r": [0.0, 1.0, 2.0, 3.0, np.nan]}, "r must be >= 0 and ascending"),
        ({"r": [0.0, 1.0, 2.0, 3.0, np.inf]}, "r must be >= 0 and ascending"),
        ({"values": np.zeros(5)}, "values must not be all 0 where they count"),
        ({"values": [1.0, 0.0, 0.0, 0.0, 0.0]}, "values must not be all 0 where they count"),
        ({"values": np.ones(4)}, r"values must be 5 finite numbers, got shape \(4,\)"),
        ({"values": [1.0, np.nan, 1.0, 1.0, 1.0]}, "values must be 5 finite numbers"),
        ({"weights": np.ones(4)}, r"weights must be 5 finite numbers >= 0, got shape \(4,\)"),
        ({"weights": [1.0, 1.0, 1.0, 1.0, -1.0]}, "weights must be 5 finite numbers >= 0"),
        (
            {"weights": [1.0, 1.0, 1.0, 0.0, 0.0]},
            "r must have at least 2 k = 4 points above 0 that count, got 2",
        ),
        ({"solver": "newton"}, "solver must be one of"),
    ],
)
def test_bad_arguments(arguments, message):
    every = {"r": np.arange(5.0), "values": np.exp(-np.arange(5.0)), "k": 2} | arguments
    with pytest.raises(ValueError, match=message):
        fit(**every)


@pytest.mark.parametrize("ends", [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (-1.0, 1.0), (1.0, np.inf)])
def test_an_empty_interval(ends):
    with pytest.raises(ValueError, match="lower and upper must be 0 < lower < upper < inf, got"):
        fit_profile(lambda r: r, 1, *ends)
