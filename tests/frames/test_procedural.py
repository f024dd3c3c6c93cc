"""The procedural frame against the equations of its surfaces, marched light rays and moved points."""

import numpy as np
import pytest

from sssfit.frames import preview, procedural
from sssfit.frames.procedural import (
    BALL,
    BOARD,
    BOARD_NORMAL,
    BOARD_POINT,
    BOARD_TOP,
    BOARD_UP,
    EDGE,
    EDGE_OFFSET,
    LIGHT,
    POWER,
    RADIUS,
)

INDEX = 7
EPS = float(np.finfo(np.float32).eps)


def in_float64(frame):
    return {n: np.asarray(v, np.float64) for n, v in frame._asdict().items() if n != "camera"}


def rays(camera):
    """Directions through the centres of pixels, with z = -1, from the lens alone."""
    i, j = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x = (i + 0.5 - camera.cx) / camera.fx
    y = -(j + 0.5 - camera.cy) / camera.fy
    return np.stack([x, y, -np.ones_like(x)], axis=-1)


@pytest.fixture(scope="module")
def scene():
    """A frame, its numbers, and its points in the world, in float64."""
    frame = procedural.frame(INDEX)
    numbers = in_float64(frame)
    points = procedural.camera_position(INDEX) + rays(frame.camera) * numbers["depth"][..., None]
    return frame, numbers, points


def test_shapes_and_kinds(scene):
    frame, _, _ = scene
    assert frame.irradiance.shape == frame.normal.shape == frame.albedo.shape == (360, 640, 3)
    assert frame.depth.shape == frame.profile_id.shape == (360, 640) and frame.motion.shape == (360, 640, 2)
    floats = (frame.irradiance, frame.depth, frame.normal, frame.albedo, frame.motion)
    assert {v.dtype.name for v in floats} == {"float32"} and frame.profile_id.dtype == "int32"


def test_points_lie_on_their_surfaces(scene):
    _, numbers, points = scene
    ids, depth = numbers["profile_id"], numbers["depth"]
    # Rounding the depth moves a point along its ray, which is no longer than 1.05 depths.
    off = 0.55 * EPS * 512
    ball = points[ids == BALL] - procedural.ball_centre(INDEX)
    np.testing.assert_allclose(np.linalg.norm(ball, axis=-1), RADIUS, rtol=0, atol=off)
    board = points[ids == BOARD] - BOARD_POINT
    np.testing.assert_allclose(board @ BOARD_NORMAL, 0, atol=off)
    assert (board @ BOARD_UP).max() < BOARD_TOP + off
    assert depth[ids > 0].max() < 512 and (depth[ids == 0] == 1e6).all()


def test_ids_are_those_of_the_silhouettes(scene):
    frame, numbers, _ = scene
    directions = rays(frame.camera)
    to_ball = procedural.ball_centre(INDEX) - procedural.camera_position(INDEX)
    # A ball is a cone of directions, and a board's upper edge is a line across the image.
    cosine = directions @ to_ball / np.linalg.norm(directions, axis=-1) / np.linalg.norm(to_ball)
    in_cone = np.arccos(cosine) < np.arcsin(RADIUS / np.linalg.norm(to_ball))
    edge = BOARD_POINT + BOARD_TOP * BOARD_UP - procedural.camera_position(INDEX)
    below = directions[..., 1] < edge[1] / -edge[2]
    np.testing.assert_array_equal(numbers["profile_id"], np.where(in_cone, BALL, np.where(below, BOARD, 0)))
    shares = np.bincount(numbers["profile_id"].astype(int).ravel()) / numbers["profile_id"].size
    assert (shares > 0.05).all()
    # The ball is in front of the board by more than its radius: a depth edge.
    seen = numbers["profile_id"] > 0
    steps = np.abs(np.diff(numbers["depth"], axis=1))[seen[:, 1:] & seen[:, :-1]]
    assert steps.max() > RADIUS


def test_normals_are_those_of_neighbouring_points(scene):
    _, numbers, points = scene
    ids = numbers["profile_id"]
    right, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    crossed = np.cross(down, right)
    crossed /= np.linalg.norm(crossed, axis=-1, keepdims=True)
    around = np.stack([np.roll(ids, s, a) for s, a in ((1, 0), (-1, 0), (1, 1), (-1, 1))])
    inside = ((around == ids).all(0) & (ids > 0))[1:-1, 1:-1]
    normal = numbers["normal"][1:-1, 1:-1]
    np.testing.assert_allclose(np.linalg.norm(normal[inside], axis=-1), 1, rtol=2 * EPS)
    # Depths rounded by eps / 2 over two pixels of 0.3 mm: slopes to 512 eps / 0.6.
    flat = inside & (ids[1:-1, 1:-1] == BOARD)
    assert np.abs(crossed - normal)[flat].max() < 2 * 512 * EPS / 0.6
    # On the ball, not near its limb, the third derivative counts too: (0.3 / 34)^2 times a few.
    facing = inside & (ids[1:-1, 1:-1] == BALL) & (normal[..., 2] > 0.5)
    assert facing.sum() > 10_000
    assert np.abs(crossed - normal)[facing].max() < 2e-3


def test_light_is_lamberts_or_none(scene):
    _, numbers, points = scene
    ids, irradiance = numbers["profile_id"], numbers["irradiance"]
    assert np.linalg.norm(LIGHT) == pytest.approx(1, abs=1e-15) and EDGE @ LIGHT == pytest.approx(
        0, abs=1e-15
    )
    expected = np.maximum(numbers["normal"] @ LIGHT, 0)[..., None] * POWER
    lit = (irradiance > 0).any(axis=-1)
    np.testing.assert_allclose(irradiance[lit], expected[lit], rtol=0, atol=4 * 3 * EPS)
    assert (irradiance[ids == 0] == 0).all()
    # March towards the light in steps of 0.1 mm, on every 13th pixel whose fate does not hang on less.
    some = np.zeros_like(lit)
    some[3::13, 3::13] = True
    some &= (
        (ids > 0) & (np.abs(points @ EDGE - EDGE_OFFSET) > 1e-3) & (np.abs(numbers["normal"] @ LIGHT) > 1e-3)
    )
    steps = np.arange(2.0, 250.0, 0.1)
    centre = procedural.ball_centre(INDEX)
    marched = points[some][:, None] + steps[:, None] * LIGHT
    gap = np.linalg.norm(marched - centre, axis=-1).min(axis=1) - RADIUS
    # From the ball itself the ray leaves on the side that faces the light.
    blocked = np.where(ids[some] == BALL, (numbers["normal"] @ LIGHT)[some] < 0, gap < 0)
    sure = (ids[some] == BALL) | (np.abs(gap) > 1e-3)
    passes = points[some] @ EDGE > EDGE_OFFSET
    np.testing.assert_array_equal(lit[some][sure], (passes & ~blocked)[sure])
    for surface in (BALL, BOARD):
        assert 0.1 < lit[ids == surface].mean() < 0.9
    assert (blocked & (ids[some] == BOARD) & passes).sum() > 50


@pytest.mark.parametrize("index", [0, 1, INDEX, -3, 1000])
def test_motion_is_that_of_moved_points(index):
    frame = procedural.frame(index, width=320, height=180)
    numbers = in_float64(frame)
    points = procedural.camera_position(index) + rays(frame.camera) * numbers["depth"][..., None]
    ball = (numbers["profile_id"] == BALL)[..., None]
    before = points - ball * (procedural.ball_centre(index) - procedural.ball_centre(index - 1))
    seen = before - procedural.camera_position(index - 1)
    surface = numbers["profile_id"] > 0
    column = frame.camera.cx + frame.camera.fx * seen[..., 0] / -seen[..., 2]
    row = frame.camera.cy - frame.camera.fy * seen[..., 1] / -seen[..., 2]
    i, j = np.meshgrid(np.arange(320) + 0.5, np.arange(180) + 0.5)
    expected = np.stack([column - i, row - j], axis=-1)
    # The points carry the rounding of depth, the motion its own: both far below a thousandth of a pixel.
    np.testing.assert_allclose(numbers["motion"][surface], expected[surface], rtol=0, atol=1e-5)
    assert (numbers["motion"][~surface] == 0).all()


def test_motion_leads_to_the_same_albedo_in_the_frame_before():
    now, before = (in_float64(procedural.frame(i)) for i in (1, 0))
    i, j = np.meshgrid(np.arange(640), np.arange(360))
    column, row = i + now["motion"][..., 0], j + now["motion"][..., 1]
    left, top = np.floor(column).astype(int).clip(0, 638), np.floor(row).astype(int).clip(0, 358)
    right_share, lower_share = (column - left)[..., None], (row - top)[..., None]

    def blended(image):
        upper = image[top, left] * (1 - right_share) + image[top, left + 1] * right_share
        lower = image[top + 1, left] * (1 - right_share) + image[top + 1, left + 1] * right_share
        return upper * (1 - lower_share) + lower * lower_share

    ids = now["profile_id"]
    same = (blended(before["profile_id"][..., None]) == ids[..., None])[..., 0]
    facing = same & (ids == BALL) & (now["normal"][..., 2] > 0.5)
    # Bands of 0.15 cos(0.55 x), pixels of up to 0.6 mm on the slope: blending errs by h^2 / 8 f''.
    bound = 2 * 0.6**2 / 8 * 0.15 * 0.55**2
    assert np.abs(blended(before["albedo"]) - now["albedo"])[facing].max() < bound
    assert np.abs(before["albedo"] - now["albedo"])[facing].max() > 10 * bound


def test_ball_and_camera_move_a_little_and_return():
    for index in range(-50, 50):
        ball = procedural.ball_centre(index + 1) - procedural.ball_centre(index)
        camera = procedural.camera_position(index + 1) - procedural.camera_position(index)
        assert np.linalg.norm(ball) < 0.9 and np.linalg.norm(camera) < 0.23
    np.testing.assert_allclose(procedural.ball_centre(40), procedural.ball_centre(0), atol=1e-12)
    np.testing.assert_allclose(procedural.camera_position(64), procedural.camera_position(0), atol=1e-12)


def test_a_finer_frame_has_the_coarse_one_within():
    coarse, fine = (in_float64(procedural.frame(3, width=w, height=h)) for w, h in ((64, 36), (192, 108)))
    # The middle of three by three pixels is the centre of the large one.
    for name in ("depth", "profile_id", "irradiance", "normal", "albedo"):
        np.testing.assert_allclose(fine[name][1::3, 1::3], coarse[name], rtol=4 * EPS, atol=4 * EPS)
    np.testing.assert_allclose(fine["motion"][1::3, 1::3], 3 * coarse["motion"], rtol=0, atol=1e-5)


def test_the_same_numbers_in_every_mode_of_jax():
    import jax

    plain = procedural.frame(2, width=32, height=18)
    with jax.enable_x64(True):
        wide = procedural.frame(2, width=32, height=18)
    for one, other in zip(plain[:-1], wide[:-1], strict=True):
        one, other = np.asarray(one), np.asarray(other)
        assert one.dtype == other.dtype and one.tobytes() == other.tobytes()


def test_sizes_that_cannot_be():
    with pytest.raises(ValueError, match="width must be a whole number of at least 1, got 0"):
        procedural.frame(width=0)


def test_pictures_of_frames_without_some_layers():
    frame = procedural.frame(width=16, height=9)
    some = preview.layers(frame._replace(normal=None, albedo=None, motion=None))
    assert some != preview.layers(frame) == preview.layers(procedural.frame(width=16, height=9))


def test_pictures_in_display_colours():
    import io

    from PIL import Image

    linear = np.array([[[0.0, 0.5, 1.0], [np.nan, -1.0, 2.0]]])
    shown = np.asarray(Image.open(io.BytesIO(preview.png(linear, white=1.0))))
    # sRGB's middle: 1.055 * 0.5^(1 / 2.4) - 0.055 = 0.7354 of 255.
    assert shown.tolist() == [[[0, 188, 255], [0, 0, 255]]]
    assert np.asarray(Image.open(io.BytesIO(preview.png(np.zeros((2, 2, 3)))))).max() == 0
