"""Diffuse reflectance of a half space in the dipole approximation.

Source: Jensen, Marschner, Levoy and Hanrahan, "A Practical Model for Subsurface Light Transport", 2001.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles._elementwise import broadcast

#: Refractive indices for which the polynomial fit of the Fresnel reflectance stays in [0, 1).
ETA_RANGE = (0.3, 3.5)


def fresnel_diffuse_reflectance(eta: ArrayLike) -> Array:
    """Diffuse Fresnel reflectance inside a medium, by the published polynomial fits.

    Args:
        eta: relative refractive index of the medium, > 0; NaN below.

    Returns:
        Reflectance averaged over the hemisphere, dimensionless. For eta >= 1 it is
        -1.4399 / eta^2 + 0.7099 / eta + 0.6681 + 0.0636 eta, for eta < 1
        -0.4399 + 0.7099 / eta - 0.3319 / eta^2 + 0.0636 / eta^3; within 1.1e-3 of the exact integral
        for 1.3 <= eta <= 2.

    Source: Jensen et al. 2001, section 2; Egan and Hilgeman 1979 for eta < 1.

    Example:
        >>> float(fresnel_diffuse_reflectance(1.3)).__round__(6)
        0.444845
    """
    dtype, (eta,) = broadcast(eta)
    inverse = 1 / eta
    inside = -1.4399 * inverse**2 + 0.7099 * inverse + 0.6681 + 0.0636 * eta
    outside = -0.4399 + 0.7099 * inverse - 0.3319 * inverse**2 + 0.0636 * inverse**3
    return jnp.where(eta > 0, jnp.where(eta < 1, outside, inside), jnp.nan).astype(dtype)


def diffuse_reflectance(sigma_s_reduced: ArrayLike, sigma_a: ArrayLike, eta: ArrayLike) -> Array:
    """Total diffuse reflectance of a half space: the dipole profile integrated over the plane.

    Args:
        sigma_s_reduced: reduced scattering coefficient, 1/mm, >= 0.
        sigma_a: absorption coefficient, 1/mm, >= 0. At 0 the reflectance is 1.
        eta: relative refractive index, in `ETA_RANGE`; NaN outside.

    Returns:
        Albedo in [0, 1], dimensionless: a' / 2 (1 + exp(-4/3 A s)) exp(-s), where a' is the reduced
        single-scattering albedo, s = sqrt(3 (1 - a')) and A = (1 + F) / (1 - F) with F the internal
        diffuse Fresnel reflectance. A medium without scattering reflects nothing; NaN off the domain.

    Source: Jensen et al. 2001, section 2.4.

    Example:
        >>> float(diffuse_reflectance(2.62, 0.0041, 1.5)).__round__(6)
        0.790932
    """
    dtype, (sigma_s_reduced, sigma_a, eta) = broadcast(sigma_s_reduced, sigma_a, eta)
    extinction = sigma_s_reduced + sigma_a
    present = extinction > 0
    absorption, total = jnp.where(present, sigma_a, 1), jnp.where(present, extinction, 1)
    # a' and 1 - a' each as a ratio: a difference would lose what a white medium absorbs, or a black one
    # scatters. The root of 1 - a' as two, so that without absorption its derivative is infinite in the
    # absorption and 0 in the scattering.
    fresnel = fresnel_diffuse_reflectance(eta)
    boundary = (1 + fresnel) / (1 - fresnel)
    depth = jnp.sqrt(3 / total) * jnp.sqrt(absorption)
    reflectance = sigma_s_reduced / total / 2 * (1 + jnp.exp(-4 / 3 * boundary * depth)) * jnp.exp(-depth)
    reflectance = jnp.where(present, reflectance, 0)
    valid = (sigma_s_reduced >= 0) & (sigma_a >= 0) & (eta >= ETA_RANGE[0]) & (eta <= ETA_RANGE[1])
    return jnp.where(valid, reflectance, jnp.nan).astype(dtype)
