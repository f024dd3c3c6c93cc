"""The benchmark of whole frames on tiny sizes: rivals draw the samples that the pass draws."""

import importlib
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
CASES = [(points, distance) for points in ("table", "fresh") for distance in ("plane", "surface")]


@pytest.fixture
def load(monkeypatch):
    """Import a script of the folder; scripts import their neighbours by plain names."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


@pytest.fixture
def problems(load):
    return load("frames_problem")


#: The least arithmetic and the most; whatever the others compute is in one of them.
ENDS = [CASES[0], pytest.param(CASES[-1], marks=pytest.mark.slow)]


@pytest.fixture(params=ENDS, ids="-".join)
def problem(request, problems):
    return problems.problem(problems.scene(64, 36), *request.param, samples=24)


@pytest.mark.parametrize(
    ("name", "package"),
    [
        ("C++, OpenMP", None),
        ("plain JAX fori_loop", None),
        pytest.param("PyTorch", "torch", marks=pytest.mark.slow),
        pytest.param("Dr.Jit, LLVM", "drjit", marks=pytest.mark.slow),
        pytest.param("Numba", "numba", marks=pytest.mark.slow),
    ],
)
def test_rivals_draw_our_samples(load, problems, problem, name, package):
    if package:
        pytest.importorskip(
            package, reason=f"{package} is not installed: pip install sssfit[bench,bench-rivals]"
        )
    module = load("frames")
    try:
        program = module.RIVALS[name](problems.given(problem))
    except module.Missing as error:
        pytest.skip(str(error))
    # Raises where they differ by more than rounding explains.
    share = problems.check(problem, name, np.asarray(program()), np.asarray(problems.ours(problem)))
    assert share < 0.02


def test_programs_that_draw_something_else_are_not_timed(problems):
    problem = problems.problem(problems.scene(64, 36), "table", "plane", samples=24)
    ours = np.asarray(problems.ours(problem))
    found = ours[problem.mask]
    assert problems.check(problem, "a", found, ours) == 0
    with pytest.raises(RuntimeError, match="a draws something else: .* of its pixels differ"):
        problems.check(problem, "a", found * np.float32(1.01), ours)
    with pytest.raises(RuntimeError, match="a draws something else: its mean is off"):
        problems.check(problem, "a", found * np.float32(1 + 1e-5), ours)


def test_the_controllers_counts_have_the_mean_asked_for(load):
    module = load("frames_counts")
    mask = np.zeros((40, 50), bool)
    mask[5:, 10:] = True
    variance = np.random.default_rng(0).lognormal(-3, 1.5, mask.shape)
    for ratio in (0.15, 0.25, 0.5):
        counts = module.controlled(variance, mask, ratio, 64)
        assert np.all(counts[~mask] == 0) and np.all((counts[mask] >= 8) & (counts[mask] <= 64))
        # One pixel more or less is the least that a target can change.
        assert counts[mask].mean() == pytest.approx(64 * ratio, abs=0.1)
        assert np.all(np.diff(counts[mask][np.argsort(variance[mask])]) >= 0)


def test_a_block_draws_its_largest_count(load):
    counts = np.zeros((300, 20), int)
    counts[0, 3], counts[1, 17], counts[299, 0] = 5, 7, 2
    assert load("frames_counts").drawn(counts) == 4096 * (7 + 2)


def test_the_line_through_times_is_least_squares(load):
    module = load("frames_counts")
    samples = {name: x for name, x in zip("abc", (0, 1, 2), strict=True)}
    seconds = {name: np.array([y, y, 9.0]) for name, y in zip("abc", (1.0, 2.0, 4.0), strict=True)}
    line = module.Maps(samples, samples, seconds).line(samples)
    # By hand: slope 3 / 2, start 7 / 3 - 3 / 2, squares left 1 / 6 of 14 / 3.
    assert line == pytest.approx((5 / 6, 1.5, 1 - 1 / 28))


@pytest.mark.slow
def test_frames(load, tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text((BENCHMARKS.parent / "docs" / "benchmarks.md").read_text())
    sizes = ["--width", "64", "--height", "36", "--samples", "16", "--repeats", "1", "--tiles", "2"]
    files = ["--page", str(page), "--plot", str(tmp_path / "time.png")]
    module = load("frames")
    results = module.main([*sizes, "--rivals", "C++, OpenMP", "plain JAX fori_loop", *files])
    printed, written = capsys.readouterr().out, page.read_text()
    assert set(results) == set(module.PARTS)
    assert all(text in written for text in printed.splitlines())
    assert len(results["rivals"]) == 8
    for distance in ("plane", "surface"):
        for row, wanted in zip(results["adaptive"][distance], (0.5, 0.5, 0.5), strict=True):
            # Of 16 samples 8 are the least.
            assert row.ratio == pytest.approx(wanted, abs=0.02) and row.allowed == pytest.approx(
                1.3 * row.ratio + 0.05
            )
    assert len(results["maps"].seconds) == 14
    assert results["memory"]["128 x 72"].passed >= results["memory"]["128 x 72"].idle > 50
    assert (tmp_path / "time.png").stat().st_size > 20_000
