"""What a scene needs: each feature of a pass switched, profile by profile, on the frame itself.

A feature is bought with time and pays in error. Both are of the pass of one profile, with as many samples as
the groups of frames have, and errors on that profile's pixels alone. The images with and without a feature
have the same random numbers, so that they differ by the feature. At last what the default has and what loses
least is left out together, feature after feature: what can be compiled away at which loss.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from sssfit.frames import scatter
from sssfit.frames._block import LUMINANCE
from sssfit.frames.points import Settings
from sssfit.trade import timing
from sssfit.trade.choice import CannotMeasure
from sssfit.trade.groups._frames import SPP
from sssfit.trade.measure import Tell, side_by_side
from sssfit.trade.picture import as_png, plain_ticks
from sssfit.trade.setting import Setting
from sssfit.trade.study import Finding, Study

_SEEDS, _QUICK_SEEDS = 8, 4
#: What the split and the prefilter are switched on with.
SPLIT, PREFILTER = 0.05, 1.0
#: What a scene can do without: up to so much more error, at the end of the loss' 95 % interval.
SMALL = 0.05


class Way(NamedTuple):
    """How a profile's pass is run.

    Attributes:
        settings: see `points.Settings`.
        tells_ids: whether light of other profiles is left out.
        has_shapes: whether each channel has a shape of its own, or all have the mean by luminance.
    """

    settings: Settings
    tells_ids: bool = True
    has_shapes: bool = True


class Feature(NamedTuple):
    """Something that a pass can do or leave.

    Attributes:
        name: what it is called.
        with_it, without: the ways to compare.
        is_default: whether the default does it.
    """

    name: str
    with_it: Way
    without: Way
    is_default: bool


class Trials(NamedTuple):
    """A way's errors and times.

    Attributes:
        errors: by seed, over the light's root mean square.
        seconds: by round.
    """

    errors: np.ndarray
    seconds: np.ndarray


def features(setting: Setting) -> list[Feature]:
    """What is switched on a setting's frame; the tangent plane only where there are normals.

    Args:
        setting: see `setting.Setting`.

    Example:
        >>> from sssfit.trade.setting import procedural_setting
        >>> [feature.name for feature in features(procedural_setting(True))][:2]
        ['3-D distance', 'profile ids']
    """
    base = Way(setting.settings)

    def changed(**fields: Any) -> Way:
        return Way(setting.settings._replace(**fields))

    found = [
        Feature("3-D distance", base, changed(distance="plane"), True),
        Feature("profile ids", base, base._replace(tells_ids=False), True),
        Feature("per-channel radii", base, changed(channels="widest"), True),
        Feature("per-channel shapes", base, base._replace(has_shapes=False), True),
        Feature("split", changed(points="fresh", split=SPLIT), changed(points="fresh"), False),
        Feature("prefilter", changed(prefilter=PREFILTER), base, False),
    ]
    if setting.frame.normal is not None:
        found.append(Feature("tangent plane", changed(plane="tangent"), base, False))
    return found


def without_all(some: Sequence[Feature]) -> Way:
    """The way that leaves several features of the default out.

    Args:
        some: features of one setting, at least one.

    Example:
        >>> from sssfit.trade.setting import procedural_setting
        >>> way = without_all(features(procedural_setting(True))[:2])
        >>> way.settings.distance, way.tells_ids
        ('plane', False)
    """
    base = some[0].with_it
    settings = base.settings
    for feature in some:
        own = feature.without.settings._asdict()
        settings = settings._replace(**{k: v for k, v in own.items() if v != getattr(base.settings, k)})
    return Way(
        settings,
        all(feature.without.tells_ids for feature in some),
        all(feature.without.has_shapes for feature in some),
    )


def _measure(setting: Setting, rounds: int, tell: Tell) -> Finding:
    if setting.pixels == 0:
        raise CannotMeasure("the frame has no pixel with a profile")
    ids = np.asarray(setting.frame.profile_id)
    rows: list[Mapping[str, Any]] = []
    sentences = []
    for number, d in setting.profiles.items():
        if d is None or not number or not (ids == number).any():
            continue
        if not np.any(setting.reference[ids == number]):
            sentences.append(f"profile {number}: not measured, it has no light")
            continue
        own = _of_profile(setting, number, d, rounds, tell)
        rows += own
        sentences.append(_sentence(own, number))
    if not rows:
        raise CannotMeasure("no profile of the frame has light")
    return Finding(tuple(sentences), tuple(rows), {"samples": SPP})


def _of_profile(setting: Setting, number: int, d: Any, rounds: int, tell: Tell) -> list[dict[str, Any]]:
    """The rows of each feature, and then those of what can be left out together."""
    every = features(setting)
    known: dict[Way, Trials] = {}
    _measure_ways(setting, number, d, {w for f in every for w in (f.with_it, f.without)}, known, rounds, tell)
    single = [_row(number, f.name, f.is_default, known[f.with_it], known[f.without]) for f in every]
    # What loses least is left out first.
    kept = [f for f in every if f.is_default]
    loss = {row["feature"]: row["loss"] for row in single}
    kept.sort(key=lambda feature: loss[feature.name])
    groups = [kept[: n + 1] for n in range(1, len(kept))]
    ways = [without_all(group) for group in groups]
    _measure_ways(setting, number, d, {every[0].with_it, *ways}, known, rounds, tell)
    chain = [
        _row(number, " + ".join(f.name for f in group), True, known[every[0].with_it], known[way])
        for group, way in zip(groups, ways, strict=True)
    ]
    return [*single, *chain]


def _measure_ways(setting, number, d, ways, known, rounds, tell) -> None:
    """Errors once, and times in turns."""
    seeds = _QUICK_SEEDS if setting.is_quick else _SEEDS
    ordered = sorted(ways, key=str)
    tell(f"scene_needs: profile {number}, errors of {len(ordered)} ways")
    new = [way for way in ordered if way not in known]
    found = side_by_side([functools.partial(_errors, setting, number, d, way, seeds) for way in new])
    for way, errors in zip(new, found, strict=True):
        known[way] = Trials(errors, np.empty(0))
    tell(f"scene_needs: profile {number}, times, {rounds} rounds")
    programs = {str(i): lambda way=way: _image(setting, number, d, way, 0) for i, way in enumerate(ordered)}
    times = timing.measure(programs, rounds, pause=0.02)
    for i, way in enumerate(ordered):
        known[way] = known[way]._replace(seconds=times[str(i)])


def _image(setting: Setting, number: int, d: Any, way: Way, seed: int) -> jax.Array:
    frame = setting.frame
    ids = jnp.asarray(frame.profile_id)
    shapes = np.asarray(d, float)
    if not way.has_shapes:
        shapes = np.full(len(shapes), np.average(shapes, weights=LUMINANCE[: len(shapes)]))
    found = scatter.scatter(
        frame.irradiance, frame.depth, frame.camera, d=shapes, counts=jnp.where(ids == number, SPP, 0),
        mask=ids == number if way.tells_ids else ids != 0, normal=frame.normal, settings=way.settings,
        most=SPP, seed=seed,
    )  # fmt: skip
    return jax.block_until_ready(found)


def _errors(setting: Setting, number: int, d: Any, way: Way, seeds: int) -> np.ndarray:
    own = np.asarray(setting.frame.profile_id) == number
    reference = setting.reference[own].astype(np.float64)
    power = np.mean(np.square(reference))
    images = (np.asarray(_image(setting, number, d, way, seed))[own] for seed in range(seeds))
    return np.array([np.sqrt(np.mean(np.square(image - reference)) / power) for image in images])


def _row(number: int, name: str, is_default: bool, with_it: Trials, without: Trials) -> dict[str, Any]:
    loss = without.errors - with_it.errors
    # Half a 95 % interval of the mean over seeds.
    noise = stats.t.ppf(0.975, len(loss) - 1) * np.std(loss, ddof=1) / np.sqrt(len(loss))
    low, ratio, high = timing.median_and_interval(with_it.seconds / without.seconds)
    row = {
        "profile": number,
        "feature": name,
        "in the default": "yes" if is_default else "no",
        "error with": float(with_it.errors.mean()),
        "error without": float(without.errors.mean()),
        "loss": float(loss.mean()),
        "loss, ±": float(noise),
        "time with / without": ratio,
        "from": low,
        "to": high,
    }
    return row | {"verdict": _verdict(row)}


def _verdict(row: Mapping[str, Any]) -> str:
    loss, noise, error, slower = (
        row[key] for key in ("loss", "loss, ±", "error with", "time with / without")
    )
    undecided = f"undecided: a loss of {loss / error:.0%} ± {noise / error:.0%}"
    if row["in the default"] == "no":
        if loss > noise:
            return f"buys {loss / row['error without']:.0%} of the error for {slower:.2g} x the time"
        if loss < -noise:
            return "makes the error larger here"
        return "buys nothing here" if loss + noise <= SMALL * error else undecided
    if loss < -noise:
        return f"can be compiled away: {-loss / error:.0%} less error without"
    most = (loss + noise) / error
    if most <= SMALL:
        return f"can be compiled away: a loss of {max(loss, 0) / error:.1%}, at most {most:.1%}"
    if loss > noise:
        return f"without: {1 + loss / error:.3g} x the error, {1 / slower:.2g} x the time"
    return undecided


def _sentence(rows: Sequence[Mapping[str, Any]], number: int) -> str:
    free = [row for row in rows if row["verdict"].startswith("can be compiled away")]
    if not free:
        return f"profile {number}: needs all that the default does"
    # The longest of the chain is what can go at once.
    best = max(free, key=lambda row: row["feature"].count(" + "))
    faster = 1 / best["time with / without"]
    return f"profile {number}: {best['feature']} {best['verdict']}, {faster:.2g} x the time"


def _picture(finding: Finding) -> bytes:
    from matplotlib.figure import Figure

    rows = list(finding.rows)
    figure = Figure(figsize=(11, 1.6 + 0.38 * len(rows)), dpi=110, layout="constrained")
    losses, times = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(rows))[::-1]
    for place, row in zip(places, rows, strict=True):
        colour = "#d55e00" if row["in the default"] == "yes" else "#0072b2"
        one = 100 / row["error with"]
        losses.errorbar(one * row["loss"], place, xerr=one * row["loss, ±"], fmt="o", color=colour, capsize=2)
        ratio = row["time with / without"]
        reach = [[max(ratio - row["from"], 0)], [max(row["to"] - ratio, 0)]]
        times.errorbar(ratio, place, xerr=reach, fmt="o", color=colour, capsize=2)
    losses.set_yticks(places, [f"{row['profile']}: {row['feature']}" for row in rows], fontsize=8)
    losses.axvline(0, color="0.6", linewidth=1)
    losses.set_xscale("symlog", linthresh=10)
    losses.set_xticks([-100, -30, -10, 0, 10, 30, 100, 300], minor=False)
    losses.xaxis.set_major_formatter("{x:g}")
    losses.set_xlabel("more error without it, % (bars: 95 %)")
    times.axvline(1, color="0.6", linewidth=1)
    times.set_xscale("log")
    plain_ticks(times.xaxis)
    times.set_xlabel("time with over time without")
    for axes in (losses, times):
        axes.grid(color="0.92")
        axes.set_axisbelow(True)
    figure.suptitle(f"{STUDY.title} (orange: in the default, blue: not)", fontsize=11)
    return as_png(figure)


STUDY = Study(
    name="scene_needs",
    title="What each feature buys on this frame, profile by profile",
    about=f"Passes with {SPP} samples with and without a feature, with the same random numbers. The loss is "
    "the error without less the error with it; both are root mean square errors over the profile's pixels, "
    "over that of the light. Lines that join features with + leave them all out",
    measure=_measure,
    picture=_picture,
)
