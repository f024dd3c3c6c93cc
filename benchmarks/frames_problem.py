"""What the benchmarks of whole frames scatter, and what the rivals are given of it.

A rival gets in arrays all that does not depend on the samples: the source with its dark rim, each pixel's
place, scale and angle, the table or the pixel's shift of the sequence. Our pass makes these itself, on the
clock.
"""

import math
import os
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.frames import gbuffer, pixel_kernel, points, procedural, scene_profiles, surface
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import VERSIONS, Distance, Points, Settings
from sssfit.frames.scatter import every_profile, scatter
from sssfit.sampling import disk, hashes

RENDERED = Path(__file__).resolve().parents[2] / "shared" / "frames"
DISTANCES: tuple[Distance, ...] = ("plane", "surface")
CUTOFF = 16.0
#: Pixels differ where they do by more than this share.
TOLERANCE = 1e-3
#: Share of the whole profile within the cut-off.
WITHIN = float(pixel_kernel.cdf(np.array(CUTOFF)))
#: Columns of `Given.pixels`.
COLUMNS = ("a0", "a1", "b0", "b1", "column", "row", "depth", "x", "y", "cosine", "sine", "per_area")


class Scene(NamedTuple):
    """A frame, the ids that scatter, the shape parameter used for all of them, and where it comes from."""

    frame: Frame
    ids: tuple[int, ...]
    d: np.ndarray
    name: str


class Problem(NamedTuple):
    """What one pass is asked for."""

    scene: Scene
    mask: np.ndarray
    settings: Settings
    samples: int

    @property
    def total(self) -> int:
        """Samples drawn in a pass."""
        return self.samples * int(self.mask.sum())


class Given(NamedTuple):
    """What rivals are given, float32 but where said.

    Attributes:
        source: (H + 2, W + 2, 4 or 8): the lit channels, then 0 and nothing, or the depth of the pixel's
            plane and its change by column and row.
        pixels: (n, 12), see COLUMNS: pixels for each mm of a sample's x and y, across (a) and down (b); the
            centre in the source; depth and place in mm; the angle's cosine and sine; 1 / area of the plane in
            a pixel.
        version: (n,) int32, the pixel's column of the table.
        shift: (n, 2) uint32, where the pixel's sequence starts.
        table: (3, VERSIONS, samples) offsets x and y, and radius / drawn density.
        weights: (VERSIONS, samples, 4) of each channel in the plane, and nothing; 0 in space.
        d: (3,) shape parameters in mm.
        last: variate whose radius is the largest one drawn.
    """

    source: np.ndarray
    pixels: np.ndarray
    version: np.ndarray
    shift: np.ndarray
    table: np.ndarray
    weights: np.ndarray
    d: np.ndarray
    last: float
    samples: int
    is_fresh: bool
    is_surface: bool


def scene(width: int = 1920, height: int = 1080) -> Scene:
    """The rendered head where it is at hand and has this size, else the procedural frame."""
    folder = Path(os.environ.get("SSSFIT_FRAMES", RENDERED)) / "s2_head"
    if (width, height) == (1920, 1080) and (folder / "gbuffer_1080p.exr").exists():
        frame = gbuffer.load(folder / "gbuffer_1080p.exr", folder / "camera.json")
        profiles, name = scene_profiles.by_id(folder / "camera.json", "skin1"), "the rendered head"
    else:
        frame, name = procedural.frame(width=width, height=height), "the procedural frame"
        profiles = scene_profiles.by_id(None, "skin1", ids=(procedural.BALL, procedural.BOARD))
    ids = tuple(number for number, d in profiles.items() if d is not None)
    return Scene(frame, ids, np.asarray(profiles[ids[0]], np.float32), f"{name}, {width} x {height}")


def problem(
    scene: Scene, arithmetic: Points, distance: Distance, samples: int = 64, every_id: bool = False
) -> Problem:
    """A pass over the pixels of id 1, or over all that scatter, with the same profile."""
    ids = scene.ids if every_id else scene.ids[:1]
    mask = np.isin(np.asarray(scene.frame.profile_id), ids)
    settings = Settings(points=arithmetic, distance=distance, cutoff=CUTOFF)
    return Problem(scene, mask, settings, samples)


def ours(problem: Problem, counts: Any = None) -> jax.Array:
    """The pass of sssfit, complete when it returns."""
    (frame, _, d, _), mask, chosen, samples = problem
    found = scatter(
        frame.irradiance, frame.depth, frame.camera, d=d, counts=samples if counts is None else counts,
        mask=mask, normal=frame.normal, settings=chosen, most=samples,
    )  # fmt: skip
    return found.block_until_ready()


def by_ids(problem: Problem) -> jax.Array:
    """The same by `every_profile`, a pass for each profile of the frame."""
    scene = problem.scene
    profiles = {number: scene.d for number in scene.ids}
    found = every_profile(scene.frame, profiles, counts=problem.samples, settings=problem.settings)
    return found.block_until_ready()


def of_one_id(problem: Problem) -> Problem:
    """The problem on a frame whose only profile, id 1, is where the mask is."""
    frame = problem.scene.frame._replace(profile_id=jnp.asarray(problem.mask).astype(jnp.int32))
    return problem._replace(scene=problem.scene._replace(frame=frame, ids=(1,)))


def on_device(problem: Problem) -> Problem:
    """With arrays where the pass wants them."""
    mask: Any = jnp.asarray(problem.mask)
    return problem._replace(mask=mask)


def given(problem: Problem) -> Given:
    """What rivals need, for the table or the sequence of seed 0 and frame 0."""
    (frame, _, d, _), mask, chosen, samples = problem
    is_surface = chosen.distance == "surface"
    is_fresh = chosen.points == "fresh"
    rows, columns = np.nonzero(np.asarray(mask))
    version, turn, shift = _of_pixels(rows, columns, mask.shape)
    cosine, sine = (np.asarray(v) for v in disk.rotation(jnp.asarray(turn)))
    if is_fresh:
        # The angle is the sample's own.
        cosine, sine = np.ones_like(cosine), np.zeros_like(sine)
    depth = np.asarray(frame.depth)[rows, columns]
    across, up = (np.asarray(v) for v in frame.camera.pixels_per_mm(depth))
    x, y, _ = (np.asarray(v) for v in frame.camera.coordinates(columns + 0.5, rows + 0.5, depth))
    pixels = np.stack(
        [across * cosine, -across * sine, -up * sine, -up * cosine, columns + 1.5, rows + 1.5, depth, x, y]
        + [cosine, sine, across * up],
        axis=1,
    ).astype(np.float32)
    none = jnp.uint32(0)
    draw = jax.jit(lambda d: points.table(samples, d, chosen, count=samples, seed=none, frame=none))
    drawn = draw(jnp.asarray(d))
    # A radius is drawn from the mixture of the channels' profiles.
    density = sum(points.density(drawn.radius, shape, None) for shape in d) / len(d)
    table = jnp.stack([drawn.x.T, drawn.y.T, (drawn.radius / density).T])
    # There are none where they follow from the distance.
    factors = drawn.weights or [jnp.zeros_like(drawn.x)] * len(d)
    weights = jnp.stack([*(w.T for w in factors), jnp.zeros_like(drawn.x.T)], axis=-1)
    table, weights = (np.array(v, order="C") for v in (table, weights))
    last = points._last_variate(chosen.importance, None if is_surface else chosen.cutoff)
    source = _source(frame, mask, is_surface)
    return Given(
        source, pixels, version, shift, table, weights, d, last, samples, is_fresh, is_surface
    )  # fmt: skip


def _of_pixels(rows, columns, shape):
    """Version, angle in turns and shift of pixels, as the pass draws them for seed 0 and frame 0."""
    none = jnp.uint32(0)
    segment = rows * (-(-shape[1] // VERSIONS)) + columns // VERSIONS
    bits = hashes.pcg3d(segment, none, jnp.uint32(0x85EBCA6B))[0] % VERSIONS
    version = (columns % VERSIONS) ^ np.asarray(bits).astype(np.int32)
    words = hashes.pcg3d(columns, rows, none)
    turn = (words[0] >> 8).astype(jnp.float32) * 2.0**-24
    return version.astype(np.int32), np.asarray(turn), np.ascontiguousarray(np.asarray(words[:2]).T)


def _source(frame: Frame, mask, is_surface: bool) -> np.ndarray:
    lit, depth = np.asarray(frame.irradiance), np.asarray(frame.depth)
    mask, last = np.asarray(mask), []
    if is_surface:
        assert frame.normal is not None
        lit = lit * np.asarray(surface.pixel_area(frame.depth, frame.normal, frame.camera))[..., None]
        slopes = surface.depth_slopes(frame.depth, frame.normal, frame.camera)
        last = [depth, *(np.asarray(v) for v in slopes)]
    source = np.zeros((depth.shape[0] + 2, depth.shape[1] + 2, 8 if is_surface else 4), np.float32)
    source[1:-1, 1:-1, :3] = np.where(mask[..., None], lit, 0)
    for at, layer in enumerate(last):
        # Nothing is lit outside the mask: any finite depth will do there, and one far away is not needed.
        source[1:-1, 1:-1, 3 + at] = np.where(mask, layer, 0)
    return source


def check(problem: Problem, name: str, found: np.ndarray, reference: np.ndarray) -> float:
    """Compare a rival's pixels, (n, 3), with our frame; the share of pixels that differ.

    A pixel differs by more than `TOLERANCE` of its value and a tenth of that of the mean. Where samples draw
    differently at all, many do.

    Raises:
        RuntimeError: more pixels differ than rounding explains, or the means do.
    """
    wanted = reference[np.asarray(problem.mask)].astype(np.float64)
    error = found.astype(np.float64) - wanted
    mean = wanted.mean(axis=0)
    differ = np.abs(error) > TOLERANCE * (np.abs(wanted) + mean / 10)
    share, most = float(differ.any(axis=1).mean()), largest_share(problem)
    if not share <= most:
        raise RuntimeError(f"{name} draws something else: {share:.2%} of its pixels differ, above {most:.2%}")
    # What is left has no direction; a few units of rounding may have one.
    off, bound = np.abs(error.mean(axis=0)), 1e-6 * mean + 4 * error.std(axis=0) / len(error) ** 0.5
    if not (off <= bound).all():
        raise RuntimeError(f"{name} draws something else: its mean is off by {off}, above {bound}")
    return share


def largest_share(problem: Problem) -> float:
    """The share of pixels that rounding may change.

    A sample may fall on the other side of a pixel's edge: a coordinate up to 2^k has a unit of 2^(k - 24),
    and there are three roundings by half of it, on either side of an edge, in two directions, for each
    sample. In space, a distance has three roundings by half a unit of the place. The weight of a sample at r
    changes by their sum / r of itself, which is seen in the mean if r is below sum / (tolerance x samples);
    each of the samples is that close with that radius times the profile's density at 0, 1 / 2d.
    """
    height, width = problem.mask.shape
    unit = 2.0 ** (math.ceil(math.log2(max(height, width) + 2)) - 24)
    share = 2 * 3 * unit * problem.samples
    if problem.settings.distance == "surface":
        frame = problem.scene.frame
        depth = np.asarray(frame.depth)[np.asarray(problem.mask)].max()
        place = depth * max(width / frame.camera.fx, height / frame.camera.fy) / 2
        near = float(np.mean(0.5 / problem.scene.d))
        share += near * 3 * place * 2.0**-24 / TOLERANCE
    return min(1.0, share)
