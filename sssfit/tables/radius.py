"""The inverse cdf of Burley's profile as a table: one for every material.

By the scaling law r = d x(xi), where x does not depend on the material, so the table holds x and a
shader multiplies by d.
"""

import jax
import numpy as np
from numpy.typing import ArrayLike

from sssfit.profiles import burley
from sssfit.tables import _arguments
from sssfit.tables.table import Axis, Table

#: Random numbers above this are taken for it: the largest below 1 in float32. Its radius is 49.04355 d.
CLAMP = 1 - 2.0**-24

_FIRST = (1 - CLAMP) ** 0.25


def radius(num_entries: int = 256) -> Table:
    """Radius per unit of d against the fourth root of the survival probability 1 - xi.

    A shader finds r = d * table(sqrt(sqrt(1 - xi))); a uniform random number may stand for 1 - xi.
    The axis goes from 2^-6 (xi = 1 - 2^-24, radius 49.04355) to 1 (xi = 0, radius 0).

    Equal steps of xi would leave the tail, where the radius grows with -3 ln(1 - xi), to one cell.
    Largest and RMS error of the radius over uniform xi, in units of d, and largest error of the
    cumulative probability, of linear lookup in 256 entries, measured:

        coordinate            largest radius error    RMS       probability
        xi                    23                      0.97      2.7e-3
        (1 - xi)^(1/2)        5.5                     1.5e-2    6.4e-6
        (1 - xi)^(1/4)        0.073                   7.2e-5    1.7e-5
        -log2(1 - xi) / 24    3.8e-4                  2.2e-4    1.7e-4

    The logarithm has the smallest largest error, but a shader that takes logarithms can evaluate the
    closed form; two square roots are cheaper than either.

    Args:
        num_entries: at least 2.

    Returns:
        1-D table, unit 1 (mm per mm of d), one channel "X"; the radii descend.

    Raises:
        ValueError: fewer than two entries.

    Source: root of t^3 + 3 t = 4 (1 - xi) in t = exp(-x / 3); closed form in Golubev, "Sampling
    Burley's Normalized Diffusion Profiles", 2019. Float64.

    Example:
        >>> table = radius(64)
        >>> root = (1 - 0.5) ** 0.25
        >>> float(np.interp(root, table.axes[0].values, table.values[:, 0])).__round__(2)
        1.55
    """
    roots = _arguments.uniform("num_entries", num_entries, _FIRST, 1.0)
    return Table(
        name="radius",
        description="Distance from the point of entry, in units of the shape parameter d, against the "
        "fourth root of the probability of a larger distance.",
        axes=(Axis("survival_fourth_root", "1", roots),),
        channels=("X",),
        values=evaluate(roots),
        unit="1",
        parameters={"profile": "burley", "coordinate": "(1 - xi)^(1/4)", "clamp": CLAMP},
    )


def evaluate(survival_fourth_root: ArrayLike) -> np.ndarray:
    """Exact radius per unit of d that the table of `radius` samples.

    Args:
        survival_fourth_root: (1 - xi)^(1/4), shape (n,). Below 2^-6 the result is that of 2^-6;
            above 1 it is NaN.

    Returns:
        Float64, shape (n, 1).

    Source: as `radius`; relative error below 1e-12.

    Example:
        >>> evaluate([0.0, 1.0]).round(5)
        array([[49.04355],
               [ 0.     ]])
    """
    roots = np.maximum(np.asarray(survival_fourth_root, np.float64), _FIRST)
    with jax.enable_x64(True):
        return np.asarray(jax.jit(burley.isf)(roots**4, 1.0))[:, None]
