"""`sssfit simulate circle`: every controller, start, sequence and light, and Burley's profile."""

import csv
import json
import math

import numpy as np
import pytest

from sssfit.cli.main import main
from sssfit.estimators import policies
from sssfit.scenarios import driver

# Each simulation is a program to compile, and many seeds.
pytestmark = pytest.mark.slow

#: Few frames and seeds, of one shape.
SMALL = ["--frames", "60", "--seeds", "40"]
VARIANCE = 4 / math.pi - 1
#: Those that are compared start alike, with independent points.
TURNS = {
    **dict.fromkeys(("spvg", "as", "ccv", "in_frame"), ("cold", "iid")),
    **dict.fromkeys(("fixed", "oracle"), ("disocclusion", "iid")),
    "ocv": ("disocclusion", "r2"),
    "unreal": ("cold", "r2"),
}


def simulate(out, *arguments):
    """The summary of a run."""
    assert main(["simulate", "circle", "--out", str(out), *SMALL, *arguments]) == 0
    return json.loads((out / "summary.json").read_text())


def frames(out):
    with open(out / "frames.csv", newline="") as stream:
        header, *rows = csv.reader(stream)
    return dict(zip(header, np.array(rows, float).T, strict=True))


@pytest.fixture(scope="module")
def every(tmp_path_factory):
    """Summaries and frames of all controllers, by name; starts and sequences take turns."""
    found = {}
    for name, (start, sequence) in TURNS.items():
        out = tmp_path_factory.mktemp(name)
        summary = simulate(out, "--controller", name, "--start", start, "--sequence", sequence)
        assert (summary["controller"], summary["start"], summary["sequence"]) == (name, start, sequence)
        found[name] = summary, frames(out)
    return found


def test_every_controller_start_and_sequence(every):
    assert set(every) == set(policies.NAMES)
    assert set(TURNS.values()) == {(start, points) for start in driver.STARTS for points in driver.SEQUENCES}
    for name, (summary, by_frame) in every.items():
        assert 8 <= summary["steady_mean_count"] <= 64 and len(by_frame["frame"]) == 60
        assert by_frame["mean_count"][50:].mean() == pytest.approx(summary["steady_mean_count"], rel=1e-12)
        # Unbiased whatever the count, since it does not look at its own frame: within five errors.
        results = by_frame["mean_result"][50:]
        error = math.sqrt(summary["delivered_variance_over_target"] * 0.0064 / 40 / 10)
        assert abs(results.mean() - 1) < 5 * error, name


def test_the_two_papers_adaptive_sampling_is_the_same(every):
    (first, by_frame), (second, other) = every["spvg"], every["as"]
    assert first | {"controller": "as"} == second
    assert all((by_frame[name] == other[name]).all() for name in by_frame)


def test_a_control_changes_nothing_under_light_that_stays(every):
    """The same number taken from every result moves no deviation; what was drawn at the start differs."""
    (constant, _), (adaptive, _) = every["ccv"], every["as"]
    error = math.hypot(constant["steady_mean_count_se"], adaptive["steady_mean_count_se"])
    assert abs(constant["steady_mean_count"] - adaptive["steady_mean_count"]) < 4 * error


def test_a_fixed_count_is_exact(every):
    summary, by_frame = every["fixed"]
    assert summary["steady_mean_count"] == 16 and summary["steady_mean_count_se"] == 0
    assert summary["count_quantiles"] == {"q05": 16, "q50": 16, "q95": 16}
    assert (by_frame["mean_count"] == 16).all() and summary["regret"] == pytest.approx(1, rel=1e-9)
    assert by_frame["delivered_variance"] == pytest.approx(np.full(60, VARIANCE / 16), rel=1e-7)


def test_the_oracle_rounds(every):
    summary, by_frame = every["oracle"]
    assert (by_frame["mean_count"] == 43).all() and summary["steady_mean_count"] == 43
    assert by_frame["oracle_count"] == pytest.approx(np.full(60, VARIANCE / 0.0064), rel=1e-7)


def test_unreal_draws_the_fewest(every):
    # Its variance over the target is some 5 of 8 samples' result: above 8.5 in a few frames alone.
    assert every["unreal"][0]["steady_mean_count"] < 9


def test_in_frame_is_nearer_to_the_oracle_than_adaptive_sampling(every):
    (in_frame, _), (adaptive, _), oracle = every["in_frame"], every["as"], VARIANCE / 0.0064
    assert abs(in_frame["steady_mean_count"] - oracle) < abs(adaptive["steady_mean_count"] - oracle)
    assert in_frame["regret_q95"] < adaptive["regret_q95"]


@pytest.mark.parametrize(
    "arguments, intensity",
    [
        (["--light", "sine"], lambda t: 1 + 0.5 * np.sin(2 * math.pi * t)),
        (["--light", "sine", "--frequency", "3", "--depth", "1"], lambda t: 1 + np.sin(6 * math.pi * t)),
        (["--light", "on_off", "--fps", "30", "--depth", "0.25"], lambda t: 1 - 0.25 * (2 * t % 2 >= 1)),
        # The file begins anew one mean step, 1.5 s, after its last row.
        (
            ["--light", "lamp.csv", "--fps", "10"],
            lambda t: np.interp(t % 4.5, [0, 1, 3, 4.5], [1, 0.5, 2, 1]),
        ),
    ],
)
def test_lights(arguments, intensity, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.csv").write_text("time,intensity\n0,1\n1,0.5\n3,2\n")
    found = simulate(tmp_path / "out", "--controller", "fixed", "--start", "disocclusion", *arguments)
    assert found["light"] == arguments[1]
    by_frame, expected = frames(tmp_path / "out"), intensity(np.arange(60) / found["fps"])
    assert by_frame["truth"] == pytest.approx(expected, rel=1e-6, abs=1e-7)
    ideal = np.clip(VARIANCE * expected**2 / 0.0064, 8, 64)
    assert by_frame["oracle_count"] == pytest.approx(ideal, rel=1e-6)


def test_burleys_profile(tmp_path):
    arguments = ["--profile", "burley", "--distance", "0.5", "--radius", "1", "--d", "1"]
    found = simulate(tmp_path, "--controller", "fixed", "--spp", "32", *arguments)
    # The profile's mean over the disc, by quadratures in 30 digits.
    probability = math.pi * 0.109012682757930438
    variance = (4 / math.pi) ** 2 * probability * (1 - probability)
    assert found["oracle_count"] == pytest.approx(variance / 0.0064, rel=1e-6)
    by_frame = frames(tmp_path)
    assert by_frame["truth"] == pytest.approx(np.full(60, 4 / math.pi * probability), rel=1e-6)
    error = math.sqrt(variance / 32 / 40 / 60)
    assert abs(by_frame["mean_result"].mean() - 4 / math.pi * probability) < 4.5 * error
    allowed = 4.5 * found["delivered_variance_over_target_se"]
    assert abs(found["delivered_variance_over_target"] - variance / 32 / 0.0064) < allowed
