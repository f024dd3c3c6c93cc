"""The separable fit: reference constants, scaling laws, refusals, and agreement of the solvers."""

import jax
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares

from sssfit.fitting import separable_to_burley
from sssfit.fitting.separable_to_burley import Domain, fit, fit_many
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET

FREE = (0.0, np.inf)
UNIT = 1 - FALLOFF_OFFSET  # the falloff at which phi is 1

# (reading, objective, domain) -> (albedo, d / phi), found in plain NumPy and SciPy, independently.
CONSTANTS = {
    ("as_coded", "difference", None): (1.45715644870843, 0.193150096888229),
    ("radial", "difference", None): (0.868604681520524, 0.894085873076704),
    ("as_coded", "derivative", None): (3.24242862056722, 0.434071104325509),
}
# Figures of which three digits are known.
ROUNDED = {
    ("as_coded", "ratio", Domain(0, 3)): (1.14, 0.250),
    ("as_coded", "ratio", Domain(0, 6)): (1.01, 0.278),
    ("as_coded", "ratio", Domain(0, 10)): (0.772, 0.310),
    ("radial", "difference", Domain(0, 6)): (0.894, 0.936),
    ("radial", "difference", Domain(0, 10)): (0.872, 0.898),
}


CASES = [pytest.param(case, marks=pytest.mark.slow) if "derivative" in case else case for case in CONSTANTS]


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case[:2])))
def test_reference_constants_by_every_solver(case):
    reading, objective, domain = case
    result = fit(UNIT, objective, reading=reading, domain=domain, albedo_bounds=FREE, solver="all")
    assert result.converged, result.status
    for solution in result.solutions:
        # A minimum of a function that is good to 1e-16 relative is located to about its root.
        np.testing.assert_allclose(solution.parameters, CONSTANTS[case], rtol=1e-5)
    np.testing.assert_allclose((result.albedo, result.d), CONSTANTS[case], rtol=2e-8)
    assert result.disagreement < 1e-5


@pytest.mark.parametrize("case", ROUNDED, ids=str)
def test_rounded_constants(case):
    reading, objective, domain = case
    result = fit(UNIT, objective, reading=reading, domain=domain, albedo_bounds=FREE)
    assert (result.albedo, result.d) == pytest.approx(ROUNDED[case], rel=5e-3)


def test_plain_scipy_on_a_plain_grid_agrees():
    variances, weights = (
        np.array([0.0484, 0.187, 0.567, 1.99, 7.41]),
        np.array([0.1, 0.118, 0.113, 0.358, 0.078]),
    )
    phi, count = 0.371, 200
    r = phi * 12 * (np.arange(count) + 0.5) / count
    p = np.sum(
        weights / (2 * np.pi * variances) * np.exp(-((r[:, None] / phi) ** 2) / (2 * variances)), axis=1
    )

    def residuals(parameters):
        albedo, d = parameters
        return albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d) - r * p

    reference = least_squares(residuals, [0.1, 0.3], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    result = fit(0.37, domain=Domain(0, 12, count, "uniform"))
    np.testing.assert_allclose((result.albedo, result.d), reference, rtol=1e-6)


@pytest.mark.parametrize("reading, power", [("as_coded", 1), ("radial", 2)])
def test_scaling_law_holds_while_the_albedo_is_free(reading, power):
    falloffs = np.array([0.002, 0.01, 0.1, 0.3, 0.37, 0.68, 1.0])
    albedo, d, _, converged = fit_many(falloffs, reading=reading, albedo_bounds=FREE)
    phi = falloffs + FALLOFF_OFFSET
    assert converged.all()
    factor, delta = CONSTANTS[(reading, "difference", None)]
    np.testing.assert_allclose(albedo, factor * phi**power, rtol=1e-6)
    np.testing.assert_allclose(d, delta * phi, rtol=1e-6)


def test_the_bound_breaks_the_law_from_where_the_law_crosses_it():
    a, delta = CONSTANTS[("as_coded", "difference", None)]
    crossing = 1 / a - FALLOFF_OFFSET
    below, above = fit(crossing - 0.01, reading="as_coded"), fit(crossing + 0.01, reading="as_coded")
    assert not below.at_bound
    assert below.d == pytest.approx(delta * (below.falloff + FALLOFF_OFFSET), rel=1e-6)
    assert above.at_bound and above.albedo == pytest.approx(1.0, abs=1e-9)
    assert above.albedo_interval == pytest.approx((1.0, 1.0), abs=1e-9)
    assert above.d != pytest.approx(delta * (above.falloff + FALLOFF_OFFSET), rel=1e-4)
    assert np.isfinite(above.dmfp)


def test_default_falloff_of_engines_per_channel():
    results = [fit(falloff) for falloff in separable_to_burley.DEFAULT_FALLOFF]
    factor, delta = CONSTANTS[("radial", "difference", None)]
    phi = np.array(separable_to_burley.DEFAULT_FALLOFF) + FALLOFF_OFFSET
    albedo = factor * phi**2
    np.testing.assert_allclose([r.albedo for r in results], albedo, rtol=1e-6)
    dmfp = delta * phi * (3.5 + 100 * (albedo - 0.33) ** 4)
    np.testing.assert_allclose([r.dmfp for r in results], dmfp, rtol=1e-5)


def test_batch_and_single_fits_agree():
    falloffs = np.array([0.05, 0.37, 0.9, 1.0])
    albedo, d, dmfp, converged = fit_many(falloffs, reading="as_coded")
    single = [fit(f, reading="as_coded") for f in falloffs]
    assert converged.all()
    np.testing.assert_allclose(albedo, [s.albedo for s in single], rtol=1e-7)
    np.testing.assert_allclose(d, [s.d for s in single], rtol=1e-7)
    np.testing.assert_allclose(dmfp, [s.dmfp for s in single], rtol=1e-6)


def test_condition_grows_from_d_to_dmfp():
    result = fit(UNIT, albedo_bounds=FREE)
    # In (ln A, ln d) the problem is benign: 2.92 for either reading.
    assert result.identifiability.condition_number == pytest.approx(2.92, abs=5e-3)
    assert result.identifiability.determined.all()
    # Where s(A) is steep the dmfp inherits the albedo's error several times over.
    assert result.dmfp_interval[1] / result.dmfp > 3 * result.d_interval[1] / result.d


def test_intervals_do_not_depend_on_the_grid():
    coarse, fine = (fit(0.5, domain=Domain(0, 40, n)) for n in (96, 384))
    assert coarse.d_interval == pytest.approx(fine.d_interval, rel=1e-3)


def test_shape_alone_does_not_determine_the_albedo():
    result = fit(0.37, normalize=True)
    assert np.isnan(result.albedo) and np.isnan(result.dmfp)
    assert result.d > 0 and np.isfinite(result.d_interval).all()
    assert result.reason == "the data do not determine the albedo, so the dmfp neither"
    assert np.isinf(result.identifiability.condition_number)


def test_radial_derivative_is_refused():
    result = fit(0.37, "derivative", reading="radial")
    assert np.isnan([result.albedo, result.d, result.dmfp]).all()
    assert "drives the albedo to its lower bound" in result.reason


def test_an_albedo_above_one_has_no_dmfp():
    result = fit(1.0, reading="as_coded", albedo_bounds=FREE)
    assert result.albedo > 1 and np.isnan(result.dmfp)
    assert result.reason.startswith("the fitted albedo 1.459 is above 1")


def test_relative_residual_is_that_of_the_curves():
    result = fit(UNIT, albedo_bounds=FREE)
    variances, weights = (
        np.array([0.0484, 0.187, 0.567, 1.99, 7.41]),
        np.array([0.1, 0.118, 0.113, 0.358, 0.078]),
    )

    def radial(r):
        return r * np.sum(weights / (2 * np.pi * variances) * np.exp(-(r**2) / (2 * variances)))

    def burley(r):
        return result.albedo * (np.exp(-r / result.d) + np.exp(-r / (3 * result.d))) / (8 * np.pi * result.d)

    misfit = quad(lambda r: (burley(r) - radial(r)) ** 2, 0, 40, limit=200)[0]
    norm = quad(lambda r: radial(r) ** 2, 0, 40, limit=200)[0]
    assert result.relative_residual == pytest.approx(np.sqrt(misfit / norm), rel=1e-7)
    # The figure that others found for this reading.
    assert result.relative_residual == pytest.approx(0.3039658, abs=1e-6)


def test_a_lower_bound_of_ones_own_is_a_bound_like_the_upper_one():
    result = fit(0.37, albedo_bounds=(0.2, 1.0))
    albedo, d, dmfp, _ = fit_many(np.array([0.37]), albedo_bounds=(0.2, 1.0))
    assert result.at_bound and result.reason == ""
    assert (result.albedo, result.d, result.dmfp) == pytest.approx((albedo[0], d[0], dmfp[0]), rel=1e-6)
    assert result.albedo == pytest.approx(0.2, abs=1e-9)


def test_no_falloffs():
    with pytest.raises(ValueError, match="falloffs must be a list of at least one number"):
        fit_many(np.array([]))


def test_weights_pick_the_part_that_matters():
    domain = Domain(0.0, 20.0, 128)
    nodes, _ = domain.nodes()
    tail = fit(0.5, domain=domain, weights=nodes > 3.0)
    assert tail.d != pytest.approx(fit(0.5, domain=domain).d, rel=0.02)


def test_result_ignores_the_precision_flag():
    with jax.enable_x64(True):
        inside = fit(0.37)
    assert inside.dmfp == pytest.approx(fit(0.37).dmfp, rel=1e-12)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"falloff": 0.0}, r"falloff must be in \(0, 1\], got 0.0"),
        ({"falloff": 1.5}, r"falloff must be in \(0, 1\], got 1.5"),
        ({"falloff": float("nan")}, "falloff must be in"),
        ({"objective": "square"}, "objective must be one of difference, ratio, derivative, got 'square'"),
        ({"reading": "both"}, "reading must be one of as_coded, radial, got 'both'"),
        ({"albedo_bounds": (1.0, 0.0)}, "albedo_bounds must be 0 <= low < high"),
        ({"solver": "newton"}, "solver must be one of"),
        ({"domain": Domain(3.0, 1.0)}, "domain must have 0 <= lower < upper"),
        ({"domain": Domain(num_points=0)}, "num_points must be from 8 to 65536, got 0"),
        ({"domain": Domain(spacing="log")}, "spacing must be 'gauss' or 'uniform', got 'log'"),  # type: ignore
        ({"weights": [1.0, 2.0]}, "weights must be 64 numbers"),
        ({"weights": np.zeros(64)}, "weights must be 64 numbers"),
        ({"weights": np.full(64, np.inf)}, "weights must be 64 numbers"),
        ({"domain": Domain(200.0, 300.0)}, "domain must reach where the falloff profile is above 0"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        fit(**({"falloff": 0.5} | arguments))
