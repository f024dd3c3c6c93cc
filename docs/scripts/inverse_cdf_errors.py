"""Draw docs/images/inverse_cdf_errors.png: float32 errors of exact forms, cdf errors of approximations.

Run from the repository root: python docs/scripts/inverse_cdf_errors.py
"""

from pathlib import Path

import jax
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from sssfit.profiles import burley
from sssfit.sampling import inverse_cdf

IMAGE = Path(__file__).resolve().parents[1] / "images" / "inverse_cdf_errors.png"


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.1), dpi=100, layout="constrained")
    # Every binary octave of the variates k / 2^24, a few hundred of each.
    steps = np.unique(np.round(np.exp2(np.linspace(0, 24, 12_000)))).astype(int)
    xi = (steps[steps < 2**24] / 2**24).astype(np.float32)
    with jax.enable_x64(True):
        exact = np.asarray(burley.ppf(xi.astype(np.float64), 1.0))
    for name, label, colour in (
        ("closed_form", "published closed form", "#c8322d"),
        ("log_poly8", "log_poly8", "#8a5a00"),
        ("exact", "ours, two Halley branches", "#2b5fb3"),
    ):
        radius = np.asarray(inverse_cdf.METHODS[name].radius(xi, np.float32(1)), np.float64)
        error = np.maximum(np.abs(radius / exact - 1), 1e-9)
        left.loglog(xi, error, ".", ms=2, color=colour, label=label, rasterized=True)
    left.set(xlabel="variate xi", ylabel="relative error of the radius", title="evaluated in float32")
    left.set_ylim(8e-10, 5)
    left.legend(frameon=False, markerscale=5, loc="upper right")
    with jax.enable_x64(True):
        xi = np.linspace(0, 1 - 2.0**-24, 2001)
        for label, radius, colour in (
            ("xie, c = 2.5715", inverse_cdf.xie(xi, 1.0), "#c8322d"),
            ("xie, c = 2.6", inverse_cdf.xie(xi, 1.0, 2.6), "#8a5a00"),
            ("log_linear", inverse_cdf.log_linear(xi, 1.0), "#2b5fb3"),
            ("log_poly4", inverse_cdf.log_poly4(xi, 1.0), "#2e8b3d"),
        ):
            right.plot(xi, 1e3 * (np.asarray(burley.cdf(radius, 1.0)) - xi), color=colour, label=label)
    right.set(xlabel="variate xi", ylabel="1000 (cdf(radius) - xi)", title="error of the probability")
    right.legend(frameon=False)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(IMAGE, metadata={"Software": None})


if __name__ == "__main__":
    main()
