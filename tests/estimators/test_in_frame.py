"""The controller that looks inside the frames: explicit faded sums, and what follows from them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from in_frame_cases import (
    FRAMES,
    PIXELS,
    frames,
    histories,
    history,
    next_count,
    safety,
    sample_variance,
    seeds,
    sequence_gain,
    weights,
)
from scipy.stats import poisson

from sssfit.estimators import in_frame
from sssfit.estimators.in_frame import Controller


def faded(values, keep):
    """Sum of the values, the older the less: an explicit weight for each."""
    return np.dot(keep ** np.arange(len(values) - 1, -1, -1.0), values)


def expected_numbers(mean, deviation, count, control, *, target, alpha, gain_alpha):
    """Of one pixel, all eight numbers by explicit sums, and what rounding in `uncertainty` is relative to."""
    learned = count >= 2
    mean, deviation, count, control = (
        np.asarray(v, float)[learned] for v in (mean, deviation, count, control)
    )
    if not learned.any():
        return np.zeros(8), 0.0
    scale, degrees, keep = control**2 + target, count - 1, 1 - alpha
    relative, result = deviation / scale, mean / np.sqrt(scale)
    foreseen = np.array([faded(relative[:i], keep) / faded(degrees[:i], keep) for i in range(1, len(count))])
    surprise = np.concatenate(
        [[np.sqrt(2 / degrees[0]) * relative[0]], relative[1:] - degrees[1:] * foreseen]
    )
    variance = relative / degrees
    jumps = np.square(np.diff(result)) / 2 * 2 / (1 / count[1:] + 1 / count[:-1])
    forget = 1 - gain_alpha
    numbers = [
        faded(relative, keep),
        faded(degrees, keep),
        faded(degrees * control**2 / scale, keep),
        faded(surprise**2, keep**2),
        result[-1],
        count[-1],
        faded(np.concatenate([[4 * variance[0]], jumps]), forget),
        faded(np.concatenate([[4 * variance[0]], variance[1:]]), forget),
    ]
    terms = relative + np.concatenate([[0], degrees[1:] * foreseen])
    return np.array(numbers), faded(terms**2, keep**2)


# The sums


@settings(max_examples=25)
@given(seed=seeds, alpha=weights, gain_alpha=weights, target=st.floats(1e-6, 1.0))
def test_the_history_is_faded_sums(dtype, seed, alpha, gain_alpha, target):
    # The constants as they are in the format.
    alpha, gain_alpha, target = (float(dtype.type(v)) for v in (alpha, gain_alpha, target))
    brought = frames(seed, dtype)
    found = histories(brought, Controller(target, alpha, gain_alpha=gain_alpha))
    assert found.gain is not None
    leaves = [found.square_deviation, found.degrees, found.lit_degrees, found.uncertainty]
    leaves += [found.gain.previous, found.gain.previous_count, found.gain.temporal, found.gain.spatial]
    assert all(leaf.dtype == dtype and leaf.shape == (FRAMES, PIXELS) for leaf in leaves)
    eps = float(np.finfo(dtype).eps)
    for pixel in range(PIXELS):
        for last in (0, 1, FRAMES - 1):
            of_pixel = [v[: last + 1, pixel] for v in brought]
            expected, terms = expected_numbers(*of_pixel, target=target, alpha=alpha, gain_alpha=gain_alpha)
            mine = np.array([float(leaf[last, pixel]) for leaf in leaves])
            # Positive sums err by some roundings a frame; differences by those of their terms.
            most = of_pixel[2].max()
            largest = np.abs(of_pixel[0] / np.sqrt(of_pixel[3] ** 2 + target)).max()
            absolute = np.array([0, 0, 0, terms, largest, 0, FRAMES * most * largest**2, 0]) * 100 * eps
            np.testing.assert_array_less(
                np.abs(mine - expected), 4 * FRAMES * eps * np.abs(expected) + absolute + 1e-30
            )


def test_a_weight_of_one_remembers_the_last_frame_alone(dtype):
    brought = frames(5, dtype)
    found = histories(brought, Controller(dtype.type(0.01), alpha=1.0))
    mean, deviation, count, control = (v[-1] for v in brought)
    learned = count >= 2
    expected = deviation / (control**2 + dtype.type(0.01))
    assert learned.any()
    close = 4 * float(np.finfo(dtype).eps)
    assert np.asarray(found.square_deviation)[-1, learned] == pytest.approx(expected[learned], rel=close)
    assert np.array_equal(found.degrees[-1, learned], count[learned] - 1)


def test_a_tiny_weight_counts_everything(dtype):
    # With alpha = 1e-6 a thousand frames weigh 1 within 1e-3.
    controller = Controller(1e-3, alpha=1e-6)

    @jax.jit
    def after(state):
        def following(i, s):
            return in_frame.update(s, 1.0, 0.5, 8, 1.0, controller)

        return jax.lax.fori_loop(0, 1000, following, state)

    found = after(in_frame.init(jnp.zeros((), dtype), controller))
    total = np.sum((1 - 1e-6) ** np.arange(1000.0))
    eps = float(np.finfo(dtype).eps)
    # A rounding to half an eps of the sum in each frame; the same in both sums would cancel in the ratio.
    assert float(found.degrees) == pytest.approx(7 * total, rel=1000 * eps)
    variance = in_frame.sample_variance(found, jnp.asarray(1.0, dtype), controller)
    assert float(variance) == pytest.approx(0.5 / 7, rel=2000 * eps)


# What follows from a history


@given(seed=seeds, target=st.floats(1e-6, 1.0))
def test_variance_and_count_by_hand(x64, seed, target):
    generator = np.random.default_rng(seed)
    total, uncertainty, control = generator.lognormal(size=(3, PIXELS))
    degrees = generator.uniform(1, 2000, PIXELS)
    temporal, spatial = generator.lognormal(size=(2, PIXELS))
    state = history(
        total, degrees, degrees, uncertainty, dtype=float, gain=(control, degrees, temporal, spatial)
    )
    controller = Controller(target, min_spp=4, max_spp=1000, gain_alpha=0.1)
    variance = total / degrees * (control**2 + target)
    assert np.asarray(sample_variance(state, control, controller)) == pytest.approx(variance, rel=1e-13)
    more = 1 + uncertainty / total**2
    assert np.asarray(safety(state)) == pytest.approx(more, rel=1e-14)
    gain = np.minimum(temporal / spatial, 1)
    assert np.asarray(sequence_gain(state)) == pytest.approx(gain, rel=1e-15)
    ideal = np.clip(variance * more * gain / target, 4, 1000)
    found = np.asarray(next_count(state, control, controller))
    assert np.all(np.abs(found - ideal) <= 0.5 + 1e-9)
    alone = eqx.tree_at(lambda h: h.gain, state, None)
    assert np.all(np.asarray(sequence_gain(alone)) == 1)


@pytest.mark.parametrize("rounding, expected", [("nearest", 50), ("up", 51), ("down", 50)])
def test_rounding(rounding, expected):
    # 0.2 (0.25 + 0.001) / 0.001 = 50.2.
    state = history(20.0, 100.0, 100.0, 0.0)
    assert int(in_frame.next_count(state, 0.5, Controller(1e-3, rounding=rounding))) == expected


@given(seed=seeds, alpha=weights, power=st.integers(-12, 12))
def test_the_unit_of_light_does_not_matter(dtype, seed, alpha, power):
    # Light times c and target times c^2; a power of 2 changes no digit.
    factor = 2.0**power
    target, alpha = dtype.type(0.01), dtype.type(alpha)
    mean, deviation, count, control = frames(seed, dtype)
    first = Controller(target, alpha, gain_alpha=dtype.type(0.1))
    second = Controller(dtype.type(target * factor**2), alpha, gain_alpha=dtype.type(0.1))
    scaled = tuple(v.astype(dtype) for v in (mean * factor, deviation * factor**2)), count
    mine = histories((mean, deviation, count, control), first)
    other = histories((*scaled[0], count, (control * factor).astype(dtype)), second)
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(other), strict=True):
        assert np.array_equal(a, b)
    last, same = (jax.tree.map(lambda v: v[-1], h) for h in (mine, other))
    light = np.linspace(0, 3, PIXELS).astype(dtype)
    asked = next_count(last, light, first)
    assert np.array_equal(asked, next_count(same, (light * factor).astype(dtype), second))


@given(seed=seeds, factor=st.floats(0.01, 100))
def test_multiplicative_light_scales_the_expected_variance(x64, seed, factor):
    # Far above the target G^2 alone counts: to target / G^2, here 1e-9 and less.
    generator = np.random.default_rng(seed)
    state = history(*generator.lognormal(size=(4, PIXELS)), dtype=float)
    controller = Controller(1e-14)
    control = generator.uniform(0.1, 10, PIXELS)
    found = np.asarray(sample_variance(state, factor * control, controller))
    expected = factor**2 * np.asarray(sample_variance(state, control, controller))
    assert found == pytest.approx(expected, rel=2e-8)


@given(seed=seeds)
def test_light_that_flickers_by_a_factor_teaches_the_same(x64, seed):
    # Frames of a steady pixel, and the same frames under light times anything: one history.
    mean, deviation, count, control = frames(seed)
    factor = np.random.default_rng(seed + 1).uniform(0.05, 5, (FRAMES, 1))
    controller = Controller(1e-16, alpha=0.1, gain_alpha=0.1)
    steady = histories((mean, deviation, count, control), controller)
    flickering = histories((factor * mean, factor**2 * deviation, count, factor * control), controller)
    for a, b in zip(jax.tree.leaves(steady), jax.tree.leaves(flickering), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8)


@given(seed=seeds, bounds=st.tuples(st.integers(2, 200), st.integers(2, 200)))
def test_counts_are_within_their_bounds(dtype, seed, bounds):
    # Whatever a history and a control may hold.
    generator = np.random.default_rng(seed)
    special = np.array(
        [0, np.nan, np.inf, -np.inf, -1, 1e-30, 1e30, np.finfo(dtype).max, np.finfo(dtype).tiny]
    )
    leaves = [
        np.where(generator.random(64) < 0.3, generator.choice(special, 64), generator.lognormal(0, 4, 64))
        for _ in range(9)
    ]
    *numbers, control = (leaf.astype(dtype) for leaf in leaves)
    low, high = sorted(bounds)
    state = history(*numbers[:4], dtype=dtype, gain=numbers[4:])
    found = next_count(state, control, Controller(1e-3, min_spp=low, max_spp=high, gain_alpha=0.1))
    assert found.dtype == jnp.int32
    assert np.all((found >= low) & (found <= high))


@given(seed=seeds)
def test_more_light_takes_no_fewer_samples(dtype, seed):
    # Rounded operations are monotone, and so is the whole, to the bit.
    generator = np.random.default_rng(seed)
    state = history(*generator.lognormal(sigma=2, size=4), dtype=dtype)
    control = np.sort(generator.lognormal(sigma=3, size=64)).astype(dtype)
    pixels = jax.tree.map(lambda v: jnp.full(64, v), state)
    found = next_count(pixels, control, Controller(1e-3, min_spp=2, max_spp=10**6))
    assert np.all(np.diff(found) >= 0)


def test_hits_that_are_rare_and_alike_are_given_one_more():
    # N hits among F frames that miss otherwise, as N is a Poisson number: 1 + 1 / N, to N / F.
    number, most = 4000, 30
    hits = np.arange(most + 1)
    with jax.enable_x64(True):
        frame = np.zeros((number, most + 1))
        for n in hits[1:]:
            frame[((np.arange(n) + 0.5) * number / n).astype(int), n] = 1
        controller = Controller(1e-3, alpha=1e-9)
        brought = frame / 8, frame * 7 / 8, np.full(frame.shape, 8), np.ones(frame.shape)
        state = jax.tree.map(lambda v: v[-1], histories(brought, controller))
        found = np.asarray(safety(state))
    assert found[0] == 1
    assert np.all(np.abs(found[1:] - 1 - 1 / hits[1:]) < 3 / number)
    # The count asked for is N safety / m of what the target takes, and the variance delivered its inverse:
    # over all N the mean is 1 - exp(-m), never above the target. Where none was seen, it is m at one hit.
    for mean in (0.5, 2.0, 8.0):
        chance = poisson.pmf(hits, mean)
        delivered = mean / np.concatenate([[1], hits[1:] * found[1:]])
        assert np.dot(chance, delivered) == pytest.approx(1 - np.exp(-mean), abs=most * 3 / number)
