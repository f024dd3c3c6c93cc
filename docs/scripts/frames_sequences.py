"""Sequences of frames: counts under a light that flashes, and the variance that controllers deliver."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import scipy.stats
from frames_data import FOLDER, save, scene, table, write

from sssfit.estimators import policies
from sssfit.frames import compare, gbuffer, reference, scatter, scene_profiles, sequence
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings

PAGE = "sequences.md"
COLOURS = {
    "fixed": "0.6", "as": "#0072b2", "ocv": "#d55e00", "ccv": "#cc79a7", "in_frame": "#009e73",
    "oracle": "black",
}  # fmt: skip

# --- a light that flashes

FLASH = FOLDER / "s5_flash"
FRAMES, EXACT = 48, (0, 3, 6, 12, 27, 39)
TARGETS, ALPHA, KAPPA, BOUNDS = (1e-3, 1e-4), 0.2, 0.2, (8, 64)
REFERENCE_SPP = 1024
#: Frames are compared where the light is above this share of its largest.
LIT = 0.01
#: The first frames are left out of means: every history is new there.
FIRST = 6


class Track(NamedTuple):
    """What a policy did in each frame: mean count; PSNR against many samples, and against the exact image."""

    counts: np.ndarray
    psnr: np.ndarray
    exact: np.ndarray


def study_flash() -> None:
    profiles = scene_profiles.by_id(FLASH / "camera.json", "skin1", FLASH / "exact_skin1_00.exr")
    frames = [
        gbuffer.load(FLASH / f"frame_{k:02d}.exr", FLASH / "camera.json", layers={"albedo": None})
        for k in range(FRAMES)
    ]
    masks = [
        np.isin(np.asarray(f.profile_id), [n for n, d in profiles.items() if d is not None]) for f in frames
    ]
    many = [halves(frame, profiles, number) for number, frame in enumerate(frames)]
    known = {k: reference.load(FLASH / f"exact_skin1_{k:02d}.exr", masks[k]) for k in EXACT}
    rows, tracks = [], {}
    for target in TARGETS:
        for name in COLOURS:
            chosen = policy(name, target)
            tracks[target, name] = track = follow(frames, masks, profiles, chosen, many, known)
            lit = np.isfinite(track.psnr)
            lit[:FIRST] = False
            of_as = tracks[target, "as"].counts[FIRST:].mean() if name not in ("fixed", "as") else np.nan
            counts = track.counts[FIRST:]
            rows.append(
                {
                    "target": f"{target:g}",
                    "policy": name,
                    "mean count": f"{counts.mean():.1f}",
                    "worst frame / mean": f"{counts.max() / counts.mean():.2f}",
                    "samples of `as` / its own": "" if np.isnan(of_as) else f"{of_as / counts.mean():.2f}",
                    "PSNR, many samples, dB": f"{track.psnr[lit].mean():.2f}",
                    "PSNR, exact, dB": f"{np.nanmean(track.exact[FIRST:]):.2f}",
                }
            )
            print(rows[-1], flush=True)
    write("flash", table(rows, 2), PAGE)
    light = [float(np.asarray(f.irradiance)[m].max()) for f, m in zip(frames, masks, strict=True)]
    draw_flash({name: tracks[TARGETS[0], name] for name in COLOURS}, np.array(light))


def policy(name: str, target: float) -> Any:
    if name == "fixed":
        return policies.named(name, spp=BOUNDS[1])
    options: dict[str, Any] = {"target_variance": target, "min_spp": BOUNDS[0], "max_spp": BOUNDS[1]}
    if name != "in_frame":
        options |= {"alpha": ALPHA, "kappa": KAPPA}
    return policies.named(name, **options)


def halves(frame: Frame, profiles, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and half the difference of two images with many samples."""
    a, b = (
        np.asarray(
            scatter.every_profile(frame, profiles, counts=REFERENCE_SPP // 2, seed=seed, number=number)
        )
        for seed in (7, 8)
    )
    return (a + b) / 2, (a - b) / 2


def follow(frames, masks, profiles, chosen, many, known) -> Track:
    found = Track(*(np.full(len(frames), np.nan) for _ in range(3)))
    brightest = max(sss[mask].max() for (sss, _), mask in zip(many, masks, strict=True))
    for state, image, info in sequence.scan(frames, sequence.Config(chosen, profiles)):
        k, mask = state.number - 1, masks[state.number - 1]
        found.counts[k] = np.asarray(info.counts)[mask].mean()
        sss, diff = many[k]
        if sss[mask].max() > LIT * brightest:
            found.psnr[k] = compare.compare(image, sss, diff, mask).psnr
            if k in known:
                found.exact[k] = compare.compare(image, known[k].sss, known[k].diff, mask).psnr
    return found


def draw_flash(tracks: dict[str, Track], light: np.ndarray) -> None:
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(9, 6.2), dpi=100, layout="constrained", sharex=True)
    frames = np.arange(len(light))
    top = 1.08 * BOUNDS[1]
    upper.fill_between(frames, 0, top * light / light.max(), color="0.92", label="light", lw=0)
    for name, track in tracks.items():
        upper.plot(frames, track.counts, color=COLOURS[name], label=name, lw=1.4)
        lower.plot(frames, track.psnr, color=COLOURS[name], lw=1.4, marker=".", ms=4)
    upper.set(ylabel="samples per pixel", ylim=(0, top), xlim=(0, len(light) - 1))
    lower.set(ylabel="PSNR against 1024 samples, dB", xlabel="frame, 60 a second")
    upper.legend(ncols=7, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=9)
    for axes in (upper, lower):
        axes.grid(color="0.93")
        axes.set_axisbelow(True)
    save(figure, "flash")


# --- the variance delivered

DELIVERED_SEEDS, WARM = 64, 24
DELIVERED_TARGET, DELIVERED_BOUNDS = 1e-3, (8, 256)
POINTS = {
    "independent": Settings(points="fresh", sequence="iid"),
    "table, R2 (default)": Settings(),
}
ORACLE_SPP = 4096


def study_delivered() -> None:
    head = scene("s2_head", "skin1")
    frame = head.frame._replace(profile_id=jnp.asarray(head.mask).astype(jnp.int32))
    profiles = {1: head.d}
    rows, ratios = [], {}
    for points, settings in POINTS.items():
        exact = np.asarray(
            scatter.variance_of_samples(frame, profiles, counts=ORACLE_SPP, settings=settings, seed=3)
        )
        # Pixels whose count the bounds would decide say nothing of the controller.
        low, high = DELIVERED_BOUNDS
        free = head.mask & (exact / DELIVERED_TARGET > 1.5 * low) & (exact / DELIVERED_TARGET < high / 1.5)
        for name, chosen in delivered_policies(settings).items():
            config = {"profiles": profiles, "settings": settings, "oracle_spp": 1024}
            seen = Welford()
            for seed in range(DELIVERED_SEEDS):
                seen.add(last_frame(frame, sequence.Config(chosen, seed=seed, **config)), free)
            ratio = seen.variance() / DELIVERED_TARGET
            ratios[points, name] = ratio
            rows.append(delivered_row(points, name, seen.counts / seen.number, ratio))
            print(rows[-1], flush=True)
    write("delivered", table(rows, 2), PAGE)
    draw_delivered(ratios)


def delivered_policies(settings: Settings) -> dict[str, Any]:
    low, high = DELIVERED_BOUNDS
    common: dict[str, Any] = {"target_variance": DELIVERED_TARGET, "min_spp": low, "max_spp": high}
    found = {f"as, kappa {kappa:g}": policies.named("as", kappa=kappa, **common) for kappa in (0.0, 0.2)}
    found["in_frame"] = policies.named("in_frame", **common)
    if settings.sequence != "iid":
        found["in_frame, gain"] = policies.named("in_frame", gain_alpha=policies.GAIN_ALPHA, **common)
    return found | {"oracle": policies.named("oracle", **common)}


class Welford:
    """Mean and variance over seeds of one pixel's value."""

    def __init__(self):
        self.number, self.mean, self.square, self.counts = 0, 0.0, 0.0, 0.0

    def add(self, last: tuple[np.ndarray, np.ndarray], where: np.ndarray) -> None:
        value, counts = (v[where].astype(float) for v in last)
        self.number += 1
        delta = value - self.mean
        self.mean = self.mean + delta / self.number
        self.square = self.square + delta * (value - self.mean)
        self.counts = self.counts + counts.mean()

    def variance(self) -> np.ndarray:
        return np.asarray(self.square) / (self.number - 1)


def last_frame(frame: Frame, config: sequence.Config) -> tuple[np.ndarray, np.ndarray]:
    """Value and count of each pixel once the histories are warm."""
    frames: Iterator[Frame] = (frame for _ in range(1 if is_stateless(config.policy) else WARM))
    *_, (_, _, info) = sequence.scan(frames, config)
    return np.asarray(info.value), np.asarray(info.counts)


def is_stateless(policy: Any) -> bool:
    return isinstance(policy, policies.Oracle | policies.Fixed)


def delivered_row(points: str, name: str, count: float, ratio: np.ndarray) -> dict[str, str]:
    degrees = DELIVERED_SEEDS - 1
    low, high = scipy.stats.chi2.ppf([0.05, 0.95], degrees) / degrees
    return {
        "points": points,
        "policy": name,
        "pixels": f"{len(ratio):,}",
        "mean count": f"{count:.1f}",
        "mean variance / target": f"{ratio.mean():.3f}",
        "median": f"{np.median(ratio):.3f}",
        "oversampled, %": f"{100 * np.mean(ratio < low):.1f}",
        "undersampled, %": f"{100 * np.mean(ratio > high):.1f}",
    }


def draw_delivered(ratios: dict[tuple[str, str], np.ndarray]) -> None:
    figure, every = plt.subplots(1, 2, figsize=(11, 4.2), dpi=100, layout="constrained", sharey=True)
    degrees = DELIVERED_SEEDS - 1
    edges = np.linspace(0, 3, 121)
    middle = (edges[1:] + edges[:-1]) / 2
    law = scipy.stats.chi2.pdf(middle * degrees, degrees) * degrees
    colours = ["#0072b2", "#56b4e9", "#009e73", "#e69f00", "black"]
    for axes, points in zip(every, POINTS, strict=True):
        axes.fill_between(middle, law, color="0.9", lw=0, label="a perfect controller, 64 seeds")
        names = [name for p, name in ratios if p == points]
        for name in names:
            colour = colours[
                ["as, kappa 0", "as, kappa 0.2", "in_frame", "in_frame, gain", "oracle"].index(name)
            ]
            density, _ = np.histogram(ratios[points, name], edges, density=True)
            axes.plot(middle, density, color=colour, lw=1.4, label=name)
        axes.set(title=points, xlabel="variance over 64 seeds / target", xlim=(0, 3), ylim=(0, None))
        axes.legend(frameon=False, fontsize=9)
    every[0].set_ylabel("density of pixels")
    save(figure, "delivered")


STUDIES = {"flash": study_flash, "delivered": study_delivered}
