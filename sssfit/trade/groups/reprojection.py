"""How an image is found where it was in the frame before, and what is left of it after many frames."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.frames import taa, temporal
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.groups import _waves
from sssfit.trade.setting import Setting

_FRAMES = 16
_LOOKUPS: dict[str, tuple[str, Mapping[str, Any]]] = {
    **{name: (name, {}) for name in taa.LOOKUPS},
    "catmull_rom, not clamped": ("catmull_rom", {"clamp": False}),
}
_READS = {"nearest": 1, "bilinear": 4, "catmull_rom": 16}


def _prepare(setting: Setting) -> Task:
    size = 256 if setting.is_quick else 1024
    motions = _waves.motions(_FRAMES)
    start, end = (_waves.image(size, shift) for shift in (np.zeros(2), motions.sum(axis=0)))
    given = jax.device_put(start.astype(np.float32))
    choices = [_choice(name, *found, given, end, motions) for name, found in _LOOKUPS.items()]
    note = f"{size} x {size} pixels of waves that move by up to {_waves.FASTEST:g} pixels a frame"
    return Task(size * size, tuple(choices), note)


def _choice(name: str, lookup: str, options: Mapping[str, Any], start, end: np.ndarray, motions) -> Choice:
    look_up: Callable[..., Any] = getattr(temporal, lookup)
    # The nearest pixel's is compiled in two parts by itself, and slower in one.
    once = (
        look_up if lookup == "nearest" else jax.jit(lambda image, motion: look_up(image, motion, **options))
    )
    everywhere = [jnp.full((*start.shape[:2], 2), motion, jnp.float32) for motion in motions]

    def error() -> Error:
        image = start
        for motion in everywhere:
            image = once(image, motion)
        return Error(_waves.error(image, end, _FRAMES))

    return Choice(
        name=name,
        knobs={"lookup": lookup, **options},
        run=lambda: jax.block_until_ready(once(start, everywhere[0])),
        error=error,
        bytes_moved=4 * (3 * _READS[lookup] + 2 + 3),
        is_default=name == taa.DEFAULT.lookup,
    )


GROUP = Group(
    name="reprojection",
    title=f"How the frame before is looked up between its pixels, {_FRAMES} times in a row",
    unit="pixel",
    error=f"root mean square error after {_FRAMES} frames, over that of the image",
    reference="the moved image in closed form",
    prepare=_prepare,
    beside_the_front="Without the clamp light rings: beside a bright pixel there may be less than none.",
    stands_for=("frames.temporal.nearest", "frames.temporal.bilinear", "frames.temporal.catmull_rom"),
)
