"""The regret: 1 for an oracle by construction, and what it must be where it has a closed form."""

from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.estimators import policies
from sssfit.scenarios import circle, driver, line, measure
from sssfit.scenarios.driver import Record
from sssfit.scenarios.measure import Target

LEVELS: tuple[measure.Level, ...] = ("mean", "q95")


class Answers(NamedTuple):
    """As much of a world as the statistics look at."""

    truth: np.ndarray
    sample_variance: np.ndarray


def statistics(variance, counts, target, first=0):
    """Of hand-made counts (seeds, frames, pixels), whole or not, for variances (frames, pixels)."""
    variance, counts = np.asarray(variance, float), np.asarray(counts, float)
    world: Any = Answers(np.zeros_like(variance), variance)
    made = Record._make([counts, *[np.zeros_like(counts)] * 5])
    return measure.collect([made], world, target, first=first)


def oracle_regret(variance, target, level: measure.Level = "mean", spent_at=None):
    """The regret of counts that are not rounded, of the target's oracle or another one's."""
    counts = measure.oracle_count(variance, spent_at or target)
    return measure.regret(statistics(variance, counts[None], target), level=level)


variances = st.lists(st.floats(1e-4, 1.0), min_size=1, max_size=40).map(lambda v: np.array([v]))


# The oracle itself


@pytest.mark.parametrize("level", LEVELS)
@given(variance=variances, share=st.floats(0.01, 0.99))
def test_one_for_counts_that_are_neither_rounded_nor_clamped(level, variance, share):
    # All ideal counts are within the bounds if the variances are within a factor of 8.
    variance = variance.max() * np.clip(variance / variance.max(), 1 / 7, None)
    target = Target(variance.max() / 64 + share * (variance.min() / 8 - variance.max() / 64))
    assert measure.oracle_count(variance, target) == pytest.approx(variance / target.variance, rel=1e-12)
    assert oracle_regret(variance, target, level) == pytest.approx(1, rel=1e-12)


@given(variance=variances, exponent=st.floats(-4, -1))
def test_one_for_clamped_counts_by_the_mean(variance, exponent):
    target = Target(10.0**exponent)
    found, counts = oracle_regret(variance, target), measure.oracle_count(variance, target)
    # Of pixels that are all at one bound the mean may be an ulp out of reach.
    is_at_a_bound = (counts == 8).all() or (counts == 64).all()
    # One pixel may carry all of the mean but 1e-6, so that rounding it weighs 1e6 times as much.
    assert found == pytest.approx(1, rel=1e-9) or (np.isnan(found) and is_at_a_bound)


@pytest.mark.parametrize("level", LEVELS)
def test_up_to_rounding_for_the_oracle_of_a_line(level):
    x = line.centres(64, 4.0)
    irradiance = (0.25 + line.ramp(x, start=0.0, end=4.0, amplitude=1.0))[None].repeat(3, axis=0)
    world = line.world(irradiance.astype(np.float32), length=4.0, d=0.6)
    variance = np.asarray(world.sample_variance, float)
    # Ideal counts from 20 to below 64, so that both bounds are out of reach.
    target = Target(float(variance.min()) / 20, 8, 4096)
    assert 1.3 * variance.min() < variance.max() < 63 * target.variance
    policy = policies.Oracle(target.variance, 8, 4096)
    records = driver.chunks(jax.random.key(0), world, policy, seeds=1, most=64)
    found = measure.regret(measure.collect(records, world, target, first=0), level=level)
    # Rounding moves a count, and the variance it delivers, by at most this share; another target, moved by
    # as much, makes up for it, and counts that are not clamped follow it.
    share = 0.5 / 20
    assert (1 - share) / (1 + share) <= found <= (1 + share) / (1 - share)
    assert found != 1


@pytest.mark.parametrize("level", LEVELS)
def test_one_where_some_pixels_cannot_have_what_they_need(level):
    variance = np.array([[1.0] * 10 + [0.03] * 90])
    counts = measure.oracle_count(variance, Target(1e-3))
    assert counts[0] == pytest.approx(np.array([64.0] * 10 + [30.0] * 90))
    assert oracle_regret(variance, Target(1e-3), level) == pytest.approx(1, rel=1e-9)


@pytest.mark.parametrize("level", LEVELS)
def test_one_where_few_pixels_need_more_than_the_least(level):
    # The quantile is that of the others, which have too many samples at any target.
    variance = np.array([[0.03] * 4 + [1e-4] * 96])
    counts = measure.oracle_count(variance, Target(1e-3))
    assert counts[0] == pytest.approx(np.array([30.0] * 4 + [8.0] * 96))
    assert oracle_regret(variance, Target(1e-3), level) == pytest.approx(1, rel=1e-9)


@pytest.mark.parametrize("level", LEVELS)
def test_no_gain_from_delivering_more_than_is_asked_for(level):
    # At half the target a tenth of the pixels is at the largest count and decides the quantile.
    variance = np.array([[0.06] * 10 + [0.01] * 90])
    half = Target(0.5e-3)
    assert measure.oracle_count(variance, half)[0] == pytest.approx(np.array([64.0] * 10 + [20.0] * 90))
    assert oracle_regret(variance, Target(1e-3), level, spent_at=half) >= 1 - 1e-9


def test_one_with_a_pixel_out_of_all_proportion():
    # The mean delivered variance is the bright pixel's, ten thousand times the target.
    variance = np.array([[640.0] + [0.003] * 9])
    counts = measure.oracle_count(variance, Target(1e-4))
    assert counts[0] == pytest.approx(np.array([64.0] + [30.0] * 9))
    # The others are a part in ten thousand of the mean, whose rounding grows by that.
    assert oracle_regret(variance, Target(1e-4)) == pytest.approx(1, rel=1e-9)


# Others


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("spp", [8, 16, 43, 64])
def test_one_for_a_fixed_count_on_the_circle(level, spp):
    variance = np.asarray(circle.uniform(3).sample_variance)[:, None]
    found = statistics(variance, np.full((2, 3, 1), spp), Target(0.0064))
    assert measure.regret(found, level=level) == pytest.approx(1, rel=1e-12)


@given(st.lists(st.integers(9, 60), min_size=2, max_size=30).filter(lambda n: len(set(n)) > 1))
def test_counts_that_scatter_on_the_circle(counts):
    # The oracle delivers mean(1 / n) with 1 / mean(1 / n) samples everywhere.
    counts = np.array(counts, float)[:, None, None]
    expected = counts.mean() * (1 / counts).mean()
    assert expected > 1
    found = statistics([[circle.SAMPLE_VARIANCE]], counts, Target(0.0064))
    assert measure.regret(found) == pytest.approx(expected, rel=1e-12)


def test_counts_perturbed_at_random():
    random = np.random.default_rng(5)
    variance = random.uniform(0.02, 0.05, (4, 50))
    perturbed = variance / 1e-3 * random.choice([0.8, 1.2], (40, 4, 50))
    found = statistics(variance, perturbed, Target(1e-3, 8, 128))
    # A pixel delivers 1e-3 over 0.8 or 1.2, and an oracle the mean of these.
    share = (perturbed < variance / 1e-3).mean()
    delivered = (share / 0.8 + (1 - share) / 1.2) * 1e-3
    expected = perturbed.mean() / (variance / delivered).mean()
    assert 1.03 < expected < 1.05
    assert measure.regret(found) == pytest.approx(expected, rel=1e-9)
    # More than 5 % deliver 1e-3 / 0.8.
    expected = perturbed.mean() / (variance / (1e-3 / 0.8)).mean()
    assert measure.regret(found, level="q95") == pytest.approx(expected, rel=1e-9)


def test_the_quantile_tells_a_fixed_count_from_the_oracle():
    # Half the pixels have four times the variance of the others. A fixed n delivers v / n there, which an
    # oracle delivers everywhere with n and n / 4.
    variance = np.array([[0.01] * 10 + [0.04] * 10])
    found = statistics(variance, np.full((3, 1, 20), 40), Target(1e-3, 4, 64))
    assert measure.regret(found) == pytest.approx(1, rel=1e-12)
    assert measure.regret(found, level="q95") == pytest.approx(1.6, rel=1e-12)


def test_the_quantile_is_taken_seed_by_seed():
    # In each seed a tenth of the pixels has 16 samples; all pixels have the same mean over the seeds.
    counts = np.full((10, 1, 20), 32.0)
    counts[np.arange(10), 0, np.arange(10)] = counts[np.arange(10), 0, np.arange(10, 20)] = 16.0
    found = statistics(np.full((1, 20), 0.03), counts, Target(1e-3))
    assert measure.regret(found, level="q95") == pytest.approx(30.4 / 16, rel=1e-9)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("spp", [4, 7.9, 64.1, 200])
def test_none_outside_the_bounds(level, spp):
    found = statistics([[0.03]], [[[spp]]], Target(1e-3))
    assert np.isnan(measure.regret(found, level=level))


@pytest.mark.parametrize("level", LEVELS)
def test_none_in_the_dark(level):
    found = statistics([[0.0, 0.0]], [[[8, 8]]], Target(1e-3))
    assert np.isnan(measure.regret(found, level=level))


def test_the_first_frames_are_left_out():
    variance, counts = np.full((4, 1), 0.03), np.array([9.0, 60.0, 30.0, 30.0]).reshape(1, 4, 1)
    for level in LEVELS:
        assert measure.regret(statistics(variance, counts, Target(1e-3)), level=level) > 1.2
        steady = statistics(variance, counts, Target(1e-3), first=2)
        assert measure.regret(steady, level=level) == pytest.approx(1, rel=1e-12)
