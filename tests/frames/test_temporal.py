"""Reprojection: loops and SciPy's interpolation, laws of lookups, and a scene that moves in closed form."""

import itertools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from sssfit.frames import procedural, temporal

nearest = jax.jit(temporal.nearest)
bilinear = jax.jit(temporal.bilinear)
catmull_rom = jax.jit(temporal.catmull_rom, static_argnames="clamp")
off_screen = jax.jit(temporal.off_screen)
disoccluded = jax.jit(temporal.disoccluded)

SIZE = (6, 9)
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


EXTREMES = (1e6, -1e6, 1e30, -3e38, np.inf, -np.inf)


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


def test_off_screen(dtype):
    motion = motions(dtype=dtype, reach=8.0)
    found = np.asarray(off_screen(motion))
    for row, column, x, y in pixels_of(motion):
        assert found[row, column] == (not (0 <= x < SIZE[1] and 0 <= y < SIZE[0]))
    assert 0.3 < found.mean() < 0.9
    for x in (*EXTREMES, np.nan):
        for there in ([x, 0], [0, x]):
            assert np.all(off_screen(np.full((*SIZE, 2), there, dtype)))
            assert np.all(off_screen(np.full((1, 1, 2), there, dtype)))
    assert not np.any(off_screen(np.full((1, 1, 2), -0.5, dtype)))


def surroundings(dtype):
    generator = np.random.default_rng(5)
    depth, previous_depth = generator.uniform(395, 405, (2, *SIZE)).astype(dtype)
    profile_id, previous_id = generator.integers(0, 2, (2, *SIZE)).astype(np.int32)
    return depth, profile_id, previous_depth, previous_id


def test_disocclusion_is_asked_of_the_nearest_pixel(dtype):
    depth, profile_id, previous_depth, previous_id = surroundings(dtype)
    motion = motions(dtype=dtype, reach=3.0)
    motion[2, 2], motion[3, 3], depth[1, 1] = [np.nan, 0], [0, np.inf], np.nan
    found = np.asarray(
        disoccluded(depth, profile_id, previous_depth, previous_id, motion, depth_tolerance=0.01)
    )
    for row, column in np.ndindex(SIZE):
        x, y = column + 0.5 + float(motion[row, column, 0]), row + 0.5 + float(motion[row, column, 1])
        seen = 0 <= x < SIZE[1] and 0 <= y < SIZE[0]
        if seen:
            pixel, here = (math.floor(y), math.floor(x)), float(depth[row, column])
            same = previous_id[pixel] == profile_id[row, column]
            seen = bool(same and abs(float(previous_depth[pixel]) - here) <= 0.01 * here)
        assert found[row, column] == (not seen)
    assert 0.2 < found.mean() < 0.95


def test_tolerances_of_depth():
    depth = np.array([[400.0, 400.0, 400.0, np.inf, 400.0, np.inf, 1e6]], np.float32)
    before = np.array([[408.0, 408.1, 391.9, np.inf, np.nan, 400.0, 1e6]], np.float32)
    ids = np.zeros((1, 7), np.int32)
    still = np.zeros((1, 7, 2), np.float32)
    for motion in (None, still):
        found = disoccluded(depth, ids, before, ids, motion)
        assert found.tolist() == [[False, True, True, False, True, False, False]]
        found = disoccluded(depth, ids, before, ids, motion, depth_tolerance=0)
        assert found.tolist() == [[True, True, True, False, True, True, False]]
    other = np.arange(7, dtype=np.int32)[None]
    found = disoccluded(depth, other, depth, ids, still, depth_tolerance=np.inf)
    assert found.tolist() == [[False, True, True, True, True, True, True]]


def test_depths_of_half_precision_are_compared_in_single():
    generator, ids = np.random.default_rng(6), np.zeros((200, 200), np.int32)
    depth = generator.uniform(380, 420, ids.shape).astype(np.float16)
    before = (depth + generator.uniform(-10, 10, ids.shape)).astype(np.float16)
    found = np.asarray(disoccluded(depth, ids, before, ids, None))
    here = depth.astype(np.float64)
    beyond = np.abs(before - here) - 0.02 * here
    # Equal but for the rounding of 0.02: either is right.
    tie = np.abs(beyond) < 1e-5
    np.testing.assert_array_equal(found[~tie], (beyond > 0)[~tie])


class Pair(NamedTuple):
    """Two frames of the procedural scene one after the other, and which points of the second are new."""

    before: procedural.Frame
    after: procedural.Frame
    index: int
    lost: np.ndarray


@pytest.fixture(scope="module", params=[1, 20])
def pair(request):
    before, after = (procedural.frame(request.param - k, width=320, height=180) for k in (1, 0))
    layers = (after.depth, after.profile_id, before.depth, before.profile_id, after.motion)
    return Pair(before, after, request.param, np.asarray(disoccluded(*layers)))


def behind_the_ball(pair, radius):
    """Which points of the board a ball of that radius hid in the frame before, by the rays of its camera."""
    row, column = np.indices(pair.lost.shape) + 0.5
    seen = np.asarray(pair.after.camera.position(column, row, pair.after.depth), np.float64)
    eye = procedural.camera_position(pair.index - 1)
    ray = seen + procedural.camera_position(pair.index) - eye
    towards = procedural.ball_centre(pair.index - 1) - eye
    along = (ray @ towards) / (ray**2).sum(-1)
    distance = np.linalg.norm(ray * along[..., None] - towards, axis=-1)
    return (np.asarray(pair.after.profile_id) == procedural.BOARD) & (distance < radius) & (along < 1)


def steps_to_silhouette(frame):
    """Pixels to the next pixel that has another id beside it, as a king moves."""
    ids = np.asarray(frame.profile_id)
    edge = ndimage.maximum_filter(ids, 3) != ndimage.minimum_filter(ids, 3)
    return np.asarray(ndimage.distance_transform_cdt(~edge, "chessboard"))


def test_what_came_into_view_is_disoccluded(pair):
    near = steps_to_silhouette(pair.after)
    assert not np.any(off_screen(pair.after.motion))
    # A share of a per cent of the frame, at silhouettes, as wide as the motion and the pixel's own half.
    assert 0.0005 < pair.lost.mean() < 0.01
    moved = float(np.abs(np.asarray(pair.after.motion)).max())
    assert near[pair.lost].max() <= math.ceil(moved + 0.5)
    # What the rays say, but for the rounding of places to pixels: half a pixel's diagonal.
    width, _ = pair.after.camera.mm_per_pixel(-procedural.ball_centre(pair.index)[2])
    rounding = float(width) * math.sqrt(0.5)
    surely = behind_the_ball(pair, procedural.RADIUS - rounding)
    perhaps = behind_the_ball(pair, procedural.RADIUS + rounding)
    on_board = np.asarray(pair.after.profile_id) == procedural.BOARD
    assert surely.sum() > 30 and np.all(pair.lost[surely]) and np.all(perhaps[pair.lost & on_board])


@pytest.mark.slow
@pytest.mark.parametrize("name, worst, mean", [("bilinear", 0.012, 0.003), ("catmull_rom", 0.004, 0.001)])
def test_albedo_comes_along_with_its_surface(pair, name, worst, mean):
    albedo, ids = np.asarray(pair.after.albedo), np.asarray(pair.after.profile_id)
    mask = np.asarray(pair.before.profile_id) > 0
    kept, near = ~pair.lost & (ids > 0), steps_to_silhouette(pair.after)

    def error(motion):
        return np.abs(np.asarray(LOOKUPS[name](pair.before.albedo, motion, mask=mask)) - albedo).max(axis=-1)

    found = error(pair.after.motion)
    ball = kept & (ids == procedural.BALL) & (near > 3)
    # The bands' phase changes by up to 0.55 per mm on the surface, 0.33 a pixel of 0.6 mm seen head-on and
    # twice that where the ball turns away: linear interpolation of 0.15 sin is wrong by up to
    # 0.15 (0.66)^2 / 8 along each axis, the cubic by a third at most.
    assert found[ball].max() < worst and found[ball].mean() < mean
    for wrong in (-pair.after.motion, 0 * pair.after.motion):
        assert error(wrong)[ball].mean() > 8 * found[ball].mean()
    # On the board's checks, too, the colours of the place and no others, but where a corner of a check lies
    # between the centres of pixels.
    low, high = ndimage.minimum_filter(albedo, (3, 3, 1)), ndimage.maximum_filter(albedo, (3, 3, 1))
    looked = np.asarray(LOOKUPS[name](pair.before.albedo, pair.after.motion, mask=mask))
    strange = np.any((looked < low - 1e-3) | (looked > high + 1e-3), axis=-1)
    assert strange[kept].mean() < 0.006


@pytest.mark.parametrize("lookup", [nearest, bilinear, pytest.param(catmull_rom, marks=pytest.mark.slow)])
def test_transforms(lookup):
    motion = jnp.stack([jnp.asarray(motions(seed)) for seed in (7, 8)])
    stack = jnp.stack([jnp.asarray(images(seed)) for seed in (9, 10)])
    mapped = jax.jit(jax.vmap(lookup))(stack, motion)
    for k in range(2):
        expected = np.asarray(lookup(stack[k], motion[k]))
        assert np.asarray(mapped[k]) == pytest.approx(expected, abs=16 * 2.0**-23 * float(stack.max()))
    with jax.disable_jit():
        eager = np.asarray(lookup(stack[0], motion[0]))
    # Compiled, products and sums may be fused.
    assert eager == pytest.approx(
        np.asarray(lookup(stack[0], motion[0])), abs=16 * 2.0**-23 * float(stack.max())
    )


@pytest.mark.slow
def test_disocclusion_under_transforms():
    stack = [
        jnp.stack([jnp.asarray(a), jnp.asarray(b)]) for a, b in zip(*map(surroundings, "ff"), strict=True)
    ]
    motion = jnp.stack([jnp.asarray(motions(seed)) for seed in (7, 8)])
    mapped = jax.vmap(disoccluded)(*stack, motion)
    for k in range(2):
        depth, profile_id, previous_depth, previous_id = (layer[k] for layer in stack)
        for function in (disoccluded, temporal.disoccluded):
            found = function(depth, profile_id, previous_depth, previous_id, motion[k])
            np.testing.assert_array_equal(mapped[k], found)


@pytest.mark.slow
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(
    "lookup",
    # Sixteen pixels with derivatives take seconds to compile.
    [
        bilinear,
        *(pytest.param(LOOKUPS[name], marks=pytest.mark.slow) for name in ("catmull_rom", "unclamped")),
    ],
    ids=[*LOOKUPS][1:],
)
def test_gradients_are_those_of_the_filter(lookup, masked, x64):
    image, motion = images(dtype="float64"), motions(dtype="float64")
    mask = masks() if masked else None
    spoiled = image if mask is None else np.where(mask[..., None], image, np.nan)
    weights = np.random.default_rng(11).normal(size=image.shape)
    # Where no masked pixel is around, what is found is the pixel itself, NaN here.
    lone = np.any(np.isnan(lookup(spoiled, motion, mask=mask)), axis=-1)
    weights[lone] = 0

    @jax.jit
    def found(image, motion):
        result = lookup(image, motion, mask=mask)
        return (weights * jnp.where(lone[..., None], 0, result)).sum()

    arguments = jnp.asarray(spoiled), jnp.asarray(motion)
    gradients = jax.jit(jax.grad(found, argnums=(0, 1)))(*arguments)
    assert all(np.isfinite(gradient).all() for gradient in gradients)
    if mask is not None:
        assert np.all(np.asarray(gradients[0])[~mask] == 0)
    # Along one direction of both, where motion is neither whole nor half: kinks have two slopes.
    smooth = np.all(np.abs(motion * 2 - np.round(motion * 2)) > 1e-3, axis=-1)
    steps = np.where(mask[..., None], 1.0, 0) if mask is not None else np.ones(image.shape)
    ways = (
        steps * np.random.default_rng(12).normal(size=image.shape),
        smooth[..., None] * motions(13, "float64"),
    )
    slope = sum(float((gradient * way).sum()) for gradient, way in zip(gradients, ways, strict=True))
    size = 1e-6
    up, down = (found(*(a + s * way for a, way in zip(arguments, ways, strict=True))) for s in (size, -size))
    assert slope == pytest.approx(float(up - down) / (2 * size), rel=1e-6, abs=1e-6)


def test_the_slope_at_a_still_pixel_is_that_to_the_right():
    image = jnp.asarray(images())
    slope = jax.jit(jax.grad(lambda motion: bilinear(image, motion)[2, 3, 0]))(jnp.zeros((*SIZE, 2)))
    across, down = image[2, 4, 0] - image[2, 3, 0], image[3, 3, 0] - image[2, 3, 0]
    assert slope[2, 3].tolist() == pytest.approx([float(across), float(down)], rel=1e-6)


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
