"""`sssfit render`: bad input is one sentence and exit code 2, and nothing is half written."""

import json

import numpy as np
import pytest
from PIL import Image

from sssfit.cli.main import main
from sssfit.files.exr import encode_exr, read_exr
from sssfit.frames import render

PROFILE = ["--profile", "skin1"]
LAYERS = ("sss.R", "sss.G", "sss.B")


def exr(path, channels):
    path.write_bytes(encode_exr({n: np.ascontiguousarray(v) for n, v in channels.items()}, {}))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    here = tmp_path_factory.mktemp("refusals")
    assert main(["procedural-frame", "--width", "64", "--height", "36", "--out", str(here), "--quiet"]) == 0
    channels, _ = read_exr(here / "frame_00.exr")
    exr(here / "no_depth.exr", {n: v for n, v in channels.items() if n != "depth"})
    exr(here / "no_green.exr", {n: v for n, v in channels.items() if n != "E.G"})
    ids = channels["id"]
    exr(here / "seven.exr", channels | {"id": np.where(ids == 2, 7, ids).astype(np.uint32)})
    exr(here / "bare.exr", {n: v for n, v in channels.items() if not n.startswith("normal")})
    exr(here / "nothing.exr", channels | {"id": 0 * ids})
    exr(here / "wall.exr", channels | {"id": np.where(ids > 0, 3, 0).astype(np.uint32)})
    exr(here / "zero.exr", channels | {"depth": 0 * channels["depth"]})
    (here / "cut.exr").write_bytes((here / "frame_00.exr").read_bytes()[:9000])
    Image.fromarray(np.zeros((36, 64, 3), np.uint8)).save(here / "eight_bit.png")
    exr(here / "small.exr", dict.fromkeys(LAYERS, np.ones((9, 16), np.float32)))
    bad = np.ones((36, 64), np.float32)
    bad[20, 26] = np.nan
    exr(here / "nan.exr", dict.fromkeys(LAYERS, bad))
    exr(here / "other.exr", {"E.R": bad, "E.G": bad, "E.B": bad})
    scene = json.loads((here / "camera.json").read_text())
    (here / "null.json").write_text(
        json.dumps(scene | {"profiles_by_id": scene["profiles_by_id"] | {"3": None}})
    )
    lens = scene["gbuffer"]["frame_00.exr"]["camera"]
    lens = {name: value for name, value in lens.items() if name not in ("fx", "fy", "fov_x_deg")}
    (here / "lens.json").write_text(json.dumps({"gbuffer": {"frame_00.exr": {"camera": lens}}}))
    return here


def refused(folder, capsys, frame, options):
    """The sentence, without the folder's name."""
    before = sorted(folder.rglob("*"))
    options = [o.replace("FOLDER", str(folder)) for o in options]
    assert main(["render", str(folder / frame), *options, "--out", str(folder / "out")]) == 2
    assert sorted(folder.rglob("*")) == before
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("sssfit: ") and printed.err.count("\n") == 1
    return printed.err.removeprefix("sssfit: ").replace(f"{folder}/", "").rstrip("\n")


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ("absent.exr", "absent.exr: there is no such file; check the path"),
        ("no_depth.exr", "no_depth.exr: there is no layer 'depth' for the depth; the file has "),
        ("no_green.exr", "no_green.exr: the irradiance lacks the channel 'E.G'; the file has "),
        ("seven.exr", "camera.json: id 7 of the frame has no profile beside 'skin1'; write it into profiles"),
        ("nothing.exr", "nothing.exr: no pixel has a profile, all ids are 0; give what shall scatter an id"),
        (
            "zero.exr",
            "zero.exr: 2048 pixels have a depth that is NaN, infinite or not above 0 (the first at ",
        ),
        ("cut.exr", "cut.exr: is truncated or damaged ("),
        ("eight_bit.png", "eight_bit.png: is a PNG image, whose few bits hold no linear light; give an EXR"),
    ],
)
def test_frames(folder, capsys, frame, message):
    options = ["--camera", "FOLDER/camera.json", *PROFILE, "--strict"]
    assert refused(folder, capsys, frame, options).startswith(message)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (PROFILE, "the camera must be one of --camera, --fx, --fov-x-deg and --mm-per-pixel, got none"),
        (
            ["--camera", "c.json", "--fx", "900", *PROFILE],
            "the camera must be one of --camera, --fx, --fov-x-deg and --mm-per-pixel, got --camera and --fx",
        ),
        (["--mm-per-pixel", "0.1", "--cx", "3", *PROFILE], "--cx belongs to --fx or --fov-x-deg"),
        (["--fx", "0", "--d", "1,1,1"], "fx must be a number above 0, got 0"),
        (["--fov-x-deg", "180", "--d", "1,1,1"], "fov_x_degrees must be between 0 and 180, got 180"),
        (["--mm-per-pixel", "-1", "--d", "1,1,1"], "mm_per_pixel must be a number above 0, got -1"),
        (
            ["--camera", "FOLDER/lens.json", *PROFILE],
            "lens.json, frame_00.exr: the perspective camera has no focal length; write fx and fy in pixels, "
            "or fov_x_deg",
        ),
        (["--camera", "FOLDER/absent.json", *PROFILE], "absent.json: there is no such file; check the path"),
        (["--camera", "FOLDER/camera.json"], "the profile must be one of --profile and --d, got none"),
        (
            ["--camera", "FOLDER/camera.json", "--d", "1,1,1", *PROFILE],
            "the profile must be one of --profile and --d",
        ),
        (["--fx", "900", "--profile", "0.5"], "a profile in numbers must be 'albedo,dmfp' or three albedos"),
        (["--fx", "900", "--profile", "2,1"], "the albedo of a profile must be in [0, 1], got '2,1'"),
        (
            ["--camera", "FOLDER/camera.json", "--profile", "skim"],
            "camera.json: there is no profile 'skim'; known",
        ),
        (["--fx", "900", "--profile", "skim"], "there is no profile 'skim'; known are Apple, "),
        *(
            (
                ["--fx", "900", f"--d={d}"],
                f"--d must be three numbers R,G,B in mm, none below 0 and one above it, got '{d}'",
            )
            for d in ("1,-1,1", "0,0,0", "1,1", "1,nan,1", "a,b,c", "")
        ),
    ],
)
def test_cameras_and_profiles(folder, capsys, options, message):
    assert refused(folder, capsys, "frame_00.exr", options).startswith(message)


def test_a_frame_without_a_profile_that_scatters(folder, capsys):
    message = refused(folder, capsys, "wall.exr", ["--camera", "FOLDER/null.json", *PROFILE])
    assert message == "wall.exr: no pixel has a profile that scatters; give one of the frame's ids a profile"


@pytest.mark.parametrize("method", ["scatter", "exact"])
def test_a_frame_without_the_normals_that_are_needed(folder, capsys, method):
    options = ["--camera", "FOLDER/camera.json", *PROFILE, "--method", method]
    message = "bare.exr: has no normals, which are needed here; name them with --layer normal=..., or take "
    assert refused(folder, capsys, "bare.exr", options).startswith(message)


def test_an_interruption_leaves_nothing(folder, capsys, monkeypatch):
    def interrupted(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(render, "by_sampling", interrupted)
    message = refused(folder, capsys, "frame_00.exr", ["--camera", "FOLDER/camera.json", *PROFILE])
    assert message == "interrupted; outputs are either as before or complete, run again to finish"


SPP = "--spp must be N or MIN:MAX, whole numbers from 1 to 65536, got "


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(
            (["--spp", spp], f"{SPP}'{spp}'")
            for spp in ("8:", ":8", "64:8", "0", "0:8", "x", "1.5", "65537", "")
        ),
        (["--spp", "8:64"], "--spp MIN:MAX and --target-variance must be given together"),
        (["--target-variance", "1"], "--spp MIN:MAX and --target-variance must be given together"),
        *(
            (
                ["--spp", "8:64", f"--target-variance={v}"],
                f"--target-variance must be a number above 0, got {v}",
            )
            for v in ("0", "-1", "nan", "inf")
        ),
        (["--cutoff-radius", "0"], "--cutoff-radius must be a number above 0 (in d) or none, got '0'"),
        (["--cutoff-radius", "all"], "--cutoff-radius must be a number above 0 (in d) or none, got 'all'"),
        (["--replicates", "7"], "--replicates must be 0 or from 8 to 1022, got 7"),
        (["--replicates=-8"], "--replicates must be 0 or from 8 to 1022, got -8"),
        (["--method", "exact", "--spp", "64"], "--spp belongs to --method scatter"),
        (["--method", "exact", "--uncorrected"], "--uncorrected belongs to --method scatter"),
        (["--method", "exact", "--sequence", "r2"], "--sequence belongs to --method scatter"),
        (["--split", "0.01"], "--split needs --points fresh"),
        (["--radius-limit", "9"], "--radius-limit belongs to --method exact"),
        (
            ["--method", "exact", "--radius-limit", "0"],
            "--radius-limit must be a number above 0, got 0",
        ),
        (["--seed=-1"], "--seed must be from 0 to 4194303, got -1"),
        (["--seed", "4194304"], "--seed must be from 0 to 4194303, got 4194304"),
        (
            ["--layer", "motion=m"],
            "--layer must be NAME=LAYER, NAME one of irradiance, depth, normal, profile_id",
        ),
        (
            ["--layer", "depth"],
            "--layer must be NAME=LAYER, NAME one of irradiance, depth, normal, profile_id",
        ),
        (
            ["--layer", "normal=facing"],
            "frame_00.exr: there is no layer 'facing' for the normal; the file has",
        ),
        (["--world-scale", "0"], "world_scale must be a number above 0, got 0"),
        (
            ["--layer", "irradiance=small.exr:sss"],
            "small.exr: the irradiance has 16 x 9 pixels, the camera 64 x 36; give images of one size",
        ),
        (
            ["--reference", "FOLDER/small.exr"],
            "small.exr: the reference has 16 x 9 pixels, the frame 64 x 36 pixels; give the",
        ),
        (
            ["--reference", "FOLDER/nan.exr"],
            "nan.exr, column 26, row 20: the reference is NaN or infinite in 1 of the pixels to compare",
        ),
        (
            ["--reference", "FOLDER/other.exr"],
            "other.exr: there is no layer 'sss' for the reference; the file has",
        ),
        (["--reference", "FOLDER/absent.exr"], "absent.exr: there is no such file; check the path"),
    ],
)
def test_options(folder, capsys, options, message):
    scene = ["--camera", "FOLDER/camera.json", *PROFILE]
    assert refused(folder, capsys, "frame_00.exr", [*scene, *options]).startswith(message)


def test_outputs_that_cannot_be_written(folder, tmp_path, capsys):
    (tmp_path / "out").write_text("notes")
    command = ["render", str(folder / "frame_00.exr"), "--camera", str(folder / "camera.json"), *PROFILE]
    assert main([*command, "--out", str(tmp_path / "out")]) == 2
    message = "is a file, not a directory; move it away or choose another directory"
    assert capsys.readouterr().err == f"sssfit: {tmp_path / 'out'}: {message}\n"
    assert (tmp_path / "out").read_text() == "notes"
    assert main([*command, "--out", ""]) == 2
    assert capsys.readouterr().err == "sssfit: --out must name a directory; use . for the current one\n"


def test_words_that_are_not_known(folder, capsys):
    command = ["render", str(folder / "frame_00.exr"), "--fx", "900", *PROFILE, "--out", str(folder / "out")]
    for name in ("estimator", "sequence", "channels", "plane", "distance", "importance", "method"):
        with pytest.raises(SystemExit) as ended:
            main([*command, f"--{name}", "best"])
        assert ended.value.code == 2
        assert f"argument --{name}: invalid choice: 'best'" in capsys.readouterr().err
