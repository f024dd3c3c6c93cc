"""A frame without another program: a ball before a tilted board under a hard-edged light, all in closed form.

Lengths are in mm. Ball and camera swing to and fro; the board stays. World space is the camera space of frame
0, but for the camera's own swing.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.frames import camera as cameras
from sssfit.frames.camera import Camera
from sssfit.frames.gbuffer import BACKGROUND_DEPTH, Frame
from sssfit.profiles import burley

#: What the ids mean.
BALL, BOARD = 1, 2
#: Radius of the ball.
RADIUS = 34.0
#: Where the board's middle is, which way it faces, and how far up it reaches along itself.
BOARD_POINT = np.array([0.0, 0.0, -430.0])
BOARD_NORMAL = np.array([0.0, 0.5, math.sqrt(0.75)])
BOARD_UP = np.array([0.0, math.sqrt(0.75), -0.5])
BOARD_TOP = 58.0
#: Towards the light, and its irradiance on what faces it.
LIGHT = np.array([0.48, 0.6, 0.64])
POWER = np.array([3.0, 2.85, 2.6])
#: The light passes where `EDGE @ point > EDGE_OFFSET`: a screen with a straight edge; EDGE is across LIGHT.
EDGE = np.array([0.8, 0.0, -0.6])
EDGE_OFFSET = 188.0

_FOV_X_DEGREES = 29.0
_BALL_CENTRE, _BALL_SWING, _BALL_PERIOD = np.array([-16.0, -10.0, -372.0]), np.array([5.0, 1.5, 2.0]), 40
_CAMERA_SWING, _CAMERA_PERIOD = np.array([2.0, 0.5, -1.0]), 64
# Name, albedo and volume mean free path in mm.
_PROFILES = {
    BALL: ("skin1", (0.44, 0.22, 0.13), (3.67, 1.37, 0.68)),
    BOARD: ("marble", (0.83, 0.79, 0.75), (8.51, 5.57, 3.95)),
}


class _Hit(NamedTuple):
    """Points that rays reach, and the distance along each ray, inf where it misses."""

    distance: np.ndarray
    point: np.ndarray


def frame(index: int = 0, *, width: int = 640, height: int = 360) -> Frame:
    """One frame of the procedural scene.

    The ball has id 1, the board behind it id 2; above the board's upper edge is background. Irradiance is
    direct light alone: one distant light times Lambert's cosine, with the shadow of the ball on the board and
    that of a straight edge on both, each a step. Everything is sampled at the centres of pixels.

    Args:
        index: of the frame; ball and camera move by up to 0.9 and 0.2 mm from one to the next.
        width: pixels.
        height: pixels.

    Returns:
        The frame, with its albedo, normals and exact motion.

    Raises:
        ValueError: width or height is no whole number of at least 1.

    Example:
        >>> frame(width=64, height=36).profile_id[[1, 20, 30], [32, 26, 60]]
        Array([0, 1, 2], dtype=int32)
    """
    camera = cameras.perspective(width, height, fov_x_degrees=_FOV_X_DEGREES)
    eye, centre = camera_position(index), ball_centre(index)
    # In float64 by NumPy: no mode of JAX matters, and float32 is only what is kept.
    x = (np.arange(width) + 0.5 - camera.cx) / camera.fx
    y = (camera.cy - np.arange(height)[:, None] - 0.5) / camera.fy
    # The z of a direction is -1, which makes the distance along it the depth.
    direction = np.stack(np.broadcast_arrays(x, y, -1.0), axis=-1)
    ball, board = _ball(eye, direction, centre), _board(eye, direction)
    profile_id = np.where(ball.distance < board.distance, BALL, BOARD)
    profile_id[np.isinf(ball.distance) & np.isinf(board.distance)] = 0
    on_ball, on_surface = (profile_id == BALL)[..., None], (profile_id > 0)[..., None]
    point = np.where(on_ball, ball.point, board.point)
    normal = np.where(on_ball, (point - centre) / RADIUS, BOARD_NORMAL)
    lit = (point @ EDGE > EDGE_OFFSET) & (on_ball[..., 0] | ~_in_ball_shadow(point, centre))
    cosine = np.maximum(normal @ LIGHT, 0) * lit
    depth = np.where(profile_id > 0, np.minimum(ball.distance, board.distance), BACKGROUND_DEPTH)

    def kept(values):
        return jnp.asarray(np.where(on_surface, values, 0), jnp.float32)

    return Frame(
        irradiance=kept(cosine[..., None] * POWER),
        depth=jnp.asarray(depth, jnp.float32),
        normal=kept(normal),
        albedo=kept(np.where(on_ball, _ball_albedo(point - centre), _board_albedo(point))),
        profile_id=jnp.asarray(profile_id, jnp.int32),
        motion=kept(_motion(point, on_ball, index, camera)),
        camera=camera,
    )


def ball_centre(index: int) -> np.ndarray:
    """The ball's centre in world space, (3,), mm, in a frame.

    Args:
        index: of the frame, any whole number.

    Example:
        >>> ball_centre(0)
        array([ -16.,  -10., -372.])
    """
    return _BALL_CENTRE + _BALL_SWING * math.sin(2 * math.pi * index / _BALL_PERIOD)


def camera_position(index: int) -> np.ndarray:
    """The camera's position in world space, (3,), mm, in a frame; it never turns.

    Args:
        index: of the frame, any whole number.

    Example:
        >>> camera_position(16)
        array([ 2. ,  0.5, -1. ])
    """
    return _CAMERA_SWING * math.sin(2 * math.pi * index / _CAMERA_PERIOD)


def describe(indices: range, names: list[str], *, width: int, height: int) -> dict[str, Any]:
    """What a camera.json says about frames of the scene: cameras, light, ids and profiles.

    Args:
        indices: of the frames.
        names: of their files.
        width: pixels.
        height: pixels.

    Returns:
        Contents for JSON, which `camera.load` and `scene_profiles.by_id` read.

    Example:
        >>> describe(range(1), ["frame_00.exr"], width=64, height=36)["profiles_by_id"]["1"]["name"]
        'skin1'
    """
    camera = cameras.perspective(width, height, fov_x_degrees=_FOV_X_DEGREES)
    lens = {name: getattr(camera, name) for name in ("projection", "width", "height", "fx", "fy", "cx", "cy")}

    def entry(index: int) -> dict[str, Any]:
        to_world = np.eye(4)
        to_world[:3, 3] = camera_position(index)
        pose = {"camera_to_world": to_world, "mm_per_pixel": "depth / fx", "fov_x_deg": _FOV_X_DEGREES}
        return {"index": index, "camera": lens | pose, "ball_centre": ball_centre(index)}

    light = {"name": "light", "type": "SUN", "toward_light": LIGHT, "angular_diameter_deg": 0.0}
    return {
        "scene": "procedural",
        "note": "a ball before a tilted board under a distant light with a straight shadow edge",
        "units": "mm",
        "ids": {str(BALL): "ball", str(BOARD): "board"},
        "lights": [light | {"E_normal_incidence": POWER}],
        "background_depth_mm": BACKGROUND_DEPTH,
        "profiles_by_id": {str(i): _profile(*profile) for i, profile in _PROFILES.items()},
        "gbuffer": {name: entry(index) for index, name in zip(indices, names, strict=True)},
    }


def _profile(name: str, albedo: tuple[float, ...], mfp: tuple[float, ...]) -> dict[str, Any]:
    with jax.enable_x64(True):
        d = np.asarray(burley.shape_from_mfp(np.array(mfp), np.array(albedo), "diffuse"))
    return {"name": name, "A": albedo, "l": mfp, "d": d}


def _ball(eye: np.ndarray, direction: np.ndarray, centre: np.ndarray) -> _Hit:
    """First hits of the ball; the rays' quadratic without loss of digits in its smaller root."""
    towards = centre - eye
    along, square = direction @ towards, (direction**2).sum(-1)
    power = towards @ towards - RADIUS**2
    discriminant = along**2 - square * power
    root = np.sqrt(np.maximum(discriminant, 0))
    distance = np.where(discriminant > 0, power / (along + root), np.inf)
    return _reached(eye, direction, distance)


def _board(eye: np.ndarray, direction: np.ndarray) -> _Hit:
    distance = ((BOARD_POINT - eye) @ BOARD_NORMAL) / (direction @ BOARD_NORMAL)
    hit = _reached(eye, direction, np.where(distance > 0, distance, np.inf))
    below = (hit.point - BOARD_POINT) @ BOARD_UP < BOARD_TOP
    return hit._replace(distance=np.where(below, hit.distance, np.inf))


def _reached(eye: np.ndarray, direction: np.ndarray, distance: np.ndarray) -> _Hit:
    return _Hit(distance, eye + direction * np.where(np.isfinite(distance), distance, 0)[..., None])


def _in_ball_shadow(point: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Whether the ball stands between points and the light; never so for points beyond it."""
    towards = centre - point
    along = towards @ LIGHT
    return (along > 0) & ((towards**2).sum(-1) - along**2 < RADIUS**2)


def _motion(point: np.ndarray, on_ball: np.ndarray, index: int, camera: Camera) -> np.ndarray:
    """Where the same points of ball and board were in the frame before, minus where they are, pixels."""

    def pixel(where, eye):
        seen = where - eye
        column = camera.cx + camera.fx * seen[..., 0] / -seen[..., 2]
        return np.stack([column, camera.cy + camera.fy * seen[..., 1] / seen[..., 2]], axis=-1)

    before = point + on_ball * (ball_centre(index - 1) - ball_centre(index))
    eye, eye_before = camera_position(index), camera_position(index - 1)
    # Points of rays that miss lie in the eye.
    with np.errstate(invalid="ignore", divide="ignore"):
        return pixel(before, eye_before) - pixel(point, eye)


def _ball_albedo(offset: np.ndarray) -> np.ndarray:
    """Soft bands around the ball, fixed to it."""
    bands = 0.5 + 0.5 * np.sin(offset @ np.array([0.12, 0.5, 0.2]))
    return 0.55 + 0.3 * bands[..., None] * np.array([1.0, 0.6, 0.4]) - np.array([0.0, 0.15, 0.25])


def _board_albedo(point: np.ndarray) -> np.ndarray:
    """Checks of 12 mm, fixed to the board."""
    along, up = point[..., 0], (point - BOARD_POINT) @ BOARD_UP
    checks = (np.floor(along / 12) + np.floor(up / 12)) % 2
    return (0.6 + 0.25 * checks[..., None]) * np.array([1.0, 0.97, 0.92])
