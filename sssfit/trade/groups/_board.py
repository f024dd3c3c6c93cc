"""What the groups on a flat surface share: a board of white and grey squares, and its exact convolution."""

import jax.numpy as jnp
import numpy as np

from sssfit.frames import camera, exact
from sssfit.frames.gbuffer import Frame
from sssfit.trade.choice import Choice, Error
from sssfit.trade.setting import Setting, skin

WIDTH = 40.0
_PIXELS, _QUICK_PIXELS = 512, 256


def flat(is_quick: bool) -> tuple[Setting, Choice]:
    """The board, seen from straight above, and its convolution as a choice."""
    size = _QUICK_PIXELS if is_quick else _PIXELS
    cells = (np.indices((size, size)) // (size // 8)).sum(axis=0) % 2
    irradiance = np.repeat(np.where(cells, 1.0, 0.1)[..., None], 3, axis=-1).astype(np.float32)
    frame = Frame(
        irradiance=jnp.asarray(irradiance),
        depth=jnp.full((size, size), 500.0, jnp.float32),
        normal=None,
        albedo=None,
        profile_id=jnp.ones((size, size), jnp.int32),
        motion=None,
        camera=camera.orthographic(size, size, WIDTH / size),
    )
    d, pixel = skin(), WIDTH / size

    def run() -> np.ndarray:
        return exact.convolve(irradiance, d, (pixel, pixel))

    # What others are measured against has no error beside itself.
    fft = Choice("FFT", {"method": "convolve"}, run, error=lambda: Error(0.0), bytes_moved=4 * (3 + 3))
    return Setting(is_quick, frame, {1: d}, "board", exact=run()), fft


def note(setting: Setting) -> str:
    """The board in a few words."""
    height, width = setting.mask.shape
    return f"{width} x {height} pixels, {WIDTH:g} mm wide"
