"""Burley's normalized diffusion profile: density, distribution, quantiles and parameters.

The profile is R(r) = A (exp(-r / d) + exp(-r / (3 d))) / (8 pi d r), per area; its radial density is
2 pi r R / A = (exp(-r / d) + exp(-r / (3 d))) / (4 d). Lengths are in millimetres, `d` is the shape
parameter, and `albedo` the diffuse surface reflectance A. All functions are elementwise: arguments
broadcast, the result has their dtype (float16 and bfloat16 are computed in float32), and `jit`, `vmap`
and `grad` apply. A shape of zero is the delta at r = 0 and a negative or NaN one gives NaN.

Source: Christensen and Burley, "Approximate Reflectance Profiles for Efficient Subsurface
Scattering", 2015; Xie, dissertation, 2021, Eq 2.43-2.47.
"""

from typing import Literal

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles import _decay
from sssfit.profiles._elementwise import broadcast, on_support, ratio

Configuration = Literal["searchlight", "diffuse", "dmfp"]


def profile(r: ArrayLike, d: ArrayLike, albedo: ArrayLike = 1.0) -> Array:
    """Areal density R(r) of light that leaves at distance r from where it entered.

    Args:
        r: distance on the surface, mm. Below 0 the density is 0, at 0 it is inf.
        d: shape parameter, mm, >= 0.
        albedo: diffuse reflectance, the integral of the profile over the plane.

    Returns:
        Density in 1/mm^2, of the arguments' broadcast shape. Relative error in float32 below 5e-7
        while it is a normal number (for d = 1 up to r = 235); rounding of r / d itself adds r / (6 d)
        ulp.

    Source: Xie 2021, Eq 2.43.

    Example:
        >>> float(profile(1.0, 1.0)).__round__(6)
        0.043147
    """
    dtype, (r, d, albedo) = broadcast(r, d, albedo)
    positive = r > 0
    radius = jnp.where(positive, r, 1)
    density = ratio(on_support(_decay.pdf, radius, d, below=0, beyond=0), jnp.where(d > 0, d, 1))
    density = ratio(density, 2 * jnp.pi * radius)
    elsewhere = jnp.where(r == 0, jnp.inf, jnp.where(r < 0, 0, jnp.nan))
    elsewhere = jnp.where(d >= 0, elsewhere, jnp.nan)
    return (albedo * jnp.where(positive, density, elsewhere)).astype(dtype)


def pdf(r: ArrayLike, d: ArrayLike) -> Array:
    """Radial density 2 pi r R(r) / A: the probability of a distance, per mm.

    Args:
        r: distance, mm. Below 0 the density is 0, at 0 it is 1 / (2 d).
        d: shape parameter, mm. At 0 the density is 0, and inf at r = 0.

    Returns:
        Density in 1/mm. Relative error in float32 below 4e-7 while it is a normal number (for d = 1 up
        to r = 257); rounding of r / d itself adds r / (6 d) ulp.

    Source: Xie 2021, Eq 2.43, times 2 pi r / A.

    Example:
        >>> float(pdf(1.0, 1.0)).__round__(6)
        0.271103
    """
    dtype, (r, d) = broadcast(r, d)
    density = ratio(on_support(_decay.pdf, r, d, below=0, beyond=0), jnp.where(d > 0, d, 1))
    return jnp.where((d == 0) & (r == 0), jnp.inf, density).astype(dtype)


def cdf(r: ArrayLike, d: ArrayLike) -> Array:
    """Probability of a distance of at most r.

    Args:
        r: distance, mm. Below 0 the result is 0.
        d: shape parameter, mm. At 0 the result is 1 from r = 0 on.

    Returns:
        1 - exp(-r/d)/4 - 3 exp(-r/(3d))/4. Relative error in float32 below 4e-7 from r / d = 1e-30.

    Source: Xie et al. 2020, section 4.2; written with expm1 so that small distances keep their digits.

    Example:
        >>> float(cdf(1.0, 1.0)).__round__(6)
        0.370632
    """
    dtype, (r, d) = broadcast(r, d)
    return on_support(_decay.cdf, r, d, below=0, beyond=1).astype(dtype)


def sf(r: ArrayLike, d: ArrayLike) -> Array:
    """Probability of a distance above r, 1 - cdf, accurate in the tail.

    Args:
        r: distance, mm. Below 0 the result is 1.
        d: shape parameter, mm. At 0 the result is 0 from r = 0 on.

    Returns:
        exp(-r/d)/4 + 3 exp(-r/(3d))/4. Relative error in float32 below 4e-7 for r / d <= 250.

    Source: as `cdf`.

    Example:
        >>> float(sf(49.04355, 1.0)) / 2**-24
        1.0000...
    """
    dtype, (r, d) = broadcast(r, d)
    return on_support(_decay.sf, r, d, below=1, beyond=0).astype(dtype)


def ppf(q: ArrayLike, d: ArrayLike) -> Array:
    """Distance r with cdf(r, d) = q: the inverse cdf, accurate where q is small.

    Args:
        q: probability. 0 gives 0, 1 gives inf, outside [0, 1] gives NaN.
        d: shape parameter, mm. At 0 every distance is 0.

    Returns:
        Distance in mm. Relative error in float32 below 4e-7 of the exact distance for q as given,
        from 1e-30 to 1 - 2^-24. Use `isf` for tail probabilities closer to 0 than 1 - q can be to 1.
        The derivative in q is 1 / pdf (2 d at 0, inf at 1), in d it is r / d, and 0 where r is
        infinite or NaN.

    Source: root of t^3 + 3 t = 4 (1 - q) in t = exp(-r / 3d); closed form in Golubev, "Sampling
    Burley's Normalized Diffusion Profiles", 2019.

    Example:
        >>> float(ppf(0.5, 1.0)).__round__(6)
        1.552183
    """
    dtype, (q, d) = broadcast(q, d)
    return _decay.lower_quantile(q, d).astype(dtype)


def isf(q: ArrayLike, d: ArrayLike) -> Array:
    """Distance r with sf(r, d) = q: the inverse survival function, accurate where q is small.

    Args:
        q: probability of a larger distance. 0 gives inf, 1 gives 0, outside [0, 1] gives NaN.
        d: shape parameter, mm. At 0 every distance is 0.

    Returns:
        Distance in mm. Relative error in float32 below 4e-7 from q = 1e-30 to 1 - 2^-24. The
        derivative in q is -1 / pdf (-inf at 0, -2 d at 1), in d it is r / d, and 0 where r is infinite
        or NaN.

    Source: as `ppf`.

    Example:
        >>> float(isf(1e-6, 1.0)).__round__(4)
        40.5835
    """
    dtype, (q, d) = broadcast(q, d)
    return _decay.upper_quantile(q, d).astype(dtype)


def mean(d: ArrayLike) -> Array:
    """Mean distance, 2.5 d, in the unit of d.

    Args:
        d: shape parameter, mm, >= 0; below 0 the result is NaN.

    Source: the first moment of the radial density.

    Example:
        >>> float(mean(2.0))
        5.0
    """
    dtype, (d,) = broadcast(d)
    return (2.5 * _non_negative(d)).astype(dtype)


def variance(d: ArrayLike) -> Array:
    """Variance of the distance, 7.75 d^2, in the squared unit of d.

    Args:
        d: shape parameter, mm, >= 0; below 0 the result is NaN.

    Source: the second moment of the radial density is 14 d^2.

    Example:
        >>> float(variance(2.0))
        31.0
    """
    dtype, (d,) = broadcast(d)
    return (7.75 * jnp.square(_non_negative(d))).astype(dtype)


def transmittance(thickness: ArrayLike, d: ArrayLike, albedo: ArrayLike = 1.0) -> Array:
    """Light through a flat slab under uniform irradiance: the profile integrated over the far side.

    Args:
        thickness: mm. At 0 (and below) all of the albedo passes.
        d: shape parameter, mm. At 0 nothing passes a positive thickness.
        albedo: diffuse reflectance.

    Returns:
        albedo * (exp(-t/d) + 3 exp(-t/(3d))) / 4, dimensionless; accuracy as `sf`.

    Source: Golubev 2019; equals albedo * sf(thickness, d).

    Example:
        >>> float(transmittance(1.0, 1.0)).__round__(6)
        0.629368
    """
    dtype, (thickness, d, albedo) = broadcast(thickness, d, albedo)
    inside = on_support(_decay.sf, thickness, d, below=1, beyond=0)
    # The delta as a limit: its light has travelled no distance, so a slab of none lets it pass.
    passed = jnp.where((thickness == 0) & (d == 0), 1, inside)
    return (albedo * passed).astype(dtype)


def scaling(albedo: ArrayLike, configuration: Configuration = "dmfp") -> Array:
    """Ratio s = path length / d of one of Burley's three fitted configurations.

    Args:
        albedo: diffuse reflectance in [0, 1]; outside the fits mean nothing and the result is NaN.
        configuration: "searchlight" (a perpendicular beam; the path length is the volume mean free
            path), "diffuse" (ideal diffuse transmission; the volume mean free path), or "dmfp" (the
            path length is the diffuse mean free path on the surface).

    Returns:
        Dimensionless s(albedo).

    Raises:
        ValueError: the configuration is none of the three.

    Source: Christensen and Burley 2015, Eq 5, 6, 8; Xie 2021, Eq 2.44. Their fits to Monte Carlo data
    are good to 5.5 %, 3.9 % and 7.7 %.

    Example:
        >>> float(scaling(0.8, "searchlight")).__round__(6)
        1.05
    """
    dtype, (albedo,) = broadcast(albedo)
    if configuration == "searchlight":
        s = 1.85 - albedo + 7 * jnp.abs(albedo - 0.8) ** 3
    elif configuration == "diffuse":
        s = 1.9 - albedo + 3.5 * jnp.square(albedo - 0.8)
    elif configuration == "dmfp":
        s = 3.5 + 100 * jnp.square(jnp.square(albedo - 0.33))
    else:
        raise ValueError(f"configuration must be 'searchlight', 'diffuse' or 'dmfp', got {configuration!r}")
    return jnp.where((albedo >= 0) & (albedo <= 1), s, jnp.nan).astype(dtype)


def shape_from_mfp(mfp: ArrayLike, albedo: ArrayLike, configuration: Configuration = "searchlight") -> Array:
    """Shape parameter d in mm from the volume mean free path in mm.

    Args:
        mfp: volume mean free path, mm, >= 0.
        albedo: diffuse reflectance in [0, 1], NaN outside.
        configuration: "searchlight" or "diffuse"; see `scaling`.

    Raises:
        ValueError: the configuration does not take a volume mean free path.

    Source: Xie 2021, Eq 2.44.

    Example:
        >>> float(shape_from_mfp(1.05, 0.8)).__round__(6)
        1.0
    """
    dtype, (mfp, albedo) = broadcast(mfp, albedo)
    return (_non_negative(mfp) / scaling(albedo, _volume(configuration))).astype(dtype)


def mfp_from_shape(d: ArrayLike, albedo: ArrayLike, configuration: Configuration = "searchlight") -> Array:
    """Volume mean free path in mm from the shape parameter in mm: inverse of `shape_from_mfp`.

    Args:
        d: shape parameter, mm, >= 0.
        albedo: diffuse reflectance in [0, 1], NaN outside.
        configuration: "searchlight" or "diffuse"; see `scaling`.

    Raises:
        ValueError: the configuration does not take a volume mean free path.

    Source: Xie 2021, Eq 2.44.

    Example:
        >>> float(mfp_from_shape(1.0, 0.8)).__round__(6)
        1.05
    """
    dtype, (d, albedo) = broadcast(d, albedo)
    return (_non_negative(d) * scaling(albedo, _volume(configuration))).astype(dtype)


def shape_from_dmfp(dmfp: ArrayLike, albedo: ArrayLike) -> Array:
    """Shape parameter d in mm from the diffuse mean free path in mm.

    Args:
        dmfp: diffuse mean free path on the surface, mm, >= 0 (0 is the delta, d = 0).
        albedo: diffuse reflectance in [0, 1], NaN outside.

    Source: Xie 2021, Eq 2.44, third configuration.

    Example:
        >>> float(shape_from_dmfp(1.0, 0.9)).__round__(6)
        0.071144
    """
    dtype, (dmfp, albedo) = broadcast(dmfp, albedo)
    return (_non_negative(dmfp) / scaling(albedo, "dmfp")).astype(dtype)


def dmfp_from_shape(d: ArrayLike, albedo: ArrayLike) -> Array:
    """Diffuse mean free path in mm from the shape parameter in mm: inverse of `shape_from_dmfp`.

    Args:
        d: shape parameter, mm, >= 0.
        albedo: diffuse reflectance in [0, 1], NaN outside.

    Source: Xie 2021, Eq 2.44, third configuration.

    Example:
        >>> float(dmfp_from_shape(1.0, 0.33)).__round__(6)
        3.5
    """
    dtype, (d, albedo) = broadcast(d, albedo)
    return (_non_negative(d) * scaling(albedo, "dmfp")).astype(dtype)


def dmfp_from_coefficients(sigma_s: ArrayLike, sigma_a: ArrayLike, g: ArrayLike = 0.0) -> Array:
    """Diffuse mean free path in mm from volume coefficients, with Grosjean's diffusion coefficient.

    Args:
        sigma_s: scattering coefficient, 1/mm, >= 0 (the reduced one with g = 0).
        sigma_a: absorption coefficient, 1/mm, >= 0; at 0 the path is infinite.
        g: mean cosine of the scattering angle, in [-1, 1].

    Returns:
        sqrt((2 sigma_a + sigma_s') / (3 (sigma_a + sigma_s')^2 sigma_a)), sigma_s' = (1 - g) sigma_s;
        NaN outside the domain.

    Source: Xie 2021, Eq 2.45-2.47, with sigma_t = sigma_a + sigma_s'.

    Example:
        >>> float(dmfp_from_coefficients(0.74, 0.032)).__round__(5)
        3.74865
    """
    dtype, (sigma_s, sigma_a, g) = broadcast(sigma_s, sigma_a, g)
    absorbing = sigma_a > 0
    absorption = jnp.where(absorbing, sigma_a, 1)
    extinction = absorption + sigma_s * (1 - g)
    # The ratio first: squares of coefficients would underflow for metre-sized paths in float32.
    path = jnp.sqrt((extinction + absorption) / (3 * absorption)) / extinction
    valid = (sigma_s >= 0) & (sigma_a >= 0) & (jnp.abs(g) <= 1)
    return jnp.where(valid, jnp.where(absorbing, path, jnp.inf), jnp.nan).astype(dtype)


def _non_negative(length: Array) -> Array:
    return jnp.where(length >= 0, length, jnp.nan)


def _volume(configuration: Configuration) -> Configuration:
    if configuration == "dmfp":
        raise ValueError(
            "configuration must be 'searchlight' or 'diffuse' for a volume mean free path; "
            "use shape_from_dmfp and dmfp_from_shape for the diffuse one"
        )
    return configuration
