"""The controller that looks inside the frames: where nothing is known, and what teaches nothing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from in_frame_cases import (
    CONTROLLER,
    GAINING,
    history,
    next_count,
    safety,
    sample_variance,
    sequence_gain,
    update,
    usual,
)

from sssfit.estimators import in_frame
from sssfit.estimators.in_frame import Controller


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
