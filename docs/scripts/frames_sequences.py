"""Sequences of frames: counts under a light that flashes, and of a scene that stands still."""

from typing import Any, NamedTuple

import interleaved
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from frames_data import FOLDER, save, scene, table, write

from sssfit.estimators import policies
from sssfit.frames import compare, gbuffer, reference, scatter, scene_profiles, sequence
from sssfit.frames.gbuffer import Frame

PAGE = "sequences.md"
COLOURS = {
    "fixed": "0.6", "as": "#0072b2", "ocv": "#d55e00", "ccv": "#cc79a7", "in_frame": "#009e73",
    "in_frame, gain": "#e69f00", "oracle": "black",
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
    name, _, with_gain = name.partition(",")
    if name != "in_frame":
        options |= {"alpha": ALPHA, "kappa": KAPPA}
    elif with_gain:
        options["gain_alpha"] = sequence.GAIN_ALPHA
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


# --- a scene that stands still

STATIC_TARGETS, STATIC_MOST = (3e-4, 1e-3, 3e-3), (64, 128, 512)
STATIC_EQUAL, STATIC_FIXED = (8, 16, 32, 64), 64
STATIC_FRAMES, STATIC_LAST, STATIC_ROUNDS = 24, 4, 25


class Static(NamedTuple):
    """A still frame, its profiles and pixels, an image of many samples and half its halves' difference.

    `large` is the same in three times as many rows and columns, to take times of.
    """

    frame: Frame
    large: Frame
    profiles: dict[int, Any]
    mask: np.ndarray
    many: tuple[np.ndarray, np.ndarray]


def still_head() -> Static:
    head = scene("s2_head", "skin1")
    large = gbuffer.load(FOLDER / "s2_head" / "gbuffer_1080p.exr", FOLDER / "s2_head" / "camera.json")
    frame, large = (f._replace(profile_id=(f.profile_id == 1).astype(jnp.int32)) for f in (head.frame, large))
    return Static(frame, large, {1: head.d}, head.mask, many_samples(frame, {1: head.d}))


def study_static() -> None:
    of = still_head()
    rows = [static_row(of, f"fixed {spp}", "", "", policies.named("fixed", spp=spp)) for spp in STATIC_EQUAL]
    for most in STATIC_MOST:
        for target in STATIC_TARGETS:
            for name, options in {
                "as, kappa 0": {"kappa": 0.0},
                "as, kappa 0.2": {"kappa": 0.2},
                "in_frame": {},
                "in_frame, gain": {"gain_alpha": sequence.GAIN_ALPHA},
            }.items():
                bounds: dict[str, Any] = {"target_variance": target, "min_spp": 8, "max_spp": most}
                chosen = policies.named(name.partition(",")[0], **bounds, **options)
                rows.append(static_row(of, name, f"[8, {most}]", f"{target:g}", chosen))
                print(rows[-1], flush=True)
    write("static", table(rows, 3), PAGE)


def many_samples(frame: Frame, profiles) -> tuple[np.ndarray, np.ndarray]:
    a, b = (
        np.asarray(scatter.every_profile(frame, profiles, counts=4096, seed=seed)).astype(float)
        for seed in (7, 8)
    )
    return (a + b) / 2, (a - b) / 2


def static_row(of: Static, name: str, bounds: str, target: str, chosen: Any) -> dict[str, str]:
    """Means over the last frames, in which the histories are warm."""
    config = sequence.Config(chosen, of.profiles)
    last = [
        (image, np.asarray(info.counts))
        for state, image, info in sequence.scan([of.frame] * STATIC_FRAMES, config)
        if state.number > STATIC_FRAMES - STATIC_LAST
    ]
    counts = last[-1][1]
    found = [compare.compare(image, *of.many, of.mask).psnr for image, _ in last]
    errors = np.mean([squared(of, image) for image, _ in last], axis=0)
    full = counts[of.mask] == counts.max()
    cells = {"policy": name, "bounds": bounds, "target": target}
    cells["mean count / 64"] = f"{np.mean([c[of.mask].mean() for _, c in last]) / STATIC_FIXED:.3f}"
    cells["time / fixed 64"] = f"{time_ratio(of.frame, of.profiles, counts):.3f}"
    nine = counts.repeat(3, axis=0).repeat(3, axis=1)
    cells["in nine times the pixels"] = f"{time_ratio(of.large, of.profiles, nine):.3f}"
    cells["PSNR, dB"] = f"{np.mean(found):.2f}"
    if bounds:
        wanted = float(target)
        cells["at the bound, %"] = f"{100 * full.mean():.1f}"
        cells["error there / target"] = f"{errors[full].mean() / wanted:.2f}" if full.any() else ""
        cells["error elsewhere / target"] = f"{errors[~full].mean() / wanted:.2f}" if (~full).any() else ""
    return cells | {
        n: "" for n in ("at the bound, %", "error there / target", "error elsewhere / target") if not bounds
    }


def squared(of: Static, image) -> np.ndarray:
    """Squared error of the luminance / pi at each pixel."""
    error = sequence.luminance(np.asarray(image) - of.many[0]) / np.pi
    return np.square(np.asarray(error))[of.mask]


def time_ratio(frame: Frame, profiles, counts: np.ndarray) -> float:
    """Of a pass with these counts and one with the fixed count, in turns."""

    def drawn(many: Any) -> Any:
        found = scatter.every_profile(frame, profiles, counts=many, most=int(np.max(many)))
        return found.block_until_ready()

    fixed = jnp.full(counts.shape, STATIC_FIXED)
    programs = {"counts": lambda: drawn(jnp.asarray(counts)), "fixed": lambda: drawn(fixed)}
    times = interleaved.measure(programs, STATIC_ROUNDS)
    return float(np.median(times["counts"] / times["fixed"]))


# --- samples that pixels draw while they wait


class WholeSegments(policies.InFrame):
    """Pixels that are sampled together draw as many as the one of them that wants most."""

    def count(self, state: Any, known: policies.Known) -> Any:
        return scatter.whole_segments(super().count(state, known))


def study_segments() -> None:
    of, rows = still_head(), []
    for spp in (16, 24, 32, 48, 64):
        rows.append(static_row(of, f"fixed {spp}", "", "", policies.named("fixed", spp=spp)))
        print(rows[-1], flush=True)
    for target in STATIC_TARGETS:
        own = policies.named(
            "in_frame", target_variance=target, max_spp=STATIC_FIXED, gain_alpha=sequence.GAIN_ALPHA
        )
        for name, chosen in {
            "in_frame, gain": own,
            "the same, whole segments": WholeSegments(own.controller, own.light),
        }.items():
            rows.append(static_row(of, name, f"[8, {STATIC_FIXED}]", f"{target:g}", chosen))
            print(rows[-1], flush=True)
    wanted = ("policy", "target", "mean count / 64", "in nine times the pixels", "PSNR, dB")
    write("segments", table([{name: row[name] for name in wanted} for row in rows], 2), PAGE)


STUDIES = {"flash": study_flash, "static": study_static, "segments": study_segments}
