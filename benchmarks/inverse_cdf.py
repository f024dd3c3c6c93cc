"""Speed and error of every way to draw radii from Burley's profile, in float32, beside rival programs.

    python benchmarks/inverse_cdf.py --csv methods.csv --plot front.png

prints a Markdown table and writes the files asked for. docs/benchmarks.md explains the columns, and
--page docs/benchmarks.md puts the table there.
"""

import argparse
import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import front_plot
import interleaved
import numpy as np
import page
import samplers
from interleaved import Timing
from samplers import Sampler

#: Variates drawn by one call. Much larger arrays are new memory at each call, which costs more than drawing.
BLOCK = 1_000_000
#: Errors that differ by less than this factor count as equal: float32 rounding alone makes such differences.
EQUAL = 1.1
#: E[exp(-r / d)] under the profile: (1/2 + 3/4) / 4.
EXPECTED = 0.3125


class Errors(NamedTuple):
    """How far a sampler is off; radii in units of d, biases of E[exp(-r / d)] in percent."""

    cdf_max: float
    cdf_rms: float
    radius_max: float
    radius_rms: float
    bias_percent: float
    weighted_bias_percent: float
    weight_max: float


class Row(NamedTuple):
    """One sampler's results; nanoseconds per sample, and whether no other beats it."""

    name: str
    library: str
    time: Timing
    errors: Errors
    front_cdf: bool = False
    front_radius: bool = False


def errors(sampler: Sampler, grid: int) -> Errors:
    """Errors over the variates k / grid, k = 0 .. grid - 1; at 2^24 those are all that float32 can draw."""
    xi = (np.arange(grid) / grid).astype(np.float32)
    drawn = np.asarray(sampler.prepare(xi)())
    weight = sampler.weight(xi, drawn)
    radius = drawn.astype(np.float64)
    value = np.exp(-radius)
    bias, weighted_bias = (100 * (np.mean(v) / EXPECTED - 1) for v in (value, value * weight))
    # The mixture does not rise with xi, so what it draws is compared in ascending order.
    radius.sort()
    exact = xi.astype(np.float64)
    off_cdf = samplers.cdf(radius) - exact
    off_radius = radius - samplers.exact_radius(exact)
    figures = (*_max_and_rms(off_cdf), *_max_and_rms(off_radius), bias, weighted_bias, np.max(weight))
    return Errors(*(float(figure) for figure in figures))


def times(contestants: Sequence[Sampler], samples: int, repeats: int) -> tuple[dict[str, Timing], Timing]:
    """Nanoseconds per sample, by name, and of the memory traffic alone."""
    variates = np.random.default_rng(0).random(samples, np.float32)
    blocks = np.split(variates, range(BLOCK, samples, BLOCK))
    programs = {sampler.name: _every_block(sampler.prepare, blocks) for sampler in contestants}
    floor = "memory traffic"
    measured = interleaved.measure(programs | {floor: _every_block(samplers.floor, blocks)}, repeats)
    per_sample = {name: interleaved.quartiles(1e9 * t / samples) for name, t in measured.items()}
    return per_sample, per_sample.pop(floor)


def with_fronts(rows: Sequence[Row]) -> list[Row]:
    """Mark the rows that no other beats in speed and error together."""
    return [
        row._replace(
            front_cdf=not any(_beats(other, row, "cdf_max") for other in rows),
            front_radius=not any(_beats(other, row, "radius_rms") for other in rows),
        )
        for row in rows
    ]


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table, fastest first."""
    lines = [
        "| Sampler | ns per sample (quartiles) | cdf error max | rms | radius error max / d | rms / d "
        "| bias % | weighted % | max weight | front |",
        "|:--|--:|--:|--:|--:|--:|--:|--:|--:|:--|",
    ]
    for row in sorted(rows, key=lambda row: row.time.median):
        e = row.errors
        small = " | ".join(f"{value:.1e}" for value in e[:4])
        biases = " | ".join(f"{value:.4f}" for value in e[4:6])
        fronts = [name for name, on in (("cdf", row.front_cdf), ("radius", row.front_radius)) if on]
        lines.append(
            f"| {row.name} | {row.time.median:.2f} ({row.time.lower:.2f} to {row.time.upper:.2f}) "
            f"| {small} | {biases} | {e.weight_max:.4f} | {', '.join(fronts)} |"
        )
    return "\n".join(lines)


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """The rows in full precision."""
    header = ["sampler", "library", "ns_lower", "ns_median", "ns_upper", *Errors._fields]
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*header, "front_cdf", "front_radius"])
        for row in rows:
            figures = (f"{value:.6g}" for value in (*row.time, *row.errors))
            writer.writerow([row.name, row.library, *figures, row.front_cdf, row.front_radius])


def main(arguments: Sequence[str] | None = None) -> list[Row]:
    """Measure, print, and write the files asked for."""
    options = _parser().parse_args(arguments)
    contestants = [s for s in samplers.everything() if s.library in (options.libraries or (s.library,))]
    neighbours = interleaved.Neighbours()
    per_sample, floor = times(contestants, options.samples, options.repeats)
    conditions = f"{interleaved.machine()}; {neighbours.describe()}."
    rows = with_fronts(
        [Row(s.name, s.library, per_sample[s.name], errors(s, options.grid)) for s in contestants]
    )
    traffic = f"Reading and writing the arrays alone takes {floor.median:.2f} ns per sample."
    report = f"{conditions} {options.repeats} rounds. {traffic}\n\n{table(rows)}"
    print(report)
    if options.csv:
        write_csv(rows, options.csv)
    if options.plot:
        front_plot.draw(rows, floor.median, options.plot)
    if options.page:
        page.replace(options.page, "samplers", report)
    return rows


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000_000, help="radii per timed run")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each sampler")
    parser.add_argument("--grid", type=int, default=2**24, help="variates that errors are taken over")
    parser.add_argument("--libraries", nargs="+", help="only samplers of these: sssfit, NumPy, SciPy, Numba")
    parser.add_argument("--csv", type=Path, help="write the table here in full precision")
    parser.add_argument("--plot", type=Path, help="draw speed against error here")
    parser.add_argument("--page", type=Path, help="put the table between its marks in this page")
    return parser


def _beats(other: Row, row: Row, error: str) -> bool:
    """No less accurate, and faster by more than either's quartiles are apart."""
    margin = max(other.time.spread, row.time.spread)
    faster = row.time.median - other.time.median > margin
    return faster and getattr(other.errors, error) <= EQUAL * getattr(row.errors, error)


def _every_block(prepare: Callable, blocks: Sequence[np.ndarray]) -> Callable[[], None]:
    programs = [prepare(block) for block in blocks]

    def run() -> None:
        for program in programs:
            program()

    return run


def _max_and_rms(error: np.ndarray) -> tuple[float, float]:
    return np.max(np.abs(error)), np.sqrt(np.mean(np.square(error)))


if __name__ == "__main__":
    main()
