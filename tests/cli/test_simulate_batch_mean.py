"""`sssfit simulate batch-mean`: Table B.1 against another simulation of it."""

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

NAMES = ["Res_f", "SF", "SF+EMA", "EMCM", "EMCM_hat", "GT"]
LIGHTS = ("static", "dynamic")
SEEDS = 60
FILES = {"summary.json", "simulation.png", "simulation.npz", "table.csv", "frames.csv"}
#: Of 4000 seeds in NumPy: mean and deviation, or the median where tails are heavy.
INDEPENDENT = {
    "static": {"Res_f": (0.03211, 0.00257), "SF": (0.01561, 0.00142), "SF+EMA": (0.00590, 0.00047)},
    "dynamic": {"Res_f": (0.57616, 0.00503), "SF": (0.37636, 0.00221), "SF+EMA": (0.37435, 0.00242)},
}
INDEPENDENT["static"]["GT"], INDEPENDENT["dynamic"]["GT"] = (0.00569, 0.00045), (0.13408, 0.0125)
MEDIANS = {"static": {"EMCM": 0.00694, "EMCM_hat": 0.0327}, "dynamic": {"EMCM": 0.1380, "EMCM_hat": 0.0778}}


def contents(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


def simulate(out, seeds=SEEDS):
    return main(["simulate", "batch-mean", "--out", str(out), "--seeds", str(seeds)])


def rows(path):
    with open(path, newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("batch_mean") / "out"
    assert simulate(out) == 0
    return out, json.loads((out / "summary.json").read_text())


def test_files_and_picture(run):
    out, summary = run
    written = contents(out)
    assert set(written) == FILES | {"manifest.json"}
    manifest = json.loads(written["manifest.json"])
    assert {name: entry["sha256"] for name, entry in manifest["files"].items()} == {
        name: hashlib.sha256(written[name]).hexdigest() for name in FILES
    }
    assert manifest["options"] == {"seeds": SEEDS, "seed": 0} and summary["seeds"] == SEEDS
    with Image.open(out / "simulation.png") as picture:
        assert picture.size == (1595, 836)


@pytest.mark.parametrize("light", LIGHTS)
def test_the_table(light, run):
    entries = run[1][light]
    assert [entry["name"] for entry in entries] == NAMES
    for entry in entries:
        assert {"name", "mean", "median", "sd"} <= set(entry)
        assert 0 < entry["low"] <= entry["median"] <= entry["high"] and entry["sd"] > 0
        if entry["name"] in INDEPENDENT[light]:
            mean, deviation = INDEPENDENT[light][entry["name"]]
            assert abs(entry["mean"] - mean) < 0.5e-5 + 4 * deviation * math.sqrt(1 / SEEDS + 1 / 4000)
            # A deviation of n normal numbers errs by 1 / sqrt(2 n).
            assert entry["sd"] == pytest.approx(deviation, rel=4 / math.sqrt(2 * SEEDS))
        else:
            # A median's error, from the quartiles of a normal middle.
            error = 1.2533 * entry["interquartile"] / 1.349 / math.sqrt(SEEDS)
            assert abs(entry["median"] - MEDIANS[light][entry["name"]]) < 4 * error


def test_tables_and_arrays(run):
    out, summary = run
    listed = rows(out / "table.csv")
    assert [(row["light"], row["name"]) for row in listed] == [
        (light, name) for light in LIGHTS for name in NAMES
    ]
    for row in listed:
        entry = summary[row["light"]][NAMES.index(row["name"])]
        assert {name: float(row[name]) for name in ("mean", "median", "sd")}.items() <= entry.items()
    streams = rows(out / "frames.csv")
    assert [int(row["frame"]) for row in streams] == list(range(1, 101))
    with np.load(out / "simulation.npz") as archive:
        for name in ("static_error_SF", "dynamic_coefficient_EMCM", "dynamic_residual_GT"):
            column = np.array([float(row[name]) for row in streams])
            assert np.array_equal(column, archive[name].astype(float), equal_nan=True)
        # One seed's moving mean error is what the table is made of.
        error = archive["static_error_Res_f"][24:].mean()
    mean, deviation = INDEPENDENT["static"]["Res_f"]
    assert abs(error - mean) < 4 * deviation


def test_the_same_command_gives_the_same_bytes(run, tmp_path):
    assert simulate(tmp_path) == 0
    assert contents(run[0]) == contents(tmp_path)


def test_what_is_printed(run, tmp_path, capsys):
    assert simulate(tmp_path) == 0
    printed = capsys.readouterr()
    static, dynamic, last = printed.out.splitlines()
    assert printed.err == "" and last == f"see {tmp_path / 'simulation.png'}"
    for light, line in zip(LIGHTS, (static, dynamic), strict=True):
        medians = ", ".join(f"{entry['name']} {entry['median']:.4f}" for entry in run[1][light])
        assert line == f"{light}, medians: {medians}"


@pytest.mark.parametrize("seeds", [1, 0, -3])
def test_too_few_seeds(seeds, run, capsys):
    before = contents(run[0])
    capsys.readouterr()
    assert simulate(run[0], seeds) == 2
    printed = capsys.readouterr()
    assert printed.err == f"sssfit: seeds must be at least 2, got {seeds}; one has no spread\n"
    assert printed.out == "" and contents(run[0]) == before
