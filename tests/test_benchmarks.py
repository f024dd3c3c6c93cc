"""The benchmark scripts on tiny sizes, so that they keep running."""

import csv
import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from sssfit.sampling import inverse_cdf as methods

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def load(monkeypatch):
    """Import a script of the folder; scripts import their neighbours by plain names."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_programs_take_turns_in_changing_order(load):
    calls = []
    programs = {name: lambda name=name: calls.append(name) for name in "abcd"}
    times = load("interleaved").measure(programs, repeats=5)
    rounds = ["".join(calls[i : i + 4]) for i in range(0, 24, 4)]
    assert [sorted(r) for r in rounds] == [list("abcd")] * 6
    assert rounds[0] == "abcd" and len(set(rounds)) > 2
    assert all(t.shape == (5,) and np.all(t >= 0) for t in times.values())


def test_the_machine_is_described(load):
    pattern = r".+, \d+ cores; Python 3.+, numpy \d.+; \d{4}-\d\d-\d\d, commit \w+"
    interleaved = load("interleaved")
    assert re.fullmatch(pattern, interleaved.machine())
    assert re.fullmatch(r"others used \d+% of .*|use of .* unknown", interleaved.Neighbours().describe())


@pytest.fixture
def page(tmp_path):
    """A copy of the page that the scripts write their results to."""
    copy = tmp_path / "page.md"
    copy.write_text((BENCHMARKS.parent / "docs" / "benchmarks.md").read_text())
    return copy


def test_samplers(load, tmp_path, page, capsys):
    sizes = ["--samples", "10000", "--repeats", "1", "--grid", "65536"]
    files = ["--csv", str(tmp_path / "methods.csv"), "--plot", str(tmp_path / "front.png")]
    files += ["--page", str(page)]
    rows = load("inverse_cdf").main([*sizes, *files, "--libraries", "sssfit", "NumPy", "SciPy"])
    errors = {row.name: row.errors for row in rows}
    assert set(methods.METHODS) | {"xie, c = 2.6", "NumPy closed form", "SciPy spline"} <= set(errors)
    assert errors["xie"].cdf_max == pytest.approx(0.0099, abs=1e-4)
    assert errors["xie"].bias_percent == pytest.approx(-1.0, abs=0.1)
    for name in ("exact", "closed_form", "log_poly12", "NumPy closed form"):
        assert errors[name].radius_max < 5e-6 and errors[name].cdf_max < 5e-7
    # What is left is the coarse grid's: it begins at 0 and ends a step before 1.
    bias = {name: e.weighted_bias_percent for name, e in errors.items()}
    assert bias == pytest.approx(dict.fromkeys(bias, 100 / 65536 / 2 / 0.3125), abs=3e-3)
    printed, written = capsys.readouterr().out, page.read_text()
    assert printed in written and all(f"| {name} |" in printed for name in errors)
    with (tmp_path / "methods.csv").open() as file:
        written = {row["sampler"]: float(row["cdf_max"]) for row in csv.DictReader(file)}
    assert written == pytest.approx({name: e.cdf_max for name, e in errors.items()}, rel=1e-5)
    assert (tmp_path / "front.png").stat().st_size > 20_000


def test_the_front_ignores_what_noise_could_explain(load):
    module = load("inverse_cdf")

    def row(name, median, spread, error):
        time = module.Timing(median - spread / 2, median, median + spread / 2)
        return module.Row(name, "", time, module.Errors(error, 0, error, error, 0, 0, 1))

    rows = module.with_fronts(
        [row("fast", 1.0, 0.1, 1e-2), row("near", 1.05, 0.1, 2e-2), row("exact", 3.0, 0.1, 1e-7)]
        + [row("slow", 2.0, 0.1, 1e-2), row("noisy", 2.0, 1.5, 1e-2), row("rounding", 4.0, 0.1, 0.95e-7)]
    )
    assert [r.name for r in rows if r.front_cdf and r.front_radius] == ["fast", "near", "exact", "noisy"]


def test_numba_samplers(load):
    pytest.importorskip("numba", reason="Numba is not installed: pip install sssfit[bench]")
    samplers, kept = load("samplers"), float(load("numba_samplers").KEPT)
    xi = np.linspace(0, 0.99, 1000, dtype=np.float32)
    exact = samplers.exact_radius(xi.astype(np.float64))
    truncated = samplers.exact_radius(kept * xi.astype(np.float64))
    # The published Newton iteration stops once the cdf is off by 1e-6, which the density turns into radii.
    expected = {"closed form": (exact, 2e-6), "Halley": (exact, 2e-6), "g": (methods.xie(xi, 1.0), 3e-6)}
    expected["Newton to 16 d"] = (truncated, 1e-6 / samplers.density(truncated.max()))
    compiled = [s for s in samplers.everything() if s.library == "Numba"]
    assert {s.name.removeprefix("Numba ") for s in compiled} == set(expected)
    for sampler in compiled:
        radius, (wanted, tolerance) = sampler.prepare(xi)(), expected[sampler.name.removeprefix("Numba ")]
        assert radius.dtype == np.float32
        np.testing.assert_allclose(radius, wanted, rtol=0, atol=tolerance, err_msg=sampler.name)


def test_fits(load, page):
    sizes = ["--falloffs", "16", "--loop-falloffs", "4", "--repeats", "1"]
    results = load("fits").main([*sizes, "--page", str(page)])
    assert set(results) == {"as_coded", "radial"}
    for solvers in results.values():
        reference = solvers["fit_many"].parameters
        assert reference.shape == (4, 2)
        for name, result in solvers.items():
            np.testing.assert_allclose(result.parameters, reference, rtol=5e-5, err_msg=name)
            assert np.all(result.seconds > 0)
    assert page.read_text().count("| SciPy trf, analytic Jacobian |") == 2
    assert page.read_text().count(", 16 fits: first call") == 2
