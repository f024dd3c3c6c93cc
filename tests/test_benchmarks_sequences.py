"""The benchmark of sequences on tiny sizes."""

import importlib
from pathlib import Path

import jax
import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def load(monkeypatch):
    """Import a script of the folder; scripts import their neighbours by plain names."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


@pytest.mark.slow
def test_sequences(load, tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text((BENCHMARKS.parent / "docs" / "benchmarks.md").read_text())
    module = load("sequences")
    sizes = ["--width", "64", "--height", "36", "--repeats", "1", "--frames", "2", "--targets", "1e-2"]
    results = module.main([*sizes, "--page", str(page)])
    printed, written = capsys.readouterr().out, page.read_text()
    assert set(results) == set(module.PARTS)
    assert all(text in written for text in printed.splitlines())
    assert len(results["steps"]) == 2 * len(module.NAMES)
    assert all(np.all(ratio > 0) for ratio in results["steps"].values())
    assert list(results["memory"]) == [1, 8, 24] and min(results["memory"].values()) > 50


@pytest.mark.slow
@pytest.mark.parametrize("name", ["as", "ocv", "in_frame"])
def test_what_is_timed_is_what_a_step_does(load, name):
    module, problems = load("sequences"), load("frames_problem")
    scene = problems.scene(64, 36)
    still, moving = (module.case(scene, name, 1e-2, is_moving) for is_moving in (False, True))
    # A part of a pixel changes no lookup.
    assert still.mean_count == moving.mean_count and still.moved == moving.moved
    pixels = scene.frame.depth.size
    # Memory read and written, counts, values and missing; the light, or the variance of a sample too. What is
    # not known of the pixels is a number.
    leaves, more, numbers = {"as": (3, 0, 3), "ocv": (8, 4, 2), "in_frame": (8, 8, 2)}[name]
    assert still.moved == pixels * (8 * leaves + 9 + more) + 4 * numbers
    for program in still.programs.values():
        jax.block_until_ready(program())
    # Step after step draws what the pass draws.
    first, second = (np.asarray(still.programs["step"]()) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    mask = np.asarray(scene.frame.profile_id) == scene.ids[0]
    assert first[mask].mean() == still.mean_count
