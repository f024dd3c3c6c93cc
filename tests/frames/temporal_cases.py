"""What the tests of reprojection share: compiled lookups, random images, motions and masks, and loops."""

import itertools
import math

import jax
import numpy as np
import pytest

from sssfit.frames import temporal

nearest = jax.jit(temporal.nearest)
bilinear = jax.jit(temporal.bilinear)
catmull_rom = jax.jit(temporal.catmull_rom, static_argnames="clamp")
off_screen = jax.jit(temporal.off_screen)
disoccluded = jax.jit(temporal.disoccluded)
SIZE = (6, 9)
EXTREMES = (1e6, -1e6, 1e30, -3e38, np.inf, -np.inf)
LOOKUPS = {
    "nearest": nearest,
    "bilinear": bilinear,
    "catmull_rom": catmull_rom,
    "unclamped": lambda image, motion, mask=None: catmull_rom(image, motion, mask=mask, clamp=False),
}
each_lookup = pytest.mark.parametrize("lookup", LOOKUPS.values(), ids=LOOKUPS)
each_filter = pytest.mark.parametrize("lookup", [*LOOKUPS.values()][1:], ids=[*LOOKUPS][1:])


def images(seed=1, dtype="float32", size=SIZE):
    return np.random.default_rng(seed).lognormal(size=(*size, 3)).astype(dtype)


def motions(seed=2, dtype="float32", size=SIZE, reach=4.0):
    """Motions of all kinds: small, off the frame, whole and half pixels."""
    found = np.random.default_rng(seed).uniform(-reach, reach, (*size, 2))
    found.reshape(-1, 2)[::5] = np.round(found.reshape(-1, 2)[::5])
    found.reshape(-1, 2)[1::5] = np.round(found.reshape(-1, 2)[1::5]) + 0.5
    return found.astype(dtype)


def masks(seed=3, size=SIZE):
    return np.random.default_rng(seed).random(size) < 0.6


def pixels_of(motion):
    """Each pixel with the place of its point in the previous frame, in Python's numbers."""
    for row, column in np.ndindex(motion.shape[:2]):
        x, y = (float(m) for m in motion[row, column])
        yield row, column, column + 0.5 + x, row + 0.5 + y


def inside(value, size):
    return min(max(value, 0), size - 1)


def looked_up_by_loop(image, motion, kernel, reach, mask=None):
    """A separable filter by a sum over all pixels that its kernel reaches, in float64."""
    height, width = motion.shape[:2]
    found = np.zeros(image.shape)
    for row, column, x, y in pixels_of(motion):
        total, weights = np.zeros(image.shape[-1]), 0.0
        for j, i in itertools.product(range(-reach, reach + 1), repeat=2):
            across, down = math.floor(x) + i, math.floor(y) + j
            weight = kernel(across + 0.5 - x) * kernel(down + 0.5 - y)
            pixel = inside(down, height), inside(across, width)
            if weight != 0 and (mask is None or mask[pixel]):
                total, weights = total + weight * np.asarray(image[pixel], np.float64), weights + weight
        pixel = inside(math.floor(y), height), inside(math.floor(x), width)
        found[row, column] = total / weights if weights > 0 else image[pixel]
    return found


def tent(x):
    return max(0.0, 1 - abs(x))


def surroundings(dtype):
    generator = np.random.default_rng(5)
    depth, previous_depth = generator.uniform(395, 405, (2, *SIZE)).astype(dtype)
    profile_id, previous_id = generator.integers(0, 2, (2, *SIZE)).astype(np.int32)
    return depth, profile_id, previous_depth, previous_id
