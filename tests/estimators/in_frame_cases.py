"""Histories and frames that the tests of `in_frame` share, and its functions compiled."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import strategies as st

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
