"""What a frame costs: the cost model fitted on some frames, and its error on others.

The points of the fit are frames of several sizes, profiles of several widths and maps of counts, by several
techniques. What tests it is another frame, or the user's, with the counts that its own variance asks for;
none of that is used for fitting. All take turns in the same rounds.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from sssfit.frames import adaptive, procedural, render, scatter
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.frames.scene_profiles import Profiles
from sssfit.trade import cost_model, demands, timing
from sssfit.trade.choice import CannotMeasure
from sssfit.trade.cost_model import Model
from sssfit.trade.demands import Demand
from sssfit.trade.groups._frames import needs_pixels
from sssfit.trade.measure import Tell, side_by_side
from sssfit.trade.picture import as_png, plain_ticks
from sssfit.trade.setting import Setting, skin
from sssfit.trade.study import Finding, Study

#: Most samples of a pixel, in all points: other numbers need programs of their own.
MOST, LEAST, _PILOT = 64, 4, 8
_SIZES, _QUICK_SIZES = ((320, 180), (640, 360), (1280, 720)), ((320, 180), (480, 270))
_WIDTHS, _QUICK_WIDTHS = (0.25, 1.0, 4.0), (0.25, 4.0)
_TECHNIQUES = {
    "distance to the surface": {},
    "distance in the plane": {"distance": "plane"},
    "fresh points": {"points": "fresh"},
    "ratio": {"estimator": "ratio"},
}
_QUICK_TECHNIQUES = ("distance to the surface", "distance in the plane")
# A first look takes one for which programs are there.
_UNSEEN_SIZE, _QUICK_UNSEEN_SIZE = (960, 540), (320, 180)
_ERRORS_OF_FIT = "median_error_fitted", "median_error_frame_left_out"
#: Mean variance over target: how many samples a pixel of mean variance gets.
_ASKED = {"adaptive, 12 wanted": 12, "adaptive, 32 wanted": 32}


@dataclass(frozen=True)
class Point:
    """A frame with a map of counts, by one technique.

    Attributes:
        frame_name, counts_name, technique: what it is.
        is_fitted: False for what tests the fit.
        run: scatters it.
        demand: of its passes.
    """

    frame_name: str
    counts_name: str
    technique: str
    is_fitted: bool
    run: Any
    demand: Demand

    @property
    def name(self) -> str:
        """Unique among the points."""
        return f"{self.frame_name}, {self.counts_name}, {self.technique}"


def _measure(setting: Setting, rounds: int, tell: Tell) -> Finding:
    needs_pixels(setting)
    if jax.default_backend() != "cpu":
        raise CannotMeasure("it is known of CPUs alone what their caches hold")
    sizes = _QUICK_SIZES if setting.is_quick else _SIZES
    parts = [functools.partial(_fitted, setting, size, tell) for size in sizes]
    points = [point for part in side_by_side([*parts, lambda: _unseen(setting, tell)]) for point in part]
    tell(f"cost_model: times of {len(points)} points, {rounds} rounds")
    # Of rounds in which a busy machine slows all alike.
    times = timing.measure({point.name: point.run for point in points}, rounds, pause=0.01)
    seconds = {name: float(np.median(values)) for name, values in times.items()}
    return _finding(points, seconds)


def _techniques(setting: Setting) -> dict[str, Settings]:
    names = _QUICK_TECHNIQUES if setting.is_quick else tuple(_TECHNIQUES)
    return {name: setting.settings._replace(**_TECHNIQUES[name]) for name in names}


def _fitted(setting: Setting, size: tuple[int, int], tell: Tell) -> list[Point]:
    """The points of the fit in frames of a width and height."""
    points, (width, height) = [], size
    frame = procedural.frame(width=width, height=height)
    if setting.frame.normal is None:
        frame = frame._replace(normal=None)
    maps = _maps(np.asarray(frame.profile_id) > 0, setting.is_quick)
    for wider in _QUICK_WIDTHS if setting.is_quick else _WIDTHS:
        name = f"{width} x {height}, d x {wider:g}"
        profiles = {procedural.BALL: wider * skin(), procedural.BOARD: None}
        points += _points(name, True, frame, profiles, maps, _techniques(setting), tell)
    return points


def _unseen(setting: Setting, tell: Tell) -> list[Point]:
    """The user's frame, or another one in which the board scatters, too."""
    frame, name = setting.frame, setting.frame_name
    profiles: Profiles = setting.profiles
    if setting.is_procedural:
        width, height = _QUICK_UNSEEN_SIZE if setting.is_quick else _UNSEEN_SIZE
        frame = procedural.frame(15, width=width, height=height)
        profiles = {procedural.BALL: skin(), procedural.BOARD: 3 * skin()}
    mask = render.scatters(frame, profiles)
    variance = scatter.variance_of_samples(
        frame, profiles, counts=_PILOT, settings=setting.settings, seed=render.LARGEST_SEED
    )
    ids = np.where(mask, np.asarray(frame.profile_id), 0)
    variance = adaptive.smoothed(variance, ids, render.SMOOTHING)
    mean = float(np.mean(variance[mask]))
    maps = {
        name: np.where(mask, adaptive.counts(variance, mean / wanted, LEAST, MOST), 0)
        for name, wanted in _ASKED.items()
    }
    size = f"{name}, {frame.depth.shape[1]} x {frame.depth.shape[0]}"
    return _points(size, False, frame, profiles, maps, _techniques(setting), tell)


def _maps(there: np.ndarray, is_quick: bool) -> dict[str, np.ndarray]:
    """Counts that are alike, rise across the frame, or differ from pixel to pixel."""
    height, width = there.shape
    rising = np.broadcast_to(np.linspace(LEAST, MOST, width).astype(int), there.shape)
    chance = np.random.default_rng(0).integers(LEAST, MOST + 1, there.shape)
    maps: dict[str, Any] = {f"{n} samples": n for n in ((8, MOST) if is_quick else (8, 24, MOST))}
    maps |= {"rising": rising, "random": chance}
    return {name: np.where(there, counts, 0) for name, counts in maps.items()}


def _points(
    name: str,
    is_fitted: bool,
    frame: Frame,
    profiles: Mapping[int, Any],
    maps: Mapping[str, np.ndarray],
    techniques: Mapping[str, Settings],
    tell: Tell,
) -> list[Point]:
    tell(f"cost_model: {name}, caches")
    by_id = {i: demands.fetched(frame, i, d) for i, d in profiles.items() if d is not None}
    points = []
    for technique, settings in techniques.items():
        for counts_name, counts in maps.items():

            def run(counts=counts, settings=settings):
                options: dict[str, Any] = {"counts": counts, "settings": settings, "most": MOST}
                return jax.block_until_ready(scatter.every_profile(frame, profiles, **options))

            demand = demands.of_frame(frame, profiles, counts, settings, by_id)
            points.append(Point(name, counts_name, technique, is_fitted, run, demand))
        tell(f"cost_model: {name}, {technique}")
        points[-1].run()
    return points


def _finding(points: list[Point], seconds: Mapping[str, float]) -> Finding:
    fitted = [point for point in points if point.is_fitted]
    model = _model(fitted, seconds)
    rows = []
    for point in points:
        found, measured = model.seconds(point.demand, point.technique), seconds[point.name]
        use = "fitted" if point.is_fitted else "unseen"
        rows.append(
            {"frame": point.frame_name, "counts": point.counts_name, "technique": point.technique}
            | {"used": use, "measured, ms": 1e3 * measured, "model, ms": 1e3 * found}
            | {"error, %": 100 * (found / measured - 1)}
            | {name: float(value) for name, value in point.demand._asdict().items()}
        )
    unseen = [abs(row["error, %"]) for row in rows if row["used"] == "unseen"]
    among = [abs(row["error, %"]) for row in rows if row["used"] == "fitted"]
    left_out = _left_out(fitted, seconds)
    facts = {
        "weights_seconds": model.weights,
        "technique_seconds": model.techniques,
        "largest_error_unseen": max(unseen) / 100,
        "median_error_unseen": float(np.median(unseen)) / 100,
        "median_error_fitted": float(np.median(among)) / 100,
        "median_error_frame_left_out": float(np.median(left_out)),
    }
    return Finding((_sentence(facts), *_in_words(model)), tuple(rows), facts)


def _model(points: list[Point], seconds: Mapping[str, float]) -> Model:
    return cost_model.fit(
        [point.demand for point in points],
        [point.technique for point in points],
        [seconds[point.name] for point in points],
    )


def _left_out(points: list[Point], seconds: Mapping[str, float]) -> list[float]:
    """Relative errors of each frame's points by the model of all other frames."""
    errors = []
    for name in dict.fromkeys(point.frame_name for point in points):
        model = _model([point for point in points if point.frame_name != name], seconds)
        for point in (point for point in points if point.frame_name == name):
            errors.append(abs(model.seconds(point.demand, point.technique) / seconds[point.name] - 1))
    return errors


def _sentence(facts: Mapping[str, float]) -> str:
    unseen, most, fitted, left_out = (
        facts[f"{name}"] for name in ("median_error_unseen", "largest_error_unseen", *_ERRORS_OF_FIT)
    )
    return (
        f"on the unseen frame off by {unseen:.0%} in the median and {most:.0%} at most; on those of the "
        f"fit by {fitted:.0%} in the median, and {left_out:.0%} where a frame is left out of it"
    )


def _in_words(model: Model) -> tuple[str, ...]:
    units = {
        "passes": "a pass {:.2g} ms", "frame_pixels": "a pixel of the frame {:.2g} ns",
        "pixels": "a sampled pixel {:.2g} ns", "from_second": "a byte from the second cache {:.2g} ns",
        "from_memory": "a byte from beyond {:.2g} ns",
    }  # fmt: skip
    scale = {name: 1e3 if name == "passes" else 1e9 for name in units}
    shared = [text.format(scale[name] * model.weights[name]) for name, text in units.items()]
    techniques = [f"a sample by {name} {1e9 * value:.2g} ns" for name, value in model.techniques.items()]
    return ("; ".join(shared), "; ".join(techniques))


def _picture(finding: Finding) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 6), dpi=110, layout="constrained")
    axes = figure.subplots()
    values = [float(row[name]) for row in finding.rows for name in ("measured, ms", "model, ms")]
    ends = np.array([0.8 * min(values), 1.25 * max(values)])
    axes.fill_between(ends, 0.75 * ends, 1.25 * ends, color="0.92", label="within 25 %")
    axes.plot(ends, ends, color="0.6", linewidth=1)
    for use, colour, marker in (("fitted", "#0072b2", "o"), ("unseen", "#d55e00", "D")):
        rows = [row for row in finding.rows if row["used"] == use]
        names = sorted({row["frame"] for row in rows})
        axes.plot(
            [row["measured, ms"] for row in rows], [row["model, ms"] for row in rows], marker, color=colour,
            markersize=5, markerfacecolor="none" if use == "fitted" else colour,
            label=f"{use}: {names[0] if len(names) == 1 else f'{len(names)} frames'}, {len(rows)} points",
        )  # fmt: skip
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    plain_ticks(axes.xaxis)
    plain_ticks(axes.yaxis)
    axes.set_xlabel("measured, ms per frame")
    axes.set_ylabel("by the model, ms per frame")
    axes.set_title(STUDY.title, fontsize=11)
    axes.grid(color="0.9", which="major")
    axes.set_axisbelow(True)
    axes.legend(fontsize=9, loc="upper left")
    return as_png(figure)


STUDY = Study(
    name="cost_model",
    title="What a frame costs, from its passes, pixels, samples and bytes",
    about="Weights that are not negative, with the least relative errors over the fitted frames; bytes from "
    "beyond a cache by replaying the samples through caches as large as this core's. The unseen frame and "
    "its adaptive counts are not used for fitting",
    measure=_measure,
    picture=_picture,
)
