"""What the previous frame did not see: by loops, and in a scene that moves in closed form."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy import ndimage
from temporal_cases import EXTREMES, LOOKUPS, SIZE, disoccluded, motions, off_screen, pixels_of, surroundings

from sssfit.frames import procedural


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
