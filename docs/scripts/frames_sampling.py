"""Whole frames over the number of samples: sequences, tables or fresh points, the prefilter, the split."""

import matplotlib.pyplot as plt
import numpy as np
from frames_data import INK, Scene, drawn, flat, mean_of, percent, root, save, scene, table, three, write

from sssfit.frames import exact, split
from sssfit.frames.points import Settings

PIXEL = 0.1
FLAT = Settings(distance="plane")
#: Colours of lines, by sequence.
SEQUENCES = {
    "iid": "black",
    "r2": "tab:orange",
    "sobol": "tab:blue",
    "hammersley": "tab:green",
    "fibonacci": "tab:pink",
}
POINTS = ("table", "fresh")
SPP = tuple(1 << k for k in range(13))
#: Sequences that know their length: a table of each length is a program of its own.
WHOLE = ("hammersley", "fibonacci")


def patch(every: int) -> Scene:
    return flat(scene("s4_patch", "skin1"), PIXEL, every)


def flat_limit(of: Scene, estimator: str = "unbiased") -> np.ndarray:
    """What the plane's estimators converge to, at the measured pixels."""
    lit = exact.convolve(of.frame.irradiance, of.d, (PIXEL, PIXEL))
    if estimator == "ratio":
        lit = lit / exact.convolve(np.ones_like(lit), of.d, (PIXEL, PIXEL))
    return lit[of.measured]


# --- error against the number of samples


def study_spp() -> None:
    of = patch(every=20)
    limit = flat_limit(of)
    norm = np.sqrt(np.square(limit).mean())
    errors, at_64, images_mean = {}, {}, {}
    for points in POINTS:
        for sequence in SEQUENCES:
            settings, key = FLAT._replace(points=points, sequence=sequence), (points, sequence)
            most = None if sequence in WHOLE else SPP[-1]
            errors[key] = {
                spp: rmse(of, settings, spp, 16 if spp <= 64 else 4, limit, most) / norm
                for spp in (SPP[::2] if sequence in WHOLE and points == "table" else SPP)
            }
            images = np.stack([drawn(of, settings, 64, 5000 + seed, most) for seed in range(24)])
            at_64[key] = np.square(images - limit).mean(axis=(0, 1))
            images_mean[key] = images.mean(axis=1).std(axis=0, ddof=1) / limit.mean(axis=0)
            print(key, {n: round(e, 5) for n, e in errors[key].items()}, flush=True)
    rows = []
    for points in POINTS:
        for sequence in SEQUENCES:
            key = points, sequence
            later = {n: e for n, e in errors[key].items() if n >= 16}
            slope = np.polyfit(np.log(list(later)), np.log(list(later.values())), 1)[0]
            rows.append(
                {
                    "points": points,
                    "sequence": sequence,
                    **{f"RMSE at {n}, %": f"{100 * errors[key][n]:.2f}" for n in (1, 16, 64, 4096)},
                    "slope from 16 on": f"{slope:.2f}",
                    "gain at 64, by channel": three(at_64["fresh", "iid"] / at_64[key]),
                    "deviation of an image's mean at 64, %": three(100 * images_mean[key], ".3f"),
                }
            )
    write("spp", table(rows, 2))
    draw_spp(errors)
    write("points", study_head())


def rmse(of: Scene, settings: Settings, spp: int, seeds: int, limit: np.ndarray, most: int | None) -> float:
    errors = [np.square(drawn(of, settings, spp, seed, most) - limit).mean() for seed in range(seeds)]
    return float(np.sqrt(np.mean(errors)))


def study_head() -> str:
    """The same at 64 samples on the head: variance between images, since seeing is part of its limit."""
    of, rows, variance = scene("s2_head", "skin1", every=8), [], {}
    norm = np.square((of.a + of.b) / 2).mean(axis=0)
    for points in POINTS:
        for sequence in SEQUENCES:
            settings = Settings(points=points, sequence=sequence)
            images = np.stack([drawn(of, settings, 64, seed) for seed in range(24)])
            variance[points, sequence] = images.var(axis=0, ddof=1).mean(axis=0)
            deviation = images.mean(axis=1).std(axis=0, ddof=1) / ((of.a + of.b) / 2).mean(axis=0)
            rows.append(
                {
                    "points": points,
                    "sequence": sequence,
                    "sampling error, %": three(100 * np.sqrt(variance[points, sequence] / norm), ".2f"),
                    "deviation of an image's mean, %": three(100 * deviation, ".3f"),
                }
            )
    for row, found in zip(rows, variance.values(), strict=True):
        row["gain over fresh iid"] = three(variance["fresh", "iid"] / found)
    return table(rows, 2)


def draw_spp(errors) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.8), dpi=100, layout="constrained", sharey=True)
    for one, points in zip(axes, POINTS, strict=True):
        for sequence, colour in SEQUENCES.items():
            found = errors[points, sequence]
            one.loglog(
                list(found), [100 * e for e in found.values()], "o-", ms=3, color=colour, label=sequence
            )
        start = 100 * errors["fresh", "iid"][1]
        one.loglog(SPP, start / np.sqrt(SPP), ":", color="grey", label="slope −1/2")
        one.loglog(SPP, start * np.array(SPP, float) ** -0.75, "--", color="grey", label="slope −3/4")
        one.set(title=f"points: {points}", xlabel="samples in a pixel")
        one.grid(alpha=0.4)
    axes[0].set_ylabel("RMSE, % of the image's root mean square")
    axes[0].legend()
    save(figure, "spp")


# --- the prefilter

SCALES = (None, 1 / 64, 1 / 16, 1 / 4, 1.0, 4.0, 16.0)


def study_prefilter() -> None:
    of, rows, shown = patch(every=8), [], {}
    for estimator in ("unbiased", "ratio"):
        limit = flat_limit(of, estimator)
        power = np.square(limit).mean(axis=0)
        for spp in (16, 64):
            for scale in SCALES:
                settings = FLAT._replace(estimator=estimator, prefilter=scale)
                images = np.stack([drawn(of, settings, spp, seed, 64) for seed in range(24)])
                bias = root(images[::2].mean(axis=0) - limit, images[1::2].mean(axis=0) - limit, power)
                spread = np.sqrt(images.var(axis=0, ddof=1).mean(axis=0) / power)
                total = np.sqrt(np.square(images - limit).mean(axis=(0, 1)) / power)
                shown[estimator, spp, scale] = (
                    np.where(bias.value > bias.error, bias.value, np.nan),
                    spread,
                    total,
                )
                rows.append(
                    {
                        "estimator": estimator,
                        "a": "none" if scale is None else f"{scale:g}" if scale >= 1 else f"1/{1 / scale:g}",
                        "samples": str(spp),
                        "bias, %": percent(bias),
                        "deviation, %": three(100 * spread),
                        "RMSE, %": three(100 * total),
                    }
                )
                print(rows[-1], flush=True)
    write("prefilter", table(rows, 2))
    draw_prefilter(shown)


def draw_prefilter(shown) -> None:
    figure, axes = plt.subplots(
        2, 2, figsize=(11, 7.4), dpi=100, layout="constrained", sharex=True, sharey=True
    )
    scales = [s for s in SCALES if s is not None]
    for line, estimator in zip(axes, ("unbiased", "ratio"), strict=True):
        for one, spp in zip(line, (16, 64), strict=True):
            for c, ink in enumerate(INK):
                bias, spread, _ = (
                    100 * np.array([shown[estimator, spp, s][k][c] for s in scales]) for k in range(3)
                )
                one.loglog(scales, bias, "s--", color=ink, ms=4)
                one.loglog(scales, spread, "o-", color=ink, ms=4)
                one.axhline(100 * shown[estimator, spp, None][1][c], color=ink, ls=":", lw=1)
            one.set(title=f"{estimator}, {spp} samples")
            one.grid(alpha=0.4)
        line[0].set_ylabel("% of the image's root mean square")
    for one in axes[1]:
        one.set_xlabel("a")
    for style, label in (("ko-", "deviation"), ("ks--", "bias"), ("k:", "deviation without")):
        axes[0, 0].plot([], [], style, ms=4, label=label)
    axes[0, 0].legend()
    save(figure, "prefilter")


# --- the split

LEAST = (0.0, 0.01, 0.05)
#: The head as if seen from so many times as far.
SMALLER = (1, 4, 32, 64)


def study_split() -> None:
    rows = []
    head = scene("s2_head", "skin1", every=8)
    for plane in ("screen", "tangent"):
        for smaller in SMALLER:
            of = head._replace(d=head.d / smaller)
            share = np.asarray(split.distant_share(of.frame.depth, of.frame.camera, of.d, Settings()))
            reached = share[of.measured]
            whole = halves_and_variance(of, Settings(points="fresh", plane=plane))
            sampled = [float((reached >= least).mean()) for least in LEAST]
            for least, part in zip(LEAST, sampled, strict=True):
                # A larger epsilon matters only where it spares samples.
                if least == 0 or part < sampled[0]:
                    settings = Settings(points="fresh", plane=plane, split=least)
                    found = halves_and_variance(of, settings)
                    rows.append(split_row(of, plane, reached, least, whole, found))
                    print(rows[-1], flush=True)
    write("split", table(rows))


def halves_and_variance(of: Scene, settings: Settings):
    """Two independent means, and the variance of images of 64 samples."""
    halves = [mean_of(of, settings, 1024, range(first, 8, 2)) for first in (0, 1)]
    images = np.stack([drawn(of, settings, 64, 100 + seed) for seed in range(12)])
    return halves, images.var(axis=0, ddof=1).mean(axis=0)


def split_row(of: Scene, plane: str, reached: np.ndarray, least: float, whole, found) -> dict[str, str]:
    (halves, variance), (parted, parted_variance) = whole, found
    level, power = sum(halves).mean(axis=0) / 2, (halves[0] * halves[1]).mean(axis=0)
    # Different seeds in the two factors: what they share is the split's bias.
    apart = root(parted[0] - halves[0], parted[1] - halves[1], power)
    return {
        "plane": plane,
        "d of red, mm": f"{of.d[0]:.3f}",
        "beyond the disc, % of red": f"{100 * np.median(reached):.1f}",
        "ε": f"{least:g}",
        "pixels sampled, %": f"{100 * (reached >= least).mean():.0f}",
        "variance / without": three(parted_variance / variance, ".3f"),
        "bias of the mean, %": three(100 * (sum(parted) - sum(halves)).mean(axis=0) / 2 / level, "+.2f"),
        "bias, relative L2, %": percent(apart),
        "sampling error without, %": three(100 * np.sqrt(variance / power), ".1f"),
    }


STUDIES = {"spp": study_spp, "prefilter": study_prefilter, "split": study_split}
