"""Draw docs/images/moving_moments.png: where a moving average stops, and what a moving variance is worth.

Run from the repository root: python docs/scripts/moving_moments.py
"""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from sssfit.estimators import bias, moving

IMAGE = Path(__file__).resolve().parents[1] / "images" / "moving_moments.png"
COLOURS = ("#c8322d", "#8a5a00", "#2b5fb3", "#222222")


@partial(jax.jit, static_argnames=("dtype", "steps"))
def step_response(alpha, dtype, steps):
    """The moving average, kept in a dtype, after a zero and that many ones."""
    state = moving.init("ema", jnp.zeros_like(alpha), dtype=dtype)
    state = moving.update(state, jnp.zeros_like(alpha), alpha=alpha)
    ones = jnp.ones_like(alpha)
    return moving.mean(jax.lax.fori_loop(0, steps, lambda _, s: moving.update(s, ones, alpha=alpha), state))


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.1), dpi=100, layout="constrained")
    alpha = np.geomspace(1e-5, 0.9, 200).astype(np.float32)
    # Long enough for every format to stop: a half format stops early where alpha is small.
    formats = (("bfloat16", 20_000), ("float16", 40_000), ("float32", 2_000_000))
    for (name, steps), colour in zip(formats, COLOURS, strict=False):
        mean = np.asarray(step_response(alpha, jnp.dtype(name), steps), np.float64)
        again = np.asarray(step_response(alpha, jnp.dtype(name), steps + 1), np.float64)
        assert (mean == again).all()
        left.loglog(alpha, np.where(mean < 1, 1 - mean, np.nan), color=colour, label=name, lw=1.8)
    left.axhline(0.01, color="#222222", lw=1, ls=":")
    left.text(0.9, 0.0115, "1 %", ha="right", va="bottom", fontsize=9)
    left.set(xlabel="alpha", ylabel="distance left of a step from 0 to 1", ylim=(3e-8, 2), xlim=(1e-5, 1))
    left.set_title("where the moving average stops")
    left.legend(frameon=False, loc="lower left")
    alpha = np.geomspace(0.005, 0.9, 200)
    windows = ((10, "10 samples"), (30, "30"), (100, "100"), (np.inf, "long past"))
    for (num_samples, label), colour in zip(windows, COLOURS, strict=True):
        with jax.enable_x64(True):
            moments = bias.emv_moments(alpha, num_samples)
        right.semilogx(alpha, moments.deviation, color=colour, label=label, lw=1.8)
        right.semilogx(alpha, moments.mean, "--", color=colour, lw=1.2)
    right.set(xlabel="alpha", ylabel="over the variance of a sample", ylim=(0, 1.45), xlim=(0.005, 0.9))
    right.set_xticks([0.01, 0.1, 0.5], ["0.01", "0.1", "0.5"])
    right.set_title("moving variance, normal samples")
    handles, labels = right.get_legend_handles_labels()
    for style, label in (("-", "deviation, debiased"), ("--", "mean, not debiased")):
        handles += right.plot([], [], style, color="#888888")
        labels.append(label)
    right.legend(handles, labels, frameon=False, loc="upper center", ncols=2, fontsize=9)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(IMAGE, metadata={"Software": None})


if __name__ == "__main__":
    main()
