"""`sssfit procedural-frame`: what it writes loads again, the same every time; bad input is one sentence."""

import hashlib
import json

import numpy as np
import pytest
from PIL import Image

from sssfit.cli.main import main
from sssfit.frames import gbuffer, procedural, scene_profiles

COMMAND = ["procedural-frame", "--frames", "2", "--width", "48", "--height", "27"]
FILES = {"frame_00.exr", "frame_01.exr", "camera.json", "preview.png"}


def contents(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


@pytest.fixture
def out(tmp_path, capsys):
    assert main([*COMMAND, "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out == f"frames of 48 x 27 pixels: 2; see {tmp_path / 'out' / 'preview.png'}\n"
    return tmp_path / "out"


def test_files_and_manifest(out):
    written = contents(out)
    assert set(written) == FILES | {"manifest.json"}
    manifest = json.loads(written["manifest.json"])
    assert {name: entry["sha256"] for name, entry in manifest["files"].items()} == {
        name: hashlib.sha256(written[name]).hexdigest() for name in FILES
    }
    assert manifest["options"] == {"frames": 2, "half": False, "width": 48, "height": 27}
    with Image.open(out / "preview.png") as picture:
        assert picture.size == (3 * 48, 2 * 27)


@pytest.mark.parametrize("index", [0, 1])
def test_frames_load_as_they_were_made(out, index):
    loaded = gbuffer.load(out / f"frame_{index:02}.exr", out / "camera.json", strict=True)
    made = procedural.frame(index, width=48, height=27)
    assert loaded.camera == made.camera
    for found, expected in zip(loaded[:6], made[:6], strict=True):
        np.testing.assert_array_equal(found, expected)


def test_profiles_have_the_d_of_their_names(out):
    # d = l / (1.9 - A + 3.5 (A - 0.8)^2)
    def shape(albedo, mfp):
        return [p / (1.9 - a + 3.5 * (a - 0.8) ** 2) for a, p in zip(albedo, mfp, strict=True)]

    skin1 = shape((0.44, 0.22, 0.13), (3.67, 1.37, 0.68))
    marble = shape((0.83, 0.79, 0.75), (8.51, 5.57, 3.95))
    for name, expected in (("skin1", [skin1, marble]), ("marble", [marble, marble])):
        found = scene_profiles.by_id(out / "camera.json", name)
        assert list(found) == [1, 2]
        for d, values in zip(found.values(), expected, strict=True):
            np.testing.assert_allclose(np.asarray(d), values, rtol=1e-14)


def test_the_same_bytes_twice(out, tmp_path):
    assert main([*COMMAND, "--quiet", "--out", str(tmp_path / "again")]) == 0
    assert contents(tmp_path / "again") == contents(out)


def test_half_numbers_take_less_room(out, tmp_path):
    assert main([*COMMAND, "--half", "--out", str(tmp_path / "half")]) == 0
    sizes = [len((folder / "frame_00.exr").read_bytes()) for folder in (tmp_path / "half", out)]
    assert sizes[0] < 0.7 * sizes[1]
    found = gbuffer.load(tmp_path / "half" / "frame_00.exr", out / "camera.json")
    made = procedural.frame(width=48, height=27)
    np.testing.assert_array_equal(found.depth, made.depth)
    np.testing.assert_allclose(found.irradiance, made.irradiance, rtol=2**-11, atol=2**-25)


def test_names_of_many_frames_sort(tmp_path):
    command = ["procedural-frame", "--frames", "101", "--width", "2", "--height", "2", "--quiet"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    names = sorted(path.name for path in tmp_path.glob("*.exr"))
    assert len(names) == 101 and (names[0], names[-1]) == ("frame_000.exr", "frame_100.exr")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--frames", "0"], "--frames must be at least 1, got 0"),
        (["--width", "0"], "width must be a whole number of at least 1, got 0"),
        (["--height", "-3"], "height must be a whole number of at least 1, got -3"),
    ],
)
def test_bad_input_writes_nothing(tmp_path, capsys, options, message):
    assert main([*COMMAND, "--out", str(tmp_path / "out"), *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err == f"sssfit: {message}\n"
    assert not (tmp_path / "out").exists()


def test_outputs_that_cannot_be_written(tmp_path, capsys):
    (tmp_path / "out").write_text("notes")
    assert main([*COMMAND, "--out", str(tmp_path / "out")]) == 2
    message = "is a file, not a directory; move it away or choose another directory"
    assert capsys.readouterr().err == f"sssfit: {tmp_path / 'out'}: {message}\n"
    assert main([*COMMAND, "--out", ""]) == 2
    assert capsys.readouterr().err == "sssfit: --out must name a directory; use . for the current one\n"
