"""Sample counts under steady light, seen through cameras that are jittered within the pixel."""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from frames_data import FOLDER, save, scene, table, write
from frames_moving import TARGET, Film, flash
from frames_sequences import ALPHA, BOUNDS, COLOURS, FIRST, KAPPA, PAGE, halves, policy

from sssfit.estimators import control_variate, policies, sample_count
from sssfit.frames import compare, gbuffer, sequence, taa
from sssfit.frames.gbuffer import Frame

#: Frames of a round of jitter; rounds until the last, which is measured: more for slow covariances.
ROUND, ROUNDS, MANY_ROUNDS = 8, 6, 30
#: The fine image has so many pixels to a pixel's side.
FINE = 3
#: Pixels are overestimated whose count exceeds the one without jitter by this factor.
OVER = 1.25
#: The share of pixels within which the light varies most.
VARIED = 0.1
EPSILONS, SLOW, WIDE = (1e-6, 1e-5, 1e-4, 1e-3), 0.005, 1000.0
FAST = control_variate.ONLINE.alpha
#: Bound of the coefficient and weight of the covariance: the paper's and ours; the dissertation's.
VARIANTS = ((1.0, FAST), (WIDE, FAST), (WIDE, SLOW))
GAMMAS = (1.0, 2.2)


# --- frames


@functools.cache
def fine() -> tuple[Frame, dict[int, Any]]:
    """The head in nine times as many pixels, each sampled at its centre."""
    folder = FOLDER / "s2_head"
    layers = {"irradiance": "E", "albedo": None}
    frame = gbuffer.load(folder / "gbuffer_1080p.exr", folder / "camera.json", layers=layers)
    head = (np.asarray(frame.profile_id) == 1).astype(np.int32)
    return frame._replace(profile_id=head), {1: scene("s2_head", "skin1").d}


def places(index: int) -> tuple[int, int]:
    """Which fine pixel of its square a frame sees: the one that the jittered place is in."""
    x, y = (float(v) + 0.5 for v in taa.jitter(index, ROUND))
    # Places on the edge of two belong to the next.
    return int(FINE * x + 1e-5), int(FINE * y + 1e-5)


def seen(column: int, row: int) -> Frame:
    """The frame of a camera that looks at one fine pixel of each square."""
    frame, _ = fine()
    x, y = ((k + 0.5) / FINE - 0.5 for k in (column, row))
    camera = frame.camera
    camera = dataclasses.replace(
        camera, width=camera.width // FINE, height=camera.height // FINE,
        fx=camera.fx / FINE, fy=camera.fy / FINE, cx=camera.cx / FINE - x, cy=camera.cy / FINE - y,
    )  # fmt: skip
    layers = {
        name: jnp.asarray(np.asarray(getattr(frame, name))[row::FINE, column::FINE])
        for name in ("irradiance", "depth", "normal", "profile_id")
    }
    return frame._replace(camera=camera, **layers)


@functools.cache
def film(jittered: bool) -> Film:
    """A round; the mask is that of pixels which are the head's wherever they are looked at."""
    _, profiles = fine()
    shown = [places(k) if jittered else (FINE // 2, FINE // 2) for k in range(ROUND)]
    known = {place: seen(*place) for place in set(shown)}
    many = {place: halves(frame, profiles, 0) for place, frame in known.items()}
    frames = [known[place] for place in shown]
    return Film(frames, profiles, [everywhere()] * ROUND, [many[place] for place in shown])


@functools.cache
def everywhere() -> np.ndarray:
    return np.all(squares(np.asarray(fine()[0].profile_id) == 1), axis=-1)


def squares(values: np.ndarray) -> np.ndarray:
    """The nine fine pixels of each, along a last axis."""
    height, width = values.shape
    cut = values.reshape(height // FINE, FINE, width // FINE, FINE)
    return np.moveaxis(cut, 1, 2).reshape(height // FINE, width // FINE, FINE**2)


def varied() -> np.ndarray:
    """Pixels of the head within which the light varies most."""
    light = np.asarray(sequence.luminance(fine()[0].irradiance))
    spread = squares(light).std(axis=-1)
    return everywhere() & (spread >= np.quantile(spread[everywhere()], 1 - VARIED))


# --- runs


class Run(NamedTuple):
    """Mean count of each frame; of the last round each pixel's mean count, PSNR, new pixels, memories."""

    course: np.ndarray
    counts: np.ndarray
    psnr: float
    new: float
    memories: list[Any]


def run(of: Film, chosen: Any, rounds: int = ROUNDS, **options: Any) -> Run:
    config = sequence.Config(chosen, of.profiles, **options)
    mask = of.masks[0]
    course, last, psnr, new, memories = [], [], [], [], []
    for state, image, info in sequence.scan([*of.frames] * rounds, config):
        counts, k = np.asarray(info.counts), (state.number - 1) % ROUND
        course.append(counts[mask].mean())
        if state.number > (rounds - 1) * ROUND:
            last.append(counts)
            psnr.append(compare.compare(image, *of.many[k], mask).psnr)
            new.append(np.asarray(info.missing)[np.asarray(of.frames[k].profile_id) == 1].mean())
            memories.append(state.memory)
    return Run(np.array(course), np.mean(last, axis=0), float(np.mean(psnr)), float(np.mean(new)), memories)


def study_jitter() -> None:
    still, moved, mask, edges = film(False), film(True), everywhere(), varied()
    rows, courses, new = [], {}, 0.0
    for name in COLOURS:
        chosen = policy(name, TARGET)
        before, again, after = run(still, chosen), run(still, chosen, seed=1), run(moved, chosen)
        courses[name], new = (before.course, after.course), after.new
        rows.append(
            {
                "policy": name,
                "mean count, still": f"{before.counts[mask].mean():.1f}",
                "jittered": f"{after.counts[mask].mean():.1f}",
                "where light varies, still": f"{before.counts[edges].mean():.1f}",
                "there, jittered": f"{after.counts[edges].mean():.1f}",
                "overestimated, %": f"{over(before, after, mask):.1f}",
                "by chance, %": f"{over(before, again, mask):.1f}",
                "PSNR, still, dB": f"{before.psnr:.2f}",
                "PSNR, jittered, dB": f"{after.psnr:.2f}",
            }
        )
        print(rows[-1], flush=True)
    text = (
        f"Of the head's pixels in a jittered frame, {100 * new:.1f} % have no history; none without jitter."
    )
    write("jitter", table(rows) + "\n\n" + text, PAGE)
    draw(courses, study_epsilon())


def over(before: Run, after: Run, mask: np.ndarray) -> float:
    """Per cent of the pixels."""
    return 100 * float((after.counts > OVER * before.counts)[mask].mean())


# --- the coefficient's epsilon


def online(epsilon: float, bound: float, alpha: Any) -> policies.Adaptive:
    controller = sample_count.Controller(TARGET, ALPHA, KAPPA, *BOUNDS)
    return policies.Adaptive(
        control_variate.Config(controller, alpha=alpha, epsilon=epsilon, bound_offset=bound)
    )


def study_epsilon() -> dict[tuple[float, float, Any], list[float]]:
    """Counts with jitter by epsilon, for each gamma, bound and weight."""
    found: dict[tuple[float, float, Any], list[float]] = {}
    rows = []
    for gamma in GAMMAS:
        for bound, alpha in VARIANTS:
            for epsilon in EPSILONS:
                rows.append(epsilon_row(gamma, bound, alpha, epsilon))
                print(rows[-1], flush=True)
                found.setdefault((gamma, bound, alpha), []).append(float(rows[-1]["jittered"]))
        for name in ("as", "ccv"):
            before, after = (run(film(j), policy(name, TARGET), gamma=gamma) for j in (False, True))
            rows.append(row(gamma, name, before, after) | flashed(policy(name, TARGET), gamma))
            found[gamma, 0.0, name] = [float(rows[-1]["jittered"])]
    write("epsilon", table(rows, 2), PAGE)
    return found


def epsilon_row(gamma: float, bound: float, alpha: Any, epsilon: float) -> dict[str, str]:
    chosen = online(epsilon, bound, alpha)
    rounds = MANY_ROUNDS if alpha == SLOW else ROUNDS
    before, after = (run(film(j), chosen, rounds, gamma=gamma) for j in (False, True))
    free = np.array([coefficients(memory.moments, epsilon) for memory in after.memories])
    low, high = np.quantile(free[-1], (0.1, 0.9))
    return (
        row(gamma, "ocv", before, after)
        | flashed(chosen, gamma)
        | {
            "a_0": f"{bound:g}",
            "weight": f"{alpha:g}",
            "epsilon": f"{epsilon:.0e}".replace("e-0", "e-"),
            "coefficient, 10 to 90 %": f"{low:.2f} to {high:.2f}",
            "its change in a round": f"{free.std(axis=0).mean():.3f}",
        }
    )


def flashed(chosen: Any, gamma: float) -> dict[str, str]:
    """Mean count under the light that flashes."""
    frames, _, profiles = flash()
    config = sequence.Config(chosen, profiles, gamma=gamma)
    drawn = [
        np.asarray(info.counts)[np.asarray(frame.profile_id) == 1].mean()
        for frame, (_, _, info) in zip(frames, sequence.scan(frames, config), strict=True)
    ]
    return {"count under the flash": f"{np.mean(drawn[FIRST:]):.1f}"}


def coefficients(moments: control_variate.Moments, epsilon: float) -> np.ndarray:
    """As they are without an upper bound."""
    found = control_variate.coefficient(moments.matrix, epsilon=epsilon, bound=np.inf)
    return np.asarray(found)[everywhere()]


def row(gamma: float, name: str, before: Run, after: Run) -> dict[str, str]:
    mask = everywhere()
    names = ("a_0", "weight", "epsilon", "coefficient, 10 to 90 %", "its change in a round")
    found = {"gamma": f"{gamma:g}", "policy": name} | dict.fromkeys(names, "")
    found["still"] = f"{before.counts[mask].mean():.1f}"
    found["jittered"] = f"{after.counts[mask].mean():.1f}"
    found["overestimated, %"] = f"{over(before, after, mask):.1f}"
    found["PSNR, jittered, dB"] = f"{after.psnr:.2f}"
    return found


def draw(courses: dict[str, Any], counts: dict[tuple[float, float, Any], list[float]]) -> None:
    figure, axes = plt.subplots(1, 3, figsize=(12.5, 4.2), dpi=100, layout="constrained")
    for name, (before, after) in courses.items():
        axes[0].plot(before, color=COLOURS[name], lw=1, ls=":")
        axes[0].plot(after, color=COLOURS[name], lw=1.4, label=name)
    axes[0].set(title="dotted: without jitter", xlabel="frame", ylabel="samples per pixel")
    lines = dict(zip(VARIANTS, ("#d55e00", "#e69f00", "#56b4e9"), strict=True))
    for each, gamma in zip(axes[1:], GAMMAS, strict=True):
        for (bound, alpha), colour in lines.items():
            label = f"ocv, a_0 = {bound:g}, weight {alpha:g}"
            each.plot(EPSILONS, counts[gamma, bound, alpha], color=colour, marker="o", ms=4, label=label)
        for name in ("as", "ccv"):
            each.axhline(counts[gamma, 0.0, name][0], color=COLOURS[name], lw=1, ls="--", label=name)
        each.set(title=f"jittered, gamma {gamma:g}", xlabel="epsilon", xscale="log")
    for each in axes:
        each.grid(color="0.93")
        each.set_axisbelow(True)
        each.set_ylim(0, 1.08 * BOUNDS[1])
        where = {"loc": "lower right", "ncols": 3} if each is axes[0] else {"loc": "upper right"}
        each.legend(frameon=False, fontsize=8, **where)
    save(figure, "jitter")


STUDIES = {"jitter": study_jitter}
