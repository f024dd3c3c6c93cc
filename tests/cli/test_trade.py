"""`sssfit trade`: a small run, going on with one, and refusals."""

import csv
import json
import shutil

import pytest

from sssfit.cli.main import main
from sssfit.frames import gbuffer
from sssfit.trade import measure

SMALL = ["trade", "--rounds", "3", "--only", "precision"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("trade") / "out"
    assert (
        main(["trade", "--quick", "--rounds", "3", "--only", "precision", "--out", str(out), "--quiet"]) == 0
    )
    return out


def test_files_and_their_numbers(run):
    names = {path.relative_to(run).as_posix() for path in run.rglob("*") if path.is_file()}
    files = {"precision.png", "report.html", "trade.csv", "trade.json", "manifest.json"}
    assert names == files | {"measured/precision.json"}
    found = json.loads((run / "trade.json").read_text())
    assert found["conditions"]["rounds"] == 3 and found["conditions"]["quick"] is True
    choices = {one["choice"]: one for one in found["groups"]["precision"]["choices"]}
    # Half a unit in the last place at most, and a third of that in the mean, of distance and of density.
    for name, digits in {"float32": 24, "float16": 11, "bfloat16": 8}.items():
        assert 0.1 * 2.0**-digits < choices[name]["error"] < 10 * 2.0**-digits
    assert choices["float64"]["error"] < 1e-14
    assert [name for name, one in choices.items() if one["is_default"]] == ["float32"]
    lines = list(csv.DictReader((run / "trade.csv").read_text().splitlines()))
    assert [line["choice"] for line in lines] == list(choices)
    manifest = json.loads((run / "manifest.json").read_text())
    assert manifest["options"]["only"] == ["precision"] and set(manifest["files"]) == files - {
        "manifest.json"
    }


def test_a_run_goes_on_with_what_is_measured(run, capsys, monkeypatch):
    before = (run / "trade.csv").read_bytes()

    def fail(*arguments):
        raise AssertionError("it is there")

    monkeypatch.setattr(measure, "group", fail)
    assert main([*SMALL, "--quick", "--out", str(run), "--resume"]) == 0
    assert (run / "trade.csv").read_bytes() == before
    assert "precision: 4 choices, on the front " in capsys.readouterr().out
    assert main([*SMALL, "--out", str(run), "--resume"]) == 2
    error = capsys.readouterr().err
    assert "precision.json" in error and "was measured under other conditions" in error
    assert (run / "trade.csv").read_bytes() == before


def test_an_interruption_loses_nothing(run, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    shutil.copytree(run, out)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}

    def interrupted(of, *rest):
        raise KeyboardInterrupt

    monkeypatch.setattr(measure, "group", interrupted)
    assert main([*SMALL, "histories", "--quick", "--out", str(out), "--resume"]) == 2
    assert "interrupted" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_what_a_frame_lacks_is_said_in_the_report(tmp_path, capsys):
    frame, camera = tmp_path / "frame.exr", tmp_path / "camera.json"
    assert (
        main(["procedural-frame", "--frames", "1", "--width", "32", "--height", "18", "--out", str(tmp_path)])
        == 0
    )
    scene = gbuffer.load(tmp_path / "frame_00.exr", camera)
    gbuffer.write(frame, scene._replace(normal=None))
    capsys.readouterr()
    out = tmp_path / "out"
    given = ["--frame", str(frame), "--camera", str(camera), "--profile", "skin1"]
    assert main(["trade", "--quick", "--only", "estimators", *given, "--out", str(out)]) == 0
    assert "estimators: not measured, the frame has no normals" in capsys.readouterr().out
    assert "Not measured: the frame has no normals." in (out / "report.html").read_text()
    assert not (out / "estimators.png").exists()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--only", "speed"], "--only must name groups or studies among inverse_cdfs, "),
        (["--rounds", "2"], "--rounds must be at least 3, got 2"),
        (["--camera", "camera.json"], "--camera belongs to --frame"),
        (["--frame", "frame.exr"], "--frame needs --camera"),
        (["--frame", "frame.exr", "--camera", "camera.json"], "--frame needs --profile"),
        (
            ["--frame", "none.exr", "--camera", "none.json", "--profile", "skin1"],
            "none.exr: there is no such file; check the path",
        ),
    ],
)
def test_refusals(arguments, message, tmp_path, capsys):
    assert main(["trade", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error and len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()
