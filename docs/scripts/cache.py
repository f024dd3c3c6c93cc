"""Measure what samples read through texture caches: fixed and adaptive counts, MIP levels, an FFT's order.

Run from the repository root, in about two minutes on two cores; near and far are written into docs/trade.md:

    python docs/scripts/cache.py [near] [far] [setups]

"near" is a close view of skin and "far" a head; "setups", not run unless asked for and as long again, is the
near view with other assumptions.
"""

import sys
import time
from collections.abc import Iterable
from typing import Any, NamedTuple

import frames_data
import numpy as np
import page

from sssfit.frames import adaptive, gbuffer, procedural, render, scatter, scene_profiles
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.trade import addresses, cache
from sssfit.trade.cache import Accesses, Counts
from sssfit.trade.setting import skin
from sssfit.trade.texture import Texture
from sssfit.trade.warps import Schedule

PRESET = "titan_x_pascal"
LEVELS = range(6)
LEAST, MOST = 8, 64
#: Of all samples that the adaptive counts keep, so that reads of the first level fall as in the dissertation.
SHARE = 1 / 5
#: The papers' factor of the prefilter.
PREFILTER = 1 / 16
PROFILE = "skin1"
#: How much closer the procedural frame's ball is in the near view.
CLOSER = 8


class View(NamedTuple):
    """A frame, and the pixels of it that are sampled.

    Attributes:
        name: what it shows.
        frame: see `gbuffer.Frame`.
        profiles: d in mm by id.
        sampled: (H, W).
        adaptive: samples of each pixel, (H, W), with the mean `SHARE` of `MOST`.
    """

    name: str
    frame: Frame
    profiles: dict[int, Any]
    sampled: np.ndarray
    adaptive: np.ndarray

    @property
    def fixed(self) -> np.ndarray:
        return np.where(self.sampled, MOST, 0)


# --- what is seen


def near() -> View:
    """The middle sixteenth of a close view at 1920 x 1080, with the whole frame as its texture."""
    if frames_data.FOLDER.is_dir():
        frame, d = rendered("s4_patch", "gbuffer_1080p.exr")
        name = "s4_patch at 1920 x 1080, its middle 480 x 270"
    else:
        frame, d = procedural.frame(width=1920, height=1080), skin() * CLOSER
        name = "procedural frame at 1920 x 1080, its middle 480 x 270"
    middle = np.zeros(frame.depth.shape, bool)
    middle[405:675, 720:1200] = True
    return view(name, frame, d, middle)


def far() -> View:
    """A head in a small frame, and all of it."""
    if frames_data.FOLDER.is_dir():
        frame, d = rendered("s2_head", "gbuffer.exr")
        return view("s2_head at 640 x 360", frame, d, np.ones(frame.depth.shape, bool))
    frame = procedural.frame()
    return view("procedural frame at 640 x 360", frame, skin(), np.ones(frame.depth.shape, bool))


def rendered(scene: str, file: str) -> tuple[Frame, np.ndarray]:
    camera = frames_data.FOLDER / scene / "camera.json"
    return gbuffer.load(frames_data.FOLDER / scene / file, camera), scene_profiles.by_id(camera, PROFILE)[1]


def view(name: str, frame: Frame, d: np.ndarray, where: np.ndarray) -> View:
    """Counts from a pilot, as `sssfit render` has them, with the target that gives the wanted mean."""
    ids = np.asarray(frame.profile_id)
    profiles = {int(number): d if number == 1 else None for number in np.unique(ids) if number}
    sampled = where & (ids == 1)
    pilot = scatter.variance_of_samples(frame, profiles, counts=np.where(sampled, LEAST, 0), seed=1)
    variance = adaptive.smoothed(pilot, sampled.astype(int), render.SMOOTHING)
    low, high = 1e-8, 1e2
    for _ in range(40):
        target = float(np.sqrt(low * high))
        counts = np.where(sampled, adaptive.counts(variance, target, LEAST, MOST), 0)
        low, high = (target, high) if counts[sampled].mean() > SHARE * MOST else (low, target)
    print(f"{name}: {sampled.sum()} pixels, d {np.round(d, 3)} mm, target variance {target:.2g}, ", end="")
    print(f"mean count {counts[sampled].mean():.2f}; largest of a warp {warp_mean(counts):.2f} in the mean")
    return View(name, frame, profiles, sampled, counts)


def warp_mean(counts: np.ndarray) -> float:
    """Samples of a pixel if each had as many as the largest of its warp."""
    rows, columns = Schedule().warp
    height, width = counts.shape
    tiles = counts[: height // rows * rows, : width // columns * columns]
    most = tiles.reshape(height // rows, rows, width // columns, columns).max(axis=(1, 3))
    return float(most[most > 0].mean())


# --- what is read


def replayed(reads: Iterable[Accesses]) -> tuple[Counts, ...]:
    return cache.simulate_chunks(reads, cache.PRESETS[PRESET])


def both(of: View, **options) -> list[tuple[Counts, ...]]:
    """The caches' counts with the fixed and the adaptive number of samples."""
    return [
        replayed(addresses.of_samples(of.frame, of.profiles, counts=counts, **options))
        for counts in (of.fixed, of.adaptive)
    ]


def rows(name: str, found: list[tuple[Counts, ...]], over: float = 1.0) -> list[dict[str, str]]:
    lines = []
    samples_of = ("fixed", "adaptive") if len(found) == 2 else ("",)
    for samples, (first, second) in zip(samples_of, found, strict=True):
        lines.append(
            {
                "reads": name,
                "samples": samples,
                "L1 reads": f"{first.reads / over:,.0f}",
                "L1 misses, %": f"{100 * first.miss_rate:.2f}",
                "L2 reads": f"{second.reads / over:,.0f}",
                "L2 misses": f"{second.misses / over:,.0f}",
                "L2 misses, %": f"{100 * second.miss_rate:.2f}",
                "from memory, MB": f"{second.bytes_from_below / over / 1e6:.2f}",
                "fewer L1 reads": "",
                "fewer L2 reads": "",
                "fewer L2 misses": "",
            }
        )
    if len(found) == 2:
        fixed, few = found
        pairs = ((fixed[0].reads, few[0].reads), (fixed[1].reads, few[1].reads))
        for key, (many, less) in zip(("L1 reads", "L2 reads"), pairs, strict=True):
            lines[1][f"fewer {key}"] = f"{many / less:.2f}×"
        lines[1]["fewer L2 misses"] = f"{fixed[1].misses / few[1].misses:.2f}×"
    return lines


def study(of: View, place: str) -> None:
    lines = []
    for level in LEVELS:
        lines += rows(f"MIP {level}", both(of, level=level))
    lines += rows("prefilter's levels", both(of, settings=Settings(prefilter=PREFILTER)))
    lines += transforms(of)
    text = frames_data.table(lines, 2)
    print("\n" + text, flush=True)
    page.replace(frames_data.DOCS / "trade.md", place, text)


def transforms(of: View) -> list[dict[str, str]]:
    """A convolution of the three channels by FFT, its share of the pixels that are sampled."""
    camera, sampled = of.frame.camera, of.sampled
    nearest = float(np.min(np.asarray(of.frame.depth)[sampled]))
    # As far as the profile reaches, on each side, and then a power of two.
    reach = 2 * 16 * float(np.max(next(d for d in of.profiles.values() if d is not None)))
    sides = [n + int(reach * camera.fx / nearest) for n in sampled.shape]
    height, width = (1 << (side - 1).bit_length() for side in sides)
    share = sampled.size / sampled.sum() / 6
    lines = []
    for columns in (1, 16):
        # Buffers in rows: 16 columns fill a line.
        found = replayed(addresses.of_transform(Texture(height, width, tile=(1, 1)), columns=columns))
        name = f"FFT of {height} x {width}, columns by {columns}"
        lines += rows(name, [found], share)
    return lines


SETUPS: dict[str, dict[str, Any]] = {
    "as above": {},
    "bilinear": {"filtering": "bilinear"},
    "texels of 4 bytes": {"texel_bytes": 4, "tile": (4, 8)},
    "texels in rows": {"tile": (1, 1)},
    "lines of 32 bytes": {"line_bytes": 32, "tile": (2, 2)},
    "64 warps resident": {"resident": 64},
    "16 warps resident": {"resident": 16},
    "warps dealt one by one": {"block": 1},
    "fresh points": {"settings": Settings(points="fresh")},
}


def study_setups(of: View) -> None:
    """How much of the result is due to what the dissertation does not say, at level 0."""
    lines = []
    for name, setup in SETUPS.items():
        setup = dict(setup)
        for_texture = {key: setup.pop(key) for key in ("texel_bytes", "tile") if key in setup}
        for_schedule = {key: setup.pop(key) for key in ("resident", "block", "line_bytes") if key in setup}
        levels = cache.PRESETS[PRESET]
        if "line_bytes" in for_schedule:
            short = for_schedule["line_bytes"]
            levels = tuple(cache.Level(one.size_bytes, short, one.ways, one.units) for one in levels)
        options = setup | {"texture": Texture(*of.sampled.shape, **for_texture), "level": 0}
        found = [
            cache.simulate_chunks(
                addresses.of_samples(
                    of.frame, of.profiles, counts=counts, schedule=Schedule(**for_schedule), **options
                ),
                levels,
            )
            for counts in (of.fixed, of.adaptive)
        ]
        lines += rows(name, found)
    print("\n" + frames_data.table(lines, 2), flush=True)


def main() -> None:
    chosen = sys.argv[1:] or ["near", "far"]
    of = near() if {"near", "setups"} & set(chosen) else None
    for name in chosen:
        start = time.perf_counter()
        if name == "far":
            study(far(), "cache far")
        elif of is not None and name == "near":
            study(of, "cache near")
        elif of is not None:
            study_setups(of)
        print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
