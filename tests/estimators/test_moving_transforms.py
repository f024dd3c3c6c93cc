"""The moving moments under JAX's transformations, in every dtype and shape, with every option."""

import logging
import re
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.estimators import moving

# Hundreds of small compilations.
pytestmark = pytest.mark.slow

T, ALPHA = 5, 0.3
ZS = np.random.default_rng(0).normal(size=(T, 2)) + [1.0, -2.0]


def whole(name, method, **options):
    """The function of a stream (T, ..., 2) and alpha; `emc` is of its two columns."""
    function = getattr(moving, name)
    if name == "emc":
        return lambda zs, alpha: function(zs[..., 0], zs[..., 1], alpha, method=method, **options)
    return lambda zs, alpha: function(zs, alpha, method=method, **options)


STATISTICS = [(name, method) for method in moving.METHODS for name in moving.STATISTICS]
every_statistic = pytest.mark.parametrize("name, method", STATISTICS)
# Parallel sums take a second to compile, and all five share them.
most_statistics = pytest.mark.parametrize("name, method", [*STATISTICS[:5], ("emcm", "associative")])
# The matrices contain the variances and the covariances.
matrices_in_parallel = pytest.mark.parametrize("name, method", [*STATISTICS[:5], *STATISTICS[-2:]])
every_name = pytest.mark.parametrize("name", moving.STATISTICS)
every_method = pytest.mark.parametrize("method", moving.METHODS)

TRACES = []


@cache
def compiled(name, method):
    """One compiled function for all tests, which counts how often it is traced."""
    function = whole(name, method)

    def traced(zs, alpha):
        TRACES.append((name, method))
        return function(zs, alpha)

    return jax.jit(traced)


# Operations are fused differently from one compiled program to the next. Any two are within the bounds of
# test_moving.py of the same weighted sum, and no weighted mean of squares is above max z^2, or that over
# 1 - alpha where it is lagged (4 max z^2 where alpha is 1).
ROUNDING = 2 * 8 * (3 + 4) * T * 4 * np.max(ZS**2)


def assert_same(found, expected):
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.shape == expected.shape and found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING * float(np.finfo(found.dtype).eps))


def like(name, shape, dtype=jnp.float32):
    """Something of the shape of a sample of scalars, pairs or vectors of 2."""
    x = jnp.zeros(shape, dtype)
    if name == "emc":
        return x, x
    return jnp.zeros((*shape, 2), dtype) if name in ("emcm", "ewma_covariance") else x


def one_sample(name, value):
    """A sample of 1, value as the second number where there are two."""
    if name == "emc":
        return jnp.float32(1), jnp.float32(value)
    return jnp.array([1, value], jnp.float32) if name in ("emcm", "ewma_covariance") else jnp.float32(value)


def bits(tree):
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree)]


# --- Transformations ---


@most_statistics
def test_jit_agrees_with_eager(name, method):
    zs = ZS.astype(np.float32)
    eager = whole(name, method)(zs, ALPHA)
    assert np.any(np.asarray(eager) != 0)
    assert_same(compiled(name, method)(zs, np.float32(ALPHA)), eager)


@most_statistics
def test_streams_in_a_batch_are_streams_alone(name, method):
    batch = (ZS[:, None] * [[1.0], [-0.5], [0.25]]).astype(np.float32)
    alphas = np.array([0.01, ALPHA, 1.0], np.float32)
    alone = compiled(name, method)
    loop = np.stack([alone(batch[:, i], alpha) for i, alpha in enumerate(alphas)], axis=1)
    assert_same(jax.jit(jax.vmap(whole(name, method), (1, 0), 1))(batch, alphas), loop)
    # A map of weights broadcasts to one sample: to numbers, or to vectors where these are the samples.
    broadcast = alphas[:, None] if name in ("ema", "emv") else alphas
    assert_same(alone(batch, broadcast), loop)
    # One weight for all, and all weights for one stream.
    one = np.stack([alone(batch[:, i], np.float32(ALPHA)) for i in range(3)], axis=1)
    assert_same(alone(batch, np.float32(ALPHA)), one)
    sweep = np.stack([alone(batch[:, 0], alpha) for alpha in alphas])
    assert_same(jax.jit(jax.vmap(whole(name, method), (None, 0)))(batch[:, 0], alphas), sweep)


@cache
def total_and_gradient(name, method):
    """The compiled sum of all values with different factors, and its gradient."""

    def total(zs, alpha):
        values = whole(name, method)(zs, alpha).ravel()
        return jnp.sum(values * jnp.cos(jnp.arange(values.size)))

    return jax.jit(jax.value_and_grad(total, (0, 1)))


@matrices_in_parallel
def test_gradients_are_difference_quotients(x64, name, method):
    run = total_and_gradient(name, method)

    def total(zs, alpha):
        return float(run(zs, alpha)[0])

    # Truncation is h^2 times a third derivative, 1e-10; rounding 1e-15 times some tens over h.
    h = 1e-5
    for alpha in (0.05, 0.7):
        in_zs, in_alpha = run(ZS, alpha)[1]
        quotient = (total(ZS, alpha + h) - total(ZS, alpha - h)) / (2 * h)
        assert float(in_alpha) == pytest.approx(quotient, rel=1e-7, abs=1e-7)
        for place in np.ndindex(ZS.shape):
            step = np.zeros_like(ZS)
            step[place] = h
            quotient = (total(ZS + step, alpha) - total(ZS - step, alpha)) / (2 * h)
            assert float(in_zs[place]) == pytest.approx(quotient, rel=1e-7, abs=1e-7)


@matrices_in_parallel
def test_gradients_at_a_weight_of_one_are_those_from_below(x64, name, method):
    run = total_and_gradient(name, method)
    # By the one-sided quotient of second order.
    h = 1e-5
    totals = [float(run(ZS, 1 - k * h)[0]) for k in range(3)]
    quotient = (3 * totals[0] - 4 * totals[1] + totals[2]) / (2 * h)
    assert abs(quotient) > 0.1
    assert float(run(ZS, 1.0)[1][1]) == pytest.approx(quotient, rel=1e-6)


@pytest.mark.parametrize("compensated", [False, True])
def test_gradients_of_last_states_at_a_weight_of_one(x64, compensated):
    def last(alpha):
        state, _ = moving.scan("emv", np.array([1.0, 3.0, 2.0]), alpha, compensated=compensated)
        return jnp.stack([moving.mean(state), moving.estimate(state)])

    # By hand: the mean is 2 - (1 - alpha) (2 - 3) and the variance 0 + (1 - alpha) (2 - 3)^2, to first order.
    np.testing.assert_array_equal(last(1.0), [2.0, 0.0])
    np.testing.assert_allclose(jax.jacrev(last)(1.0), [-1.0, -1.0], rtol=1e-15)


def test_gradients_of_bounded_matrices_are_finite():
    def total(zs):
        return jnp.sum(moving.emcm(zs, ALPHA, bounded=True))

    gradient = jax.jit(jax.grad(total))
    # A component without variance, and two on a line.
    for factors, offsets in (([1, 0], [0, 1]), ([1.0, 0.7], [0, 0])):
        zs = (ZS[:, :1] * factors + offsets).astype(np.float32)
        assert np.all(np.isfinite(gradient(zs)))


@most_statistics
def test_strict_promotion_of_ranks_and_dtypes(name, method):
    function = whole(name, method)
    zs, alpha = jnp.asarray(ZS, jnp.float32), jnp.float32(ALPHA)
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        # Promotion is refused while tracing, so shapes are all that has to be computed.
        plain = jax.eval_shape(function, zs, alpha)
        assert jax.eval_shape(function, zs, ALPHA) == plain
        gradient = jax.grad(lambda z, a: jnp.sum(function(z, a)), (0, 1))
        assert [g.shape for g in jax.eval_shape(gradient, zs, alpha)] == [zs.shape, ()]
        mapped = jax.eval_shape(jax.vmap(function, (None, 0)), zs, jnp.full(3, alpha))
        assert mapped.shape == (3, *plain.shape)


@most_statistics
def test_other_values_are_not_traced_again(name, method):
    zs, alpha = ZS.astype(np.float32), np.float32(ALPHA)
    compiled(name, method)(zs, alpha)
    before = TRACES.count((name, method))
    compiled(name, method)(zs + 1, alpha / 2)
    assert TRACES.count((name, method)) == before > 0


@most_statistics
def test_eager_calls_compile_once(name, method, caplog):
    zs, function = ZS.astype(np.float32), whole(name, method)
    function(zs, ALPHA)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        function(zs + 1, ALPHA)
    assert [record.message for record in caplog.records if "XLA compilation" in record.message] == []


# --- Dtypes ---


@most_statistics
def test_the_dtype_is_that_of_the_samples(name, method):
    function = whole(name, method)
    for kind in (jnp.float16, jnp.bfloat16, jnp.float32):
        zs = jnp.asarray(ZS, kind)
        assert jax.eval_shape(function, zs, ALPHA).dtype == kind
        with jax.enable_x64(True):
            # A weight of higher precision does not widen the result.
            assert jax.eval_shape(function, zs, np.float64(ALPHA)).dtype == kind
    for flag, known in ((False, jnp.float32), (True, jnp.float64)):
        with jax.enable_x64(flag):
            assert jax.eval_shape(function, ZS, ALPHA).dtype == known
            assert jax.eval_shape(function, ZS.astype(int), ALPHA).dtype == known


@most_statistics
def test_half_formats_are_computed_in_float32(name, method):
    zs = jnp.asarray(ZS, jnp.float16)
    wide = np.asarray(compiled(name, method)(zs.astype(jnp.float32), np.float32(ALPHA)))
    narrow = np.asarray(compiled(name, method)(zs, np.float32(ALPHA)))
    assert narrow.dtype == np.float16
    # Each sample rounds what is stored, by u = 2^-11 of the mean or of the moment itself, which then fades;
    # a mean off by d changes a covariance by 2 d |m_n - m_j| < 4 d max |z|, over 1 - alpha if lagged.
    largest, rounding = float(np.max(np.abs(ZS))), 2.0**-11 * min(T, 1 / ALPHA)
    bound = rounding * (largest if name == "ema" else 6 * largest**2 / (1 - ALPHA))
    np.testing.assert_allclose(narrow.astype(np.float32), wide, rtol=0, atol=bound)


@pytest.mark.parametrize(
    "name, stream, expected",
    [
        ("ema", [1.0, 2.0, 4.0], 2.75),
        ("emv", [1, 2, 4], 1.6875),
        ("emv", np.array([1, 2, 4]), 1.6875),
        ("emc", ([1.0, 3.0], [2.0, 1.0]), -0.5),
        ("emc", (np.array([1, 3]), np.array([2, 1])), -0.5),
        ("emcm", [[1.0, 2.0], [3.0, 1.0]], [[1.0, -0.5], [-0.5, 0.25]]),
        ("ewma_covariance", [[1, 2], [3, 1]], [[2.0, -1.0], [-1.0, 0.5]]),
    ],
)
def test_lists_and_integers_are_samples(name, stream, expected):
    _, values = moving.scan(name, stream, 0.5)
    assert values[-1].tolist() == expected
    assert moving.associative(name, stream, 0.5)[-1].tolist() == expected


# --- Shapes ---


@every_method
@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (2, 1, 4)])
def test_shapes(method, shape):
    xs, zs = jnp.zeros((T, *shape)), jnp.zeros((T, *shape, 2))
    for name in ("ema", "emv"):
        function = whole(name, method)
        assert jax.eval_shape(lambda xs, function=function: function(xs, ALPHA), xs).shape == (T, *shape)
    found = jax.eval_shape(lambda xs: moving.emc(xs, jnp.zeros((T, *shape)), ALPHA, method=method), xs)
    assert found.shape == (T, *shape)
    for name in ("emcm", "ewma_covariance"):
        function = whole(name, method)
        found = jax.eval_shape(lambda zs, function=function: function(zs, ALPHA), zs)
        assert found.shape == (T, *shape, 2, 2)


@every_method
def test_covariances_broadcast_their_streams(method):
    zs = ZS.astype(np.float32)
    together = moving.emc(zs, zs[:, :1], ALPHA, method=method)
    assert together.shape == (T, 2)
    for i in range(2):
        assert_same(together[:, i], moving.emc(zs[:, i], zs[:, 0], ALPHA, method=method))


@every_method
def test_streams_of_no_and_of_one_sample(method):
    for count in (0, 1):
        zs = np.full((count, 3, 2), 5.0, np.float32)
        mean = np.asarray(moving.ema(zs, ALPHA, method=method))
        np.testing.assert_array_equal(mean, zs)
        for name in ("emv", "emc", "emcm", "ewma_covariance"):
            values = np.asarray(whole(name, method)(zs, ALPHA))
            shape = {"emv": (3, 2), "emc": (3,)}.get(name, (3, 2, 2))
            np.testing.assert_array_equal(values, np.zeros((count, *shape), np.float32))
    options = {"valid": np.zeros((0, 3), bool), "bias": False}
    if method == "scan":
        state, values = moving.scan("emcm", np.zeros((0, 3, 2)), ALPHA, **options)
        assert bits(state) == bits(moving.init("emcm", np.zeros((3, 2))))
    else:
        values = moving.associative("emcm", np.zeros((0, 3, 2)), ALPHA, **options)
    assert values.shape == (0, 3, 2, 2)


@every_name
def test_the_mean_of_every_statistic(name):
    state = moving.init(name, like(name, (4,)))
    x = jax.tree.map(lambda v: v + 3, like(name, (4,)))
    state = moving.update(state, x, alpha=ALPHA)
    found = moving.mean(state)
    assert found.shape == {"ema": (4,), "emv": (4,), "emc": (2, 4)}.get(name, (4, 2))
    np.testing.assert_array_equal(found, 3)
    value = moving.estimate(state)
    assert value.shape == ((4, 2, 2) if name in ("emcm", "ewma_covariance") else (4,))
    np.testing.assert_array_equal(value, 3 if name == "ema" else 0)


# --- The state as a carry ---


@every_name
@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("kind", [jnp.bfloat16, jnp.float32, jnp.float64])
def test_an_updated_state_is_of_the_same_kind(name, compensated, kind):
    with jax.enable_x64(kind == jnp.float64):
        for shape, weights_shape in (((), None), ((3,), None), ((3,), ())):
            state = moving.init(
                name,
                like(name, shape, kind),
                compensated=compensated,
                weights_shape=weights_shape,
            )
            assert (state.low is not None) == compensated
            assert all(m.dtype == kind and m.shape == shape for m in (*state.mean, *state.products))
            assert state.started.shape == (shape if weights_shape is None else weights_shape)
            before = [jax.typeof(leaf) for leaf in jax.tree.leaves(state)]
            for alpha, valid in ((ALPHA, None), (np.float32(ALPHA), True), (jnp.asarray(ALPHA), None)):

                def update(state, x, alpha=alpha, valid=valid):
                    return moving.update(state, x, alpha=alpha, valid=valid)

                after = jax.eval_shape(update, state, like(name, shape, kind))
                assert jax.tree.structure(after) == jax.tree.structure(state)
                kinds = [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(after)]
                assert kinds == [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in before]


@every_name
def test_updates_are_traced_once(name):
    traces = []

    @jax.jit
    def update(state, x, alpha):
        traces.append(1)
        return moving.update(state, x, alpha=alpha)

    # Numbers of Python, from which a state could inherit a weak dtype.
    numbers: dict[str, Any] = {"ema": 0.0, "emv": 0.0, "emc": (0.0, 0.0)}
    state = moving.init(name, numbers.get(name, [0.0, 0.0]))
    for value in (1.0, 2.0, 3.0):
        state = update(state, one_sample(name, value), value / 10)
    assert len(traces) == 1


# --- valid ---


@every_name
@pytest.mark.parametrize("compensated, kind", [(False, jnp.float32), (True, jnp.float16)])
def test_a_sample_that_does_not_count_leaves_the_state_to_the_bit(name, compensated, kind):
    update = jax.jit(lambda s, x, valid: moving.update(s, x, alpha=ALPHA, valid=valid))
    empty = moving.init(name, one_sample(name, 0.0), dtype=kind, compensated=compensated)
    filled = empty
    for value in (1.5, -0.3, 1 / 3):
        filled = update(filled, one_sample(name, value), True)
    assert bits(filled) != bits(empty)
    for state in (empty, filled):
        for rubbish in (np.nan, np.inf, -np.inf, 3e38):
            assert bits(update(state, one_sample(name, rubbish), False)) == bits(state)
    assert bits(update(filled, one_sample(name, 0.7), True)) != bits(filled)


def test_pixels_count_on_their_own():
    empty = moving.init("emv", np.zeros(3, np.float32))
    once = moving.update(empty, np.array([1, 2, 3], np.float32), alpha=0.5)
    twice = moving.update(
        once, np.array([np.nan, 4, np.inf], np.float32), alpha=0.5, valid=np.array([False, True, False])
    )
    assert moving.mean(twice).tolist() == [1, 3, 3]
    assert moving.estimate(twice).tolist() == [0, 1, 0]
    assert twice.started.tolist() == [True] * 3


@pytest.mark.parametrize("name, method", [*STATISTICS[:5:2], ("emcm", "scan"), ("emcm", "associative")])
def test_gradients_past_rubbish_are_finite(name, method):
    valid = np.array([False, True, True, False, True])
    rubbish = np.where(valid[:, None], ZS, [[np.nan, np.inf]] * T).astype(np.float32)
    mask = valid[:, None] if name in ("ema", "emv") else valid

    def total(zs, alpha):
        stream = (zs[:, 0], zs[:, 1]) if name == "emc" else zs
        if method == "scan":
            values = moving.scan(name, stream, alpha, valid=mask)[1]
        else:
            values = moving.associative(name, stream, alpha, valid=mask)
        # Before the first valid sample there is no number to take a gradient of.
        return jnp.sum(values[1:] ** 2)

    in_zs, in_alpha = jax.jit(jax.grad(total, (0, 1)))(rubbish, np.float32(ALPHA))
    assert np.isfinite(in_alpha) and in_alpha != 0
    assert np.all(np.isfinite(in_zs))
    np.testing.assert_array_equal(np.asarray(in_zs)[~valid], 0)
    assert np.all(np.asarray(in_zs)[valid] != 0)


# --- weights_shape, dtype, compensated ---


@every_name
def test_one_record_of_weights_serves_all_pixels(name):
    update = jax.jit(lambda s, x: moving.update(s, x, alpha=ALPHA))
    states = [moving.init(name, like(name, (4,)), weights_shape=shape) for shape in (None, ())]
    rng = np.random.default_rng(1)
    for _ in range(3):
        x = jax.tree.map(lambda v: jnp.asarray(rng.normal(size=v.shape), v.dtype), like(name, (4,)))
        states = [update(state, x) for state in states]
    many, one = states
    assert one.debias.shape == one.started.shape == () and many.debias.shape == (4,)
    np.testing.assert_array_equal(moving.mean(one), moving.mean(many))
    for bias in (True, False) if name != "ewma_covariance" else (True,):
        assert_same(moving.estimate(one, bias=bias), moving.estimate(many, bias=bias))


@pytest.mark.parametrize("argument", ["alpha", "valid"])
def test_one_record_of_weights_refuses_a_map(argument):
    state = moving.init("ema", np.zeros(4, np.float32), weights_shape=())
    values = {"alpha": ALPHA} | {argument: np.ones(4, {"alpha": float, "valid": bool}[argument])}
    with pytest.raises(ValueError, match=rf"^{argument} must .*shape \(\), got \(4,\); .*weights_shape"):
        moving.update(state, np.zeros(4, np.float32), **values)


@every_name
def test_moments_may_be_stored_in_another_dtype(name):
    stream = (ZS[:, 0], ZS[:, 1]) if name == "emc" else ZS
    state, values = moving.scan(name, jax.tree.map(np.float32, stream), ALPHA, dtype=jnp.float16)
    assert values.dtype == moving.estimate(state).dtype == moving.mean(state).dtype == jnp.float16
    assert state.debias.dtype == jnp.float32
    assert np.all(np.isfinite(values))


def test_compensation_keeps_what_rounding_loses():
    # Around 1000, a float32 holds multiples of 2^-14; with alpha = 1e-4 one increment in four is lost.
    count, alpha = 3000, np.float32(1e-4)
    xs = (1000 + np.random.default_rng(2).normal(size=count)).astype(np.float32)
    weights = np.float64(alpha) * (1 - np.float64(alpha)) ** np.arange(count - 1.0, -1, -1)
    weights[0] = (1 - np.float64(alpha)) ** (count - 1)
    mean = weights @ xs.astype(float)
    variance = weights @ (xs - mean) ** 2
    plain, compensated = (moving.scan("emv", xs, alpha, compensated=flag)[0] for flag in (False, True))
    assert compensated.low is not None
    high_and_low = float(compensated.mean[0]) + float(compensated.low[0][0])
    # Increments alpha (x - m) round by 2 u of themselves; the pairs of numbers hold the rest. u = 2^-24.
    largest = float(np.max(np.abs(xs - mean)))
    of_mean = float(alpha) * count * 2 * 2.0**-24 * largest + count * 2.0**-48 * 1000
    assert abs(high_and_low - mean) <= of_mean
    # Where the sum is stored in one float32, that cannot be met.
    assert abs(float(plain.mean[0]) - mean) > 100 * of_mean
    # The variance is of products with 7 u, and of the mean: 2 d times the deviations that it enters.
    of_variance = 8 * 2.0**-24 * float(variance) + 2 * of_mean * largest + count * 2.0**-48 * float(variance)
    whole = float(compensated.products[0]) + float(compensated.low[1][0])
    assert abs(whole - variance) <= of_variance
    # What is shown is the pair, rounded.
    assert float(moving.mean(compensated)) == float(np.float32(high_and_low))
    assert float(moving.estimate(compensated)) == float(np.float32(whole))


@every_name
def test_compensated_half_floats_are_as_good_as_float32(name):
    stream = (ZS[:, 0], ZS[:, 1]) if name == "emc" else ZS
    stream = jax.tree.map(lambda x: x.astype(np.float16).astype(np.float32), stream)
    wide, _ = moving.scan(name, stream, ALPHA)
    narrow, _ = moving.scan(name, stream, ALPHA, dtype=jnp.float16, compensated=True)
    assert narrow.low is not None
    pairs = zip(
        (*narrow.mean, *narrow.products),
        (*narrow.low[0], *narrow.low[1]),
        (*wide.mean, *wide.products),
        strict=True,
    )
    for high, low, value in pairs:
        found = np.asarray(high, np.float32) + np.asarray(low, np.float32)
        # Two half floats round by 2^-22 of the value, or 2^-25, half the smallest number, each sample.
        bound = T * 2.0**-22 * 6 * np.max(ZS**2) / (1 - ALPHA)
        np.testing.assert_allclose(found, value, rtol=0, atol=bound)
        assert np.any(np.asarray(low) != 0)


def test_an_unbiased_mean_is_the_mean():
    zs = ZS.astype(np.float32)
    for run in (
        lambda bias: moving.scan("ema", zs, ALPHA, bias=bias)[1],
        lambda bias: moving.associative("ema", zs, ALPHA, bias=bias),
    ):
        np.testing.assert_array_equal(run(False), run(True))


# --- Errors ---


@pytest.mark.parametrize(
    "alpha, shown",
    [
        (0, "0"),
        (0.0, "0"),
        (-0.1, "-0.1"),
        (1.5, "1.5"),
        (np.nan, "nan"),
        (np.float32(2), "2"),
        (np.array([0.5, 3.0]), "3"),
    ],
)
def test_a_weight_outside_its_range_is_refused(alpha, shown):
    zs = np.zeros((3, 2), np.float32)
    message = rf"alpha must be in \(0, 1\], got {shown}; it is the weight of the newest sample"
    with pytest.raises(ValueError, match=message):
        moving.update(moving.init("ema", zs[0]), zs[0], alpha=alpha)
    for method in moving.METHODS:
        with pytest.raises(ValueError, match=message):
            moving.emv(zs, alpha, method=method)


@every_name
def test_an_unknown_method_is_refused(name):
    with pytest.raises(ValueError, match="method must be one of scan, associative, got 'parallel'"):
        whole(name, "parallel")(ZS, ALPHA)


def test_an_unknown_statistic_is_refused():
    message = "statistic must be one of ema, emv, emc, emcm, ewma_covariance, got 'median'"
    for call in (
        lambda: moving.init("median", 0.0),  # pyright: ignore[reportArgumentType]
        lambda: moving.scan("median", ZS, ALPHA),  # pyright: ignore[reportArgumentType]
        lambda: moving.associative("median", ZS, ALPHA),  # pyright: ignore[reportArgumentType]
    ):
        with pytest.raises(ValueError, match=message):
            call()


def test_a_covariance_needs_a_pair():
    message = r"a sample of 'emc' must be a pair \(x, y\)"
    for sample in (0.0, np.zeros(2), (0.0, 0.0, 0.0)):
        with pytest.raises(ValueError, match=message):
            moving.init("emc", sample)
    with pytest.raises(ValueError, match=message):
        moving.scan("emc", ZS, ALPHA)
    with pytest.raises(ValueError, match=message):
        moving.update(moving.init("emc", (0.0, 0.0)), 1.0, alpha=ALPHA)


@pytest.mark.parametrize("name", ["emcm", "ewma_covariance"])
def test_a_matrix_needs_vectors(name):
    for sample in (0.0, np.zeros((3, 0))):
        with pytest.raises(ValueError, match=f"a sample of '{name}' must have its vector on the last axis"):
            moving.init(name, sample)


@every_name
def test_a_sample_of_another_shape_is_refused(name):
    state = moving.init(name, like(name, (3,)))
    for shape in ((2, 3), (4,)):
        with pytest.raises(ValueError, match=rf"^x must .*\(3,\), got {re.escape(str(shape))}"):
            moving.update(state, like(name, shape), alpha=ALPHA)
    if name in ("emcm", "ewma_covariance"):
        with pytest.raises(ValueError, match="x must have 2 components like the state, got 5"):
            moving.update(state, np.zeros((3, 5)), alpha=ALPHA)


def test_what_is_not_defined_is_refused():
    lagged = moving.init("ewma_covariance", np.zeros(2))
    with pytest.raises(ValueError, match="bias=False is not defined for 'ewma_covariance'; use 'emcm'"):
        moving.estimate(lagged, bias=False)
    for name in ("ema", "emv", "emc"):
        with pytest.raises(ValueError, match=f"bounded needs a covariance matrix, the state is of '{name}'"):
            moving.estimate(moving.init(name, like(name, ())), bounded=True)
    for run in (moving.scan, moving.associative):
        with pytest.raises(ValueError, match="bias=False is not defined"):
            run("ewma_covariance", ZS, ALPHA, bias=False)
        with pytest.raises(ValueError, match="bounded needs a covariance matrix"):
            run("emv", ZS, ALPHA, bounded=True)


@every_statistic
def test_a_stream_needs_a_time_axis(name, method):
    number = np.float32(1)
    with pytest.raises(ValueError, match="xs must have time on axis 0"):
        if name == "emc":
            moving.emc(number, number, ALPHA, method=method)
        else:
            whole(name, method)(number, ALPHA)
    if name in ("emcm", "ewma_covariance"):
        with pytest.raises(ValueError, match="xs must have time on axis 0.* vectors on the last"):
            whole(name, method)(np.zeros(3), ALPHA)
