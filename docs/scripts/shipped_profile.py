"""Write the shipped measurement, data/profile.csv. Run from the repository root:

    python docs/scripts/shipped_profile.py

It is synthetic: Burley's profile with 3 % of normal noise at 48 radii from 0.1 to 15 mm, seed 7. The albedo
is 0.7, 0.55 and 0.4, and d is 1.5, 1.0 and 0.6 mm, in red, green and blue.
"""

import csv
from pathlib import Path

import jax
import numpy as np

from sssfit.profiles import burley

FILE = Path(__file__).resolve().parents[2] / "data" / "profile.csv"
ALBEDO, D = np.array([0.7, 0.55, 0.4]), np.array([1.5, 1.0, 0.6])
NOISE, SEED = 0.03, 7


def main():
    r = np.round(np.geomspace(0.1, 15, 48), 4)
    with jax.enable_x64(True):
        truth = np.asarray(burley.profile(r[:, None], D, ALBEDO))
    values = truth * (1 + NOISE * np.random.default_rng(SEED).normal(size=truth.shape))
    with FILE.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["r_mm", "R_r", "R_g", "R_b", "sigma_r", "sigma_g", "sigma_b"])
        for row in zip(r, values, NOISE * truth, strict=True):
            writer.writerow([repr(float(row[0])), *(f"{x:.4e}" for x in (*row[1], *row[2]))])


if __name__ == "__main__":
    main()
