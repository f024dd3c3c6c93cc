"""Counts against exact fractions, the papers' constants, and the circle of the 2020 paper at work."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from sssfit.estimators import sample_count
from sssfit.estimators.sample_count import PAPER_2020, PAPER_2021, PRESETS, UNREAL, Controller, History

# Compiled once for each precision.
estimate = jax.jit(sample_count.estimate)
basic_estimate = jax.jit(sample_count.basic_estimate)
round_count = jax.jit(sample_count.round_count, static_argnames="rounding")
distant_share = jax.jit(sample_count.distant_share)
distant_count = jax.jit(sample_count.distant_count)
update = jax.jit(sample_count.update)
next_count = jax.jit(sample_count.next_count)

counts = st.floats(8, 64)
ratios = st.floats(1e-3, 1e3)
targets = st.floats(1e-6, 1.0)
weights = st.floats(1e-6, 1.0)
shares = st.floats(0, 1)


def exact_count(mean_count, variance, target_variance, alpha, kappa):
    """Eq 8-10 of the 2021 paper in fractions, and the gain kappa (2 / alpha - 2)."""
    mean_count, variance, target_variance, alpha, kappa = (
        Fraction(float(v)) for v in (mean_count, variance, target_variance, alpha, kappa)
    )
    expected = variance / target_variance * mean_count
    correction = (variance - target_variance) / target_variance * mean_count * (2 / alpha - 2)
    return kappa * correction + expected, float(kappa * (2 / alpha - 2))


def within(count, low, high):
    return float(min(max(count, Fraction(low)), Fraction(high)))


# Estimate


@given(mean_count=counts, ratio=ratios, target=targets, alpha=weights, kappa=shares)
def test_estimate_is_the_formula_in_fractions(dtype, mean_count, ratio, target, alpha, kappa):
    values = [dtype.type(v) for v in (mean_count, ratio * target, target, alpha, kappa)]
    names = ("mean_count", "variance", "target_variance", "alpha", "kappa")
    found = estimate(**dict(zip(names, values, strict=True)), min_spp=8, max_spp=64)
    count, gain = exact_count(*values)
    assert found.dtype == dtype
    error = 6 * float(np.finfo(dtype).eps) * (1 + gain)
    assert float(found) == pytest.approx(within(count, 8, 64), rel=error, abs=0)


@given(mean_count=counts, ratio=st.floats(0, 10), target=targets, alpha=weights, kappa=shares)
def test_estimate_errs_by_roundings_of_its_terms(dtype, mean_count, ratio, target, alpha, kappa):
    values = [dtype.type(v) for v in (mean_count, ratio * target, target, alpha, kappa)]
    names = ("mean_count", "variance", "target_variance", "alpha", "kappa")
    found = float(estimate(**dict(zip(names, values, strict=True)), min_spp=0, max_spp=1e30))
    count, gain = exact_count(*values)
    # The terms are at most (1 + gain) max(ratio, 1) mean_count, each of at most 8 roundings of eps / 2.
    scale = float(values[0]) * (1 + gain) * max(ratio, 1)
    assert found == pytest.approx(within(count, 0, 10**30), abs=4 * float(np.finfo(dtype).eps) * scale)


def test_estimate_squares_the_deviations(x64):
    # Deviations of 0.09 and 0.08: (0.0081 - 0.0064) / 0.0064 * 20 * 8 = 42.5, and 25.3125 expected.
    found = float(
        estimate(20.0, 0.09**2, target_variance=0.08**2, alpha=0.2, kappa=1.0, min_spp=8, max_spp=1000)
    )
    assert found == pytest.approx(67.8125, rel=1e-13)
    # As printed in 2020, with deviations for variances: 250 and 25.3125.
    assert abs(found - 275.3125) > 200


@given(
    mean_count=st.floats(0, 1e6),
    variance=st.floats(0, 1e30),
    target=targets,
    alpha=weights,
    kappa=shares,
    bounds=st.tuples(st.floats(0, 100), st.floats(0, 100)),
)
def test_estimate_is_within_its_bounds(dtype, mean_count, variance, target, alpha, kappa, bounds):
    low, high = (dtype.type(v) for v in sorted(bounds))
    found = estimate(
        *(dtype.type(v) for v in (mean_count, variance)),
        target_variance=dtype.type(target),
        alpha=dtype.type(alpha),
        kappa=dtype.type(kappa),
        min_spp=low,
        max_spp=high,
    )
    assert low <= float(found) <= high


@given(seed=st.integers(0, 2**32 - 1), alpha=weights, kappa=shares)
def test_estimate_grows_with_the_variance_and_the_mean_count(dtype, seed, alpha, kappa):
    # Rounded operations are monotone, and so is the whole, to the bit.
    generator = np.random.default_rng(seed)
    rising = np.sort(generator.lognormal(sigma=2, size=32)).astype(dtype)
    setting = dict(
        target_variance=dtype.type(1),
        alpha=dtype.type(alpha),
        kappa=dtype.type(kappa),
        min_spp=0,
        max_spp=1e9,
    )
    assert np.all(np.diff(estimate(dtype.type(20), rising, **setting)) >= 0)
    assert np.all(np.diff(estimate(20 * rising, dtype.type(0.7), **setting)) >= 0)


@given(mean_count=counts, ratio=ratios, alpha=weights, kappa=shares, power=st.integers(-30, 30))
def test_only_the_ratio_of_variance_and_target_counts(dtype, mean_count, ratio, alpha, kappa, power):
    # A power of two scales without rounding.
    found = [
        float(
            estimate(
                dtype.type(mean_count),
                dtype.type(ratio) * scale,
                target_variance=dtype.type(1e-3) * scale,
                alpha=dtype.type(alpha),
                kappa=dtype.type(kappa),
                min_spp=8,
                max_spp=64,
            )
        )
        for scale in (dtype.type(1), dtype.type(2.0**power))
    ]
    assert found[0] == found[1]


SETTING = dict(target_variance=1e-3, alpha=0.2, kappa=0.2, min_spp=8, max_spp=64)


@pytest.mark.parametrize("kappa", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("alpha", [1e-6, 0.2, 1.0])
def test_estimate_at_the_ends(dtype, alpha, kappa):
    setting = SETTING | dict(alpha=alpha, kappa=kappa)
    mean_count = np.array([16, 16, 16, 0, 0, 0, 16, np.nan, 0], dtype)
    variance = np.array([0, np.inf, 1e-3, np.inf, 0, 1, np.nan, 1e-3, np.nan], dtype)
    expected = np.array([8, 64, 16, 8, 8, 8, np.nan, np.nan, np.nan], dtype)
    found = estimate(mean_count, variance, **(setting | {"target_variance": dtype.type(1e-3)}))
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, expected)


def test_without_a_correction_the_count_is_the_expected_one(dtype):
    # kappa = 0, or nothing remembered: 1.5 * 16 is exact.
    for alpha, kappa in ((0.2, 0.0), (1e-6, 0.0), (1.0, 1.0), (1.0, 0.3)):
        setting = dict(target_variance=dtype.type(0.25), alpha=alpha, kappa=kappa, min_spp=8, max_spp=64)
        assert float(estimate(dtype.type(16), dtype.type(0.375), **setting)) == 24


@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_estimate_for_a_tiny_target(dtype, kappa):
    setting = SETTING | dict(target_variance=np.finfo(dtype).tiny, kappa=kappa)
    variance = np.array([0, np.finfo(dtype).tiny, 1, np.finfo(dtype).max, np.inf], dtype)
    found = estimate(dtype.type(16), variance, **setting)
    np.testing.assert_array_equal(found, [8, 16, 64, 64, 64])
    np.testing.assert_array_equal(estimate(dtype.type(0), variance, **setting), 8)


def test_estimate_of_maps_and_halves():
    found = estimate(jnp.ones((4, 1)), jnp.ones(3), **SETTING)
    assert found.shape == (4, 3) and found.dtype == jnp.float32
    half = sample_count.estimate(jnp.float16(16), jnp.float16(2e-3), **SETTING)
    assert half.dtype == jnp.float16


@pytest.mark.parametrize("alpha", [0.0, -0.1, 1.01, np.nan])
def test_estimate_refuses_a_weight_outside_its_domain(alpha):
    with pytest.raises(ValueError, match=r"alpha must be in \(0, 1\], got"):
        sample_count.estimate(8.0, 1.0, **(SETTING | {"alpha": alpha}))


def test_basic_estimate(dtype):
    # Eq 7 of the 2020 paper; 0.375 / 0.25 * 16 = 24 is exact.
    count = dtype.type(16) * np.ones(5, dtype)
    variance = np.array([0.375, 0.01, 0, np.inf, np.nan], dtype)
    found = basic_estimate(count, variance, target_variance=dtype.type(0.25), min_spp=8)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.array([24, 8, 8, np.inf, np.nan], dtype))
    none = basic_estimate(dtype.type(0), dtype.type(np.inf), target_variance=dtype.type(1), min_spp=8)
    assert float(none) == 8


# Rounding


def test_rounding(dtype):
    count = np.array([0, 0.5, 1.5, 2.5, 8.49, 8.51, 63.2, -3, -0.4, np.nan, 1e30, np.inf, -np.inf], dtype)
    top = 2**31 - 1
    for rounding, expected in (
        ("nearest", [0, 0, 2, 2, 8, 9, 63, 0, 0, 0, top, top, 0]),
        ("up", [0, 1, 2, 3, 9, 9, 64, 0, 0, 0, top, top, 0]),
        ("down", [0, 0, 1, 2, 8, 8, 63, 0, 0, 0, top, top, 0]),
    ):
        found = round_count(count, rounding=rounding)
        assert found.dtype == jnp.int32
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(sample_count.round_count(count), sample_count.round_count(count, "nearest"))


def test_rounding_of_numbers_near_the_largest_integer(dtype):
    top = 2**31 - 1
    below = np.nextafter(dtype.type(2.0**31), dtype.type(0))
    count = np.array([below, 2.0**31, 2.0**32, np.finfo(dtype).max], dtype)
    found = round_count(count, rounding="down")
    np.testing.assert_array_equal(found, [int(np.floor(below)), top, top, top])


@pytest.mark.parametrize("half", [jnp.float16, jnp.bfloat16])
def test_rounding_of_halves_and_integers(half):
    found = sample_count.round_count(jnp.array([8.5, 9.5, 40.0, jnp.nan, jnp.inf], half))
    assert found.dtype == jnp.int32
    assert found.tolist() == [8, 10, 40, 0, 2**31 - 1]
    assert int(sample_count.round_count(7)) == 7


def test_an_unknown_rounding_is_refused():
    with pytest.raises(ValueError, match="rounding must be one of nearest, up, down, got 'even'"):
        sample_count.round_count(8.5, "even")  # type: ignore[arg-type]


# Distant light


@given(
    depth=st.floats(1e-2, 1e4),
    width=st.floats(1e-5, 1e-2),
    height=st.floats(1e-5, 1e-2),
    d=st.floats(1e-2, 1e2),
)
def test_distant_share_is_what_the_cdf_leaves(dtype, depth, width, height, d):
    values = [dtype.type(v) for v in (depth, width, height, d)]
    found = distant_share(*values)
    # As many digits as 1 - cdf loses on the way to the smallest number.
    with mpmath.workdps(350):
        z, w, h, shape = (mpmath.mpf(float(v)) for v in values)
        x = z * mpmath.sqrt(w * w + h * h) / 2 / shape
        cdf = 1 - mpmath.exp(-x) / 4 - 3 * mpmath.exp(-x / 3) / 4
        expected = float(1 - cdf)
    assert found.dtype == dtype
    # 3.5 eps of the survival function, and 4 roundings of the radius over d, where ln sf has a slope of 1/2.
    error = float(np.finfo(dtype).eps) * (3.5 + float(x))
    assert float(found) == pytest.approx(expected, rel=error, abs=float(np.finfo(dtype).tiny))


def test_distant_share_of_maps_and_at_the_ends(dtype):
    depth = np.array([0, 1e30, np.inf, np.nan], dtype)
    found = distant_share(depth, dtype.type(1e-3), dtype.type(1e-3), dtype.type(0.5))
    np.testing.assert_array_equal(found, np.array([1, 0, 0, np.nan], dtype))
    assert distant_share(jnp.ones((4, 1)), 1e-3, 1e-3, jnp.ones(3)).shape == (4, 3)


def test_distant_count_stops_below_the_threshold(dtype):
    share = np.array([0, 0.25, 0.5, 1, np.nextafter(dtype.type(0.25), dtype.type(0))], dtype)
    found = distant_count(dtype.type(32), share, threshold=dtype.type(0.25))
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, [0, 8, 16, 32, 0])
    np.testing.assert_array_equal(distant_count(dtype.type(32), share, threshold=0), 32 * share)


# The next count


def test_the_presets_are_the_published_constants():
    # 2020: caption of Fig 9, alpha as in section 4.1.3; 2021: section 7.
    for controller, target, threshold in ((PAPER_2020, 1e-3, 0), (PAPER_2021, 1e-4, 0.01)):
        assert (controller.target_variance, controller.distant_threshold) == (target, threshold)
        assert (controller.alpha, controller.kappa) == (0.2, 0.2)
        assert (controller.min_spp, controller.max_spp) == (8, 64)
        assert (controller.metric, controller.variance_when_missing) == ("accumulated", "target")
    assert (UNREAL.target_variance, UNREAL.alpha, UNREAL.min_spp, UNREAL.max_spp) == (1e-4, 0.2, 8, 64)
    assert PRESETS == {"paper_2020": PAPER_2020, "paper_2021": PAPER_2021, "unreal": UNREAL}


@pytest.mark.parametrize("name", ["paper_2020", "paper_2021"])
@given(mean_count=counts, ratio=st.floats(0.1, 10))
def test_the_papers_next_count_is_the_rounded_estimate(dtype, name, mean_count, ratio):
    controller = PRESETS[name]
    mean_count, variance = dtype.type(mean_count), dtype.type(ratio * controller.target_variance)
    constants = [dtype.type(v) for v in (controller.target_variance, controller.alpha, controller.kappa)]
    count, gain = exact_count(mean_count, variance, *constants)
    found = next_count(History(*(jnp.asarray(v) for v in (mean_count, 1.0, variance))), controller)
    # Rounding may fall to the other side of a half by the estimate's own error.
    slack = 4 * float(np.finfo(dtype).eps) * (1 + gain) * max(ratio, 1) * 64
    assert found.dtype == jnp.int32
    assert abs(int(found) - within(count, 8, 64)) <= 0.5 + slack


def test_unreal_divides_the_variance_by_its_target(dtype):
    variance = np.array([0, 5e-4, 8.4e-4, 0.00321, 0.0064, 0.1, np.inf, np.nan], dtype)
    for mean_count in (0, 8, 50):
        history = History(jnp.full(8, mean_count, dtype), jnp.ones(8, dtype), jnp.asarray(variance))
        np.testing.assert_array_equal(next_count(history, UNREAL), [8, 8, 8, 32, 64, 64, 64, 8])


def test_rounding_of_the_next_count_and_its_bounds(dtype):
    # 20.5 is exact in halves of the target 1/4.
    history = History(jnp.asarray(20.5, dtype), jnp.asarray(0.0, dtype), jnp.asarray(0.25, dtype))
    for controller, expected in (
        (Controller(0.25, rounding="nearest"), 20),
        (Controller(0.25, rounding="up"), 21),
        (Controller(0.25, rounding="down"), 20),
        (Controller(0.25, min_spp=30, max_spp=40), 30),
        (Controller(0.25, min_spp=2, max_spp=4), 4),
    ):
        assert int(next_count(history, controller)) == expected


def test_no_samples_without_distant_light_or_knowledge(dtype):
    history = sample_count.init(jnp.zeros(3, dtype))
    below = np.nextafter(dtype.type(0.01), dtype.type(0))
    share = np.array([below, 0.01, 1], dtype)
    np.testing.assert_array_equal(next_count(history, PAPER_2021, distant_share=share), [0, 8, 8])
    # The 2020 paper knows no such threshold.
    np.testing.assert_array_equal(next_count(history, PAPER_2020, distant_share=0.0), 8)
    # What a NaN has got into counts as missing.
    lost = jax.tree.map(lambda part: part * jnp.nan, history)
    np.testing.assert_array_equal(next_count(lost, PAPER_2021), 8)


def test_counts_from_a_half_precision_history_need_no_half_precision_target():
    # 1e-4 and 1.5e-4 as halves; the count is that of these numbers, at the full target.
    variance = np.float16(1.5e-4)
    history = History(jnp.float16(20.0), jnp.float16(1.0), jnp.asarray(variance))
    count, _ = exact_count(20, variance, np.float32(1e-4), np.float32(0.2), np.float32(0.2))
    assert int(next_count(history, PAPER_2021)) == round(within(count, 8, 64))


# The history


def exact_update(history, value, count, alpha):
    """Eq 5-7 of the 2021 paper in fractions."""
    mean_count, mean, variance, value, count, alpha = (
        Fraction(float(v)) for v in (*history, value, count, alpha)
    )
    return (
        (1 - alpha) * mean_count + alpha * count,
        (1 - alpha) * mean + alpha * value,
        (1 - alpha) * variance + alpha * (1 - alpha) * (value - mean) ** 2,
    )


@given(
    mean_count=counts,
    mean=st.floats(-10, 10),
    variance=st.floats(0, 10),
    value=st.floats(-10, 10),
    count=st.integers(1, 64),
    alpha=weights,
)
def test_update_is_the_formulas_in_fractions(dtype, mean_count, mean, variance, value, count, alpha):
    start = [dtype.type(v) for v in (mean_count, mean, variance)]
    value, alpha = dtype.type(value), dtype.type(alpha)
    found = update(History(*(jnp.asarray(v) for v in start)), value, count, Controller(1e-3, alpha=alpha))
    expected = [float(v) for v in exact_update(start, value, count, alpha)]
    # Four roundings at most in an increment, of at most the sum of what is averaged.
    step = abs(float(value)) + abs(float(mean))
    scales = (64, step, float(variance) + step**2)
    for part, right, scale in zip(jax.tree.leaves(found), expected, scales, strict=True):
        assert part.dtype == dtype
        assert float(part) == pytest.approx(right, abs=3 * float(np.finfo(dtype).eps) * scale)


def test_a_missing_history_starts_from_the_frame(dtype):
    stale = History(*(jnp.asarray(v, dtype) for v in (40.0, 7.0, 3.0)))
    lost = History(*(jnp.asarray(np.nan, dtype) for _ in range(3)))
    for old in (stale, lost, sample_count.init(jnp.zeros((), dtype))):
        found = update(old, dtype.type(0.3), 17, PAPER_2021, missing=True)
        assert [v.dtype for v in jax.tree.leaves(found)] == [dtype] * 3
        # Weight 1 and the target, to the bit.
        assert [dtype.type(v) for v in jax.tree.leaves(found)] == [17, dtype.type(0.3), dtype.type(1e-4)]
        found = update(old, dtype.type(0.3), 17, UNREAL, missing=True)
        assert [dtype.type(v) for v in jax.tree.leaves(found)] == [17, dtype.type(0.3), 0]


def test_after_a_missing_history_the_count_stays(dtype):
    # At the target the next count is the same, whatever kappa is.
    for kappa in (0.0, 0.2, 1.0):
        controller = Controller(1e-3, kappa=kappa)
        history = update(sample_count.init(jnp.zeros((), dtype)), dtype.type(1), 23, controller, missing=True)
        assert int(next_count(history, controller)) == 23


def same_bits(found, expected):
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() and a.dtype == b.dtype for a, b in pairs)


@pytest.mark.parametrize("value", [1.0, np.nan, np.inf])
def test_nothing_is_learned_from_an_invalid_or_unsampled_frame(dtype, value):
    history = History(*(jnp.asarray(v, dtype) for v in (np.pi, -0.0, np.e)))
    value = dtype.type(value)
    assert same_bits(update(history, value, 8, PAPER_2021, valid=False), history)
    assert same_bits(update(history, value, 0, PAPER_2021), history)
    # Another surface's history must not stay where nothing replaces it.
    for count, valid in ((8, False), (0, True)):
        left = update(history, value, count, PAPER_2021, missing=True, valid=valid)
        assert same_bits(left, sample_count.init(jnp.zeros((), dtype)))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_bad_value_costs_one_frame(dtype, bad):
    history = update(sample_count.init(jnp.zeros((), dtype)), dtype.type(1), 20, PAPER_2021, missing=True)
    history = update(history, dtype.type(bad), 20, PAPER_2021)
    assert not np.isfinite(float(history.mean)) and bool(history.is_lost)
    # As after a disocclusion.
    assert int(next_count(history, PAPER_2021)) == 8
    fresh = update(history, dtype.type(1), 8, PAPER_2021)
    assert same_bits(fresh, update(history, dtype.type(1), 8, PAPER_2021, missing=True))
    assert float(fresh.mean) == 1 and not bool(fresh.is_lost)


@pytest.mark.parametrize("stored", [jnp.float16, jnp.float32])
def test_one_sample_too_bright_for_the_format_is_forgotten(stored):
    history = sample_count.init(0.0, dtype=stored)
    counts = []
    for t in range(600):
        # Its square, and for half the value itself, is beyond the largest number.
        value = np.float32(1e30 if t == 5 else 1)
        history = update(history, value, 16, PAPER_2021, missing=t == 0)
        assert all(np.isfinite(float(part)) for part in jax.tree.leaves(history))
        counts.append(int(next_count(history, PAPER_2021)))
    assert counts[5] == 64 and counts[-1] == 8


def test_maps_learn_where_they_may(dtype):
    history = sample_count.init(jnp.zeros((2, 3), dtype))
    value = np.array([[1, np.nan, 2], [3, 4, 5]], dtype)
    valid = ~np.isnan(value)
    count = np.array([[8, 8, 0], [16, 32, 64]])
    missing = np.array([[True], [False]])
    found = update(history, value, count, PAPER_2021, missing=missing, valid=valid)
    expected = np.zeros((3, 2, 3))
    expected[:, 0, 0] = 8, 1, 1e-4
    expected[:, 1] = 0.2 * count[1], 0.2 * value[1], 0.16 * value[1] ** 2
    for part, right in zip(jax.tree.leaves(found), expected, strict=True):
        np.testing.assert_allclose(part, right, rtol=4 * np.finfo(dtype).eps, atol=0)


def test_a_nan_that_is_kept_out_does_not_reach_the_gradient(dtype):
    history = sample_count.init(jnp.zeros((), dtype))

    def learned(alpha, value, valid):
        new = sample_count.update(history, value, 8, Controller(1e-3, alpha=alpha), valid=valid)
        return new.variance + new.mean

    slopes = jax.jit(jax.grad(learned, (0, 1)))(dtype.type(0.2), dtype.type(np.nan), False)
    assert [float(s) for s in slopes] == [0, 0]


@pytest.mark.parametrize("policy", ["target", "zero"])
def test_a_half_precision_history_is_computed_in_single_precision(policy):
    controller = Controller(1e-4, variance_when_missing=policy)
    history = sample_count.init(jnp.zeros(5), dtype=jnp.float16)
    values = np.random.default_rng(3).normal(1, 0.05, (20, 5)).astype(np.float32)
    rows = np.zeros((3, 5))
    for frame, value in enumerate(values):
        history = update(history, value, 16, controller, missing=frame == 0)
        if frame == 0:
            rows = np.array([np.full(5, 16), value, np.full(5, 1e-4 if policy == "target" else 0)])
        else:
            delta = value - rows[1]
            rows[2] = 0.8 * rows[2] + 0.16 * delta**2
            rows[:2] += 0.2 * (np.array([np.full(5, 16), value]) - rows[:2])
        # What is stored is rounded: half a unit of 2^-10 of the number, or of 2^-24 below the normals.
        stored = np.array([np.asarray(part) for part in jax.tree.leaves(history)])
        assert stored.dtype == np.float16
        relative = np.array([0.5, 0.5, 2.5])[:, None] * 2.0**-10
        np.testing.assert_array_less(np.abs(stored - rows), relative * rows + 2.0**-25 + 1e-7)
        # Compare single steps: go on from what was stored.
        rows = stored.astype(float)


def test_histories_start_at_zero(dtype):
    history = sample_count.init(np.ones((2, 3), dtype))
    assert [part.shape for part in jax.tree.leaves(history)] == [(2, 3)] * 3
    assert all(part.dtype == dtype and not part.any() for part in jax.tree.leaves(history))
    assert sample_count.init(0, dtype=jnp.bfloat16).mean.dtype == jnp.bfloat16
    assert sample_count.init(0).mean.dtype == jnp.result_type(float)


# Transformations


def run(history, values, controller):
    """All frames by scan, with the counts that the controller asks for."""

    def step(history, value):
        count = sample_count.next_count(history, controller)
        history = sample_count.update(history, value, count, controller)
        return history, count

    return jax.lax.scan(step, history, values)


def test_scan_is_the_loop(dtype):
    values = np.random.default_rng(0).normal(1, 0.05, (40, 6)).astype(dtype)
    history = sample_count.init(jnp.zeros(6, dtype))
    scanned, counted = jax.jit(run)(history, values, PAPER_2020)
    for frame, value in enumerate(values):
        count = next_count(history, PAPER_2020)
        np.testing.assert_array_equal(count, counted[frame])
        history = update(history, value, count, PAPER_2020)
    for one, other in zip(jax.tree.leaves(scanned), jax.tree.leaves(history), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e2 * np.finfo(dtype).eps)


def test_controllers_are_mapped_over(dtype):
    values = np.random.default_rng(1).normal(1, 0.05, (40, 6)).astype(dtype)
    history = sample_count.init(jnp.zeros(6, dtype))
    alphas, kappas = np.array([0.05, 0.2, 0.5], dtype), np.array([0, 0.2, 1], dtype)

    def counts_of(alpha, kappa):
        return run(history, values, Controller(1e-3, alpha=alpha, kappa=kappa))[1]

    swept = jax.jit(jax.vmap(counts_of))(alphas, kappas)
    target, low, high, threshold = (jnp.full(3, v, dtype) for v in (1e-3, 8, 64, 0))
    stacked = Controller(target, jnp.asarray(alphas), jnp.asarray(kappas), low, high, threshold)
    mapped = jax.jit(jax.vmap(lambda c: run(history, values, c)[1]))(stacked)
    for i in range(3):
        single = jax.jit(run)(history, values, Controller(1e-3, alpha=alphas[i], kappa=kappas[i]))[1]
        np.testing.assert_array_equal(swept[i], single)
        np.testing.assert_array_equal(mapped[i], single)
    assert np.unique(swept).size > 10


def test_gradients_by_hand(dtype):
    history = History(*(jnp.asarray(v, dtype) for v in (20.0, 1.0, 2e-3)))

    def variance(controller):
        return sample_count.update(history, dtype.type(1.5), 8, controller).variance

    # (1 - a) v + a (1 - a) d^2 has the slope (1 - 2 a) d^2 - v.
    controller = Controller(1e-3, 0.3, 0.2, 8.0, 64.0, 0.0)
    slope = jax.jit(jax.grad(variance))(jax.tree.map(lambda v: jnp.asarray(v, dtype), controller)).alpha
    assert float(slope) == pytest.approx(0.4 * 0.25 - 2e-3, rel=10 * float(np.finfo(dtype).eps))

    def count(variance, alpha, kappa):
        setting = dict(target_variance=dtype.type(1e-3), min_spp=8, max_spp=200)
        return sample_count.estimate(dtype.type(20), variance, alpha=alpha, kappa=kappa, **setting)

    slopes = jax.jit(jax.grad(count, (0, 1, 2)))
    # 20 (r + kappa (2 / a - 2) (r - 1)), r = 2.
    found = slopes(*(dtype.type(v) for v in (2e-3, 0.5, 0.5)))
    expected = (20 / 1e-3 * 2, 20 * 0.5 * -8, 20 * 2)
    np.testing.assert_allclose(found, expected, rtol=30 * np.finfo(dtype).eps)
    # At a bound the count does not move, and no NaN comes of an infinite variance.
    for v in (0.0, np.inf):
        assert [float(slope) for slope in slopes(*(dtype.type(x) for x in (v, 0.5, 0.5)))] == [0, 0, 0]


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(alpha=0.0), r"alpha must be in \(0, 1\], got 0"),
        (dict(alpha=np.array([0.2, 1.5])), r"alpha must be in \(0, 1\], got 1.5"),
        (dict(kappa=1.1), r"kappa must be in \[0, 1\], got 1.1"),
        (dict(kappa=-0.1), r"kappa must be in \[0, 1\], got -0.1"),
        (dict(kappa=np.nan), r"kappa must be in \[0, 1\], got nan"),
        (dict(target_variance=0.0), "target_variance must be above 0, got 0.0"),
        (dict(min_spp=0), "min_spp must be at least 1, got 0"),
        (dict(distant_threshold=-0.1), "distant_threshold must be at least 0, got -0.1"),
        (dict(min_spp=65), "min_spp must not exceed max_spp, got 65 and 64"),
        (dict(metric="basic"), "metric must be one of accumulated, variance_ratio, got 'basic'"),
        (dict(variance_when_missing="one"), "variance_when_missing must be 'target' or 'zero', got 'one'"),
        (dict(rounding="even"), "rounding must be one of nearest, up, down, got 'even'"),
    ],
)
def test_constants_outside_their_domain_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Controller(**({"target_variance": 1e-3} | changes))


# The circle of the 2020 paper: a uniform point of the unit square finds 4 / pi inside the circle, else 0.

PIXELS, FRAMES = 10_000, 150
INSIDE = np.pi / 4
# Cumulative probabilities of Binomial(n, pi / 4), n from 0 to 64; beyond n they are 1.
TABLE = np.array([binom.cdf(np.arange(64), n, INSIDE) for n in range(65)])


def circle(kappa, missing_first):
    """Counts and moving variances of all frames, (FRAMES, PIXELS); binomial draws by inversion."""
    controller = Controller(0.08**2, alpha=0.2, kappa=kappa)
    table = jnp.asarray(TABLE)

    def step(history, item):
        key, missing = item
        count = sample_count.next_count(history, controller)
        uniform = jax.random.uniform(key, (PIXELS,), jnp.float64)
        hits = jnp.sum(uniform[:, None] > table[count], axis=1)
        value = 4 / jnp.pi * hits / count
        history = sample_count.update(history, value, count, controller, missing=missing)
        return history, (count, history.variance)

    keys = jax.random.split(jax.random.key(20), FRAMES)
    missing = jnp.arange(FRAMES) < missing_first
    start = sample_count.init(jnp.zeros(PIXELS, jnp.float64))
    return jax.lax.scan(step, start, (keys, missing))[1]


@pytest.fixture(scope="module")
def circles():
    """Counts and variances by kappa and start."""
    with jax.enable_x64(True):
        simulate = jax.jit(circle)
        return {
            (kappa, start): tuple(np.asarray(part) for part in simulate(kappa, start == "disoccluded"))
            for kappa in (0.0, 1.0)
            for start in ("cold", "disoccluded")
        }


# Mean and standard error of 20000 runs in NumPy; mean counts of the first frames in one decimal.
STEADY = {0.0: (42.633, 0.030), 1.0: (49.653, 0.021)}
FIRST = {
    (0.0, "cold"): (8, 41.1, 63.9, 64),
    (1.0, "cold"): (8, 63.9, 64),
    (0.0, "disoccluded"): (8, 8, 19.4, 28.9, 36.2),
    (1.0, "disoccluded"): (8, 8, 40.4, 52.7),
}


@pytest.mark.parametrize("start", ["cold", "disoccluded"])
@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_the_circle_settles_at_the_published_setting(circles, kappa, start):
    means = circles[kappa, start][0][50:].mean(axis=0)
    expected, error = STEADY[kappa]
    own = means.std(ddof=1) / np.sqrt(PIXELS)
    assert abs(means.mean() - expected) < 4 * np.hypot(own, error)


@pytest.mark.parametrize("kappa, start", FIRST)
def test_the_first_frames_of_the_circle(circles, kappa, start):
    for frame, expected in enumerate(FIRST[kappa, start]):
        count = circles[kappa, start][0][frame]
        error = count.std() * np.sqrt(1 / PIXELS + 1 / 20_000)
        assert abs(count.mean() - expected) < 0.05 + 4 * error


@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_the_circles_early_counts_by_enumeration(circles, kappa):
    chances = binom.pmf(np.arange(9), 8, INSIDE)
    values = 4 / np.pi * np.arange(9) / 8

    def rounded(mean_count, variance):
        ratio = variance / 0.08**2
        return np.round(np.clip(mean_count * (ratio + kappa * 8 * (ratio - 1)), 8, 64))

    # Cold: means from 0, so that the second count follows from the first frame's 8 samples.
    second = rounded(0.2 * 8, 0.16 * values**2)
    # Disoccluded: 8 twice, and the third follows from the difference of the two.
    third = rounded(8.0, 0.8 * 0.08**2 + 0.16 * np.subtract.outer(values, values) ** 2)
    for start, frame, counts, weight in (
        ("cold", 1, second, chances),
        ("disoccluded", 2, third, np.outer(chances, chances)),
    ):
        mean = np.sum(weight * counts)
        deviation = np.sqrt(np.sum(weight * (counts - mean) ** 2))
        found = circles[kappa, start][0][frame].mean()
        assert abs(found - mean) < 4 * deviation / np.sqrt(PIXELS)


@pytest.mark.parametrize("kappa", [0.0, 1.0])
def test_a_cold_start_takes_26_frames_to_the_target(circles, kappa):
    below = circles[kappa, "cold"][1] <= 0.08**2
    assert below.any(axis=0).all()
    first = below.argmax(axis=0) + 1
    assert np.median(first) == 26
    # Of 20000 runs in NumPy, two decimals.
    error = first.std() * np.sqrt(1 / PIXELS + 1 / 20_000)
    assert abs(first.mean() - 26.95) < 0.005 + 4 * error
