"""A whole frame in one go: how many samples, the image, and others like it with other random numbers.

Every pass runs inside a `Step` of the caller's, which may show, time or protect it.
"""

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from sssfit.frames import _layers, adaptive, exact, scatter, split
from sssfit.frames.gbuffer import LAYERS, Frame
from sssfit.frames.points import Settings
from sssfit.frames.scene_profiles import Profiles

#: What surrounds a pass, by the name of the pass; or a piece of one, by that name and its share of the pass.
Step = Callable[..., AbstractContextManager[Any]]
#: How many seeds of the samplers belong to one seed of `by_sampling`.
SEEDS = 1024
#: Width in pixels of the square over which a pilot's variances are averaged: a few samples tell little of one
#: pixel, and neighbours differ little.
SMOOTHING = 5
_FINAL, _PILOT, _FIRST_REPLICATE = 0, 1, 2
#: What that leaves for replicates, and the largest seed.
MOST_REPLICATES = SEEDS - _FIRST_REPLICATE
LARGEST_SEED = 2**32 // SEEDS - 1


class Rendered(NamedTuple):
    """A scattered frame.

    Attributes:
        image: (H, W, 3), float32, in the irradiance's unit for albedo 1; irradiance where nothing scatters.
        counts: samples drawn for it in each pixel, (H, W), uint32; 0 where none are.
        pilot_samples: samples of the pass before it, which are not in the image.
        left_out: share of the profile's light that sums left out, (3,), by id; empty where it was sampled.
    """

    image: np.ndarray
    counts: np.ndarray
    pilot_samples: int
    left_out: dict[int, np.ndarray]


def size(path: str | os.PathLike[str], layer: str | None = None) -> tuple[int, int]:
    """Width and height of a frame in a file, for cameras whose numbers do not say it.

    Args:
        path: the EXR file.
        layer: that of the irradiance, as for `gbuffer.load`; None for its usual name.

    Returns:
        Pixels across and down.

    Raises:
        FileError: the file is missing, truncated or no EXR image, or lacks the layer.

    Example:
        >>> import pathlib, tempfile
        >>> from sssfit.frames import gbuffer, procedural
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "frame.exr"
        ...     gbuffer.write(path, procedural.frame(width=64, height=36))
        ...     size(path)
        (64, 36)
    """
    name = LAYERS["irradiance"] if layer is None else layer
    found = _layers.Layers(path).find(name, _layers.COLOUR, "irradiance", needed=True)
    assert found is not None
    return found.shape[1], found.shape[0]


def scatters(frame: Frame, profiles: Profiles) -> np.ndarray:
    """The pixels that have a profile.

    Args:
        frame: see `gbuffer.Frame`.
        profiles: d in mm by id; None where nothing scatters.

    Returns:
        (H, W), boolean.

    Example:
        >>> from sssfit.frames import procedural
        >>> mask = scatters(procedural.frame(width=64, height=36), {1: np.ones(3), 2: None})
        >>> mask[20, 26], mask[30, 60]
        (np.True_, np.False_)
    """
    kept = [number for number, d in profiles.items() if number and d is not None]
    return np.isin(np.asarray(frame.profile_id), kept)


def by_sampling(
    frame: Frame,
    profiles: Profiles,
    settings: Settings,
    *,
    least: int,
    most: int,
    target_variance: float | None = None,
    seed: int = 0,
    step: Step = nullcontext,
) -> Rendered:
    """Scatter a frame by Monte Carlo, with as many samples as a pilot pass finds each pixel to need.

    The pilot has random numbers of its own, and none of its samples is in the image: counts that depended on
    an image's own samples would bias it.

    Args:
        frame, profiles: as for `scatter.every_profile`.
        settings: see `points.Settings`.
        least, most: bounds of a pixel's count, from 1 on.
        target_variance: wanted of the Rec. 709 luminance of image / pi; None for `most` samples everywhere.
        seed: from 0 to `LARGEST_SEED`; the image is that of `scatter.every_profile` with 1024 times it,
            the pilot has one more, and `replicates` have those from two more on.
        step: around the passes "compile pilot", "pilot", "compile final" and "final". Compiling is a call
            with one pixel of each id; in it the frame is prepared once, too.

    Returns:
        See `Rendered`.

    Raises:
        ValueError: as `scatter.every_profile`, or a number out of its range.

    Example:
        >>> from sssfit.frames import procedural
        >>> frame, profiles = procedural.frame(width=64, height=36), {1: np.ones(3), 2: None}
        >>> made = by_sampling(frame, profiles, Settings(), least=16, most=16)
        >>> int(made.counts.sum()) == 16 * int((frame.profile_id == 1).sum())
        True
    """
    _check_seed(seed, 0)
    mask = _sampled(frame, profiles, settings)
    wanted, pilot_samples = np.full(mask.shape, most, np.int32), 0
    if target_variance is not None:
        pilot = max(least, 2)
        options: dict[str, Any] = {"counts": pilot, "settings": settings, "seed": SEEDS * seed + _PILOT}
        variance = _compiled_apart("pilot", scatter.variance_of_samples, frame, profiles, options, step)
        variance = adaptive.smoothed(variance, np.where(mask, np.asarray(frame.profile_id), 0), SMOOTHING)
        wanted = adaptive.counts(variance, target_variance, least, most)
        pilot_samples = pilot * int(mask.sum())
    drawn = np.where(mask, wanted, 0)
    options = {"counts": drawn, "settings": settings, "seed": SEEDS * seed + _FINAL}
    image = _compiled_apart("final", scatter.every_profile, frame, profiles, options, step)
    return Rendered(image, drawn.astype(np.uint32), pilot_samples, {})


def replicates(
    frame: Frame,
    profiles: Profiles,
    settings: Settings,
    counts: np.ndarray,
    *,
    number: int,
    seed: int = 0,
    step: Step = nullcontext,
) -> Iterator[np.ndarray]:
    """Images like that of `by_sampling`, with the same counts and independent samples.

    Args:
        frame, profiles, settings: as they were there.
        counts: those of the image.
        number: how many, at most `MOST_REPLICATES`.
        seed: as it was there.
        step: around each, by the names "replicate 1" and so on.

    Returns:
        (H, W, 3) float32 each; made one at a time.

    Raises:
        ValueError: a number out of its range.

    Example:
        >>> from sssfit.frames import procedural
        >>> frame, profiles = procedural.frame(width=64, height=36), {1: np.ones(3), 2: None}
        >>> made = replicates(frame, profiles, Settings(), np.full((36, 64), 16), number=8)
        >>> next(made).shape
        (36, 64, 3)
    """
    _check_seed(seed, number)
    for index in range(number):
        with step(f"replicate {index + 1}"):
            words = SEEDS * seed + _FIRST_REPLICATE + index
            found = scatter.every_profile(frame, profiles, counts=counts, settings=settings, seed=words)
            found = np.asarray(found)
        yield found


def by_sums(
    frame: Frame,
    profiles: Profiles,
    *,
    cutoff: float | None = exact.CUTOFF,
    radius_limit: float | None = None,
    step: Step = lambda name, share=1.0: nullcontext(),
) -> Rendered:
    """Scatter a frame by `exact.convolve` where that is right, and else by `exact.visible`.

    A convolution is right where an orthographic camera sees a profile's pixels at one depth, to rounding.

    Args:
        frame, profiles: as for `scatter.every_profile`.
        cutoff: as for `exact.convolve`.
        radius_limit: as for `exact.visible`, mm; a convolution has none.
        step: around the pass of each id, by the names "id 1" and so on; around the pieces of a sum over
            pixels instead, each with its share of the id's pass as a second argument.

    Returns:
        See `Rendered`. A channel whose d is 0 keeps its irradiance.

    Raises:
        ValueError: as the two functions, or a curved frame without normals.

    Example:
        >>> from sssfit.frames import procedural
        >>> frame = procedural.frame(width=64, height=36)
        >>> by_sums(frame, {1: np.ones(3), 2: None}).left_out[1].tolist()
        [0.0, 0.0, 0.0]
    """
    irradiance, depth = np.asarray(frame.irradiance, np.float32), np.asarray(frame.depth, np.float32)
    ids, image, left_out = np.asarray(frame.profile_id), irradiance.copy(), {}
    for number in np.unique(ids[scatters(frame, profiles)]).tolist():
        given = profiles[number]
        assert given is not None
        mask, d, left_out[number] = ids == number, np.asarray(given, float), np.zeros(len(given))
        used = d > 0
        name = f"id {number}"
        if not used.any():
            with step(name):
                continue
        if frame.camera.projection == "orthographic" and _is_flat(depth[mask]):
            size = 1 / frame.camera.fy, 1 / frame.camera.fx
            with step(name):
                found = exact.convolve(irradiance[..., used], d[used], size, mask=mask, cutoff=cutoff)
        else:
            if frame.normal is None:
                raise ValueError("the exact sum over a curved surface needs the frame's normals")
            found, left_out[number][used] = exact.visible(
                irradiance[..., used], depth, frame.normal, frame.camera, d[used], mask=mask, cutoff=cutoff,
                radius_limit=radius_limit, step=functools.partial(step, name),
            )  # fmt: skip
        image[..., used] = np.where(mask[..., None], found, image[..., used])
    return Rendered(image, np.zeros(ids.shape, np.uint32), 0, left_out)


def _compiled_apart(
    name: str, function, frame: Frame, profiles: Profiles, options: dict[str, Any], step: Step
):
    """What a pass gives, as an array on the host, after a call whose time is that of compiling."""
    ids, first = np.unique(np.asarray(frame.profile_id), return_index=True)
    few = np.zeros(frame.profile_id.shape, np.int32)
    few.flat[first] = ids
    with step(f"compile {name}"):
        np.asarray(function(frame._replace(profile_id=jnp.asarray(few)), profiles, **options))
    with step(name):
        return np.asarray(function(frame, profiles, **options))


def _sampled(frame: Frame, profiles: Profiles, settings: Settings) -> np.ndarray:
    """The pixels in which samples are drawn."""
    ids = np.asarray(frame.profile_id)
    mask = scatters(frame, profiles)
    for number in np.unique(ids[mask]).tolist():
        d, here = np.asarray(profiles[number], np.float32), ids == number
        if not d.any():
            mask &= ~here
        elif settings.split is not None:
            depth = jnp.where(here, frame.depth, 1)
            share = np.asarray(split.distant_share(depth, frame.camera, d, settings))
            mask &= ~here | (share >= settings.split)
    return mask


def _is_flat(depth: np.ndarray) -> bool:
    return bool(np.ptp(depth) <= 1e-6 * depth.max())


def _check_seed(seed: int, number: int) -> None:
    if not 0 <= seed <= LARGEST_SEED:
        raise ValueError(f"seed must be from 0 to {LARGEST_SEED}, got {seed}")
    if not 0 <= number <= MOST_REPLICATES:
        raise ValueError(f"number must be from 0 to {MOST_REPLICATES}, got {number}")
