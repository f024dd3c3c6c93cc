"""Draw docs/images/falloff_fit.png: Burley's parameters against the separable falloff.

Run from the repository root: python docs/scripts/falloff_fit.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.polynomial import Polynomial

from sssfit.fitting.separable_to_burley import fit
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET

IMAGE = Path(__file__).resolve().parents[1] / "images" / "falloff_fit.png"

# Unreal Engine's two published conversions of the falloff X, lowest power first. They are figures from a
# source under Epic's licence (BurleyNormalizedSSS.cpp), quoted here to compare with and used nowhere else.
UNREAL = {
    "Unreal, active": (
        Polynomial([0.00004, 0.906]),
        Polynomial([-0.0014, 0.7279, -2.039, 8.332, -15.18, 10.39]),
        "-",
    ),
    "Unreal, disabled": (
        Polynomial([0.01098, 0.2636, 5.143, -16.59, 26.08, -19.88, 5.883]),
        Polynomial([0.006853, 0.4067, 1.636, -4.424, 5.2154, -5.178, 4.78]),
        ":",
    ),
}
COLOURS = {"radial": "#2b5fb3", "as_coded": "#c8322d"}


def scaling(albedo):
    return 3.5 + 100 * (albedo - 0.33) ** 4


def main():
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 4.4), dpi=100, layout="constrained")
    falloff = np.linspace(0.02, 1, 50)
    for reading, colour in COLOURS.items():
        fits = [fit(float(x), reading=reading) for x in falloff]
        for axes, name in ((left, "albedo"), (middle, "d"), (right, "dmfp")):
            low, high = np.array([getattr(f, f"{name}_interval") for f in fits]).T
            axes.plot(falloff, [getattr(f, name) for f in fits], color=colour, label=f"ours, {reading}", lw=2)
            axes.fill_between(falloff, low, high, color=colour, alpha=0.15, lw=0)
    for label, (albedo, dmfp, style) in UNREAL.items():
        a, length = albedo(falloff), dmfp(falloff)
        options = {"color": "#222222", "ls": style, "lw": 1.6}
        left.plot(falloff, a, label=label, **options)
        middle.plot(falloff, length / scaling(a), label=label, **options)
        right.plot(falloff, length, label=label, **options)
    energy = 0.767 * (falloff + FALLOFF_OFFSET) ** 2
    left.plot(falloff, energy, "--", color="#2e8b3d", lw=1.4, label="energy of the source profile")
    left.set(title="albedo A", ylim=(0, 1.05), ylabel="A, no unit")
    middle.set(title="shape parameter d", yscale="log", ylim=(2e-3, 3), ylabel="d [mm]")
    right.set(title="diffuse mean free path", yscale="log", ylim=(8e-3, 30), ylabel="dmfp [mm]")
    for axes in (left, middle, right):
        axes.set(xlabel="falloff X", xlim=(0, 1))
        axes.grid(alpha=0.3, which="major")
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(IMAGE, metadata={"Software": None})


if __name__ == "__main__":
    main()
