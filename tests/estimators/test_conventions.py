"""Our moving moments against pandas, river and RiskMetrics."""

import logging
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from river import stats

from sssfit.estimators import conventions, moving

T = 30
ZS = np.random.default_rng(0).normal(size=(T, 2)) @ [[1.0, 0.4], [0.0, 0.7]] + [3.0, -1.0]
# Of numbers around 1, means and variances alike.
CLOSE = 1e-10

every_alpha = pytest.mark.parametrize("alpha", [0.01, 0.2, 0.5, 0.9, 1.0])
# Libraries and scans of every method, compiled for every weight.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("x64")]


def assert_close(found, expected, first=10):
    """Each of the first samples, where conventions differ most, and all the others together."""
    found, expected = np.asarray(found), np.asarray(expected)
    assert found.shape == expected.shape and len(found) == T
    for t in range(first):
        np.testing.assert_allclose(found[t], expected[t], rtol=0, atol=CLOSE, err_msg=f"sample {t}")
    np.testing.assert_allclose(found, expected, rtol=0, atol=CLOSE)


# --- pandas ---


@cache
def pandas_ewm(adjust, bias):
    return jax.jit(lambda zs, alpha: conventions.pandas_ewm(zs, alpha, adjust=adjust, bias=bias))


def frame(zs):
    return pd.DataFrame(zs, columns=["x", "y"])


@every_alpha
@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("adjust", [True, False])
def test_pandas_mean_variance_and_covariance(adjust, bias, alpha):
    ours = pandas_ewm(adjust, bias)(ZS, alpha)
    theirs = frame(ZS).ewm(alpha=alpha, adjust=adjust)
    assert_close(ours.mean, theirs.mean().to_numpy())
    # pandas stacks the matrices.
    assert_close(ours.covariance, theirs.cov(bias=bias).to_numpy().reshape(T, 2, 2))
    variances = np.diagonal(ours.covariance, axis1=1, axis2=2)
    assert_close(variances, theirs.var(bias=bias).to_numpy())
    # Nothing is known of a spread from one sample, nor from the newest alone.
    unknown = 0 if bias else T if alpha == 1 else 1
    assert np.sum(np.isnan(ours.covariance).all(axis=(1, 2))) == unknown


@every_alpha
@pytest.mark.parametrize("method", moving.METHODS)
def test_our_convention_is_pandas_without_adjustment_and_with_bias(method, alpha):
    theirs = frame(ZS).ewm(alpha=alpha, adjust=False)
    assert_close(moving.ema(ZS, alpha, method=method), theirs.mean().to_numpy())
    assert_close(moving.emv(ZS, alpha, method=method), theirs.var(bias=True).to_numpy())
    covariance = theirs.cov(bias=True).to_numpy().reshape(T, 2, 2)
    assert_close(moving.emcm(ZS, alpha, method=method), covariance)
    assert_close(moving.emc(ZS[:, 0], ZS[:, 1], alpha, method=method), covariance[:, 0, 1])


def test_the_conventions_are_told_apart():
    # By far more than the tolerance, from the second sample on.
    every = [pandas_ewm(adjust, bias)(ZS, 0.2) for adjust in (True, False) for bias in (True, False)]
    second = [np.asarray(values.covariance[1, 0, 0]) for values in every]
    gaps = np.abs(np.subtract.outer(second, second))[np.triu_indices(4, 1)]
    # After two samples with weights p and 1 - p the unbiased variance is half the squared difference,
    # whatever p is.
    assert np.sum(gaps > 1e4 * CLOSE) == 5 and np.min(gaps) < CLOSE
    assert abs(second[1] - (ZS[1, 0] - ZS[0, 0]) ** 2 / 2) < CLOSE
    assert np.max(np.abs(every[0].mean[1] - every[2].mean[1])) > 1e4 * CLOSE


PANDAS_PARAMETERS = [
    ("span", conventions.alpha_from_span, (1.0, 2.5, 9.0, 40.0)),
    ("com", conventions.alpha_from_center_of_mass, (0.0, 0.7, 4.0, 30.0)),
    ("halflife", conventions.alpha_from_halflife, (0.3, 1.0, 12.5, 100.0)),
]


@pytest.mark.parametrize("name, alpha_from, values", PANDAS_PARAMETERS, ids=["span", "com", "halflife"])
def test_pandas_other_parameters(name, alpha_from, values):
    for value in values:
        alpha = alpha_from(value)
        for adjust in (True, False):
            theirs = frame(ZS).ewm(**{name: value}, adjust=adjust)
            ours = pandas_ewm(adjust, True)(ZS, alpha)
            assert_close(ours.mean, theirs.mean().to_numpy())
            assert_close(ours.covariance, theirs.cov(bias=True).to_numpy().reshape(T, 2, 2))


def test_batches_and_dtypes_in_pandas_convention():
    batch = np.stack([ZS, -2 * ZS, ZS[::-1]], axis=1)
    ours = pandas_ewm(True, False)(batch, 0.2)
    assert ours.mean.shape == (T, 3, 2) and ours.covariance.shape == (T, 3, 2, 2)
    for i in range(3):
        theirs = frame(batch[:, i]).ewm(alpha=0.2)
        # 4 times as large where the samples are doubled.
        np.testing.assert_allclose(ours.mean[:, i], theirs.mean(), rtol=0, atol=CLOSE)
        covariance = theirs.cov().to_numpy().reshape(T, 2, 2)
        np.testing.assert_allclose(ours.covariance[:, i], covariance, rtol=0, atol=4 * CLOSE)
    single = jax.eval_shape(pandas_ewm(True, False), ZS.astype(np.float32), 0.2)
    assert single.mean.dtype == single.covariance.dtype == jnp.float32
    assert jax.eval_shape(pandas_ewm(True, True), ZS.astype(int), 0.2).mean.dtype == jnp.float64


def test_a_nan_stays_where_pandas_skips_it():
    zs = ZS.copy()
    zs[4, 0] = np.nan
    ours = pandas_ewm(False, True)(zs, 0.2)
    np.testing.assert_array_equal(np.isnan(ours.mean), [[t >= 4, False] for t in range(T)])
    assert not np.isnan(frame(zs).ewm(alpha=0.2, adjust=False).mean().to_numpy()).any()


@pytest.mark.parametrize("function", [lambda z: conventions.pandas_ewm(z, 0.2), conventions.riskmetrics])
def test_eager_calls_compile_once(function, caplog):
    function(ZS)
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        function(ZS + 1)
    assert [record.message for record in caplog.records if "XLA compilation" in record.message] == []


def test_pandas_convention_refuses_what_is_no_weight():
    for alpha in (0.0, 1.5, np.nan):
        with pytest.raises(ValueError, match=r"alpha must be in \(0, 1\], got"):
            conventions.pandas_ewm(ZS, alpha)
    with pytest.raises(ValueError, match="zs must have at least one vector, got none"):
        conventions.pandas_ewm(ZS[:0], 0.2)
    with pytest.raises(
        ValueError, match=r"alpha must be one number for pandas' convention, got shape \(2,\)"
    ):
        conventions.pandas_ewm(ZS, np.array([0.1, 0.2]))


# --- river ---


def river_values(statistic, *columns):
    values = []
    for row in zip(*columns, strict=True):
        statistic.update(*(float(v) for v in row))
        values.append(statistic.get())
    return np.array(values)


@every_alpha
@pytest.mark.parametrize("method", moving.METHODS)
def test_river(method, alpha):
    x, y = ZS.T
    ours = float(conventions.alpha_from_fading_factor(alpha))
    assert_close(moving.ema(x, ours, method=method), river_values(stats.EWMean(alpha), x))
    assert_close(moving.emv(x, ours, method=method), river_values(stats.EWVar(alpha), x))
    assert_close(moving.emc(x, y, ours, method=method), river_values(stats.EWCov(alpha), x, y))


@pytest.mark.parametrize("method", moving.METHODS)
def test_a_large_mean_costs_river_the_variance_and_us_nothing(method):
    alpha, level = 0.2, 1e8
    xs = level + np.random.default_rng(1).normal(size=T)
    # The same weights in extended precision, about the first sample, which loses nothing.
    weight = np.longdouble(alpha)
    deviations = xs.astype(np.longdouble) - np.longdouble(xs[0])
    age = np.subtract.outer(np.arange(T), np.arange(T))
    weights = np.where(age >= 0, weight * (1 - weight) ** np.maximum(age, 0), 0)
    weights[:, 0] = (1 - weight) ** np.arange(T)
    mean = weights @ deviations
    truth = (weights @ deviations**2 - mean**2).astype(float)
    ours = np.asarray(moving.emv(xs, alpha, method=method))
    # Each step rounds the mean by half an ulp of 10^8, at most 1 / alpha of which last. Where the means
    # are off by d, variances are by 2 sqrt(V) d + d^2. In parallel a mean is one of log2(30) + 4 sums.
    off = 2.0**-53 * level * (1 / alpha) * (1 if method == "scan" else 10)
    bound = 2 * np.sqrt(np.max(truth)) * off + off**2
    assert bound < 1e-5
    assert np.all(np.abs(ours - truth) <= bound)
    # The mean of squares is 10^16, and a float64 there has steps of 2.
    theirs = river_values(stats.EWVar(alpha), xs)
    assert np.max(np.abs(theirs - truth)) > 0.1
    # Its covariance is no better off.
    assert np.max(np.abs(river_values(stats.EWCov(alpha), xs, xs) - truth)) > 0.1


# --- RiskMetrics ---


def loop(returns, decay):
    """S_t = decay S_(t-1) + (1 - decay) r_(t-1) r_(t-1)', from the first product; nothing before it."""
    forecasts = [np.full((2, 2), np.nan), np.outer(returns[0], returns[0])]
    for r in returns[1:-1]:
        forecasts.append(decay * forecasts[-1] + (1 - decay) * np.outer(r, r))
    return np.array(forecasts)


@pytest.mark.parametrize("decay", [0.0, 0.5, 0.94, 0.97])
def test_riskmetrics_is_the_loop(decay):
    assert_close(conventions.riskmetrics(ZS, decay=decay), loop(ZS, decay))


def test_riskmetrics_days_are_the_default():
    np.testing.assert_array_equal(conventions.riskmetrics(ZS), conventions.riskmetrics(ZS, decay=0.94))


def test_a_forecast_does_not_know_its_own_return():
    forecast = jax.jit(conventions.riskmetrics)
    usual = np.asarray(forecast(ZS))
    for t in (0, 1, 7, T - 1):
        other = ZS.copy()
        other[t:] = 100.0
        changed = np.asarray(forecast(other))
        np.testing.assert_array_equal(changed[: t + 1], usual[: t + 1])
        assert np.all(changed[t + 1 :] != usual[t + 1 :])


def test_riskmetrics_has_no_mean():
    # A constant return is all risk, where a covariance about the mean sees none.
    constant = np.full((5, 2), 3.0)
    np.testing.assert_array_equal(conventions.riskmetrics(constant)[1:], 9.0)
    np.testing.assert_array_equal(moving.emcm(constant, 0.06), 0.0)


def test_riskmetrics_shapes():
    one = np.asarray(conventions.riskmetrics(ZS[:1]))
    assert one.shape == (1, 2, 2) and np.all(np.isnan(one))
    batch = np.stack([ZS, ZS[::-1]], axis=1)
    found = conventions.riskmetrics(batch)
    assert found.shape == (T, 2, 2, 2)
    for i in range(2):
        assert_close(found[:, i], loop(batch[:, i], 0.94))
    assert jax.eval_shape(conventions.riskmetrics, ZS.astype(np.float32)).dtype == jnp.float32


# --- Weights ---


def test_weights_of_the_other_parameters():
    # By their definitions: the mean age sum k a (1 - a)^k is c, and h samples halve a weight.
    ages = np.arange(20_000)
    for c in (0.0, 0.7, 4.0, 30.0):
        alpha = float(conventions.alpha_from_center_of_mass(c))
        assert np.sum(ages * alpha * (1 - alpha) ** ages) == pytest.approx(c, rel=1e-12, abs=1e-15)
        # A span is the width of the window with that mean age, (span - 1) / 2.
        assert float(conventions.alpha_from_span(2 * c + 1)) == pytest.approx(alpha, rel=1e-15)
    for h in (0.3, 1.0, 12.5, 100.0):
        assert (1 - float(conventions.alpha_from_halflife(h))) ** h == pytest.approx(0.5, rel=1e-13)
    assert float(conventions.alpha_from_decay(0.75)) == 0.25
    assert float(conventions.alpha_from_fading_factor(0.3)) == 0.3


def test_a_long_halflife_keeps_its_digits(dtype):
    # ln 2 / h - (ln 2 / h)^2 / 2 and less than 1e-19 of it; a constant, a quotient and expm1 are rounded.
    for h in (1e6, 3e7):
        rate = np.log(np.longdouble(2)) / np.longdouble(dtype.type(h))
        alpha = conventions.alpha_from_halflife(dtype.type(h))
        assert alpha.dtype == dtype
        expected = rate - rate**2 / 2 + rate**3 / 6
        assert abs(np.asarray(alpha).astype(np.longdouble) / expected - 1) < 3 * np.finfo(dtype).eps


# Each function, a start from which 0.25, 0.5 and 0.875 more are in its domain, and numbers that are not.
WEIGHTS = [
    (conventions.alpha_from_span, 1.0, "span", (0.99, -3.0, np.nan)),
    (conventions.alpha_from_center_of_mass, 0.0, "center_of_mass", (-0.1, np.nan)),
    (conventions.alpha_from_halflife, 0.0, "halflife", (0, -1.0, np.nan)),
    (conventions.alpha_from_decay, 0.0, "decay", (-0.1, 1, 1.5, np.nan)),
    (conventions.alpha_from_fading_factor, 0.0, "alpha", (0, 1.5, np.nan)),
]
WEIGHT_NAMES = [name for _, _, name, _ in WEIGHTS]


@pytest.mark.parametrize("function, start, name, outside", WEIGHTS, ids=WEIGHT_NAMES)
def test_weights_take_arrays_and_keep_their_dtype(function, start, name, outside):
    values = start + np.array([[0.25, 0.5, 0.875]], np.float32)
    found = jax.jit(function)(values)
    assert found.shape == (1, 3) and found.dtype == jnp.float32
    single = [float(function(float(v))) for v in values[0]]
    np.testing.assert_allclose(found[0], single, rtol=1e-6)
    # They are weights of a stream, under differentiation too.
    total = jax.jit(jax.value_and_grad(lambda v: jnp.sum(moving.ema(ZS[:5, 0], function(v)))))
    h = 1e-6
    ends = [float(total(start + 0.5 + s)[0]) for s in (h, -h)]
    slope = (ends[0] - ends[1]) / (2 * h)
    assert float(total(start + 0.5)[1]) == pytest.approx(slope, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("function, start, name, outside", WEIGHTS, ids=WEIGHT_NAMES)
def test_parameters_outside_their_domain_are_refused(function, start, name, outside):
    for value in outside:
        with pytest.raises(ValueError, match=rf"^{name} must be .*, got {value}"):
            function(value)


def test_riskmetrics_refuses_a_weight_of_nothing():
    with pytest.raises(ValueError, match="decay must be below 1, got 1.0"):
        conventions.riskmetrics(ZS, decay=1.0)
