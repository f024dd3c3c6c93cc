"""Reprojection: lookups against loops and SciPy's interpolation, and what is refused."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage
from temporal_cases import (
    SIZE,
    bilinear,
    catmull_rom,
    images,
    inside,
    looked_up_by_loop,
    masks,
    motions,
    nearest,
    off_screen,
    pixels_of,
    surroundings,
    tent,
)

from sssfit.frames import temporal


def keys(x):
    """Keys' cubic for a = -1/2 as his paper has it, in powers of the distance."""
    s = abs(x)
    if s >= 2:
        return 0.0
    return 1.5 * s**3 - 2.5 * s**2 + 1 if s <= 1 else -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2


def test_nearest_is_the_pixel_that_the_place_is_in(dtype):
    history = {"count": np.arange(54, dtype=np.int32).reshape(SIZE), "mean": images(dtype=dtype)}
    history["packed"] = (history["mean"].astype(np.float16), np.arange(54 * 8).reshape(*SIZE, 2, 4) % 7 == 0)
    motion = motions(dtype=dtype)
    found = nearest(history, motion)
    assert jax.tree.structure(found) == jax.tree.structure(history)
    for leaf, given_leaf in zip(jax.tree.leaves(found), jax.tree.leaves(history), strict=True):
        expected = np.empty_like(given_leaf)
        for row, column, x, y in pixels_of(motion):
            pixel = inside(math.floor(y), SIZE[0]), inside(math.floor(x), SIZE[1])
            expected[row, column] = given_leaf[pixel]
        assert leaf.dtype == jnp.asarray(given_leaf).dtype
        np.testing.assert_array_equal(leaf, expected)


def test_nearest_is_right_to_the_last_digit():
    # Half a pixel and its neighbours among float32, where adding 0.5 would round up to the next pixel.
    half = np.float32(0.5)
    steps = [np.nextafter(half, np.float32(0)), half, -half, np.nextafter(-half, np.float32(-1))]
    motion = np.zeros((1, 5000, 2), np.float32)
    motion[0, 4000:4004, 0] = steps
    found = np.asarray(nearest(np.arange(5000)[None], motion))[0]
    assert found[4000:4004].tolist() == [4000, 4002, 4002, 4002]
    assert not off_screen(motion[:, :, ::-1])[0, 4000] and off_screen(motion[:, :, ::-1])[0, 4001]


def test_bilinear_is_scipy_s(dtype):
    image, motion = images(dtype=dtype), motions(dtype=dtype)
    found = bilinear(image, motion)
    assert found.dtype == dtype
    row, column = np.indices(SIZE)
    place = [row + motion[..., 1].astype(np.float64), column + motion[..., 0]]
    expected = np.stack(
        [
            ndimage.map_coordinates(image[..., c].astype(np.float64), place, order=1, mode="nearest")
            for c in range(3)
        ],
        axis=-1,
    )
    # A weight is within 2 eps, half of one for each share and for their product; so are three sums.
    assert np.asarray(found) == pytest.approx(expected, abs=4 * float(np.finfo(dtype).eps * image.max()))


def test_bilinear_counts_the_masked_pixels_alone(dtype):
    image, motion, mask = images(dtype=dtype), motions(dtype=dtype), masks()
    expected = looked_up_by_loop(image, motion, tent, 1, mask)
    found = np.asarray(bilinear(image, motion, mask=mask))
    # As above, and more so the smaller the sum of the weights that divides them.
    covered = looked_up_by_loop(mask[..., None].astype(float), motion, tent, 1)
    close = 8 * float(np.finfo(dtype).eps * image.max())
    assert np.all(np.abs(found - expected) * np.where(covered > 0, covered, 1) <= close)


def test_catmull_rom_is_keys_cubic(dtype):
    image, motion = images(dtype=dtype), motions(dtype=dtype)
    expected = looked_up_by_loop(image, motion, keys, 2)
    found = catmull_rom(image, motion, clamp=False)
    assert found.dtype == dtype
    # A weight is within 4 eps (its terms are up to 4), each of the sixteen products and sums within half of
    # one; the weights' sum of absolute values is below 1.6.
    close = 16 * float(np.finfo(dtype).eps * image.max())
    assert np.asarray(found) == pytest.approx(expected, abs=close)
    clamped = np.asarray(catmull_rom(image, motion))
    differ = np.abs(clamped - np.asarray(found)).max(axis=-1) > close
    # Noise rings almost everywhere, by more than rounding.
    assert 0.02 < differ.mean() < 0.9
    for row, column, x, y in pixels_of(motion):
        rows = [inside(math.floor(y - 0.5) + k, SIZE[0]) for k in range(-1, 3)]
        columns = [inside(math.floor(x - 0.5) + k, SIZE[1]) for k in range(-1, 3)]
        sixteen = image[np.ix_(rows, columns)].reshape(16, 3)
        assert np.all(clamped[row, column] >= sixteen.min(axis=0))
        assert np.all(clamped[row, column] <= sixteen.max(axis=0))
        bounded = np.clip(expected[row, column], sixteen.min(axis=0), sixteen.max(axis=0))
        whole = np.array([x, y]) % 1 == 0.5
        if not whole.any():
            assert clamped[row, column] == pytest.approx(bounded, abs=close)


def test_catmull_rom_beside_what_does_not_count_is_bilinear():
    image, motion, mask = images(), motions(), masks()
    mask[:, 5:] = True
    expected = np.asarray(bilinear(image, motion, mask=mask))
    free = np.asarray(catmull_rom(image, motion))
    found = np.asarray(catmull_rom(image, motion, mask=mask))
    complete = np.zeros(SIZE, bool)
    for row, column, x, y in pixels_of(motion):
        weighed = [
            mask[inside(math.floor(y) + j, SIZE[0]), inside(math.floor(x) + i, SIZE[1])]
            for j, i in itertools.product(range(-2, 3), repeat=2)
            if keys(math.floor(x) + i + 0.5 - x) * keys(math.floor(y) + j + 0.5 - y) != 0
        ]
        complete[row, column] = all(weighed)
    assert 0.1 < complete.mean() < 0.9
    np.testing.assert_array_equal(found, np.where(complete[..., None], free, expected))


def test_half_precision_places_are_single_precision_s():
    image = np.arange(3000, dtype=np.float16)[None, :, None] % 7
    found = bilinear(image, np.full((1, 3000, 2), [0.25, 0], np.float16))
    assert found.dtype == jnp.float16
    exact = image[0, :, 0].astype(float) * 0.75 + np.append(image[0, 1:, 0], image[0, -1, 0]) * 0.25
    # Quarters of whole numbers below 7 are numbers of half precision.
    np.testing.assert_array_equal(found[0, :, 0], exact)


def test_what_does_not_fit_is_refused():
    image, motion, mask = images(), motions(), masks()
    depth, ids, *_ = surroundings("float32")
    refused = {
        r"motion must have shape \(6, 9, 2\), got \(6, 8, 2\)": lambda: temporal.bilinear(
            image, motion[:, 1:]
        ),
        r"motion must have shape \(H, W, 2\), got \(6, 9\)": lambda: temporal.off_screen(motion[..., 0]),
        r"motion must have at least one pixel, got shape \(0, 9, 2\)": lambda: temporal.off_screen(
            motion[:0]
        ),
        r"history must have the motion's shape \(6, 9, \.\.\.\), got \(6, 7\)": lambda: temporal.nearest(
            {"ids": ids[:, 2:]}, motion
        ),
        r"image must have shape \(H, W, C\) and at least one pixel, got \(6, 9\)": lambda: (
            temporal.catmull_rom(image[..., 0], motion)
        ),
        r"mask must have the image's shape \(6, 9\), got \(5, 9\)": lambda: temporal.catmull_rom(
            image, motion, mask=mask[1:]
        ),
        r"previous_depth must have shape \(H, W\), all four the same, got \(5, 9\)": lambda: (
            temporal.disoccluded(depth, ids, depth[1:], ids, motion)
        ),
        r"depth must have shape \(H, W\), all four the same, got \(6, 9, 1\)": lambda: temporal.disoccluded(
            depth[..., None], ids, depth, ids, motion
        ),
        "depth_tolerance must be at least 0, got -0.1": lambda: temporal.disoccluded(
            depth, ids, depth, ids, motion, depth_tolerance=-0.1
        ),
    }
    for message, call in refused.items():
        with pytest.raises(ValueError, match=f"^{message}$"):
            call()
