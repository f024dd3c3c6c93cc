"""Sequences whose light and geometry move, made of the rendered scenes."""

import functools
import json
import random
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from frames_data import save, scene, table, write
from frames_sequences import BOUNDS, COLOURS, FIRST, FLASH, FRAMES, LIT, PAGE, halves, policy
from interleaved import PAUSE

from sssfit.frames import compare, gbuffer, scene_profiles, sequence, temporal
from sssfit.frames.gbuffer import Frame

TARGET = 1e-3
#: Frames of the flash in one period: the light is on in the first half of each.
PERIOD = 12
#: From this count of the oracle's on a pixel is one that needs many.
HARD = 48
#: Upright bars across the light: their width, distance and soft edge, and the way of a frame, mm.
BAR, BARS, SOFT, WAY = 40.0, 120.0, 10.0, 5.0
#: Times are the shortest of so many runs of a sequence.
ROUNDS = 3
STILL_FRAMES = 33


class Film(NamedTuple):
    """Frames, and for each the pixels that scatter and an image of many samples: its mean, its halves'."""

    frames: Sequence[Frame]
    profiles: dict[int, Any]
    masks: list[np.ndarray]
    many: list[tuple[np.ndarray, np.ndarray]]

    @property
    def brightest(self) -> float:
        return max(sss[mask].max() for (sss, _), mask in zip(self.many, self.masks, strict=True))


# --- the films


def film(frames: Sequence[Frame], profiles: dict[int, Any]) -> Film:
    masks = [np.asarray(frame.profile_id) == 1 for frame in frames]
    return Film(
        frames, profiles, masks, [halves(frame, profiles, number) for number, frame in enumerate(frames)]
    )


@functools.cache
def flash() -> tuple[list[Frame], np.ndarray, dict[int, Any]]:
    """The frames as they are, how bright the light of each is, and their profiles."""
    profiles = scene_profiles.by_id(FLASH / "camera.json", "skin1", FLASH / "exact_skin1_00.exr")
    known = json.loads((FLASH / "camera.json").read_text())["frames"]
    frames = [
        gbuffer.load(FLASH / f"frame_{k:02d}.exr", FLASH / "camera.json", layers={"albedo": None})
        for k in range(FRAMES)
    ]
    return frames, np.array([known[k]["intensity"] for k in range(FRAMES)]), profiles


@functools.cache
def flashing() -> Film:
    frames, _, profiles = flash()
    return film(frames, profiles)


def on_and_off() -> Film:
    """The light at its brightest or none; frames without light are dark in either."""
    frames, light, profiles = flash()
    factors = [2 / light[k] if k % PERIOD < PERIOD // 2 else 0.0 for k in range(FRAMES)]
    return film([lit(frame, factor) for frame, factor in zip(frames, factors, strict=True)], profiles)


@functools.cache
def turning() -> Film:
    """Constant light. Four frames have none that could be made brighter: they are left out."""
    frames, light, profiles = flash()
    kept = []
    for k, frame in enumerate(frames):
        if light[k] > 0:
            bridged = k > 0 and light[k - 1] == 0
            motion = across(frame, frames[k - 1]) if bridged else frame.motion
            kept.append(lit(frame, 1 / light[k])._replace(motion=motion))
    return film(kept, profiles)


def lit(frame: Frame, factor: Any) -> Frame:
    return frame._replace(irradiance=jnp.asarray(frame.irradiance) * jnp.float32(factor))


def across(frame: Frame, left_out: Frame) -> jax.Array:
    """Motion since the frame before the one that is left out; NaN for points that were not seen there."""
    now, then = (frame.depth, frame.profile_id), (left_out.depth, left_out.profile_id)
    unseen = temporal.disoccluded(*now, *then, frame.motion)
    motion = jnp.asarray(frame.motion) + temporal.nearest(left_out.motion, frame.motion)
    return jnp.where(unseen[..., None], jnp.nan, motion)


def head() -> tuple[Frame, dict[int, Any]]:
    of = scene("s2_head", "skin1")
    return of.frame._replace(profile_id=jnp.asarray(of.mask).astype(jnp.int32)), {1: of.d}


@functools.cache
def still() -> Film:
    """One frame, again and again."""
    frame, profiles = head()
    one = film([frame], profiles)
    return Film([frame] * STILL_FRAMES, profiles, one.masks * STILL_FRAMES, one.many * STILL_FRAMES)


def bars() -> Film:
    """Shadows of upright bars that pass over a head, as if from a screen beside the camera."""
    frame, profiles = head()
    camera = frame.camera
    column = jnp.arange(jnp.shape(frame.depth)[1]) + 0.5 - camera.cx
    across_mm = column * jnp.asarray(frame.depth) / camera.fx
    frames = []
    for k in range(FRAMES):
        from_middle = abs((across_mm - WAY * k) % BARS - BARS / 2)
        frames.append(lit(frame, jnp.clip((from_middle - BAR / 2) / SOFT + 0.5, 0, 1)[..., None]))
    return film(frames, profiles)


# --- what moves


class Course(NamedTuple):
    """What a policy did in each frame: mean count; PSNR; squared error over the target, at all pixels and at
    those for which the oracle draws many; seconds.
    """

    counts: np.ndarray
    psnr: np.ndarray
    error: np.ndarray
    hard: np.ndarray
    seconds: np.ndarray


def study_moving() -> None:
    films = {
        "light on and off": on_and_off,
        "bars of shadow": bars,
        "head turns, constant light": turning,
    }
    rows, courses = [], {}
    for title, make in films.items():
        of = make()
        runs = [together(of, only_time=number > 0) for number in range(ROUNDS)]
        courses[title] = {
            name: course._replace(seconds=np.min([run[name].seconds for run in runs], axis=0))
            for name, course in runs[0].items()
        }
        rows += [moving_row(title, name, courses[title]) for name in COLOURS]
    write("moving", table(rows, 2), PAGE)
    draw_moving(courses)


def together(of: Film, *, only_time: bool) -> dict[str, Course]:
    """All policies, frame by frame, in an order shuffled anew: a busy machine slows all of them alike."""
    configs = {name: sequence.Config(policy(name, TARGET), of.profiles) for name in COLOURS}
    states = {name: sequence.init(of.frames[0], config) for name, config in configs.items()}
    found = {name: Course(*(np.full(len(of.frames), np.nan) for _ in Course._fields)) for name in configs}
    order, shuffle = list(configs), random.Random(0).shuffle
    for k, frame in enumerate(of.frames):
        shuffle(order)
        drawn = {}
        for name in order:
            time.sleep(PAUSE)
            start = time.perf_counter()
            states[name], image, info = jax.block_until_ready(
                sequence.step(states[name], frame, configs[name])
            )
            found[name].seconds[k] = time.perf_counter() - start
            drawn[name] = image, np.asarray(info.counts)
        hard = of.masks[k] & (drawn["oracle"][1] >= HARD)
        for name in () if only_time else order:
            note(found[name], of, k, drawn[name], hard)
    return found


def note(course: Course, of: Film, k: int, drawn: tuple[Any, np.ndarray], hard: np.ndarray) -> None:
    """Figures of a frame from its image and counts, but for its time."""
    image, counts = drawn
    mask, many = of.masks[k], of.many[k]
    error = products(image, many)[0] / TARGET
    course.counts[k], course.error[k] = counts[mask].mean(), error[mask].mean()
    if hard.any():
        course.hard[k] = error[hard].mean()
    if many[0][mask].max() > LIT * of.brightest:
        course.psnr[k] = compare.compare(image, *many, mask).psnr


def products(image: Any, many: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Squared error of the luminance / pi, and of a channel, free of the noise of the many samples."""
    off, half = np.asarray(image, float) - many[0], many[1]
    bright = [np.asarray(sequence.luminance(v)) / np.pi for v in (off - half, off + half)]
    return bright[0] * bright[1], ((off - half) * (off + half)).mean(axis=-1)


def moving_row(title: str, name: str, courses: dict[str, Course]) -> dict[str, str]:
    """Means once the histories are old enough."""
    own, of_as, fixed = (Course._make(v[FIRST:] for v in courses[n]) for n in (name, "as", "fixed"))
    counts, psnr = own.counts, own.psnr[np.isfinite(own.psnr)]
    row = {
        "sequence": title,
        "policy": name,
        "mean count": f"{counts.mean():.1f}",
        "worst frame / mean": f"{counts.max() / counts.mean():.2f}",
        "samples of `as` / its own": f"{of_as.counts.mean() / counts.mean():.2f}",
        "PSNR, dB": f"{psnr.mean():.2f}",
        "worst frame, dB": f"{psnr.min():.2f}",
        "error / target": f"{own.error.mean():.2f}",
        f"where {HARD} are needed": f"{np.nanmean(own.hard):.2f}",
        "time / fixed": f"{own.seconds.sum() / fixed.seconds.sum():.2f}",
    }
    # A fixed count is not one that `as` saves samples of; the oracle's variance is no part of its time.
    row |= {"samples of `as` / its own": ""} if name in ("fixed", "as") else {}
    row |= {"time / fixed": ""} if name in ("fixed", "oracle") else {}
    print(row, flush=True)
    return row


def draw_moving(courses: dict[str, dict[str, Course]]) -> None:
    figure, axes = plt.subplots(
        2, len(courses), figsize=(12.5, 6.2), dpi=100, layout="constrained", sharex=True, sharey="row"
    )
    for (upper, lower), (title, found) in zip(axes.T, courses.items(), strict=True):
        for name, course in found.items():
            # `in_frame` often lies under the oracle.
            style: dict[str, Any] = {
                "color": COLOURS[name],
                "lw": 1.4,
                "ls": "--" if name == "oracle" else "-",
            }
            upper.plot(course.counts, label=name, **style)
            lower.plot(course.psnr, marker=".", ms=4, **style)
        upper.set(title=title, ylim=(0, 1.08 * BOUNDS[1]), xlim=(0, FRAMES - 1))
        lower.set(xlabel="frame, 60 a second")
        for each in (upper, lower):
            each.grid(color="0.93")
            each.set_axisbelow(True)
    axes[0, 0].set(ylabel="samples per pixel")
    axes[1, 0].set(ylabel="PSNR against 1024 samples, dB")
    lines, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(lines, names, ncols=len(names), frameon=False, loc="outside upper center", fontsize=9)
    save(figure, "moving")


STUDIES = {"moving": study_moving}
