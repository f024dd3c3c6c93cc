"""How Burley's parameters that were fitted to a separable falloff move with that falloff."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.fitting import _falloff_curves, sensitivity
from sssfit.fitting.separable_to_burley import SeparableFit
from sssfit.profiles import burley
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET


class Slopes(NamedTuple):
    """Derivatives in the falloff, which has no unit.

    Attributes:
        albedo: of the albedo; 0 where it lies on its bound.
        d: of the shape parameter, mm.
        dmfp: of the diffuse mean free path, mm; NaN where there is none.
    """

    albedo: float
    d: float
    dmfp: float


def slopes(found: SeparableFit, *, domain: _falloff_curves.Domain | None = None) -> Slopes:
    """Derivatives of a fit's parameters in its falloff, with a domain that is stretched with it.

    Args:
        found: from `separable_to_burley.fit` without weights and without `normalize`.
        domain: where the profiles were compared, if it was given to the fit.

    Returns:
        `Slopes`; NaN where the fit determined nothing.

    Source: the implicit function theorem, see `sensitivity`.

    Example:
        >>> from sssfit.fitting import separable_to_burley
        >>> slopes(separable_to_burley.fit(0.37)).d.__round__(4)  # d is proportional to falloff + 0.001
        0.8941
    """
    if not np.isfinite([found.albedo, found.d]).all():
        return Slopes(np.nan, np.nan, np.nan)
    rule = (domain or _falloff_curves.DEFAULT_DOMAINS[found.objective]).nodes()
    residuals = _falloff_curves.residual_function(found.objective, False)
    free = np.array([not found.at_bound, True])

    def parameters(falloff):
        phi = falloff + FALLOFF_OFFSET
        nodes, weights = map(jnp.asarray, rule)
        problem = _falloff_curves.problem(phi, nodes, weights, found.objective, found.reading, False)
        optimum = jnp.array([found.albedo, found.d / (found.falloff + FALLOFF_OFFSET)])
        albedo, in_phi = sensitivity.optimum(residuals, problem, optimum, free)
        return albedo, in_phi * phi, burley.dmfp_from_shape(in_phi * phi, albedo)

    with jax.enable_x64(True):
        moved = jax.jit(jax.jacfwd(parameters))(jnp.asarray(found.falloff, float))
    return Slopes(*(float(slope) for slope in moved))
