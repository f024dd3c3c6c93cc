"""Speed of the simulations: sssfit's driver beside the same in NumPy and as a loop compiled by Numba.

    python benchmarks/scenarios.py

prints two Markdown reports. docs/benchmarks.md explains them, and --page docs/benchmarks.md puts them there.
"""

import argparse
import math
import multiprocessing
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import interleaved
import jax
import numpy as np
import page
import scenarios_rivals as rivals
from scenarios_rivals import Bounds, Controller, Outcome, Scene

from sssfit.estimators import policies
from sssfit.scenarios import circle, driver, light, line

OURS, NUMPY, NUMBA = "sssfit", "NumPy, one core", ("Numba, one core", "Numba, all cores")
PARTS = ("circle", "line")
#: As in the papers, and as `policies.named` has them by default.
ALPHA, KAPPA, CIRCLE_TARGET, LINE_TARGET = 0.2, 0.2, 0.0064, 1e-4
LENGTH, D = 4.0, 0.05
#: How many standard errors two programs may differ by.
AGREEMENT = 4


class Problem(NamedTuple):
    """What is simulated how often, for sssfit and for its rivals."""

    name: str
    world: Any
    policy: Any
    scene: Scene
    controller: Controller
    bounds: Bounds
    seeds: int


class Row(NamedTuple):
    """A program's rounds of seconds, what it found, and the seconds of its compilation."""

    name: str
    seconds: np.ndarray
    found: Outcome
    compilation: float
    samples: float


def circle_problem(frames: int, seeds: int) -> Problem:
    """The uniform circle under adaptive sampling."""
    world, bounds = circle.uniform(frames), Bounds(CIRCLE_TARGET)
    truth, lit = (np.asarray(values)[:, None] for values in (world.truth, world.control))
    policy = policies.named("spvg", target_variance=CIRCLE_TARGET, alpha=ALPHA, kappa=KAPPA)
    scene = Scene(lit, lit, truth, None)
    return Problem("spvg", world, policy, scene, rivals.adaptive(bounds, ALPHA, KAPPA), bounds, seeds)


def line_problem(name: str, texels: int, frames: int, seeds: int) -> Problem:
    """The line with a ramp under light that swells and fades; the controller is "as" or "in_frame"."""
    profile, bounds = line.ramp(line.centres(texels, LENGTH)), Bounds(LINE_TARGET)
    lit = (light.sine(frames)[:, None] * profile).astype(np.float32)
    world = line.world(lit, length=LENGTH, d=D)
    if name == "as":
        controller = rivals.adaptive(bounds, ALPHA, KAPPA)
        policy = policies.named(name, target_variance=LINE_TARGET, alpha=ALPHA, kappa=KAPPA)
    else:
        controller = rivals.in_frame(bounds, policies.IN_FRAME_ALPHA)
        policy = policies.named(name, target_variance=LINE_TARGET)
    scene = Scene(lit, np.asarray(world.surround), np.asarray(world.truth), D / LENGTH * texels)
    return Problem(name, world, policy, scene, controller, bounds, seeds)


def ours(problem: Problem) -> Outcome:
    """All seeds by sssfit, which gives the whole record, and the two means of each."""
    world, means = problem.world, []
    truth = np.asarray(world.truth)
    for record in driver.chunks(jax.random.key(0), world, problem.policy, seeds=problem.seeds):
        parts = (record.count, np.square(record.value - truth))
        means.append([part.reshape(len(part), -1).mean(axis=1, dtype=np.float64) for part in parts])
    return Outcome(*(np.concatenate(parts) for parts in zip(*means, strict=True)))


def programs(problem: Problem) -> tuple[dict[str, Callable[[], Outcome]], dict[str, float]]:
    """All programs that can run here, compiled, and the seconds that this took."""
    scene, controller, bounds, seeds = problem[3:]
    found: dict[str, Callable[[], Outcome]] = {
        OURS: lambda: ours(problem),
        NUMPY: lambda: rivals.by_numpy(scene, controller, bounds, seeds),
    }
    compilation = {OURS: _compilation_of_ours(problem)}
    try:
        compiled = rivals.by_numba(scene, controller)
    except ModuleNotFoundError as error:
        if error.name != "numba":
            raise
        return found, compilation
    for name, all_cores in zip(NUMBA, (False, True), strict=True):
        found[name] = lambda all_cores=all_cores: compiled(seeds, all_cores)
        compilation[name] = _seconds(lambda all_cores=all_cores: compiled(1, all_cores))
    return found, compilation


def compare(problem: Problem, repeats: int) -> list[Row]:
    """Times of all programs, measured in turns once they are known to agree."""
    everyone, compilation = programs(problem)
    outcomes = {name: program() for name, program in everyone.items()}
    check(outcomes)
    times = interleaved.measure(everyone, repeats)
    size = problem.scene.light.size
    return [
        Row(name, times[name], found, compilation.get(name, 0.0), float(found.count.sum() * size))
        for name, found in outcomes.items()
    ]


def check(outcomes: Mapping[str, Outcome]) -> None:
    """Compare the means over the seeds of every two programs.

    Raises:
        RuntimeError: they differ by more than their standard errors explain.
    """
    for (first, one), (second, other) in combinations(outcomes.items(), 2):
        for what, a, b in zip(Outcome._fields, one, other, strict=True):
            error = math.hypot(_standard_error(a), _standard_error(b))
            if not abs(a.mean() - b.mean()) <= AGREEMENT * error:
                raise RuntimeError(
                    f"{first} and {second} do not simulate the same: their mean {what.replace('_', ' ')} is "
                    f"{a.mean():.6g} and {b.mean():.6g}, with a standard error of {error:.2g} between them"
                )


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| Program | seconds (quartiles) | ns per sample | times sssfit's (quartiles) "
        "| mean count | rmse | compiled in, s |",
        "|:--|--:|--:|--:|--:|--:|--:|",
    ]
    for row in rows:
        time, ratio = interleaved.quartiles(row.seconds), interleaved.quartiles(row.seconds / rows[0].seconds)
        count, rmse = row.found.count, math.sqrt(row.found.squared_error.mean())
        compiled = f"{row.compilation:.1f}" if row.compilation else ""
        lines.append(
            f"| {row.name} | {time.median:.3f} ({time.lower:.3f} to {time.upper:.3f}) "
            f"| {1e9 * time.median / row.samples:.1f} "
            f"| {ratio.median:.2f} ({ratio.lower:.2f} to {ratio.upper:.2f}) "
            f"| {count.mean():.3f} ± {_standard_error(count):.3f} | {rmse:.5f} | {compiled} |"
        )
    return "\n".join(lines)


def peak_memory(name: str, texels: int, frames: int, seeds: int) -> tuple[float, float]:
    """MB of a new process before the line is simulated by sssfit, and at most."""
    # A new process, as this one has used memory for others.
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_peaks, (name, texels, frames, seeds))


def main(arguments: Sequence[str] | None = None) -> dict[str, list[Row]]:
    """Measure, print, and write the page asked for: the rows of each problem by its name."""
    options = _parser().parse_args(arguments)
    results: dict[str, list[Row]] = {}
    for part in options.parts:
        neighbours = interleaved.Neighbours()
        found, text = _measured(part, options)
        results |= found
        conditions = f"{interleaved.machine()}; {neighbours.describe()}. {options.repeats} rounds."
        report = f"{conditions}{_missing(found)}\n\n{text}"
        print(report, flush=True)
        if options.page:
            page.replace(options.page, f"simulations {part}", report)
    return results


def _measured(part: str, options: argparse.Namespace) -> tuple[dict[str, list[Row]], str]:
    """The rows of a part's problems, and a text with their tables."""
    if part == "circle":
        frames, seeds = options.circle_frames, options.circle_seeds
        rows = compare(circle_problem(frames, seeds), options.repeats)
        return {"spvg": rows}, f"`spvg`, {seeds} seeds x {frames} frames.\n\n{table(rows)}"
    size = (options.texels, options.line_frames, options.line_seeds)
    found, texts = {}, []
    for name in ("as", "in_frame"):
        rows = found[name] = compare(line_problem(name, *size), options.repeats)
        before, most = peak_memory(name, *size)
        memory = f"A process that does sssfit's alone takes {most:.0f} MB, {before:.0f} of them beforehand."
        sizes = f"{size[2]} seeds x {size[1]} frames x {size[0]} texels"
        texts.append(f"`{name}`, {sizes}. {memory}\n\n{table(rows)}")
    return found, "\n\n".join(texts)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="only these")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each program")
    parser.add_argument("--circle-seeds", type=int, default=1000, help="repetitions of the circle")
    parser.add_argument("--circle-frames", type=int, default=150, help="frames of each")
    parser.add_argument("--line-seeds", type=int, default=100, help="repetitions of the line")
    parser.add_argument("--line-frames", type=int, default=120, help="frames of each")
    parser.add_argument("--texels", type=int, default=512, help="of the line")
    parser.add_argument("--page", type=Path, help="put the tables between their marks in this page")
    return parser


def _missing(results: Mapping[str, Sequence[Row]]) -> str:
    names = {row.name for rows in results.values() for row in rows}
    return "" if names.issuperset(NUMBA) else " Numba is not installed and has no rows."


def _standard_error(by_seed: np.ndarray) -> float:
    return float(np.std(by_seed, ddof=1) / math.sqrt(len(by_seed)))


def _seconds(program: Callable[[], object]) -> float:
    start = time.perf_counter()
    program()
    return time.perf_counter() - start


def _compilation_of_ours(problem: Problem) -> float:
    """How much longer the first chunk of seeds takes than the same once more."""

    def first_chunk() -> None:
        next(driver.chunks(jax.random.key(0), problem.world, problem.policy, seeds=problem.seeds))

    first = _seconds(first_chunk)
    return max(0.0, first - _seconds(first_chunk))


def _peaks(name: str, texels: int, frames: int, seeds: int) -> tuple[float, float]:
    problem = line_problem(name, texels, frames, seeds)
    before = interleaved.peak()
    ours(problem)
    return before, interleaved.peak()


if __name__ == "__main__":
    main()
