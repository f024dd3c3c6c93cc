"""Batch means of appendix B.3: moments by quadrature, streams by explicit weights, the table as elsewhere."""

import math

import jax
import numpy as np
import pytest
from scipy.integrate import quad

from sssfit.scenarios import batch_mean

# Each simulation is a program to compile, and many seeds.
pytestmark = pytest.mark.slow

simulate = jax.jit(batch_mean.simulate, static_argnames=("light", "frames", "spp"))

SEEDS, THEIR_SEEDS = 2000, 4000
HEAVY_TAILED = ("EMCM", "EMCM_hat")

# Mean, median and standard deviation of 4000 seeds in NumPy; of the heavy-tailed entries the median alone.
SIMULATED = {
    "static": {
        "Res_f": (0.03211, 0.03209, 0.00257),
        "SF": (0.01561, 0.01557, 0.00142),
        "SF+EMA": (0.00590, 0.00589, 0.00047),
        "EMCM": (None, 0.00694, None),
        "EMCM_hat": (None, 0.0327, None),
        "GT": (0.00569, 0.00568, 0.00045),
    },
    "dynamic": {
        "Res_f": (0.57616, 0.57618, 0.00503),
        "SF": (0.37636, 0.37638, 0.00221),
        "SF+EMA": (0.37435, 0.37435, 0.00242),
        "EMCM": (None, 0.1380, None),
        "EMCM_hat": (None, 0.0778, None),
        "GT": (0.13408, 0.13391, 0.0125),
    },
}


# Moments


def test_moments_by_quadrature():
    def f(y):
        return 1 / (1 + y)

    def g(y):
        return 1 - y

    def mean(function):
        value, error = quad(function, 0, 1, epsabs=1e-14, epsrel=1e-13)
        assert error < 1e-13
        return value

    value, control = mean(f), mean(g)
    expected = (
        value,
        control,
        mean(lambda y: (f(y) - value) ** 2),
        mean(lambda y: (g(y) - control) ** 2),
        mean(lambda y: (f(y) - value) * (g(y) - control)),
    )
    found = batch_mean.MOMENTS
    assert tuple(found) == pytest.approx(expected, rel=1e-12)
    assert found.static_coefficient == pytest.approx(expected[4] / expected[3], rel=1e-12)
    assert found.dynamic_coefficient == pytest.approx(value / control, rel=1e-13)


def test_moments_by_their_digits():
    # By mpmath: Var f, Cov(f, g), 12 (3/2 ln 2 - 1), 2 ln 2.
    found = batch_mean.MOMENTS
    assert found.value_variance == pytest.approx(0.019546986081798575, rel=1e-14)
    assert found.covariance == pytest.approx(0.039720770839917964, rel=1e-14)
    assert found.static_coefficient == pytest.approx(0.47664925007901557, rel=1e-14)
    assert found.dynamic_coefficient == pytest.approx(1.3862943611198906, rel=1e-15)


def test_intensities():
    assert batch_mean.intensity("static").tolist() == [1.0] * 100
    moving = batch_mean.intensity("dynamic", 100)
    assert moving == pytest.approx([1 + 3 * math.sin(i / 10) for i in range(100)], abs=1e-14)
    assert moving.dtype == np.float64 and moving.min() < 0


# Streams


def weights(count, alpha):
    """Of the first to the last of so many, which starts from the first."""
    found = alpha * (1 - alpha) ** np.arange(count - 1, -1, -1.0)
    found[0] = (1 - alpha) ** (count - 1)
    return found


def moving_average(values, alpha):
    return np.array([weights(n, alpha) @ values[:n] for n in range(1, len(values) + 1)])


def moving_covariance(x, y, alpha):
    found = np.empty(len(x))
    for n in range(1, len(x) + 1):
        w = weights(n, alpha)
        found[n - 1] = w @ ((x[:n] - w @ x[:n]) * (y[:n] - w @ y[:n]))
    return found


def by_hand(y, h):
    """Coefficients, residuals and errors of all six, NaN where there is none."""
    frames = len(h)
    f, g = h[:, None] / (1 + y), h[:, None] * (1 - y)
    value, control = f.mean(axis=1), g.mean(axis=1)
    single = np.array([np.cov(a, b)[0, 1] / np.var(b, ddof=1) for a, b in zip(f, g, strict=True)])
    variance = moving_covariance(control, control, 0.05)
    with np.errstate(invalid="ignore"):
        over_time = moving_covariance(value, control, 0.05) / variance
    static = np.all(h == 1)
    best = 12 * (1.5 * math.log(2) - 1) if static else 2 * math.log(2)
    earlier = {
        "Res_f": (np.zeros(frames), control),
        "SF": (np.append(np.nan, single[:-1]), control),
        "SF+EMA": (np.append(np.nan, moving_average(single, 0.05)[:-1]), control),
        # One frame has no covariance: a coefficient exists from the third on.
        "EMCM": (np.append([np.nan, np.nan], over_time[1:-1]), control),
        "EMCM_hat": (np.append([np.nan, np.nan], over_time[1:-1]), 0.5 * h),
        "GT": (np.full(frames, best), control),
    }
    streams = {}
    for name, (coefficient, taken) in earlier.items():
        left = value - coefficient * taken
        known = np.isfinite(left)
        error = np.full(frames, np.nan)
        error[known] = np.sqrt(moving_covariance(left[known], left[known], 0.2))
        streams[name] = coefficient, left, error
    return streams


@pytest.mark.parametrize("light", batch_mean.LIGHTS)
def test_streams_by_explicit_weights(x64, light):
    key = jax.random.key(4)
    found = simulate(key, light)
    y = np.asarray(jax.random.uniform(key, (batch_mean.FRAMES, batch_mean.SPP)))
    expected = by_hand(y, batch_mean.intensity(light))
    assert set(found.coefficient) == set(expected) == set(batch_mean.NAMES)
    for name in batch_mean.NAMES:
        # The first coefficients over time are ratios of small differences.
        for mine, other in zip(
            (getattr(found, part)[name] for part in found._fields), expected[name], strict=True
        ):
            assert mine.shape == (100,)
            np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-13)


def test_streams_in_single_precision_and_of_other_sizes():
    # Three frames of two samples are the fewest.
    found = simulate(jax.random.key(5), "dynamic", frames=3, spp=2)
    for part in found:
        for name, first in (("Res_f", 0), ("SF", 1), ("SF+EMA", 1), ("EMCM", 2), ("EMCM_hat", 2), ("GT", 0)):
            assert part[name].shape == (3,) and part[name].dtype == np.float32
            assert np.isnan(np.asarray(part[name])).tolist() == [i < first for i in range(3)]
    with jax.enable_x64(True):
        y = np.asarray(jax.random.uniform(jax.random.key(5), (3, 2), np.float32), float)
    expected = by_hand(y, batch_mean.intensity("dynamic", 3))
    for name in ("Res_f", "SF", "SF+EMA", "GT"):
        assert np.asarray(found.residual[name]) == pytest.approx(
            expected[name][1], rel=1e-3, abs=1e-5, nan_ok=True
        )


# The table


@pytest.fixture(scope="module")
def tables():
    return {
        light: {entry.name: entry for entry in batch_mean.table(jax.random.key(6), light, seeds=SEEDS)}
        for light in batch_mean.LIGHTS
    }


@pytest.mark.parametrize("name", batch_mean.NAMES)
@pytest.mark.parametrize("light", batch_mean.LIGHTS)
def test_the_table_as_simulated_elsewhere(tables, light, name):
    entry, (mean, median, sd) = tables[light][name], SIMULATED[light][name]
    # Both simulations' standard errors, and half of the last digit, the fourth or the fifth.
    both = math.sqrt(1 / SEEDS + 1 / THEIR_SEEDS)
    digit = 5e-5 if name == "EMCM_hat" or (name, light) == ("EMCM", "dynamic") else 5e-6
    # A normal distribution's quartiles are 1.349 standard deviations apart, and its median errs by 1.2533 of
    # them over the root of the number; this holds for the middle of the heavy-tailed ones as well.
    of_median = 1.2533 * entry.interquartile / 1.349 * both
    assert abs(entry.median - median) < digit + 4 * of_median
    if name not in HEAVY_TAILED:
        assert mean is not None and sd is not None
        assert abs(entry.mean - mean) < digit + 4 * entry.sd * both
        # A standard deviation errs by itself over the root of twice the number, for a normal distribution.
        assert abs(entry.sd - sd) < (5e-5 if sd == 0.0125 else digit) + 5 * entry.sd * both / math.sqrt(2)


def test_what_the_table_says(tables):
    # Wanted is f's own noise under light that stays, and little under light that moves.
    static, dynamic = (
        {name: entry.median for name, entry in tables[light].items()} for light in batch_mean.LIGHTS
    )
    assert static["EMCM_hat"] == pytest.approx(static["Res_f"], rel=0.05)
    assert static["SF"] < 0.6 * static["Res_f"] and static["EMCM"] < 0.3 * static["Res_f"]
    assert dynamic["EMCM_hat"] < dynamic["EMCM"] < 0.5 * dynamic["SF"] < 0.5 * dynamic["Res_f"]


def test_columns_of_the_table():
    # Of five seeds, each the mean error of frames 25 to 100.
    key, seeds = jax.random.key(7), 5
    calls = []
    found = batch_mean.table(
        key, "dynamic", seeds=seeds, progress=lambda done, total: calls.append((done, total))
    )
    assert calls[0] == (0, seeds) and calls[-1] == (seeds, seeds)
    streams = [simulate(jax.random.fold_in(key, n), "dynamic").error for n in range(seeds)]
    assert [entry.name for entry in found] == list(batch_mean.NAMES)
    for entry in found:
        errors = np.array([np.asarray(s[entry.name], float)[24:].mean() for s in streams])
        low, first, median, third, high = np.quantile(errors, (0.005, 0.25, 0.5, 0.75, 0.995))
        assert entry.mean == pytest.approx(errors.mean(), rel=1e-4)
        assert entry.median == pytest.approx(median, rel=1e-4)
        assert entry.sd == pytest.approx(errors.std(ddof=1), rel=1e-3, abs=1e-5)
        assert entry.interquartile == pytest.approx(third - first, rel=1e-3, abs=1e-5)
        assert (entry.low, entry.high) == pytest.approx((low, high), rel=1e-4)


def test_chunks_of_the_table(monkeypatch):
    key = jax.random.key(7)
    whole = batch_mean.table(key, "dynamic", seeds=5)
    monkeypatch.setattr(batch_mean, "_CHUNK_SAMPLES", 2 * batch_mean.FRAMES * batch_mean.SPP)
    calls = []
    parts = batch_mean.table(key, "dynamic", seeds=5, progress=lambda done, total: calls.append(done))
    assert calls == [0, 2, 4, 5]
    for mine, other in zip(parts, whole, strict=True):
        assert mine.name == other.name
        assert mine[1:] == pytest.approx(other[1:], rel=1e-4, abs=1e-6)


# Faults


def test_faults():
    key = jax.random.key(0)
    with pytest.raises(ValueError, match="light must be one of static, dynamic, got 'sine'"):
        batch_mean.intensity("sine")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="light must be one of static, dynamic, got 'sine'"):
        batch_mean.simulate(key, "sine")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="frames must be at least 1, got 0"):
        batch_mean.intensity("static", 0)
    with pytest.raises(ValueError, match="frames must be at least 3, got 2; the first two only teach"):
        batch_mean.simulate(key, "static", frames=2)
    with pytest.raises(ValueError, match="spp must be at least 2, got 1; one sample has no covariance"):
        batch_mean.simulate(key, "static", spp=1)
    with pytest.raises(ValueError, match="seeds must be at least 2, got 1; one has no spread"):
        batch_mean.table(key, "static", seeds=1)
