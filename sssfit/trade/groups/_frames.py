"""What the groups that scatter frames share: an image's error over several seeds, and its cost."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from sssfit.frames import scatter
from sssfit.frames.points import Settings
from sssfit.trade.choice import CannotMeasure, Choice, Error, Task
from sssfit.trade.setting import MOST_SUMMED, REFERENCE_SAMPLES, Setting

#: What an image's error is, and against what.
ERROR = "root mean square error over that of the light"
REFERENCE = (
    f"the exact sum over all visible pixels, or, for more than {MOST_SUMMED:,} of them or without normals, "
    f"{REFERENCE_SAMPLES:,} samples in each"
)
#: Samples of a pixel where something else is chosen, and the default of `sssfit render`.
SPP = 64
#: Images with independent samples over which an error is averaged.
_SEEDS = 4
# Of a pixel: three numbers of irradiance, depth, its normal and id read, three written. Of a sample: three
# numbers of irradiance, in eight texels if it is prefiltered, and its depth where distance is to the surface.
_PIXEL_BYTES, _SAMPLE_BYTES, _TEXELS, _DEPTH_BYTES = 4 * (3 + 1 + 3 + 1 + 3), 12, 8, 4


def choice(
    setting: Setting,
    name: str,
    knobs: Mapping[str, Any],
    settings: Settings,
    counts: int | np.ndarray,
    is_default: bool = False,
) -> Choice:
    """A way to scatter the setting's frame."""
    most = int(np.max(counts))
    drawn = float(np.mean(np.broadcast_to(counts, setting.mask.shape)[setting.mask]))

    def image(seed: int) -> np.ndarray:
        found = scatter.every_profile(
            setting.frame, setting.profiles, counts=counts, settings=settings, most=most, seed=seed
        )
        return jax.block_until_ready(found)

    sample_bytes = _SAMPLE_BYTES * (1 if settings.prefilter is None else _TEXELS)
    sample_bytes += _DEPTH_BYTES if settings.distance == "surface" else 0
    return Choice(
        name=name,
        knobs=dict(knobs),
        run=lambda: image(0),
        error=lambda: error_of([np.asarray(image(seed)) for seed in range(_SEEDS)], setting),
        samples=drawn,
        bytes_moved=_PIXEL_BYTES + sample_bytes * drawn,
        is_default=is_default,
    )


def task(setting: Setting, choices: Sequence[Choice]) -> Task:
    """A group's task on the setting's frame."""
    height, width = setting.mask.shape
    return Task(setting.pixels, tuple(choices), f"{setting.frame_name}, {width} x {height}")


def varied(
    setting: Setting, base: Settings, variants: Mapping[str, Mapping[str, Any]], spp: int = SPP
) -> list[Choice]:
    """Choices that differ from the base in some fields of its settings, by their names."""
    needs_pixels(setting)
    found = []
    for name, fields in variants.items():
        settings = base._replace(**fields)
        is_default = settings == base and spp == SPP
        found.append(choice(setting, name, {**fields, "spp": spp}, settings, spp, is_default))
    return found


def needs_pixels(setting: Setting) -> None:
    """Raise where nothing scatters, or no light."""
    if setting.pixels == 0:
        raise CannotMeasure("the frame has no pixel with a profile")
    if not np.any(np.asarray(setting.frame.irradiance)[setting.mask]):
        raise CannotMeasure("no pixel with a profile has light")


def needs_normals(setting: Setting) -> None:
    """Raise where the frame has none."""
    if setting.frame.normal is None:
        raise CannotMeasure("the frame has no normals")


def error_of(images: list[np.ndarray], setting: Setting) -> Error:
    """The error of images with independent samples, and its standard error."""
    reference = setting.reference[setting.mask].astype(np.float64)
    power = np.mean(np.square(reference))
    squares = [np.mean(np.square(image[setting.mask] - reference)) / power for image in images]
    mean = float(np.mean(squares))
    noise = np.std(squares, ddof=1) / np.sqrt(len(squares)) if len(squares) > 1 else 0.0
    return Error(mean**0.5, float(noise / (2 * mean**0.5)) if mean > 0 else 0.0)
