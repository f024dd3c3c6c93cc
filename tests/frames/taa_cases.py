"""What the tests of temporal antialiasing share: the compiled step, random images, masks and motions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.frames import taa

compiled = eqx.filter_jit(taa.accumulate)
SIZE = (5, 7)
CLAMPED = ("neighbourhood", "variance")
each_clamping = pytest.mark.parametrize("clamping", taa.CLAMPINGS)
each_box = pytest.mark.parametrize("clamping", CLAMPED)


def accumulate(history, image, *, config=taa.DEFAULT, **options):
    """`taa.accumulate`, compiled once for all constants of one kind."""
    config, options = jax.tree.map(jnp.asarray, (config, options))
    return compiled(history, image, config=config, **options)


def images(seed=1, dtype="float32", size=SIZE):
    return np.random.default_rng(seed).lognormal(size=(*size, 3)).astype(dtype)


def masks(seed=3, size=SIZE, share=0.7):
    return np.random.default_rng(seed).random(size) < share


def motions(seed=4, size=SIZE):
    return np.random.default_rng(seed).uniform(-2, 2, (*size, 2)).astype(np.float32)
