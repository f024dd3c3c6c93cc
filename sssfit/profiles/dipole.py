"""The dipole approximation of a half space: its profile, what leaves beyond a distance, its total.

Light that enters at a point is taken to be diffused by a source one mean free path below it, and the surface
by a second one above, at -z_v. Lengths are in millimetres. All functions are elementwise: arguments
broadcast, the result has their dtype (float16 and bfloat16 are computed in float32), and `jit`, `vmap` and
`grad` apply.

Source: Jensen, Marschner, Levoy and Hanrahan, "A Practical Model for Subsurface Light Transport", 2001.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles._elementwise import broadcast

# exp(-x) is 0 in float64 too from here on.
_FAR = 1000.0
# Mean free paths within which no light leaves, to rounding; their square is still a normal float32.
_NEAR = 1e-18

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
    depth = jnp.sqrt(3 / total) * jnp.sqrt(absorption)
    reflectance = (
        sigma_s_reduced / total / 2 * (1 + jnp.exp(-4 / 3 * _boundary(eta) * depth)) * jnp.exp(-depth)
    )
    reflectance = jnp.where(present, reflectance, 0)
    return jnp.where(_is_valid(sigma_s_reduced, sigma_a, eta), reflectance, jnp.nan).astype(dtype)


def effective_transport(sigma_s_reduced: ArrayLike, sigma_a: ArrayLike) -> Array:
    """Effective transport coefficient: the rate at which diffused light decays with the distance.

    Args:
        sigma_s_reduced: reduced scattering coefficient, 1/mm, >= 0.
        sigma_a: absorption coefficient, 1/mm, >= 0. At 0 nothing decays and the result is 0, with an
            infinite derivative.

    Returns:
        sqrt(3 sigma_a (sigma_a + sigma_s')), 1/mm; NaN off the domain. Relative error in float32 below 4e-7.

    Source: Jensen et al. 2001, section 2.1.

    Example:
        >>> float(effective_transport(2.62, 0.0041)).__round__(6)
        0.179656
    """
    dtype, (sigma_s_reduced, sigma_a) = broadcast(sigma_s_reduced, sigma_a)
    extinction = sigma_s_reduced + sigma_a
    present = extinction > 0
    # The root as two: the product would underflow, and lose the finite derivative in the scattering.
    root = jnp.sqrt(jnp.where(present, extinction, 1)) * jnp.sqrt(3 * jnp.where(present, sigma_a, 1))
    valid = (sigma_s_reduced >= 0) & (sigma_a >= 0)
    return jnp.where(valid, jnp.where(present, root, 0), jnp.nan).astype(dtype)


def profile(r: ArrayLike, sigma_s_reduced: ArrayLike, sigma_a: ArrayLike, eta: ArrayLike) -> Array:
    """Areal density of the light that leaves at distance r from where it entered.

    Args:
        r: distance on the surface, mm. Below 0 the density is 0; at 0 it is finite.
        sigma_s_reduced: reduced scattering coefficient, 1/mm, >= 0. At 0 the density is 0.
        sigma_a: absorption coefficient, 1/mm, >= 0. At 0 the density falls as r^-3 and not exponentially;
            derivatives stay finite.
        eta: relative refractive index, in `ETA_RANGE`; NaN outside.

    Returns:
        a' / (4 pi) times the sum of z (1 + s d) exp(-s d) / d^3 over the real source, z = 1 / sigma_t',
        and the virtual one, z = (1 + 4/3 A) / sigma_t', in 1/mm^2; d = sqrt(r^2 + z^2), s is
        `effective_transport`, a' and A are as in `diffuse_reflectance`, which is its integral over the
        plane. NaN off the domain. Relative error in float32 below (2 + s d) 4e-7 for coefficients and
        distances from 1e-6 to 1e6 and 1 <= eta <= 2, while the density is a normal number.

    Source: Jensen et al. 2001, section 2.4, with a plus between the two: both z are positive here.

    Example:
        >>> float(profile(1.0, 2.62, 0.0041, 1.5)).__round__(6)
        0.034327
    """
    dtype, (r, sigma_s_reduced, sigma_a, eta) = broadcast(r, sigma_s_reduced, sigma_a, eta)
    extinction = sigma_s_reduced + sigma_a
    inside = (extinction > 0) & (r >= 0) & (r < jnp.inf)
    absorption, total = jnp.where(inside, sigma_a, 0), jnp.where(inside, extinction, 1)
    paths = _in_paths(jnp.where(inside, r, 0), total)
    density = jnp.zeros_like(paths)
    for source in (jnp.ones_like(paths), 1 + 4 / 3 * _boundary(eta)):
        distance = jnp.hypot(paths, source)
        decayed = _decayed(3 * absorption / total, distance)
        density += source / distance * jnp.square(total / distance) * decayed
    density = sigma_s_reduced / total * density / (4 * jnp.pi)
    density = jnp.where(inside, density, jnp.where(jnp.isnan(r), jnp.nan, 0))
    return jnp.where(_is_valid(sigma_s_reduced, sigma_a, eta), density, jnp.nan).astype(dtype)


def sf(r: ArrayLike, sigma_s_reduced: ArrayLike, sigma_a: ArrayLike, eta: ArrayLike) -> Array:
    """Share of the light that leaves beyond distance r, of all that leaves: 1 - cdf, accurate in the tail.

    Args:
        r: distance on the surface, mm. Below 0 and at 0 the share is 1.
        sigma_s_reduced: reduced scattering coefficient, 1/mm, >= 0. At 0 nothing leaves, and the share is
            the limit for ever less scattering; without absorption too it is 1 at every finite distance.
        sigma_a: absorption coefficient, 1/mm, >= 0. At 0 the share falls as 1 / r; its derivative in
            sigma_a is infinite there, and 0 at r = 0.
        eta: relative refractive index, in `ETA_RANGE`; NaN outside.

    Returns:
        The sum over the two sources of z exp(-s d) / d, over its value at r = 0; symbols as in `profile`.
        Times `diffuse_reflectance` it is the energy that leaves beyond r. NaN off the domain. Relative error
        in float32 below (2 + s d) 4e-7 where that of `profile` is.

    Source: the integral of Jensen et al. 2001, section 2.4, over the plane beyond r:
        (1 + s d) exp(-s d) / d^2 is the derivative of -exp(-s d) / d.

    Example:
        >>> float(sf(1.0, 2.62, 0.0041, 1.5)).__round__(6)
        0.550898
    """
    dtype, (r, sigma_s_reduced, sigma_a, eta) = broadcast(r, sigma_s_reduced, sigma_a, eta)
    extinction = sigma_s_reduced + sigma_a
    inside = (extinction > 0) & (r * extinction > _NEAR) & (r < jnp.inf)
    absorption, total = jnp.where(inside, sigma_a, 1), jnp.where(inside, extinction, 1)
    decay = jnp.sqrt(3 / total) * jnp.sqrt(absorption)
    paths = _in_paths(jnp.where(inside, r, 1), total)
    share = _share_beyond(paths, decay, 1 + 4 / 3 * _boundary(eta))
    ends = jnp.where(r < jnp.inf, 1, jnp.where(jnp.isnan(r), jnp.nan, 0))
    share = jnp.where(inside, share, ends)
    return jnp.where(_is_valid(sigma_s_reduced, sigma_a, eta), share, jnp.nan).astype(dtype)


def _is_valid(sigma_s_reduced: Array, sigma_a: Array, eta: Array) -> Array:
    return (sigma_s_reduced >= 0) & (sigma_a >= 0) & (eta >= ETA_RANGE[0]) & (eta <= ETA_RANGE[1])


def _boundary(eta: Array) -> Array:
    """Jensen's A, by which a mismatched boundary moves the virtual source away."""
    fresnel = fresnel_diffuse_reflectance(eta)
    return (1 + fresnel) / (1 - fresnel)


def _in_paths(r: Array, total: Array) -> Array:
    """The distance in mean free paths: 0 to 1 is then the real source's depth, whatever the medium."""
    return jnp.minimum(r * total, jnp.finfo(r.dtype).max)


@jax.custom_jvp
def _decayed(square: Array, distance: Array) -> Array:
    """(1 + x) exp(-x) for x = sqrt(square) distance, whose slope in the square is finite at 0."""
    exponent = jnp.minimum(jnp.where(square > 0, jnp.sqrt(square) * distance, 0), _FAR)
    return (1 + exponent) * jnp.exp(-exponent)


@_decayed.defjvp
def _decayed_jvp(primals, tangents):
    (square, distance), (d_square, d_distance) = primals, tangents
    exponent = jnp.minimum(jnp.where(square > 0, jnp.sqrt(square) * distance, 0), _FAR)
    slope = jnp.exp(-exponent) * distance
    return _decayed(*primals), -slope * (distance / 2 * d_square + square * d_distance)


@jax.custom_jvp
def _share_beyond(paths: Array, decay: Array, virtual: Array) -> Array:
    """The share beyond a distance in mean free paths, of sources at depths 1 and `virtual`."""
    shares, beyond = _sources(paths, decay, virtual)
    return shares[0] * beyond[0] + shares[1] * beyond[1]


@_share_beyond.defjvp
def _share_beyond_jvp(primals, tangents):
    paths, decay, virtual = primals
    d_paths, d_decay, d_virtual = tangents
    shares, beyond = _sources(*primals)
    real, other = shares[0] * beyond[0], shares[1] * beyond[1]
    near, far = jnp.hypot(paths, 1), jnp.hypot(paths, virtual)
    # Light that changes its source; the real one's is the narrower.
    moved = shares[0] * shares[1] * jnp.minimum(beyond[0] - beyond[1], 0)
    by_paths = -paths / near * real * (1 / near + decay) - paths / far * other * (1 / far + decay)
    by_virtual = moved * decay + other * (
        jnp.square(paths / far) / virtual + decay * _excess(paths, virtual) / far
    )
    # In one piece: an infinite d_decay, which is that of no absorption, would cancel itself in several.
    by_decay = moved * (virtual - 1) - real * _excess(paths, 1.0) - other * _excess(paths, virtual)
    return _share_beyond(*primals), by_paths * d_paths + by_decay * d_decay + by_virtual * d_virtual


def _sources(paths: Array, decay: Array, virtual: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """How the light that leaves is shared by the sources, and what share of either's own is beyond."""
    lead = decay * (virtual - 1)
    near, far = (
        depth / jnp.hypot(paths, depth) * jnp.exp(-decay * _excess(paths, depth)) for depth in (1.0, virtual)
    )
    return (jax.nn.sigmoid(lead), jax.nn.sigmoid(-lead)), (near, far)


def _excess(paths: Array, depth: Array | float) -> Array:
    """hypot(paths, depth) - depth, without its cancellation."""
    return paths * (paths / (jnp.hypot(paths, depth) + depth))
