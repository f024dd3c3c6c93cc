"""The controller that looks inside the frames at work: what it spends and delivers, against what is exact.

The variance that a frame delivers is, given its count, the exact variance of a sample over the count.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from sssfit.estimators import in_frame, policies
from sssfit.scenarios import circle, driver, light, line

# Each simulation is a program to compile, and many seeds.
pytestmark = pytest.mark.slow

# Traced, so that both share a program: 0.05, and what the name stands for.
ALPHAS = {"0.05": 0.05, "default": policies.IN_FRAME_ALPHA}
#: Frames 51 on.
STEADY = slice(50, None)


def mean_and_error(by_seed):
    return by_seed.mean(), by_seed.std(ddof=1) / np.sqrt(len(by_seed))


# The circle: 42.69 samples take the variance of one, 4 / pi - 1, to 0.0064.

CIRCLE_TARGET, CIRCLE_COUNT = 0.0064, 42.693678864869170


@pytest.fixture(scope="module", params=driver.STARTS)
def on_the_circle(request):
    policy = policies.named("in_frame", target_variance=CIRCLE_TARGET, alpha=jnp.float32(0.05))
    return driver.run(jax.random.key(1), circle.uniform(150), policy, seeds=1000, start=request.param)


def test_count_and_variance_on_the_circle(on_the_circle):
    count = on_the_circle.count[:, STEADY].astype(float)
    found, error = mean_and_error(count.mean(axis=1))
    assert abs(found / CIRCLE_COUNT - 1) < 0.03 and error < 0.1
    delivered, error = mean_and_error((circle.SAMPLE_VARIANCE / count).mean(axis=1))
    assert abs(delivered / CIRCLE_TARGET - 1) < 0.03 and error < 1e-4
    # The same from the results themselves, within their standard error.
    squared, error = mean_and_error(np.square(on_the_circle.value[:, STEADY] - 1.0).mean(axis=1))
    assert abs(squared - delivered) < 4 * error


def test_results_on_the_circle_are_unbiased(on_the_circle):
    # Given the frames before, and so altogether: the count of a frame does not look at its samples.
    value = on_the_circle.value.astype(float)
    assert np.all(np.abs(value.mean(axis=0) - 1) < 4.5 * value.std(axis=0) / np.sqrt(len(value)))


def test_what_it_believes_in_on_the_circle(on_the_circle):
    # The expected variance of the results, frame by frame of thousands, is near their own.
    believed = on_the_circle.variance[:, STEADY].astype(float).mean()
    squared, error = mean_and_error(np.square(on_the_circle.value[:, STEADY] - 1.0).mean(axis=1))
    assert abs(believed - squared) < 0.02 * squared + 4 * error


# The line, under light that stays, swells, is switched and flickers

LINE_TARGET = 1e-4


@pytest.fixture(scope="module")
def on_the_line():
    """By light and alpha: mean count over the oracle's, and variance over the target where that is free."""
    profile = line.ramp(line.centres(256, 4.0))

    @functools.cache
    def figures(name, alpha):
        irradiance = (light.LIGHTS[name](150)[:, None] * profile).astype(np.float32)
        world = line.world(irradiance, length=4.0, d=0.05)
        policy = policies.named("in_frame", alpha=jnp.float32(ALPHAS[alpha]))
        record = driver.run(jax.random.key(2), world, policy, seeds=6)
        count, variance = (
            record.count[:, STEADY].astype(float),
            np.asarray(world.sample_variance, float)[STEADY],
        )
        ideal = variance / LINE_TARGET
        oracle = np.round(np.clip(ideal, 8, 64))
        free = (ideal > 8) & (ideal < 64)
        assert free.mean() > 0.1
        return count.mean() / oracle.mean(), (variance / count)[:, free].mean() / LINE_TARGET

    return figures


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("name", light.LIGHTS)
def test_the_line_takes_hardly_more_than_the_oracle(on_the_line, name, alpha):
    spent, delivered = on_the_line(name, alpha)
    assert spent <= 1.05
    assert abs(delivered - 1) < 0.05


# Points of low discrepancy

# What a gain_alpha of 0.02 remembers of the first frames is below 0.98^200 = 2 %.
LEARNED = slice(200, None)


@pytest.fixture(scope="module")
def exact_r2_variance():
    """Variance over random shifts of the circle's mean over n = 1 to 64 points of R2, in whole numbers."""
    generator = np.random.default_rng(3)
    number = np.arange(64, dtype=np.uint64)[:, None]
    point = [
        ((number * step + generator.integers(0, 2**32, 40_000, dtype=np.uint64)) % 2**32) / 2**32
        for step in (3242174889, 2447445414)
    ]
    value = 4 / np.pi * (np.square(point[0] - 0.5) + np.square(point[1] - 0.5) < 0.25)
    means = np.cumsum(value, axis=0) / np.arange(1, 65)[:, None]
    return np.mean(np.square(means - 1), axis=1)


class Showing(policies.InFrame):
    """Records the gain in the coefficient's place."""

    def learn(self, state, known, sampled):
        state, learned = super().learn(state, known, sampled)
        return state, learned._replace(coefficient=in_frame.sequence_gain(state))


@pytest.fixture(scope="module")
def with_a_gain():
    policy = Showing(in_frame.Controller(CIRCLE_TARGET, alpha=0.05, gain_alpha=0.02))

    def record(sequence):
        return driver.run(jax.random.key(4), circle.uniform(400), policy, seeds=640, sequence=sequence)

    return {sequence: record(sequence) for sequence in driver.SEQUENCES}


def test_the_gain_of_r2_is_learned(with_a_gain, exact_r2_variance):
    # Twelve samples do what takes 43 independent ones.
    smallest = 1 + int(np.argmax(exact_r2_variance <= CIRCLE_TARGET))
    assert smallest == 12 and np.all(exact_r2_variance[11:] < 1.02 * CIRCLE_TARGET)
    record = with_a_gain["r2"]
    found, error = mean_and_error(record.count[:, LEARNED].mean(axis=1))
    assert 0.95 * smallest < found < 1.1 * smallest and error < 0.05
    # The results' own variance, and what the exact ones of the counts come to.
    squared, error = mean_and_error(np.square(record.value[:, LEARNED] - 1.0).mean(axis=1))
    assert abs(squared / CIRCLE_TARGET - 1) < 0.05 + 4 * error / CIRCLE_TARGET
    delivered = exact_r2_variance[record.count[:, LEARNED] - 1].mean()
    assert abs(squared - delivered) < 4 * error + 0.01 * delivered
    # The gain at twelve points.
    gain = exact_r2_variance[11] * 12 / circle.SAMPLE_VARIANCE
    assert abs(record.coefficient[:, LEARNED].mean() - gain) < 0.1 * gain


def test_independent_points_have_a_gain_of_about_one(with_a_gain):
    # Of a ratio that is 1 on average, what exceeds 1 is cut off: a fading sum over 2 / 0.02 - 1 frames of
    # squared differences, whose variance is 3 / 2 of that of squares that are independent.
    degrees = (2 / 0.02 - 1) / 1.5
    grid = (np.arange(100_000) + 0.5) / 100_000
    expected = np.minimum(chi2.ppf(grid, degrees) / degrees, 1).mean()
    found, error = mean_and_error(with_a_gain["iid"].coefficient[:, LEARNED].mean(axis=1))
    # The two sums' neighbours are not quite independent, nor the results normal.
    assert abs(found - expected) < 0.02 + 4 * error
    count = with_a_gain["iid"].count[:, LEARNED].mean()
    assert 0.9 < count / CIRCLE_COUNT < 1.02


# Normal samples, thousands of pixels at once

STREAMS, LENGTH, COUNT = 4000, 150, 16


@pytest.fixture(scope="module")
def normal_samples():
    """The histories of normal samples of variance 0.3 under light of 0.9."""
    controller = in_frame.Controller(1e-3, alpha=0.05, gain_alpha=0.05)
    generator = np.random.default_rng(5)
    mean = 0.4 + generator.normal(size=(LENGTH, STREAMS)) * np.sqrt(0.3 / COUNT)
    deviation = 0.3 * generator.chisquare(COUNT - 1, (LENGTH, STREAMS))

    def following(state, frame):
        return in_frame.update(state, *frame, count=COUNT, control=0.9, controller=controller), None

    brought = mean.astype(np.float32), deviation.astype(np.float32)
    state = jax.jit(lambda b: jax.lax.scan(following, in_frame.init(b[0][0], controller), b)[0])(brought)
    return state, controller


def test_the_expected_variance_is_unbiased(normal_samples):
    found = np.asarray(in_frame.sample_variance(normal_samples[0], 0.9, normal_samples[1]), float)
    mean, error = mean_and_error(found)
    assert abs(mean - 0.3) < 4 * error
    # Of 39 remembered frames of 15 degrees of freedom each.
    assert found.std() / 0.3 == pytest.approx(np.sqrt(2 / (39 * 15)), rel=4 / np.sqrt(2 * STREAMS) + 0.01)


def test_the_uncertainty_is_the_variance_of_the_sum(normal_samples):
    state, _ = normal_samples
    total, uncertainty = (np.asarray(v, float) for v in (state.square_deviation, state.uncertainty))
    # What is foretold errs itself: alpha / (2 - alpha) more.
    ratio, error = uncertainty.mean() / total.var(), np.sqrt(2 / STREAMS)
    assert 1 - 4 * error < ratio < 1 + 0.05 / 1.95 + 4 * error


def test_the_gain_compares_like_with_like(normal_samples):
    # Of independent samples both sums have one expectation.
    gain = normal_samples[0].gain
    apart, error = mean_and_error(np.asarray(gain.temporal, float) - np.asarray(gain.spatial, float))
    assert abs(apart) < 4 * error
    assert error < 0.01 * float(gain.spatial.mean())
