"""Mipmaps with masks: block sums and tents by NumPy, energy, and nothing that bleeds."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.frames import mipmap

# Every size of a frame compiles anew.
pytestmark = pytest.mark.slow

build = jax.jit(mipmap.build, static_argnames="levels")
lookup = jax.jit(mipmap.lookup)

SIZES = [(1, 1), (1, 7), (9, 2), (17, 30)]
each_size = pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")


def frame(size, seed=1, share=0.7, dtype="float32"):
    generator = np.random.default_rng(seed)
    return generator.lognormal(size=(*size, 3)).astype(dtype), generator.random(size) < share


def block_means(values, mask, level):
    """Means over squares of 2^level pixels, with nothing beyond the frame, in float64."""
    side, (height, width) = 2**level, mask.shape
    weighted = np.concatenate([np.where(mask[..., None], values, 0), mask[..., None]], -1).astype(np.float64)
    rows = -(-height // side)
    columns = -(-width // side)
    means = np.zeros((rows, columns, 4))
    for i in range(rows):
        for j in range(columns):
            block = weighted[i * side : (i + 1) * side, j * side : (j + 1) * side]
            means[i, j] = block.sum(axis=(0, 1)) / side**2
    return means


def tents(values, mask, column, row, level):
    """What a lookup finds, by weights of all texels of a level."""
    found = np.zeros(4)
    for number in range(64):
        share = max(0, 1 - abs(level - number))
        if share == 0:
            continue
        means = block_means(values, mask, number)
        across = np.maximum(0, 1 - np.abs(column / 2**number - np.arange(means.shape[1]) - 0.5))
        down = np.maximum(0, 1 - np.abs(row / 2**number - np.arange(means.shape[0]) - 0.5))
        found = found + share * np.einsum("i,j,ijc->c", down, across, means)
    total, coverage = found[:3], found[3]
    return (total / coverage if coverage > 0 else np.zeros(3)), coverage


@each_size
def test_levels_are_means_over_squares(size, dtype):
    values, mask = frame(size, dtype=dtype)
    found = build(values, mask)
    assert found.sizes[0] == size and found.sizes[-1] == (1, 1)
    assert found.texels.dtype == dtype and len(found.sizes) == max(size[0] - 1, size[1] - 1).bit_length() + 1
    for number in range(len(found.sizes)):
        level = np.asarray(found.level(number))
        expected = block_means(values, mask, number)
        assert level.shape == expected.shape == (*found.sizes[number], 4)
        # Positive terms, added in pairs: each level rounds twice.
        assert level == pytest.approx(expected, rel=(2 * number + 1) * float(np.finfo(dtype).eps))


@each_size
def test_energy_is_kept_whatever_the_size(size):
    values, mask = frame(size, 2)
    found = build(values, mask)
    total = [math.fsum(values[..., c][mask].tolist()) for c in range(3)]
    for number in range(len(found.sizes)):
        level = np.asarray(found.level(number), np.float64).reshape(-1, 4)
        sums = [math.fsum(level[:, c].tolist()) * 4**number for c in range(4)]
        assert sums[:3] == pytest.approx(total, rel=(2 * number + 1) * 2.0**-23)
        # The mask's means are fractions of powers of 2: exact.
        assert sums[3] == mask.sum()


@each_size
def test_a_lookup_is_a_sum_of_tents(size, dtype):
    values, mask = frame(size, 3, dtype=dtype)
    found = build(values, mask)
    generator = np.random.default_rng(4)
    places = generator.uniform(-2, [size[1] + 2, size[0] + 2], (40, 2))
    levels = generator.uniform(0, len(found.sizes) - 1, 40)
    levels[:8] = np.round(levels[:8])
    places, levels = places.astype(dtype), levels.astype(dtype)
    got = lookup(found, places[:, 0], places[:, 1], levels)
    assert got.values.dtype == got.coverage.dtype == dtype
    for k in range(40):
        column, row = places[k].tolist()
        expected, coverage = tents(values, mask, column, row, float(levels[k]))
        # Taking 0.5 from a place of up to 32 pixels is within 16 eps, and so is each of the weights in both
        # directions of four texels whose sum this is.
        bound = 128 * float(np.finfo(dtype).eps)
        assert float(got.coverage[k]) == pytest.approx(coverage, abs=bound)
        if coverage > 0:
            close = 2 * bound * values.max() / coverage
            assert np.asarray(got.values[k]) == pytest.approx(expected, abs=close)


@each_size
def test_level_0_at_a_centre_is_the_pixel(size):
    values, mask = frame(size, 5)
    row, column = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5, indexing="ij")
    found = lookup(build(values, mask), column, row, 0.0)
    assert np.array_equal(found.values, np.where(mask[..., None], values, 0))
    assert np.array_equal(found.coverage, mask)


@given(seed=st.integers(0, 1000), share=st.floats(0.01, 1), level=st.floats(0, 5))
def test_constants_stay_constant_at_every_level_and_mask(seed, share, level):
    _, mask = frame((17, 30), seed, share)
    found = build(np.full((17, 30, 3), [0.1, 3.7, 1e5], np.float32), mask)
    places = np.random.default_rng(seed).uniform(0, [30, 17], (64, 2)).astype(np.float32)
    got = lookup(found, places[:, 0], places[:, 1], np.float32(level))
    covered = np.asarray(got.coverage) > 0
    expected = np.broadcast_to(np.array([0.1, 3.7, 1e5], np.float32), got.values.shape)
    # 2 roundings a level, 4 texels, 2 levels and the division.
    assert np.asarray(got.values)[covered] == pytest.approx(expected[covered], rel=16 * 2.0**-23)
    assert np.all(np.asarray(got.values)[~covered] == 0)
    assert np.all((got.coverage >= 0) & (got.coverage <= 1 + 8 * 2.0**-23))


@each_size
def test_nothing_bleeds_from_outside_the_mask(size):
    values, mask = frame(size, 6)
    for outside in (np.nan, np.inf, 1e30):
        spoiled = np.where(mask[..., None], values, np.float32(outside))
        assert np.array_equal(build(spoiled, mask).texels, build(values, mask).texels)
    # Two profiles: the values found for one are between its own.
    found = build(values, mask)
    places = np.random.default_rng(7).uniform(0, size[::-1], (200, 2)).astype(np.float32)
    levels = np.linspace(0, len(found.sizes) - 1, 200, dtype=np.float32)
    got = lookup(found, places[:, 0], places[:, 1], levels)
    covered = np.asarray(got.coverage) > 0
    if mask.any():
        inside = values[mask]
        assert np.all(np.asarray(got.values)[covered] <= inside.max(axis=0) * (1 + 2e-6))
        assert np.all(np.asarray(got.values)[covered] >= inside.min(axis=0) * (1 - 2e-6))


def test_an_empty_mask_gives_zeros(dtype):
    values, _ = frame((6, 11), 8, dtype=dtype)
    values[0, 0] = np.nan
    found = build(values, np.zeros((6, 11), bool))
    got = lookup(found, np.linspace(-1, 12, 20), 3.0, np.linspace(0, 4, 20))
    assert np.all(np.asarray(got.values) == 0) and np.all(np.asarray(got.coverage) == 0)


def test_places_and_levels_off_the_frame():
    values, mask = frame((6, 11), 9, share=1.1)
    found = build(values, mask)
    last = len(found.sizes) - 1
    for column, row in ((-1e30, 3.0), (1e30, 3.0), (3.0, -100.0), (5.0, 1e9), (np.inf, 3.0)):
        got = lookup(found, column, row, 0.0)
        assert float(got.coverage) == 0 and np.all(got.values == 0)
    for level, same in ((-3.0, 0.0), (1e30, last), (31.0, last), (np.inf, last)):
        assert np.array_equal(lookup(found, 5.5, 2.5, level).values, lookup(found, 5.5, 2.5, same).values)
    # Half of the footprint of a place on the edge lies outside.
    assert float(lookup(found, 0.0, 2.5, 0.0).coverage) == 0.5
    assert np.array_equal(lookup(found, 0.0, 2.5, 0.0).values, values[2, 0])
    for column, row, level in ((np.nan, 2.5, 0.0), (2.5, np.nan, 0.0), (2.5, 2.5, np.nan)):
        assert np.isnan(lookup(found, column, row, level).values).all()


def test_one_bad_pixel_spoils_its_surroundings_alone():
    values, mask = frame((8, 8), 10, share=1.1)
    values[0, 0] = np.nan
    got = lookup(build(values, mask), np.array([4.5, 7.9, 0.5]), np.array([4.5, 0.1, 0.5]), 0.0)
    assert np.isfinite(got.values[:2]).all() and np.isnan(got.values[2]).all()


def test_a_flipped_frame_is_found_flipped():
    values, mask = frame((16, 32), 11)
    plain, flipped = build(values, mask), build(values[:, ::-1], mask[:, ::-1])
    turned = build(values.swapaxes(0, 1), mask.T)
    places = np.random.default_rng(12).uniform(0, [32, 16], (100, 2)).astype(np.float32)
    level = np.linspace(0, 4, 100, dtype=np.float32)
    expected = lookup(plain, places[:, 0], places[:, 1], level)
    for found in (
        lookup(flipped, 32 - places[:, 0], places[:, 1], level),
        lookup(turned, places[:, 1], places[:, 0], level),
    ):
        # As above, for two lookups and the rounded place of the second.
        bound = 3 * 128 * 2.0**-23
        coverage = np.asarray(expected.coverage)
        assert np.asarray(found.coverage) == pytest.approx(coverage, abs=bound)
        apart = np.abs(np.asarray(found.values) - np.asarray(expected.values)).max(axis=1)
        assert np.all(apart * coverage <= 2 * bound * values.max()) and (coverage > 0.5).sum() > 50


def test_weights_in_place_of_a_mask():
    values = np.array([[[1.0], [4.0]]], np.float32)
    found = build(values, np.array([[0.25, 0.75]], np.float32))
    assert found.level(1).tolist() == [[[(0.25 + 3) / 4, 0.25]]]
    assert lookup(found, 1.0, 1.0, 1.0).values.tolist() == [3.25]


def test_fewer_levels():
    values, mask = frame((16, 16), 13)
    full = build(values, mask)
    for levels in (1, 3, 5, 99):
        found = build(values, mask, levels=levels)
        assert found.sizes == full.sizes[:levels]
        assert np.array_equal(found.texels, full.texels[: len(found.texels)])
    assert float(lookup(build(values, mask, levels=1), 3.2, 4.5, 7.0).coverage) >= 0


def test_half_precision_looks_up_in_single():
    values, mask = np.full((4, 2000, 3), 0.3, np.float16), np.ones((4, 2000), bool)
    values[:, 1999] = 7
    found = build(values, mask)
    assert found.texels.dtype == jnp.float16
    got = lookup(found, np.float32(1999.5), 1.5, 0.0)
    assert got.values.dtype == jnp.float16 and got.values.tolist() == [7, 7, 7]
    wide = lookup(found, 500.0, 2.0, 3.0).values
    assert np.asarray(wide, np.float32) == pytest.approx(0.3, rel=2e-3)


def test_transforms():
    values, mask = frame((3, 4), 14)
    close = 8 * 2.0**-23
    found = build(values, mask)
    eager = mipmap.build(values, mask)
    assert np.asarray(eager.texels) == pytest.approx(np.asarray(found.texels), rel=close)
    column, row = np.linspace(0, 4, 9, dtype=np.float32), np.linspace(0, 3, 9, dtype=np.float32)
    level = np.linspace(0, 2, 9, dtype=np.float32)
    expected = lookup(found, column, row, level)
    for a, b in zip(mipmap.lookup(found, column, row, level), expected, strict=True):
        assert np.asarray(a) == pytest.approx(np.asarray(b), rel=close, abs=close)
    mapped = jax.jit(jax.vmap(mipmap.lookup, in_axes=(None, 0, 0, 0)))(found, column, row, level)
    for a, b in zip(mapped, expected, strict=True):
        assert np.asarray(a) == pytest.approx(np.asarray(b), rel=close, abs=close)
    stack = jax.jit(jax.vmap(mipmap.build))(np.stack([values, 2 * values]), np.stack([mask, mask]))
    assert np.asarray(stack.texels[0]) == pytest.approx(np.asarray(found.texels), rel=close)
    assert lookup(found, column[:, None], row, 0.0).values.shape == (9, 9, 3)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_gradients_are_finite_and_those_of_a_mean(share, x64):
    values, mask = frame((7, 10), 15, share, dtype="float64")

    @jax.jit
    def found(values, column, row, level):
        return mipmap.lookup(mipmap.build(values, mask), column, row, level).values.sum()

    arguments = (jnp.asarray(values), 4.3, 3.1, 1.4)
    gradients = jax.jit(jax.grad(found, argnums=(0, 1, 2, 3)))(*arguments)
    assert all(np.isfinite(gradient).all() for gradient in gradients)
    # Weights of a mean: positive, and 1 in total for each channel.
    by_pixel = np.asarray(gradients[0])
    assert np.all(by_pixel >= 0) and np.all(by_pixel[~mask] == 0)
    assert by_pixel.sum() == pytest.approx(3 if mask.any() else 0)
    step = 1e-6
    for k in (1, 2, 3):
        up, down = ([*arguments[:k], arguments[k] + s, *arguments[k + 1 :]] for s in (step, -step))
        difference = (found(*up) - found(*down)) / (2 * step)
        assert float(gradients[k]) == pytest.approx(float(difference), rel=1e-6, abs=1e-8)


def test_what_does_not_fit_is_refused():
    values, mask = frame((4, 5))
    with pytest.raises(ValueError, match=r"^values must have shape \(H, W, C\) and mask \(H, W\), got"):
        mipmap.build(values, mask[:3])
    with pytest.raises(ValueError, match=r"got \(4, 5\) and \(4, 5\)$"):
        mipmap.build(values[..., 0], mask)
    with pytest.raises(ValueError, match="levels must be at least 1, got 0"):
        mipmap.build(values, mask, levels=0)
    with pytest.raises(ValueError, match="at least one pixel"):
        mipmap.build(values[:0], mask[:0])
