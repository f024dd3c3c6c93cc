"""Where in its pixel a frame is sampled: SciPy's Halton points."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import qmc

from sssfit.frames import procedural, taa


@pytest.mark.parametrize("length", [1, 8, 13, 4096])
def test_jitter_is_halton_s_without_its_first_point(length):
    expected = qmc.Halton(d=2, scramble=False).random(length + 1)[1:] - 0.5
    index = np.arange(length)
    found = jax.jit(taa.jitter, static_argnums=1)(index, length)
    assert found.dtype == jnp.float32 and found.shape == (2, length)
    assert np.asarray(found).T == pytest.approx(expected, abs=2.0**-24)
    assert np.all(np.abs(found) < 0.5)
    # Each frame has its own place, and the next round is the same.
    assert len(np.unique(np.asarray(found).T, axis=0)) == length
    eager = taa.jitter(index, length)
    assert np.asarray(eager) == pytest.approx(np.asarray(found), abs=2.0**-25)
    np.testing.assert_array_equal(taa.jitter(index + 3 * length, length), eager)
    np.testing.assert_array_equal(taa.jitter(index - length, length), eager)


def test_jitter_of_any_integer():
    assert taa.jitter(0).shape == (2,) and taa.jitter(np.zeros((3, 4), int)).shape == (2, 3, 4)
    for index in (10**30 + 3, np.uint8(203), np.int64(11), jnp.uint32(2**32 - 5), jnp.int32(3)):
        length = 8
        np.testing.assert_array_equal(taa.jitter(index, length), taa.jitter(int(index) % 8))
    # 300 is no number of a byte.
    np.testing.assert_array_equal(taa.jitter(np.uint8(203), 300), taa.jitter(203, 300))
    traced = jax.jit(lambda k: jax.lax.fori_loop(0, k, lambda i, s: s + taa.jitter(i), jnp.zeros(2)))(8)
    # The mean that the docstring tells.
    assert (np.asarray(traced) / 8).tolist() == pytest.approx([-0.0547, 0], abs=1e-4)


def test_a_jittered_camera_sees_the_place_in_the_pixel():
    camera = procedural.frame(width=8, height=6).camera
    for index in range(8):
        x, y = (float(v) for v in taa.jitter(index))
        jittered = dataclasses.replace(camera, cx=camera.cx - x, cy=camera.cy - y)
        seen = jittered.position(3.5, 2.5, 400.0)
        assert np.asarray(seen) == pytest.approx(
            np.asarray(camera.position(3.5 + x, 2.5 + y, 400.0)), rel=1e-5
        )
