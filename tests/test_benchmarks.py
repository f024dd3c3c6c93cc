"""The benchmark scripts on tiny sizes, so that they keep running."""

import csv
import importlib
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.estimators import in_frame, sample_count
from sssfit.sampling import inverse_cdf as methods
from sssfit.scenarios import circle, line

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def load(monkeypatch):
    """Import a script of the folder; scripts import their neighbours by plain names."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


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


@pytest.mark.slow
def test_profiles(load, page):
    sizes = ["--number", "16", "--few", "4", "--repeats", "1", "--steps", "20"]
    results = load("profiles").main([*sizes, "--page", str(page)])
    reference = results["measured_many"].parameters
    assert reference.shape == (16, 2)
    for name, result in results.items():
        np.testing.assert_allclose(
            result.parameters, reference[: len(result.parameters)], rtol=1e-4, err_msg=name
        )
        assert np.all(result.seconds > 0)
    assert page.read_text().count("16 curves of 48 points: first call") == 1


def some_frames(module):
    """A frame of each kind: state alone, vectors, counts, and results besides the state."""
    kinds = [("`ema`, 3 channels", "float32, a weight each"), ("`emcm`, 2 channels", "float16, one weight")]
    kinds += [("`sample_count`", "float32"), ("`control_variate`, count given", "float32")]
    frames = {(frame.name, frame.history): frame for frame in module.frames(64, 48)}
    return [frames[kind] for kind in kinds]


@pytest.mark.slow
def test_frames_are_updated_in_turns_and_in_place(load):
    module = load("moving_frames")
    for frame in some_frames(module):
        update = jax.jit(frame.update)
        expected = update(frame.state, *frame.inputs)
        for _ in range(3):
            expected = update(expected[0], *frame.inputs)
        # Compiled another way, each of the four updates may round its products and sums the other way.
        tolerance = 16 * float(jnp.finfo(jax.tree.leaves(frame.state)[0].dtype).eps)
        for mode in module.MODES:
            stepper = module.Stepper(frame, mode)
            for _ in range(3):
                stepper()
            for found, wanted in zip(jax.tree.leaves(stepper.last), jax.tree.leaves(expected), strict=True):
                assert found.dtype == wanted.dtype
                np.testing.assert_allclose(found, wanted, tolerance, tolerance, err_msg=frame.name)


def test_a_copy_uses_all_that_it_reads(load):
    module = load("moving_frames")

    def total(tree):
        return sum(np.sum(np.asarray(leaf), dtype=np.float64) for leaf in jax.tree.leaves(tree))

    for frame in some_frames(module):
        copy = module.copy_of(frame)
        # Small whole numbers, which no dtype rounds.
        state = jax.tree.map(lambda leaf: leaf + 1 if leaf.dtype != bool else ~leaf, copy.state)
        inputs = [jnp.ceil(array).astype(array.dtype) for array in copy.inputs]
        found = copy.update(state, *inputs)
        assert total(found) == total((state, inputs[1:]))
        shapes = jax.eval_shape(frame.update, frame.state, *frame.inputs)
        sizes = [[(leaf.size, leaf.dtype) for leaf in jax.tree.leaves(tree)] for tree in (found, shapes)]
        assert sizes[0] == sizes[1]


@pytest.mark.slow
def test_moving_frames(load, page, monkeypatch):
    frames = load("moving_frames")
    chosen = some_frames(frames)
    monkeypatch.setattr(frames, "frames", lambda width, height: chosen)
    sizes = ["--width", "64", "--height", "48", "--repeats", "1"]
    rows = load("moving").main(["--parts", "frames", *sizes, "--page", str(page)])["frames"]
    # By hand: mean, debias and started of three channels, with their samples; and so on.
    expected = {"`ema`, 3 channels": (3 * (4 + 4 + 1) + 12, 27), "`emcm`, 2 channels": (5 * 2 + 8, 10)}
    expected |= {"`sample_count`": (12 + 4 + 4, 12), "`control_variate`, count given": (28 + 12 + 4, 28 + 12)}
    for row in rows:
        # One weight for all is five bytes in a whole frame.
        assert (row.read, row.written) == pytest.approx(expected[row.frame.name], abs=0.01)
        assert row.accessed["copy in turns"] == pytest.approx(row.read + row.written, abs=0.4)
        assert row.accessed["update in place"] >= row.accessed["copy in place"] - 0.4
        assert all(times.shape == (1,) and times > 0 for times in row.seconds.values())
    assert "| `sample_count` | float32 | 20 + 12 |" in page.read_text()


@pytest.mark.slow
def test_moving_streams(load, page):
    pytest.importorskip("pandas", reason="pandas is not installed: pip install sssfit[bench]")
    pytest.importorskip("river", reason="river is not installed: pip install sssfit[bench]")
    sizes = ["--streams", "8", "--few-streams", "3", "--steps", "20", "--repeats", "1"]
    rows = load("moving").main(["--parts", "streams", *sizes, "--page", str(page)])["streams"]
    assert {"sssfit, last only", "pandas, a frame per stream", "river"} <= {row.name for row in rows}
    for row in rows:
        assert row.streams == (3 if row.name.startswith(("pandas", "river")) else 8)
        # Twice the bound of `emv`, 8 T eps times a mean square: no sample here is beyond four deviations.
        assert row.difference < 2 * 8 * 20 * 1.2e-7 * 4**2
    assert page.read_text().count("| river | 3 |") == 1


@pytest.mark.slow
def test_moving_lengths(load, page, tmp_path, monkeypatch):
    module = load("moving")
    monkeypatch.setattr(module, "STREAMS", dict.fromkeys((1, 16), "black"))
    files = ["--page", str(page), "--plot", str(tmp_path / "crossover.png")]
    rows = module.main(["--parts", "lengths", "--longest", "16", "--repeats", "1", *files])["lengths"]
    assert [(row.statistic, row.streams, row.samples) for row in rows] == [
        (statistic, streams, 16) for statistic in ("emv", "emcm") for streams in (1, 16)
    ]
    assert "| `emcm` | 16 | 16 |" in page.read_text()
    assert (tmp_path / "crossover.png").stat().st_size > 20_000


def test_where_associative_is_faster_is_interpolated(load):
    module = load("moving")

    def found(*ratios):
        seconds = [{"scan": np.ones(3), "associative": np.array([0.1, ratio, 9])} for ratio in ratios]
        rows = [module.Row("emv", 1, 16 * 8**i, times, {}) for i, times in enumerate(seconds)]
        return module.faster(rows)

    assert found(3, 2, 1.5) == []
    assert found(0.5, 0.2) == [(16, np.inf)]
    # The ratio falls from 2 to 1/2 over a factor of 8 in length, and is 1 in the middle.
    assert found(3, 2, 0.5) == [(pytest.approx(128 * 8**0.5), np.inf)]
    assert found(0.5, 2, 0.5, 2)[0] == (16, pytest.approx(16 * 8**0.5))
    assert found(4, 2, 1, 0.5)[0][0] == pytest.approx(1024)
    assert module.described(found(0.5, 2, 0.5)) == "16 to 45, from 360 on"
    assert module.described([]) == "nowhere"


@pytest.fixture
def rivals(load):
    return load("scenarios_rivals")


def some_pixels(bounds):
    """Numbers that pixels may remember, within bounds, and draw; the last pixel has seen nothing."""
    numbers = np.random.default_rng(0)
    shares = numbers.uniform(0, 1, (len(bounds), 500)) ** 2
    memory = [np.append(low + (high - low) * s, 0.0) for (low, high), s in zip(bounds, shares, strict=True)]
    drawn = np.append(numbers.integers(8, 64, 500), 8)
    # Darkness is as frequent as light.
    light, mean, deviation = numbers.uniform(0, 1, (3, 501)) ** 4
    return memory, drawn, light, mean, deviation


def test_rivals_follow_the_adaptive_controller(rivals, x64):
    memory, drawn, light, mean, deviation = some_pixels([(8, 64), (0, 1), (0, 3e-3), (0, 0)])
    ours, theirs = sample_count.PAPER_2020, rivals.adaptive(rivals.Bounds(1e-3), alpha=0.2, kappa=0.2)
    history = sample_count.History(*map(jnp.asarray, memory[:3]))
    counts = theirs.count(light, *memory)
    np.testing.assert_array_equal(counts, sample_count.next_count(history, ours))
    assert len(np.unique(counts)) > 30 and counts.min() == 8 and counts.max() == 64
    for is_first in (False, True):
        found = theirs.learn(is_first, drawn, mean, deviation, light, *memory)
        wanted = sample_count.update(history, mean, drawn, ours, missing=is_first)
        expected = np.stack([wanted.mean_count, wanted.mean, wanted.variance])
        np.testing.assert_allclose(np.stack(found[:3]), expected, rtol=1e-13)


def test_rivals_follow_the_controller_inside_the_frames(rivals, x64):
    memory, drawn, light, mean, deviation = some_pixels([(0, 400), (20, 600), (0, 300), (0, 3)])
    ours, theirs = in_frame.Controller(1e-2, alpha=0.05), rivals.in_frame(rivals.Bounds(1e-2), alpha=0.05)
    total, degrees, lit_degrees, uncertainty = map(jnp.asarray, memory)
    history = in_frame.History(total, degrees, lit_degrees, uncertainty, None)
    counts = theirs.count(light, *memory)
    np.testing.assert_array_equal(counts, in_frame.next_count(history, light, ours))
    assert len(np.unique(counts)) > 30 and counts.min() == 8 and counts.max() == 64
    for given in (memory, np.zeros((4, 501))):
        is_first = given is not memory
        found = np.stack(theirs.learn(is_first, drawn, mean, deviation, light, *given))
        wanted = in_frame.update(history, mean, deviation, drawn, light, ours, missing=is_first)
        expected = [wanted.square_deviation, wanted.degrees, wanted.lit_degrees, wanted.uncertainty]
        np.testing.assert_allclose(found, np.stack(expected), rtol=1e-12)
        # Lamps that are off, and that come on.
        unchanged, afresh = np.sum(found[1] == memory[1]), np.sum(found[1] == drawn - 1)
        assert (unchanged == 0 and afresh == 501) if is_first else (unchanged > 20 and afresh > 20)


@pytest.fixture(params=["circle", "line"])
def small(request, rivals):
    """A scene with the fixed count 8, and the exact variance of each result."""
    if request.param == "circle":
        world, texels_per_d = circle.uniform(np.array([1.0, 2.0])), None
        truth, lit = (np.asarray(values)[:, None] for values in (world.truth, world.control))
    else:
        lit = np.random.default_rng(0).uniform(0, 1, (2, 24)).astype(np.float32)
        world, texels_per_d = line.world(lit, length=4.0, d=0.1), 0.6
        truth = np.asarray(world.truth)
    variance = np.asarray(world.sample_variance, np.float64) / 8
    return rivals.Scene(lit, lit, truth, texels_per_d), rivals.Bounds(1.0, 8, 8), variance


def assert_samples_are_fair(found, variance):
    """Exact variances, and results that are independent of each other and near to normal."""
    assert np.all(found.count == 8)
    error = found.squared_error.std() / len(found.squared_error) ** 0.5
    assert abs(found.squared_error.mean() - variance.mean()) < 4 * error
    independent = np.sqrt(2 * np.mean(variance**2) / variance.size / len(found.squared_error))
    assert error == pytest.approx(independent, rel=0.15)


def test_samples_of_numpy_have_the_exact_variance(rivals, small):
    scene, bounds, variance = small
    controller = rivals.adaptive(bounds, alpha=0.2, kappa=0.2)
    assert_samples_are_fair(rivals.by_numpy(scene, controller, bounds, 10_000), variance)


@pytest.mark.parametrize("small", ["line", pytest.param("circle", marks=pytest.mark.slow)], indirect=True)
def test_samples_of_numba_have_the_exact_variance(rivals, small):
    pytest.importorskip("numba", reason="Numba is not installed: pip install sssfit[bench]")
    scene, bounds, variance = small
    run = rivals.by_numba(scene, rivals.adaptive(bounds, alpha=0.2, kappa=0.2))
    assert_samples_are_fair(run(10_000, False), variance)


def test_programs_that_disagree_are_not_timed(load):
    module, by_seed = load("scenarios"), np.random.default_rng(0).normal(40, 1, (2, 100))
    one, other = module.Outcome(*by_seed), module.Outcome(*by_seed[::-1])
    module.check({"a": one, "b": other})
    with pytest.raises(RuntimeError, match="a and b do not simulate the same: their mean squared error is"):
        # Five standard errors of the difference.
        module.check({"a": one, "b": other._replace(squared_error=one.squared_error + 5 * 0.02**0.5)})


@pytest.mark.slow
def test_simulations(load, page, capsys):
    sizes = ["--circle-seeds", "64", "--circle-frames", "10", "--repeats", "1"]
    sizes += ["--line-seeds", "32", "--line-frames", "10", "--texels", "32"]
    module = load("scenarios")
    results = module.main([*sizes, "--page", str(page)])
    assert set(results) == {"spvg", "as", "in_frame"}
    numbers = {"spvg": 64 * 10, "as": 32 * 10 * 32, "in_frame": 32 * 10 * 32}
    for name, rows in results.items():
        assert [row.name for row in rows[:2]] == ["sssfit", "NumPy, one core"]
        for row in rows:
            assert row.samples == pytest.approx(row.found.count.mean() * numbers[name])
            assert 8 < row.found.count.mean() < 64 and row.seconds.shape == (1,) and row.seconds > 0
    printed, written = capsys.readouterr().out, page.read_text()
    assert all(text in written for text in printed.splitlines())
    assert "`in_frame`, 32 seeds x 10 frames x 32 texels. A process that does" in written
    assert (" Numba is not installed" in written) == (len(results["as"]) == 2)
