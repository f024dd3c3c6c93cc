"""On what the choices are measured: how thoroughly, and on which frame."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from sssfit.files.json_text import sha256_bytes
from sssfit.frames import procedural, render
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.frames.scene_profiles import Profiles

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
        is_procedural: whether the frame is the package's own.
        exact: the scattered frame, (H, W, 3), where it is known already.
    """

    is_quick: bool
    frame: Frame
    profiles: Profiles
    frame_name: str
    is_procedural: bool = False
    exact: np.ndarray | None = None

    @functools.cached_property
    def mask(self) -> np.ndarray:
        """Pixels with a profile, (H, W)."""
        return render.scatters(self.frame, self.profiles)

    @functools.cached_property
    def pixels(self) -> int:
        """How many those are."""
        return int(self.mask.sum())

    @property
    def settings(self) -> Settings:
        """The default settings, but for what needs normals where the frame has none."""
        return Settings() if self.frame.normal is not None else Settings(estimator="ratio")

    @functools.cached_property
    def reference(self) -> np.ndarray:
        """The scattered frame that others are compared with, (H, W, 3)."""
        if self.exact is not None:
            return self.exact
        if self.pixels <= MOST_SUMMED and self.frame.normal is not None:
            return render.by_sums(self.frame, self.profiles).image
        many: dict[str, Any] = {
            "least": REFERENCE_SAMPLES,
            "most": REFERENCE_SAMPLES,
            "seed": render.LARGEST_SEED,
        }
        return render.by_sampling(self.frame, self.profiles, self.settings, **many).image

    def describe(self) -> dict[str, Any]:
        """Facts for a report, and what tells one frame from another."""
        height, width = self.mask.shape
        content = b"".join(np.asarray(layer).tobytes() for layer in self.frame[:5] if layer is not None)
        shapes = {str(i): None if d is None else list(map(float, d)) for i, d in self.profiles.items()}
        size = {"width": width, "height": height, "pixels": self.pixels}
        return {"frame": self.frame_name, **size, "d_mm": shapes, "frame_sha256": sha256_bytes(content)}


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
    profiles: Profiles = {procedural.BALL: skin(), procedural.BOARD: None}
    return Setting(is_quick, frame, profiles, "procedural", is_procedural=True)


def skin() -> np.ndarray:
    """The shapes of the procedural scene's ball.

    Returns:
        d, mm, (3,).

    Example:
        >>> skin().round(2)
        array([1.92, 0.48, 0.2 ])
    """
    scene = procedural.describe(range(0), [], width=1, height=1)
    return np.asarray(scene["profiles_by_id"][str(procedural.BALL)]["d"])
