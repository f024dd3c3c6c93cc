"""Radial profiles that are sums of Gaussians: d'Eon's fit to skin, and the falloff profile of Jimenez.

A Gaussian of variance v is exp(-r^2 / (2 v)) / (2 pi v) per area. Tables list variances in mm^2, not
standard deviations.

Source: d'Eon, Luebke and Enderton, "Efficient Rendering of Human Skin", 2007, table 1; Jimenez et al.,
"Separable Subsurface Scattering", 2015, and its published demo.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles._elementwise import broadcast

#: Variances in mm^2 of d'Eon's six Gaussians for skin.
SKIN_VARIANCES = np.array([0.0064, 0.0484, 0.187, 0.567, 1.99, 7.41])

#: Their weights in red, green, blue; each column sums to 1. Shape (6, 3).
SKIN_WEIGHTS = np.array(
    [
        [0.233, 0.455, 0.649],
        [0.100, 0.336, 0.344],
        [0.118, 0.198, 0.0],
        [0.113, 0.007, 0.007],
        [0.358, 0.004, 0.0],
        [0.078, 0.0, 0.0],
    ]
)

# The demo blurs with the red weights of all but the narrowest Gaussian, which it counts as unscattered.
_FALLOFF_VARIANCES = SKIN_VARIANCES[1:]
_FALLOFF_WEIGHTS = SKIN_WEIGHTS[1:, 0]

#: Added to the falloff before it divides the distance, so that a falloff of 0 is no division by 0.
FALLOFF_OFFSET = 0.001


def profile(r: ArrayLike, variances: ArrayLike, weights: ArrayLike) -> Array:
    """Areal density of a sum of isotropic Gaussians.

    Args:
        r: distance, mm, any shape.
        variances: mm^2, > 0, shape (k,).
        weights: the energy of each Gaussian, shape (k,).

    Returns:
        sum_i weights[i] exp(-r^2 / (2 variances[i])) / (2 pi variances[i]), 1/mm^2, of r's shape.
        Its integral over the plane is the sum of the weights.

    Source: Xie 2021, Eq 2.48.

    Example:
        >>> float(profile(0.0, SKIN_VARIANCES[1:], SKIN_WEIGHTS[1:, 0])).__round__(6)
        0.491288
    """
    dtype = jnp.result_type(float, r, variances, weights)
    wide = jnp.promote_types(dtype, jnp.float32)
    r, variances, weights = (jnp.asarray(a, wide) for a in (r, variances, weights))
    along_gaussians = (1,) * r.ndim + (-1,)
    variances, weights = variances.reshape(along_gaussians), weights.reshape(along_gaussians)
    gaussians = jnp.exp(-0.5 * jnp.square(r)[..., None] / variances) / (2 * jnp.pi * variances)
    return jnp.sum(weights * gaussians, axis=-1).astype(dtype)


def falloff_profile(r: ArrayLike, falloff: ArrayLike) -> Array:
    """The profile behind the separable kernel's "falloff" colour: P(r / (falloff + 0.001)).

    The distance is stretched but the density not divided by the stretch squared, so the energy is
    0.767 (falloff + 0.001)^2. The demo's code writes 3.14 for pi, which scales it by 1.0005.

    Args:
        r: distance, mm.
        falloff: dimensionless width, > -0.001, (0, 1] in practice; broadcasts with r.

    Returns:
        Areal density, 1/mm^2 (per falloff squared).

    Source: the demo of Jimenez et al. 2015; Xie 2021, appendix A.

    Example:
        >>> float(falloff_profile(0.0, 0.3)).__round__(6)
        0.491288
    """
    dtype, (r, falloff) = broadcast(r, falloff)
    stretched = r / (falloff + FALLOFF_OFFSET)
    variances = jnp.asarray(_FALLOFF_VARIANCES, stretched.dtype)
    weights = jnp.asarray(_FALLOFF_WEIGHTS, stretched.dtype)
    return profile(stretched, variances, weights).astype(dtype)
