"""Measure the scattering of docs/frames.md: its table, CSV file and pictures.

Run from the repository root, both studies in a minute and a half on two cores, or one of them:

    python docs/scripts/frames.py [pictures] [bias]
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")
import frames_data
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import interleaved

from sssfit.files.arrays import csv_bytes
from sssfit.frames import compare, exact, preview, procedural, scatter
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings

DOCS = Path(__file__).resolve().parents[1]
# The exact sum over the board takes a minute at twice this size.
SIZE, PICTURE_SIZE = {"width": 256, "height": 144}, {"width": 320, "height": 180}
SEEDS = 64
COUNTS = (16, 64)
VARIANTS = tuple(
    Settings(plane=plane, estimator=estimator)
    for estimator in ("unbiased", "ratio")
    for plane in ("screen", "tangent")
)


class Part(NamedTuple):
    """The pixels of one profile, and what infinitely many samples make of them."""

    name: str
    d: np.ndarray
    mask: np.ndarray
    exact: np.ndarray


def profiles() -> dict[int, tuple[str, np.ndarray]]:
    described = procedural.describe(range(1), ["frame_00.exr"], **SIZE)["profiles_by_id"]
    return {int(key): (profile["name"], np.asarray(profile["d"])) for key, profile in described.items()}


def parts(frame: Frame) -> Iterator[Part]:
    assert frame.normal is not None
    for number, (name, d) in profiles().items():
        mask = np.asarray(frame.profile_id) == number
        found = exact.visible(frame.irradiance, frame.depth, frame.normal, frame.camera, d, mask=mask)
        yield Part(name, d, mask, found.scattered)


# --- the pictures


def study_pictures() -> None:
    frame = procedural.frame(**PICTURE_SIZE)
    (DOCS / "images" / "frames_procedural.png").write_bytes(preview.layers(frame))
    truth = np.sum([part.exact for part in parts(frame)], axis=0)
    shapes = {number: d for number, (_, d) in profiles().items()}
    drawn = np.asarray(scatter.every_profile(frame, shapes, counts=16))
    white = float(np.asarray(frame.irradiance).max())
    difference = 0.5 + 8 * (drawn - truth) / white
    shown = {
        "irradiance": display(np.asarray(frame.irradiance) / white),
        "scattered, 16 samples a pixel": display(drawn / white),
        "exact": display(truth / white),
        "8 × (scattered − exact); grey is 0, cut at 1/16 of white": np.clip(difference, 0, 1),
    }
    figure, axes = plt.subplots(2, 2, figsize=(12.4, 7.5), dpi=100, layout="constrained")
    for one, (title, picture) in zip(axes.flat, shown.items(), strict=True):
        one.imshow(picture, interpolation="nearest")
        one.set_title(title, fontsize=14, loc="left")
        one.set_axis_off()
    figure.savefig(DOCS / "images" / "frames_scattered.png", metadata={"Software": None})


def display(linear: np.ndarray) -> np.ndarray:
    """Linear colours as sRGB."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


# --- bias and noise


def measured(frame: Frame, part: Part, settings: Settings, count: int) -> dict[str, Any]:
    """Bias and error of single images over their seeds, in the mean and the norm of the exact one."""
    mean, none = part.exact[part.mask].mean(axis=0, dtype=np.float64), np.zeros_like(part.exact)
    bias, errors = [], []
    for seed in range(SEEDS):
        image = scatter.scatter(
            frame.irradiance, frame.depth, frame.camera, d=jnp.asarray(part.d), counts=count,
            mask=part.mask, normal=frame.normal, settings=settings, seed=seed,
        )  # fmt: skip
        found = compare.compare(image, part.exact, none, part.mask)
        bias.append(np.divide(found.bias, mean))
        errors.append(found.relative_l2)
    row: dict[str, Any] = {
        "profile": part.name,
        "samples": count,
        "estimator": settings.estimator,
        "plane": settings.plane,
    }
    for channel, values in zip("rgb", np.transpose(bias), strict=True):
        row[f"bias_{channel}"] = float(values.mean())
        row[f"bias_{channel}_se"] = float(values.std(ddof=1) / np.sqrt(SEEDS))
    for channel, values in zip("rgb", np.transpose(errors), strict=True):
        row[f"error_{channel}"], row[f"worst_{channel}"] = float(np.median(values)), float(values.max())
    return row


def study_bias() -> None:
    frame = procedural.frame(**SIZE)
    rows = [
        measured(frame, part, settings, count)
        for part in parts(frame)
        for settings in VARIANTS
        for count in COUNTS
    ]
    shown = []
    for row in rows:
        cells = {name: str(row[name]) for name in ("profile", "estimator", "plane", "samples")}
        for channel, colour in zip("rgb", ("red", "green", "blue"), strict=True):
            bias, error = 100 * row[f"bias_{channel}"], 100 * row[f"bias_{channel}_se"]
            cells[f"bias {colour}, %"] = f"{bias:+.3f} ± {error:.3f}"
        for name, key in (("error of an image, %", "error"), ("that of the worst, %", "worst")):
            cells[name] = ", ".join(f"{100 * row[f'{key}_{c}']:.1f}" for c in "rgb")
        shown.append(cells)
    write("bias", frames_data.table(shown, 3), {name: [row[name] for row in rows] for name in rows[0]})
    unbiased = [row for row in rows if row["estimator"] == "unbiased"]
    largest = max(abs(row[f"bias_{c}"]) / row[f"bias_{c}_se"] for row in unbiased for c in "rgb")
    shapes = "; ".join(f"{name} d = {', '.join(f'{x:.2f}' for x in d)} mm" for name, d in profiles().values())
    write(
        "bias conditions",
        f"{interleaved.machine()}. Frame 0 at {SIZE['width']} × {SIZE['height']} pixels, {SEEDS} seeds; "
        f"{shapes}. The largest of the {3 * len(unbiased)} biases of the unbiased estimator is "
        f"{largest:.1f} standard errors.",
    )


def write(name: str, text: str, columns: dict[str, Any] | None = None) -> None:
    frames_data.write(name, text)
    if columns is not None:
        (DOCS / "data" / f"frames_{name}.csv").write_bytes(csv_bytes(columns))


STUDIES = {"pictures": study_pictures, "bias": study_bias}


def main() -> None:
    for name in sys.argv[1:] or STUDIES:
        STUDIES[name]()


if __name__ == "__main__":
    main()
