"""Fits of curves against SciPy's, planted parameters, laws of scale, and what lies at the ends."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.optimize import curve_fit, least_squares

from sssfit.fitting import measured, profile_models, responses

POINTS = 48
R = np.geomspace(0.1, 20, POINTS)
ALBEDO, D, NOISE = 0.7, 1.5, 0.03


def burley(r, albedo, d):
    return albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r)


def noisy(seed=1, r=R, albedo=ALBEDO, d=D):
    clean = burley(r, albedo, d)
    return clean * (1 + NOISE * np.random.default_rng(seed).normal(size=r.shape)), NOISE * clean


def value(fit, name):
    return fit.parameters[name].value


# --- planted parameters

PLANTED = {
    "burley": (0.7, 1.5),
    "dipole": (1.2, 0.03),
    "jimenez": (0.8, 0.6),
    "gaussians:2": (0.3, 4.0, 0.4, 0.2),
    "gaussians:4": (0.03, 0.4, 3.0, 20.0, 0.1, 0.3, 0.2, 0.1),
}
SEEN = {"radial": None, "line": None, "edge": None, "beam": 3.0}
# Each profile once; beams are fitted in tests of the command line.
CASES = [
    ("burley", "radial"),
    pytest.param("dipole", "radial", marks=pytest.mark.slow),
    pytest.param("jimenez", "line", marks=pytest.mark.slow),
    pytest.param("gaussians:2", "edge", marks=pytest.mark.slow),
    pytest.param("gaussians:4", "radial", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("model, response", CASES)
@pytest.mark.usefixtures("x64")
def test_planted_parameters_are_found_by_all_solvers(model, response):
    chosen = profile_models.named(model)
    r = np.concatenate([-R[::-4], R]) if response == "edge" else R
    seen = responses.function(response, SEEN[response])
    curve = np.asarray(seen(chosen, jnp.array(PLANTED[model]), jnp.asarray(r)))
    # A hundred-thousandth of the largest value is noise.
    found = measured.fit(
        r,
        curve,
        model=model,
        sigma=1e-5 * curve.max(),
        response=response,
        beam_radius=SEEN[response],
        solver="all",
    )
    # Of four Gaussians without noise L-BFGS-B gives up, and is named.
    ended = [solution for solution in found.solutions[0] if solution.converged]
    assert len(ended) == 3 or (model == "gaussians:4" and not found.converged and len(ended) == 2), (
        found.status
    )
    first = ended[0].parameters
    for solution in ended:
        np.testing.assert_allclose(solution.parameters, first, rtol=0, atol=1e-6)
    assert found.disagreement <= 1e-6 or model == "gaussians:4"
    for parameter, planted in zip(chosen.parameters, PLANTED[model], strict=True):
        estimate = found.parameters[parameter.name]
        # No noise was added: what is left is how well a solver finds the bottom of a misfit that is 0 there.
        assert estimate.value == pytest.approx(planted, rel=1e-5)
        assert estimate.interval_95[0] < planted < estimate.interval_95[1]


# --- against SciPy


def test_known_noise_agrees_with_curve_fit():
    values, sigma = noisy()
    expected, covariance = curve_fit(burley, R, values, p0=(0.5, 1.0), sigma=sigma, absolute_sigma=True)
    found = measured.fit(R, values, sigma=sigma)
    np.testing.assert_allclose([value(found, "albedo"), value(found, "d")], expected, rtol=1e-6)
    errors = [found.parameters[name].standard_error for name in ("albedo", "d")]
    # SciPy differentiates by finite differences.
    np.testing.assert_allclose(errors, np.sqrt(np.diag(covariance)), rtol=1e-4)
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert found.correlation[0, 1] == pytest.approx(correlation, abs=1e-4)
    chi2 = np.sum(np.square((values - burley(R, *expected)) / sigma))
    assert found.chi2_per_dof == pytest.approx(chi2 / (POINTS - 2), rel=1e-9)
    assert found.notes == ()


def test_unknown_noise_agrees_with_curve_fit_and_student():
    values, sigma = noisy()
    expected, covariance = curve_fit(burley, R, values, p0=(0.5, 1.0), sigma=values)
    found = measured.fit(R, values, weights="relative")
    np.testing.assert_allclose([value(found, "albedo"), value(found, "d")], expected, rtol=1e-6)
    np.testing.assert_allclose(
        [found.parameters[name].standard_error for name in ("albedo", "d")],
        np.sqrt(np.diag(covariance)),
        rtol=1e-4,
    )
    assert np.isnan(found.chi2_per_dof)
    low, high = found.parameters["albedo"].interval_95
    half = 2.0128955989194  # Student's, 46 degrees of freedom, from a table
    assert (high - low) / 2 == pytest.approx(half * found.parameters["albedo"].standard_error, rel=1e-9)
    # The noise is 3 % of each value; estimated of 46 degrees of freedom it is known to a tenth.
    np.testing.assert_allclose(found.sigma[:, 0] / values, NOISE, rtol=0.4)


def test_weights_of_another_kind_give_the_sandwich():
    values, sigma = noisy()
    weights = R**2
    expected = least_squares(
        lambda p: np.sqrt(weights) * (burley(R, *p) - values), (0.5, 1.0), xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    bread = np.linalg.inv(expected.jac.T @ expected.jac)
    meat = expected.jac.T @ (weights[:, None] * sigma[:, None] ** 2 * expected.jac)
    found = measured.fit(R, values, sigma=sigma, weights=weights)
    np.testing.assert_allclose([value(found, "albedo"), value(found, "d")], expected.x, rtol=1e-6)
    errors = [found.parameters[name].standard_error for name in ("albedo", "d")]
    np.testing.assert_allclose(errors, np.sqrt(np.diag(bread @ meat @ bread)), rtol=1e-4)


LOSSES = [
    ("cauchy", 2.385),
    pytest.param("huber", 1.345, marks=pytest.mark.slow),
    pytest.param("soft_l1", 1.345, marks=pytest.mark.slow),
]


@pytest.mark.parametrize("loss, scale", LOSSES)
def test_robust_losses_agree_with_scipy(loss, scale):
    values, sigma = noisy()
    values[[5, 20, 33]] *= (1.6, 0.5, 2.0)
    expected = least_squares(
        lambda p: (burley(R, *p) - values) / sigma,
        (0.5, 1.0),
        loss=loss,
        f_scale=scale,
        xtol=1e-15,
        ftol=1e-15,
    )
    found = measured.fit(R, values, sigma=sigma, loss=loss)
    np.testing.assert_allclose([value(found, "albedo"), value(found, "d")], expected.x, rtol=1e-6)


def test_outliers_hardly_move_a_robust_fit_of_unknown_noise():
    values, _ = noisy()
    spoiled = values.copy()
    spoiled[[36, 40, 44]] *= 2
    clean, plain = (measured.fit(R, curve, weights=values**-2.0) for curve in (values, spoiled))
    robust = measured.fit(R, spoiled, weights=values**-2.0, loss="cauchy")
    error = clean.parameters["d"].standard_error
    assert abs(value(plain, "d") - value(clean, "d")) > 2 * error
    assert abs(value(robust, "d") - value(clean, "d")) < error
    assert robust.parameters["d"].standard_error < 2 * error


def test_a_shared_shape_is_scipys_joint_fit():
    curves, sigmas = zip(*(noisy(seed, albedo=a) for seed, a in ((1, 0.7), (2, 0.5), (3, 0.3))), strict=True)

    def left(p):
        return np.concatenate(
            [(burley(R, a, p[3]) - c) / s for a, c, s in zip(p[:3], curves, sigmas, strict=True)]
        )

    expected = least_squares(
        left,
        (0.5, 0.5, 0.5, 1.0), xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    found = measured.fit(R, np.transpose(curves), sigma=np.transpose(sigmas), shared=["d"])
    names = ("albedo_r", "albedo_g", "albedo_b", "d")
    assert set(found.names) == set(names)
    np.testing.assert_allclose([value(found, name) for name in names], expected.x, rtol=1e-6)
    errors = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))
    np.testing.assert_allclose([found.parameters[n].standard_error for n in names], errors, rtol=1e-4)
    assert {"dmfp_r", "dmfp_g", "dmfp_b"} == set(found.derived)


def test_channels_that_share_nothing_are_fitted_apart():
    (first, a), (second, b) = noisy(1), noisy(2, albedo=0.4)
    both = measured.fit(R, np.stack([first, second], 1), sigma=np.stack([a, b], 1), channels=("x", "y"))
    alone = measured.fit(R, second, sigma=b)
    assert both.parameters["d_y"] == alone.parameters["d"]
    assert both.correlation[0, 2] == both.correlation[1, 3] == 0


# --- laws


@given(stretch=st.floats(-6, 6).map(lambda e: 10.0**e), factor=st.floats(-30, 30).map(lambda e: 10.0**e))
@settings(max_examples=12)
def test_units_of_distance_and_of_light(stretch, factor):
    values, sigma = noisy()
    plain = measured.fit(R, values, sigma=sigma)
    other = measured.fit(stretch * R, factor * values, sigma=factor * sigma)
    energy = factor * stretch**2
    assert value(other, "d") == pytest.approx(stretch * value(plain, "d"), rel=1e-7)
    assert value(other, "albedo") == pytest.approx(energy * value(plain, "albedo"), rel=1e-7)
    for name, unit in (("d", stretch), ("albedo", energy)):
        error = plain.parameters[name].standard_error
        assert other.parameters[name].standard_error == pytest.approx(unit * error, rel=1e-5)
    assert other.chi2_per_dof == pytest.approx(plain.chi2_per_dof, rel=1e-7)


# --- what is said of data


def test_a_point_at_0_is_left_out_of_burleys_profile_alone():
    values, sigma = noisy()
    r, values, sigma = (
        np.insert(a, 0, first) for a, first in ((R[1:], 0.0), (values[1:], 9.0), (sigma[1:], 1.0))
    )
    found = measured.fit(r, values, sigma=sigma)
    assert len(found.r) == POINTS - 1
    assert found.notes == ("the point at r = 0 is left out: Burley's profile is infinite there",)
    assert value(found, "d") == pytest.approx(D, rel=0.05)


def test_a_model_that_does_not_fit_is_said_so_and_its_intervals_are_wider():
    values = np.exp(-np.square(R) / 8) / (8 * np.pi)
    found = measured.fit(R, values, sigma=1e-4)
    assert found.notes[0].startswith("the model does not fit within the noise (chi2 per degree of freedom is")
    assert found.chi2_per_dof > 10


def test_what_the_near_field_does_not_tell():
    near = np.geomspace(0.002, 0.01, POINTS)
    values, sigma = noisy(r=near)
    found = measured.fit(near, values, sigma=sigma)
    assert not found.parameters["d"].determined and not found.parameters["albedo"].determined
    assert found.parameters["d"].interval_95[1] == np.inf
    assert 0 < found.parameters["d"].interval_95[0] < D
    assert any("raised together" in note and "d" in note and "albedo" in note for note in found.notes)
    # The height near 0, albedo / d, is what such data do tell.
    assert value(found, "albedo") / value(found, "d") == pytest.approx(ALBEDO / D, rel=0.1)


@pytest.mark.parametrize("seed", [1, 4, 5])
def test_what_follows_from_undetermined_parameters_is_not_determined(seed):
    r = np.geomspace(1e-3, 1e-2, POINTS)
    clean = burley(r, 0.7, 1.0)
    values = clean * (1 + 0.05 * np.random.default_rng(seed).normal(size=POINTS))
    found = measured.fit(r, values, sigma=0.05 * clean).parameters
    assert not any(found[name].determined for name in ("albedo", "d", "dmfp"))
    # True is 5.374 mm, far from the best guess for two of the seeds.
    assert found["dmfp"].interval_95 == (0, np.inf)


def test_what_goes_along_with_a_length_on_its_bound_is_not_determined():
    found = measured.fit(np.linspace(1, 4, POINTS), np.linspace(4, 1, POINTS))
    assert value(found, "d") == pytest.approx(4000) and "d lies on its bound, 4000" in found.notes
    albedo = found.parameters["albedo"]
    assert not albedo.determined and albedo.interval_68[1] == albedo.interval_95[1] == np.inf
    # With the shape at its lower end, too: the near field tells their ratio alone.
    assert albedo.interval_95[0] / found.parameters["d"].interval_95[0] < 2 * albedo.value / 4000


def test_weights_that_are_not_the_noises_have_intervals_of_their_own_estimate():
    clean = burley(R, 0.7, 1.0)
    values = clean * (1 + 0.3 * np.random.default_rng(0).normal(size=POINTS))
    found = measured.fit(R, values, sigma=0.3 * clean, weights="area")
    d = found.parameters["d"]
    # The root mean square of the noise in the likelihood's optimum is smaller than in this one.
    assert found.notes == ()
    low, high = np.log(np.array(d.interval_95) / d.value)
    assert low == pytest.approx(-high) and high == pytest.approx(1.959964 * d.standard_error / d.value)


def test_weights_that_are_not_the_noises_make_no_misfit():
    clean, found = burley(R, 0.7, 1.0), []
    for seed in range(60):
        values = clean * (1 + 0.3 * np.random.default_rng(seed).normal(size=POINTS))
        found.append(measured.fit(R, values, sigma=0.3 * clean, weights="area"))
    # Each of the two signs of a misfit has a chance of 1 in 1000: of three among sixty it is below 1 in 4000.
    assert sum("does not fit" in note for fit in found for note in fit.notes) < 3
    # By chi2 alone, which is not what was minimized, many would have been called misfits.
    assert np.sum(stats.chi2.sf([fit.chi2 for fit in found], POINTS - 2) < 1e-3) >= 6


def test_a_misfit_is_seen_under_any_weights():
    # Twice the light near the source, at ten times the noise.
    values = burley(R, 0.7, 1.0) * (1 + np.exp(-3 * R))
    found = measured.fit(R, values, sigma=0.03 * values, weights="area")
    assert any("does not fit" in note for note in found.notes)


def test_intervals_of_the_likelihood_end_where_it_has_fallen():
    near = np.geomspace(0.1, 1.2, POINTS)
    values, sigma = noisy(r=near)
    sigma = 6 * sigma
    found = measured.fit(near, values, sigma=sigma)
    assert found.parameters["d"].standard_error > 0.2 * value(found, "d")

    def chi2(d):
        shape = burley(near, 1.0, d) / sigma
        albedo = shape @ (values / sigma) / (shape @ shape)
        return np.sum(np.square(albedo * shape - values / sigma))

    least = found.chi2
    for end in found.parameters["d"].interval_68:
        # The ends are found to a ten-thousandth of their distance.
        assert chi2(end) - least == pytest.approx(0.9944578832097531**2, rel=1e-2)


@pytest.mark.slow
def test_a_gaussian_too_many_lies_on_its_bound_or_is_not_determined():
    values = 0.4 * np.exp(-np.square(R) / 2) / (2 * np.pi)
    sigma = 1e-3 * np.ones(POINTS)
    found = measured.fit(R, values, model="gaussians:2", sigma=sigma)
    assert value(found, "albedo") == pytest.approx(0.4, rel=0.02)
    assert not all(found.parameters[name].determined for name in found.names)
    assert found.notes


# --- the ends


@pytest.mark.parametrize("d", [1e-6, 1e6])
def test_shapes_of_any_size(d):
    r = np.geomspace(0.1, 20, POINTS) * d
    values, sigma = noisy(r=r, d=d)
    assert value(measured.fit(r, values, sigma=sigma), "d") == pytest.approx(d, rel=0.02)


def test_float32_is_fitted_in_float64():
    values, sigma = noisy()
    wide, narrow = (
        measured.fit(*(a.astype(t) for a in (R, values)), sigma=sigma.astype(t)) for t in (float, "f4")
    )
    assert value(narrow, "d") == pytest.approx(value(wide, "d"), rel=1e-5)


def test_as_many_points_as_parameters():
    r = np.array([0.5, 2.0])
    found = measured.fit(r, burley(r, 0.5, 1.0), sigma=1e-4)
    assert (value(found, "albedo"), value(found, "d")) == pytest.approx((0.5, 1.0), rel=1e-6)
    assert found.dof == 0 and np.isnan(found.chi2_per_dof) and np.isnan(found.aicc)


def test_noise_of_very_different_sizes():
    values, sigma = noisy()
    sigma = sigma * np.where(np.arange(POINTS) % 2, 1e8, 1.0)
    found = measured.fit(R, values, sigma=sigma)
    assert found.converged
    assert abs(np.log(value(found, "d") / D)) < 5 * found.parameters["d"].standard_error / D


def test_an_albedo_above_1_has_no_mean_free_path():
    values, sigma = noisy(albedo=1.4)
    found = measured.fit(R, values, sigma=sigma)
    assert value(found, "albedo") == pytest.approx(1.4, rel=0.05)
    assert np.isnan(value(found, "dmfp")) and not found.parameters["dmfp"].determined
