"""Speed of the moving moments: updates beside copies, streams beside other packages, scan beside associative.

    python benchmarks/moving.py --plot crossover.png

prints three Markdown tables and writes the picture. docs/benchmarks.md explains them, and
--page docs/benchmarks.md puts them there.
"""

import argparse
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import interleaved
import jax
import jax.numpy as jnp
import moving_frames
import moving_rivals
import numpy as np
import page
from jax import Array
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, ScalarFormatter

from sssfit.estimators import moving
from sssfit.estimators.moving import Statistic

ALPHA = moving_frames.ALPHA
PARTS = ("frames", "streams", "lengths")
METHODS: tuple[moving.Method, ...] = ("scan", "associative")
STATISTICS: tuple[Statistic, ...] = ("emv", "emcm")
#: How many streams go through time together, and their colours.
STREAMS = {1: "#0072b2", 16: "#d55e00", 1024: "#117733"}
#: The shortest stream, and by how much the next is longer.
SHORTEST, FACTOR = 16, 8


class Row(NamedTuple):
    """Results of a whole stream by method: rounds of seconds, and seconds of the compilation."""

    statistic: Statistic
    streams: int
    samples: int
    seconds: dict[str, np.ndarray]
    compilation: dict[str, float]

    @property
    def ratio(self) -> np.ndarray:
        return self.seconds["associative"] / self.seconds["scan"]


def measure(statistic: Statistic, streams: int, samples: int, repeats: int) -> Row:
    """Times of both methods on one array."""
    shape = (samples, streams, 2) if statistic == "emcm" else (samples, streams)
    xs = jnp.asarray(np.random.default_rng(0).standard_normal(shape, np.float32))
    whole: Callable[..., Array] = getattr(moving, statistic)
    programs, compilation = {}, {}
    for method in METHODS:
        start = time.perf_counter()
        compiled = jax.jit(lambda xs, method=method: whole(xs, ALPHA, method=method)).lower(xs).compile()
        compilation[method] = time.perf_counter() - start
        programs[method] = lambda compiled=compiled: compiled(xs).block_until_ready()
    return Row(statistic, streams, samples, interleaved.measure(programs, repeats), compilation)


def lengths(longest: int, most: int, repeats: int) -> list[Row]:
    """Both methods for every statistic, number of streams and length, up to `most` samples in all."""
    rows = []
    for statistic in STATISTICS:
        for streams in STREAMS:
            samples = SHORTEST
            while samples <= min(longest, most // streams):
                rows.append(measure(statistic, streams, samples, repeats))
                samples *= FACTOR
    return rows


def faster(rows: Sequence[Row]) -> list[tuple[float, float]]:
    """Between which numbers of samples associative is faster in the median; rows of one kind by length.

    Where two lengths disagree, the end is interpolated between them. It is infinite where none is known.
    """
    samples = [float(row.samples) for row in rows]
    gains = [-float(np.log(np.median(row.ratio))) for row in rows]
    ends = [samples[0]] if gains[0] > 0 else []
    for i in range(len(rows) - 1):
        if (gains[i] > 0) != (gains[i + 1] > 0):
            ends.append(samples[i] * (samples[i + 1] / samples[i]) ** (gains[i] / (gains[i] - gains[i + 1])))
    ends += [math.inf] * (len(ends) % 2)
    return list(zip(ends[::2], ends[1::2], strict=True))


def described(ranges: Sequence[tuple[float, float]]) -> str:
    """Ranges of numbers of samples in words, to two digits."""
    low_high = [[f"{float(f'{end:.2g}'):,.0f}" for end in ends] for ends in ranges]
    return ", ".join(f"from {a} on" if b == "inf" else f"{a} to {b}" for a, b in low_high) or "nowhere"


def table(rows: Sequence[Row]) -> str:
    """A line for each statistic and number of streams: its longest streams, and where the methods cross."""
    lines = [
        "| Statistic | streams | samples of each | scan, ns per sample | associative "
        "| times scan's (quartiles) | compiled in, s | associative is faster, samples |",
        "|:--|--:|--:|--:|--:|--:|--:|:--|",
    ]
    for alike in _groups(rows):
        row = alike[-1]
        scan, associative = (np.median(row.seconds[m]) * 1e9 / row.samples / row.streams for m in METHODS)
        ratio = interleaved.quartiles(row.ratio)
        compiled = " and ".join(f"{row.compilation[method]:.1f}" for method in METHODS)
        lines.append(
            f"| `{row.statistic}` | {row.streams} | {row.samples} | {scan:.1f} | {associative:.1f} "
            f"| {ratio.median:.2f} ({ratio.lower:.2f} to {ratio.upper:.2f}) | {compiled} "
            f"| {described(faster(alike))} |"
        )
    return "\n".join(lines)


def draw(rows: Sequence[Row], path: Path) -> None:
    """Nanoseconds per sample against the length, a panel for each statistic."""
    figure = Figure(figsize=(9.5, 5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(STATISTICS), sharey=True)
    for axes, statistic in zip(panels, STATISTICS, strict=True):
        axes.set(yscale="log", title=statistic, xlabel="samples of each stream")
        axes.set_xscale("log", base=FACTOR)
        lengths_of_all = sorted({row.samples for row in rows})
        axes.set_xticks(lengths_of_all, [str(samples) for samples in lengths_of_all])
        axes.set_xticks([], minor=True)
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_locator(LogLocator(subs=()))
        axes.grid(color="0.92")
        axes.set_axisbelow(True)
        for alike in _groups([row for row in rows if row.statistic == statistic]):
            samples, streams = [row.samples for row in alike], alike[0].streams
            for method, style in zip(METHODS, ("o-", "s--"), strict=True):
                times = [interleaved.quartiles(row.seconds[method]) for row in alike]
                lower, median, upper = np.array(times).T * 1e9 / samples / streams
                label = f"{method}, {streams} {'stream' if streams == 1 else 'streams'}"
                color, face = STREAMS[streams], STREAMS[streams] if method == "scan" else "white"
                axes.plot(samples, median, style, color=color, markerfacecolor=face, label=label)
                axes.vlines(samples, lower, upper, color=color)
    panels[0].set_ylabel("nanoseconds per sample (median, bar: quartiles)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9, frameon=False)
    figure.savefig(path)


def main(arguments: Sequence[str] | None = None) -> dict[str, Sequence]:
    """Measure, print, and write the files asked for: the results of each part."""
    options = _parser().parse_args(arguments)
    results: dict[str, Sequence] = {}
    for part in options.parts:
        neighbours = interleaved.Neighbours()
        results[part], note, found = _measured(part, options)
        conditions = f"{interleaved.machine()}; {neighbours.describe()}. {options.repeats} rounds."
        report = f"{conditions}{note}\n\n{found}"
        print(report, flush=True)
        if options.page:
            page.replace(options.page, f"moving {part}", report)
    return results


def _measured(part: str, options: argparse.Namespace) -> tuple[Sequence, str, str]:
    """The results of a part, a note on them, and their table."""
    if part == "frames":
        rows = [
            moving_frames.measure(frame, options.repeats)
            for frame in moving_frames.frames(options.width, options.height)
        ]
        return rows, f" {options.width} x {options.height} pixels.", moving_frames.table(rows)
    if part == "streams":
        rows = moving_rivals.compare(options.streams, options.few_streams, options.steps, options.repeats)
        note = f" {options.steps} pairs in each stream{moving_rivals.versions(rows)}."
        return rows, note, moving_rivals.table(rows)
    rows = lengths(options.longest, options.most, options.repeats)
    if options.plot:
        draw(rows, options.plot)
    return rows, "", table(rows)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="only these tables")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each program")
    parser.add_argument("--width", type=int, default=1920, help="pixels of a frame")
    parser.add_argument("--height", type=int, default=1080)
    parser.add_argument("--streams", type=int, default=100_000, help="streams of the compiled programs")
    parser.add_argument("--few-streams", type=int, default=256, help="streams of pandas and river")
    parser.add_argument("--steps", type=int, default=1000, help="pairs of each of them")
    parser.add_argument("--longest", type=int, default=2**19, help="samples of the longest stream, by length")
    parser.add_argument("--most", type=int, default=2**23, help="samples of all streams together, by length")
    parser.add_argument("--plot", type=Path, help="draw the time against the length here")
    parser.add_argument("--page", type=Path, help="put the tables between their marks in this page")
    return parser


def _groups(rows: Sequence[Row]) -> list[list[Row]]:
    kinds = dict.fromkeys((row.statistic, row.streams) for row in rows)
    return [[row for row in rows if (row.statistic, row.streams) == kind] for kind in kinds]


if __name__ == "__main__":
    main()
