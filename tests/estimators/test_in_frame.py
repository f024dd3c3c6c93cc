"""The controller that looks inside the frames: explicit faded sums, laws, the ends of the formats, faults."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import poisson

from sssfit.estimators import in_frame
from sssfit.estimators.in_frame import Controller, Gain, History

# Compiled once for each precision, shape and structure; the constants are traced.
update = jax.jit(in_frame.update)
next_count = jax.jit(in_frame.next_count)
sample_variance = jax.jit(in_frame.sample_variance)
safety = jax.jit(in_frame.safety)
sequence_gain = jax.jit(in_frame.sequence_gain)

PIXELS, FRAMES = 3, 24
seeds = st.integers(0, 2**32 - 1)
weights = st.one_of(st.floats(1e-6, 1.0), st.sampled_from([1e-6, 0.5, 1.0]))
#: A history as a lit pixel has it, and constants for it.
USUAL = (20.0, 100.0, 95.0, 3.0)
CONTROLLER = Controller(1e-3, alpha=0.1)
GAINING = Controller(1e-3, alpha=0.1, gain_alpha=0.02)


def history(*numbers, dtype: Any = np.float32, gain: Any = None):
    leaves: list[Any] = [jnp.asarray(v, dtype) for v in numbers]
    return History(*leaves, gain=None if gain is None else Gain(*(jnp.asarray(v, dtype) for v in gain)))


def usual(dtype: Any = np.float32, gain=False):
    return history(*USUAL, dtype=dtype, gain=(1.0, 16.0, 0.02, 0.05) if gain else None)


def frames(seed, dtype: Any = np.float64):
    """Means, squared deviations, counts and controls of FRAMES frames of PIXELS pixels, all of them lit."""
    generator = np.random.default_rng(seed)
    shape = (FRAMES, PIXELS)
    # Above the root of any target below.
    control = 2 + generator.lognormal(size=shape)
    mean = generator.lognormal(size=shape)
    deviation = generator.lognormal(size=shape) * generator.choice([0, 1, 1, 1, 1], shape)
    count = generator.choice([0, 1, 2, 3, 8, 20, 64], shape)
    return mean.astype(dtype), deviation.astype(dtype), count, control.astype(dtype)


@jax.jit
def histories(brought, controller):
    """The history after each frame, from nothing."""

    def following(state, frame):
        state = in_frame.update(state, *frame, controller=controller)
        return state, state

    return jax.lax.scan(following, in_frame.init(brought[0][0], controller), brought)[1]


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


# Nothing known, nothing learned


@pytest.mark.parametrize("controller", [CONTROLLER, GAINING], ids=["plain", "gain"])
def test_a_history_of_nothing(dtype, controller):
    state = in_frame.init(jnp.zeros((2, 3), dtype), controller)
    assert len(jax.tree.leaves(state)) == (4 if controller.gain_alpha is None else 8)
    for leaf in jax.tree.leaves(state):
        assert leaf.dtype == dtype and leaf.shape == (2, 3) and not np.any(leaf)
    assert np.all(next_count(state, 1.0, controller) == 8)
    assert not np.any(sample_variance(state, 1.0, controller))
    assert np.all(np.asarray(safety(state)) == 1) and np.all(np.asarray(sequence_gain(state)) == 1)
    assert not np.any(state.is_lost)


@pytest.mark.parametrize("stored", [jnp.float16, jnp.bfloat16, jnp.float32])
def test_formats_of_the_history(stored):
    state = in_frame.init(jnp.zeros(3), GAINING, dtype=stored)
    state = update(state, 1.0, 0.5, 8, 1.0, GAINING)
    assert all(leaf.dtype == stored and leaf.shape == (3,) for leaf in jax.tree.leaves(state))
    assert sample_variance(state, 1.0, GAINING).dtype == jnp.float32


def test_half_formats_keep_a_rounding_for_each_remembered_frame():
    # Each frame rounds the sums by 2^-11 at most, of which 1 / alpha are remembered.
    generator = np.random.default_rng(2)
    controller = Controller(1e-3, alpha=0.05)
    wide = narrow = None
    for _ in range(150):
        brought = (1.0, generator.chisquare(31) * 0.1, 32, 1.0)
        wide = update(in_frame.init(0.0, controller) if wide is None else wide, *brought, controller)
        start = in_frame.init(0.0, controller, dtype=jnp.float16)
        narrow = update(start if narrow is None else narrow, *brought, controller)
    assert wide is not None and narrow is not None
    for name in ("square_deviation", "degrees", "lit_degrees"):
        apart = float(getattr(narrow, name)) / float(getattr(wide, name)) - 1
        assert abs(apart) < 2.0**-11 / 0.05
    assert abs(int(next_count(narrow, 0.7, controller)) - int(next_count(wide, 0.7, controller))) <= 2


@pytest.mark.parametrize("gain", [False, True])
def test_a_missing_pixel_forgets(gain):
    controller = GAINING if gain else CONTROLLER
    state = usual(gain=gain)
    fresh = in_frame.init(0.0, controller)
    brought = 0.7, 0.3, 16, 0.9
    for a, b in zip(
        jax.tree.leaves(update(state, *brought, controller, missing=True)),
        jax.tree.leaves(update(fresh, *brought, controller)),
        strict=True,
    ):
        assert a == b
    assert int(next_count(state, 1.0, controller, missing=True)) == 8
    assert int(next_count(state, 1.0, controller)) == 64
    # Nothing to learn from either: a history of nothing.
    for skipped in (
        update(state, *brought, controller, missing=True, valid=False),
        update(state, 0.7, 0.0, 1, 0.9, controller, missing=True),
    ):
        assert not any(np.any(leaf) for leaf in jax.tree.leaves(skipped))


@pytest.mark.parametrize("gain", [False, True])
@pytest.mark.parametrize(
    "mean, deviation, count, control, valid",
    [
        (0.7, 0.3, 16, 0.9, False),
        (np.nan, np.inf, 16, np.nan, False),
        (0.0, 0.0, 0, 0.9, True),
        (0.7, 0.0, 1, 0.9, True),
        (np.nan, np.nan, 1, 0.9, True),
        (0.0, 0.0, 64, 0.0, True),
    ],
    ids=["invalid", "invalid NaN", "count 0", "count 1", "count 1 NaN", "black"],
)
def test_what_teaches_nothing_changes_no_bit(dtype, gain, mean, deviation, count, control, valid):
    state = usual(dtype, gain)
    found = update(state, mean, deviation, count, control, GAINING if gain else CONTROLLER, valid=valid)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(state), strict=True):
        assert a.tobytes() == b.tobytes()


def test_maps_of_validity():
    state = jax.tree.map(lambda v: jnp.full((2, 3), v), usual())
    valid = np.array([[True, False, True], [False, True, False]])
    found = update(state, 0.5, 0.3, 8, 1.0, CONTROLLER, valid=valid)
    for leaf, old in zip(jax.tree.leaves(found), jax.tree.leaves(state), strict=True):
        assert np.array_equal(np.asarray(leaf) == np.asarray(old), ~valid)


def test_a_lamp_that_is_off_is_remembered():
    # Ten thousand black frames, and the light is back: the count is the old one in the first frame.
    state = usual()

    @jax.jit
    def dark(state):
        def following(i, s):
            return in_frame.update(s, 0.0, 0.0, 8, 0.0, CONTROLLER)

        return jax.lax.fori_loop(0, 10_000, following, state)

    after = dark(state)
    for a, b in zip(jax.tree.leaves(after), jax.tree.leaves(state), strict=True):
        assert a.tobytes() == b.tobytes()
    assert int(next_count(after, 0.0, CONTROLLER)) == 8
    assert int(next_count(after, 0.4, CONTROLLER)) == int(next_count(state, 0.4, CONTROLLER)) > 8


def test_a_lamp_is_off_when_all_is_below_the_target():
    # 1e-3: light, result and spread of a thousandth of its root, and then one of them above it.
    state, dim = usual(), {"mean": 1e-3, "square_deviation": 7e-6, "control": 1e-3}
    for brought in (dim, dim | {"mean": -1e-3}):
        for a, b in zip(
            jax.tree.leaves(update(state, **brought, count=8, controller=CONTROLLER)),
            jax.tree.leaves(state),
            strict=True,
        ):
            assert a.tobytes() == b.tobytes()
    for brighter in ({"mean": 0.1}, {"mean": -0.1}, {"square_deviation": 0.1}, {"control": 0.1}):
        found = update(state, **(dim | brighter), count=8, controller=CONTROLLER)
        assert float(found.degrees) == pytest.approx(0.9 * 100 + 7)


def test_only_a_lamp_that_was_on_is_off():
    # A shadow under light, and a pixel that never had any, are learned.
    shadow = update(usual(), 0.0, 0.0, 8, 1.0, CONTROLLER)
    assert float(shadow.square_deviation) == pytest.approx(0.9 * 20)
    dark = history(0.0, 50.0, 0.0, 0.0)
    assert float(update(dark, 0.0, 0.0, 8, 0.0, CONTROLLER).degrees) == pytest.approx(0.9 * 50 + 7)


def test_the_first_light_starts_afresh():
    # What was seen in the dark says nothing of it; light that was there before goes on.
    brought = 0.7, 0.3, 16, 0.9
    dark = history(0.4, 50.0, 1.0, 0.2, gain=(1.0, 9.0, 2.0, 3.0))
    fresh = update(in_frame.init(0.0, GAINING), *brought, controller=GAINING)
    for a, b in zip(
        jax.tree.leaves(update(dark, *brought, controller=GAINING)), jax.tree.leaves(fresh), strict=True
    ):
        assert a == b
    going_on = update(history(0.4, 50.0, 40.0, 0.2), *brought, controller=CONTROLLER)
    assert float(going_on.degrees) == pytest.approx(0.9 * 50 + 15)


def test_samples_that_are_all_alike():
    state = in_frame.init(0.0, GAINING)
    for _ in range(30):
        state = update(state, 0.7, 0.0, 8, 0.7, GAINING)
    assert float(state.square_deviation) == float(state.uncertainty) == 0
    assert float(sample_variance(state, 1e3, GAINING)) == 0
    assert float(safety(state)) == float(sequence_gain(state)) == 1
    assert int(next_count(state, 1e6, GAINING)) == 8


# What is not a number


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("which", ["mean", "deviation", "control"])
def test_a_bad_frame_is_forgotten_at_the_next(dtype, which, bad):
    brought = {"mean": 0.7, "deviation": 0.3, "control": 0.9} | {which: bad}
    lost = update(usual(dtype), brought["mean"], brought["deviation"], 16, brought["control"], CONTROLLER)
    assert bool(lost.is_lost)
    assert int(next_count(lost, 1.0, CONTROLLER)) == 8
    assert np.isnan(float(sample_variance(lost, 1.0, CONTROLLER)))
    healed = update(lost, 0.7, 0.3, 16, 0.9, CONTROLLER)
    fresh = update(in_frame.init(jnp.zeros((), dtype), CONTROLLER), 0.7, 0.3, 16, 0.9, CONTROLLER)
    for a, b in zip(jax.tree.leaves(healed), jax.tree.leaves(fresh), strict=True):
        assert a == b


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("which", range(7))
def test_a_history_that_is_not_a_number_is_as_good_as_missing(which, bad):
    # Whichever of its numbers it is.
    leaves, structure = jax.tree.flatten(usual(gain=True))
    leaves[which] = jnp.float32(bad)
    lost = jax.tree.unflatten(structure, leaves)
    assert bool(lost.is_lost)
    assert int(next_count(lost, 1.0, GAINING)) == 8
    healed = update(lost, 0.7, 0.3, 16, 0.9, GAINING)
    fresh = update(in_frame.init(0.0, GAINING), 0.7, 0.3, 16, 0.9, GAINING)
    for a, b in zip(jax.tree.leaves(healed), jax.tree.leaves(fresh), strict=True):
        assert a == b


def test_a_control_that_is_not_a_number_is_no_light():
    state = history(20.0, 100.0, 95.0, 3.0)
    assert int(next_count(state, np.nan, CONTROLLER)) == int(next_count(state, 0.0, CONTROLLER)) == 8
    assert int(next_count(state, np.inf, CONTROLLER)) == 64


@pytest.mark.parametrize(
    "mean, deviation", [(1e8, 1e15), (1e8, 1e17), (1e17, 1e33), (0.0, 3e38), (1e19, 1.0), (3e38, 0.0)]
)
def test_a_firefly_is_forgotten(mean, deviation):
    # Finite, in the dark, and larger than anything: gone after the frames that fade it, 2^-300 of it.
    controller = Controller(1e-3, alpha=0.5, gain_alpha=0.5)
    calm = hit = in_frame.init(0.0, controller)
    for frame in range(300):
        calm = update(calm, 0.1, 0.05, 16, 0.2, controller)
        brought = (mean, deviation, 16, 0.0) if frame == 5 else (0.1, 0.05, 16, 0.2)
        hit = update(hit, *brought, controller)
    assert np.all(np.isfinite(jax.tree.leaves(hit)))
    assert float(safety(hit)) == pytest.approx(float(safety(calm)), rel=1e-4)
    assert float(sequence_gain(hit)) == pytest.approx(float(sequence_gain(calm)), rel=1e-4)
    assert int(next_count(hit, 0.2, controller)) == int(next_count(calm, 0.2, controller))


@pytest.mark.parametrize("stored", [jnp.float16, jnp.bfloat16, jnp.float32])
def test_the_largest_numbers_stay_finite(stored):
    state = in_frame.init(0.0, GAINING, dtype=stored)
    for _ in range(20):
        state = update(state, 1e4, 1e8, 64, 0.0, GAINING)
        assert np.all(np.isfinite([float(leaf) for leaf in jax.tree.leaves(state)]))
        assert int(next_count(state, 1.0, GAINING)) == 64


# Transformations


def test_not_compiled_as_compiled():
    state, brought = usual(gain=True), (0.7, 0.3, 16, 0.9)
    eager, compiled = in_frame.update(state, *brought, controller=GAINING), update(state, *brought, GAINING)
    # Roundings of sums that may be fused, relative to their largest terms.
    for a, b in zip(jax.tree.leaves(eager), jax.tree.leaves(compiled), strict=True):
        assert a.dtype == b.dtype == jnp.float32
        assert float(a) == pytest.approx(float(b), rel=1e-6, abs=1e-6)
    found, expected = (f(state, 0.3, GAINING) for f in (in_frame.sample_variance, sample_variance))
    assert float(found) == pytest.approx(float(expected), rel=1e-6)
    assert int(in_frame.next_count(state, 0.3, GAINING)) == int(next_count(state, 0.3, GAINING))


def test_mapped_as_in_a_loop(x64):
    # Over pixels, and over constants.
    brought = frames(9)
    controller = Controller(0.01, alpha=0.1, gain_alpha=0.1)
    together = histories(brought, controller)
    last = jax.tree.map(lambda v: v[-1], together)
    mapped = jax.vmap(lambda h, g: in_frame.next_count(h, g, controller))(last, brought[3][-1])
    assert np.array_equal(mapped, next_count(last, brought[3][-1], controller))
    for pixel in range(PIXELS):
        alone = histories(tuple(v[:, pixel] for v in brought), controller)
        for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(a[:, pixel], b, rtol=1e-12, atol=1e-14)
    alphas = jnp.array([0.02, 0.1, 1.0])

    def over(alpha):
        return histories(brought, Controller(0.01, alpha, gain_alpha=0.1))

    mapped = eqx.filter_vmap(over)(alphas)
    for index, alpha in enumerate(alphas):
        for a, b in zip(jax.tree.leaves(mapped), jax.tree.leaves(over(alpha)), strict=True):
            np.testing.assert_allclose(a[index], b, rtol=1e-12, atol=1e-14)


def test_constants_as_maps():
    alphas, targets = np.array([0.1, 0.5], np.float32), np.array([1e-3, 1e-2], np.float32)
    state = jax.tree.map(lambda v: jnp.full(2, v), usual())
    together = update(state, 0.7, 0.3, 16, 0.9, Controller(targets, alphas))
    asked = next_count(together, 0.5, Controller(targets, alphas))
    for index in range(2):
        one = Controller(float(targets[index]), float(alphas[index]))
        alone = update(usual(), 0.7, 0.3, 16, 0.9, one)
        for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            assert float(a[index]) == pytest.approx(float(b), rel=1e-6)
        assert int(asked[index]) == int(next_count(alone, 0.5, one))


def wanted(numbers, control, target):
    """What a count is made of, before it is rounded, which has no gradient."""
    state = history(*numbers[:4], dtype=float, gain=numbers[4:])
    controller = Controller(target, alpha=0.1, gain_alpha=0.1)
    state = in_frame.update(state, 0.7, 0.3, 16, control, controller)
    return (
        in_frame.sample_variance(state, control, controller)
        * in_frame.safety(state)
        * (in_frame.sequence_gain(state))
    )


value = jax.jit(wanted)
slopes = jax.jit(jax.grad(wanted, argnums=(0, 1, 2)))


def test_gradients_are_slopes(x64):
    numbers = jnp.array([20.0, 100.0, 95.0, 3.0, 0.7, 12.0, 0.02, 0.05])
    gradient = slopes(numbers, 0.9, 1e-2)
    for index in range(8):
        step = np.zeros(8)
        step[index] = 1e-5
        slope = (value(numbers + step, 0.9, 1e-2) - value(numbers - step, 0.9, 1e-2)) / 2e-5
        # A central difference is off by its square and by rounding, 1e-16 / 1e-5.
        assert float(gradient[0][index]) == pytest.approx(float(slope), rel=1e-5, abs=1e-9)
    for index, (low, high) in (
        (1, ((0.9 - 1e-5, 1e-2), (0.9 + 1e-5, 1e-2))),
        (2, ((0.9, 1e-2 - 1e-6), (0.9, 1e-2 + 1e-6))),
    ):
        slope = (value(numbers, *high) - value(numbers, *low)) / (high[index - 1] - low[index - 1])
        assert float(gradient[index]) == pytest.approx(float(slope), rel=1e-5)


@pytest.mark.parametrize(
    "numbers, control",
    [
        ((0.0,) * 8, 1.0),
        ((0.0,) * 8, 0.0),
        ((0.0, 50.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0),
        ((20.0, 100.0, 95.0, 3.0, 0.7, 12.0, 0.0, 0.0), 0.0),
        ((1e30, 1.0, 1.0, 1e30, 0.0, 0.0, 0.0, 0.0), 1.0),
    ],
)
def test_gradients_are_finite_where_nothing_is_known(x64, numbers, control):
    for leaf in slopes(jnp.array(numbers), control, 1e-2):
        assert np.all(np.isfinite(leaf))


def test_gradients_of_the_history_itself(x64):
    for numbers in ((0.0, 0.0, 0.0, 0.0), USUAL):
        of_safety = jax.grad(lambda n: in_frame.safety(history(*n, dtype=float)))(jnp.array(numbers))
        assert np.all(np.isfinite(of_safety))
    of_gain = jax.grad(lambda n: in_frame.sequence_gain(history(*USUAL, dtype=float, gain=n)))(jnp.zeros(4))
    assert np.all(np.isfinite(of_gain))


# Faults


@pytest.mark.parametrize(
    "fault, message",
    [
        ({"target_variance": 0.0}, "target_variance must be above 0, got 0.0"),
        ({"alpha": 0.0}, r"alpha must be in \(0, 1\], got 0; it is the weight of the newest sample"),
        ({"alpha": 1.1}, r"alpha must be in \(0, 1\], got 1.1"),
        ({"gain_alpha": 2.0}, r"alpha must be in \(0, 1\], got 2"),
        ({"min_spp": 1}, "min_spp must be at least 2, got 1"),
        ({"min_spp": 9, "max_spp": 8}, "min_spp must not exceed max_spp, got 9 and 8"),
        ({"rounding": "away"}, "rounding must be one of nearest, up, down, got 'away'"),
    ],
)
def test_faults_of_constants(fault, message):
    with pytest.raises(ValueError, match=message):
        Controller(**({"target_variance": 1e-3} | fault))


@pytest.mark.parametrize("name", ["mean", "square_deviation", "count", "control", "missing", "valid"])
def test_faults_of_shapes(name):
    state = in_frame.init(jnp.zeros((2, 3)), CONTROLLER)
    given_shapes: dict[str, Any] = {"mean": 0.5, "square_deviation": 0.1, "count": 8, "control": 1.0}
    given_shapes |= {"missing": False, "valid": True}
    given_shapes[name] = np.broadcast_to(np.asarray(given_shapes[name]), 4)
    first = [given_shapes.pop(key) for key in ("mean", "square_deviation", "count", "control")]
    with pytest.raises(ValueError, match=rf"{name} must broadcast to the shape \(2, 3\), got \(4,\)"):
        in_frame.update(state, *first, controller=CONTROLLER, **given_shapes)


def test_a_history_without_a_gain_for_a_controller_with_one():
    with pytest.raises(ValueError, match="history must keep a gain for a controller with a gain_alpha"):
        in_frame.update(usual(), 0.5, 0.1, 8, 1.0, GAINING)
    # The other way round the gain is left alone.
    found = update(usual(gain=True), 0.5, 0.1, 8, 1.0, CONTROLLER)
    assert found.gain is not None and float(found.gain.temporal) == np.float32(0.02)
