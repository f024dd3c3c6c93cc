"""Measure fits of profiles: the tables and pictures of docs/fits.md.

Run from the repository root, all studies in some ten minutes on two cores, or some of them:

    python docs/scripts/fits.py [coverage] [beams] [transport] [solvers]

The beams are rendered scenes, which are no part of the repository (see frames_data.FOLDER). Whether
posteriors are calibrated is a study of its own, calibration.py.
"""

import csv
import sys
import time

import frames_data
import jax
import matplotlib.pyplot as plt
import numpy as np
import page

from sssfit.fitting import measured, measured_many, measurement_image
from sssfit.profiles import burley

PAGE = frames_data.DOCS / "fits.md"
CHANNELS = ("red", "green", "blue")


def write(name: str, text: str) -> None:
    """Put a table into the page, and print it."""
    print(f"\n{name}\n{text}", flush=True)
    page.replace(PAGE, name, text)


def save(figure, name: str) -> None:
    figure.savefig(frames_data.DOCS / "images" / f"fits_{name}.png", dpi=110, bbox_inches="tight")
    plt.close(figure)


# --- intervals of planted parameters

SETS, POINTS, SEED = 4000, 48, 20261129
R_MM = np.geomspace(0.1, 20, POINTS)


def planted(number: int, seed: int):
    """Random albedos, diffuse mean free paths, noise, and the curves that they give."""
    random = np.random.default_rng(seed)
    albedo = random.uniform(0.1, 0.9, number)
    dmfp, noise = (
        np.exp(random.uniform(np.log(low), np.log(high), number)) for low, high in ((1, 8), (0.005, 0.1))
    )
    with jax.enable_x64(True):
        d = np.asarray(burley.shape_from_dmfp(dmfp, albedo))
        truth = np.asarray(burley.profile(R_MM, d[:, None], albedo[:, None]))
    sigma = noise[:, None] * truth
    return albedo, d, dmfp, sigma, truth + sigma * random.normal(size=truth.shape)


def study_coverage() -> None:
    """How often intervals hold the truth."""
    albedo, d, dmfp, sigma, curves = planted(SETS, SEED)
    rows, levels = [], np.linspace(0.02, 0.98, 49)
    found = [measured.fit(R_MM, curve, sigma=s) for curve, s in zip(curves, sigma, strict=True)]
    many = measured_many.fit(R_MM, curves, sigma=sigma)
    share = {}
    for name, truth in (("albedo", albedo), ("d", d), ("dmfp", dmfp)):
        estimates = [fit.parameters[name] for fit in found]
        row = {"parameter": f"`{name}`"}
        for level in (68, 95):
            ends = np.array([getattr(estimate, f"interval_{level}") for estimate in estimates])
            inside = np.mean((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
            error = np.sqrt(level / 100 * (1 - level / 100) / SETS)
            row[f"{level} % intervals hold, %"] = f"{100 * inside:.2f} ± {100 * error:.2f}"
        row["not determined"] = str(sum(not estimate.determined for estimate in estimates))
        rows.append(row)
    for column, name, truth in ((0, "albedo", albedo), (1, "d", d)):
        ends = [measured_many.interval(many, level) for level in levels]
        share[name] = [np.mean((low[:, column] <= truth) & (truth <= high[:, column])) for low, high in ends]
    apart = max(
        float(np.max(np.abs(many.parameters[:, i] / [fit.parameters[name].value for fit in found] - 1)))
        for i, name in enumerate(("albedo", "d"))
    )
    noted = sum(bool(fit.notes) for fit in found)
    write("coverage", frames_data.table(rows))
    print(f"fit and measured_many differ by at most {apart:.1e}; {noted} fits have notes")
    draw_coverage(levels, share)


def draw_coverage(levels, share) -> None:
    figure, axes = plt.subplots(figsize=(5.2, 3.4))
    band = 1.96 * np.sqrt(levels * (1 - levels) / SETS)
    axes.fill_between(
        levels, -100 * band, 100 * band, color="0.85", label="95 % of studies of exact intervals"
    )
    for name, found in share.items():
        axes.plot(levels, 100 * (np.array(found) - levels), label=name)
    axes.axhline(0, color="0.4", linewidth=0.8)
    axes.set(
        xlabel="level of the interval", ylabel="coverage less the level, percentage points", ylim=(-4, 4)
    )
    axes.legend(frameon=False)
    save(figure, "coverage")


# --- rendered beams

TRUTH = {"skin1": (1.9178483, 0.4794626, 0.2035194), "marble": (7.9299257, 5.0164360, 3.4088466)}
BEAM_RADIUS, PIXEL, IRRADIANCE, CUTOFF = 10.0, 0.125, 10 / np.pi, 16.0


def study_beams() -> None:
    """Shapes recovered from path-traced beams."""
    rows, drawn = [], {}
    for kind in ("ref", "exact"):
        for profile, truth in TRUTH.items():
            path = frames_data.FOLDER / "s1_beam" / f"{kind}_{profile}.exr"
            given = measurement_image.load_image(
                path, pixel_mm=PIXEL, response="beam", layer="sss", irradiance=IRRADIANCE
            )
            found = fit_beam(given, CUTOFF)
            drawn[kind, profile] = found
            for channel, name, d in zip("rgb", CHANNELS, truth, strict=True):
                estimate = found[channel].parameters["d"]
                low, high = (100 * (end / d - 1) for end in estimate.interval_95)
                rows.append(
                    {
                        "image": f"{profile}, {'Cycles' if kind == 'ref' else 'exact'}",
                        "channel": name,
                        "d rendered, mm": f"{d:.5f}",
                        "d found": f"{estimate.value:.5f}",
                        "off by, %": f"{100 * (estimate.value / d - 1):+.3f}",
                        "95 % interval, %": f"{low:+.3f} to {high:+.3f}",
                        "albedo": f"{found[channel].parameters['albedo'].value:.4f}",
                        "chi2 / dof": f"{found[channel].chi2_per_dof:.3g}",
                    }
                )
    write("beams", frames_data.table(rows, 2))
    draw_beams(drawn)


def fit_beam(given, cutoff: float) -> dict[str, measured.Fit]:
    """Each channel alone."""
    return {
        channel: measured.fit(
            given.r, given.values[:, i], sigma=given.sigma[:, i],
            response="beam", beam_radius=BEAM_RADIUS, cutoff=cutoff,
        )
        for i, channel in enumerate("rgb")
    }  # fmt: skip


def draw_beams(drawn) -> None:
    figure, axes = plt.subplots(2, 2, figsize=(9, 5), sharex="col", height_ratios=(2, 1))
    for column, profile in enumerate(TRUTH):
        for channel, ink in zip("rgb", frames_data.INK, strict=True):
            fit = drawn["ref", profile][channel]
            above, below = axes[:, column]
            above.plot(fit.r, fit.values[:, 0], ".", color=ink, markersize=2, alpha=0.5)
            above.plot(fit.r, fit.fitted[:, 0], color=ink, linewidth=1)
            below.plot(fit.r, (fit.values - fit.fitted)[:, 0] / fit.sigma[:, 0], ".", color=ink, markersize=2)
        above.set(title=f"{profile}, Cycles", yscale="log", ylim=(1e-5, 2))
        below.set(xlabel="distance from the beam's axis, mm", ylim=(-5, 5))
    axes[0, 0].set_ylabel("exitance / irradiance")
    axes[1, 0].set_ylabel("residual / sigma")
    save(figure, "beams")


# --- transport

CLAIMED = {"searchlight": 5.5, "diffuse": 3.9}
MODELS = ("burley", "dipole", "gaussians:2", "gaussians:4")


def study_transport() -> None:
    """Photon transport fitted by each profile, and by Burley's own formulas without any fit."""
    rows, drawn = [], []
    for (illumination, _), (r, values, sigma, albedo) in transport().items():
        # What is asked is how near a profile comes to where light leaves, not how likely it is: differences
        # of the radial density 2 pi r R, whatever their noise.
        density = r**2 * np.gradient(r)
        fits = {
            model: measured.fit(r, values, model=model, weights=density, eta=1.0, solver="all")
            for model in MODELS
        }
        row = {"light": illumination, "albedo": f"{albedo:.3f}", "claimed, %": f"{CLAIMED[illumination]}"}
        row["formula, %"] = f"{100 * energy_error(r, values, formula(r, albedo, illumination)):.2f}"
        for model, fit in fits.items():
            row[f"{model}, %"] = f"{100 * energy_error(r, values, fit.fitted[:, 0]):.2f}"
        burley_fit = fits["burley"].parameters
        row["d by formula, mm"] = f"{1 / float(burley.scaling(albedo, illumination)):.4f}"
        row["d fitted"] = f"{burley_fit['d'].value:.4f}"
        row["albedo fitted"] = f"{burley_fit['albedo'].value:.3f}"
        rows.append(row)
        drawn.append((illumination, albedo, r, values, sigma, fits))
        print(row, max(fit.disagreement for fit in fits.values()), flush=True)
    write("transport", frames_data.table(rows))
    draw_transport([case for case in drawn if case[0] == "searchlight"])


def transport() -> dict:
    """By illumination and single-scattering albedo: distances, R, its standard error, and the albedo."""
    with (frames_data.DOCS / "data" / "transport.csv").open() as file:
        rows = list(csv.DictReader(file))
    cases = {}
    for row in rows:
        key = row["illumination"], float(row["single_scattering_albedo"])
        names = ("r_mm", "R", "sigma", "albedo", "r_inner_mm", "r_outer_mm")
        cases.setdefault(key, []).append([float(row[name]) for name in names])
    found = {}
    for key, case in cases.items():
        r, values, sigma, albedo, inner, outer = np.array(case).T
        found[key] = where_ring_means_are_met(r, values, inner, outer), values, sigma, float(albedo[0])
    return found


def where_ring_means_are_met(r, values, inner, outer) -> np.ndarray:
    """The distance in each ring at which R is the ring's mean, if R is a power of r there."""
    power = -np.gradient(np.log(values), np.log(r))
    steps = np.linspace(0, 1, 201)[:, None]
    across = inner + (outer - inner) * steps
    mean = np.trapezoid(across ** (1 - power), across, axis=0) / np.trapezoid(across, across, axis=0)
    return mean ** (-1 / power)


def formula(r: np.ndarray, albedo: float, illumination) -> np.ndarray:
    """Burley's profile of a mean free path of 1 mm, by the published scaling."""
    with jax.enable_x64(True):
        return np.asarray(burley.profile(r, burley.shape_from_mfp(1.0, albedo, illumination), albedo))


def energy_error(r: np.ndarray, wanted: np.ndarray, found: np.ndarray) -> float:
    """The share of the light that leaves elsewhere, int r |found - wanted| dr / int r wanted dr."""

    def integral(values):
        return np.trapezoid(r * r * values, np.log(r))

    return float(integral(abs(found - wanted)) / integral(wanted))


def draw_transport(cases) -> None:
    figure, axes = plt.subplots(
        2, len(cases), figsize=(11, 5.4), sharex=True, sharey="row", height_ratios=(2, 1)
    )
    for column, (_, albedo, r, values, sigma, fits) in zip(axes.T, cases, strict=True):
        above, below = column
        above.errorbar(r, r * values, 2 * r * sigma, fmt="k.", markersize=3, label="photon transport")
        for model, ink in zip(MODELS, ("tab:blue", "tab:orange", "tab:green", "tab:red"), strict=True):
            fitted = fits[model].fitted[:, 0]
            above.plot(r, r * fitted, color=ink, linewidth=1, label=model)
            below.plot(r, 100 * (fitted / values - 1), color=ink, linewidth=1)
        above.set(title=f"albedo {albedo:.2f}", xscale="log", yscale="log", ylim=(1e-6, 0.2))
        below.set(xlabel="distance, mean free paths", ylim=(-60, 60))
    axes[0, 0].set_ylabel("r R, 1/mm")
    axes[1, 0].set_ylabel("fit / transport - 1, %")
    axes[0, 0].legend(frameon=False, fontsize=8)
    save(figure, "transport")


# --- solvers


def study_solvers() -> None:
    """Three solvers on the same curves."""
    with jax.enable_x64(True):
        clean = np.asarray(burley.profile(R_MM, 1.5, 0.7))
    noisy = clean * (1 + 0.03 * np.random.default_rng(SEED).normal(size=POINTS))
    cases = {"Burley's, 3 % noise": (R_MM, noisy, 0.03 * clean)}
    for (illumination, _), (r, values, sigma, albedo) in transport().items():
        if illumination == "searchlight":
            cases[f"transport, albedo {albedo:.2f}"] = (r, values, sigma)
    rows = []
    for name, (r, values, sigma) in cases.items():
        row = {"curve": name}
        for model in ("burley", "dipole", "jimenez", *(f"gaussians:{k}" for k in (1, 2, 3, 4, 6))):
            found = measured.fit(r, values, model=model, sigma=sigma, solver="all")
            row[model] = f"{found.disagreement:.0e}"
            if found.disagreement > 1e-6 or not found.converged:
                print(name, model, found.disagreement, found.status, found.notes, flush=True)
        rows.append(row)
    write("solvers", frames_data.table(rows))


STUDIES = {
    "coverage": study_coverage,
    "beams": study_beams,
    "transport": study_transport,
    "solvers": study_solvers,
}


def main() -> None:
    for name in sys.argv[1:] or STUDIES:
        start = time.perf_counter()
        STUDIES[name]()
        print(f"{name}: {time.perf_counter() - start:.0f} s, commit {frames_data.commit()}", flush=True)


if __name__ == "__main__":
    main()
