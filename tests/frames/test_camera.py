"""Cameras: unprojecting and projecting undo each other and match fractions; files load or say why not."""

import json
import math
import re
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files.errors import FileError
from sssfit.frames import camera as cameras
from sssfit.frames.camera import Camera

CAMERAS = st.builds(
    Camera,
    st.sampled_from(["perspective", "orthographic"]),
    st.just(640),
    st.just(360),
    *[st.floats(1.0, 1e4)] * 2,
    *[st.floats(-1000.0, 1000.0)] * 2,
)
COORDINATES, DEPTHS = st.floats(-1e4, 1e4), st.floats(1e-2, 1e6)


@given(CAMERAS, COORDINATES, COORDINATES, DEPTHS)
def test_projecting_undoes_unprojecting(dtype, camera, column, row, depth):
    place = [jnp.asarray(value, dtype) for value in (column, row, depth)]
    back = camera.project(camera.position(*place))
    # Five roundings, each relative to the distance from the axis, and those of the two differences.
    for found, expected, axis in zip(back, place, (camera.cx, camera.cy, 0.0), strict=True):
        assert found.dtype == dtype
        bound = 4 * np.finfo(dtype).eps * (abs(float(expected)) + abs(axis))
        assert abs(float(found) - float(expected)) <= bound


@given(CAMERAS, st.tuples(COORDINATES, COORDINATES, DEPTHS))
def test_unprojecting_undoes_projecting(dtype, camera, point):
    position = jnp.asarray(point, dtype) * jnp.asarray([1, 1, -1], dtype)
    column, row, depth = camera.project(position)
    back = np.asarray(camera.position(column, row, depth))
    # The pixel coordinate is rounded where it is the axis plus something.
    for axis, (middle, scale) in enumerate(
        zip((camera.cx, camera.cy), camera.pixels_per_mm(depth), strict=True)
    ):
        reach = 2 * abs(middle) / float(scale) + abs(float(position[axis]))
        assert abs(back[axis] - float(position[axis])) <= 4 * np.finfo(dtype).eps * reach
    assert back[2] == position[2]


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize(("column", "row", "depth"), [(0, 0, 900), (639, 359, 764.25), (200, 311, 1160)])
def test_positions_are_those_of_exact_fractions(x64, projection, column, row, depth):
    camera = Camera(projection, 640, 360, 1237.5, 1111.25, 318.5, 181.25)
    away = Fraction(depth) if projection == "perspective" else 1
    x = (column + Fraction(1, 2) - Fraction(637, 2)) * away / Fraction(2475, 2)
    y = -(row + Fraction(1, 2) - Fraction(725, 4)) * away / Fraction(4445, 4)
    found = camera.position(column + 0.5, row + 0.5, depth)
    np.testing.assert_allclose(found, [float(x), float(y), -depth], rtol=1e-15)


@given(CAMERAS, DEPTHS)
def test_a_pixel_is_as_wide_as_pixels_per_mm_say(x64, camera, depth):
    left, right = camera.position(jnp.array([100.0, 101.0]), jnp.array([50.0, 51.0]), depth)
    per_x, per_y = camera.pixels_per_mm(depth)
    np.testing.assert_allclose(right - left, [1 / per_x, -1 / per_y, 0], rtol=1e-11)
    np.testing.assert_allclose(camera.mm_per_pixel(depth), [1 / per_x, 1 / per_y], rtol=1e-14)


def test_images_of_depth_broadcast_with_the_pixels_centres():
    camera = cameras.perspective(5, 3, fx=2.0)
    depth = jnp.full((3, 5), 4.0, jnp.float32)
    found = camera.position(*camera.pixel_centres(), depth)
    assert found.shape == (3, 5, 3) and found.dtype == jnp.float32
    np.testing.assert_array_equal(found[0, 0], [-4, 2, -4])
    np.testing.assert_array_equal(found[2, 4], [4, -2, -4])
    per_x, per_y = camera.pixels_per_mm(depth)
    assert per_x.shape == per_y.shape == (3, 5)
    per_x, per_y = cameras.orthographic(5, 3, 0.25).pixels_per_mm(depth)
    np.testing.assert_array_equal([per_x, per_y], np.full((2, 3, 5), 4.0))


def test_another_lens_needs_no_other_program():
    compilations = []

    @jax.jit
    def unproject(camera, column, row, depth):
        compilations.append(camera.projection)
        return camera.position(column, row, depth)

    for fx in (500.0, 1000.0):
        camera = cameras.perspective(640, 360, fx=fx)
        np.testing.assert_allclose(unproject(camera, 420.0, 180.0, 500.0), [50000 / fx, 0, -500], rtol=1e-6)
    assert compilations == ["perspective"]


def test_gradients_pass_through():
    camera = cameras.perspective(640, 360, fx=1000.0)
    slope = jax.grad(lambda depth: camera.position(420.0, 180.0, depth)[0])(500.0)
    assert float(slope) == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize("degrees", [1.0, 29.0, 90.0, 179.0])
def test_the_field_of_view_is_between_the_edges(x64, degrees):
    camera = cameras.perspective(640, 360, fov_x_degrees=degrees)
    left, right = camera.position(jnp.array([0.0, 640.0]), 180.0, 1.0)
    cosine = left @ right / jnp.linalg.norm(left) / jnp.linalg.norm(right)
    assert math.degrees(math.acos(cosine)) == pytest.approx(degrees, rel=1e-9)
    assert camera.fy == camera.fx


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "a perspective camera needs its focal length: either fx or fov_x_degrees, neither was given"),
        (
            {"fx": 1, "fov_x_degrees": 1},
            "a perspective camera needs its focal length: either fx or fov_x_degrees, both were given",
        ),
        ({"fy": 3.0}, "a perspective camera needs its focal length"),
        ({"fx": 0}, "fx must be a number above 0, got 0"),
        ({"fx": 1, "fy": -2}, "fy must be a number above 0, got -2"),
        ({"fx": math.nan}, "fx must be a number above 0, got nan"),
        ({"fx": math.inf}, "fx must be a number above 0, got inf"),
        ({"fov_x_degrees": 180}, "fov_x_degrees must be between 0 and 180, got 180"),
        ({"fx": 1, "cx": math.nan}, "cx must be finite, got nan"),
        ({"fx": 1, "width": 0}, "width must be a whole number of at least 1, got 0"),
        ({"fx": 1, "height": 2.5}, "height must be a whole number of at least 1, got 2.5"),
    ],
)
def test_cameras_that_cannot_be(arguments, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        cameras.perspective(**{"width": 640, "height": 360, **arguments})


def test_other_faults_of_arguments():
    with pytest.raises(ValueError, match="mm_per_pixel must be a number above 0, got 0"):
        cameras.orthographic(640, 360, 0.0)
    with pytest.raises(ValueError, match="projection must be 'perspective' or 'orthographic', got 'fish'"):
        Camera("fish", 1, 1, 1.0, 1.0, 0.0, 0.0)  # pyright: ignore[reportArgumentType]


PLAIN = {"projection": "perspective", "width": 640, "height": 360, "fx": 1000, "fy": 1000}


def saved(tmp_path, content):
    path = tmp_path / "camera.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (PLAIN, Camera("perspective", 640, 360, 1000.0, 1000.0, 320.0, 180.0)),
        (PLAIN | {"fy": 900, "cx": 1}, Camera("perspective", 640, 360, 1000.0, 900.0, 1.0, 180.0)),
        ({"width": 4, "height": 2, "fx": 3}, Camera("perspective", 4, 2, 3.0, 3.0, 2.0, 1.0)),
        # The focal length is what counts where both are there, as renderers round angles.
        (PLAIN | {"fov_x_deg": 10}, Camera("perspective", 640, 360, 1000.0, 1000.0, 320.0, 180.0)),
        (
            {"projection": "orthographic", "width": 4, "height": 2, "mm_per_pixel": 0.5, "cy": 0},
            Camera("orthographic", 4, 2, 2.0, 2.0, 2.0, 0.0),
        ),
        (
            {"projection": "orthographic", "width": 4, "height": 2, "ortho_width_mm": 8},
            Camera("orthographic", 4, 2, 0.5, 0.5, 2.0, 1.0),
        ),
    ],
)
def test_plain_files(tmp_path, content, expected):
    assert cameras.load(saved(tmp_path, content)) == expected
    assert cameras.load(saved(tmp_path, {"gbuffer": {"a.exr": {"camera": content}}}), "x/a.exr") == expected
    assert cameras.load(saved(tmp_path, {"frames": [{"file": "a.exr", "camera": content}]})) == expected


def test_the_camera_of_a_frame(tmp_path):
    wide, same = PLAIN | {"width": 1920, "height": 1080}, dict(PLAIN)
    every = {"a.exr": PLAIN, "b.exr": same, "c.exr": wide}
    path = saved(tmp_path, {"gbuffer": {name: {"camera": camera} for name, camera in every.items()}})
    assert cameras.load(path, "c.exr").width == 1920
    assert cameras.load(path, "folder/a.exr").width == 640
    # A copy of a frame under another name: only one camera has its size.
    assert cameras.load(path, "copy.exr", size=(640, 360)).width == 640
    held = "a.exr (640 x 360), b.exr (640 x 360), c.exr (1920 x 1080)"
    for arguments, message in (
        (("d.exr",), f"does not say which camera is meant for d.exr; name one of {held}"),
        ((), f"does not say which camera is meant; name one of {held}"),
    ):
        with pytest.raises(FileError, match=re.escape(f"{path}: {message}")):
            cameras.load(path, *arguments)
    message = f"has no camera for d.exr of 10 x 20 pixels; it has {held}; give the frame's own camera"
    with pytest.raises(FileError, match=re.escape(message)):
        cameras.load(path, "d.exr", size=(10, 20))


NO_CAMERA = "holds no camera; write projection, width, height and fx or fov_x_deg, or gbuffer with a camera"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {"width": 640, "height": 360, "projection": "perspective"},
            "the perspective camera has no focal length; write fx and fy in pixels, or fov_x_deg",
        ),
        (
            PLAIN | {"projection": "orthographic"},
            "the orthographic camera has no scale; write mm_per_pixel or ortho_width_mm",
        ),
        (
            PLAIN | {"projection": "fish"},
            "the projection is 'fish'; only perspective and orthographic are known",
        ),
        ({"fx": 3}, "the camera has no width or no height; write both, in pixels"),
        (PLAIN | {"fx": "long"}, "fx is 'long' where a number belongs; write a number"),
        (PLAIN | {"cx": True}, "cx is True where a number belongs; write a number"),
        (
            PLAIN | {"fx": -1},
            "the camera is not usable (fx must be a number above 0, got -1); mend its numbers",
        ),
        (
            PLAIN | {"width": 0.5},
            "the camera is not usable (width must be a whole number of at least 1, got 0.5)",
        ),
        (
            {"projection": "orthographic", "width": 4, "height": 2, "mm_per_pixel": 0},
            "the camera is not usable (mm_per_pixel must be a number above 0, got 0); mend its numbers",
        ),
        (
            {"projection": "orthographic", "width": 0, "height": 2, "ortho_width_mm": 1},
            "the camera is not usable (width must be a whole number of at least 1, got 0); mend its numbers",
        ),
        ({}, NO_CAMERA),
        ([], NO_CAMERA),
        ({"gbuffer": {}}, NO_CAMERA),
        ({"gbuffer": {"a.exr": {"camera": 3}}}, NO_CAMERA),
        ({"frames": [{"camera": PLAIN}]}, NO_CAMERA),
        ("{", "is not valid JSON"),
    ],
)
def test_files_without_a_usable_camera(tmp_path, content, message):
    path = saved(tmp_path, content)
    with pytest.raises(FileError) as caught:
        cameras.load(path)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)


def test_no_file(tmp_path):
    with pytest.raises(FileError, match=r"none\.json: there is no such file; check the path"):
        cameras.load(tmp_path / "none.json")


def test_a_sequence_with_one_lens_needs_no_name(rendered):
    path = rendered / "s5_flash" / "camera.json"
    assert cameras.load(path) == cameras.load(path, "frame_12.exr")


@pytest.mark.parametrize(
    ("scene", "frames"),
    [
        ("s1_beam", ["gbuffer"]),
        ("s2_head", ["gbuffer", "gbuffer_1080p"]),
        ("s3_skull", ["gbuffer"]),
        ("s4_patch", ["gbuffer", "gbuffer_1080p"]),
        ("s5_flash", [f"frame_{i:02}" for i in range(48)]),
    ],
)
def test_cameras_of_rendered_scenes(rendered, scene, frames):
    for frame in frames:
        camera = cameras.load(rendered / scene / "camera.json", f"{frame}.exr")
        assert (camera.width, camera.height) == (
            (1920, 1080) if "1080p" in frame else (480, 270) if scene == "s5_flash" else (640, 360)
        )
        assert (camera.cx, camera.cy) == (camera.width / 2, camera.height / 2)
        if scene == "s1_beam":
            assert (camera.projection, camera.fx, camera.fy) == ("orthographic", 8.0, 8.0)
        else:
            fov = json.loads((rendered / scene / "camera.json").read_text())
            numbers = (fov.get("gbuffer") or {f["file"]: f for f in fov["frames"]})[f"{frame}.exr"]["camera"]
            again = cameras.perspective(camera.width, camera.height, fov_x_degrees=numbers["fov_x_deg"])
            assert camera.projection == "perspective"
            assert camera.fx == camera.fy == pytest.approx(again.fx, rel=1e-12)
