"""`sssfit tables`: what it writes, what it refuses, and that a failure loses nothing."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from sssfit import tables
from sssfit.cli.main import main
from sssfit.files import atomic
from sssfit.files.output import Output

HEADER = "material,unit,albedo_r,albedo_g,albedo_b,dmfp_r,dmfp_g,dmfp_b\n"
SMALL = ["--size", "16", "--size-2d", "5", "--quiet"]


@pytest.fixture
def wax(tmp_path):
    path = tmp_path / "wax.csv"
    path.write_text(HEADER + "Wax,mm,0.8,0.6,0.4,2.5,1.5,0\n")
    return path


def contents(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


def test_every_file_is_listed_and_loads(wax, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["tables", str(wax), "--out", str(out), *SMALL]) == 0
    assert "8 tables" in capsys.readouterr().out
    written = contents(out)

    listed = json.loads(written["manifest.json"])
    assert set(written) == set(listed["files"]) | {"manifest.json", "timing.json"}
    assert listed["inputs"][0]["name"] == "wax.csv"
    for entry in listed["tables"]:
        for stored in entry["formats"].values():
            for name in stored["files"]:
                if not name.endswith(".json"):
                    assert tables.load(out / name).name == entry["name"]


def test_a_delta_channel_is_handled(wax, tmp_path):
    out = tmp_path / "out"
    assert main(["tables", str(wax), "--out", str(out), "--formats", "npz", *SMALL]) == 0
    transmittance = tables.load(out / "Wax" / "transmittance.npz").values[:, 2]
    assert transmittance[0] == pytest.approx(0.4) and not transmittance[1:].any()
    kernel = tables.load(out / "Wax" / "burley_kernel.npz").values[:, 2]
    assert kernel[12] == 1 and kernel.sum() == 1
    curvature = tables.load(out / "Wax" / "curvature.npz")
    cosine = curvature.axes[1].values
    assert (curvature.values[:, :, 2] == cosine.clip(0)[None, :]).all()


def test_files_of_others_and_of_earlier_runs_stay(wax, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    assert main(["tables", str(wax), "--out", str(out), "--formats", "npz", *SMALL]) == 0
    assert main(["tables", str(wax), "--out", str(out), "--formats", "csv", *SMALL]) == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert (out / "radius.npz").exists() and (out / "radius.csv").exists()


BAD_FILES = {
    "missing column": ("material,unit\nWax,mm\n", "row 1: column 'sigma_s_reduced_r' is missing"),
    "negative": (HEADER + "Wax,mm,0.8,0.6,0.4,2.5,-1.5,0\n", "row 2: dmfp_g is -1.5"),
    "unit": (HEADER + "Wax,inch,0.8,0.6,0.4,2.5,1.5,0\n", "row 2: the unit 'inch' is not known"),
    "text": (HEADER + "Wax,mm,0.8,0.6,0.4,2.5,wide,0\n", "row 2: column 'dmfp_g' has 'wide'"),
    "empty": ("", "the file is empty"),
    "file name": (
        HEADER + "report.html,mm,0.8,0.6,0.4,2.5,1.5,0\n",
        "row 2: the material name 'report.html'",
    ),
    "too long": (HEADER + "Wax,mm,0.8,0.6,0.4,2.5,1e11,0\n", "mean free path of channel g is 1e+11 mm"),
    "albedo": (HEADER + "A,mm,0,0,0,1,1,1\nWax,mm,1.2,0.6,0.4,2.5,1,0\n", "row 3: albedo_r is 1.2"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_input_is_one_sentence_and_loses_nothing(case, tmp_path, capsys):
    text, message = BAD_FILES[case]
    source, out = tmp_path / "bad.csv", tmp_path / "out"
    source.write_text(text)
    out.mkdir()
    (out / "manifest.json").write_text("earlier")
    assert main(["tables", str(source), "--out", str(out), *SMALL]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("sssfit: bad.csv") and message in captured.err
    assert captured.err.count("\n") == 1 and ";" in captured.err
    assert contents(out) == {"manifest.json": b"earlier"}


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--size", "0"], "size must be from 12 to 65536, got 0"),
        (["--size", "1000000000"], "size must be from 12 to 65536, got 1000000000"),
        (["--size-2d", "1"], "size-2d must be from 2 to 1024, got 1"),
    ],
)
def test_bad_sizes(arguments, message, tmp_path, capsys):
    assert main(["tables", "--out", str(tmp_path / "out"), *arguments]) == 2
    assert capsys.readouterr().err == f"sssfit: {message}\n"
    assert not (tmp_path / "out").exists()


def test_output_that_is_a_file(wax, tmp_path, capsys):
    assert main(["tables", str(wax), "--out", str(wax), *SMALL]) == 2
    assert "is a file, not a directory" in capsys.readouterr().err
    assert wax.read_text().startswith("material")


@pytest.fixture
def earlier(wax, tmp_path):
    out = tmp_path / "out"
    assert main(["tables", str(wax), "--out", str(out), "--formats", "npz", *SMALL]) == 0
    return out, contents(out)


def test_a_disk_that_fills_up_leaves_earlier_outputs(wax, earlier, monkeypatch, capsys):
    out, before = earlier
    count, written = 0, Output.put

    def put(self, path, content):
        nonlocal count
        count += 1
        if count > 5:
            raise OSError(28, "No space left on device")
        written(self, path, content)

    monkeypatch.setattr(Output, "put", put)
    capsys.readouterr()
    assert main(["tables", str(wax), "--out", str(out), *SMALL]) == 2
    assert "the disk is full" in capsys.readouterr().err
    assert contents(out) == before


def test_an_unwritable_directory(wax, tmp_path, monkeypatch, capsys):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    # Root may write anywhere, so the system's refusal is simulated.
    monkeypatch.setattr(atomic.tempfile, "mkdtemp", refuse)
    out = tmp_path / "out"
    assert main(["tables", str(wax), "--out", str(out), *SMALL]) == 2
    assert "cannot be written (permission denied)" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("moment", ["before anything is staged", "in the middle"])
def test_interrupting_leaves_earlier_outputs(moment, wax, earlier, monkeypatch, capsys):
    out, before = earlier
    steps, written = 0 if moment == "before anything is staged" else 4, Output.put

    def interrupt(self, path, content):
        nonlocal steps
        if steps == 0:
            raise KeyboardInterrupt
        steps -= 1
        written(self, path, content)

    monkeypatch.setattr(Output, "put", interrupt)
    capsys.readouterr()
    assert main(["tables", str(wax), "--out", str(out), *SMALL]) == 2
    assert capsys.readouterr().err == (
        "sssfit: interrupted; outputs are either as before or complete, run again to finish\n"
    )
    assert contents(out) == before


@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
@pytest.mark.parametrize("delay", [0.3, 0.8, 1.5, 2.5, None])
def test_a_real_interrupt_of_a_real_process(delay, wax, tmp_path):
    """At any moment: in the imports, in compiled code, and (None) as soon as the output is staged."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "sssfit.cli", "tables", str(wax), "--out", str(out)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    if delay is None:
        deadline = time.monotonic() + 60
        while not out.exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert out.exists(), "the run never began to write"
    else:
        time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 2, error
    assert error == "sssfit: interrupted; outputs are either as before or complete, run again to finish\n"
    assert not out.exists()


def test_an_empty_output_name(wax, capsys):
    assert main(["tables", str(wax), "--out", ""]) == 2
    assert capsys.readouterr().err == "sssfit: --out must name a directory; use . for the current one\n"
