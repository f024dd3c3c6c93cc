"""`sssfit simulate line`: counts and errors along a line, beside light that stays, and files as inputs."""

import csv
import hashlib
import json
import math

import numpy as np
import pytest
from PIL import Image

from sssfit.cli.main import main

# Each simulation is a program to compile, and many seeds.
pytestmark = pytest.mark.slow

FRAMES, TEXELS, SEEDS = 60, 64, 4
SMALL = ["--frames", str(FRAMES), "--texels", str(TEXELS), "--seeds", str(SEEDS)]
FILES = {"summary.json", "simulation.png", "simulation.npz", "frames.csv", "texels.csv"}
#: Positions of the texels' centres, mm.
X = (np.arange(TEXELS) + 0.5) / 16


def contents(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


def simulate(out, *arguments):
    """The summary of a run."""
    assert main(["simulate", "line", "--out", str(out), *SMALL, *arguments]) == 0
    return json.loads((out / "summary.json").read_text())


def table(path):
    with open(path, newline="") as stream:
        header, *rows = csv.reader(stream)
    return dict(zip(header, np.array(rows, float).T, strict=True))


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Adaptive sampling under light that stays and that varies: directories and summaries."""
    found = {}
    for light in ("static", "sine"):
        out = tmp_path_factory.mktemp(light) / "out"
        found[light] = out, simulate(out, "--light", light)
    return found


def test_files_summary_and_picture(runs):
    out, summary = runs["static"]
    written = contents(out)
    assert set(written) == FILES | {"manifest.json"}
    manifest = json.loads(written["manifest.json"])
    assert {name: entry["sha256"] for name, entry in manifest["files"].items()} == {
        name: hashlib.sha256(written[name]).hexdigest() for name in FILES
    }
    asked = {
        "controller": "as",
        "target_variance": 1e-4,
        "start": "disocclusion",
        "kernel": "line",
        "d": 0.05,
    }
    assert (
        asked | {"profile": "ramp", "amplitude": 0.5, "length": 4.0, "texels": 64}
    ).items() <= summary.items()
    with Image.open(out / "simulation.png") as picture:
        assert picture.size == (1595, 792)


@pytest.mark.parametrize("light", ["static", "sine"])
def test_figures_are_those_of_the_records(light, runs):
    out, summary = runs[light]
    with np.load(out / "simulation.npz") as archive:
        counts, results = (archive[name].astype(float) for name in ("record_count", "record_value"))
        truth, variance = archive["truth"], archive["sample_variance"]
    assert counts.shape == (SEEDS, FRAMES, TEXELS)
    errors = ((results - truth) ** 2).mean(axis=(1, 2))
    ideal = np.clip(variance / 1e-4, 8, 64)
    expected = {
        "mean_count": counts.mean(),
        "mean_count_se": counts.mean(axis=(1, 2)).std(ddof=1) / 2,
        "image_rmse": np.sqrt(errors.mean()),
        "oracle_count": ideal.mean(),
        "count_over_oracle": counts.mean() / ideal.mean(),
        "static_mean_count": runs["static"][1]["mean_count"],
        "static_ratio": counts.mean() / runs["static"][1]["mean_count"],
        "static_image_rmse": runs["static"][1]["image_rmse"],
    }
    assert {name: summary[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    # Given a count, a squared error is the delivered variance on average; the rest is uncorrelated.
    rest = (results - truth) ** 2 - variance / counts
    assert abs(rest.mean()) < 5 * rest.std() / math.sqrt(rest.size)


def test_adaptive_sampling_takes_moving_light_for_noise(runs):
    assert runs["static"][1]["static_ratio"] == 1
    assert runs["sine"][1]["static_ratio"] > 1.8
    # Twice what the light itself asks for.
    assert runs["sine"][1]["count_over_oracle"] > 2 > 1.5 > runs["static"][1]["count_over_oracle"]


def test_named_lighting(runs):
    for light, intensity in (
        ("static", np.ones(FRAMES)),
        ("sine", 1 + 0.5 * np.sin(2 * math.pi * np.arange(FRAMES) / 60)),
    ):
        out = runs[light][0]
        texels, frames = table(out / "texels.csv"), table(out / "frames.csv")
        assert (texels["x_mm"] == X).all()
        assert texels["irradiance"] == pytest.approx(0.5 * np.clip(X - 1, 0, 1), rel=1e-14)
        assert frames["intensity"] == pytest.approx(intensity, rel=1e-14)
        # Around its middle, at 1.5 mm, the ramp is odd, and so is the truth.
        below, above = texels["truth"][:24], texels["truth"][24:48][::-1]
        assert below + above == pytest.approx(np.full(24, 0.5 * intensity.mean()), rel=1e-6)


def test_the_same_command_gives_the_same_bytes(runs, tmp_path):
    simulate(tmp_path, "--light", "sine")
    assert contents(runs["sine"][0]) == contents(tmp_path)


def test_light_and_profile_from_files(runs, tmp_path):
    light, profile = tmp_path / "lamp.csv", tmp_path / "edge.csv"
    light.write_text("time,intensity\n0,1\n0.5,1\n")
    profile.write_text("x,irradiance\n0,0\n1,0\n2,0.5\n")
    found = simulate(tmp_path / "out", "--light", str(light), "--profile", str(profile))
    # By name the same lighting, but for the interpolation's rounding.
    named = runs["static"][1]
    assert found["static_ratio"] == 1 and (found["light"], found["profile"]) == ("lamp.csv", "edge.csv")
    assert found["oracle_count"] == pytest.approx(named["oracle_count"], rel=1e-5)
    assert abs(found["mean_count"] - named["mean_count"]) < 0.01 * named["mean_count"]
    texels = table(tmp_path / "out" / "texels.csv")
    assert texels["irradiance"] == pytest.approx(np.interp(X, [0, 1, 2], [0, 0, 0.5]), rel=1e-14)
    assert found["inputs_sha256"] == {
        "light": hashlib.sha256(light.read_bytes()).hexdigest(),
        "profile": hashlib.sha256(profile.read_bytes()).hexdigest(),
    }
    # Nothing of where the files lay.
    assert str(tmp_path).encode() not in b"".join(contents(tmp_path / "out").values())


def test_a_brighter_lamp_is_compared_with_light_that_stays(runs, tmp_path):
    lamp = tmp_path / "lamp.csv"
    lamp.write_text("time,intensity\n0,2\n1,2\n")
    found = simulate(tmp_path / "out", "--light", str(lamp))
    frames = table(tmp_path / "out" / "frames.csv")
    assert (frames["intensity"] == 2).all()
    assert found["static_mean_count"] == pytest.approx(runs["static"][1]["mean_count"], rel=1e-12)
    assert found["static_ratio"] == pytest.approx(found["mean_count"] / found["static_mean_count"], rel=1e-12)
    assert found["static_ratio"] > 1.2


def test_another_profile_with_a_fixed_count(tmp_path):
    arguments = ["--profile", "pulse", "--amplitude", "0.25", "--controller", "fixed", "--spp", "20"]
    found = simulate(tmp_path, *arguments)
    assert found["mean_count"] == 20 and found["static_ratio"] == 1
    texels = table(tmp_path / "texels.csv")
    assert (texels["irradiance"] == 0.25 * ((X >= 1) & (X < 3))).all()
    # Light that is on or off: mean p and second moment times amplitude, so a variance of p (a - p).
    variance = texels["truth"] * (0.25 - texels["truth"])
    assert texels["delivered_variance"] == pytest.approx(variance / 20, rel=1e-5, abs=1e-9)
    squared, error = texels["squared_error"].mean(), variance.mean() / 20
    # Of 240 results a texel; each squared error's own deviation is at most some three times its mean here.
    assert abs(squared - error) < 5 * 3 * error / math.sqrt(240 * (variance > variance.max() / 10).sum())


def test_the_other_kernel_and_length(tmp_path):
    found = simulate(tmp_path, "--kernel", "radial", "--length", "8", "--d", "0.2", "--controller", "oracle")
    assert (found["kernel"], found["length"], found["d"]) == ("radial", 8.0, 0.2)
    texels = table(tmp_path / "texels.csv")
    assert (texels["x_mm"] == 2 * X).all()
    assert found["static_ratio"] == 1 and abs(found["mean_count"] - found["oracle_count"]) < 0.5
    # As the ramp is odd around 1.5 mm, so is the truth.
    assert texels["truth"][11] + texels["truth"][12] == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize(
    "arguments",
    [["--frames", "1"], ["--texels", "1"], ["--light", "off.csv"]],
)
def test_the_least_there_is(arguments, tmp_path, monkeypatch, capsys):
    """Nothing but the one line on the terminal, and no warning either."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "off.csv").write_text("time,intensity\n0,0\n1,0\n")
    command = ["simulate", "line", "--out", "out", "--controller", "fixed", "--frames", "2", "--texels", "4"]
    assert main([*command, "--seeds", "2", *arguments]) == 0
    printed = capsys.readouterr()
    assert printed.err == "" and printed.out.count("\n") == 1
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["mean_count"] == 16
