"""Sequences of frames: the variance that controllers deliver, beside the one that they promise."""

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import scipy.stats
from frames_data import save, scene, table, write

from sssfit.estimators import policies
from sssfit.frames import scatter, sequence
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings

PAGE = "sequences.md"
DELIVERED_SEEDS, WARM = 64, 24
DELIVERED_TARGET, DELIVERED_BOUNDS = 1e-3, (8, 256)
#: Errors are kept of so many seeds.
KEPT = 8
POINTS = {
    "independent": Settings(points="fresh", sequence="iid"),
    "table, R2 (default)": Settings(),
}
ORACLE_SPP = 4096
DELIVERED_COLOURS = {
    "as, kappa 0": "#0072b2", "as, kappa 0.2": "#56b4e9", "in_frame": "#009e73",
    "in_frame, gain": "#e69f00", "oracle": "black",
}  # fmt: skip
#: Numbers of all pixels by points and policy.
Found = dict[tuple[str, str], np.ndarray]


def study_delivered() -> None:
    head = scene("s2_head", "skin1")
    frame = head.frame._replace(profile_id=jnp.asarray(head.mask).astype(jnp.int32))
    profiles = {1: head.d}
    rows, ratios, errors = [], {}, {}
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
            errors[points, name] = seen.errors() / np.sqrt(DELIVERED_TARGET)
            rows.append(delivered_row(points, name, seen.counts / seen.number, ratio))
            rows[-1] |= beyond(errors[points, name])
            print(rows[-1], flush=True)
    write("delivered", table(rows, 2), PAGE)
    draw_delivered(ratios, errors)


def delivered_policies(settings: Settings) -> dict[str, Any]:
    low, high = DELIVERED_BOUNDS
    common: dict[str, Any] = {"target_variance": DELIVERED_TARGET, "min_spp": low, "max_spp": high}
    found = {f"as, kappa {kappa:g}": policies.named("as", kappa=kappa, **common) for kappa in (0.0, 0.2)}
    found["in_frame"] = policies.named("in_frame", **common)
    if settings.sequence != "iid":
        found["in_frame, gain"] = policies.named("in_frame", gain_alpha=sequence.GAIN_ALPHA, **common)
    return found | {"oracle": policies.named("oracle", **common)}


class Welford:
    """Mean and variance over seeds of one pixel's value, and its values for the first of them."""

    def __init__(self):
        self.number, self.mean, self.square, self.counts = 0, 0.0, 0.0, 0.0
        self.kept: list[np.ndarray] = []

    def add(self, last: tuple[np.ndarray, np.ndarray], where: np.ndarray) -> None:
        value, counts = (v[where].astype(float) for v in last)
        self.number += 1
        delta = value - self.mean
        self.mean = self.mean + delta / self.number
        self.square = self.square + delta * (value - self.mean)
        self.counts = self.counts + counts.mean()
        if len(self.kept) < KEPT:
            self.kept.append(value)

    def variance(self) -> np.ndarray:
        return np.asarray(self.square) / (self.number - 1)

    def errors(self) -> np.ndarray:
        """Of the values kept, beside the mean over all seeds, of which each is a part."""
        share = 1 - 1 / self.number
        return np.abs(np.stack(self.kept) - self.mean).ravel() / np.sqrt(share)


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


def beyond(errors: np.ndarray) -> dict[str, str]:
    """A perfect controller has 31.7 % of errors above the target's root, and 0.27 % above three of them."""
    return {f"beyond {k}, %": f"{100 * np.mean(errors > k):.2f}" for k in (1, 3)}


def draw_delivered(ratios: Found, errors: Found) -> None:
    figure, every = plt.subplots(2, 2, figsize=(11, 8.2), dpi=100, layout="constrained", sharey="row")
    draw_ratios(every[0], ratios)
    draw_errors(every[1], errors)
    save(figure, "delivered")


def draw_ratios(every: np.ndarray, ratios: Found) -> None:
    degrees = DELIVERED_SEEDS - 1
    edges = np.linspace(0, 3, 121)
    middle = (edges[1:] + edges[:-1]) / 2
    law = scipy.stats.chi2.pdf(middle * degrees, degrees) * degrees
    for axes, points in zip(every, POINTS, strict=True):
        axes.fill_between(middle, law, color="0.9", lw=0, label="a perfect controller, 64 seeds")
        for name, ratio in of_points(ratios, points).items():
            density, _ = np.histogram(ratio, edges, density=True)
            axes.plot(middle, density, color=DELIVERED_COLOURS[name], lw=1.4, label=name)
        axes.set(title=points, xlabel="variance over 64 seeds / target", xlim=(0, 3), ylim=(0, None))
        axes.legend(frameon=False, fontsize=9)
    every[0].set_ylabel("density of pixels")


def draw_errors(every: np.ndarray, errors: Found) -> None:
    """Share of the errors up to each size."""
    sizes = np.linspace(0, 4, 161)
    for axes, points in zip(every, POINTS, strict=True):
        law = scipy.stats.halfnorm.cdf(sizes)
        axes.plot(sizes, law, color="0.8", lw=5, label="a perfect controller: half-normal")
        for name, error in of_points(errors, points).items():
            share = np.searchsorted(np.sort(error), sizes, side="right") / error.size
            axes.plot(sizes, share, color=DELIVERED_COLOURS[name], lw=1.4, label=name)
        axes.set(xlabel="|error of a pixel's value| / root of the target", xlim=(0, 4), ylim=(0, 1.01))
        axes.legend(frameon=False, fontsize=9, loc="lower right")
        axes.grid(color="0.93")
        axes.set_axisbelow(True)
    every[0].set_ylabel(f"share of pixels, {KEPT} seeds")


def of_points(found: Found, points: str) -> dict[str, np.ndarray]:
    return {name: values for (of, name), values in found.items() if of == points}


STUDIES = {"delivered": study_delivered}
