"""Convolution by FFT beside sampling, where both are right: a flat surface seen from straight above."""

import jax.numpy as jnp
import numpy as np

from sssfit.frames import camera, exact
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting, skin

_WIDTH, _PIXELS, _QUICK_PIXELS = 40.0, 512, 256
_SAMPLES = (16, 64, 256)


def _prepare(setting: Setting) -> Task:
    size = _QUICK_PIXELS if setting.is_quick else _PIXELS
    flat, convolved = _flat(size, setting.is_quick)
    settings = Settings(distance="plane")
    sampled = [
        _frames.choice(flat, f"{n} samples", {"method": "scatter", "spp": n}, settings, n) for n in _SAMPLES
    ]
    return Task(flat.pixels, (convolved, *sampled), f"{size} x {size} pixels, {_WIDTH:g} mm wide")


def _flat(size: int, is_quick: bool) -> tuple[Setting, Choice]:
    """A board of white and grey squares, seen from straight above, and its convolution."""
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
    d, pixel = skin(), _WIDTH / size

    def run() -> np.ndarray:
        return exact.convolve(irradiance, d, (pixel, pixel))

    # What others are measured against has no error beside itself.
    fft = Choice("FFT", {"method": "convolve"}, run, error=lambda: Error(0.0), bytes_moved=4 * (3 + 3))
    return Setting(is_quick, frame, {1: d}, "board", exact=run()), fft


GROUP = Group(
    name="convolution",
    title="A flat surface: convolution by FFT, or samples",
    unit="pixel",
    error=_frames.ERROR,
    reference="the convolution in float64, which is right to some 1e-13 of the light",
    prepare=_prepare,
    stands_for=("frames.exact.convolve",),
)
