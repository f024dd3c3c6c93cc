"""Measure the scenarios of docs/scenarios.md: its tables, CSV files and pictures.

Run from the repository root, all studies in about ten minutes on two cores, or some of them:

    python docs/scripts/scenarios.py [pictures] [circle] [line] [regret] [tune] [under]
"""

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import matplotlib

matplotlib.use("Agg")
import equinox as eqx
import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import interleaved
import page

from sssfit.estimators import policies
from sssfit.files.arrays import csv_bytes
from sssfit.scenarios import (
    batch_mean,
    circle,
    driver,
    light,
    line,
    measure,
    plot,
    tune,
    writing,
)
from sssfit.scenarios.measure import Target

DOCS = Path(__file__).resolve().parents[1]
LENGTH, TEXELS, D, FRAMES = 4.0, 256, 0.05, 150
CIRCLE, LINE = Target(0.08**2), Target(1e-4)
COLOURS = {"as": "#777777", "ocv": "#2b5fb3", "ccv": "#8a5a00", "in_frame": "#c8322d"}


def simulate(world, policy, target, seeds: int, *, seed: int = 1, first: int = measure.STEADY, **options):
    return writing.simulate(world, policy, target, seeds=seeds, seed=seed, first=first, **options)[0]


def lit_line(profile, intensity, *, texels: int = TEXELS, kernel: line.Kernel = "line") -> line.Line:
    irradiance = intensity[:, None] * profile(line.centres(texels, LENGTH))
    return line.world(irradiance.astype(np.float32), length=LENGTH, d=D, kernel=kernel)


def sweep(*, texels: int = TEXELS) -> line.Line:
    """A stripe of light, 0.6 mm wide, that crosses the line: light that does not change by a factor."""
    x, starts = line.centres(texels, LENGTH), np.linspace(0.2, 3.2, FRAMES)
    irradiance = np.stack([line.pulse(x, start=start, end=start + 0.6) for start in starts])
    return line.world(irradiance.astype(np.float32), length=LENGTH, d=D)


LIGHTS = {
    "static": light.static(FRAMES),
    "sine 1 Hz": light.sine(FRAMES),
    "sine 5 Hz, to 0": light.sine(FRAMES, frequency=5.0, depth=1.0),
    "on/off 1 Hz": light.on_off(FRAMES),
    "candle": light.candle(FRAMES),
}


def table(rows: Iterable[dict[str, str]]) -> str:
    rows = list(rows)
    names = list(rows[0])
    lines = [names, [":--"] + ["--:"] * (len(names) - 1), *(list(row.values()) for row in rows)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def write(name: str, text: str, columns: dict[str, Any] | None = None) -> None:
    print(f"\n{name}\n{text}", flush=True)
    page.replace(DOCS / "scenarios.md", name, text)
    if columns is not None:
        (DOCS / "data" / f"scenarios_{name}.csv").write_bytes(csv_bytes(columns))


def columns_of(rows: list[dict[str, Any]]) -> dict[str, list[Any]]:
    return {name: [row[name] for row in rows] for name in rows[0]}


# --- the circle


def circle_runs() -> Iterator[tuple[str, policies.Policy, driver.Start]]:
    target = {"target_variance": CIRCLE.variance}
    for kappa in (0.0, 0.2, 1.0):
        for start in ("cold", "disocclusion"):
            yield f"spvg, kappa {kappa:g}", policies.named("spvg", kappa=kappa, **target), start
    yield "in_frame", policies.named("in_frame", **target), "cold"
    yield "oracle", policies.named("oracle", **target), "cold"
    yield "fixed, 43", policies.named("fixed", spp=43), "cold"


def study_circle(seeds: int = 20_000) -> None:
    world, rows = circle.uniform(FRAMES), []
    for name, policy, start in circle_runs():
        found = simulate(world, policy, CIRCLE, seeds, start=start)
        figures = measure.summarize(found)
        share = found.histogram[measure.STEADY :].sum(axis=0) / found.histogram[measure.STEADY :].sum()
        share = np.pad(share, (0, 65 - min(65, len(share))))
        error = found.error_by_seed[:, measure.STEADY :].mean(axis=1) / CIRCLE.variance
        rows.append(
            {
                "controller": name,
                "start": start,
                "mean_count": figures.mean_count,
                "mean_count_se": figures.mean_count_se,
                "count_over_oracle": figures.count_over_oracle,
                "share_at_8": float(share[8]),
                "share_at_64": float(share[64]),
                "delivered_over_target": float(error.mean()),
                "delivered_over_target_se": measure.standard_error(error),
                "mean_count_30": float(found.count[:30].mean()),
                "regret": figures.regret,
                "regret_q95": figures.regret_q95,
            }
        )
    shown = (
        {
            "controller": row["controller"],
            "start": row["start"],
            "mean count": f"{row['mean_count']:.3f} ± {row['mean_count_se']:.3f}",
            "over oracle": f"{row['count_over_oracle']:.3f}",
            "at 8": f"{row['share_at_8']:.1%}",
            "at 64": f"{row['share_at_64']:.1%}",
            "delivered / target": (
                f"{row['delivered_over_target']:.4f} ± {row['delivered_over_target_se']:.4f}"
            ),
            "first 30 frames": f"{30 * row['mean_count_30']:.0f}",
        }
        for row in rows
    )
    write("circle", table(shown), columns_of(rows))
    write("circle conditions", f"{interleaved.machine()}. {seeds:,} seeds, frames 51 to {FRAMES}.")


# --- the line


class Setup(NamedTuple):
    name: str
    profile: Any
    kernel: line.Kernel


SETUPS = (
    Setup("ramp, radial kernel", line.ramp, "radial"),
    Setup("ramp", line.ramp, "line"),
    Setup("step", line.step, "line"),
)


def study_line(seeds: int = 16, frames: int = 120) -> None:
    rows = []
    for setup in SETUPS:
        static: dict[str, measure.Summary] = {}
        for lit, intensity in LIGHTS.items():
            world = lit_line(setup.profile, intensity[:frames], kernel=setup.kernel)
            for name in ("as", "ocv", "ccv", "in_frame", "oracle"):
                found = measure.summarize(simulate(world, policies.named(name), LINE, seeds, first=0))
                static.setdefault(name, found)
                rows.append(
                    {
                        "setup": setup.name,
                        "light": lit,
                        "controller": name,
                        "mean_count": found.mean_count,
                        "mean_count_se": found.mean_count_se,
                        "dynamic_over_static": found.mean_count / static[name].mean_count,
                        "over_static_as": found.mean_count / static["as"].mean_count,
                        "oracle_count": found.oracle_count,
                        "image_rmse": found.image_rmse,
                        "image_rmse_se": found.image_rmse_se,
                    }
                )
    shown = []
    for setup in SETUPS:
        for lit in LIGHTS:
            row = {"setup": setup.name, "light": lit}
            for name in ("as", "ocv", "ccv", "in_frame", "oracle"):
                wanted = (setup.name, lit, name)
                r = next(r for r in rows if (r["setup"], r["light"], r["controller"]) == wanted)
                ratio = r["dynamic_over_static"]
                row[name] = f"{r['mean_count']:.2f} ({ratio:.2f}), {1e3 * r['image_rmse']:.2f}"
            shown.append(row)
    write("line", table(shown), columns_of(rows))
    write(
        "line conditions", f"{interleaved.machine()}. {seeds} seeds of {TEXELS} texels, frames 1 to {frames}."
    )


# --- the regret


def regret_worlds() -> dict[str, tuple[driver.World, Target]]:
    worlds: dict[str, tuple[driver.World, Target]] = {
        "circle": (circle.uniform(FRAMES), CIRCLE),
        "circle, sine 5 Hz": (circle.uniform(light.sine(FRAMES, frequency=5.0)), CIRCLE),
    }
    worlds |= {f"ramp, {name}": (lit_line(line.ramp, intensity), LINE) for name, intensity in LIGHTS.items()}
    worlds |= {f"step, {name}": (lit_line(line.step, intensity), LINE) for name, intensity in LIGHTS.items()}
    return worlds | {"sweep": (sweep(), LINE)}


def regret_policies(target: Target) -> dict[str, policies.Policy]:
    variance = {"target_variance": target.variance}
    names = ("fixed", "unreal", "as", "ocv", "ccv", "in_frame")
    named = {name: policies.named(name, spp=24, **variance) for name in names}
    return named | {"as, kappa 0": policies.named("as", kappa=0.0, **variance)}


def study_regret() -> None:
    rows = []
    for scenario, (world, target) in regret_worlds().items():
        seeds = 4000 if world.truth.ndim == 1 else 24
        for name, policy in regret_policies(target).items():
            found = measure.summarize(simulate(world, policy, target, seeds, seed=7))
            rows.append({"scenario": scenario, "controller": name, **found._asdict()})
            if name == "in_frame":
                same = as_at_equal_samples(world, target, found.mean_count, seeds)
                rows[-1]["rmse_over_as_at_equal_samples"] = found.image_rmse / same
            else:
                rows[-1]["rmse_over_as_at_equal_samples"] = float("nan")
    names = list(regret_policies(LINE))

    def cells(scenario: str, show) -> dict[str, str]:
        of = {row["controller"]: row for row in rows if row["scenario"] == scenario}
        return {"scenario": scenario} | {name: show(of[name]) for name in names}

    def regrets(row) -> str:
        return f"{row['regret']:.2f}, {row['regret_q95']:.2f}"

    def delivered(row) -> str:
        return f"{row['count_over_oracle']:.3f}, {row['delivered_over_target']:.3f}"

    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    write("regret", table(cells(s, regrets) for s in scenarios), columns_of(rows))
    write("attainment", table(cells(s, delivered) for s in scenarios))
    equal = (
        {"scenario": row["scenario"], "rmse of in_frame / as": f"{row['rmse_over_as_at_equal_samples']:.3f}"}
        for row in rows
        if row["controller"] == "in_frame"
    )
    write("equal samples", table(equal))
    conditions = f"4,000 seeds of the circle, 24 of lines of {TEXELS} texels, frames 51 to {FRAMES}."
    write("regret conditions", f"{interleaved.machine()}. {conditions}")


def as_at_equal_samples(world, target: Target, count: float, seeds: int) -> float:
    """Root mean square error of adaptive sampling whose target makes it draw as many samples."""
    counts, errors = [], []
    for factor in 2.0 ** np.arange(-1, 13, 0.5):
        # An array, so that one program serves all targets.
        variance = np.float32(target.variance * factor)
        policy = policies.named("as", target_variance=jax.numpy.asarray(variance))
        found = measure.summarize(simulate(world, policy, target, max(4, seeds // 4), seed=7))
        counts.append(found.mean_count)
        errors.append(found.image_rmse)
        if found.mean_count < count:
            break
    return float(np.interp(count, counts[::-1], errors[::-1]))


# --- tuning


def tune_worlds() -> dict[str, driver.World]:
    lights = {name: LIGHTS[name] for name in ("static", "sine 5 Hz, to 0", "candle")}
    worlds: dict[str, driver.World] = {
        f"ramp, {name}": lit_line(line.ramp, intensity, texels=128) for name, intensity in lights.items()
    }
    return worlds | {"step, on/off 1 Hz": lit_line(line.step, LIGHTS["on/off 1 Hz"], texels=128)}


def study_tune(candidates: int = 512) -> None:
    worlds, rows, fronts = tune_worlds(), [], {}
    for name in tune.CONSTANTS:
        drawn = tune.draw(name, candidates, seed=3)
        found = tune.evaluate(jax.random.key(11), worlds, LINE, name, drawn)
        kept = tune.front(found.samples, found.error)
        best = {key: values[kept] for key, values in drawn.items()}
        # With other seeds: what was chosen for luck loses it here.
        fronts[name] = tune.evaluate(jax.random.key(12), worlds, LINE, name, best, seeds=8)
        for i in range(len(kept)):
            constants = {key: float(values[i]) for key, values in best.items()}
            figures = {"samples": fronts[name].samples[i], "error": fronts[name].error[i]}
            constants = {key: constants.get(key, float("nan")) for key in tune.RANGES}
            rows.append({"controller": name, **figures, **constants})
    levels = (0.8, 0.9, 1.0, 1.1, 1.2, 1.4)
    shown = (
        {"tuned": name} | {f"{level:g}": f"{tune.samples_at(found, level):.2f}" for level in levels}
        for name, found in fronts.items()
    )
    write("tune", table(shown), columns_of(rows))
    presets = preset_points(worlds)
    marked = ({"preset": n, "samples": f"{s:.2f}", "error": f"{e:.2f}"} for n, (s, e) in presets.items())
    write("presets", table(marked))
    text = f"{candidates} candidates of each controller, 2 seeds; the front again with 8 others."
    write("tune conditions", f"{interleaved.machine()}. {text}")
    draw_fronts(fronts, presets)


def preset_points(worlds) -> dict[str, tuple[float, float]]:
    """Samples and error of controllers with the constants they are published with, at the wanted variance."""
    points = {}
    for name, factor in (*((name, 1.0) for name in ("as", "ocv", "ccv", "in_frame", "unreal")), ("as", 10.0)):
        constants = {"target_variance": np.array([factor])}
        found = tune.evaluate(jax.random.key(12), worlds, LINE, name, constants, seeds=8)
        label = name if factor == 1 else "as, target 1e-3 (2020)"
        points[label] = (float(found.samples[0]), float(found.error[0]))
    return points


def draw_fronts(fronts: dict[str, tune.Candidates], presets: dict[str, tuple[float, float]]) -> None:
    figure, axes = plt.subplots(figsize=(8, 5), dpi=100, layout="constrained")
    for name, found in fronts.items():
        order = np.argsort(found.samples)
        axes.plot(
            found.samples[order],
            found.error[order],
            "o-",
            color=COLOURS[name],
            ms=3,
            lw=1,
            label=f"{name}, tuned",
        )
    for (name, (samples, error)), marker in zip(presets.items(), "sD^v*P", strict=True):
        axes.plot(
            samples,
            error,
            marker,
            color="#111111",
            ms=8,
            label=f"{name}, as published" if name != "in_frame" else "in_frame, defaults",
        )
    axes.axhline(1, color="#222222", ls=":", lw=1)
    axes.axvline(1, color="#222222", ls=":", lw=1)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="mean samples / oracle's",
        ylabel="deviation that 95 % keep / wanted",
    )
    ticks = (0.5, 0.7, 1, 1.4, 2, 3, 4)
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks], minor=False)
    axes.set_yticks((0.7, 0.8, 1, 1.2, 1.5, 2, 3), ["0.7", "0.8", "1", "1.2", "1.5", "2", "3"], minor=False)
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=8, loc="lower left")
    figure.savefig(DOCS / "images" / "scenarios_tune.png", metadata={"Software": None})


# --- too few samples


def study_under(seeds: int = 24) -> None:
    rows = []
    for scenario in ("ramp, sine 1 Hz", "step, sine 1 Hz", "step, static"):
        profile, lit = scenario.split(", ")
        world = lit_line(getattr(line, profile), LIGHTS[lit])
        for name, policy in under_policies().items():
            share = shortfall(world, policy, seeds)
            found = measure.summarize(simulate(world, policy, LINE, seeds, seed=3))
            rows.append({"scenario": scenario, "controller": name, "short": share, **found._asdict()})
    names = list(under_policies())

    def cell(scenario, name) -> str:
        row = next(r for r in rows if (r["scenario"], r["controller"]) == (scenario, name))
        return f"{row['short']:.1%}, {row['delivered_over_target']:.2f}, {row['count_over_oracle']:.2f}"

    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    shown = ({"controller": name} | {s: cell(s, name) for s in scenarios} for name in names)
    write("under", table(shown), columns_of(rows))
    write(
        "under conditions",
        f"{interleaved.machine()}. {seeds} seeds of {TEXELS} texels, frames 51 to {FRAMES}.",
    )


def under_policies() -> dict[str, policies.Policy]:
    made: dict[str, policies.Policy] = {"as": policies.named("as")}
    online = policies.named("ocv")
    for offset in (0.0, 0.5, 1.0, 2.0, 8.0):
        made[f"ocv, a_0 = {offset:g}"] = eqx.tree_at(lambda p: p.config.bound_offset, online, offset)
    for name in ("as", "ocv", "in_frame"):
        policy = policies.named(name)
        made |= {name: policy} if name == "in_frame" else {}
        made[f"{name}, median of 3"] = policies.MedianFiltered(policy)
    return made


def shortfall(world, policy, seeds: int) -> float:
    """Share of those that need more than the least count and get less than half of what they need."""
    needed = measure.oracle_count(world.sample_variance[measure.STEADY :], LINE)
    short, asked = 0, 0
    for record in driver.chunks(jax.random.key(3), world, policy, seeds=seeds):
        count = record.count[:, measure.STEADY :]
        wanted = np.broadcast_to(needed > LINE.min_spp, count.shape)
        short += int((wanted & (count < needed / 2)).sum())
        asked += int(wanted.sum())
    return short / asked


# --- pictures of single simulations


def study_pictures() -> None:
    images = DOCS / "images"
    policy = policies.named("spvg", target_variance=CIRCLE.variance, kappa=0.0)
    found, record = writing.simulate(circle.uniform(FRAMES), policy, CIRCLE, seeds=2000, start="cold")
    title = "The 2020 controller on the circle, kappa 0, cold start"
    (images / "scenarios_circle.png").write_bytes(plot.circle(found, title=title, one=record.value[0]))
    x, intensity = line.centres(TEXELS, LENGTH), light.sine(120)
    world = lit_line(line.ramp, intensity)
    for name, title in (("as", "Adaptive sampling"), ("in_frame", "The in-frame controller")):
        found = simulate(world, policies.named(name), LINE, 16, first=0)
        picture = plot.line(
            found, title=f"{title} on the ramp under a sine", x=x, light=line.ramp(x), intensity=intensity
        )
        (images / f"scenarios_line_{name}.png").write_bytes(picture)
    key = jax.random.key(0)
    entries = {lit: batch_mean.table(key, lit, seeds=1000) for lit in batch_mean.LIGHTS}
    streams = {lit: batch_mean.simulate(jax.random.key(5), lit) for lit in batch_mean.LIGHTS}
    (images / "scenarios_batch_mean.png").write_bytes(plot.batch_mean(entries, streams))


STUDIES = {
    "pictures": study_pictures,
    "circle": study_circle,
    "line": study_line,
    "regret": study_regret,
    "tune": study_tune,
    "under": study_under,
}


def main() -> None:
    for name in sys.argv[1:] or STUDIES:
        STUDIES[name]()


if __name__ == "__main__":
    main()
