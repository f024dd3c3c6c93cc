"""Whole frames against exact references: a beam on a slab, and curved scenes by method."""

import matplotlib.pyplot as plt
import numpy as np
from frames_data import (
    COLOURS,
    INK,
    Root,
    Scene,
    drawn,
    mean_of,
    percent,
    root,
    save,
    scene,
    table,
    three,
    write,
)  # fmt: skip

from sssfit.frames import exact
from sssfit.frames.points import Settings
from sssfit.sampling import inverse_cdf

# --- the beam

BEAM_SETTINGS = Settings(distance="plane")
BEAM_PIXEL = (0.125, 0.125)
BEAM_SPP, BEAM_SEEDS, BEAM_ROWS = 4096, 32, 8
IMPORTANCE_SPP, IMPORTANCE_SEEDS, IMPORTANCE_ROWS = 1024, 32, 12


def study_beam() -> None:
    layers, rows, residuals = [], [], {}
    for profile in ("skin1", "marble"):
        layers += [
            layer_row(profile, layer, scene("s1_beam", profile, layer=layer)) for layer in ("E", "E_box")
        ]
        beam = scene("s1_beam", profile, every=BEAM_ROWS, layer="E_box")
        halves = [
            np.stack([drawn(beam, BEAM_SETTINGS, BEAM_SPP, seed) for seed in range(first, BEAM_SEEDS, 2)])
            for first in (0, 1)
        ]
        means = np.concatenate(halves).mean(axis=1) - beam.a.mean(axis=0)
        bias, error = means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(BEAM_SEEDS)
        found = [half.mean(axis=0) - beam.a for half in halves]
        left = root(*found, np.square(beam.a).mean(axis=0))
        of_pixels = limit_of(beam).mean(axis=0) - beam.a.mean(axis=0)
        single = np.sqrt(np.mean([np.square(image - beam.a).mean(axis=0) for image in halves[0]], axis=0))
        rows.append(
            {
                "profile": profile,
                "bias of the mean, % (red, green, blue)": three(100 * bias / beam.a.mean(axis=0), "+.4f"),
                "its standard error, %": three(100 * error / beam.a.mean(axis=0), ".4f"),
                "bias / error": three(bias / error, "+.1f"),
                "less that of pixels, / error": three((bias - of_pixels) / error, "+.1f"),
                "bias / error of one image": three(bias / error / np.sqrt(BEAM_SEEDS), "+.1f"),
                "relative L2 without noise, %": percent(left, 3),
                "relative L2 of one image, %": three(100 * single / np.sqrt(np.square(beam.a).mean(axis=0))),
            }
        )
        residuals[profile] = by_distance(beam, np.mean(found, axis=0))
    write("beam layers", table(layers, 2))
    write("beam", table(rows))
    draw_beam(residuals)


def limit_of(beam: Scene) -> np.ndarray:
    """What infinitely many samples leave: light that is constant in a pixel, by convolution."""
    return exact.convolve(beam.frame.irradiance, beam.d, BEAM_PIXEL)[beam.measured]


def layer_row(profile: str, layer: str, beam: Scene) -> dict[str, str]:
    limit = limit_of(beam) - beam.a
    power = np.square(beam.a).mean(axis=0)
    return {
        "profile": profile,
        "light": layer,
        "bias of the mean, %": three(100 * limit.mean(axis=0) / beam.a.mean(axis=0), "+.4f"),
        "relative L2, %": three(100 * np.sqrt(np.square(limit).mean(axis=0) / power), ".3f"),
    }


def by_distance(beam: Scene, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact profile over the distance from the beam's axis, and the mean residual there."""
    row, column = np.nonzero(beam.measured)
    r = 0.125 * np.hypot(row + 0.5 - 180, column + 0.5 - 320)
    ring = np.minimum(r, 21.9).astype(int)
    number = np.bincount(ring, minlength=22)
    rings = [
        np.stack([np.bincount(ring, v[:, c], 22) for c in range(3)], -1) / number[:, None]
        for v in (beam.a, residual)
    ]
    return np.arange(22)[:21] + 0.5, rings[0][:21], rings[1][:21]


def draw_beam(residuals) -> None:
    figure, axes = plt.subplots(2, 2, figsize=(10, 6.4), dpi=100, layout="constrained", sharex=True)
    for (upper, lower), (profile, (r, truth, residual)) in zip(axes.T, residuals.items(), strict=True):
        for c, (colour, ink) in enumerate(zip(COLOURS, INK, strict=True)):
            upper.semilogy(r, np.where(truth[:, c] > 1e-5, truth[:, c], np.nan), color=ink, label=colour)
            lower.plot(r, 100 * residual[:, c] / truth[:, c].max(), color=ink)
        upper.set(title=f"{profile}: exact", ylabel="irradiance, unit of E")
        lower.axhline(0, color="grey", lw=0.8)
        lower.set(ylabel="mean of the images − exact,\n% of the largest", xlabel="distance from the axis, mm")
        upper.legend()
    save(figure, "beam")


def study_importance() -> None:
    beam = scene("s1_beam", "skin1", every=IMPORTANCE_ROWS, layer="E_box")
    row, column = np.nonzero(beam.measured)
    r = 0.125 * np.hypot(row + 0.5 - 180, column + 0.5 - 320)
    parts = {"centre (r < 5 mm)": r < 5, "rim (10 to 15 mm)": (r > 10) & (r < 15)}
    limit = limit_of(beam)
    rows, chosen = [], [(name, True) for name in inverse_cdf.METHODS] + [("xie", False)]
    base = BEAM_SETTINGS._replace(channels="widest")
    for name, corrected in chosen:
        settings = base._replace(importance=name, corrected=corrected)
        images = np.stack([drawn(beam, settings, IMPORTANCE_SPP, seed) for seed in range(IMPORTANCE_SEEDS)])
        found = [half.mean(axis=0) - limit for half in (images[::2], images[1::2])]
        # The widest channel alone: it is the one that the radius is drawn for.
        left = root(*(f[:, :1] for f in found), np.square(beam.a[:, :1]).mean(axis=0))
        cells = {"importance": f"{name}{'' if corrected else ', uncorrected'}"}
        for part, inside in parts.items():
            means = images[:, inside, 0].mean(axis=1) / limit[inside, 0].mean() - 1
            bias, error = means.mean(), means.std(ddof=1) / np.sqrt(len(means))
            cells[f"bias, {part}, %"] = f"{100 * bias:+.3f} ± {100 * error:.3f}"
            cells[f"/ error, {part.split()[0]}"] = f"{bias / error:+.1f}"
        cells["relative L2 without noise, %"] = percent(left, 3)
        rows.append(cells)
        print(cells, flush=True)
    write("importance", table(rows))


# --- curved scenes

CASES = (("s2_head", "skin1"), ("s2_head", "marble"), ("s3_skull", "marble"), ("s4_patch", "skin1"))
METHODS = {
    f"{estimator}, {distance}, {plane}": Settings(estimator=estimator, distance=distance, plane=plane)
    for estimator in ("unbiased", "ratio")
    for distance, plane in (("surface", "screen"), ("surface", "tangent"), ("plane", "screen"))
}
METHOD_ROWS, METHOD_SPP, METHOD_SEEDS = 6, 64, 8
LIMIT_SPP, LIMIT_SEEDS = 1024, 8
#: Scenes where a sum over all that is seen takes less than two minutes.
SUMMED = (("s2_head", "skin1"), ("s3_skull", "marble"))


def study_methods() -> None:
    rows, shown, planes = [], {}, []
    for case in CASES:
        of = scene(*case, every=METHOD_ROWS)
        found = {name: parted(of, settings) for name, settings in METHODS.items()}
        for name, (total, model, sampling, bias, worst) in found.items():
            rows.append(
                {
                    "frame": of.name,
                    "method": name,
                    "total at 64, %": percent(total, 1),
                    "model, %": percent(model, 1),
                    "sampling at 64, %": three(100 * sampling, ".1f"),
                    "mean of the model, %": three(100 * bias, "+.1f"),
                    "worst pixel": f"{worst:.0f}",
                }
            )
            print(rows[-1], flush=True)
        if case in SUMMED:
            rows.append(summed_row(of))
        shown[of.name] = found
        for estimator in ("unbiased", "ratio"):
            both = [found[f"{estimator}, surface, {plane}"] for plane in ("screen", "tangent")]
            planes.append(
                {
                    "frame": of.name,
                    "estimator": estimator,
                    "total, tangent / screen": three(both[1][0].value / both[0][0].value),
                    "model, tangent − screen, %": three(100 * (both[1][1].value - both[0][1].value), "+.2f"),
                    "sampling, tangent / screen": three(both[1][2] / both[0][2]),
                }
            )
    write("methods", table(rows, 2))
    write("planes", table(planes, 2))
    draw_methods(shown)


def parted(of: Scene, settings: Settings) -> tuple[Root, Root, np.ndarray, np.ndarray, float]:
    """Total, model and sampling error, the model's bias in the mean, and the worst pixel / its reference."""
    power, level = (of.a * of.b).mean(axis=0), (of.a + of.b).mean(axis=0) / 2
    halves = [
        mean_of(of, settings, LIMIT_SPP, range(first, LIMIT_SEEDS, 2)) - half
        for first, half in ((0, of.a), (1, of.b))
    ]
    model = root(*halves, power)
    images = np.stack([drawn(of, settings, METHOD_SPP, 1000 + seed) for seed in range(METHOD_SEEDS)])
    totals = [root(image - of.a, image - of.b, power) for image in images]
    total = Root(
        np.sqrt(np.mean([np.square(t.value) * np.sign(t.value) for t in totals], axis=0)),
        np.mean([t.error for t in totals], axis=0),
    )
    sampling = np.sqrt(images.var(axis=0, ddof=1).mean(axis=0) / power)
    bias = sum(half.mean(axis=0) for half in halves) / 2 / level
    return total, model, sampling, bias, float((images / level).max())


def summed_row(of: Scene) -> dict[str, str]:
    assert of.frame.normal is not None
    found = exact.visible(
        of.frame.irradiance, of.frame.depth, of.frame.normal, of.frame.camera, of.d, mask=of.mask
    ).scattered[of.measured]
    power, level = (of.a * of.b).mean(axis=0), (of.a + of.b).mean(axis=0) / 2
    return {
        "frame": of.name,
        "method": "the exact sum over what is seen",
        "total at 64, %": "",
        "model, %": percent(root(found - of.a, found - of.b, power), 1),
        "sampling at 64, %": "0",
        "mean of the model, %": three(100 * ((found - (of.a + of.b) / 2).mean(axis=0) / level), "+.1f"),
        "worst pixel": "",
    }


def draw_methods(shown) -> None:
    figure, axes = plt.subplots(2, 2, figsize=(12, 8), dpi=100, layout="constrained", sharex=True)
    for one, (name, found) in zip(axes.flat, shown.items(), strict=True):
        for c, ink in enumerate(INK):
            at = np.arange(len(found)) + 0.26 * (c - 1)
            model = [max(100 * p[1].value[c], 0) for p in found.values()]
            sampling = [100 * p[2][c] for p in found.values()]
            one.bar(at - 0.06, model, 0.12, color=ink)
            one.bar(at + 0.06, sampling, 0.12, color=ink, alpha=0.4)
        one.set(title=name, yscale="log", ylim=(0.3, 200), ylabel="relative L2, %")
        one.set_xticks(range(len(found)), [n.replace(", ", "\n") for n in found])
        one.grid(axis="y", alpha=0.4)
        one.set_axisbelow(True)
    figure.suptitle(
        "Left bars: model error, whatever the samples; right, pale bars: sampling error at 64 samples"
    )
    save(figure, "methods")


STUDIES = {"beam": study_beam, "importance": study_importance, "methods": study_methods}
