"""What a pass costs when its pixels take different numbers of samples."""

import argparse
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import frames_problem as problems
import interleaved
import jax
import jax.numpy as jnp
import numpy as np
from frames_problem import Problem, Scene

from sssfit.frames import _order, points, scatter

LEAST = 8
#: Samples in proportion to the fixed number, which the controller's targets are chosen for.
RATIOS = (0.15, 0.25, 0.5)
#: time / time(fixed) is to be at most SLOPE times the ratio of samples, and OFFSET.
SLOPE, OFFSET = 1.3, 0.05


class Adaptive(NamedTuple):
    """One count map: its share of the samples, rounds of time / time(fixed), and the parts in seconds."""

    ratio: float
    times: np.ndarray
    parts: dict[str, float]

    @property
    def allowed(self) -> float:
        return SLOPE * self.ratio + OFFSET


class Line(NamedTuple):
    """A least-squares line through medians: seconds, seconds per sample, and how much of them it explains."""

    start: float
    slope: float
    r_squared: float


class Maps(NamedTuple):
    """Of each map the samples asked for, those that its blocks draw, and rounds of seconds."""

    asked: dict[str, int]
    drawn: dict[str, int]
    seconds: dict[str, np.ndarray]

    def line(self, samples: Mapping[str, int]) -> Line:
        x = np.array([samples[name] for name in self.seconds], np.float64)
        y = np.array([np.median(times) for times in self.seconds.values()])
        slope, start = np.polyfit(x, y, 1)
        left = y - start - slope * x
        return Line(float(start), float(slope), 1 - float(left @ left / np.sum((y - y.mean()) ** 2)))


def controlled(variance: np.ndarray, mask: np.ndarray, ratio: float, most: int) -> np.ndarray:
    """Counts for a target variance that makes them so many in proportion to the largest.

    count = ceil(variance of a sample / target), from 8 to the largest, as the controllers have it.
    """
    low, high = 0.0, float(variance[mask].max())

    def counts(target: float) -> np.ndarray:
        return np.clip(np.ceil(variance / target), min(LEAST, most), most).astype(np.int32)

    for _ in range(60):
        middle = (low + high) / 2
        if counts(middle)[mask].mean() > ratio * most:
            low = middle
        else:
            high = middle
    return np.where(mask, counts(high), 0)


def variance(problem: Problem) -> np.ndarray:
    """Of one sample's luminance at each pixel, from a pilot of eight."""
    frame = problem.scene.frame._replace(profile_id=jnp.asarray(problem.mask).astype(jnp.int32))
    found = scatter.variance_of_samples(
        frame, {1: problem.scene.d}, counts=min(LEAST, problem.samples), settings=problem.settings, seed=1
    )
    return np.asarray(found)


def drawn(counts: np.ndarray) -> int:
    """Samples that are computed: a block draws the largest count in it for each of its pixels."""
    _, largest, _ = _order.of_segments(jnp.asarray(counts, jnp.int32), 1)
    return _order.BLOCK * int(largest.sum())


def adaptive_report(scene: Scene, options: argparse.Namespace) -> tuple[dict[str, list[Adaptive]], str]:
    """The controller's maps beside the fixed count, with where the time goes."""
    found, texts = {}, []
    for distance in problems.DISTANCES:
        problem = problems.problem(scene, "table", distance, options.samples)
        found[distance], fixed = adaptive(problem, options.repeats)
        title = f"Distance: {distance}. Fixed {problem.samples} samples: {milliseconds(fixed)} ms."
        texts.append(f"{title}\n\n{adaptive_table(found[distance])}")
    return found, "\n\n".join(texts)


def adaptive(problem: Problem, repeats: int) -> tuple[list[Adaptive], np.ndarray]:
    """Times of the controller's maps, and of the fixed count."""
    mask, most = np.asarray(problem.mask), problem.samples
    seen = variance(problem)
    maps = {f"{ratio}": controlled(seen, mask, ratio, most) for ratio in RATIOS}
    resident = problems.on_device(problem)
    programs: dict[str, Callable[[], Any]] = {
        name: functools.partial(problems.ours, resident, jnp.asarray(counts))
        for name, counts in ({"fixed": mask * most, "nothing": 0 * mask} | maps).items()
    }
    times = interleaved.measure(programs | {"table": table_alone(problem)}, repeats)
    fixed, nothing, table = (float(np.median(times[name])) for name in ("fixed", "nothing", "table"))
    rows = []
    for name, counts in maps.items():
        ratio, time = counts.sum() / problem.total, float(np.median(times[name]))
        samples = (fixed - nothing) * ratio
        uneven = (fixed - nothing) * (drawn(counts) - counts.sum()) / drawn(mask * most)
        parts = {"table": table, "set-up, sort and layout": nothing - table, "samples": samples}
        parts |= {"drawn beyond the count": uneven, "rest": time - nothing - samples - uneven}
        rows.append(Adaptive(float(ratio), times[name] / times["fixed"], parts))
    return rows, times["fixed"]


def table_alone(problem: Problem) -> Callable[[], Any]:
    """What draws the samples' table, apart from the pass."""
    settings, samples = problem.settings, problem.samples
    draw = jax.jit(lambda d, word: points.table(samples, d, settings, count=samples, seed=word, frame=word))
    d, word = jnp.asarray(problem.scene.d), jnp.uint32(0)
    return lambda: jax.block_until_ready(draw(d, word))


def adaptive_table(rows: list[Adaptive]) -> str:
    """The rows as a Markdown table, parts in milliseconds."""
    parts = list(rows[0].parts)
    columns = ", ms | ".join(parts)
    lines = [f"| samples / fixed | time / fixed (quartiles) | allowed | {columns}, ms |"]
    lines.append("|--:|--:|--:|" + "--:|" * len(parts))
    for row in rows:
        time = interleaved.quartiles(row.times)
        cells = " | ".join(f"{1e3 * row.parts[part]:.1f}" for part in parts)
        spread = f"{time.median:.3f} ({time.lower:.3f} to {time.upper:.3f})"
        lines.append(f"| {row.ratio:.3f} | {spread} | {row.allowed:.3f} | {cells} |")
    return "\n".join(lines)


def count_maps(problem: Problem) -> dict[str, np.ndarray]:
    """Maps of all sorts, 0 outside the mask."""
    mask, most = np.asarray(problem.mask), problem.samples
    rows, columns = np.arange(mask.shape[0])[:, None], np.arange(mask.shape[1])
    seen = variance(problem)
    maps = {f"controller, {r}": controlled(seen, mask, r, most) for r in (0.15, 0.2, 0.3, 0.5, 0.75)}
    maps |= {f"uniform {most >> k}": np.full(mask.shape, most >> k) for k in range(4)}
    maps["left half"] = np.where(columns < np.median(np.nonzero(mask)[1]), most, 0)
    maps["gradient"] = np.rint(LEAST + (most - LEAST) * rows / mask.shape[0]).astype(np.int32)
    maps["checks of 64"] = np.where((rows // 64 + columns // 64) % 2, most, LEAST)
    maps["checks of 1"] = np.where((rows + columns) % 2, most, LEAST)
    maps["random"] = np.random.default_rng(0).integers(LEAST, most, mask.shape, endpoint=True)
    return {name: np.where(mask, counts, 0).astype(np.int32) for name, counts in maps.items()}


def maps_report(scene: Scene, options: argparse.Namespace) -> tuple[Maps, str]:
    """Time against samples over all maps."""
    problem = problems.problem(scene, "table", "surface", options.samples)
    found = maps(problem, options.repeats)
    lines = ["| Count map | samples asked for, M | drawn, M | ms (quartiles) | ns per sample drawn |"]
    lines.append("|:--|--:|--:|--:|--:|")
    for name, seconds in found.seconds.items():
        each = 1e9 * np.median(seconds) / found.drawn[name]
        counts = f"{found.asked[name] / 1e6:.2f} | {found.drawn[name] / 1e6:.2f}"
        lines.append(f"| {name} | {counts} | {milliseconds(seconds)} | {each:.2f} |")
    fits = []
    for what, samples in (("drawn", found.drawn), ("asked for", found.asked)):
        line = found.line(samples)
        fits.append(
            f"Against samples {what}: {1e3 * line.start:.1f} ms + {1e9 * line.slope:.2f} ns per sample, "
            f"R^2 = {line.r_squared:.4f}."
        )
    if options.plot:
        draw(found, options.plot)
    return found, "\n".join(fits) + "\n\n" + "\n".join(lines)


def maps(problem: Problem, repeats: int) -> Maps:
    """Times of all maps, in turns."""
    every, resident = count_maps(problem), problems.on_device(problem)
    programs = {
        name: functools.partial(problems.ours, resident, jnp.asarray(counts))
        for name, counts in every.items()
    }
    seconds = interleaved.measure(programs, repeats)
    asked = {name: int(counts.sum()) for name, counts in every.items()}
    return Maps(asked, {name: drawn(counts) for name, counts in every.items()}, seconds)


def draw(found: Maps, path: Path) -> None:
    """Time against samples: those drawn with their line, and those asked for."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    line = found.line(found.drawn)
    ends = np.array([0, max(found.drawn.values())])
    label = f"{1e3 * line.start:.0f} ms + {1e9 * line.slope:.2f} ns per sample, $R^2$ = {line.r_squared:.4f}"
    axes.plot(ends / 1e6, 1e3 * (line.start + line.slope * ends), color="0.6", linewidth=1, label=label)
    times = {name: 1e3 * np.percentile(seconds, (25, 50, 75)) for name, seconds in found.seconds.items()}
    for samples, face, what in (
        (found.asked, "white", "samples asked for"),
        (found.drawn, "#0072b2", "samples drawn: a block's largest count for each of its pixels"),
    ):
        x = [samples[name] / 1e6 for name in times]
        y = [time[1] for time in times.values()]
        axes.plot(x, y, "o", color="#0072b2", markerfacecolor=face, markersize=5.5, label=what)
    for name, (low, _, high) in times.items():
        axes.plot([found.drawn[name] / 1e6] * 2, [low, high], color="#0072b2", linewidth=1, alpha=0.6)
    axes.set(xlabel="samples, millions", ylabel="milliseconds of a pass (median, bar: quartiles)")
    axes.set(xlim=(0, None), ylim=(0, None))
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    axes.legend(frameon=False, fontsize=9)
    figure.savefig(path)


def milliseconds(seconds: np.ndarray) -> str:
    """Median and quartiles of rounds."""
    time = interleaved.quartiles(1e3 * seconds)
    return f"{time.median:.1f} ({time.lower:.1f} to {time.upper:.1f})"
