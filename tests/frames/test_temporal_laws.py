"""Laws of lookups: what stays constant, what is found exactly, and what never bleeds or is left."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from temporal_cases import (
    EXTREMES,
    LOOKUPS,
    SIZE,
    bilinear,
    catmull_rom,
    each_filter,
    each_lookup,
    images,
    looked_up_by_loop,
    masks,
    motions,
    nearest,
    off_screen,
    tent,
)

from sssfit.frames import temporal


@each_filter
@given(seed=st.integers(0, 100), share=st.floats(0, 1), reach=st.floats(0, 20))
def test_constants_stay_constant(lookup, seed, share, reach):
    constant = np.array([0.1, 3.7, 1e5], np.float32)
    image = np.broadcast_to(constant, (*SIZE, 3))
    motion = motions(seed, reach=reach)
    mask = np.random.default_rng(seed).random(SIZE) < share
    # As above: the weights' sum is within 16 eps of 1.
    for found in (lookup(image, motion), lookup(image, motion, mask=mask)):
        assert np.asarray(found) == pytest.approx(image, rel=16 * 2.0**-23)


@given(x=st.integers(-12, 12), y=st.integers(-12, 12), masked=st.booleans())
@each_lookup
def test_whole_pixels_are_found_exactly(lookup, x, y, masked):
    image = images()
    motion = np.broadcast_to(np.array([x, y], np.float32), (*SIZE, 2))
    row, column = np.indices(SIZE)
    expected = image[np.clip(row + y, 0, SIZE[0] - 1), np.clip(column + x, 0, SIZE[1] - 1)]
    options = {"mask": masks()} if masked and lookup is not nearest else {}
    np.testing.assert_array_equal(lookup(image, motion, **options), expected)
    if abs(x) < SIZE[1] and abs(y) < SIZE[0]:
        # Inside, it is NumPy's roll.
        seen = ~np.asarray(off_screen(motion))
        np.testing.assert_array_equal(expected[seen], np.roll(image, (-y, -x), (0, 1))[seen])


@each_lookup
def test_without_motion_nothing_changes(lookup):
    for dtype in ("float16", "float32"):
        image = images(dtype=dtype)
        image[2, 3] = np.nan
        for motion in (None, np.zeros((*SIZE, 2), np.float32)):
            found = lookup(image, motion)
            assert found.dtype == dtype
            # A NaN stays where it is.
            np.testing.assert_array_equal(found, image)
    history = {"a": image}
    assert temporal.nearest(history, None) is history


def test_quadratic_images_are_reproduced_by_catmull_rom(x64):
    row, column = np.indices((12, 14)) + 0.5

    def image(x, y):
        return np.stack([1 + x - 2 * y, x * x + y * y, x * y * y], axis=-1)

    motion = motions(size=(12, 14), reach=1.5, dtype="float64")
    x, y = column + motion[..., 0], row + motion[..., 1]
    whole = (x >= 1.5) & (x <= 12.5) & (y >= 1.5) & (y <= 10.5)
    found = np.asarray(catmull_rom(image(column, row), motion, clamp=False))
    assert found[whole] == pytest.approx(image(x, y)[whole], rel=1e-13, abs=1e-10)
    assert whole.sum() > 50


@each_filter
def test_nothing_bleeds_from_outside_the_mask(lookup):
    image, motion, mask = images(), motions(), masks()
    found = np.asarray(lookup(image, motion, mask=mask))
    for outside in (np.nan, np.inf, 1e30):
        spoiled = np.asarray(lookup(np.where(mask[..., None], image, np.float32(outside)), motion, mask=mask))
        same = (spoiled == found).all(axis=-1)
        # The rest has none of the mask around, and is the nearest pixel.
        lone = looked_up_by_loop(mask[..., None].astype(float), motion, tent, 1)[..., 0] == 0
        np.testing.assert_array_equal(same, ~lone)
        assert np.all(~(spoiled[lone] < 1e30))
    kept = image[mask]
    touched = ~lone
    assert np.all(found[touched] <= kept.max(axis=0) * (1 + 1e-6)) or lookup is LOOKUPS["unclamped"]


@each_filter
def test_an_empty_mask_gives_the_nearest_pixel(lookup):
    image, motion = images(), motions()
    found = lookup(image, motion, mask=np.zeros(SIZE, bool))
    np.testing.assert_array_equal(found, nearest(image, motion))


def test_a_share_of_next_to_nothing_still_counts():
    # The only masked pixel weighs 1e-30, and what it holds is as small.
    image = np.array([[[5.0], [1e-20]]], np.float32)
    motion = np.full((1, 2, 2), [1e-30, 0], np.float32)
    found = bilinear(image, motion, mask=np.array([[False, True]]))
    assert found[0].tolist() == [[pytest.approx(1e-20, rel=1e-6)]] * 2


@pytest.mark.parametrize("lookup", [nearest, bilinear, catmull_rom])
@pytest.mark.parametrize("size", [(1, 1), (1, 4), (4, 5)], ids=str)
def test_motion_beyond_all_bounds_finds_the_edge(lookup, size):
    image = images(size=size)
    height, width = size
    for x, y in itertools.product(EXTREMES, repeat=2):
        found = np.asarray(lookup(image, np.full((*size, 2), [x, y], np.float32)))
        corner = image[0 if y < 0 else height - 1, 0 if x < 0 else width - 1]
        np.testing.assert_array_equal(found, np.broadcast_to(corner, image.shape))
    for x, y in ((np.nan, 0), (0, np.nan), (np.nan, np.nan)):
        np.testing.assert_array_equal(lookup(image, np.full((*size, 2), [x, y], np.float32)), image)
