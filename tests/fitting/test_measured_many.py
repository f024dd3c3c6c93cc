"""Many curves at once: what a single fit says of each, and intervals that hold the truth as stated."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from sssfit.fitting import intervals, measured, measured_many, profile_models, responses
from sssfit.profiles.burley import shape_from_dmfp

POINTS = 48
R = np.geomspace(0.05, 25, POINTS)
# Two batches of the same size; the other tests have four rows each, and share compiled code.
NUMBER = 1024


SHAPES = [0.1, 0.7, 4.0, 0.3]


def burley(r, albedo, d):
    return albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r)


def noisy(number, seed, noise, albedo, d):
    clean = burley(R, *(np.broadcast_to(a, number)[:, None] for a in (albedo, d)))
    sigma = np.broadcast_to(noise, number)[:, None] * clean
    return clean + sigma * np.random.default_rng(seed).normal(size=clean.shape), sigma


# --- one by one


@pytest.mark.parametrize(
    "model, response",
    [
        ("burley", "radial"),
        pytest.param("gaussians:2", "radial", marks=pytest.mark.slow),
    ],
)
def test_rows_are_single_fits(model, response, x64):
    planted = {"gaussians:2": (0.2, 5.0, 0.3, 0.2), "dipole": (1.1, 0.05), "jimenez": (0.8, 0.6)}
    chosen, seen = profile_models.named(model), responses.function(response)
    clean = np.asarray(seen(chosen, jnp.array(planted.get(model, (0.6, 1.2))), jnp.array(R)))
    sigma = 0.02 * clean + 1e-6 * clean.max()
    values = clean + sigma * np.random.default_rng(3).normal(size=(4, POINTS))
    many = measured_many.fit(R, values, sigma=sigma, model=model, response=response)
    assert many.converged.all()
    for row, curve in enumerate(values):
        single = measured.fit(R, curve, sigma=sigma, model=model, response=response)
        # The search for this many follows one start: here it leads to the same minimum.
        expected = [single.parameters[name].value for name in single.names]
        np.testing.assert_allclose(many.parameters[row], expected, rtol=1e-6)
        errors = np.sqrt(np.diag(single.covariance))
        np.testing.assert_allclose(many.errors[row], errors, rtol=1e-5)
        np.testing.assert_allclose(many.correlation[row], single.correlation, atol=1e-5)
        assert many.chi2[row] == pytest.approx(single.chi2, rel=1e-8)


@pytest.mark.parametrize(
    "response, beam_radius", [("edge", None), pytest.param("beam", 2.0, marks=pytest.mark.slow)]
)
def test_light_that_does_not_scatter(response, beam_radius, x64):
    # What Jimenez' strength leaves unscattered is no part of what grows with it.
    model, seen = profile_models.named("jimenez"), responses.function(response, beam_radius)
    x = np.linspace(-4.0 if response == "edge" else 0.1, 4.0, POINTS)
    planted = np.array([[0.6, 0.5], [1.1, 0.9], [0.3, 0.2], [0.8, 0.7]])
    curves = np.stack([np.asarray(seen(model, jnp.asarray(p), jnp.asarray(x))) for p in planted])
    given = {"sigma": 1e-3, "model": "jimenez", "response": response, "beam_radius": beam_radius}
    many = measured_many.fit(x, curves, **given)
    assert many.converged.all()
    np.testing.assert_allclose(many.parameters, planted, rtol=1e-7)
    if response == "beam":
        single = measured.fit(x, curves[0], **given)
        np.testing.assert_allclose(many.errors[0], np.sqrt(np.diag(single.covariance)), rtol=1e-5)


def test_rows_are_scipys():
    values, sigma = noisy(4, 5, [0.01, 0.03, 0.1, 0.1], [0.2, 0.5, 0.9, 0.4], SHAPES)
    many = measured_many.fit(R, values, sigma=sigma)
    for row in range(4):
        expected = least_squares(
            lambda p, row=row: (burley(R, *p) - values[row]) / sigma[row],
            (0.5, SHAPES[row]),
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        np.testing.assert_allclose(many.parameters[row], expected.x, rtol=1e-6)
        errors = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac))) / (1, expected.x[1])
        np.testing.assert_allclose(many.errors[row], errors, rtol=1e-4)
        assert many.chi2[row] == pytest.approx(2 * expected.cost, rel=1e-8)


def test_rows_do_not_know_each_other():
    values, sigma = noisy(4, 5, 0.03, 0.5, SHAPES)
    many = measured_many.fit(R, values, sigma=sigma)
    other = measured_many.fit(R, values[::-1], sigma=sigma[::-1])
    np.testing.assert_allclose(other.parameters[::-1], many.parameters, rtol=1e-12)


@pytest.mark.parametrize("d", [1e-6, 1e6])
def test_shapes_of_any_size(d):
    # The same values in units in which the shape is d: a profile is per area.
    values, sigma = noisy(4, 7, 0.02, [0.3, 0.6, 0.9, 1.5], 1.0)
    plain = measured_many.fit(R, values, sigma=sigma)
    other = measured_many.fit(d * R, values / d**2, sigma=sigma / d**2)
    np.testing.assert_allclose(other.parameters, plain.parameters * (1, d), rtol=1e-8)
    np.testing.assert_allclose(other.errors, plain.errors, rtol=1e-6)


def test_what_the_data_do_not_tell_has_large_errors():
    near = np.geomspace(1e-3, 0.02, POINTS)
    values = burley(near, 0.5, np.ones((4, 1)))
    many = measured_many.fit(near, values, sigma=0.1 * values)
    assert np.all(many.errors[:, 1] > 1)
    assert np.all(np.abs(many.correlation[:, 0, 1]) > 0.99)


# --- many times


@pytest.fixture(scope="module")
def study():
    """Random media and noise, and what was fitted to them."""
    rng = np.random.default_rng(11)
    albedo = rng.uniform(0.1, 0.9, NUMBER)
    dmfp = 8 ** rng.uniform(0, 1, NUMBER)
    noise = 0.005 * 20 ** rng.uniform(0, 1, NUMBER)
    d = np.asarray(shape_from_dmfp(dmfp, albedo))
    values, sigma = noisy(NUMBER, 12, noise, albedo, d)
    return np.stack([albedo, d], axis=1), measured_many.fit(R, values, sigma=sigma)


@pytest.mark.parametrize("level", intervals.LEVELS)
def test_intervals_hold_the_truth_as_often_as_they_say(study, level):
    truth, many = study
    assert many.converged.all()
    low, high = measured_many.interval(many, level)
    held = np.mean((low < truth) & (truth < high), axis=0)
    # The share that holds has a binomial standard error of 1.5 and .7 %.
    np.testing.assert_allclose(held, level, atol=4 * np.sqrt(level * (1 - level) / NUMBER))


def test_chi2_is_that_of_the_noise(study):
    dof = POINTS - 2
    mean = np.mean(study[1].chi2)
    assert mean == pytest.approx(dof, abs=4 * np.sqrt(2 * dof / NUMBER))
    spread = np.var(study[1].chi2) / (2 * dof)
    # The variance of a variance of nearly normal numbers, with chi2's excess of 12 / dof.
    assert spread == pytest.approx(1, abs=4 * np.sqrt((2 + 12 / dof) / NUMBER))


def test_errors_are_correlated_as_stated(study):
    truth, many = study
    pulls = np.stack([many.parameters[:, 0] - truth[:, 0], np.log(many.parameters[:, 1] / truth[:, 1])], 1)
    pulls /= many.errors
    product = pulls[:, 0] * pulls[:, 1] - many.correlation[:, 0, 1]
    # Of a product of two normal numbers of correlation c the variance is 1 + c^2.
    error = np.sqrt(np.mean(1 + many.correlation[:, 0, 1] ** 2) / NUMBER)
    assert abs(np.mean(product)) < 4 * error
    # A correlation of the wrong sign would not have passed.
    assert np.mean(many.correlation[:, 0, 1]) < -4 * error


# --- intervals, refusals


def test_intervals_are_those_of_single_fits():
    values, sigma = noisy(4, 5, 0.03, 0.5, [0.3, 0.7, 1.5, 1.0])
    low, high = measured_many.interval(measured_many.fit(R, values, sigma=sigma), 0.95)
    for row in range(4):
        single = measured.fit(R, values[row], sigma=sigma[row])
        assert single.notes == ()
        expected = [single.parameters[name].interval_95 for name in ("albedo", "d")]
        np.testing.assert_allclose(np.stack([low[row], high[row]], axis=1), expected, rtol=1e-5)


def test_shares_end_at_0_and_lengths_at_infinity():
    many = measured_many.Many(
        np.full((1, 2), 0.5), np.array([[0.5, 1e4]]), np.eye(2)[None], np.ones(1), np.ones(1, bool),
        np.array([True, False]),
    )  # fmt: skip
    low, high = measured_many.interval(many, 0.95)
    np.testing.assert_allclose(low, [[0.0, 0.0]])
    np.testing.assert_allclose(high, [[0.5 + 0.5 * 1.959963984540054, np.inf]])


@pytest.mark.parametrize("level", [0, 1, 1.5, np.nan])
def test_levels_that_are_no_chances(level):
    many = measured_many.Many(*[np.ones((1, 2))] * 6)
    with pytest.raises(ValueError, match=f"level must be between 0 and 1, got {level}"):
        measured_many.interval(many, level)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"values": np.ones(POINTS)}, r"values must be of shape \(number, m\), got \(48,\)"),
        ({"values": np.ones((0, POINTS))}, r"got \(0, 48\)"),
        ({"values": np.ones((2, 3))}, "r and values must be of shapes"),
        ({"values": np.zeros((2, POINTS))}, "a whole curve is 0 or negative"),
        ({"values": np.full((2, POINTS), np.nan)}, "values must be finite"),
        ({"sigma": 0.0}, "sigma must be above 0, but it is 0"),
        ({"sigma": np.inf}, "sigma must be finite"),
        ({"r": -R}, "r must ascend"),
        ({"model": "lambert"}, "model must be one of"),
        ({"response": "beam"}, "beam_radius must be a length in mm above 0 for a beam, got None"),
        ({"r": R[:1], "values": np.ones((2, 1))}, "at least 2 points for the parameters of burley, got 1"),
        ({"cutoff": -1.0}, "cutoff must be above 0, got -1.0"),
        ({"eta": 9.0}, "eta must be from"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        measured_many.fit(**({"r": R, "values": np.ones((2, POINTS)), "sigma": 1.0} | arguments))


def test_sigma_of_another_shape_is_refused_in_words():
    with pytest.raises(
        ValueError, match=r"sigma must be a number or of the shape of values \(2, 48\), got \(3,\)"
    ):
        measured_many.fit(R, np.ones((2, POINTS)), sigma=np.ones(3))
