"""The extremes: each case of the stability table, what the bounds catch, and the documented courses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.estimators import _reference, moving, stability

# Every case compiles for every dtype.
pytestmark = pytest.mark.slow

CASES = [(case, dtype) for case in stability.CASES for dtype in stability.DTYPES]
#: Long streams have a test of their own for their full length.
QUICK = 100_000


@pytest.mark.parametrize(("case", "dtype"), CASES, ids=[f"{case}-{dtype}" for case, dtype in CASES])
def test_bounds_hold(case, dtype):
    with jax.enable_x64(True):
        rows = stability.CASES[case](jnp.dtype(dtype), QUICK)
    assert rows or (case, dtype) == ("long streams", "float64")
    for row in rows:
        assert row.dtype in (dtype, "bfloat16")
        assert np.isfinite(row.bound) and np.isfinite(row.measured)
        assert row.holds, row


@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_ten_million_updates_do_not_drift(dtype):
    with jax.enable_x64(True):
        rows = stability.CASES["long streams"](jnp.dtype(dtype), 10_000_000)
    assert len(rows) == 8
    assert all("10,000,000 updates" in row.case and row.holds for row in rows), rows


def moments_of_squares(xs, alpha):
    """The variance as a difference of moments, which cancels: what the bounds must not let pass."""

    def step(carry, x):
        mean, square = carry
        carry = mean + alpha * (x - mean), square + alpha * (x * x - square)
        return carry, carry[1] - carry[0] ** 2

    return np.asarray(jax.lax.scan(step, (xs[0], xs[0] ** 2), xs)[1])


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_the_bound_of_a_large_mean_fails_a_difference_of_moments(offset):
    xs = stability._noise(np.float32, offset=offset)
    found = moments_of_squares(jnp.asarray(xs), np.float32(0.2))
    _, true = _reference.explicit(xs, float(np.float32(0.2)))
    (row,) = [
        row for row in stability._compared("large mean", xs, 0.2) if row.quantity == "error of the variance"
    ]
    assert row.holds and np.max(np.abs(found - true)) > 3 * row.bound


def test_the_bound_of_a_small_weight_fails_weights_formed_from_one_minus_alpha():
    # 1 - 1e-6 is 1.3 % off in float32, which a recursion that multiplies by it cannot lose again.
    xs, alpha = np.ones(200_000, np.float32), np.float32(1e-6)
    xs[0] = 0

    def step(mean, x):
        return (1 - alpha) * mean + alpha * x, None

    plain = float(jax.jit(lambda xs: jax.lax.scan(step, xs[0], xs[1:])[0])(jnp.asarray(xs)))
    exact = -np.expm1((len(xs) - 1) * np.log1p(-float(alpha)))
    ours = float(moving.scan("ema", jnp.asarray(xs), alpha, compensated=True)[0].mean[0])
    eps = float(np.finfo(np.float32).eps)
    assert abs(ours - exact) < 3 * eps < abs(plain - exact) / 100


def test_explicit_weights_agree_with_pandas(x64):
    pd = pytest.importorskip("pandas")
    xs = np.random.default_rng(3).normal(size=200)
    for alpha in (0.01, 0.2, 0.9):
        mean, variance = _reference.explicit(xs, alpha)
        windows = pd.Series(xs).ewm(alpha=alpha, adjust=False)
        assert np.max(np.abs(mean - windows.mean())) < 1e-14
        assert np.max(np.abs(variance - windows.var(bias=True))) < 1e-13
        filtered_mean, filtered_variance = _reference.filtered(xs, alpha)
        assert np.max(np.abs(mean - filtered_mean)) < 1e-13
        assert np.max(np.abs(variance - filtered_variance)) < 1e-13


@pytest.mark.parametrize("method", moving.METHODS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_arrives_stays_until_alpha_is_one(bad, method, dtype):
    xs = jnp.ones(12, dtype).at[4].set(bad)
    mean, variance = (np.asarray(f(xs, 0.2, method=method)) for f in (moving.ema, moving.emv))
    assert np.all(mean[:4] == 1) and np.all(variance[:4] == 0)
    assert mean[4] == pytest.approx(bad, nan_ok=True)
    assert not np.any(np.isfinite(mean[4:]) | np.isfinite(variance[4:]))
    assert variance[4] == pytest.approx(abs(bad), nan_ok=True)
    state = moving.scan("emv", xs, 0.2)[0]
    healed = moving.update(state, 3.0, alpha=1.0)
    assert float(moving.mean(healed)) == 3 and float(moving.estimate(healed)) == 0


@pytest.mark.parametrize("method", moving.METHODS)
@pytest.mark.parametrize("statistic", ["emcm", "ewma_covariance"])
def test_products_that_overflow_make_no_nan(statistic, method, dtype):
    huge = float(jnp.finfo(dtype).max) / 16
    signs = np.where(np.random.default_rng(5).random((64, 2)) < 0.5, -1.0, 1.0)
    run = getattr(moving, statistic)
    matrices = np.asarray(run(jnp.asarray(huge * signs, dtype), 0.2, method=method))
    assert not np.isnan(matrices).any()
    assert np.isinf(matrices[-1][[0, 1], [0, 1]]).all() and np.isfinite(matrices[:, 0, 1]).all()


def test_a_table_of_some_cases_and_unknown_ones():
    assert list(stability.table([])) == []
    rows = list(stability.table(["coefficient"]))
    assert [row.dtype for row in rows] == list(stability.DTYPES)
    with pytest.raises(ValueError, match="cases must be some of weights, .* got nothing"):
        stability.table(["weights", "nothing"])


def test_a_row_fails_beyond_its_bound_and_for_nan():
    row = stability.Row("case", "quantity", "float32", 1.0, 1.0)
    assert row.holds
    assert not row._replace(measured=1.1).holds and not row._replace(measured=float("nan")).holds
