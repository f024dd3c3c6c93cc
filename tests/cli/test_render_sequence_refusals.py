"""`sssfit render --mode`: bad input is one sentence and exit code 2, and what was done is kept."""

import json
import os

import numpy as np
import pytest

from sssfit.cli.main import main
from sssfit.files.exr import encode_exr, read_exr
from sssfit.frames import gbuffer, sequence_ledger
from sssfit.frames.sequence_ledger import UNFINISHED

ASKED = ["--mode", "fixed", "--spp", "16"]
ADAPTIVE = ["--mode", "ocv", "--target-variance", "1e-3"]
FIRST_TWO = {
    f"{kind}_0{k}.{end}" for kind in ("scattered", "count") for end in ("exr", "png") for k in (0, 1)
}


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    here = tmp_path_factory.mktemp("frames")
    size = ["--width", "64", "--height", "36", "--frames", "4"]
    assert main(["procedural-frame", *size, "--out", str(here), "--quiet"]) == 0
    assert render(here, *ASKED, out="whole") == 0
    return here


@pytest.fixture
def folder(frames, tmp_path):
    """A copy to be spoilt."""
    for path in [*frames.glob("frame_*.exr"), frames / "camera.json"]:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def render(folder, *options, frame="frame_*.exr", out="out"):
    scene = [str(folder / frame), "--camera", str(folder / "camera.json"), "--profile", "skin1"]
    options = [o.replace("FOLDER", str(folder)) for o in options]
    return main(["render", *scene, *options, "--out", str(folder / out), "--quiet"])


def refused(folder, capsys, *options, **more):
    """The sentence, without the folder's name."""
    capsys.readouterr()
    assert render(folder, *options, **more) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.startswith("sssfit: ") and printed.err.count("\n") == 1
    return printed.err.removeprefix("sssfit: ").replace(f"{folder}/", "").rstrip("\n")


def names(folder):
    return {path.name for path in (folder / "out").iterdir()}


def spoil(folder, name, change):
    channels, _ = read_exr(folder / name)
    made = {n: np.ascontiguousarray(v) for n, v in change(channels).items()}
    (folder / name).write_bytes(encode_exr(made, {}))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--mode", "ocv"], "--mode ocv needs --target-variance"),
        (
            [*ASKED, "--target-variance", "1"],
            "--target-variance belongs to --mode as, ocv, ccv, unreal, in_frame or oracle, not fixed",
        ),
        (
            ["--mode", "oracle", "--target-variance", "1", "--alpha", "0.1"],
            "--alpha belongs to --mode as, ocv, ccv, unreal or in_frame, not oracle",
        ),
        *(
            (
                ["--mode", mode, "--target-variance", "1", "--kappa", "0.1"],
                f"--kappa belongs to --mode as, ocv or ccv, not {mode}",
            )
            for mode in ("in_frame", "oracle", "unreal")
        ),
        ([*ASKED, "--kappa", "0.1"], "--kappa belongs to --mode as, ocv or ccv, not fixed"),
        ([*ASKED, "--history", "float16"], "--history belongs to --mode as, ocv, ccv, unreal or in_frame, "),
        (
            ["--mode", "in_frame", "--target-variance", "1", "--gamma", "2.2"],
            "--gamma belongs to --mode as, ocv, ccv or unreal, not in_frame",
        ),
        (
            ["--mode", "as", "--target-variance", "1", "--light", "control"],
            "--light belongs to --mode ocv, ccv or in_frame, not as",
        ),
        (["--mode", "fixed", "--spp", "8:64"], "--spp must be a single number with --mode fixed, got '8:64'"),
        ([*ADAPTIVE, "--spp", "8"], "--spp must be MIN:MAX with --mode ocv, got '8'"),
        ([*ADAPTIVE, "--spp", "64:8"], "--spp must be N or MIN:MAX, whole numbers from 1 to 65536, got"),
        ([*ADAPTIVE[:3], "0"], "--target-variance must be a number above 0, got 0"),
        ([*ADAPTIVE, "--alpha", "0"], "alpha must be in (0, 1], got 0"),
        ([*ADAPTIVE, "--kappa", "2"], "kappa must be in [0, 1], got 2"),
        ([*ADAPTIVE, "--gamma", "-1"], "--gamma must be a number above 0, got -1"),
        ([*ADAPTIVE, "--white", "inf"], "--white must be a number above 0, got inf"),
        ([*ADAPTIVE, "--seed=-1"], "--seed must be from 0 to 4194303, got -1"),
        ([*ADAPTIVE, "--method", "exact"], "--method exact has no --mode: nothing is sampled"),
        ([*ADAPTIVE, "--replicates", "8"], "--replicates belongs to a frame without --mode"),
        ([*ADAPTIVE, "--radius-limit", "8"], "--radius-limit belongs to --method exact"),
        ([*ADAPTIVE, "--split", "0.5"], "--split needs --points fresh"),
        (
            [*ADAPTIVE, "--layer", "albedo=a"],
            "--layer must be NAME=LAYER, NAME one of irradiance, depth, nor",
        ),
        (
            [*ADAPTIVE, "--layer", "motion=m"],
            "frame_00.exr: there is no layer 'm' for the motion; the file has",
        ),
        (["--resume"], "FRAME.exr names more than one file; give --mode to render a sequence"),
        (
            [*ASKED, "--reference", "FOLDER/camera.json"],
            "camera.json: the name has no number at its end; number the frames as in frame_0001.exr",
        ),
        (
            [*ASKED, "--reference", "FOLDER/ref_9.exr"],
            "ref_9.exr: neither this reference nor another has the number of a frame, 00 to 03; number the",
        ),
    ],
)
def test_options(frames, capsys, options, message):
    assert refused(frames, capsys, *options).startswith(message)
    assert not (frames / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--resume"], "--resume needs --mode"),
        (["--kappa", "0.2"], "--kappa needs --mode"),
        (["--kappa", "0"], "--kappa needs --mode"),
        (["--white", "1"], "--white needs --mode"),
        (
            ["--reference", "FOLDER/ref_*.exr"],
            "--reference names more than one file; give --mode to render a sequence",
        ),
        (["--reference", "a.exr", "b.exr"], "--reference names more than one file; give --mode to render a"),
    ],
)
def test_a_frame_without_a_mode(frames, capsys, options, message):
    assert refused(frames, capsys, *options, frame="frame_00.exr").startswith(message)


def test_several_frames_without_a_mode(frames, capsys):
    message = "sssfit: FRAME.exr names more than one file; give --mode to render a sequence\n"
    every = [str(frames / f"frame_0{k}.exr") for k in (0, 1)]
    for given in (every, [str(frames / "frame_*.exr")]):
        assert main(["render", *given, "--fx", "9", "--d", "1,1,1", "--out", str(frames / "out")]) == 2
        assert capsys.readouterr().err == message


def test_a_gap_and_a_number_twice(folder, capsys):
    (folder / "frame_02.exr").rename(folder / "other_003.exr")
    message = refused(folder, capsys, *ASKED, frame="*.exr")
    assert message == "other_003.exr: has the number 003 as frame_03.exr has; give one file for each number"
    message = (
        "frame_01.exr: after this frame, number 02 is missing; the next one is 03; bring 02 back, or give "
    )
    assert refused(folder, capsys, *ASKED).startswith(message)
    assert refused(folder, capsys, *ASKED, frame="shot_*.exr") == (
        "shot_*.exr: no file has such a name; check the folder and the pattern"
    )
    assert not (folder / "out").exists()


def test_what_stops_a_sequence_leaves_what_was_done(frames, folder, capsys):
    """A file that is cut short, one of another size, one in the wrong unit; then it goes on."""
    good = {k: (folder / f"frame_0{k}.exr").read_bytes() for k in (2, 3)}
    (folder / "frame_02.exr").write_bytes(good[2][:9000])
    assert refused(folder, capsys, *ASKED).startswith("frame_02.exr: is truncated or damaged (")
    assert names(folder) == FIRST_TWO | {UNFINISHED}
    (folder / "frame_02.exr").write_bytes(good[2])
    spoil(folder, "frame_02.exr", lambda c: c | {n: c[n] * 1e3 for n in ("motion.X", "motion.Y")})
    message = refused(folder, capsys, *ASKED, "--resume")
    assert message.startswith("frame_02.exr, column ") and "more than the frame of 64 x 36 pixels" in message
    assert message.endswith(
        "; write motion in pixels, where a point was in the frame before minus where it is, y down"
    )
    (folder / "frame_02.exr").write_bytes(good[2])
    spoil(folder, "frame_03.exr", lambda c: {n: v[::2, ::2] for n, v in c.items()})
    assert refused(folder, capsys, *ASKED, "--resume") == (
        "frame_03.exr: the irradiance has 32 x 18 pixels, the camera 64 x 36; give images of one size, and "
        "their camera"
    )
    scene = json.loads((folder / "camera.json").read_text())
    lens = scene["gbuffer"]["frame_03.exr"]["camera"]
    assert {p for p in names(folder) if "_02" in p} and not {p for p in names(folder) if "_03" in p}
    (folder / "frame_03.exr").write_bytes(good[3])
    assert render(folder, *ASKED, "--resume") == 0 and UNFINISHED not in names(folder)
    for path in (frames / "whole").iterdir():
        assert path.name == "timing.csv" or path.read_bytes() == (folder / "out" / path.name).read_bytes()
    # With a camera that fits it, the sequence itself does not.
    spoil(folder, "frame_03.exr", lambda c: {n: v[::2, ::2] for n, v in c.items()})
    lens |= {"width": 32, "height": 18, "cx": 16, "cy": 9}
    (folder / "camera.json").write_text(json.dumps(scene))
    assert refused(folder, capsys, *ASKED, out="other") == (
        "frame_03.exr: has 32 x 18 pixels, the frames before it 64 x 36; render all frames in one size"
    )


def test_an_unfinished_sequence_is_not_lost_nor_mixed(folder, capsys):
    (folder / "frame_02.exr").write_bytes(b"")
    assert refused(folder, capsys, *ASKED) == (
        "frame_02.exr: is not an EXR image; restore the file or write it again"
    )
    before = {p.name: p.read_bytes() for p in (folder / "out").iterdir()}
    again = "; give what it was begun with, or another directory"
    for options, message in (
        (
            ASKED,
            "out: holds an unfinished sequence, 2 of 4 frames; give --resume to go on with it, or another ",
        ),
        (
            ["--mode", "fixed", "--spp", "8", "--resume"],
            f"out: holds an unfinished sequence with another --spp{again}",
        ),
        ([*ADAPTIVE, "--resume"], f"out: holds an unfinished sequence with another --mode{again}"),
        (
            [*ASKED, "--layer", "depth=z", "--resume"],
            f"out: holds an unfinished sequence with another --layer{again}",
        ),
    ):
        assert refused(folder, capsys, *options).startswith(message)
    frame = "frame_0[012].exr"
    another = f"out: holds an unfinished sequence with another FRAME.exr{again}"
    assert refused(folder, capsys, *ASKED, "--resume", frame=frame) == another
    camera = (folder / "camera.json").read_bytes()
    (folder / "camera.json").write_bytes(camera + b" ")
    another = f"out: holds an unfinished sequence with another content of the --camera file{again}"
    assert refused(folder, capsys, *ASKED, "--resume") == another
    (folder / "camera.json").write_bytes(camera)
    changed = "has changed since the sequence was rendered so far; bring it back, or start over in another"
    changed += " directory"
    for name in ("frame_01.exr", "out/count_00.png"):
        kept = (folder / name).read_bytes()
        (folder / name).write_bytes(kept + b" ")
        assert refused(folder, capsys, *ASKED, "--resume") == f"{name}: {changed}"
        (folder / name).write_bytes(kept)
    assert before == {p.name: p.read_bytes() for p in (folder / "out").iterdir()}
    (folder / "out" / UNFINISHED).write_bytes(b"PK")
    message = f"out/{UNFINISHED}: what is left of an unfinished sequence cannot be read ("
    assert refused(folder, capsys, *ASKED, "--resume").startswith(message)


def test_a_complete_sequence_of_other_options(folder, capsys):
    assert render(folder, *ASKED) == 0
    message = (
        "out: holds a complete sequence with another --seed; give what it was begun with, or another direc"
    )
    assert refused(folder, capsys, *ASKED, "--seed", "1", "--resume").startswith(message)


def test_a_complete_sequence_of_other_files(folder, capsys):
    assert render(folder, *ASKED) == 0
    for name in ("frame_01.exr", "out/scattered_00.exr", "out/sequence.csv"):
        kept = (folder / name).read_bytes()
        (folder / name).write_bytes(kept + b" ")
        message = f"{name}: has changed since the sequence was rendered so far; "
        assert refused(folder, capsys, *ASKED, "--resume").startswith(message)
        (folder / name).write_bytes(kept)
    (folder / "out" / "count_01.png").unlink()
    assert refused(folder, capsys, *ASKED, "--resume").startswith("out/count_01.png: ")


def test_outputs_in_the_place_of_inputs(folder, capsys):
    for k in range(2):
        (folder / f"frame_0{k}.exr").rename(folder / f"scattered_0{k}.exr")
    before = {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}
    frame = str(folder / "scattered_*.exr")
    scene = ["--camera", str(folder / "camera.json"), "--profile", "skin1", *ASKED]
    assert main(["render", frame, *scene, "--out", str(folder), "--quiet"]) == 2
    message = "an output of this name would take its place, nothing was written; give another --out"
    assert f"scattered_00.exr: {message}" in capsys.readouterr().err
    assert before == {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


def test_a_frame_rewritten_while_it_is_read(folder, capsys, monkeypatch):
    load = gbuffer.load

    def rewritten(path, *arguments, **options):
        found = load(path, *arguments, **options)
        os.utime(path, ns=(1, 1))
        return found

    monkeypatch.setattr(gbuffer, "load", rewritten)
    message = "frame_00.exr: has changed while it was read; render it first, then this"
    assert refused(folder, capsys, *ASKED) == message


def test_a_single_frame_into_an_unfinished_sequence(folder, capsys):
    (folder / "out").mkdir()
    (folder / "out" / UNFINISHED).write_bytes(b"")
    message = refused(folder, capsys, frame="frame_00.exr")
    assert (
        message
        == "out: holds an unfinished sequence; finish it with --mode and --resume, or give another directory"
    )


def test_outputs_that_cannot_be_written(folder, capsys, monkeypatch):
    (folder / "out").write_text("notes")
    assert refused(folder, capsys, *ASKED) == (
        "out: is a file, not a directory; move it away or choose another directory"
    )
    assert main(["render", "a_1.exr", "--fx", "9", "--d", "1,1,1", *ASKED, "--out", ""]) == 2
    assert capsys.readouterr().err == "sssfit: --out must name a directory; use . for the current one\n"


def test_a_state_that_cannot_be_kept(folder, capsys, monkeypatch):
    from sssfit.files.errors import FileError

    def full(*arguments):
        raise FileError(
            "out", "", "the disk is full, an earlier file is untouched", "free space and run again"
        )

    with monkeypatch.context() as patch:
        patch.setattr(sequence_ledger, "save", full)
        message = refused(folder, capsys, *ASKED)
    assert message == "out: the disk is full, an earlier file is untouched; free space and run again"
    assert render(folder, *ASKED, "--resume") == 0


def test_frames_without_the_normals_that_are_needed(folder, capsys):
    for k in range(4):
        spoil(folder, f"frame_0{k}.exr", lambda c: {n: v for n, v in c.items() if not n.startswith("normal")})
    message = (
        "frame_00.exr: has no normals, which are needed here; name them with --layer normal=..., or take "
    )
    assert refused(folder, capsys, *ASKED).startswith(message)


def test_a_profile_that_comes_later_and_is_not_known(folder, capsys):
    spoil(folder, "frame_02.exr", lambda c: c | {"id": np.where(c["id"] == 2, 7, c["id"]).astype(np.uint32)})
    message = (
        "camera.json: id 7 of the frame has no profile beside 'skin1'; write it into profiles_by_id, null"
    )
    assert refused(folder, capsys, *ASKED).startswith(message)
    assert names(folder) == FIRST_TWO | {UNFINISHED}
