"""The controller that looks inside the frames: the ends of the formats, transformations, faults."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from in_frame_cases import (
    CONTROLLER,
    GAINING,
    PIXELS,
    USUAL,
    frames,
    histories,
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
@pytest.mark.parametrize("which", range(8))
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
