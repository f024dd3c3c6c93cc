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


STUDIES = {"delivered": study_delivered}
