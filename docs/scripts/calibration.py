"""Whether posteriors are as wide as they should be: ranks of the truth among draws, over many data sets.

Albedo and d are drawn from the prior and a curve of Burley's profile is made of them, with noise; if the
draws of the posterior are what they claim to be, the number of them below the truth is equally likely to be
any. The noise is a fifth of the profile in the middle of the prior, so that it tells nothing of the truth,
and walls of the prior matter. Prints the table, puts it into docs/fits.md and draws
docs/images/fits_calibration.png.

Run from the repository root, about ten minutes: python docs/scripts/calibration.py
With a number of data sets it prints only.

Source: Talts et al., "Validating Bayesian inference algorithms with simulation-based calibration", 2018.
"""

import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import page

from sssfit.fitting import posterior
from sssfit.profiles import burley

DOCS = Path(__file__).resolve().parents[1]
IMAGE = DOCS / "images" / "fits_calibration.png"
PRIOR = {"albedo": (0.05, 0.95), "d": (0.3, 3.0)}
NAMES = ("albedo", "d", "dmfp")
R = np.geomspace(0.1, 10, 16)
SIGMA = 0.2 * np.asarray(burley.profile(R, np.sqrt(0.3 * 3.0), 0.5), float)
DATA_SETS, BINS, DRAWS, SEED = 500, 20, 199, 2024
STEPS = 2000


def ranks_of(random: np.random.Generator, seed: int) -> list[int]:
    """How many of the draws lie below the truth, 0 to DRAWS, of one data set."""
    albedo, d = random.uniform(*PRIOR["albedo"]), np.exp(random.uniform(*np.log(PRIOR["d"])))
    truth = {"albedo": albedo, "d": d, "dmfp": float(burley.dmfp_from_shape(d, albedo))}
    values = np.asarray(burley.profile(R, d, albedo), float) + SIGMA * random.normal(size=len(R))
    steps = STEPS
    while True:
        found = posterior.sample(R, values, sigma=SIGMA, prior=PRIOR, steps=steps, seed=seed)
        if found.converged:
            break
        steps *= 2
    draws = found.draws
    chosen = np.linspace(0, len(draws["d"]) - 1, DRAWS).round().astype(int)
    return [int(np.sum(draws[name][chosen] < truth[name])) for name in NAMES]


def row(name: str, counts: np.ndarray) -> dict[str, str]:
    expected = counts.sum() / len(counts)
    chi2 = float(np.sum(np.square(counts - expected)) / expected)
    return {
        "parameter": name,
        "chi2 of ranks": f"{chi2:.1f}",
        "degrees of freedom": str(len(counts) - 1),
        "p": f"{stats.chi2.sf(chi2, len(counts) - 1):.2f}",
        "fewest in a bin": str(counts.min()),
        "most in a bin": str(counts.max()),
    }


def table(rows: list[dict[str, str]]) -> str:
    names = list(rows[0])
    head = [names, [":--"] + ["--:"] * (len(names) - 1)]
    return "\n".join("| " + " | ".join(line) + " |" for line in [*head, *(list(r.values()) for r in rows)])


def draw(counts: np.ndarray, data_sets: int) -> None:
    figure, panels = plt.subplots(
        1, len(NAMES), figsize=(10, 3.2), dpi=100, sharey=True, layout="constrained"
    )
    low, high = stats.binom(data_sets, 1 / BINS).ppf([0.005, 0.995])
    for axes, name, heights in zip(panels, NAMES, counts, strict=True):
        axes.axhspan(low, high, color="0.85", label="99 % of bins, if calibrated")
        axes.axhline(data_sets / BINS, color="0.5", lw=1)
        edges = np.linspace(0, 1, BINS + 1)
        axes.stairs(heights, edges, fill=True, alpha=0.55, color="#2b5fb3", label="data sets")
        axes.set(title=name, xlabel="rank of the truth among draws", xlim=(0, 1))
    panels[0].set(ylabel=f"of {data_sets} data sets", ylim=(0, 1.35 * high))
    panels[0].legend(frameon=False, loc="upper center", fontsize=8)
    figure.savefig(IMAGE, metadata={"Software": None})


def main(data_sets: int = DATA_SETS) -> None:
    start = time.perf_counter()
    random = np.random.default_rng(SEED)
    ranks = []
    for i in range(data_sets):
        ranks.append(ranks_of(random, i))
        if (i + 1) % 50 == 0:
            print(f"{i + 1} of {data_sets}, {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    size = (DRAWS + 1) // BINS
    counts = np.array([np.bincount(column // size, minlength=BINS) for column in np.array(ranks).T])
    text = table([row(name, heights) for name, heights in zip(NAMES, counts, strict=True)])
    print(text)
    if data_sets != DATA_SETS:
        return
    draw(counts, data_sets)
    fits = DOCS / "fits.md"
    if fits.exists() and "<!-- begin calibration -->" in fits.read_text(encoding="utf-8"):
        page.replace(fits, "calibration", text)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
