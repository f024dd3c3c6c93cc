"""Measure the sample counts of docs/moving_moments.md: its tables, a CSV file and a picture.

A pixel of the circle scenario draws n points of the unit square and averages 4 / pi over those within the
inscribed circle, so that a frame's result is (4 / pi) Binomial(n, pi / 4) / n exactly. Run from the
repository root, in about a minute:

    python docs/scripts/sample_counts.py
"""

import csv
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import interleaved
import page

from sssfit.estimators import count_prediction, sample_count

DOCS = Path(__file__).resolve().parents[1]
HIT = np.pi / 4
POPULATION_VARIANCE = 4 / np.pi - 1
EXCESS_KURTOSIS = (1 - 6 * HIT * (1 - HIT)) / (HIT * (1 - HIT))
TARGET = 0.08**2
ORACLE = POPULATION_VARIANCE / TARGET
PIXELS = 10_000
SEED = 2020
#: What no count reaches, unless it runs away.
OPEN = 2**20


class Run(NamedTuple):
    """One setting. The light is scaled so that the oracle, variance / target, has the given value."""

    study: str
    controller: sample_count.Controller
    start: str = "disocclusion"
    oracle: float = ORACLE

    @property
    def first(self) -> int:
        """The first frame, from 0, that is measured: ten memories, 50 frames at least."""
        return max(50, round(10 / float(self.controller.alpha)))

    @property
    def scale(self) -> float:
        return float(np.sqrt(self.oracle * self.controller.target_variance / POPULATION_VARIANCE))


class Row(NamedTuple):
    """Measured over 100 frames of all pixels; errors are standard errors over the pixels."""

    study: str
    start: str
    alpha: float
    kappa: float
    min_spp: int
    max_spp: int
    oracle: float
    neutral: float
    mean_count: float
    mean_count_error: float
    count_deviation: float
    count_q05: float
    count_q50: float
    count_q95: float
    share_at_min: float
    share_at_max: float
    moving_variance_over_target: float
    frame_variance_over_target: float
    frame_variance_over_target_error: float


def simulate(run: Run, frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Counts, frame results in units of the light, and moving variances, each (frames, PIXELS)."""
    controller, random = run.controller, np.random.default_rng(SEED)
    next_count = jax.jit(lambda history: sample_count.next_count(history, controller))
    update = jax.jit(lambda h, x, n, missing: sample_count.update(h, x, n, controller, missing=missing))
    history = sample_count.init(np.zeros(PIXELS, np.float32))
    if run.start == "neutral":
        neutral = _neutral(run)
        values = (neutral, run.scale, controller.target_variance)
        history = sample_count.History(*(np.full(PIXELS, v, np.float32) for v in values))
    counts, results, variances = (np.empty((frames, PIXELS)) for _ in range(3))
    for frame in range(frames):
        counts[frame] = next_count(history)
        count = counts[frame].astype(np.int64)
        results[frame] = random.binomial(count, HIT) / count / HIT
        missing = frame == 0 and run.start == "disocclusion"
        history = update(history, np.float32(run.scale * results[frame]), count.astype(np.int32), missing)
        variances[frame] = history.variance
    return counts, results, variances


def _neutral(run: Run) -> float:
    return float(count_prediction.neutral_count(run.oracle, target_variance=1.0, alpha=run.controller.alpha))


def measure(run: Run) -> Row:
    counts, results, variances = simulate(run, run.first + 100)
    counts, results, variances = (a[run.first :] for a in (counts, results, variances))
    controller = run.controller
    squared_error = np.square(results - 1).mean(axis=0) * run.oracle / POPULATION_VARIANCE
    return Row(
        run.study,
        run.start,
        controller.alpha,
        controller.kappa,
        controller.min_spp,
        controller.max_spp,
        run.oracle,
        _neutral(run),
        counts.mean(),
        _standard_error(counts.mean(axis=0)),
        counts.std(),
        *np.percentile(counts, (5, 50, 95)),
        (counts == controller.min_spp).mean(),
        (counts == controller.max_spp).mean(),
        variances.mean() / controller.target_variance,
        squared_error.mean(),
        _standard_error(squared_error),
    )


def _standard_error(by_pixel: np.ndarray) -> float:
    return by_pixel.std(ddof=1) / np.sqrt(len(by_pixel))


def circle(alpha: float = 0.2, kappa: float = 0.0, bounds=(8, 64)) -> sample_count.Controller:
    return sample_count.Controller(TARGET, alpha=alpha, kappa=kappa, min_spp=bounds[0], max_spp=bounds[1])


def runs() -> Iterator[Run]:
    for kappa in (0.0, 0.1, 0.2, 0.5, 1.0):
        yield Run("kappa", circle(kappa=kappa))
    for kappa in (0.0, 1.0):
        yield Run("kappa", circle(kappa=kappa), "cold")
    yield Run("kappa", circle(bounds=(8, OPEN)))
    for alpha in (0.02, 0.05, 0.1, 0.2, 0.4):
        yield Run("alpha", circle(alpha))
    for alpha, kappa in ((0.005, 0.0), (0.01, 0.0), (0.02, 0.0), (0.05, 0.0), (0.1, 0.0), (0.2, 0.0),
                         (0.005, 0.005), (0.01, 0.01), (0.01, 0.05)):  # fmt: skip
        yield Run("prediction", circle(alpha, kappa, (1, OPEN)), "neutral")
    for name, controller in sample_count.PRESETS.items():
        for oracle in (20.0, ORACLE, 200.0, 1000.0):
            yield Run(name, controller, oracle=oracle)


def table(header: str, rows) -> str:
    names = header.split("|")
    lines = [header, "|".join([":--"] + ["--:"] * (len(names) - 1)), *("|".join(row) for row in rows)]
    return "\n".join("| " + " | ".join(cell.strip() for cell in line.split("|")) + " |" for line in lines)


def kappa_table(rows: list[Row]) -> str:
    def cells(r: Row):
        bounds = "" if r.max_spp < OPEN else ", no upper bound"
        yield from (f"{r.start}{bounds}", f"{r.kappa:g}", f"{r.mean_count:.2f} ± {r.mean_count_error:.2f}")
        yield f"{r.count_q05:.0f}, {r.count_q50:.0f}, {r.count_q95:.0f}"
        yield from (f"{r.share_at_min:.1%}", f"{r.share_at_max:.1%}" if not bounds else "-")
        yield from (f"{r.mean_count / r.neutral:.3f}", f"{r.mean_count / r.oracle:.3f}")
        yield f"{r.frame_variance_over_target:.3f} ± {r.frame_variance_over_target_error:.3f}"

    header = "start|kappa|mean count|5, 50, 95 %|at 8|at 64|over neutral|over oracle|variance / target"
    return table(header, (cells(r) for r in rows if r.study == "kappa"))


def alpha_table(rows: list[Row]) -> str:
    def cells(r: Row):
        yield from (f"{r.alpha:g}", f"{r.neutral:.2f}", f"{r.mean_count:.2f} ± {r.mean_count_error:.2f}")
        yield from (f"{r.mean_count / r.neutral:.3f}", f"{r.mean_count / r.oracle:.3f}")
        yield f"{r.moving_variance_over_target:.3f}"
        yield f"{r.frame_variance_over_target:.3f} ± {r.frame_variance_over_target_error:.3f}"

    header = "alpha|neutral|mean count|over neutral|over oracle|moving variance / target|variance / target"
    return table(header, (cells(r) for r in rows if r.study == "alpha"))


def prediction_table(rows: list[Row]) -> str:
    def cells(r: Row):
        said = count_prediction.steady_state(
            circle(r.alpha, r.kappa), POPULATION_VARIANCE, excess_kurtosis=EXCESS_KURTOSIS
        )
        yield from (f"{r.alpha:g}", f"{r.kappa:g}", f"{float(said.deviation / said.mean):.2f}")
        yield from (f"{float(said.mean):.2f}", f"{number(r.mean_count)} ± {number(r.mean_count_error)}")
        yield from (f"{float(said.deviation):.2f}", number(r.count_deviation), f"{r.count_q50:.0f}")

    def number(value: float) -> str:
        return f"{value:.2f}" if value < 100 else f"{value:,.0f}"

    header = "alpha|kappa|spread|mean predicted|mean|deviation predicted|deviation|median"
    return table(header, (cells(r) for r in rows if r.study == "prediction"))


def preset_table(rows: list[Row]) -> str:
    def cells(name: str):
        yield f"`{name.upper()}`"
        for r in rows:
            if r.study == name:
                yield f"{r.mean_count:.1f}, {r.frame_variance_over_target:.2f}"

    header = "preset|oracle 20|oracle 42.69|oracle 200|oracle 1000"
    return table(header, (cells(name) for name in sample_count.PRESETS))


def draw(path: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.1), dpi=100, layout="constrained")
    for kappa, colour in ((0.0, "#2b5fb3"), (1.0, "#c8322d")):
        for start, style in (("cold", "-"), ("disocclusion", "--")):
            counts = simulate(Run("picture", circle(kappa=kappa), start), 150)[0]
            label = f"{start}, kappa {kappa:g}"
            left.plot(np.arange(1, 61), counts[:60].mean(axis=1), style, color=colour, label=label, lw=1.6)
        share = np.bincount(counts[50:].astype(int).ravel(), minlength=65)[8:] / counts[50:].size
        edges = np.arange(7.5, 65)
        right.stairs(100 * share, edges, color=colour, lw=1.6, label=f"kappa {kappa:g}")
        right.stairs(100 * share, edges, color=colour, lw=0, fill=True, alpha=0.18)
    left.axhline(ORACLE, color="#222222", lw=1, ls=":", label="oracle 42.69")
    right.axvline(ORACLE, color="#222222", lw=1, ls=":", label="oracle 42.69")
    left.set(xlabel="frame", ylabel="mean count [spp]", title="after a start", xlim=(0, 61), ylim=(0, 68))
    left.legend(frameon=False, loc="lower right", fontsize=9)
    right.set(xlabel="count [spp]", ylabel="share of pixels and frames [%]", title="frames 51 to 150")
    right.set(yscale="log", ylim=(0.08, 130), xlim=(6, 66))
    right.set_yticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
    right.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.1, 1), fontsize=9)
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.set_axisbelow(True)
    figure.savefig(path, metadata={"Software": None})


def main():
    rows = [measure(run) for run in runs()]
    with (DOCS / "data" / "sample_counts.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Row._fields)
        writer.writerows([f"{v:.6g}" if isinstance(v, float) else v for v in row] for row in rows)
    conditions = f"{interleaved.machine()}. {PIXELS:,} pixels, float32, seed {SEED}."
    tables = {"kappa": kappa_table, "alpha": alpha_table, "prediction": prediction_table,
              "presets": preset_table}  # fmt: skip
    for name, make in tables.items():
        text = make(rows)
        print(text, end="\n\n")
        page.replace(DOCS / "moving_moments.md", f"counts {name}", text)
    page.replace(DOCS / "moving_moments.md", "counts conditions", conditions)
    draw(DOCS / "images" / "sample_counts.png")


if __name__ == "__main__":
    main()
