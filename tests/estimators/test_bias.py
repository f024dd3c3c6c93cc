"""Biases and moments against enumeration of every outcome, explicit weights, and many runs."""

import itertools
import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.estimators import bias, sample_count
from sssfit.estimators.sample_count import Controller

pilot_bias = jax.jit(bias.pilot_bias)
emv_moments = jax.jit(bias.emv_moments)

# Values and their probabilities.
TWO = np.array([0.0, 1.0]), np.array([0.9, 0.1])
THREE = np.array([0.0, 1.0, 4.0]), np.array([0.5, 0.3, 0.2])
FOUR = np.array([-2.0, 0.5, 3.0, 7.0]), np.array([0.1, 0.2, 0.3, 0.4])


# The pilot's bias


@pytest.mark.parametrize(
    "distribution, pilot, expected",
    [
        (TWO, 1, 0.0),
        (TWO, 2, -0.072),
        (TWO, 4, -0.06552),
        (TWO, 8, -0.043046712),
        (THREE, 2, -0.168),
        (THREE, 4, -0.06492),
        (THREE, 8, -0.004296012),
    ],
)
def test_pilot_biases_in_exact_decimals(dtype, distribution, pilot, expected):
    values, probabilities = (part.astype(dtype) for part in distribution)
    found = bias.pilot_bias(values, probabilities, pilot)
    assert found.dtype == dtype
    # A power's error is that of its base times its exponent, relative to terms below 1.
    assert float(found) == pytest.approx(expected, abs=2 * (1 + pilot) * float(np.finfo(dtype).eps))


def as_fractions(distribution):
    return [[Fraction(str(v)) for v in part] for part in distribution]


def enumerated(values, probabilities, pilot):
    """The scheme's bias over all k^n sequences of pilot samples."""
    truth = sum(p * v for p, v in zip(probabilities, values, strict=True))
    total = Fraction(0)
    for outcome in itertools.product(range(len(values)), repeat=pilot):
        chance = math.prod(probabilities[i] for i in outcome)
        # All alike: their mean is believed. Otherwise the truth is found.
        total += chance * (values[outcome[0]] if len(set(outcome)) == 1 else truth)
    return total - truth


@pytest.mark.parametrize("distribution", [TWO, THREE, FOUR])
@pytest.mark.parametrize("pilot", [1, 2, 3, 6])
def test_pilot_bias_is_that_of_all_sequences(x64, distribution, pilot):
    values, probabilities = distribution
    exact_values, exact_probabilities = as_fractions(distribution)
    expected = float(enumerated(exact_values, exact_probabilities, pilot))
    found = float(bias.pilot_bias(values, probabilities, pilot))
    assert found == pytest.approx(expected, rel=1e-13, abs=1e-15)


@pytest.mark.parametrize("pilot", [2, 5])
def test_pilot_bias_of_many_runs(x64, pilot):
    runs = 1_000_000
    values, probabilities = THREE
    drawn = np.random.default_rng(1).choice(values, (runs, pilot), p=probabilities)
    alike = np.all(drawn == drawn[:, :1], axis=1)
    results = np.where(alike, drawn[:, 0], values @ probabilities)
    error = results.std(ddof=1) / np.sqrt(runs)
    found = float(bias.pilot_bias(values, probabilities, pilot))
    assert abs(results.mean() - values @ probabilities - found) < 4 * error
    assert abs(found) > 10 * error


@pytest.mark.parametrize("distribution", [TWO, THREE])
@pytest.mark.parametrize("pilot", [2, 4])
def test_probabilities_of_tuples_need_their_exponents(x64, distribution, pilot):
    # n! / prod n_i! prod p_i^n_i sums to 1. Without the exponents, as Eq 2.31 is printed, it does not.
    values, probabilities = as_fractions(distribution)
    truth = sum(p * v for p, v in zip(probabilities, values, strict=True))
    total = printed = of_bias = Fraction(0)
    for counts in itertools.product(range(pilot + 1), repeat=len(values)):
        if sum(counts) != pilot:
            continue
        ways = Fraction(math.factorial(pilot), math.prod(math.factorial(n) for n in counts))
        chance = ways * math.prod(p**n for p, n in zip(probabilities, counts, strict=True))
        total += chance
        printed += ways * math.prod(probabilities)
        if pilot in counts:
            of_bias += chance * (values[counts.index(pilot)] - truth)
    assert total == 1
    assert printed == len(values) ** pilot * math.prod(probabilities) and printed != 1
    found = float(bias.pilot_bias(distribution[0], distribution[1], pilot))
    assert found == pytest.approx(float(of_bias), rel=1e-13)


def test_the_bias_rises_before_it_falls(x64):
    found = np.asarray(bias.pilot_bias(np.array([TWO[0]] * 6), np.array([TWO[1]] * 6), np.arange(1, 7)))
    assert abs(found[0]) < 1e-16
    assert abs(found[1]) > abs(found[0])
    # -0.072 for two and for three, then less.
    assert found[2] == pytest.approx(found[1], rel=1e-15)
    assert np.all(np.diff(np.abs(found[2:])) < 0)


def test_pilots_of_any_number_and_shape(dtype):
    values = np.broadcast_to(THREE[0].astype(dtype), (4, 3))
    probabilities = np.array([[0.5, 0.3, 0.2], [1, 0, 0], [0, 0.5, 0.5], [1 / 3] * 3], dtype)
    # Far more than any power can hold.
    for pilot in (10_000, 2**30):
        np.testing.assert_array_equal(pilot_bias(values, probabilities, pilot), 0)
    pilots = np.array([1, 5, 2, 3])
    found = pilot_bias(values, probabilities, pilots)
    assert found.shape == (4,) and found.dtype == dtype
    singles = [pilot_bias(v, p, n) for v, p, n in zip(values, probabilities, pilots, strict=True)]
    np.testing.assert_allclose(found, singles, rtol=0, atol=4 * np.finfo(dtype).eps)
    # One sample, or one value, is never wrong.
    np.testing.assert_allclose(found[:2], 0, rtol=0, atol=4 * np.finfo(dtype).eps)


def test_the_slope_of_the_pilot_bias(dtype):
    values, probabilities = (part.astype(dtype) for part in THREE)
    in_values, in_probabilities = jax.jit(jax.grad(bias.pilot_bias, (0, 1)))(values, probabilities, 3)
    # sum p^3 (v - m) with m = sum p v, by hand.
    v, p = THREE
    mean, low = v @ p, np.sum(p**3)
    error = 40 * float(np.finfo(dtype).eps)
    np.testing.assert_allclose(in_values, p**3 - low * p, rtol=0, atol=error)
    np.testing.assert_allclose(in_probabilities, 3 * p**2 * (v - mean) - low * v, rtol=0, atol=error)
    # A value that never comes has the slope of its own term alone, and no NaN.
    _, slope = jax.jit(jax.grad(bias.pilot_bias, (0, 1)))(values, np.array([0, 0.6, 0.4], dtype), 3)
    assert np.all(np.isfinite(slope))


@pytest.mark.parametrize(
    "values, probabilities, message",
    [
        ([0.0, 1.0], [1.0], r"must have one shape with a last axis, got \(2,\) and \(1,\)"),
        (0.0, 1.0, r"must have one shape with a last axis, got \(\) and \(\)"),
        ([0.0, 1.0], [0.5, 0.6], r"probabilities must be >= 0 and sum to 1, got \[0.5, 0.6\]"),
        ([0.0, 1.0], [1.5, -0.5], r"probabilities must be >= 0 and sum to 1, got \[1.5, -0.5\]"),
        (np.zeros((2, 2)), np.array([[0.5, 0.5], [0.5, 0.6]]), "probabilities must be >= 0 and sum to 1"),
    ],
)
def test_distributions_that_are_none_are_refused(values, probabilities, message):
    with pytest.raises(ValueError, match=message):
        bias.pilot_bias(values, probabilities, 2)
    with pytest.raises(ValueError, match=message):
        bias.controller_bias(values, probabilities, Controller(0.05, min_spp=1, max_spp=2), 2)


# The controller's bias


def next_samples(mean_count, variance, controller):
    """Eq 8-10 of the 2021 paper, clamped, halves to the even number."""
    ratio = variance / controller.target_variance
    correction = controller.kappa * (2 / controller.alpha - 2) * (ratio - 1)
    count = mean_count * (ratio + correction)
    return round(min(max(count, controller.min_spp), controller.max_spp))


def follow(values, probabilities, controller, frames):
    """Expectations over every sequence of single samples, one branch after the other."""
    truth = sum(p * v for p, v in zip(probabilities, values, strict=True))
    rows = np.zeros((5, frames))

    def branch(frame, chance, count, history, total, drawn):
        if frame == frames:
            return
        for outcome in itertools.product(range(len(values)), repeat=count):
            probability = chance * math.prod(probabilities[i] for i in outcome)
            samples = [values[i] for i in outcome]
            mean = sum(samples) / count
            if frame == 0:
                after = (count, mean, controller.target_variance)
            else:
                before, moving, variance = history
                alpha = controller.alpha
                after = (
                    before + alpha * (count - before),
                    moving + alpha * (mean - moving),
                    (1 - alpha) * (variance + alpha * (mean - moving) ** 2),
                )
            sums = total + sum(samples), drawn + count
            pooled = sums[0] / sums[1]
            errors = (mean - truth, after[1] - truth, pooled - truth, count, (mean - truth) ** 2)
            rows[:, frame] += probability * np.array(errors)
            branch(frame + 1, probability, next_samples(after[0], after[2], controller), after, *sums)

    branch(0, 1.0, round(controller.min_spp), None, 0.0, 0)
    return bias.ControllerBias(*rows)


@pytest.mark.parametrize(
    "distribution, controller, frames",
    [
        (TWO, Controller(0.05, min_spp=1, max_spp=3), 4),
        ((TWO[0], np.array([0.7, 0.3])), Controller(0.03, alpha=0.5, kappa=1.0, min_spp=2, max_spp=4), 3),
        (
            (np.array([1.0, -0.5]), np.array([0.25, 0.75])),
            Controller(0.2, alpha=0.3, kappa=0.0, min_spp=2, max_spp=5),
            3,
        ),
        (THREE, Controller(1.0, alpha=0.4, kappa=0.5, min_spp=1, max_spp=3), 3),
    ],
)
def test_controller_bias_is_that_of_all_sequences(distribution, controller, frames):
    values, probabilities = distribution
    found = bias.controller_bias(values, probabilities, controller, frames)
    expected = follow(values, probabilities, controller, frames)
    for name in bias.ControllerBias._fields:
        part = getattr(found, name)
        assert part.shape == (frames,) and part.dtype == np.float64
        np.testing.assert_allclose(part, getattr(expected, name), rtol=1e-11, atol=1e-13, err_msg=name)
    # The frame and the moving mean are without bias, the mean over all samples is not.
    assert np.abs(found.frame).max() < 1e-12
    assert np.abs(found.moving_mean).max() < 1e-12
    assert np.abs(found.pooled_mean[:2]).max() < 1e-12
    assert np.abs(found.pooled_mean[2:]).min() > 1e-4
    assert found.count[-1] > controller.min_spp


def test_controller_bias_of_many_pixels(x64):
    pixels, frames = 1_000_000, 4
    controller = Controller(0.05, alpha=0.3, kappa=0.2, min_spp=2, max_spp=4)
    expected = bias.controller_bias(TWO[0], TWO[1], controller, frames)

    @jax.jit
    def simulate(key):
        history = sample_count.init(jnp.zeros(pixels))
        total = drawn = jnp.zeros(pixels)
        rows = []
        for frame in range(frames):
            count = sample_count.next_count(history, controller)
            key, own = jax.random.split(key)
            hits = jax.random.uniform(own, (4, pixels), jnp.float64) < 0.1
            total_now = jnp.sum(hits & (jnp.arange(4)[:, None] < count), axis=0)
            mean = total_now / count
            history = sample_count.update(history, mean, count, controller, missing=frame == 0)
            total, drawn = total + total_now, drawn + count
            rows.append((mean - 0.1, history.mean - 0.1, total / drawn - 0.1, count, (mean - 0.1) ** 2))
        moments = [[(jnp.mean(part), jnp.std(part)) for part in row] for row in rows]
        return jnp.asarray(moments, jnp.float64)

    # Frame, quantity, mean and deviation.
    found = np.asarray(simulate(jax.random.key(3)))
    errors = found[..., 1] / np.sqrt(pixels)
    # The first two counts are the same for all pixels.
    assert np.all(np.abs(found[..., 0] - np.array(expected).T) <= 4 * errors + 1e-12)
    assert np.all(np.abs(expected.pooled_mean[2:]) > 8 * errors[2:, 2])


def test_a_fixed_count_has_no_bias_at_all():
    controller = Controller(0.05, min_spp=3, max_spp=3)
    found = bias.controller_bias(THREE[0], THREE[1], controller, 2)
    np.testing.assert_allclose(found.count, 3, rtol=1e-14)
    for part in (found.frame, found.moving_mean, found.pooled_mean):
        assert np.abs(part).max() < 1e-12
    # Population variance over the count: 0.3 + 16 * 0.2 - 1.1^2 = 2.29.
    np.testing.assert_allclose(found.frame_variance, 2.29 / 3, rtol=1e-12)


def test_a_single_value_leaves_one_branch():
    found = bias.controller_bias(np.array([0.7]), np.ones(1), Controller(0.05, min_spp=2, max_spp=64), 4)
    for part in (found.frame, found.moving_mean, found.pooled_mean, found.frame_variance):
        np.testing.assert_allclose(part, 0, atol=1e-15)
    # No variance comes, and that of the start fades.
    np.testing.assert_array_equal(found.count, 2)


def test_more_branches_than_fit_are_refused():
    # 52 samples of three values have 54 * 53 / 2 = 1431 outcomes, and 1431^2 is above 2 million.
    with pytest.raises(ValueError, match="2047761 branches exceed 2000000; use fewer frames or values, or"):
        bias.controller_bias(THREE[0], THREE[1], Controller(0.05, min_spp=52, max_spp=52), 2)


def test_a_controller_that_draws_nothing_is_refused():
    # Without samples there is no mean to be biased.
    with pytest.raises(ValueError, match="min_spp"):
        bias.controller_bias(TWO[0], TWO[1], Controller(0.05, min_spp=0, max_spp=3), 2)


# Moments of the moving variance


def exact_moments(alpha, num_samples, kurtosis):
    """By explicit weights in extended precision: Var sum_ij A_ij x_i x_j with A = diag(w) - w w'."""
    alpha = np.longdouble(alpha)
    weights = alpha * (1 - alpha) ** np.arange(num_samples, dtype=np.longdouble)
    weights[-1] = (1 - alpha) ** np.longdouble(num_samples - 1)
    rest = np.array([weights[:i].sum() + weights[i + 1 :].sum() for i in range(num_samples)])
    diagonal = weights * rest
    complement = diagonal.sum()
    squares = weights**2
    # Every pair of samples, all of them positive.
    off_diagonal = 2 * np.sum(squares[1:] * np.cumsum(squares)[:-1])
    variance = (np.longdouble(kurtosis) - 1) * (diagonal**2).sum() + 2 * off_diagonal
    return complement, np.sqrt(variance) / complement


@pytest.mark.parametrize("kurtosis", [1.0, 1.8, 3.0, 9.0])
@pytest.mark.parametrize("num_samples", [2, 3, 10, 200])
@pytest.mark.parametrize("alpha", [0.01, 0.05, 0.2, 0.5, 0.9])
def test_moments_by_explicit_weights(x64, alpha, num_samples, kurtosis):
    found = emv_moments(alpha, num_samples, kurtosis)
    mean, deviation = (float(v) for v in exact_moments(alpha, num_samples, kurtosis))
    assert float(found.mean) == pytest.approx(mean, rel=1e-13)
    # Sums of powers from 1 down to the squared weights of 0.01.
    assert float(found.deviation) == pytest.approx(deviation, rel=1e-9)


@pytest.mark.parametrize("num_samples", [2, 3, 10, 1000])
def test_moments_of_a_tiny_weight_and_few_samples(dtype, num_samples):
    alpha = dtype.type(1e-6)
    found = emv_moments(alpha, num_samples, dtype.type(3))
    mean, deviation = (float(v) for v in exact_moments(alpha, num_samples, 3))
    error = 20 * float(np.finfo(dtype).eps)
    assert float(found.mean) == pytest.approx(mean, rel=error)
    assert float(found.deviation) == pytest.approx(deviation, rel=error)


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.7])
@pytest.mark.parametrize("kurtosis", [1.0, 3.0, 5.0])
def test_a_long_past_is_the_limit(x64, alpha, kurtosis):
    long = exact_moments(alpha, 1200, kurtosis)
    found = emv_moments(alpha, jnp.inf, kurtosis)
    assert float(found.mean) == pytest.approx(float(long[0]), rel=1e-12)
    assert float(found.deviation) == pytest.approx(float(long[1]), rel=1e-12)
    assert float(found.mean) == pytest.approx((2 - 2 * alpha) / (2 - alpha), rel=1e-12)


def test_equal_weights_have_the_textbook_variance(x64):
    # With alpha = 1/2 two samples weigh the same: Var s^2 = (kurtosis - (n - 3) / (n - 1)) / n, n = 2.
    for kurtosis in (1.0, 1.8, 3.0, 9.0):
        found = emv_moments(0.5, 2, kurtosis)
        assert float(found.mean) == pytest.approx(0.5, rel=1e-15)
        assert float(found.deviation) ** 2 == pytest.approx((kurtosis + 1) / 2, rel=1e-13)


SAMPLES = {
    "normal": (3.0, lambda generator, shape: generator.normal(size=shape)),
    "uniform": (1.8, lambda generator, shape: generator.uniform(-np.sqrt(3), np.sqrt(3), shape)),
    # 1 with the probability 0.1: variance 0.09, fourth moment 0.1 0.9^4 + 0.9 0.1^4 = 0.0657.
    "two-valued": (0.0657 / 0.0081, lambda generator, shape: (generator.uniform(size=shape) < 0.1) / 0.3),
}


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("alpha, num_samples", [(0.2, 60), (0.3, 4)])
def test_moments_of_many_histories(x64, name, alpha, num_samples):
    kurtosis, draw = SAMPLES[name]
    histories = 100_000
    samples = draw(np.random.default_rng(9), (num_samples, histories))
    mean, variance = samples[0], np.zeros(histories)
    for sample in samples[1:]:
        delta = sample - mean
        mean, variance = mean + alpha * delta, (1 - alpha) * (variance + alpha * delta**2)
    found = emv_moments(alpha, num_samples, kurtosis)
    deviation = variance.std(ddof=1)
    assert abs(variance.mean() - float(found.mean)) < 4 * deviation / np.sqrt(histories)
    debiased = variance / float(found.mean)
    spread = debiased.std(ddof=1)
    of_debiased = np.mean((debiased - debiased.mean()) ** 4) / spread**4
    error = spread * np.sqrt((of_debiased - 1) / 4 / histories)
    assert abs(spread - float(found.deviation)) < 4 * error


@given(alpha=st.floats(1e-6, 0.99), kurtosis=st.floats(1, 50))
def test_single_precision_has_the_moments_of_double(alpha, kurtosis):
    alpha, kurtosis = np.float32(alpha), np.float32(kurtosis)
    single = [float(v) for v in emv_moments(alpha, jnp.inf, kurtosis)]
    a, k = np.longdouble(alpha), np.longdouble(kurtosis)
    kept = 1 - a
    # Geometric sums of the weights' powers; 1 - kept^p is exact enough here.
    second, third, fourth = (a**p / (1 - kept**p) for p in (2, 3, 4))
    variance = (k - 1) * (second - 2 * third + fourth) + 2 * (second**2 - fourth)
    assert single[0] == pytest.approx(float(1 - second), rel=1e-6)
    # The terms are at most 1 / (1 - alpha) times what their sum is, each of a dozen roundings.
    error = 2e-6 / float(kept) ** 2
    assert single[1] == pytest.approx(float(np.sqrt(variance) / (1 - second)), rel=error)


def test_moments_at_the_ends(dtype):
    # One sample, or none but the newest: the variance is 0 and has no debiased form.
    for alpha, num_samples in ((0.2, 1), (1e-6, 1), (1.0, 1), (1.0, 5), (1.0, jnp.inf)):
        found = emv_moments(dtype.type(alpha), float(num_samples), dtype.type(3))
        assert found.mean.dtype == found.deviation.dtype == dtype
        assert float(found.mean) == 0
        assert np.isnan(found.deviation)
    found = emv_moments(np.array([[0.1], [0.2]], dtype), np.array([2, 5, np.inf]), 3.0)
    assert found.mean.shape == found.deviation.shape == (2, 3)


@pytest.mark.parametrize("alpha", [0.0, -1.0, 1.5])
def test_weights_outside_their_domain_are_refused(alpha):
    with pytest.raises(ValueError, match=r"alpha must be in \(0, 1\], got"):
        bias.emv_moments(alpha)
