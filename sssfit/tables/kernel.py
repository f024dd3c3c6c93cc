"""Separable blur kernels as tables: weights for each channel over the offset along one direction."""

import jax
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfc

from sssfit.profiles import burley, gaussian_sum, separable
from sssfit.tables import _arguments
from sssfit.tables.table import Axis, Table

# Share of the widest channel's light that stays within the kernel's reach.
_WITHIN = 0.997


def burley_kernel_table(d: ArrayLike, num_taps: int = 25, reach: float | None = None) -> Table:
    """Weights of a two-pass blur that scatters like Burley's profile along each axis.

    Args:
        d: shape parameter of each channel, mm, shape (3,); 0 puts all weight on the middle tap.
        num_taps: odd, at least 3.
        reach: offset of the last tap, mm, > 0. By default the distance within which 99.7 % of the
            widest channel's light stays, 16.6 d; 1 mm if every d is 0.

    Returns:
        1-D table over the offset in mm (ascending, denser near 0), unit 1, channels R, G, B; each
        channel's weights sum to 1. `parameters["truncated_mass"]` is the share of each channel's
        line spread that lies beyond the reach and was spread over the taps.

    Raises:
        ValueError: num_taps is even or below 3, or an argument outside its domain.

    Source: Jimenez et al., "Separable Subsurface Scattering", 2015; Xie 2021, Eq 2.60-2.65. Float64.

    Example:
        >>> table = burley_kernel_table([1.0, 0.5, 0.0], num_taps=5, reach=8.0)
        >>> table.values.round(3)
        array([[0.024, 0.005, 0.   ],
               [0.192, 0.125, 0.   ],
               [0.566, 0.742, 1.   ],
               [0.192, 0.125, 0.   ],
               [0.024, 0.005, 0.   ]])
    """
    shape = _arguments.channels("d", d)
    with jax.enable_x64(True):
        widest = float(burley.ppf(_WITHIN, np.max(shape)))
    last = (widest or 1.0) if reach is None else reach
    offsets = separable.kernel_offsets(num_taps, last)
    with jax.enable_x64(True):
        weights = np.asarray(jax.jit(separable.burley_kernel)(offsets, shape))
        truncated = 2 * np.asarray(jax.jit(separable.line_sf)(last, shape))
    parameters = {
        "profile": "burley",
        "d": shape.tolist(),
        "num_taps": num_taps,
        "reach": float(last),
        "truncated_mass": truncated.tolist(),
    }
    return _table("burley_kernel", "whose taps carry Burley's line spread", offsets, weights, parameters)


def falloff_kernel_table(
    falloff: ArrayLike = (1.0, 0.37, 0.3), strength: ArrayLike = (0.48, 0.41, 0.28), num_taps: int = 25
) -> Table:
    """Weights of the published separable skin blur, from its two colours.

    The last tap is at 3 mm with more than 20 taps and at 2 mm with fewer, as published.

    Args:
        falloff: width of each channel, in [0, 1], shape (3,).
        strength: share of each channel's light that scatters, in [0, 1], shape (3,).
        num_taps: odd, at least 3.

    Returns:
        1-D table over the offset in mm (ascending, denser near 0), unit 1, channels R, G, B; each
        channel's weights sum to 1. `parameters["truncated_mass"]` is the share of each channel's
        Gaussians, used along a line, beyond the last tap.

    Raises:
        ValueError: num_taps is even or below 3, or a colour outside [0, 1].

    Source: the demo of Jimenez et al. 2015; Xie 2021, appendix A. Float64.

    Example:
        >>> table = falloff_kernel_table(num_taps=17)
        >>> table.values[8].round(3)
        array([0.536, 0.625, 0.749])
    """
    width = _arguments.channels("falloff", falloff, 1.0)
    share = _arguments.channels("strength", strength, 1.0)
    reach = 3.0 if num_taps > 20 else 2.0
    offsets = separable.kernel_offsets(num_taps, reach)
    with jax.enable_x64(True):
        weights = np.asarray(jax.jit(separable.falloff_kernel)(offsets, width, share))
    parameters = {
        "profile": "falloff",
        "falloff": width.tolist(),
        "strength": share.tolist(),
        "num_taps": num_taps,
        "reach": reach,
        "truncated_mass": _falloff_mass_beyond(reach, width).tolist(),
    }
    return _table("falloff_kernel", "with the published skin falloff", offsets, weights, parameters)


def _table(name: str, what: str, offsets: np.ndarray, weights: np.ndarray, parameters: dict) -> Table:
    return Table(
        name=name,
        description=f"Weights of a separable blur {what}, against the offset of the tap.",
        axes=(Axis("offset", "mm", offsets),),
        channels=_arguments.CHANNELS,
        values=weights,
        unit="1",
        parameters=parameters,
    )


def _falloff_mass_beyond(reach: float, falloff: np.ndarray) -> np.ndarray:
    # A radial Gaussian of weight w along a line has mass w / sqrt(2 pi variance).
    deviations = np.sqrt(gaussian_sum.SKIN_VARIANCES[1:, None])
    masses = gaussian_sum.SKIN_WEIGHTS[1:, :1] / deviations
    stretched = reach / (falloff + gaussian_sum.FALLOFF_OFFSET)
    return np.sum(masses * erfc(stretched / (np.sqrt(2) * deviations)), axis=0) / np.sum(masses)
