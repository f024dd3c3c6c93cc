"""Speed and memory of whole frames: the pass of sssfit beside the same samples by others.

    python benchmarks/frames.py

prints a Markdown report for each part. docs/benchmarks.md explains them, and --page docs/benchmarks.md --plot
docs/images/frames_time.png puts them there.
"""

import argparse
import subprocess
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import frames_counts as counts
import frames_memory as memory
import frames_problem as problems
import frames_report
import frames_rivals as rivals
import frames_rivals_arrays as on_arrays
import interleaved
import numpy as np
from frames_problem import Given, Problem, Scene
from frames_rivals import Missing, Program

from sssfit.frames.points import Distance, Points

OURS = "sssfit"
PARTS = ("rivals", "adaptive", "maps", "ids", "memory")
RIVALS: dict[str, Callable[[Given], Program]] = {
    "C++, OpenMP": rivals.by_openmp,
    "Numba": rivals.by_numba,
    **on_arrays.PROGRAMS,
}
CASES: dict[tuple[Points, Distance], str] = {
    ("table", "plane"): "Table, distance in the plane",
    ("table", "surface"): "Table, distance to the surface",
    ("fresh", "plane"): "Fresh radii and angles, distance in the plane",
    ("fresh", "surface"): "Fresh radii and angles, distance to the surface",
}


class Row(NamedTuple):
    """A program's rounds of seconds, for so many samples, and the share of pixels that differ from ours."""

    name: str
    seconds: np.ndarray
    samples: int
    differ: float


class Comparison(NamedTuple):
    """A problem's rows, and a sentence for each rival without one."""

    problem: Problem
    rows: list[Row]
    missing: list[str]


def compare(problem: Problem, repeats: int, names: Sequence[str] = tuple(RIVALS)) -> Comparison:
    """Times of all programs that can run here, measured in turns once they are known to agree."""
    given, resident = problems.given(problem), problems.on_device(problem)
    programs: dict[str, Callable[[], Any]] = {OURS: lambda: problems.ours(resident)}
    shares, missing = {OURS: 0.0}, []
    reference = np.asarray(problems.ours(resident))
    for name in names:
        try:
            program = RIVALS[name](given)
        except Missing as error:
            missing.append(str(error))
            continue
        shares[name] = problems.check(problem, name, np.asarray(program()), reference)
        programs[name] = program
    times = interleaved.measure(programs, repeats)
    return Comparison(
        problem, [Row(name, times[name], problem.total, shares[name]) for name in programs], missing
    )


def table(comparisons: Mapping[str, Comparison]) -> str:
    """All comparisons in one Markdown table: a row for each program, two columns for each mask."""
    titles = list(comparisons)
    columns = " | ".join(f"{title}: ns per sample | times sssfit's" for title in titles)
    lines = [f"| Program | {columns} | differ |"]
    lines.append("|:--|" + "--:|" * (2 * len(titles) + 1))
    first = next(iter(comparisons.values()))
    for number, row in enumerate(first.rows):
        cells, most = [], 0.0
        for comparison in comparisons.values():
            own, reference = comparison.rows[number], comparison.rows[0]
            time = interleaved.quartiles(1e9 * own.seconds / own.samples)
            ratio = interleaved.quartiles(own.seconds / reference.seconds)
            cells.append(f"{time.median:.2f} ({time.lower:.2f} to {time.upper:.2f})")
            cells.append(f"{ratio.median:.2f} ({ratio.lower:.2f} to {ratio.upper:.2f})")
            most = max(most, own.differ)
        lines.append(f"| {row.name} | {' | '.join(cells)} | {most:.2%} |")
    return "\n".join(lines)


def rivals_report(scene: Scene, options: argparse.Namespace) -> tuple[dict[str, Comparison], str]:
    """All four arithmetics, on the first profile's pixels and on all that scatter."""
    found: dict[str, Comparison] = {}
    texts = []
    for case, title in CASES.items():
        here: dict[str, Comparison] = {}
        for every_id in (False, True):
            problem = problems.problem(scene, *case, options.samples, every_id)
            pixels = f"{problem.mask.sum():,} pixels"
            if not any(c.problem.total == problem.total for c in here.values()):
                here[pixels] = compare(problem, options.repeats, options.rivals)
                found[f"{title}, {pixels}"] = here[pixels]
        most = max(problems.largest_share(c.problem) for c in here.values())
        explained = f"Rounding explains up to {most:.1%} of pixels that differ."
        texts.append(f"{title}, {options.samples} samples a pixel. {explained}\n\n{table(here)}")
    missing = next(iter(found.values())).missing
    return found, "\n\n".join([f"Rivals: {_versions()}. {' '.join(missing)}".strip(), *texts])


def ids_report(scene: Scene, options: argparse.Namespace) -> tuple[dict[str, np.ndarray], str]:
    """What a frame of one profile pays for asking which profiles it has."""
    found: dict[str, np.ndarray] = {}
    lines = ["| Distance | a mask, ms (quartiles) | a frame of one id, ms | times the mask's (quartiles) |"]
    lines.append("|:--|--:|--:|--:|")
    for distance in problems.DISTANCES:
        problem = problems.on_device(problems.problem(scene, "table", distance, options.samples))
        problem = problems.of_one_id(problem)
        programs = {
            "mask": lambda problem=problem: problems.ours(problem),
            "ids": lambda problem=problem: problems.by_ids(problem),
        }
        one, other = (np.asarray(program()) for program in programs.values())
        if not np.array_equal(one, other):
            raise RuntimeError("a frame of one profile is not what its mask gives")
        times = interleaved.measure(programs, options.repeats)
        found[distance] = times["ids"] / times["mask"]
        cells = [counts.milliseconds(times["mask"]), counts.milliseconds(times["ids"])]
        ratio = interleaved.quartiles(found[distance])
        cells.append(f"{ratio.median:.3f} ({ratio.lower:.3f} to {ratio.upper:.3f})")
        lines.append(f"| {distance} | {' | '.join(cells)} |")
    return found, "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Measure, print, and write the page asked for: what each part found, by its name."""
    options = _parser().parse_args(arguments)
    scene = problems.scene(options.width, options.height)
    parts: dict[str, frames_report.Part] = {
        "rivals": rivals_report,
        "adaptive": counts.adaptive_report,
        "maps": counts.maps_report,
        "ids": ids_report,
        "memory": memory.report,
    }
    return frames_report.measure(parts, scene, options, "frames")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="only these")
    parser.add_argument("--rivals", nargs="*", choices=RIVALS, default=tuple(RIVALS), help="only these")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each program")
    parser.add_argument("--samples", type=int, default=64, help="of each pixel at most")
    parser.add_argument("--width", type=int, default=1920, help="of the frame; the head has 1920 x 1080")
    parser.add_argument("--height", type=int, default=1080, help="of the frame")
    parser.add_argument("--tiles", type=int, default=4, help="along each side of the large frame")
    parser.add_argument("--page", type=Path, help="put the tables between their marks in this page")
    parser.add_argument("--plot", type=Path, help="draw the time against the samples here")
    return parser


def _versions() -> str:
    names = {"PyTorch": "torch", "Dr.Jit": "drjit", "Numba": "numba"}
    found = [f"{name} {_version(package)}" for name, package in names.items()]
    try:
        done = subprocess.run(["g++", "-dumpfullversion"], capture_output=True, text=True, check=True)
        found.append(f"g++ {done.stdout.strip()}")
    except (OSError, subprocess.CalledProcessError):
        found.append("g++ absent")
    return ", ".join(found)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


if __name__ == "__main__":
    main()
