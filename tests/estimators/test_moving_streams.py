"""Streams that go on, masks of whole times, and what half formats cannot hold."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.estimators import bias, moving

ZS = np.random.default_rng(11).normal(size=(12, 3, 2)).astype(np.float32)


def sample_of(name, zs):
    return (zs[..., 0], zs[..., 1]) if name == "emc" else zs


@pytest.mark.parametrize("name", moving.STATISTICS)
def test_a_stream_goes_on_from_its_state(name):
    zs = ZS if name != "ema" else ZS[..., 0]
    whole_state, whole = moving.scan(name, sample_of(name, zs), 0.2)
    state, first = moving.scan(name, sample_of(name, zs[:5]), 0.2)
    state, second = moving.scan(name, sample_of(name, zs[5:]), 0.2, state=state)
    np.testing.assert_array_equal(np.concatenate([first, second]), whole)
    for part, other in zip(jax.tree.leaves(state), jax.tree.leaves(whole_state), strict=True):
        np.testing.assert_array_equal(part, other)


def test_a_state_of_another_statistic_is_refused():
    state, _ = moving.scan("ema", ZS, 0.2)
    with pytest.raises(ValueError, match="state is of 'ema', not of 'emv'"):
        moving.scan("emv", ZS, 0.2, state=state)


@pytest.mark.parametrize("run", [lambda *a, **k: moving.scan(*a, **k)[1], moving.associative])
def test_a_mask_of_times_masks_times(run):
    # As many streams as times: which of the two a mask of one axis means must not depend on it.
    xs = np.random.default_rng(2).normal(size=(6, 6)).astype(np.float32)
    valid = np.array([True, False, True, True, False, True])
    found = run("emv", xs, 0.2, valid=valid)
    expected = run("emv", xs, 0.2, valid=np.broadcast_to(valid[:, None], (6, 6)))
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(found[1], found[0])
    with pytest.raises(ValueError, match=r"valid must broadcast to the shape \(6, 6\), got \(3, 6\)"):
        run("emv", xs, 0.2, valid=np.ones((3, 6), bool))


@pytest.mark.parametrize("method", moving.METHODS)
def test_weights_are_those_of_one_sample(method):
    xs = np.zeros((5, 4), np.float32)
    lists: list[Any] = [[0.1, 0.2, 0.3, 1.0], [0.1, 0.2, 0.3, 2.0]]
    np.testing.assert_array_equal(moving.ema(xs, lists[0], method=method), xs)
    with pytest.raises(ValueError, match=r"alpha must broadcast to the shape \(4,\), got \(5, 1\)"):
        moving.ema(xs, np.full((5, 1), 0.2), method=method)
    with pytest.raises(ValueError, match=r"alpha must be in \(0, 1\], got 2"):
        moving.ema(xs, lists[1], method=method)


def test_complex_samples_are_refused():
    with pytest.raises(ValueError, match="samples must be real"):
        moving.emv(np.ones(3, np.complex64), 0.2)


def test_a_sample_beyond_a_half_format_leaves_no_nan():
    xs = np.array([1, 5e5, 1, 1, -5e5, 1], np.float32)
    state, means = moving.scan("ema", xs, 0.2, dtype=jnp.float16)
    # float32 arithmetic, stored as a half number of at most 65504.
    expected, mean = [1.0], np.float32(1)
    for x in xs[1:]:
        mean = np.float32(np.float16(np.clip(mean + np.float32(0.2) * (x - mean), -65504, 65504)))
        expected.append(float(mean))
    np.testing.assert_allclose(means.astype(jnp.float32), expected, rtol=2**-10)
    assert not np.isnan(np.asarray(moving.scan("emv", xs, 0.2, dtype=jnp.float16)[1], float)).any()


@pytest.mark.parametrize("scale", [1.0, 3e-4])
def test_bounded_halves_hold_below_the_normal_numbers_too(scale):
    rng = np.random.default_rng(4)
    x = rng.normal(size=2000) * scale
    zs = np.stack([x, 0.7 * x + 1e-3 * scale * rng.normal(size=2000)], axis=-1).astype(np.float16)
    matrices = np.asarray(moving.emcm(zs, 0.2, bounded=True)).astype(np.float64)
    # Products of half numbers are exact in float64.
    assert np.all(matrices[:, 0, 1] ** 2 <= matrices[:, 0, 0] * matrices[:, 1, 1])
    free = np.asarray(moving.emcm(zs, 0.2)).astype(np.float64)
    assert np.any(free[:, 0, 1] ** 2 > free[:, 0, 0] * free[:, 1, 1])


def test_moments_of_few_samples_keep_their_digits(x64):
    # Weights around 0.4, where XLA's log1p has lost two digits in float64.
    for alpha in (0.3, 0.38, 0.4124431592810602, 0.45, 0.6):
        for count in (2, 3, 10):
            weights = np.longdouble(alpha) * (1 - np.longdouble(alpha)) ** np.arange(count)[::-1]
            weights[0] /= np.longdouble(alpha)
            matrix = np.diag(weights) - np.outer(weights, weights)
            mean = np.trace(matrix)
            squares = np.sum(np.diag(matrix) ** 2)
            deviation = np.sqrt(2 * squares + 2 * (np.sum(matrix**2) - squares)) / mean
            found = bias.emv_moments(alpha, float(count))
            assert float(found.mean) == pytest.approx(float(mean), rel=1e-14)
            assert float(found.deviation) == pytest.approx(float(deviation), rel=1e-14)


def test_a_pilot_without_samples_is_refused():
    with pytest.raises(ValueError, match="pilot must be at least 1, got 0"):
        bias.pilot_bias(np.array([0.0, 1.0]), np.array([0.9, 0.1]), 0)
