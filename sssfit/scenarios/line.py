"""A line of texels under light that varies along it, scattered by Burley's profile.

The lighting is a texture of one texel for each pixel, as an engine has it; beyond its ends it stays as at the
end. A sample takes Burley's radius and a direction, and reads the texel that its offset along the line falls
into. So the exact answers are sums over texels: the scattering kernel's mass in each, times the light (the
truth) or its square (the second moment, whose rest over the squared truth is the variance of a sample).

Source: Xie and Olano 2021, section 4 and Fig 2 and 7, whose setup is not stated in numbers; the line spread:
Xie, dissertation, 2021, Eq 2.65.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles import burley, separable
from sssfit.sampling import inverse_cdf
from sssfit.scenarios import light
from sssfit.scenarios._direction import cosine_of_half_turn

Kernel = Literal["line", "radial"]
KERNELS: tuple[Kernel, ...] = get_args(Kernel)
#: The masses between all texels are kept at once.
MAX_TEXELS = 8192
#: How far, in units of d, the light around a pixel is looked at: what comes from beyond is below 3 %.
SURROUND_REACH = 10.0


class Line(eqx.Module):
    """A world of a line of texels; made by `world`. See `driver.World` for the answers."""

    irradiance: Array
    texels_per_d: Array
    truth: Array
    sample_variance: Array
    control: Array
    surround: Array
    kernel: Kernel = eqx.field(static=True)

    def places(self, uniform: Array) -> Array:
        """Texels that samples fall into; see `driver.World`."""
        texels = self.irradiance.shape[1]
        offset = inverse_cdf.log_poly12(uniform[0], self.texels_per_d)
        if self.kernel == "line":
            offset = offset * cosine_of_half_turn(uniform[1])
        else:
            offset = jnp.where(uniform[1] < 0.5, offset, -offset)
        hit = jnp.floor(jnp.arange(texels, dtype=offset.dtype) + 0.5 + offset)
        return jnp.clip(hit, 0, texels - 1).astype(jnp.int32)

    def values(self, places: Array, frame: Array) -> Array:
        """Values of samples; see `driver.World`."""
        return self.irradiance[frame][places]


def world(irradiance: ArrayLike, *, length: float, d: float, kernel: Kernel = "line") -> Line:
    """A line of texels.

    Args:
        irradiance: on each texel in each frame, >= 0, shape (frames, texels); a profile times the light's
            intensity is `intensity[:, None] * profile`.
        length: of the line, mm, > 0.
        d: Burley's shape parameter, mm, > 0.
        kernel: "line", Burley's line spread, what a surface of parallel stripes of light shows; or "radial",
            his radius to either side, as if all light lay on the line.

    Returns:
        A world of `texels` pixels, in the irradiance's dtype, with the albedo 1. Its exact answers are
        computed in float64, where the kernel's masses have errors below 1e-11. The control is the texel's
        own irradiance, the surround the mean over `SURROUND_REACH` d to both sides.

    Raises:
        ValueError: an argument is out of its domain.

    Source: Xie and Olano 2021, section 4; sampling: Xie et al. 2020, Eq 17-18.

    Example:
        >>> stripe = world(pulse(centres(8, 4.0))[None], length=4.0, d=0.1)
        >>> [f"{value:.2f}" for value in stripe.truth[0]]
        ['0.01', '0.05', '0.45', '0.49', '0.49', '0.45', '0.05', '0.01']
    """
    irradiance = np.asarray(irradiance)
    dtype = jax.dtypes.canonicalize_dtype(np.result_type(np.float32, irradiance.dtype))
    if irradiance.ndim != 2 or 0 in irradiance.shape:
        raise ValueError(f"irradiance must have shape (frames, texels), got {irradiance.shape}")
    if not (np.isfinite(irradiance).all() and (irradiance >= 0).all()):
        raise ValueError("irradiance must be finite and at least 0 everywhere")
    if irradiance.shape[1] > MAX_TEXELS:
        raise ValueError(f"texels must be at most {MAX_TEXELS}, got {irradiance.shape[1]}")
    for name, value in (("length", length), ("d", d)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be a positive length in mm, got {value}")
    if kernel not in KERNELS:
        raise ValueError(f"kernel must be one of {', '.join(KERNELS)}, got {kernel!r}")
    # What is sampled, which in float32 is not quite what was given.
    lit = irradiance.astype(dtype).astype(np.float64)
    texels_per_d = d / length * lit.shape[1]
    masses = texel_masses(lit.shape[1], texels_per_d, kernel)
    # Around each frame's mean, so that the second moment does not cancel; the masses sum to 1.
    level = lit.mean(axis=1, keepdims=True)
    above = (lit - level) @ masses.T
    truth = level + above
    variance = np.maximum(np.square(lit - level) @ masses.T - np.square(above), 0)
    answers = (truth, variance, lit, lit @ _surround_weights(lit.shape[1], texels_per_d).T)
    if not variance.max() < float(jnp.finfo(dtype).max):
        raise ValueError(f"irradiance must have squares that fit {dtype}, got {irradiance.max():g}")
    arrays = (jnp.asarray(v, dtype) for v in (irradiance, texels_per_d, *answers))
    return Line(*arrays, kernel=kernel)


def centres(texels: int, length: float) -> np.ndarray:
    """Where the texels' centres are.

    Args:
        texels: how many, >= 1.
        length: of the line, mm, > 0.

    Returns:
        Positions from the line's start, mm, float64, shape (texels,).

    Raises:
        ValueError: there is no texel, or no length.

    Source: none; half a texel from the edges.

    Example:
        >>> centres(4, 2.0).tolist()
        [0.25, 0.75, 1.25, 1.75]
    """
    if texels < 1:
        raise ValueError(f"texels must be at least 1, got {texels}")
    if not 0 < length < math.inf:
        raise ValueError(f"length must be a positive length in mm, got {length}")
    return (np.arange(texels) + 0.5) * (length / texels)


def step(x: ArrayLike, *, edge: float = 1.0, amplitude: float = 0.5) -> np.ndarray:
    """Lighting with a hard edge.

    Args:
        x: positions, mm.
        edge: where the light begins, mm.
        amplitude: irradiance from there on.

    Returns:
        Irradiance, of x's shape.

    Source: one reading of Xie and Olano 2021, Fig 2a.

    Example:
        >>> step([0.5, 1.5]).tolist()
        [0.0, 0.5]
    """
    return np.where(np.asarray(x) >= edge, amplitude, 0.0)


def ramp(x: ArrayLike, *, start: float = 1.0, end: float = 2.0, amplitude: float = 0.5) -> np.ndarray:
    """Lighting that rises linearly and stays.

    Args:
        x: positions, mm.
        start, end: where it begins and ends to rise, mm.
        amplitude: irradiance from `end` on.

    Returns:
        Irradiance, of x's shape.

    Source: one reading of Xie and Olano 2021, Fig 2a, whose light changes in [1, 2].

    Example:
        >>> ramp([0.5, 1.5, 3.0]).tolist()
        [0.0, 0.25, 0.5]
    """
    return amplitude * np.clip((np.asarray(x, np.float64) - start) / (end - start), 0.0, 1.0)


def pulse(x: ArrayLike, *, start: float = 1.0, end: float = 3.0, amplitude: float = 0.5) -> np.ndarray:
    """A stripe of light.

    Args:
        x: positions, mm.
        start, end: its edges, mm.
        amplitude: irradiance between them.

    Returns:
        Irradiance, of x's shape.

    Source: none; two edges facing each other.

    Example:
        >>> pulse([0.5, 1.5, 3.5]).tolist()
        [0.0, 0.5, 0.0]
    """
    x = np.asarray(x)
    return np.where((x >= start) & (x < end), amplitude, 0.0)


#: The profiles that have a name.
PROFILES: dict[str, Callable[..., np.ndarray]] = {"step": step, "ramp": ramp, "pulse": pulse}


def load(path: str | Path, x: ArrayLike) -> np.ndarray:
    """A lighting profile from a CSV file with the columns x (mm, ascending) and irradiance (>= 0).

    Args:
        path: the file.
        x: positions to interpolate it at, mm; beyond its ends it stays as at the end.

    Returns:
        Irradiance, float64, of x's shape.

    Raises:
        FileError: the file has a fault, which the message places.

    Source: none; linear interpolation.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "profile.csv"
        ...     _ = path.write_text("x,irradiance\\n0,0\\n2,1\\n")
        ...     load(path, [0.5, 3.0]).tolist()
        [0.25, 1.0]
    """
    return np.interp(np.asarray(x, np.float64), *light.read_columns(path, "x", "irradiance"))


def texel_masses(texels: int, texels_per_d: float, kernel: Kernel = "line") -> np.ndarray:
    """How much of each pixel's light comes from each texel.

    Args:
        texels: how many.
        texels_per_d: Burley's shape parameter in texels, > 0.
        kernel: as for `world`.

    Returns:
        Shape (texels, texels), float64, rows of pixels summing to 1: the first and last texel stand for all
        that lies beyond them.

    Raises:
        ValueError: there is no texel.

    Source: differences of the integrated line spread, dissertation Eq 2.65.

    Example:
        >>> texel_masses(3, 0.5).round(3).tolist()
        [[0.777, 0.142, 0.081], [0.223, 0.554, 0.223], [0.081, 0.142, 0.777]]
    """
    if texels < 1:
        raise ValueError(f"texels must be at least 1, got {texels}")
    with jax.enable_x64(True):
        edges = jnp.arange(texels) + 0.5
        if kernel == "line":
            beyond = separable.line_sf(edges, float(texels_per_d))
        else:
            beyond = burley.sf(edges, float(texels_per_d)) / 2
        # beyond[k]: what lies more than k + 1/2 texels to one side.
        beyond = np.asarray(beyond)
    apart = np.abs(np.subtract.outer(np.arange(texels), np.arange(texels)))
    between = np.append(1 - 2 * beyond[0], beyond[:-1] - beyond[1:])
    masses = between[apart]
    masses[:, 0] = np.where(apart[:, 0] > 0, beyond[apart[:, 0] - 1], 1 - beyond[0])
    masses[:, -1] = np.where(apart[:, -1] > 0, beyond[apart[:, -1] - 1], 1 - beyond[0])
    return masses if texels > 1 else np.ones((1, 1))


def _surround_weights(texels: int, texels_per_d: float) -> np.ndarray:
    """Rows of equal weights for the texels around each pixel, ends repeated beyond the ends."""
    reach = max(1.0, round(SURROUND_REACH * texels_per_d))
    place = np.arange(texels)
    weights = (np.abs(place[:, None] - place) <= reach).astype(np.float64)
    weights[:, 0] += np.maximum(reach - place, 0)
    weights[:, -1] += np.maximum(reach - (texels - 1 - place), 0)
    return weights / (2 * reach + 1)
