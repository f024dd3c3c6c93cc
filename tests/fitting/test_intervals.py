"""Covariances, intervals along a likelihood, and what is said of misfits and of undetermined directions."""

import math

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq

from sssfit.fitting import intervals

POINTS = 48
#: Chance of an alarm of either kind under white noise.
ALARM = 1e-3


@pytest.fixture
def rng():
    return np.random.default_rng(20)


# --- covariance


@pytest.mark.parametrize("scales", [(1.0, 1.0, 1.0), (1e-9, 1.0, 1e7)])
def test_covariance_is_the_sandwich(rng, scales):
    design = rng.normal(size=(POINTS, 3)) * scales
    noise = rng.uniform(0.2, 3.0, POINTS)
    unit = design / scales
    bread = np.linalg.inv(unit.T @ unit)
    expected = bread @ (unit.T * noise**2) @ unit @ bread / np.outer(scales, scales)
    np.testing.assert_allclose(intervals.covariance(design, noise), expected, rtol=1e-10)


def test_covariance_under_the_stated_noise_is_the_inverse(rng):
    design = rng.normal(size=(POINTS, 3))
    expected = np.linalg.inv(design.T @ design)
    np.testing.assert_allclose(intervals.covariance(design, np.ones(POINTS)), expected, rtol=1e-10)


def test_columns_that_cannot_be_told_apart_take_nothing_from_the_others(rng):
    first, other = rng.normal(size=(2, POINTS))
    design, noise = np.stack([first, 2 * first, other, 0 * other], axis=1), rng.uniform(0.5, 2.0, POINTS)
    found = intervals.covariance(design, noise)
    assert np.isinf(np.diag(found)[[0, 1, 3]]).all()
    assert np.count_nonzero(found) == 4
    reduced = intervals.covariance(np.stack([first, other], axis=1), noise)
    assert found[2, 2] == pytest.approx(reduced[1, 1], rel=1e-10)


def test_fewer_points_than_parameters_determine_none(rng):
    found = intervals.covariance(rng.normal(size=(2, 3)), np.ones(2))
    assert np.isinf(np.diag(found)).all()
    assert np.isinf(np.diag(intervals.covariance(np.zeros((4, 2)), np.ones(4)))).all()
    assert intervals.covariance(np.zeros((4, 0)), np.ones(4)).shape == (0, 0)


def test_correlation(rng):
    design = rng.normal(size=(POINTS, 3))
    covariance = np.linalg.inv(design.T @ design)
    errors = np.sqrt(np.diag(covariance))
    expected = covariance / np.outer(errors, errors)
    np.testing.assert_allclose(intervals.correlation(covariance), expected, rtol=1e-12)
    unknown = np.array([[np.inf, 0.0], [0.0, 2.0]])
    np.testing.assert_array_equal(intervals.correlation(unknown), np.eye(2))


# --- intervals


@pytest.mark.parametrize("level", [0.5, *intervals.LEVELS, 0.999])
def test_half_widths_are_scipys(level):
    assert intervals.half_width(level, math.inf) == pytest.approx(stats.norm.interval(level)[1], rel=1e-12)
    for dof in (1, 7, 46):
        assert intervals.half_width(level, dof) == pytest.approx(stats.t.interval(level, dof)[1], rel=1e-9)


def test_around_is_a_factor_or_a_difference():
    (low, high), (lower, higher) = intervals.around(3.0, 0.2, True, (1.0, 2.0))
    assert (low, high) == pytest.approx((3 * math.exp(-0.2), 3 * math.exp(0.2)))
    assert (lower, higher) == pytest.approx((3 * math.exp(-0.4), 3 * math.exp(0.4)))
    narrow, wide = intervals.around(0.3, 0.2, False, (1.0, 2.0))
    assert narrow == pytest.approx((0.1, 0.5)) and wide == pytest.approx((0.0, 0.7))
    assert intervals.around(3.0, math.inf, True, (1.0,)) == ((0.0, math.inf),)
    assert intervals.around(3.0, 1e4, True, (1.0,)) == ((0.0, math.inf),)


def counted(z):
    """Half of the deviance of a count of 5 whose expectation is 5 exp(z)."""
    return 5 * (math.exp(z) - 1 - z)


@pytest.mark.parametrize("step", [1e-6, 0.3, 7.0])
def test_along_an_asymmetric_likelihood(step):
    widths = (1.0, 1.96)
    found = intervals.along_likelihood(counted, 0.0, step, widths, -50.0, 50.0)
    for width, (low, high) in zip(widths, found, strict=True):
        ends = (brentq(lambda z: counted(z) - width**2 / 2, *between) for between in ((-9, 0), (0, 9)))  # noqa: B023
        # The search stops at 1e-4 of the distance from the optimum.
        assert (low, high) == pytest.approx(tuple(ends), rel=1e-4)
    # Not at all the ends that the curvature 5 gives.
    assert found[1][0] < 1.1 * -1.96 / math.sqrt(5) < -0.9 * 1.96 / math.sqrt(5) < -found[1][1]


def test_the_optimum_may_lie_anywhere():
    shifted = intervals.along_likelihood(lambda z: counted(z - 3) + 70, 3.0, 0.1, (1.0,), -50.0, 50.0)
    plain = intervals.along_likelihood(counted, 0.0, 0.1, (1.0,), -50.0, 50.0)
    assert shifted[0] == pytest.approx(tuple(end + 3 for end in plain[0]), rel=1e-4)


def test_what_does_not_close_ends_at_the_bounds():
    def one_sided(z):
        return max(-z, 0.0) ** 2 / 2

    ((low, high),) = intervals.along_likelihood(one_sided, 0.0, 0.2, (1.5,), -5.0, 5.0)
    assert low == pytest.approx(-1.5, rel=1e-4) and high == 5.0
    # Beyond every bound that matters the search gives up, and says so by the bound.
    ((low, high),) = intervals.along_likelihood(one_sided, 0.0, 0.2, (1.5,), -5.0, math.inf)
    assert high == math.inf
    ((low, high),) = intervals.along_likelihood(one_sided, 0.0, 0.2, (1.5,), -1.0, 5.0)
    assert low == -1.0
    # An optimum on its bound has no other side.
    ((low, high),) = intervals.along_likelihood(lambda z: z + z * z, 0.0, 0.2, (1.0,), 0.0, 5.0)
    assert low == 0.0 and high == pytest.approx((math.sqrt(3) - 1) / 2, rel=1e-4)


# --- misfits


@pytest.mark.parametrize("is_known, chance", [(True, 2 * ALARM), (False, ALARM)])
def test_white_noise_is_rarely_called_a_misfit(rng, is_known, chance):
    number = 3000
    alarms = sum(
        intervals.misfit(rng.normal(size=(POINTS, 1)), POINTS, is_known)[1] != "" for _ in range(number)
    )
    # Swings are whole numbers: their chance is at most what it is meant to be.
    assert alarms <= stats.binom.ppf(0.9999, number, chance)


def test_channels_are_counted_together_but_do_not_join(rng):
    alternating = np.where(np.arange(POINTS) % 2, 1.0, -1.0)
    assert intervals.misfit(np.stack([alternating, alternating], axis=1), 2 * POINTS, True) == (1.0, "")
    factor, words = intervals.misfit(np.ones((POINTS, 2)), 2 * POINTS, True)
    assert "the residuals of 96 points change their sign only 0 times" in words
    assert factor == pytest.approx(96 / 4)


def test_noise_that_is_too_large_is_a_misfit():
    alternating = np.where(np.arange(POINTS) % 2, 3.0, -3.0)[:, None]
    factor, words = intervals.misfit(alternating, POINTS - 2, True)
    assert factor == pytest.approx(9 * POINTS / (POINTS - 2))
    assert words == (
        "the model does not fit within the noise (chi2 per degree of freedom is 9.39); "
        "the intervals are 3.06 times as wide for it"
    )
    # Of noise that was estimated from the same residuals its size says nothing.
    assert intervals.misfit(alternating, POINTS - 2, False) == (1.0, "")


def test_a_systematic_misfit_is_found_in_noise_of_its_own_size(rng):
    wave = 2 * np.sin(np.linspace(0, 2 * np.pi, POINTS))
    found = [intervals.misfit((wave + rng.normal(size=POINTS))[:, None], POINTS - 2, True) for _ in range(50)]
    # Over its 24 points the wave's mean is 1.3: 6 standard errors in either half.
    assert sum(factor > 1.5 for factor, _ in found) >= 45


def test_a_systematic_misfit_far_below_the_noise_is_none():
    smooth = 1e-3 * np.sin(np.linspace(0, 2 * np.pi, POINTS))[:, None]
    assert intervals.misfit(smooth, POINTS - 2, True) == (1.0, "")
    # Of unknown noise it is all there is.
    factor, words = intervals.misfit(smooth / 1e-3, POINTS - 2, False)
    assert factor == pytest.approx((POINTS - 2) / 4, rel=0.05) and "change their sign only" in words


def test_points_that_are_left_out_have_no_sign():
    column = np.tile([1.0, 0.0, -1.0, 0.0], 12)[:, None]
    assert intervals.misfit(column, 22, True) == (1.0, "")
    assert intervals.misfit(np.zeros((POINTS, 1)), POINTS, True) == (1.0, "")


# --- directions


def test_what_is_determined_needs_no_words():
    assert intervals.directions(np.diag([3.0, 50.0]), ["a", "b"], np.ones(2)) == []


@pytest.mark.parametrize(
    "jacobian, words",
    [
        ([[9.0, 9.0], [9.0, 9.0]], "a raised with b lowered|b raised with a lowered"),
        ([[9.0, -9.0], [9.0, -9.0]], "a and b raised together|b and a raised together"),
        (
            [[1.5, 0.0], [0.0, 9.0]],
            "tell a raised from nothing: a factor of 2.72 costs 1.5 standard deviations",
        ),
        ([[9.0, 9.0]], "costs 0 standard deviations"),
    ],
)
def test_directions_in_words(jacobian, words):
    (sentence,) = intervals.directions(np.array(jacobian), ["a", "b"], np.ones(2))
    assert any(part in sentence for part in words.split("|")), sentence
    assert sentence.startswith("the data cannot tell ")


def test_the_worst_direction_comes_first():
    found = intervals.directions(np.diag([1.5, 0.1, 9.0]), ["a", "b", "c"], np.ones(3))
    assert [sentence.split()[4] for sentence in found] == ["b", "a"]


def test_numbers_without_logarithm_are_left_out():
    jacobian = np.array([[9.0, 0.0, np.nan], [0.0, 0.0, 1.0]])
    assert intervals.directions(jacobian, ["a", "b", "c"], np.array([1.0, 0.0, 1.0])) == []
    assert intervals.directions(jacobian[:, 1:], ["b", "c"], np.array([0.0, 1.0])) == []
