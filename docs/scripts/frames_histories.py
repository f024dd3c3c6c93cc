"""Sequences of frames: what a history is worth in its first frames, and what it loses in half precision."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from frames_data import table, write
from frames_moving import TARGET, Film, flashing, products, still, turning
from frames_sequences import ALPHA, BOUNDS, FIRST, LIT, PAGE, policy

from sssfit.estimators import policies
from sssfit.frames import compare, sequence, temporal

SEEDS = 8
#: Frames since the start, ages of pixels that came into view, and what age counts as old.
STARTED, AGES, OLD = (0, 1, 2, 4, 8, 16, 32), (0, 1, 2, 4, 8), 16

# --- new pixels


class Sums(NamedTuple):
    """Over pixels: how many, and sums of their counts and of their two squared errors."""

    pixels: float = 0.0
    counts: float = 0.0
    bright: float = 0.0
    square: float = 0.0

    def plus(self, where: np.ndarray, counts: np.ndarray, errors: tuple[np.ndarray, np.ndarray]) -> "Sums":
        new = where.sum(), counts[where].sum(), *(error[where].sum() for error in errors)
        return Sums(*(old + float(more) for old, more in zip(self, new, strict=True)))


def cold_policies() -> dict[str, Any]:
    bounds: dict[str, Any] = {"target_variance": TARGET, "min_spp": BOUNDS[0], "max_spp": BOUNDS[1]}
    found = {
        f"as, kappa {kappa:g}": policies.named("as", alpha=ALPHA, kappa=kappa, **bounds)
        for kappa in (0.0, 0.2)
    }
    return found | {name: policies.named(name, **bounds) for name in ("in_frame", "oracle")}


def study_cold() -> None:
    """All pixels of a still head by frame, and those of a turning head by the age of their history."""
    for name, of, groups in (("cold", still(), by_frame), ("disoccluded", turning(), by_age)):
        rows = []
        for title, chosen in cold_policies().items():
            found: dict[str, Sums] = {}
            for seed in range(SEEDS):
                for group, *figures in groups(of, sequence.Config(chosen, of.profiles, seed=seed)):
                    found[group] = found.get(group, Sums()).plus(*figures)
            rows += cold_rows(title, found, of.brightest)
            pixels = {group: f"{sums.pixels / SEEDS:,.0f}" for group, sums in found.items()}
        # The same for all of them.
        rows.append({"policy": "", "figure": "pixels"} | pixels)
        write(name, table(rows, 2), PAGE)


def by_frame(of: Film, config: sequence.Config) -> Iterator[tuple[Any, ...]]:
    for state, image, info in sequence.scan(of.frames, config):
        k = state.number - 1
        if k in STARTED:
            yield f"frame {k}", of.masks[k], np.asarray(info.counts), products(image, of.many[k])


def by_age(of: Film, config: sequence.Config) -> Iterator[tuple[Any, ...]]:
    """Pixels that came into view so many frames ago; those of the first frame are only ever old."""
    age = jnp.zeros(of.masks[0].shape)
    for state, image, info in sequence.scan(of.frames, config):
        k = state.number - 1
        age = jnp.where(info.missing, 0 if k else OLD, temporal.nearest(age, of.frames[k].motion) + 1)
        if k < OLD:
            continue
        errors, counts = products(image, of.many[k]), np.asarray(info.counts)
        for frames in AGES:
            yield f"age {frames}", of.masks[k] & np.asarray(age == frames), counts, errors
        yield f"{OLD} or more", of.masks[k] & np.asarray(age >= OLD), counts, errors


def cold_rows(title: str, found: dict[str, Sums], peak: float) -> list[dict[str, str]]:
    figures = {
        "mean count": lambda s: f"{s.counts / s.pixels:.1f}",
        "error / target": lambda s: f"{s.bright / s.pixels / TARGET:.2f}",
        "PSNR, dB": lambda s: f"{10 * np.log10(peak**2 * s.pixels / s.square):.2f}",
    }
    return [
        {"policy": title, "figure": name} | {group: value(sums) for group, sums in found.items()}
        for name, value in figures.items()
    ]


# --- half precision


class Kept(NamedTuple):
    """What was drawn with one type of history: counts of each frame at its pixels, PSNR, bytes a pixel."""

    counts: list[np.ndarray]
    psnr: np.ndarray
    size: float


def study_half() -> None:
    rows = []
    for title, of in {"flash": flashing(), "still head": still()}.items():
        for name in ("as", "ocv", "ccv", "in_frame"):
            full, half = (keep(of, name, dtype) for dtype in (jnp.float32, jnp.float16))
            pairs = list(zip(full.counts, half.counts, strict=True))
            differ = np.mean(np.concatenate([a != b for a, b in pairs]))
            means = np.array([(b.mean(dtype=float) - a.mean(dtype=float)) for a, b in pairs])
            row = {"sequence": title, "policy": name}
            for label, kept in (("float32", full), ("float16", half)):
                row[f"mean count, {label}"] = f"{np.mean([c.mean() for c in kept.counts]):.2f}"
            for label, kept in (("float32", full), ("float16", half)):
                row[f"PSNR, {label}, dB"] = f"{kept.psnr.mean():.2f}"
            row["counts that differ, %"] = f"{100 * differ:.1f}"
            row["largest mean difference"] = f"{means[abs(means).argmax()]:+.3f}"
            row["bytes a pixel"] = f"{full.size:g}, {half.size:g}"
            rows.append(row)
            print(row, flush=True)
    write("half", table(rows, 2), PAGE)


def keep(of: Film, name: str, dtype: Any) -> Kept:
    config = sequence.Config(policy(name, TARGET), of.profiles, history_dtype=dtype)
    counts, psnr, size = [], [], 0.0
    for state, image, info in sequence.scan(of.frames, config):
        k = state.number - 1
        mask, many = of.masks[k], of.many[k]
        arrays = [leaf for leaf in jax.tree.leaves(state) if jnp.ndim(leaf) == 2]
        size = sum(leaf.nbytes for leaf in arrays) / mask.size
        if k >= FIRST:
            counts.append(np.asarray(info.counts)[mask])
            if many[0][mask].max() > LIT * of.brightest:
                psnr.append(compare.compare(image, *many, mask).psnr)
    return Kept(counts, np.array(psnr), size)


STUDIES = {"cold": study_cold, "half": study_half}
