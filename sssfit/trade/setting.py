"""On what the choices are measured: how thoroughly, and on which frame."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from sssfit.frames import procedural, render
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.frames.scene_profiles import Profiles

#: Of the procedural frame's ball: skin's three shapes, mm.
SKIN = np.array([1.9178483, 0.4794626, 0.2035194])
#: Width and height of the procedural frame.
QUICK_SIZE, FULL_SIZE = (320, 180), (640, 360)
#: Pixels up to which every pixel's light is summed exactly; beyond, this many samples stand for the sum.
MOST_SUMMED, REFERENCE_SAMPLES = 45_000, 16_384


@dataclass(frozen=True)
class Setting:
    """What groups are measured on.

    Attributes:
        is_quick: fewer choices and smaller arrays, for a first look.
        frame: what frames' groups scatter.
        profiles: shapes in mm by id.
        frame_name: what the report calls it.
    """

    is_quick: bool
    frame: Frame
    profiles: Profiles
    frame_name: str

    @functools.cached_property
    def mask(self) -> np.ndarray:
        """Pixels with a profile, (H, W)."""
        return render.scatters(self.frame, self.profiles)

    @functools.cached_property
    def pixels(self) -> int:
        """How many those are."""
        return int(self.mask.sum())

    @property
    def is_summed(self) -> bool:
        """Whether the reference is exact."""
        return self.pixels <= MOST_SUMMED and self.frame.normal is not None

    @functools.cached_property
    def reference(self) -> np.ndarray:
        """The scattered frame that others are compared with, (H, W, 3)."""
        if self.is_summed:
            return render.by_sums(self.frame, self.profiles).image
        settings = Settings() if self.frame.normal is not None else Settings(distance="plane")
        many: dict[str, Any] = {
            "least": REFERENCE_SAMPLES,
            "most": REFERENCE_SAMPLES,
            "seed": render.LARGEST_SEED,
        }
        return render.by_sampling(self.frame, self.profiles, settings, **many).image

    def describe(self) -> dict[str, Any]:
        """Facts for a report."""
        height, width = self.mask.shape
        return {"frame": self.frame_name, "width": width, "height": height, "pixels": self.pixels}


def procedural_setting(is_quick: bool) -> Setting:
    """The package's own frame, for those who give none.

    Args:
        is_quick: see `Setting`.

    Returns:
        A small scene with one profile, a ball of skin.

    Example:
        >>> procedural_setting(True).describe()["width"]
        320
    """
    width, height = QUICK_SIZE if is_quick else FULL_SIZE
    frame = procedural.frame(width=width, height=height)
    return Setting(is_quick, frame, {1: SKIN, 2: None}, "procedural")
