"""`sssfit simulate circle`: what it writes, and its figures against simulations by binomial numbers."""

import csv
import hashlib
import json
import math
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from sssfit.cli.main import main, parser

SEEDS = 400
FILES = {"summary.json", "simulation.png", "simulation.npz", "frames.csv"}


def contents(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


def simulate(out, *arguments, seeds=SEEDS):
    """The summary of a run."""
    assert main(["simulate", "circle", "--out", str(out), "--seeds", str(seeds), *arguments]) == 0
    return json.loads((out / "summary.json").read_text())


def frames(out):
    with open(out / "frames.csv", newline="") as stream:
        header, *rows = csv.reader(stream)
    return dict(zip(header, np.array(rows, float).T, strict=True))


@pytest.fixture(scope="module")
def default(tmp_path_factory):
    """A run with the defaults, but for the seeds."""
    out = tmp_path_factory.mktemp("default") / "out"
    return out, simulate(out)


def by_binomials(kappa, start="cold", *, seeds=4000, target=0.0064, alpha=0.2, unreal=False):
    """Steady figures of 100 frames after 50, each with its standard error, and mean counts of all frames.

    The hits of n points in the circle are a binomial number; counts and variances after the 2021 paper's
    Algorithm 1 in float64.
    """
    random = np.random.default_rng(11)
    mean, variance, mean_count = np.zeros((3, seeds))
    counts, results, means, believed = np.zeros((4, 150, seeds))
    for frame in range(150):
        ratio = variance / target
        ideal = kappa * (ratio - 1) * mean_count * (2 / alpha - 2) + ratio * mean_count
        counts[frame] = count = np.round(np.clip(ratio if unreal else ideal, 8, 64))
        results[frame] = result = 4 / math.pi * random.binomial(count.astype(int), math.pi / 4) / count
        if frame == 0 and start == "disocclusion":
            mean, variance, mean_count = result, np.full(seeds, target), count
        else:
            variance = (1 - alpha) * (variance + alpha * (result - mean) ** 2)
            mean, mean_count = mean + alpha * (result - mean), mean_count + alpha * (count - mean_count)
        means[frame], believed[frame] = mean, variance
    steady = {
        "steady_mean_count": counts,
        "delivered_variance_over_target": (results - 1) ** 2 / target,
        "variance_of_moving_mean_over_target": (means - 1) ** 2 / target,
        "believed_variance_over_target": believed / target,
        "share_at_min": counts == 8,
        "share_at_max": counts == 64,
    }
    by_seed = {name: values[50:].mean(axis=0) for name, values in steady.items()}
    errors = {name: (v.mean(), v.std(ddof=1) / math.sqrt(seeds)) for name, v in by_seed.items()}
    return errors, counts.mean(axis=1), counts.std(axis=1)


def test_files_summary_and_picture(default):
    out, summary = default
    written = contents(out)
    assert set(written) == FILES | {"manifest.json"}
    manifest = json.loads(written["manifest.json"])
    assert {name: entry["sha256"] for name, entry in manifest["files"].items()} == {
        name: hashlib.sha256(written[name]).hexdigest() for name in FILES
    }
    asked = {"controller": "spvg", "kappa": 0.2, "target_variance": 0.0064, "start": "cold", "frames": 150}
    assert (
        asked | {"seeds": SEEDS, "light": "static", "sequence": "iid", "seed": 0}
    ).items() <= summary.items()
    # Exact but for the world's float32.
    assert summary["oracle_count"] == pytest.approx((4 / math.pi - 1) / 0.0064, rel=1e-7)
    with Image.open(out / "simulation.png") as picture:
        assert picture.size == (1155, 726)


def test_the_manifest_tells_every_option(default):
    options = json.loads((default[0] / "manifest.json").read_text())["options"]
    given = vars(parser().parse_args(["simulate", "circle", "--out", "x", "--seeds", str(SEEDS)]))
    # How to run it again: all but where to, how loud, and the function itself; no file was read.
    expected = {name: given[name] for name in set(given) - {"out", "quiet", "run"}}
    assert expected | {"inputs_sha256": {}} == options


# Mean counts of 20000 seeds from frame 51 to 150, their errors, and Var(mu) / target.
PUBLISHED = {("0", "cold"): (42.633, 0.030, 0.1352), ("1", "disocclusion"): (49.650, 0.021, 0.1866)}


@pytest.mark.parametrize("kappa, start", [("0.2", "cold"), *PUBLISHED])
def test_figures_against_binomials(kappa, start, default, tmp_path):
    out, found = default
    if (kappa, start) != ("0.2", "cold"):
        out = tmp_path / "out"
        found = simulate(out, "--kappa", kappa, "--start", start)
    expected, mean_counts, spreads = by_binomials(float(kappa), start)
    for name, (value, error) in expected.items():
        # Ours has a tenth of the seeds.
        allowed = 4.5 * error * math.sqrt(1 + 4000 / SEEDS)
        assert abs(found[name] - value) < allowed, name
    assert found["steady_mean_count_se"] == pytest.approx(
        expected["steady_mean_count"][1] * math.sqrt(4000 / SEEDS), rel=0.15
    )
    # 150 frames, two-sided: 4.5 errors happen by chance once in a thousand runs.
    apart = np.abs(frames(out)["mean_count"] - mean_counts)
    assert (apart <= 4.5 * spreads * math.sqrt(1 / SEEDS + 1 / 4000)).all()
    if (kappa, start) in PUBLISHED:
        count, error, of_mean = PUBLISHED[kappa, start]
        assert abs(found["steady_mean_count"] - count) < 4 * math.hypot(error, found["steady_mean_count_se"])
        spread = expected["variance_of_moving_mean_over_target"][1] * math.sqrt(4000 / SEEDS)
        assert abs(found["variance_of_moving_mean_over_target"] - of_mean) < 5e-5 + 4.5 * spread


def test_points_of_low_discrepancy(tmp_path):
    found = simulate(tmp_path, "--kappa", "0", "--sequence", "r2")
    # 13.5 to 14.3, continued or from a random start.
    allowed = 4 * found["steady_mean_count_se"]
    assert 13.5 - allowed < found["steady_mean_count"] < 14.3 + allowed


def test_the_same_command_gives_the_same_bytes(default, tmp_path):
    simulate(tmp_path)
    assert contents(default[0]) == contents(tmp_path)


@pytest.mark.slow
def test_another_process_gives_the_same_bytes(default, tmp_path):
    command = [
        sys.executable,
        "-m",
        "sssfit.cli",
        "simulate",
        "circle",
        "--seeds",
        str(SEEDS),
        "--out",
        "out",
    ]
    other = {"PYTHONHASHSEED": "12", "TZ": "Asia/Kolkata", "LC_ALL": "C", "COLUMNS": "40"}
    subprocess.run(command, cwd=tmp_path, env=os.environ | other, check=True, capture_output=True)
    assert contents(default[0]) == contents(tmp_path / "out")


def test_another_seed_gives_other_numbers(default, tmp_path):
    found = simulate(tmp_path, "--seed", "1")
    assert found["steady_mean_count"] != default[1]["steady_mean_count"]
    error = math.hypot(found["steady_mean_count_se"], default[1]["steady_mean_count_se"])
    assert abs(found["steady_mean_count"] - default[1]["steady_mean_count"]) < 4 * error


def test_what_is_printed(tmp_path, capsys):
    found = simulate(tmp_path, "--quiet")
    printed = capsys.readouterr()
    assert printed.err == "" and printed.out.endswith(f"see {tmp_path / 'simulation.png'}\n")
    numbers = [float(n) for n in re.findall(r"\d+\.\d+", printed.out.split(":")[0])]
    names = ("steady_mean_count", "steady_mean_count_se", "oracle_count", "delivered_variance_over_target")
    assert numbers == [round(found[name], 3) for name in names]


def test_examples_of_the_help_are_understood(capsys):
    for command in (["simulate", "circle"], ["simulate", "line"], ["simulate", "batch-mean"]):
        with pytest.raises(SystemExit) as stopped:
            main([*command, "--help"])
        examples = re.findall(r"^  sssfit (.*)$", capsys.readouterr().out, re.MULTILINE)
        assert stopped.value.code == 0 and examples
        for example in examples:
            assert callable(parser().parse_args(example.split()).run)
