"""What the studies of whole frames share: the rendered scenes, their samples, tables and pictures.

The scenes are no part of the repository; they lie in `shared/frames` beside it, or where SSSFIT_FRAMES says.
"""

import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import page

from sssfit.frames import gbuffer, reference, scatter, scene_profiles
from sssfit.frames.camera import orthographic
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings

DOCS = Path(__file__).resolve().parents[1]
FOLDER = Path(os.environ.get("SSSFIT_FRAMES", DOCS.parents[1] / "shared" / "frames"))
COLOURS = ("red", "green", "blue")
INK = ("tab:red", "tab:green", "tab:blue")


class Scene(NamedTuple):
    """The pixels of one profile in a frame, and those among them that are measured.

    Attributes:
        name: of the scene and its profile.
        frame: see `gbuffer.Frame`.
        d: mm, by channel.
        mask: the pixels of the profile.
        measured: those of them that samples are drawn for.
        a, b: two independent halves of the reference at the measured pixels, (P, 3).
    """

    name: str
    frame: Frame
    d: np.ndarray
    mask: np.ndarray
    measured: np.ndarray
    a: np.ndarray
    b: np.ndarray


def scene(name: str, profile: str, *, every: int = 1, layer: str = "E") -> Scene:
    """Id 1 of a rendered scene; every so manieth row is measured, all rows give light."""
    folder = FOLDER / name
    camera, exact = folder / "camera.json", folder / f"exact_{profile}.exr"
    frame = gbuffer.load(folder / "gbuffer.exr", camera, layers={"irradiance": layer})
    mask = np.asarray(frame.profile_id) == 1
    measured = only_rows(mask, every)
    known = reference.load(exact, mask)
    sss, diff = (v[measured].astype(float) for v in (known.sss, known.diff))
    d = np.asarray(scene_profiles.by_id(camera, profile, exact)[1], float)
    return Scene(f"{name}, {profile}", frame, d, mask, measured, sss + diff, sss - diff)


def flat(of: Scene, pixel_mm: float, every: int) -> Scene:
    """A scene's light on a plane seen head-on, without a reference: `exact.convolve` is its answer."""
    height, width = of.mask.shape
    frame = of.frame._replace(
        camera=orthographic(width, height, pixel_mm),
        depth=jnp.full((height, width), 500.0),
        normal=jnp.broadcast_to(jnp.array([0.0, 0.0, 1.0]), (height, width, 3)),
    )
    mask = np.ones((height, width), bool)
    none = np.zeros((0, 3))
    return Scene(f"{of.name}, laid flat", frame, of.d, mask, only_rows(mask, every), none, none)


def only_rows(mask: np.ndarray, every: int) -> np.ndarray:
    return mask & (np.arange(len(mask)) % every == every // 2)[:, None]


def drawn(of: Scene, settings: Settings, spp: int, seed: int, most: int | None = None) -> np.ndarray:
    """The measured pixels of one image, (P, 3), float64. `most` is for fewer programs, see `scatter`."""
    image = scatter.scatter(
        of.frame.irradiance, of.frame.depth, of.frame.camera, d=of.d, counts=np.where(of.measured, spp, 0),
        mask=of.mask, normal=of.frame.normal, settings=settings, seed=seed, most=most or spp,
    )  # fmt: skip
    return np.asarray(image)[of.measured].astype(float)


def mean_of(of: Scene, settings: Settings, spp: int, seeds: Iterable[int], most: int | None = None):
    """Mean of several images at the measured pixels, (P, 3)."""
    images = (drawn(of, settings, spp, seed, most) for seed in seeds)
    total, number = np.zeros((int(of.measured.sum()), 3)), 0
    for image in images:
        total, number = total + image, number + 1
    return total / number


class Root(NamedTuple):
    """Root of a mean square that was measured as a product of independent halves, by channel.

    Attributes:
        value: of the reference's root mean square; negative where the mean of products is.
        error: of its square, over pixels as a sample, as a root: a value below it is zero as far as is known.
    """

    value: np.ndarray
    error: np.ndarray


def root(first: np.ndarray, second: np.ndarray, power: np.ndarray) -> Root:
    """Relative norm that two differences have in common, (P, 3) each."""
    product = first * second
    square = product.mean(axis=0) / power
    spread = product.std(axis=0) / np.sqrt(len(product)) / power
    return Root(np.sign(square) * np.sqrt(abs(square)), np.sqrt(spread))


def percent(found: Root, digits: int = 2) -> str:
    """Three channels in %, what is not distinguishable from zero as a bound."""
    return ", ".join(
        f"{100 * v:.{digits}f}" if v > e else f"< {100 * max(e, 10.0**-digits / 100):.{digits}f}"
        for v, e in zip(found.value, found.error, strict=True)
    )


def three(values: Iterable[float], form: str = ".2f") -> str:
    return ", ".join(format(v, form) for v in values)


def table(rows: Sequence[dict[str, str]], words: int = 1) -> str:
    """Markdown; the first columns are words, the others numbers."""
    names = list(rows[0])
    head = [names, [":--"] * words + ["--:"] * (len(names) - words)]
    return "\n".join("| " + " | ".join(line) + " |" for line in [*head, *(list(r.values()) for r in rows)])


def write(name: str, text: str, to: str = "frames.md") -> None:
    """Print a result, and put it in its place on the page."""
    print(f"\n{name}\n{text}", flush=True)
    page.replace(DOCS / to, name, text)


def save(figure, name: str) -> None:
    figure.savefig(DOCS / "images" / f"frames_{name}.png", metadata={"Software": None})


def commit() -> str:
    done = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=DOCS, capture_output=True, text=True)
    return done.stdout.strip() or "unknown"
