"""Pre-integrated shadows: light that scatters into a penumbra, by its width and the shadow value.

Across a straight penumbra of width w the shadow value s of a wide filter rises linearly from 0 (dark) to
1. The table replaces s by what a scattering surface shows when the true edge is narrower: a ramp P'
of width w / sharpening inside the same penumbra, blurred by the material. The rest of the penumbra is
room for the blur.

An edge straight across the blur sees only the profile's line spread, which replaces the printed
integrand: a 1 / r profile used along a line has no finite integral.
"""

import jax
import numpy as np
from numpy.typing import ArrayLike

from sssfit.profiles import separable
from sssfit.tables import _arguments
from sssfit.tables.table import Axis, Table

# In shapes of the widest channel. There 0.5 % of the light leaks past either end of the penumbra.
_NARROWEST = 20.0


def shadow(
    d: ArrayLike,
    num_values: int = 64,
    num_widths: int = 64,
    min_width: float | None = None,
    sharpening: float = 10.0,
    shift: float = 0.0,
) -> Table:
    """Scattered shadow against the inverse width of the penumbra (rows) and the shadow value (columns).

    What scatters further than the penumbra reaches is lost: at s = 0 and 1 the result misses 0 and 1 by
    that leak, which is a visible step where w is not many times d.

    Args:
        d: shape parameter of each channel, mm, shape (3,); 0 gives the sharpened ramp in every row.
        num_values: columns, s from 0 to 1; at least 2.
        num_widths: rows, 1 / w from 0, a penumbra so wide that scattering is lost in it, to
            1 / min_width; at least 2.
        min_width: narrowest penumbra, mm, > 0. By default 20 d of the widest channel, where the leak
            is 0.5 %; 1 mm if every d is 0.
        sharpening: ratio of the penumbra's width to that of the ramp P', >= 1. The default, also that
            of published tools, gives nine tenths of the penumbra to the blur.
        shift: how far the middle of P' lies from that of the penumbra, towards the light, in widths
            of the penumbra. P' stays inside it: at most (1 - 1 / sharpening) / 2 either way. 0 shares
            the room between the blur's two sides. At the largest, the point where s becomes 1 is next
            to the edge and shows about 1/2.

    Returns:
        2-D table, unit 1, channels R, G, B, in [0, 1], ascending along s.

    Raises:
        ValueError: fewer than two rows or columns, or an argument outside its domain.

    Source: Penner, "Pre-Integrated Skin Shading", 2011; Xie 2021, Eq 2.52, with R the line spread of
    Eq 2.65 in mm. Closed form in float64, absolute error below 1e-11.

    Example:
        >>> table = shadow([0.76, 0.32, 0.2], num_values=5, num_widths=2)
        >>> table.values[:, :, 0].round(3)
        array([[0.   , 0.   , 0.5  , 1.   , 1.   ],
               [0.005, 0.036, 0.5  , 0.964, 0.995]])
    """
    shape = _arguments.channels("d", d)
    narrowest = (_NARROWEST * np.max(shape) or 1.0) if min_width is None else min_width
    narrowest = _arguments.positive("min_width", narrowest, "mm")
    values = _arguments.uniform("num_values", num_values, 0.0, 1.0)
    inverse_widths = _arguments.uniform("num_widths", num_widths, 0.0, 1 / narrowest)
    return Table(
        name="shadow",
        description="Scattered light in a penumbra, against the inverse of its width and the unscattered "
        "shadow value (0 dark, 1 lit).",
        axes=(Axis("inverse_width", "1/mm", inverse_widths), Axis("shadow", "1", values)),
        channels=_arguments.CHANNELS,
        values=evaluate(inverse_widths, values, shape, sharpening, shift),
        unit="1",
        parameters={
            "profile": "burley",
            "d": shape.tolist(),
            "min_width": narrowest,
            "sharpening": float(sharpening),
            "shift": float(shift),
        },
    )


def evaluate(
    inverse_widths: ArrayLike, values: ArrayLike, d: ArrayLike, sharpening: float = 10.0, shift: float = 0.0
) -> np.ndarray:
    """The closed form that the table of `shadow` samples, on a grid.

    Args:
        inverse_widths: 1 / w in 1/mm, >= 0, shape (m,).
        values: shadow values s in [0, 1], shape (n,).
        d: shape parameters, mm, shape (3,).
        sharpening: as `shadow`.
        shift: as `shadow`.

    Returns:
        Float64, shape (m, n, 3): the mean of P'(P^-1(s) + X) for X of the line spread.

    Raises:
        ValueError: an argument outside its domain.

    Source: as `shadow`.

    Example:
        >>> evaluate([0.1], [0.0, 0.5, 1.0], np.ones(3))[0, :, 0].round(4)
        array([0.0349, 0.5   , 0.9651])
    """
    shape = _arguments.channels("d", d)
    _check_ramp(sharpening, shift)
    inverse_widths = _arguments.within("inverse_widths", inverse_widths, 0.0)
    values = _arguments.within("values", values, 0.0, 1.0)
    # Lengths in units of the penumbra's width, so that an infinite width is a shape of 0: the delta.
    relative = np.multiply.outer(inverse_widths, shape)[:, None, :]
    place = values[None, :, None] - 0.5 - shift
    half = 0.5 / sharpening
    with jax.enable_x64(True):
        # A ramp is a difference of two max(0, x), whose means line_excess gives. Compiled, its
        # quadrature needs no memory of its own.
        excess = jax.jit(separable.line_excess)
        dark, lit = excess(-half - place, relative), excess(half - place, relative)
        # Rounding of the difference may leave the range of a mean of P'.
        return np.clip(np.asarray(dark - lit) / (2 * half), 0, 1)


def _check_ramp(sharpening: float, shift: float) -> None:
    if not 1 <= sharpening < np.inf:
        raise ValueError(f"sharpening must be at least 1 and finite, got {sharpening}")
    room = 0.5 - 0.5 / sharpening
    if not abs(shift) <= room:
        raise ValueError(
            f"shift must be at most {room:g} either way at sharpening {sharpening:g}, got {shift}"
        )
