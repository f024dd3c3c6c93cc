"""Pre-integrated skin shading: diffuse light on a scattering sphere, by curvature and light direction.

The irradiance max(0, N.L) around a point of a sphere of radius r, averaged with the profile. A shader
looks the result up by the surface's curvature 1/r and its own N.L. Conventions differ between
implementations, so both of their choices are arguments here:

`distance`: what the profile takes for the distance to a point at angle x, "chord" 2 r sin(x / 2)
(through the body) or "arc" r x (along the surface).

`average`: "sphere", over the surface, or "great_circle", over the circle through the light alone and
weighted by the radial density, as the published demos do; at d = 0.76 r / 3 and N.L = 0.7 that is 3 %
too bright.

Either is divided by the kernel's own mass on the sphere, so a fully lit surround gives 1.
"""

from typing import Literal, get_args

import jax
import numpy as np
from numpy.typing import ArrayLike

from sssfit.profiles import burley
from sssfit.tables import _arguments
from sssfit.tables.table import Axis, Table

Distance = Literal["chord", "arc"]
Average = Literal["sphere", "great_circle"]

# Panels of the quadrature halve towards the point itself this often; the rest is counted at angle 0.
# They then resolve every d / r from 1e-9 up, and what is smaller is the delta to as many digits.
_HALVINGS = 32
_PANEL_NODES, _PANEL_WEIGHTS = np.polynomial.legendre.leggauss(8)


def curvature(
    d: ArrayLike,
    num_cosines: int = 64,
    num_curvatures: int = 64,
    max_curvature: float = 1.0,
    distance: Distance = "chord",
    average: Average = "sphere",
) -> Table:
    """Scattered diffuse lighting against curvature (rows) and the cosine N.L (columns).

    Args:
        d: shape parameter of each channel, mm, shape (3,); 0 gives max(0, N.L) in every row.
        num_cosines: columns, from N.L = -1 to 1; at least 2.
        num_curvatures: rows, from 0, where the result is max(0, N.L), to max_curvature; at least 2.
        max_curvature: curvature 1/r of the last row, 1/mm, > 0.
        distance: "chord" or "arc"; see the module.
        average: "sphere" or "great_circle"; see the module.

    Returns:
        2-D table, unit 1 (multiply by the irradiance at N.L = 1 and the albedo), channels R, G, B.
        Entries are within 1e-6 of the integral for any d. Bilinear lookup errs most at the kink of the
        first row, by a quarter of a column's step (0.008 at 64) unless an odd num_cosines has an entry
        there (0.002 at 65 for skin).

    Raises:
        ValueError: fewer than two rows or columns, or an argument outside its domain.

    Source: Penner, "Pre-Integrated Skin Shading", 2011; Xie 2021, Eq 2.51. Read as the integral over
    the sphere, since with the printed one (no area element) a profile with a pole diverges. Shape and
    curvature enter only as their product.

    Example:
        >>> table = curvature([0.76, 0.32, 0.2], num_cosines=5, num_curvatures=2)
        >>> table.values[:, :, 0].round(3)
        array([[0.   , 0.   , 0.   , 0.5  , 1.   ],
               [0.074, 0.106, 0.18 , 0.381, 0.624]])
    """
    shape = _arguments.channels("d", d)
    last = _arguments.positive("max_curvature", max_curvature, "1/mm")
    cosines = _arguments.uniform("num_cosines", num_cosines, -1.0, 1.0)
    curvatures = _arguments.uniform("num_curvatures", num_curvatures, 0.0, last)
    return Table(
        name="curvature",
        description="Diffuse lighting of a scattering sphere that a distant light shines on, against its "
        "curvature and the cosine between normal and light.",
        axes=(Axis("curvature", "1/mm", curvatures), Axis("cosine", "1", cosines)),
        channels=_arguments.CHANNELS,
        values=evaluate(curvatures, cosines, shape, distance, average),
        unit="1",
        parameters={
            "profile": "burley",
            "d": shape.tolist(),
            "max_curvature": last,
            "distance": distance,
            "average": average,
        },
    )


def evaluate(
    curvatures: ArrayLike,
    cosines: ArrayLike,
    d: ArrayLike,
    distance: Distance = "chord",
    average: Average = "sphere",
) -> np.ndarray:
    """The integral that the table of `curvature` samples, on a grid.

    Args:
        curvatures: 1/r in 1/mm, >= 0, shape (m,).
        cosines: N.L in [-1, 1], shape (n,).
        d: shape parameters, mm, shape (3,).
        distance: "chord" or "arc".
        average: "sphere" or "great_circle".

    Returns:
        Float64, shape (m, n, 3), within 1e-6 of the integral (2e-9 for 64 uniform cosines).

    Raises:
        ValueError: an unknown convention, or an argument outside its domain.

    Source: as `curvature`.

    Example:
        >>> evaluate([1 / 3], [np.sqrt(0.5)], np.full(3, 0.7568628))[0, 0, 0].round(6)
        np.float64(0.576285)
    """
    _check_option("distance", distance, Distance)
    _check_option("average", average, Average)
    shape = _arguments.channels("d", d)
    curvatures = _arguments.within("curvatures", curvatures, 0.0)
    cosines = _arguments.within("cosines", cosines, -1.0, 1.0)
    # Lengths in units of the radius, in which the shape is d / r. All of it is one column per shape.
    relative = np.multiply.outer(curvatures, shape).ravel()
    angles, mass = _kernel(_panel_edges(cosines), relative, distance, average)
    light = _mean_clamped_cosine(cosines[:, None], angles, average)
    # Not a matrix product, whose last digits depend on the number of threads.
    values = np.einsum("in,nk->ik", light, mass) / np.sum(mass, axis=0)
    return np.moveaxis(values.reshape(len(cosines), len(curvatures), 3), 0, 1)


def _panel_edges(cosines: np.ndarray) -> np.ndarray:
    """Angles between which every integrand is smooth: octaves of the profile, kinks of the light."""
    # A circle of this angle around the point touches the terminator, from one side or the other.
    kinks = np.arcsin(np.abs(cosines))
    octaves = np.pi * 2.0 ** -np.arange(_HALVINGS + 1)
    edges = np.unique(np.concatenate([octaves, kinks, np.pi - kinks]))
    return edges[edges >= np.min(octaves)]


def _kernel(
    edges: np.ndarray, relative: np.ndarray, distance: Distance, average: Average
) -> tuple[np.ndarray, np.ndarray]:
    """Quadrature angles (n,), and the profile's mass at each for every relative shape (n, k)."""
    widths = np.diff(edges)[:, None]
    angles = (edges[:-1, None] + widths * (_PANEL_NODES + 1) / 2).ravel()
    steps = (widths * _PANEL_WEIGHTS / 2).ravel()
    if distance == "chord":
        # The sphere's area element is 2 pi s ds exactly in the chord s, so the radial density is left.
        lengths, stretch = 2 * np.sin(angles / 2), np.cos(angles / 2)
    else:
        # Along the arc it is 2 pi sin(x) dx, where the radial density counts 2 pi x dx.
        lengths, stretch = angles, np.sinc(angles / np.pi) if average == "sphere" else np.ones_like(angles)
    with jax.enable_x64(True):
        density = np.asarray(jax.jit(burley.pdf)(lengths[:, None], relative))
        nearest = np.asarray(jax.jit(burley.cdf)(edges[0], relative))
    mass = (stretch * steps)[:, None] * density
    return np.append(0.0, angles), np.concatenate([nearest[None], mass])


def _mean_clamped_cosine(cosine: np.ndarray, angle: np.ndarray, average: Average) -> np.ndarray:
    """Mean of max(0, N.L) around the circle of points at an angle from one with this cosine."""
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    middle, swing = cosine * np.cos(angle), sine * np.sin(angle)
    if average == "great_circle":
        return (np.maximum(0, middle + swing) + np.maximum(0, middle - swing)) / 2
    # N.L = middle + swing cos(phi) is positive for |phi| below arccos(-middle / swing).
    turn = np.clip(-middle / np.maximum(swing, 1e-300), -1, 1)
    # Divided first, so that a circle in full light has exactly its middle.
    return middle * (np.arccos(turn) / np.pi) + swing * (np.sqrt((1 - turn) * (1 + turn)) / np.pi)


def _check_option(name: str, value: str, options: object) -> None:
    if value not in get_args(options):
        first, second = get_args(options)
        raise ValueError(f"{name} must be {first!r} or {second!r}, got {value!r}")
