"""Write the shipped intensities of data/lights. Run from the repository root:

    python docs/scripts/lights.py

The candle is a synthetic flame: the logarithm of its intensity is a sum of two stationary first-order
autoregressions, a draught of 0.5 s and a flicker of 0.05 s, and of a puffing at 11 Hz whose phase wanders;
standard deviations 0.12, 0.08 and 0.05. It is scaled to the mean 1 over its ten seconds.
"""

import csv
from pathlib import Path

import numpy as np

from sssfit.scenarios import light

FOLDER = Path(__file__).resolve().parents[2] / "data" / "lights"
FRAMES, SEED = 600, 11


def candle() -> np.ndarray:
    random = np.random.default_rng(SEED)
    logarithm = np.zeros(FRAMES)
    for seconds, deviation in ((0.5, 0.12), (0.05, 0.08)):
        kept = np.exp(-1 / (light.FPS * seconds))
        stream = random.normal(size=FRAMES)
        for frame in range(1, FRAMES):
            stream[frame] = kept * stream[frame - 1] + np.sqrt(1 - kept**2) * stream[frame]
        logarithm += deviation * stream
    phase = np.cumsum(2 * np.pi * 11 / light.FPS + 0.3 * random.normal(size=FRAMES))
    logarithm += 0.05 * np.sqrt(2) * np.sin(phase)
    intensity = np.exp(logarithm)
    return intensity / intensity.mean()


def main():
    FOLDER.mkdir(parents=True, exist_ok=True)
    made = {"candle": candle()}
    made |= {name: light.LIGHTS[name](FRAMES) for name in ("static", "sine", "on_off")}
    for name, intensity in made.items():
        with (FOLDER / f"{name}.csv").open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["time", "intensity"])
            for frame, value in enumerate(intensity):
                writer.writerow([repr(frame / light.FPS), f"{value:.6f}"])


if __name__ == "__main__":
    main()
