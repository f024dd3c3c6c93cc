"""Frames survive writing and reading, load from other layers and files, and say what is wrong with them."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from sssfit.files.errors import FileError
from sssfit.files.exr import encode_exr
from sssfit.frames import camera as cameras
from sssfit.frames import gbuffer
from sssfit.frames.gbuffer import Frame

WIDTH, HEIGHT = 6, 4
CAMERA = cameras.perspective(WIDTH, HEIGHT, fx=10.0)
SHAPE = (HEIGHT, WIDTH)
VALUES = st.floats(-100, 100, width=16)
OPTIONAL = ("normal", "albedo", "motion")


def images(components, values=VALUES):
    return arrays(np.float32, (*SHAPE, components), elements=values).map(jnp.asarray)


FRAMES = st.builds(
    Frame,
    images(3, st.floats(0, 1000, width=16)),
    arrays(np.float32, SHAPE, elements=st.floats(0.125, 1000, width=32)).map(jnp.asarray),
    st.none() | images(3),
    st.none() | images(3),
    arrays(np.int32, SHAPE, elements=st.integers(0, 2**31 - 1), fill=st.just(1)).map(jnp.asarray),
    st.none() | images(2),
    st.just(CAMERA),
)


def same(one, other):
    for name, found, expected in zip(Frame._fields, one, other, strict=True):
        if name == "camera" or expected is None:
            assert found == expected, name
        else:
            assert found.dtype == expected.dtype, name
            np.testing.assert_array_equal(found, expected, name)


@settings(max_examples=25)
@given(FRAMES.filter(lambda frame: frame.profile_id.any()), st.booleans())
def test_what_is_written_is_read(tmp_path, frame, half):
    gbuffer.write(tmp_path / "a.exr", frame, half=half)
    same(gbuffer.load(tmp_path / "a.exr", CAMERA), frame)
    assert gbuffer.encode(frame, half=half) == (tmp_path / "a.exr").read_bytes()


def channels(**changes):
    """Channels of a small file, all half but for depth and id."""
    made = {f"E.{c}": np.full(SHAPE, 0.5 * i, np.float16) for i, c in enumerate("RGB", 1)}
    made |= {"depth": np.full(SHAPE, 300, np.float32), "id": np.ones(SHAPE, np.uint32)}
    made |= {f"normal.{c}": np.full(SHAPE, c == "Z", np.float16) for c in "XYZ"}
    made |= {f"albedo.{c}": np.full(SHAPE, 0.25, np.float16) for c in "RGB"}
    made |= {"motion.X": np.full(SHAPE, 1.5, np.float16), "motion.Y": np.full(SHAPE, -2, np.float16)}
    made |= changes
    return {name: pixels for name, pixels in made.items() if pixels is not None}


def saved(path, content):
    path.write_bytes(encode_exr(content, {}))
    return path


def changed(pixels, row, column, value):
    pixels = pixels.copy()
    pixels[row, column] = value
    return pixels


@pytest.fixture
def exr(tmp_path):
    return saved(tmp_path / "a.exr", channels())


def test_a_file_with_every_layer(exr):
    frame = gbuffer.load(exr, CAMERA)
    kinds = [np.asarray(values).dtype.name for values in frame[:6]]
    assert kinds == ["float32"] * 4 + ["int32", "float32"]
    pixel = [np.asarray(values)[2, 3].tolist() for values in frame[:6]]
    assert pixel == [[0.5, 1.0, 1.5], 300.0, [0.0, 0.0, 1.0], [0.25] * 3, 1, [1.5, -2.0]]
    assert frame.camera is CAMERA


def test_the_camera_from_a_file(tmp_path, exr):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"width": WIDTH, "height": HEIGHT, "fx": 10.0}))
    same(gbuffer.load(exr, path), gbuffer.load(exr, CAMERA))


def test_layers_that_may_be_missing(tmp_path):
    path = saved(tmp_path / "a.exr", {n: p for n, p in channels().items() if n[0] in "Ed"})
    frame = gbuffer.load(path, CAMERA)
    assert [getattr(frame, name) for name in OPTIONAL] == [None] * 3
    assert (frame.profile_id == 1).all()
    left_out = gbuffer.load(saved(path, channels()), CAMERA, layers=dict.fromkeys(OPTIONAL))
    assert [getattr(left_out, name) for name in OPTIONAL] == [None] * 3


@pytest.mark.parametrize("nothing", [1e6, 1e10, np.inf, 0.995e6])
def test_without_ids_the_background_is_what_is_far(tmp_path, nothing):
    depth = changed(channels()["depth"], 1, 2, nothing)
    frame = gbuffer.load(saved(tmp_path / "a.exr", channels(id=None, depth=depth)), CAMERA)
    expected = changed(np.ones(SHAPE, int), 1, 2, 0)
    np.testing.assert_array_equal(frame.profile_id, expected)
    assert frame.depth[1, 2] == (np.float32(0.995e6) if nothing < 1e6 else 1e6)


def test_lengths_in_other_units(tmp_path):
    depth = changed(np.full(SHAPE, 0.3, np.float32), 0, 0, 1e10)
    path = saved(tmp_path / "a.exr", channels(id=None, depth=depth))
    frame = gbuffer.load(path, CAMERA, world_scale=1000.0)
    assert frame.depth[1, 1] == np.float32(0.3) * np.float32(1000) and frame.depth[0, 0] == 1e6
    assert frame.profile_id[0, 0] == 0
    with pytest.raises(
        FileError, match="no pixel has a profile, all ids are 0; give what shall scatter an id"
    ):
        gbuffer.load(path, CAMERA, background_depth=0.2)


@pytest.mark.parametrize("name", ["depth", "depth.V", "depth.Z", "depth.Y", "depth.R", "depth.X"])
def test_names_of_a_single_number(tmp_path, name):
    content = channels(depth=None) | {name: np.full(SHAPE, 7, np.float32)}
    assert (gbuffer.load(saved(tmp_path / "a.exr", content), CAMERA).depth == 7).all()


def test_layers_with_other_names_and_in_other_files(tmp_path):
    every = channels()
    frame = {f"View.Light.{c}": every[f"E.{c}"] for c in "RGB"} | {"Z": every["depth"]}
    path = saved(tmp_path / "a.exr", frame)
    (tmp_path / "more").mkdir()
    saved(tmp_path / "more" / "b.exr", {c: every[f"albedo.{c}"] for c in "RGB"})
    rest = {f"n.{c}": every[f"normal.{d}"] for c, d in zip("RGB", "XYZ", strict=True)}
    # Some renderers keep ids as float.
    rest |= {"index.X": every["id"].astype(np.float32), "m.x": every["motion.X"], "m.y": every["motion.Y"]}
    saved(tmp_path / "c.exr", rest)
    layers = {
        "irradiance": "View.Light",
        "depth": "Z",
        "albedo": "more/b.exr",
        "normal": "c.exr:n",
        "profile_id": f"{tmp_path}/c.exr:index",
        "motion": "c.exr:m",
    }
    found = gbuffer.load(path, CAMERA, layers=layers)
    same(found, gbuffer.load(saved(tmp_path / "d.exr", every), CAMERA))


def refusal(path, camera=CAMERA, **options):
    with pytest.raises(FileError) as caught:
        gbuffer.load(path, camera, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_missing_layers(tmp_path, exr):
    held = "the file has E.B, E.G, E.R, id"
    short = {name: channels()[name] for name in ("E.R", "E.G", "E.B", "id")}
    path = saved(tmp_path / "b.exr", short)
    assert (
        refusal(path) == f"{path}: there is no layer 'depth' for the depth; {held}: say which of them it is"
    )
    layers = {"depth": "Z"}
    assert (
        refusal(path, layers=layers)
        == f"{path}: there is no layer 'Z' for the depth; {held}: say which of them it is"
    )
    path = saved(tmp_path / "c.exr", {"E.R": short["E.R"], "id": short["id"]})
    assert refusal(path) == f"{path}: the irradiance lacks the channel 'E.G', 'E.B'; the file has E.R, id"
    # What is asked for must be there, what is not need not.
    assert refusal(exr, layers={"motion": "speed"}).startswith(
        f"{exr}: there is no layer 'speed' for the motion;"
    )
    message = f"{tmp_path}/b.exr: there is no layer '' for the albedo; {held}: say which of them it is"
    assert refusal(exr, layers={"albedo": "b.exr"}) == message
    assert (
        refusal(exr, layers={"profile_id": "n.exr:id"})
        == f"{tmp_path}/n.exr: there is no such file; check the path"
    )


def test_other_sizes(tmp_path, exr):
    other = cameras.perspective(8, HEIGHT, fx=1.0)
    remedy = "give images of one size, and their camera"
    assert refusal(exr, other) == f"{exr}: the irradiance has 6 x 4 pixels, the camera 8 x 4; {remedy}"
    path = saved(tmp_path / "b.exr", {"Z": np.ones((2, 3), np.float32)})
    message = f"{path}: the depth has 3 x 2 pixels, the camera 6 x 4; {remedy}"
    assert refusal(exr, layers={"depth": "b.exr:Z"}) == message
    (tmp_path / "camera.json").write_text(json.dumps({"width": 8, "height": 4, "fx": 1}))
    assert "camera.json: has no camera for a.exr of 6 x 4 pixels; it has (8 x 4); give" in refusal(
        exr, tmp_path / "camera.json"
    )


@pytest.mark.parametrize(
    ("kind", "suffix"), [("PNG", "png"), ("JPEG", "jpg"), ("BMP", "bmp"), ("GIF", "gif")]
)
def test_eight_bits_are_not_irradiance(tmp_path, exr, kind, suffix):
    path = tmp_path / f"light.{suffix}"
    Image.fromarray(np.zeros((*SHAPE, 3), np.uint8)).save(path)
    message = (
        f"{path}: is a {kind} image, whose few bits hold no linear light; give an EXR image of float or half"
    )
    assert refusal(path).startswith(message)
    assert refusal(exr, layers={"irradiance": path.name}).startswith(message)


def test_truncated_and_other_files(tmp_path, exr, capfd):
    data = exr.read_bytes()
    for end in (3, 100, len(data) // 2, len(data) - 9):
        (tmp_path / "b.exr").write_bytes(data[:end])
        found = refusal(tmp_path / "b.exr")
        assert re.match(
            r".*b\.exr: is (truncated or damaged \(.*\)|not an EXR image); restore the file", found
        )
    (tmp_path / "b.exr").write_text("light\n")
    assert refusal(tmp_path / "b.exr").endswith(": is not an EXR image; restore the file or write it again")
    assert refusal(tmp_path / "n.exr").endswith(": there is no such file; check the path")
    assert capfd.readouterr() == ("", "")


NAN, INF = float("nan"), float("inf")
LIGHT, DEPTH = "a NaN, infinite or negative irradiance", "a depth that is NaN, infinite or not above 0"


@pytest.mark.parametrize(
    ("channel", "value", "fault"),
    [
        *[("E.G", value, LIGHT) for value in (NAN, INF, -INF, -0.25)],
        *[("depth", value, DEPTH) for value in (NAN, INF, -INF, -1, 0)],
        ("normal.X", NAN, "a NaN or infinite normal"),
        ("albedo.B", INF, "a NaN or infinite albedo"),
        ("motion.Y", -INF, "a NaN or infinite motion"),
    ],
)
def test_bad_pixels_are_masked_out_or_refused(tmp_path, channel, value, fault):
    content = channels()
    content[channel] = changed(changed(content[channel], 1, 4, value), 3, 0, value)
    path = saved(tmp_path / "a.exr", content)
    told = f"{path}: 2 pixels have {fault} (the first at column 4, row 1)"
    with pytest.warns(UserWarning) as caught:
        frame = gbuffer.load(path, CAMERA)
    assert [str(warning.message) for warning in caught] == [f"{told}; they are masked out"]
    assert caught[0].filename == __file__
    good = gbuffer.load(saved(tmp_path / "b.exr", channels()), CAMERA)
    for place in ((1, 4), (3, 0)):
        assert frame.profile_id[place] == 0 and frame.depth[place] == 1e6
        assert (frame.irradiance[place] == 0).all()
    rest = np.ones(SHAPE, bool)
    rest[[1, 3], [4, 0]] = False
    for found, expected in zip(frame[:6], good[:6], strict=True):
        assert np.isfinite(np.asarray(found)).all()
        np.testing.assert_array_equal(np.asarray(found)[rest], np.asarray(expected)[rest])
    remedy = "mend the file, or have them masked out without strict"
    assert refusal(path, strict=True) == f"{told}; {remedy}"


def test_several_faults_are_one_sentence(tmp_path):
    content = channels()
    content["E.R"] = changed(content["E.R"], 0, 0, -1)
    content["depth"] = changed(content["depth"], 2, 1, 0)
    path = saved(tmp_path / "a.exr", content)
    first = f"1 pixel has {LIGHT} (the first at column 0, row 0)"
    told = f"{path}: {first}, 1 pixel has {DEPTH} (the first at column 1, row 2)"
    assert refusal(path, strict=True).startswith(f"{told}; mend the file")


def test_the_background_may_hold_anything_but_light(tmp_path):
    content = channels(id=changed(np.ones(SHAPE, np.uint32), 1, 4, 0))
    for name in ("depth", "normal.X", "albedo.R", "motion.X"):
        content[name] = changed(content[name], 1, 4, NAN)
    frame = gbuffer.load(saved(tmp_path / "a.exr", content), CAMERA, strict=True)
    assert frame.depth[1, 4] == 1e6 and frame.irradiance[1, 4].tolist() == [0.5, 1.0, 1.5]
    assert all(np.isfinite(np.asarray(values)).all() for values in frame[:6])
    # What stands there without scattering keeps its place.
    content["depth"] = changed(content["depth"], 1, 4, 250)
    assert gbuffer.load(saved(tmp_path / "a.exr", content), CAMERA).depth[1, 4] == 250
    content["E.R"] = changed(content["E.R"], 1, 4, NAN)
    assert LIGHT in refusal(saved(tmp_path / "a.exr", content), strict=True)


def test_nothing_to_scatter(tmp_path):
    remedy = "give what shall scatter an id of 1 or more"
    path = saved(tmp_path / "a.exr", channels(id=np.zeros(SHAPE, np.uint32)))
    assert refusal(path) == f"{path}: no pixel has a profile, all ids are 0; {remedy}"
    saved(path, channels(depth=np.zeros(SHAPE, np.float32)))
    with pytest.warns(UserWarning, match="24 pixels have a depth that"):
        assert refusal(path) == f"{path}: no good pixel has a profile; {remedy}"


@pytest.mark.parametrize("value", [0.5, -1.0, NAN, INF, 2.0**31])
def test_ids_are_whole_numbers(tmp_path, value):
    ids = changed(np.ones(SHAPE, np.float32), 2, 5, value)
    path = saved(tmp_path / "a.exr", channels(id=ids))
    told = (
        f"1 profile ids are no whole numbers from 0 to 2147483647 (the first is {value:g} at column 5, row 2)"
    )
    assert refusal(path) == f"{path}: {told}; write one id per object, without anti-aliasing"
    big = changed(np.ones(SHAPE, np.uint32), 2, 5, 2**32 - 1)
    assert "(the first is 4.29497e+09 at" in refusal(saved(path, channels(id=big)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"layers": {"light": "E"}},
            "layers must name irradiance, depth, normal, albedo, profile_id, motion",
        ),
        ({"layers": {"depth": None}}, "layers cannot leave out depth"),
        ({"world_scale": 0}, "world_scale must be a number above 0, got 0"),
        ({"world_scale": NAN}, "world_scale must be a number above 0, got nan"),
        ({"background_depth": INF}, "background_depth must be a number above 0, got inf"),
    ],
)
def test_options_that_cannot_be(exr, options, message):
    with pytest.raises(ValueError, match=message):
        gbuffer.load(exr, CAMERA, **options)


def test_numbers_that_do_not_fit(exr):
    frame = gbuffer.load(exr, CAMERA)
    bright = frame._replace(irradiance=frame.irradiance.at[0, 0, 0].set(70000.0))
    with pytest.raises(ValueError, match="irradiance has 70000, half numbers end at 65504: write float"):
        gbuffer.encode(bright, half=True)
    assert gbuffer.encode(bright)
    with pytest.raises(ValueError, match="profile_id must not be negative, got -1"):
        gbuffer.encode(frame._replace(profile_id=-frame.profile_id))


SCENES = [
    ("s1_beam", "gbuffer", {1}),
    ("s2_head", "gbuffer", {1, 2, 3}),
    ("s2_head", "gbuffer_1080p", {1, 2, 3}),
    ("s3_skull", "gbuffer", {0, 1, 3}),
    ("s4_patch", "gbuffer", {1}),
    ("s4_patch", "gbuffer_1080p", {1}),
    ("s5_flash", "frame_00", {0, 1}),
    ("s5_flash", "frame_27", {0, 1}),
]


@pytest.mark.parametrize(("scene", "name", "ids"), SCENES)
def test_rendered_frames_load_as_they_are(rendered, scene, name, ids):
    frame = gbuffer.load(rendered / scene / f"{name}.exr", rendered / scene / "camera.json", strict=True)
    size = (1080, 1920) if "1080p" in name else (270, 480) if scene == "s5_flash" else (360, 640)
    assert frame.depth.shape == size and frame.normal is not None
    assert set(np.unique(frame.profile_id)) == ids
    assert (frame.motion is not None) == (scene == "s5_flash")
    assert (frame.albedo is None) == (name == "frame_27")
    surface = np.asarray(frame.profile_id) > 0
    assert (np.asarray(frame.depth)[~surface] == 1e6).all()
    # Unit vectors of half numbers.
    lengths = np.linalg.norm(np.asarray(frame.normal, np.float64)[surface], axis=-1)
    assert np.abs(lengths - 1).max() < np.sqrt(3) * 2**-11


def json_of(folder):
    return json.loads((folder / "camera.json").read_text())


def test_positions_are_those_of_the_rendered_scene(rendered):
    # The slab is the plane z = 0, 80 mm wide.
    folder = rendered / "s1_beam"
    frame = gbuffer.load(folder / "gbuffer.exr", folder / "camera.json")
    points = np.asarray(frame.camera.position(*frame.camera.pixel_centres(), frame.depth), np.float64)
    numbers = json_of(folder)["gbuffer"]["gbuffer.exr"]["camera"]
    world = points + np.array(numbers["camera_to_world"])[:3, 3]
    np.testing.assert_allclose(world[..., 2], 0, atol=numbers["unproject_max_error_mm"])
    np.testing.assert_allclose(world[0, [0, -1], 0], [-39.9375, 39.9375], rtol=1e-6)
    np.testing.assert_allclose(world[[0, -1], 0, 1], [22.4375, -22.4375], rtol=1e-6)


@pytest.mark.parametrize("name", ["gbuffer", "gbuffer_1080p"])
def test_a_rendered_wall_is_flat(rendered, name):
    folder = rendered / "s2_head"
    frame = gbuffer.load(folder / f"{name}.exr", folder / "camera.json")
    wall = np.asarray(frame.profile_id) == 3
    points = np.asarray(frame.camera.position(*frame.camera.pixel_centres(), frame.depth), np.float64)[wall]
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points[::37] - middle, full_matrices=False)
    # What Cycles' own positions differ by from those of its depth.
    allowed = json_of(folder)["gbuffer"][f"{name}.exr"]["camera"]["unproject_max_error_mm"]
    assert np.abs((points - middle) @ axes[2]).max() < allowed
    # Its normal, which Cycles renders, is that of the plane.
    normal = np.asarray(frame.normal, np.float64)[wall].mean(axis=0)
    assert abs(normal @ axes[2]) == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("index", [1, 20, 47])
def test_rendered_motion_is_that_of_moved_points(rendered, index):
    folder = rendered / "s5_flash"
    frame = gbuffer.load(folder / f"frame_{index:02}.exr", folder / "camera.json")
    now, before = (json_of(folder)["frames"][i] for i in (index, index - 1))
    to_world, head = np.array(now["camera"]["camera_to_world"]), np.array(now["head_to_world"])
    then, from_world = np.array(before["head_to_world"]), np.array(before["camera"]["world_to_camera"])
    surface = np.asarray(frame.profile_id) == 1
    columns, rows = np.broadcast_arrays(*frame.camera.pixel_centres())
    points = np.asarray(frame.camera.position(columns, rows, frame.depth), np.float64)[surface]
    path = from_world @ then @ np.linalg.inv(head) @ to_world
    column, row, _ = frame.camera.project((points @ path[:3, :3].T + path[:3, 3]).astype(np.float32))
    moved = np.stack([np.asarray(column) - columns[surface], np.asarray(row) - rows[surface]], axis=-1)
    found = np.asarray(frame.motion)[surface]
    # Half numbers, float32 pixel coordinates, and what Cycles' motion was found to differ by.
    allowed = np.abs(found) * 2**-11 + 4 * 480 * 2**-24 + 1.1e-4
    assert (np.abs(moved - found) <= allowed).all()
    assert np.abs(found).max() > 0.5
