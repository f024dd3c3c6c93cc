"""`sssfit render --mode`: what it writes of a sequence, and that no break makes a difference."""

import csv
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image

from sssfit.cli.main import main
from sssfit.estimators import policies
from sssfit.files.exr import encode_exr, read_exr
from sssfit.frames import (
    compare,
    gbuffer,
    procedural,
    scatter,
    scene_profiles,
    sequence,
    sequence_ledger,
    sequence_output,
)
from sssfit.frames.points import Settings
from sssfit.frames.sequence_ledger import UNFINISHED

H, W, FRAMES, BLACK, LEFT_OUT = 36, 64, 5, 2, 3
ASKED = ["--mode", "ocv", "--target-variance", "2e-3", "--spp", "4:16"]
KINDS = ("scattered_{}.exr", "scattered_{}.png", "count_{}.exr", "count_{}.png")
WHOLE = {"sequence.csv", "sequence.png", "sequence.webp", "summary.json", "timing.csv", "manifest.json"}


def contents(directory):
    """All files but the one with times."""
    return {p.name: p.read_bytes() for p in directory.iterdir() if p.name != "timing.csv"}


def layer(path, name):
    channels = read_exr(path)[0]
    return np.stack([channels[f"{name}.{c}"] for c in "RGB"], axis=-1)


def rows(directory):
    with open(directory / "sequence.csv", newline="") as file:
        return list(csv.DictReader(file))


def summary(directory):
    return json.loads((directory / "summary.json").read_text())


def command(folder, out, *options, frames=None):
    frames = [str(folder / "frame_*.exr")] if frames is None else frames
    scene = [*frames, "--camera", str(folder / "camera.json"), "--profile", "skin1"]
    return ["render", *scene, *options, "--out", str(out), "--quiet"]


def render(folder, out, *options, frames=None):
    return main(command(folder, out, *options, frames=frames))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Five frames, the third of them black; references of all but one, which are some light with noise."""
    here = tmp_path_factory.mktemp("sequence")
    size = ["--width", str(W), "--height", str(H), "--frames", str(FRAMES)]
    assert main(["procedural-frame", *size, "--out", str(here), "--quiet"]) == 0
    dark = procedural.frame(BLACK, width=W, height=H)
    gbuffer.write(here / f"frame_0{BLACK}.exr", dark._replace(irradiance=0 * dark.irradiance))
    noise = np.random.default_rng(2)
    for k in set(range(FRAMES)) - {LEFT_OUT}:
        light = layer(here / f"frame_0{k}.exr", "E")
        halves = {"sss": 0.9 * light + 0.01, "diff": noise.normal(0, 0.02, light.shape).astype(np.float32)}
        channels = {f"{n}.{c}": v[..., i].copy() for n, v in halves.items() for i, c in enumerate("RGB")}
        (here / f"exact_{k}.exr").write_bytes(encode_exr(channels, {}))
    assert render(here, here / "ocv", *ASKED, "--reference", str(here / "exact_*.exr")) == 0
    return here


@pytest.fixture(scope="module")
def frames(folder):
    return [gbuffer.load(folder / f"frame_0{k}.exr", folder / "camera.json") for k in range(FRAMES)]


@pytest.fixture(scope="module")
def profiles(folder):
    return scene_profiles.by_id(folder / "camera.json", "skin1")


def test_files_and_manifest(folder):
    written = contents(folder / "ocv")
    each = {kind.format(f"0{k}") for k in range(FRAMES) for kind in KINDS}
    assert set(written) == each | WHOLE - {"timing.csv"}
    digits = [f"0{k}" for k in range(FRAMES)]
    assert set(sequence_output.names(digits)) == {path.name for path in (folder / "ocv").iterdir()}
    manifest = json.loads(written.pop("manifest.json"))
    listed = {name: entry["sha256"] for name, entry in manifest["files"].items()}
    assert listed == {name: hashlib.sha256(data).hexdigest() for name, data in written.items()}
    asked = manifest["options"]
    assert asked["frame"] == [f"frame_0{k}.exr" for k in range(FRAMES)] and asked["camera"] == "camera.json"
    assert asked["reference"] == [f"exact_{k}.exr" for k in range(FRAMES) if k != LEFT_OUT]
    inputs = asked["inputs_sha256"]
    for name, digest in {**inputs["frames"], **inputs["references"], "camera.json": inputs["camera"]}.items():
        assert digest == hashlib.sha256((folder / name).read_bytes()).hexdigest()
    assert set(inputs["frames"]) == set(asked["frame"])
    for name in sorted(each | {"sequence.png", "sequence.webp"}):
        if not name.endswith("exr"):
            with Image.open(folder / "ocv" / name) as picture:
                assert picture.size[0] >= W
    with open(folder / "ocv" / "timing.csv", newline="") as file:
        times = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in times] == list(range(FRAMES))
    assert set(times[0]) == {"frame", "reading_seconds", "step_seconds", "writing_seconds"}
    assert all(float(row["step_seconds"]) > 0 for row in times)


def test_the_images_are_the_library_s(folder, frames, profiles):
    policy = policies.named("ocv", target_variance=2e-3, min_spp=4, max_spp=16)
    for k, (_, image, info) in enumerate(sequence.scan(frames, sequence.Config(policy, profiles))):
        np.testing.assert_array_equal(layer(folder / "ocv" / f"scattered_0{k}.exr", "sss"), image)
        counts = read_exr(folder / "ocv" / f"count_0{k}.exr")[0]["count"]
        assert counts.dtype == np.uint32
        np.testing.assert_array_equal(counts, info.counts)


def test_the_figures_are_those_of_the_files(folder, frames):
    found = rows(folder / "ocv")
    assert list(found[0])[:3] == ["frame", "mean_count", "psnr"] and len(found) == FRAMES
    for k, (row, frame) in enumerate(zip(found, frames, strict=True)):
        mask = np.asarray(frame.profile_id) > 0
        counts = read_exr(folder / "ocv" / f"count_0{k}.exr")[0]["count"][mask]
        assert int(row["frame"]) == k and float(row["mean_count"]) == pytest.approx(counts.mean(), rel=1e-12)
        assert int(row["largest_count"]) == counts.max() and int(row["samples"]) == counts.sum()
        assert float(row["share_at_max"]) == pytest.approx((counts == 16).mean())
        if k in (BLACK, LEFT_OUT):
            assert row["psnr"] == ""
            continue
        sss, diff = (layer(folder / f"exact_{k}.exr", name) for name in ("sss", "diff"))
        image = layer(folder / "ocv" / f"scattered_0{k}.exr", "sss")
        assert float(row["psnr"]) == compare.compare(image, sss, diff, mask).psnr
    assert float(found[0]["share_new"]) == 1 and float(found[1]["share_new"]) < 0.1
    stated = summary(folder / "ocv")
    assert stated["mean_count"] == pytest.approx(np.mean([float(row["mean_count"]) for row in found]))
    assert stated["psnr"] == pytest.approx(np.mean([float(row["psnr"]) for row in found if row["psnr"]]))
    assert (stated["psnr_frames"], stated["frames"], stated["size"]) == (3, FRAMES, [W, H])
    assert (stated["mode"], stated["min_spp"], stated["max_spp"], stated["alpha"]) == ("ocv", 4, 16, 0.2)
    assert stated["settings"]["cutoff"] == 16 and stated["light"] == "control"
    first = layer(folder / "ocv" / "scattered_00.exr", "sss")
    assert stated["pictures"] == {"count": 16, "white": sequence_output.white(first)}


def test_a_fixed_count(folder, frames, profiles, tmp_path):
    assert render(folder, tmp_path, "--mode", "fixed", "--spp", "16", "--seed", "3") == 0
    expected = scatter.every_profile(frames[0], profiles, counts=16, seed=3 * 1024)
    np.testing.assert_array_equal(layer(tmp_path / "scattered_00.exr", "sss"), expected)
    assert {float(row["mean_count"]) for row in rows(tmp_path)} == {16}
    stated = summary(tmp_path)
    assert (stated["psnr"], stated["alpha"], stated["history"]) == (None, None, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "options", "constants"),
    [
        ("as", ["--kappa", "0.1", "--gamma", "2.2"], {"kappa": 0.1, "gamma": 2.2, "alpha": 0.2}),
        ("ccv", ["--light", "surround"], {"light": "surround"}),
        ("unreal", ["--alpha", "0.3", "--history", "float16"], {"alpha": 0.3, "history": "float16"}),
        ("in_frame", [], {"alpha": 0.02, "light": "surround", "kappa": None, "gain_alpha": 0.1}),
        ("in_frame", ["--points", "fresh", "--sequence", "iid"], {"gain_alpha": None, "max_spp": 64}),
        ("oracle", ["--white", "2.5"], {"alpha": None, "pictures": {"count": 64, "white": 2.5}}),
    ],
)
def test_every_mode(folder, frames, profiles, tmp_path, mode, options, constants):
    given = ["--mode", mode, "--target-variance", "5e-3", *options]
    assert render(folder, tmp_path, *given, frames=[str(folder / f"frame_0{k}.exr") for k in (1, 0)]) == 0
    stated = summary(tmp_path)
    assert stated | constants == stated and stated["frames"] == 2
    own = ("kappa", "alpha", "light", "gain_alpha")
    named = {name: constants[name] for name in own if constants.get(name) is not None}
    policy = policies.named(mode, target_variance=5e-3, **named)
    more = {"gamma": constants.get("gamma", 1.0), "history_dtype": constants.get("history", "float32")}
    if "iid" in options:
        more["settings"] = Settings(points="fresh", sequence="iid")
    config = sequence.Config(policy, profiles, **more)
    for k, (_, image, info) in enumerate(sequence.scan(frames[:2], config)):
        np.testing.assert_array_equal(layer(tmp_path / f"scattered_0{k}.exr", "sss"), image)
        np.testing.assert_array_equal(read_exr(tmp_path / f"count_0{k}.exr")[0]["count"], info.counts)


def test_the_same_bytes_twice(folder, tmp_path):
    names = [str(folder / f"frame_0{k}.exr") for k in (3, 0, 2, 1, 4)]
    truth = [str(folder / f"exact_{k}.exr") for k in (4, 2, 1, 0)]
    assert render(folder, tmp_path, *ASKED, "--reference", *truth, frames=names) == 0
    assert contents(tmp_path) == contents(folder / "ocv")


class Killed(BaseException):
    """What nothing in the package expects."""


def killed(folder, out, monkeypatch, moment):
    """A run in which nothing reaches the disk any more from a moment on."""
    replace = os.replace

    def counted(*arguments):
        nonlocal moment
        moment -= 1
        if moment <= 0:
            raise Killed
        return replace(*arguments)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(os, "replace", counted)
        render(folder, out, *ASKED, "--reference", str(folder / "exact_*.exr"), "--resume")
    (out / f".sssfit-{moment + 2**60:016x}.tmp").write_bytes(b"half")


# Four files and the state of each frame, the times, and five files at the end.
@pytest.mark.parametrize("moments", [[3], [5], [6, 2, 9], [26], [28], [31]])
def test_what_is_cut_off_goes_on_with_the_same_bytes(folder, tmp_path, monkeypatch, capsys, moments):
    out = tmp_path / "out"
    for moment in moments:
        killed(folder, out, monkeypatch, moment)
        assert not (out / "manifest.json").exists()
    capsys.readouterr()
    assert render(folder, out, *ASKED, "--reference", str(folder / "exact_*.exr"), "--resume") == 0
    assert capsys.readouterr().out.startswith("5 frames; mean count ")
    assert contents(out) == contents(folder / "ocv")


def test_large_frames_go_on_from_a_state_that_is_older(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(sequence_ledger, "LARGE_PIXELS", 100)
    monkeypatch.setattr(sequence_ledger, "SELDOM", 2)
    # In the fourth frame: the state is that after two.
    killed(folder, tmp_path, monkeypatch, 15)
    kept = sequence_ledger.load(tmp_path)
    assert kept is not None and len(kept[0].rows) == 2 and (tmp_path / "count_02.png").exists()
    assert render(folder, tmp_path, *ASKED, "--reference", str(folder / "exact_*.exr"), "--resume") == 0
    assert contents(tmp_path) == contents(folder / "ocv")


def interrupted(monkeypatch, after):
    files = sequence_output.files

    def counted(*arguments, **options):
        nonlocal after
        after -= 1
        if after == 0:
            signal.raise_signal(signal.SIGINT)
        return files(*arguments, **options)

    monkeypatch.setattr(sequence_output, "files", counted)


def test_ctrl_c_lets_the_frame_end(folder, tmp_path, monkeypatch, capsys):
    options = [*ASKED, "--reference", str(folder / "exact_*.exr")]
    with monkeypatch.context() as patch:
        interrupted(patch, 2)
        assert render(folder, tmp_path, *options) == 2
    printed = capsys.readouterr()
    sentence = "sssfit: interrupted after 2 of 5 frames; run again with --resume to go on\n"
    assert (printed.out, printed.err) == ("", sentence)
    assert {p.name for p in tmp_path.iterdir()} == {k.format(f"0{n}") for k in KINDS for n in (0, 1)} | {
        UNFINISHED
    }
    assert render(folder, tmp_path, *options, "--resume") == 0
    assert contents(tmp_path) == contents(folder / "ocv")


def test_a_complete_sequence_is_left_alone_and_an_empty_one_begun(folder, tmp_path, capsys):
    out, options = tmp_path / "out", ["--mode", "fixed", "--spp", "16", "--resume"]
    assert render(folder, out, *options) == 0
    before = contents(out)
    capsys.readouterr()
    assert render(folder, out, *options) == 0
    assert capsys.readouterr().out == f"all 5 frames were complete: see {out / 'sequence.png'}\n"
    assert contents(out) == before
    # Without --resume it is done again, as a single frame is.
    assert render(folder, out, *options[:-1]) == 0 and contents(out) == before


def test_motion_that_is_missing_is_told_once(folder, frames, tmp_path, monkeypatch, capsys):
    for k, frame in enumerate(frames):
        gbuffer.write(tmp_path / f"still_{k}.exr", frame._replace(motion=None))
    (tmp_path / "camera.json").write_bytes((folder / "camera.json").read_bytes())
    still = {"frames": [str(tmp_path / "still_*.exr")]}
    with monkeypatch.context() as patch:
        interrupted(patch, 3)
        assert render(tmp_path, tmp_path / "out", *ASKED, **still) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first == (
        f"warning: {tmp_path / 'still_1.exr'}: there is no motion; this and other frames without are taken "
        "to stand still"
    )
    assert "interrupted after 3" in second
    assert render(tmp_path, tmp_path / "out", *ASKED, "--resume", **still) == 0
    assert capsys.readouterr().err == ""
    assert summary(tmp_path / "out")["without_motion"] == [1, 2, 3, 4]


def test_motion_by_another_name(folder, tmp_path):
    for k in range(3):
        channels, _ = read_exr(folder / f"frame_0{k}.exr")
        renamed = {name.replace("motion.", "Vector."): values for name, values in channels.items()}
        (tmp_path / f"frame_0{k}.exr").write_bytes(encode_exr(renamed, {}))
    (tmp_path / "camera.json").write_bytes((folder / "camera.json").read_bytes())
    assert render(tmp_path, tmp_path / "out", *ASKED, "--layer", "motion=Vector") == 0
    for k in range(3):
        name = f"scattered_0{k}.exr"
        assert (tmp_path / "out" / name).read_bytes() == (folder / "ocv" / name).read_bytes()


def test_bad_pixels_are_told_in_order(folder, tmp_path, capsys):
    for k in range(4):
        channels, _ = read_exr(folder / f"frame_0{k}.exr")
        channels["E.G"][20, 26 : 27 + k % 3] = np.nan
        (tmp_path / f"frame_0{k}.exr").write_bytes(encode_exr(channels, {}))
    (tmp_path / "camera.json").write_bytes((folder / "camera.json").read_bytes())
    assert render(tmp_path, tmp_path / "out", *ASKED) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1] for line in lines] == [str(tmp_path / f"frame_0{k}.exr") for k in range(4)]
    assert summary(tmp_path / "out")["bad_pixels"] == 1 + 2 + 3 + 1


def test_a_single_frame_is_as_it_was(folder, tmp_path):
    frame = [str(folder / "frame_00.exr")]
    assert render(folder, tmp_path, "--spp", "16", frames=frame) == 0
    asked = json.loads((tmp_path / "manifest.json").read_text())["options"]
    assert (asked["frame"], asked["reference"], asked["replicates"]) == ("frame_00.exr", None, 8)
    assert not {"mode", "alpha", "kappa", "gamma", "history", "light", "white", "resume"} & set(asked)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
def test_a_real_process_killed_at_random_moments(folder, tmp_path):
    for k in range(24):
        shutil.copy(folder / f"frame_0{k % FRAMES}.exr", tmp_path / f"frame_{k:02}.exr")
    shutil.copy(folder / "camera.json", tmp_path / "camera.json")
    whole, out, moments = tmp_path / "whole", tmp_path / "out", np.random.default_rng(5)
    assert render(tmp_path, whole, *ASKED) == 0
    for _ in range(3):
        again = [sys.executable, "-m", "sssfit.cli", *command(tmp_path, out, *ASKED, "--resume")]
        process = subprocess.Popen(again, stdout=subprocess.DEVNULL)
        done = len(list(out.glob("scattered_*.exr")))
        while process.poll() is None and len(list(out.glob("scattered_*.exr"))) <= done:
            time.sleep(0.001)
        time.sleep(moments.uniform(0, 0.15))
        process.kill()
        process.wait()
        assert (out / UNFINISHED).exists() or not list(out.glob("count_*.png"))[1:]
    assert render(tmp_path, out, *ASKED, "--resume") == 0
    assert contents(out) == contents(whole)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
@pytest.mark.parametrize("delay", [0.5, None])
def test_a_real_interrupt_of_a_real_process(folder, tmp_path, delay):
    """In the imports, and (None) between or in frames; then it goes on."""
    out = tmp_path / "out"
    again = command(folder, out, *ASKED, "--reference", str(folder / "exact_*.exr"))
    process = subprocess.Popen(
        [sys.executable, "-m", "sssfit.cli", *again], stderr=subprocess.PIPE, text=True
    )
    if delay is None:
        while process.poll() is None and not (out / UNFINISHED).exists():
            time.sleep(0.001)
    else:
        time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 2 and error.startswith("sssfit: interrupted") and error.count("\n") == 1
    assert out.exists() is (delay is None)
    assert delay or "run again with --resume to go on" in error
    assert main([*again, "--resume"]) == 0
    assert contents(out) == contents(folder / "ocv")


@pytest.mark.slow
def test_a_rendered_head_under_a_flash(rendered, tmp_path):
    here = rendered / "s5_flash"
    names = [str(here / f"frame_0{k}.exr") for k in range(7)]
    options = ["--mode", "ocv", "--target-variance", "1e-3", "--spp", "8:64"]
    truth = ["--reference", str(here / "exact_skin1_*.exr")]
    assert render(here, tmp_path, *options, *truth, frames=names) == 0
    found = rows(tmp_path)
    assert [k for k, row in enumerate(found) if row["psnr"]] == [0, 3, 6]
    psnr = [float(row["psnr"]) for row in found if row["psnr"]]
    assert psnr[0] < psnr[1] < psnr[2] and float(found[6]["mean_count"]) > 30
    assert all(float(row["share_new"]) < 0.01 for row in found[1:])
