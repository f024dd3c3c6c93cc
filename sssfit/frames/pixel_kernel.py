"""Burley's profile integrated over pixels: what nearest-pixel lookups of a continuous profile converge to."""

import numpy as np
from numpy.typing import ArrayLike

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)


def mass_in_quadrant(
    width: ArrayLike, height: ArrayLike, d: float, *, cutoff: float | None = None
) -> np.ndarray:
    """Share of the profile's light that falls into a rectangle with one corner at its centre.

    Args:
        width, height: of the rectangle, mm, > 0; they broadcast.
        d: shape parameter, mm, >= 0; 0 is the delta, a quarter of which is in every quadrant.
        cutoff: radius in d beyond which the profile is zero; what is left is scaled to integrate to 1.

    Returns:
        Share in [0, 1/4], float64, to 1e-13.

    Source: own derivation. In polar coordinates the radial integral is the cdf; the angle is replaced by
    the s with hypotenuse a cosh(s), in which the rest is smooth, and split where the cut-off lies.

    Example:
        >>> round(float(mass_in_quadrant(1e9, 1e9, 1.0)), 12)
        0.25
    """
    width, height = np.broadcast_arrays(np.asarray(width, float), np.asarray(height, float))
    if not (np.all(width > 0) and np.all(height > 0)):
        raise ValueError("width and height must be above 0")
    if not d >= 0:
        raise ValueError(f"d must be at least 0, got {d}")
    if cutoff is not None and not cutoff > 0:
        raise ValueError(f"cutoff must be above 0, got {cutoff}")
    reach = np.inf if cutoff is None else cutoff
    if d == 0:
        return np.full(width.shape, 0.25)
    width, height = width / d, height / d
    return (_mass_in_wedge(width, height, reach) + _mass_in_wedge(height, width, reach)) / (2 * np.pi)


def mass_in_parallelogram(
    first: np.ndarray, second: np.ndarray, d: float, *, cutoff: float | None = None
) -> np.ndarray:
    """Share of the profile's light that falls into a parallelogram around its centre.

    Args:
        first, second: the two sides as vectors in space, mm, (..., 3), not parallel.
        d: shape parameter, mm, >= 0.
        cutoff: as for `mass_in_quadrant`.

    Returns:
        Share in [0, 1], shape (...), float64.

    Source: two triangles from the centre to each pair of sides, each the sum of two right ones.

    Example:
        >>> square = mass_in_parallelogram(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), 1.0)
        >>> round(float(square - 4 * mass_in_quadrant(0.5, 0.5, 1.0)), 12)
        0.0
    """
    if d == 0:
        return np.ones(np.broadcast_shapes(first.shape, second.shape)[:-1])
    reach = np.inf if cutoff is None else cutoff
    total = 0.0
    for side, other in ((first, second), (second, first)):
        # A side lies half the other vector away; its foot and both ends are measured along the side.
        length = np.linalg.norm(side, axis=-1)
        along = np.sum(other / 2 * side, axis=-1) / length
        away = np.sqrt(np.maximum(np.sum(np.square(other / 2), axis=-1) - np.square(along), 0))
        for end in (length / 2 + along, length / 2 - along):
            total = total + np.sign(end) * _mass_in_wedge(away / d, np.abs(end) / d, reach)
    return total / np.pi


def kernel(
    shape: tuple[int, int], pixel_size: tuple[float, float], d: float, *, cutoff: float | None = None
) -> np.ndarray:
    """The profile's share in each pixel around the centre of one, for offsets to one side.

    Args:
        shape: rows and columns that are wanted, >= 1.
        pixel_size: height and width of a pixel, mm, > 0.
        d: shape parameter, mm, >= 0.
        cutoff: as for `mass_in_quadrant`.

    Returns:
        Shape `shape`, float64: entry (j, i) is the share of the pixel j rows and i columns away, to 1e-13
        of all light. The other three quadrants mirror it.

    Source: differences of `mass_in_quadrant` at the pixels' corners.

    Example:
        >>> quarter = kernel((400, 400), (0.1, 0.1), 1.0)
        >>> total = 4 * quarter.sum() - 2 * quarter[0].sum() - 2 * quarter[:, 0].sum() + quarter[0, 0]
        >>> round(float(total), 5)
        1.0
    """
    rows, columns = ((np.arange(n) + 0.5) * size for n, size in zip(shape, pixel_size, strict=True))
    # A row at a time: the quadrature multiplies the memory by its nodes.
    corners = np.stack([mass_in_quadrant(columns, row, d, cutoff=cutoff) for row in rows])
    # The share up to a corner is odd in either coordinate.
    corners = np.concatenate([-corners[:1], corners], axis=0)
    corners = np.concatenate([-corners[:, :1], corners], axis=1)
    return np.maximum(np.diff(np.diff(corners, axis=0), axis=1), 0)


def _mass_in_wedge(a: np.ndarray, b: np.ndarray, reach: float) -> np.ndarray:
    """2 pi times the share in the triangle below the diagonal, between x = 0 and x = a, in units of d."""
    end = np.arcsinh(b / a)
    inside = np.minimum(end, np.arccosh(np.maximum(reach / a, 1)))
    cosh = np.cosh(inside[..., None] * (_NODES + 1) / 2)
    found = inside / 2 * np.sum(_WEIGHTS * cdf(a[..., None] * cosh) / cosh, axis=-1) / cdf(np.array(reach))
    # Where the cut-off is nearer than the edge, the cdf is 1 and the angle itself remains.
    return found + 2 * (np.arctan(np.tanh(end / 2)) - np.arctan(np.tanh(inside / 2)))


def cdf(x: np.ndarray) -> np.ndarray:
    """The profile's cdf on the host, in float64.

    Args:
        x: distance in d, >= 0.

    Source: Christensen and Burley 2015.

    Example:
        >>> round(float(cdf(np.array(16.0))), 8)
        0.99637901
    """
    return -0.25 * np.expm1(-x) - 0.75 * np.expm1(-x / 3)
