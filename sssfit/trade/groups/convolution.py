"""Convolution by FFT beside sampling, where both are right: a flat surface seen from straight above."""

import jax.numpy as jnp
import numpy as np

from sssfit.frames import camera, exact
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.trade.choice import Choice, Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import SKIN, Setting

_WIDTH, _PIXELS, _QUICK_PIXELS = 40.0, 512, 256
_SAMPLES = (16, 64, 256)


def _prepare(setting: Setting) -> Task:
    size = _QUICK_PIXELS if setting.is_quick else _PIXELS
    flat = _flat(size, setting.is_quick)
    settings = Settings(distance="plane")
    sampled = [
        _frames.choice(flat, f"{n} samples", {"method": "scatter", "spp": n}, settings, n) for n in _SAMPLES
    ]
    return Task(
        flat.pixels, (_convolved(flat, size), *sampled), f"{size} x {size} pixels, {_WIDTH:g} mm wide"
    )


def _flat(size: int, is_quick: bool) -> Setting:
    """A board of white and grey squares, seen from straight above."""
    cells = (np.indices((size, size)) // (size // 8)).sum(axis=0) % 2
    irradiance = np.repeat(np.where(cells, 1.0, 0.1)[..., None], 3, axis=-1).astype(np.float32)
    frame = Frame(
        irradiance=jnp.asarray(irradiance),
        depth=jnp.full((size, size), 500.0, jnp.float32),
        normal=None,
        albedo=None,
        profile_id=jnp.ones((size, size), jnp.int32),
        motion=None,
        camera=camera.orthographic(size, size, _WIDTH / size),
    )
    return Setting(is_quick, frame, {1: SKIN}, "board")


def _convolved(flat: Setting, size: int) -> Choice:
    irradiance, pixel = np.asarray(flat.frame.irradiance), _WIDTH / size

    def run():
        return exact.convolve(irradiance, SKIN, (pixel, pixel), mask=flat.mask)

    return Choice(
        name="FFT",
        knobs={"method": "convolve"},
        run=run,
        error=lambda: _frames.error_of([run()], flat),
        bytes_moved=4 * (3 + 3),
    )


GROUP = Group(
    name="convolution",
    title="A flat surface: convolution by FFT, or samples",
    unit="pixel",
    error=_frames.ERROR,
    reference="the convolution in float64 (its own error is 0 but for rounding)",
    prepare=_prepare,
    stands_for=("frames.exact.convolve",),
)
