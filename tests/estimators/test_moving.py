"""The moving moments against their weights written out, and the laws that they obey."""

import math
from fractions import Fraction
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.estimators import moving

NAMES = ("ema", "emv", "emc", "emcm", "ewma_covariance")
every_name = pytest.mark.parametrize("name", NAMES)
every_method = pytest.mark.parametrize("method", moving.METHODS)
# A law is tried on all of them with each stream: drawing streams takes longer than the moments.
EVERY = [(name, method) for name in NAMES for method in moving.METHODS]

# One shape of stream, so that each function is compiled once; no power of two, for the tree's odd ends.
T = 7

# How large rounding gets, to first order. u = eps / 2, a = alpha, A and Q are the moving averages of |z| and
# z^2, both at least (1 - a)^k times what they were k samples ago.
#
# "scan", mean: a step rounds difference, product and sum, rho <= 2 u a |x - m| + u |m'| <= 3 u A for a <= 1/2
# (and beyond, where it starts from the new sample: 2 u (1 - a) |x - m|). What one step loses fades as A may:
# 3 u T A = 1.5 T eps A.
# "scan", covariance: the increments a (1 - a) dx dy round by 7 u at most, once each; held values by 2 u a c
# and the sum by u c', each step: at most (2 T + 7) u sqrt(Qx Qy). An error rho of the mean at time j enters
# all later increments, which telescope to (1 - a)^(n - j) rho (m_n - m_j), for x and for y; with
# (1 - a)^(n - j) A_j (A_n + A_j) <= 2 Q that is 12 u Q for each of T - 1 steps: 7 (T - 1) + 3.5 < 8 T eps.
# "associative", mean: a stretch of p samples joined by q later ones costs (2 p + 4 q + 6) u A at most, mostly
# for the rounded weights. With p = q = 1, 2, .. going up and p + q <= T, q = .., 2, 1 going down that is
# (T L + 5 T + 6 L) eps A, L = log2(T), for many samples, and 37 eps A for 7: below 1.5 (L + 4) T.
# "associative", covariance: means are off each on their own, so that Cauchy-Schwarz and Hardy's inequality
# (sum_i a (1 - a)^(n - i) A_i^2 <= 5 Q) give 2 sqrt(5) times that; the sums of squares add 2 T + 2 L + 4.
# For 7 samples 190 eps Q, below 8 (L + 4) T.
# The lagged products are the same over 1 - a.
FACTOR = {"ema": 1.5} | dict.fromkeys(NAMES[1:], 8.0)


def slowdown(method, count=T):
    """How many times the rounding of "scan" a method is allowed."""
    return 1 if method == "scan" else math.ceil(math.log2(count)) + 4


@pytest.fixture
def fine_float64():
    if np.finfo(np.longdouble).eps > 2.0**-60:
        pytest.skip("long double is no finer than float64 on this machine")


class Explicit(NamedTuple):
    """What the weights say after each sample, in extended precision."""

    weights: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    lagged: np.ndarray
    size: np.ndarray
    size_of_squares: np.ndarray


def explicit(zs, alpha):
    """w_0 = (1 - a)^n, w_i = a (1 - a)^(n - i), and the weighted sums by their definitions; (T, n)."""
    zs, alpha = np.asarray(zs).astype(np.longdouble), np.longdouble(alpha)
    times = np.arange(len(zs))
    age = np.subtract.outer(times, times)
    fading = np.where(age >= 0, alpha * (1 - alpha) ** np.maximum(age, 0), 0)
    weights = fading.copy()
    weights[:, 0] = (1 - alpha) ** times
    mean = weights @ zs
    from_mean = zs[None] - mean[:, None]
    covariance = np.einsum("ni,nij,nik->njk", weights, from_mean, from_mean)
    from_earlier = np.concatenate([0 * zs[:1], zs[1:] - mean[:-1]])
    lagged = np.einsum("ni,ij,ik->njk", fading, from_earlier, from_earlier)
    root = np.sqrt(weights @ zs**2)
    return Explicit(
        weights, mean, covariance, lagged, weights @ np.abs(zs), root[:, :, None] * root[:, None, :]
    )


def part(name, matrix):
    """What a statistic of the pair (x, y) shows of their matrix."""
    if name == "emv":
        return np.diagonal(matrix, axis1=-2, axis2=-1)
    return matrix[..., 0, 1] if name == "emc" else matrix


def expected(name, zs, alpha):
    """The statistic by its weights, and what its rounding is relative to."""
    by_weights = explicit(zs, alpha)
    if name == "ema":
        return by_weights.mean, by_weights.size
    if name == "ewma_covariance":
        return by_weights.lagged, by_weights.size_of_squares / (1 - np.longdouble(alpha))
    return part(name, by_weights.covariance), part(name, by_weights.size_of_squares)


def limit(name, method, size, dtype):
    return FACTOR[name] * slowdown(method, len(size)) * len(size) * float(np.finfo(dtype).eps) * size


@cache
def whole(name, method):
    """The compiled function of a stream of pairs (T, 2) and alpha."""
    function = getattr(moving, name)
    if name == "emc":
        return jax.jit(lambda zs, alpha: function(zs[:, 0], zs[:, 1], alpha, method=method))
    return jax.jit(lambda zs, alpha: function(zs, alpha, method=method))


def found(name, method, zs, alpha):
    values = whole(name, method)(zs, alpha)
    assert values.dtype == zs.dtype
    return np.asarray(values)


def samples(name, zs):
    """A stream of pairs as `scan` takes it."""
    return (zs[..., 0], zs[..., 1]) if name == "emc" else zs


def stream(seed, kind, offset):
    """Pairs around a mean: noise, growing, fading, on a line, or with a first sample far away."""
    rng = np.random.default_rng(seed)
    zs = rng.normal(size=(T, 2))
    if kind in ("growing", "fading"):
        zs *= 10.0 ** ((1 if kind == "growing" else -1) * rng.uniform(0, 0.5) * np.arange(T)[:, None])
    if kind == "line":
        zs[:, 1] = -0.7 * zs[:, 0]
    if kind == "glint":
        zs[0] *= 10.0 ** rng.uniform(1, 5)
    return (zs + offset) * 10.0 ** rng.uniform(-3, 3)


streams = st.builds(
    stream,
    st.integers(0, 2**32 - 1),
    st.sampled_from(["noise", "growing", "fading", "line", "glint"]),
    st.sampled_from([0.0, 1.0, -300.0]),
)
light = st.one_of(st.floats(1e-6, 0.5), st.floats(-6, -0.4).map(lambda e: 10.0**e))
heavy = st.one_of(st.floats(0.5, 0.999), st.floats(-5, -0.4).map(lambda e: 1 - 10.0**e))
every_weight = st.one_of(light, heavy, st.just(1.0))


def assert_weighted_sums(names, methods, zs, alpha):
    for name in names:
        value, size = expected(name, zs, alpha)
        for method in methods:
            error = np.abs(found(name, method, zs, alpha) - value)
            assert np.all(error <= limit(name, method, size, zs.dtype)), (name, method)


@given(zs=streams, alpha=light)
def test_a_moment_is_its_weighted_sum(dtype, fine_reference, zs, alpha):
    assert_weighted_sums(NAMES, moving.METHODS, zs.astype(dtype), dtype.type(alpha))


# Here old values nearly vanish, and must do so without leaving their rounding behind.
@every_method
@every_name
@given(zs=streams, alpha=heavy)
def test_a_moment_is_its_weighted_sum_where_the_newest_sample_weighs_most(
    dtype, fine_reference, name, method, zs, alpha
):
    assert_weighted_sums([name], [method], zs.astype(dtype), dtype.type(alpha))


@every_method
@every_name
def test_a_flash_vanishes_as_the_weights_say(dtype, fine_reference, name, method):
    zs, alpha = np.zeros((T, 2), dtype), dtype.type(0.999)
    zs[0] = 1.1, 0.9
    value, size = expected(name, zs, alpha)
    # Five samples; later ones underflow in float32.
    error = np.abs(found(name, method, zs, alpha) - value)[:5]
    assert np.all(error <= limit(name, method, size[:5], dtype))


def test_with_compensation_a_flash_vanishes_no_worse(dtype, fine_reference):
    zs, alpha = np.zeros((T, 2), dtype), dtype.type(0.999)
    zs[0] = 1.1, 0.9
    value, size = expected("emv", zs, alpha)
    variances = np.asarray(moving.scan("emv", zs, alpha, compensated=True)[1])
    error = np.abs(variances - value)[:5]
    assert np.all(error <= limit("emv", "scan", size[:5], dtype))


@given(zs=streams, alpha=every_weight)
def test_the_mean_keeps_to_its_documented_bound(dtype, fine_reference, zs, alpha):
    # One step rounds by (2 alpha + 1/2) eps max |x|, and 1 / alpha of them are remembered.
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    mean, largest = explicit(zs, alpha).mean, np.max(np.abs(zs.astype(float)), axis=0)
    for method in moving.METHODS:
        bound = 2.5 * slowdown(method) * min(T, 1 / float(alpha)) * float(np.finfo(dtype).eps) * largest
        assert np.all(np.abs(found("ema", method, zs, alpha) - mean) <= bound), method


@every_method
def test_a_first_sample_far_away_is_forgotten(fine_float64, method):
    # A glint of 10^9 deviations; after 60 halvings nothing is left of it, nor of what it rounded off.
    zs = np.random.default_rng(2).normal(size=(100, 1))
    zs[0] = 1e9
    zs, alpha = zs.astype(np.float32), np.float32(0.5)
    by_weights = explicit(zs, alpha)
    variances = np.asarray(moving.emv(zs, alpha, method=method))
    bound = limit("emv", method, by_weights.size_of_squares[..., 0], np.float32)
    assert np.all(np.abs(variances - by_weights.covariance[..., 0]) <= bound)
    assert variances[1, 0] > 1e17 and variances[-1, 0] < 10


# --- Units, offsets, order ---


@given(zs=streams, alpha=every_weight, powers=st.tuples(st.integers(-12, 12), st.integers(-12, 12)))
def test_powers_of_two_scale_to_the_bit(dtype, zs, alpha, powers):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    scales = np.array([2.0**p for p in powers], dtype)
    for name, method in EVERY:
        units = scales if name == "ema" else part(name, np.multiply.outer(scales, scales))
        scaled = found(name, method, zs * scales, alpha)
        np.testing.assert_array_equal(scaled, units * found(name, method, zs, alpha), name)


@given(zs=streams, alpha=every_weight)
def test_mirrored_samples_have_the_mirrored_mean_and_the_same_moments(dtype, zs, alpha):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    for name, method in EVERY:
        same = (-1 if name == "ema" else 1) * found(name, method, zs, alpha)
        np.testing.assert_array_equal(found(name, method, -zs, alpha), same, name)


@given(zs=streams, alpha=light, scale=st.floats(0.01, 100), offset=st.floats(-100, 100))
def test_other_units_and_offsets_change_the_moments_as_they_must(
    dtype, fine_reference, zs, alpha, scale, offset
):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    exact = np.longdouble(scale) * zs.astype(np.longdouble) + np.longdouble(offset)
    moved = exact.astype(dtype)
    for name in NAMES:
        size, moved_size = (expected(name, values, alpha)[1] for values in (zs, moved))
        degree = 1 if name == "ema" else 2
        # The moved samples are rounded by u |z|: that moves a mean by u A and a covariance by 2 u Q.
        given = degree * float(np.finfo(dtype).eps) / 2 * moved_size
        for method in moving.METHODS:
            old, new = (found(name, method, values, alpha).astype(np.longdouble) for values in (zs, moved))
            rule = scale**degree * old + (offset if degree == 1 else 0)
            bound = limit(name, method, moved_size + scale**degree * size, dtype) + given
            assert np.all(np.abs(new - rule) <= bound), (name, method)


@given(
    zs=streams,
    alpha=light,
    places=st.tuples(st.integers(0, T - 1), st.integers(0, T - 1)).filter(lambda pair: pair[0] < pair[1]),
)
def test_exchanged_samples_exchange_their_weights(dtype, fine_reference, zs, alpha, places):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    exchanged = zs.copy()
    exchanged[list(places)] = zs[list(places[::-1])]
    by_weights = explicit(zs, alpha)
    early, late = (zs[place].astype(np.longdouble) for place in places)
    gained = by_weights.weights[-1, places[0]] - by_weights.weights[-1, places[1]]
    # The weighted sums of z and of z z' lose one sample and gain the other.
    mean, change = by_weights.mean[-1], gained * (late - early)
    squares = gained * (np.outer(late, late) - np.outer(early, early))
    changes = squares - np.outer(mean + change, mean + change) + np.outer(mean, mean)
    for name in NAMES:
        rule = change if name == "ema" else part(name, changes)
        if name == "ewma_covariance":
            rule = rule / (1 - np.longdouble(alpha))
        sizes = expected(name, zs, alpha)[1] + expected(name, exchanged, alpha)[1]
        for method in moving.METHODS:
            old, new = (found(name, method, values, alpha)[-1].astype(float) for values in (zs, exchanged))
            error = np.abs(new - old - rule)
            assert np.all(error <= limit(name, method, sizes, dtype)[-1]), (name, method)


@given(zs=streams, later=streams, alpha=every_weight, now=st.integers(1, T - 1))
def test_an_estimate_knows_nothing_of_later_samples(dtype, zs, later, alpha, now):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    other = np.concatenate([zs[:now], later.astype(dtype)[now:]])
    for name, method in EVERY:
        known = found(name, method, zs, alpha)[:now]
        np.testing.assert_array_equal(found(name, method, other, alpha)[:now], known, name)


@given(zs=streams, alpha=every_weight)
def test_estimates_of_a_prefix_are_the_prefix_of_the_estimates(dtype, zs, alpha):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    for name in NAMES:
        prefix = found(name, "scan", zs, alpha)[:4]
        np.testing.assert_array_equal(found(name, "scan", zs[:4], alpha), prefix, name)


# --- In parts, one at a time, in parallel ---


@cache
def in_one(name):
    return jax.jit(lambda zs, alpha: moving.scan(name, samples(name, zs), alpha))


@cache
def in_halves(name):
    """The first half by `scan`, and the rest by updates of the state that it leaves."""

    def run(zs, alpha):
        state, first = moving.scan(name, samples(name, zs[: T // 2]), alpha)

        def step(state, z):
            state = moving.update(state, samples(name, z), alpha=alpha)
            return state, moving.estimate(state)

        state, second = jax.lax.scan(step, state, zs[T // 2 :])
        return state, jnp.concatenate([first, second])

    return jax.jit(run)


@given(zs=streams, alpha=every_weight)
def test_two_halves_make_the_whole_to_the_bit(dtype, zs, alpha):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    for name in NAMES:
        parts, together = in_halves(name)(zs, alpha), in_one(name)(zs, alpha)
        assert jax.tree.structure(parts) == jax.tree.structure(together)
        for one, other in zip(jax.tree.leaves(parts), jax.tree.leaves(together), strict=True):
            np.testing.assert_array_equal(one, other, name)
        np.testing.assert_array_equal(together[1], found(name, "scan", zs, alpha), name)


@cache
def one_at_a_time(name):
    return jax.jit(lambda state, z, alpha: moving.update(state, samples(name, z), alpha=alpha))


@every_name
@pytest.mark.parametrize("alpha", [0.05, 0.7, 1.0])
def test_updates_by_hand_are_the_whole_stream(dtype, name, alpha):
    zs = (3 + np.random.default_rng(3).normal(size=(T, 2))).astype(dtype)
    alpha = dtype.type(alpha)
    # The same operations, of which a compiler may fuse some: as much as one of them rounds a value, which
    # is below 4 max z^2 for lagged products, is one part in 8 of the bound for all roundings.
    power = 1 if name == "ema" else 2
    bound = 8 * T * float(np.finfo(dtype).eps) * (2 * np.max(np.abs(zs))) ** power
    state = moving.init(name, samples(name, zs[0]))
    assert np.all(np.isnan(moving.estimate(state))) and np.all(np.isnan(moving.mean(state)))
    for z, value in zip(zs, found(name, "scan", zs, alpha), strict=True):
        state = one_at_a_time(name)(state, z, alpha)
        assert np.all(np.abs(moving.estimate(state) - value) <= bound)
    assert np.all(np.abs(moving.mean(state) - found("ema", "scan", zs, alpha)[-1]) <= bound)


@given(zs=streams, alpha=light)
def test_both_methods_agree(dtype, fine_reference, zs, alpha):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    for name in NAMES:
        size = expected(name, zs, alpha)[1]
        difference = np.abs(found(name, "scan", zs, alpha) - found(name, "associative", zs, alpha))
        bound = sum(limit(name, method, size, dtype) for method in moving.METHODS)
        assert np.all(difference <= bound), name


# --- One statistic by another ---


@given(zs=streams, alpha=every_weight)
def test_the_matrix_holds_the_variances_and_the_covariance(dtype, fine_reference, zs, alpha):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    size = explicit(zs, alpha).size_of_squares
    for method in moving.METHODS:
        matrices = found("emcm", method, zs, alpha)
        for name in ("emv", "emc"):
            # Another program, whose products and sums may be fused otherwise: both round within the bound.
            bound = 2 * limit(name, method, part(name, size), dtype)
            assert np.all(np.abs(part(name, matrices) - found(name, method, zs, alpha)) <= bound), method
        assert np.all(part("emv", matrices) >= 0)
        np.testing.assert_array_equal(matrices[0], 0)
        for values in (matrices, found("ewma_covariance", method, zs, alpha)):
            np.testing.assert_array_equal(values, np.swapaxes(values, 1, 2))


@given(seed=st.integers(0, 2**32 - 1))
def test_the_matrix_is_exactly_so_where_nothing_is_rounded(x64, seed):
    # Means are multiples of 2^-6 below 16; their squares and these halved 7 times fit into 53 bits.
    zs, alpha = np.random.default_rng(seed).integers(-15, 16, (T, 2)).astype(float), 0.5
    matrices = found("emcm", "scan", zs, alpha)
    for name in ("emv", "emc"):
        np.testing.assert_array_equal(part(name, matrices), found(name, "scan", zs, alpha))
    np.testing.assert_array_equal(found("ewma_covariance", "scan", zs, alpha), 2 * matrices)
    np.testing.assert_array_equal(matrices, explicit(zs, alpha).covariance.astype(float))


@given(zs=streams, alpha=every_weight)
def test_no_eigenvalue_is_below_the_documented_bound(dtype, fine_reference, zs, alpha):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    for method in moving.METHODS:
        matrices = found("emcm", method, zs, alpha).astype(np.longdouble)
        xx, xy, yy = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
        largest = (xx + yy + np.hypot(xx - yy, 2 * xy)) / 2
        least = np.divide(xx * yy - xy**2, largest, out=np.zeros_like(xx), where=largest > 0)
        steps = 5 * 2 * min(T, 1 / float(alpha))
        lowest = -steps * float(np.finfo(dtype).eps) * np.maximum.accumulate(xx + yy)
        assert np.all(least >= lowest), method


@every_method
@given(zs=streams, alpha=light)
def test_the_lagged_matrix_is_larger_by_the_weight_of_the_past(dtype, fine_reference, method, zs, alpha):
    zs, alpha = zs.astype(dtype), dtype.type(alpha)
    size = explicit(zs, alpha).size_of_squares
    error = limit("emcm", method, size, dtype)
    past = 1 - np.longdouble(alpha)
    matrices = found("emcm", method, zs, alpha).astype(np.longdouble)
    lagged = found("ewma_covariance", method, zs, alpha) * past
    assert np.all(np.abs(lagged - matrices) <= 2 * error)
    # So is the coefficient Sxy / Syy, where Syy is larger than its own error.
    known = matrices[:, 1, 1] > 4 * error[:, 1, 1]
    one, other = (m[known, 0, 1] / m[known, 1, 1] for m in (matrices, lagged))
    # A quotient is off by (error above + |quotient| error below) / what is below.
    off = (error[known, 0, 1] + np.abs(one) * error[known, 1, 1]) / (
        matrices[known, 1, 1] - 2 * error[known, 1, 1]
    )
    assert np.all(np.abs(one - other) <= 2 * off)


@every_method
@given(zs=streams)
def test_a_weight_of_one_keeps_the_newest_sample_alone(dtype, method, zs):
    zs, alpha = zs.astype(dtype), dtype.type(1)
    np.testing.assert_array_equal(found("ema", method, zs, alpha), zs)
    for name in ("emv", "emc", "emcm"):
        np.testing.assert_array_equal(found(name, method, zs, alpha), 0)
    steps = np.concatenate([0 * zs[:1], np.diff(zs, axis=0)])
    np.testing.assert_array_equal(
        found("ewma_covariance", method, zs, alpha), steps[:, :, None] * steps[:, None, :]
    )


# --- Values from elsewhere ---

# alpha: mean x, mean y, covariance, variance x, variance y, by the weights in extended precision.
XS, YS = (1, 2, 4, 7, 11), (2, 1, 5, 3, 8)
PRINTED = {
    0.2: (4.4464, 3.6416, 8.35198976, 15.13672704, 5.91954944),
    0.05: (1.96324375, 2.44000625, 3.22442297972656, 6.23115522808594, 2.10288824996094),
    1e-6: (
        1.00001999998500,
        2.00000899999600,
        7.39997990002210e-5,
        1.45999543000612e-4,
        4.69998970000840e-5,
    ),
}


def beginning(samples, dtype):
    """A stream of T pairs that starts with these; what follows does not matter, as tested above."""
    return np.concatenate([samples, np.ones((T - len(samples), 2))]).astype(dtype)


@every_method
@pytest.mark.parametrize("alpha", PRINTED)
def test_printed_values(x64, method, alpha):
    zs, last = beginning(np.stack([XS, YS], axis=-1), float), len(XS) - 1
    matrix = found("emcm", method, zs, alpha)[last]
    values = (*found("ema", method, zs, alpha)[last], matrix[0, 1], matrix[0, 0], matrix[1, 1])
    # 15 digits are given, and the small variances are of samples around 1: their own rounding is 1e-16.
    for value, printed in zip(values, PRINTED[alpha], strict=True):
        assert float(value) == pytest.approx(printed, rel=2e-14, abs=2e-16)


def fractions_of(alpha):
    """The five numbers above, exactly."""
    count = len(XS)
    weights = [alpha * (1 - alpha) ** (count - 1 - i) for i in range(count)]
    weights[0] = (1 - alpha) ** (count - 1)
    assert sum(weights) == 1

    def average(values):
        return sum(w * v for w, v in zip(weights, values, strict=True))

    mu, nu = average(XS), average(YS)

    def covariance(a, b):
        return average([p * q for p, q in zip(a, b, strict=True)]) - average(a) * average(b)

    return mu, nu, covariance(XS, YS), covariance(XS, XS), covariance(YS, YS)


@pytest.mark.parametrize("alpha", PRINTED)
def test_the_printed_values_are_those_of_the_weights(alpha):
    # The decimal alpha as written, in rational numbers; the last of 15 digits may be rounded either way.
    for value, printed in zip(fractions_of(Fraction(str(alpha))), PRINTED[alpha], strict=True):
        assert float(value) == pytest.approx(printed, rel=5e-15)


@every_method
def test_a_case_by_hand_is_exact(dtype, method):
    # Weights 9/16, 3/16, 1/4: all numbers on the way are short binary fractions.
    zs, alpha = beginning([[1, 2], [2, 0], [4, 1]], dtype), dtype.type(0.25)
    by_hand = np.array([[399 / 256, -69 / 128], [-69 / 128, 39 / 64]])
    np.testing.assert_array_equal(found("ema", method, zs, alpha)[2], [31 / 16, 11 / 8])
    np.testing.assert_array_equal(found("emv", method, zs, alpha)[2], np.diagonal(by_hand))
    assert found("emc", method, zs, alpha)[2] == by_hand[0, 1]
    np.testing.assert_array_equal(found("emcm", method, zs, alpha)[2], by_hand)
    np.testing.assert_array_equal(found("ewma_covariance", method, zs, alpha)[2], by_hand / 0.75)


# --- Samples that do not count ---


masks = (
    st.integers(0, 4**T - 1)
    .map(lambda bits: np.array([bits >> i & 1 for i in range(2 * T)], bool))
    .map(lambda flat: flat.reshape(T, 2))
)


@cache
def masked(name, method):
    if method == "scan":
        return jax.jit(lambda zs, alpha, valid: moving.scan(name, zs, alpha, valid=valid)[1])
    return jax.jit(lambda zs, alpha, valid: moving.associative(name, zs, alpha, valid=valid))


def by_valid_samples(name, zs, alpha, valid):
    """The statistic of the valid samples alone at each time, NaN before them, and the rounding's size."""
    value = np.full_like(expected(name, zs, alpha)[0], np.nan)
    size = np.zeros_like(value)
    if valid.any():
        kept, kept_size = expected(name, zs[valid], alpha)
        last = np.cumsum(valid) - 1
        value[last >= 0], size[last >= 0] = kept[last[last >= 0]], kept_size[last[last >= 0]]
    return value, size


@every_method
@pytest.mark.parametrize("name", ["ema", "emcm", "ewma_covariance"])
@given(zs=streams, alpha=light, valid=masks, rubbish=st.sampled_from([np.nan, np.inf, 1e300]))
def test_samples_that_do_not_count_leave_no_trace(x64, fine_float64, name, method, zs, alpha, valid, rubbish):
    valid = valid[:, 0]
    value, size = by_valid_samples(name, zs, alpha, valid)
    mask = valid[:, None] if name == "ema" else valid
    values = np.asarray(masked(name, method)(np.where(valid[:, None], zs, rubbish), alpha, mask))
    np.testing.assert_array_equal(np.isnan(values), np.isnan(value))
    started = np.cumsum(valid) > 0
    bound = limit(name, method, size, np.float64)
    assert np.all(np.abs(values - value)[started] <= bound[started])


@every_method
@given(zs=streams, alpha=light, valid=masks)
def test_pixels_have_masks_of_their_own(x64, fine_float64, method, zs, alpha, valid):
    values = np.asarray(masked("emv", method)(np.where(valid, zs, np.nan), alpha, valid))
    for pixel in range(2):
        one = slice(pixel, pixel + 1)
        value, size = by_valid_samples("emv", zs[:, one], alpha, valid[:, pixel])
        np.testing.assert_array_equal(np.isnan(values[:, one]), np.isnan(value))
        started = np.cumsum(valid[:, pixel]) > 0
        error = np.abs(values[:, one] - value)
        assert np.all(error[started] <= limit("emv", method, size, np.float64)[started])


@every_method
@pytest.mark.parametrize("name", ["ema", "emv", "emcm", "ewma_covariance"])
def test_without_a_valid_sample_nothing_is_known(x64, name, method):
    never = np.zeros((T, {"ema": 1, "emv": 2}.get(name, 0)), bool)
    values = masked(name, method)(np.ones((T, 2)), 0.2, never if never.size else np.zeros(T, bool))
    assert values.shape == ((T, 2) if name in ("ema", "emv") else (T, 2, 2))
    assert np.all(np.isnan(values))


def test_a_state_without_a_valid_sample_knows_nothing():
    x = np.ones(T, np.float32)
    state, _ = moving.scan("emc", (x, x), 0.2, valid=False)
    assert not state.started
    assert np.isnan(moving.estimate(state)) and np.all(np.isnan(moving.mean(state)))


# --- Without bias ---


@cache
def unbiased(method):
    if method == "scan":
        return jax.jit(lambda zs, alpha: moving.scan("emcm", zs, alpha, bias=False)[1])
    return jax.jit(lambda zs, alpha: moving.associative("emcm", zs, alpha, bias=False))


@pytest.mark.parametrize(
    "method, kind", [("scan", "float32"), ("scan", "float64"), ("associative", "float64")]
)
@given(zs=streams, alpha=light)
def test_without_bias_it_is_the_reliability_weighted_covariance(x64, fine_float64, method, kind, zs, alpha):
    zs, alpha = zs.astype(kind), np.dtype(kind).type(alpha)
    by_weights = explicit(zs, alpha)
    # 1 - sum w^2 without cancellation: the weights sum to 1.
    pairs = np.multiply.outer(np.arange(T), np.ones(T)) != np.arange(T)
    divisor = np.einsum("ni,nj,ij->n", by_weights.weights, by_weights.weights, pairs)[1:, None, None]
    values = np.asarray(unbiased(method)(zs, alpha))
    assert np.all(np.isnan(values[0]))
    # The divisor's recursion rounds by 13 u of itself at most, each step; |covariance| is below `size`.
    size = by_weights.size_of_squares[1:] / divisor
    bound = (8 + 6.5) * slowdown(method) * T * float(np.finfo(kind).eps) * size
    assert np.all(np.abs(values[1:] - by_weights.covariance[1:] / divisor) <= bound)


@given(seed=st.integers(0, 2**32 - 1), alpha=st.floats(0.02, 0.5))
def test_without_bias_it_is_numpys_with_reliability_weights(x64, seed, alpha):
    zs = np.random.default_rng(seed).normal(size=(T, 2))
    weights = alpha * (1 - alpha) ** np.arange(T - 1.0, -1, -1)
    weights[0] = (1 - alpha) ** (T - 1)
    theirs = np.cov(zs.T, aweights=weights, ddof=1)
    # Both divide by 1 - sum w^2 > 0.1, after T roundings or so of 10 at most.
    np.testing.assert_allclose(unbiased("scan")(zs, alpha)[-1], theirs, rtol=0, atol=1e-13)


def test_weights_of_one_over_the_number_give_the_ordinary_covariance(x64):
    zs = np.random.default_rng(4).normal(size=(T, 2))
    state = moving.init("emcm", zs[0])
    for number, z in enumerate(zs, start=1):
        state = one_at_a_time("emcm")(state, z, 1 / number)
    np.testing.assert_allclose(moving.mean(state), zs.mean(axis=0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(moving.estimate(state), np.cov(zs.T, ddof=0), rtol=0, atol=3e-15)
    np.testing.assert_allclose(moving.estimate(state, bias=False), np.cov(zs.T, ddof=1), rtol=0, atol=3e-15)
    # 1 - sum of 7 squares of 1 / 7.
    assert float(state.debias) == pytest.approx(6 / 7, rel=1e-15)


@jax.jit
def last_state(zs, alpha):
    return moving.scan("emcm", zs, alpha)[0]


@pytest.mark.parametrize("alpha", [0.05, 0.4])
def test_without_bias_it_expects_the_covariance(x64, alpha):
    count, times = 20_000, 8
    truth = np.array([[1.0, 0.6], [0.6, 2.0]])
    noise = np.random.default_rng(5).normal(size=(times, count, 2))
    zs = 3 + noise @ np.linalg.cholesky(truth).T
    state = last_state(zs, alpha)
    values = {bias: np.asarray(moving.estimate(state, bias=bias)) for bias in (True, False)}
    error = np.std(values[False], axis=0) / np.sqrt(count)
    assert np.all(np.abs(np.mean(values[False], axis=0) - truth) < 4 * error)
    # And with it, 1 - sum of the squared weights of it, which is told apart from the truth.
    squares = (1 - alpha) ** (2 * times - 2) + alpha / (2 - alpha) * (1 - (1 - alpha) ** (2 * times - 2))
    error = np.std(values[True], axis=0) / np.sqrt(count)
    assert np.all(np.abs(np.mean(values[True], axis=0) - truth * (1 - squares)) < 4 * error)
    assert np.all(np.abs(np.mean(values[True], axis=0) - truth) > 20 * error)


# --- Bounded by the variances ---


def beyond(matrices):
    """How many off-diagonal entries have a square above the product of their variances, exactly."""
    count = 0
    for row in matrices.reshape(-1, matrices.shape[-2] * matrices.shape[-1]).astype(float).tolist():
        size = matrices.shape[-1]
        exact = [Fraction(value) for value in row]
        for i in range(size):
            for j in range(i):
                count += exact[i * size + j] ** 2 > exact[i * size + i] * exact[j * size + j]
    return count


def free_and_bounded(zs):
    """The matrices as they are and bounded, of the same states."""

    def step(state, z):
        state = moving.update(state, z, alpha=0.2)
        return state, (moving.estimate(state), moving.estimate(state, bounded=True))

    state = moving.init("emcm", jnp.zeros_like(zs[0]))
    return tuple(np.asarray(values) for values in jax.jit(lambda z: jax.lax.scan(step, state, z)[1])(zs))


@pytest.mark.parametrize("kind", ["float16", "float32", "float64"])
def test_bounded_covariances_are_so_exactly(kind):
    noise = np.random.default_rng(6).normal(size=(2, T, 25))
    # Two components on a line but for their last digits, one off it; the streams at different heights.
    zs = np.stack([noise[0], noise[0] * 0.7, noise[1]], axis=-1) + np.linspace(-3, 3, 25)[:, None]
    with jax.enable_x64(kind == "float64"):
        free, bounded = free_and_bounded(jnp.asarray(zs, kind))
    assert free.dtype == bounded.dtype == kind
    # Rounding does break it.
    assert beyond(free) > 0
    assert beyond(bounded) == 0
    # What was well inside is as it was, what was not is moved by its last digits, no variance is.
    wide = free.astype(np.longdouble)
    variances = np.diagonal(wide, axis1=-2, axis2=-1)
    reach = (1 - 8 * float(np.finfo(kind).eps)) * np.sqrt(variances[..., :, None] * variances[..., None, :])
    diagonal = np.broadcast_to(np.eye(3, dtype=bool), free.shape)
    kept = (np.abs(wide) <= reach) | diagonal
    assert np.any(kept & ~diagonal & (wide != 0)) and np.any(~kept)
    np.testing.assert_array_equal(bounded[kept], free[kept])
    assert np.all(np.abs(bounded) >= np.minimum(np.abs(wide), reach))
    np.testing.assert_array_equal(np.sign(bounded), np.sign(free))
    np.testing.assert_array_equal(bounded, np.swapaxes(bounded, -1, -2))


@every_method
def test_whole_streams_are_bounded_exactly(method):
    bounded = jax.jit(lambda zs: moving.emcm(zs, 0.2, method=method, bounded=True))
    x = np.random.default_rng(7).normal(size=(25, T, 1)) + np.linspace(-3, 3, 25)[:, None, None]
    streams_on_a_line = (x * [1.0, 0.7]).astype(np.float32)
    assert sum(beyond(found("emcm", method, zs, np.float32(0.2))) for zs in streams_on_a_line) > 0
    assert sum(beyond(np.asarray(bounded(zs))) for zs in streams_on_a_line) == 0


# --- Where a stored mean stops ---


def largest_lost(mean, alpha, kind):
    """By trial: the largest x >= mean for which mean + alpha (x - mean), rounded once, is the mean."""
    patterns = {"float16": np.uint16, "float32": np.uint32}[kind]
    low = int(np.asarray(mean, kind).view(patterns))
    high = int(np.asarray(np.inf, kind).view(patterns))

    def lost(bits):
        x = np.asarray(bits, patterns).view(kind).astype(np.longdouble)
        return (np.longdouble(mean) + np.longdouble(alpha) * (x - np.longdouble(mean))).astype(kind) == mean

    assert lost(low)
    # Positive numbers are ordered as their bit patterns are, and what is lost is a range of them.
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if lost(middle) else (low, middle)
    return tuple(np.asarray(bits, patterns).view(kind).astype(float) for bits in (low, high))


@pytest.mark.parametrize("alpha", [0.75, 0.2, 0.05, 0.005, 1e-3])
@pytest.mark.parametrize("kind", ["float16", "float32"])
def test_stagnation_is_what_rounding_loses(x64, kind, alpha):
    rng = np.random.default_rng(7)
    means = np.concatenate([[0.25, 1.0, 1.5, 2.0, 3.0], rng.uniform(0.01, 30, 40)]).astype(kind)
    bounds = np.asarray(moving.stagnation(means.astype(float), alpha, kind))
    for mean, bound in zip(means, bounds, strict=True):
        last_lost, first_seen = largest_lost(mean, alpha, kind)
        # A tie is lost or not as the mean's last bit is even or odd.
        assert last_lost - float(mean) <= bound * (1 + 1e-12)
        assert first_seen - float(mean) >= bound * (1 - 1e-12)
    np.testing.assert_array_equal(moving.stagnation(-means.astype(float), alpha, kind), bounds)


def test_stagnation_at_zero_is_that_of_the_smallest_numbers(x64):
    last_lost, first_seen = largest_lost(np.float16(0), 0.005, "float16")
    bound = float(moving.stagnation(0.0, 0.005, "float16"))
    assert last_lost <= bound * (1 + 1e-12) and first_seen >= bound * (1 - 1e-12)
    # Half the smallest subnormal number over alpha.
    assert bound == pytest.approx(2.0**-25 / 0.005, rel=1e-15)


@pytest.mark.parametrize("kind", ["float16", "bfloat16"])
def test_a_mean_stays_within_its_stagnation_and_moves_beyond(kind):
    alpha, update = np.float32(0.05), one_at_a_time("ema")
    for start in (0.3, 1.5, 7.0):
        mean = jnp.asarray(start, kind)
        state = update(moving.init("ema", np.float32(0), dtype=kind), np.float32(mean), alpha)
        bound = float(moving.stagnation(mean, alpha, kind))
        # The sum is rounded to float32 before: 1 % is far more than that.
        for factor, moves in ((0.99, False), (1.01, True), (-0.99, False), (-1.01, True)):
            x = np.float32(float(mean) + factor * bound)
            after = moving.mean(update(state, x, alpha))
            assert after.dtype == kind
            assert (float(after) != float(mean)) == moves
