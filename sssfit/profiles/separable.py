"""One-dimensional views of a radial profile: Burley's line spread, and kernels for two-pass blurs.

The line spread is the profile integrated along one axis of the plane, the response to a line of light;
it is all that a straight shadow edge sees, and the pre-integrated kernel of a separable blur.

Source: Jimenez et al. 2015; Xie 2021, Eq 2.60-2.67. With exp(-r/d)/r integrated along a line the line
spread is (K0(|x|/d) + K0(|x|/3d)) / (4 pi d), and its repeated integrals are Bickley functions.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles import gaussian_sum
from sssfit.profiles._elementwise import broadcast, on_support, ratio

# Ki_n(y) = integral over u > 0 of exp(-y cosh u) / cosh(u)^n. The trapezoid rule converges
# exponentially on it and adds only positive terms: 1e-11 relative for y <= 80 with this step.
_STEP = 0.1
_COSH = np.cosh(_STEP * np.arange(400))
_WEIGHTS = np.where(np.arange(400) == 0, 0.5, 1.0) * _STEP


def line_spread(x: ArrayLike, d: ArrayLike) -> Array:
    """Density of the signed distance x along one axis, Burley's profile integrated over the other.

    Args:
        x: signed distance, mm. At 0 the density is inf (logarithmically).
        d: shape parameter, mm, >= 0.

    Returns:
        (K0(|x|/d) + K0(|x|/3d)) / (4 pi d), 1/mm; its integral over all x is 1. Relative error
        below 1e-10 in float64 for 1e-12 <= |x|/d <= 80, and 1e-5 in float32 up to 40.

    Source: Xie 2021, Eq 2.65, of Eq 2.43 with albedo 1.

    Example:
        >>> float(line_spread(1.0, 1.0)).__round__(6)
        0.135091
    """
    dtype, (x, d) = broadcast(x, d)
    nonzero = x != 0
    distance = jnp.where(nonzero, jnp.abs(x), 1)

    def density(y):
        return (_bickley(0, y) + _bickley(0, y / 3)) / (4 * jnp.pi)

    spread = ratio(on_support(density, distance, d, below=0, beyond=0), jnp.where(d > 0, d, 1))
    return jnp.where(nonzero, spread, jnp.where(d >= 0, jnp.inf, jnp.nan)).astype(dtype)


def line_sf(x: ArrayLike, d: ArrayLike) -> Array:
    """Probability of a signed distance above x: the line spread integrated from x to infinity.

    Args:
        x: signed distance, mm; 1/2 at 0.
        d: shape parameter, mm. At 0 the result is 1 below x = 0 and 0 from there on.

    Returns:
        Probability. Relative error in the tail as `line_spread`.

    Source: integral of Xie 2021, Eq 2.65.

    Example:
        >>> float(line_sf(0.0, 1.0)).__round__(6)
        0.5
    """
    dtype, (x, d) = broadcast(x, d)

    def tail(y):
        return (_bickley(1, y) + 3 * _bickley(1, y / 3)) / (4 * jnp.pi)

    upper = on_support(tail, jnp.abs(x), d, below=0, beyond=0)
    return jnp.where(x < 0, 1 - upper, upper).astype(dtype)


def line_excess(x: ArrayLike, d: ArrayLike) -> Array:
    """Mean excess of the signed distance X over x, E[max(X - x, 0)], in mm.

    The response to any piecewise linear edge of light is a sum of these.

    Args:
        x: signed distance, mm.
        d: shape parameter, mm. At 0 the result is max(-x, 0).

    Returns:
        Length in mm; at x = 0 it is 2.5 d / pi. Relative error in the tail as `line_spread`.

    Source: second integral of Xie 2021, Eq 2.65.

    Example:
        >>> float(line_excess(0.0, 1.0) * np.pi).__round__(5)
        2.5
    """
    dtype, (x, d) = broadcast(x, d)

    def excess(y):
        return (_bickley(2, y) + 9 * _bickley(2, y / 3)) / (4 * jnp.pi)

    upper = d * on_support(excess, jnp.abs(x), d, below=0, beyond=0)
    return jnp.where(x < 0, upper - x, upper).astype(dtype)


def kernel_offsets(num_taps: int, reach: float) -> np.ndarray:
    """Tap positions from -reach to reach, spaced as a signed square so that the centre is dense.

    Args:
        num_taps: odd, >= 3.
        reach: position of the last tap, mm, > 0.

    Returns:
        Float64 positions in mm, ascending, shape (num_taps,), exactly symmetric, 0 in the middle.

    Raises:
        ValueError: num_taps is even or below 3, or reach is not positive and finite.

    Source: the demo of Jimenez et al. 2015 (reach 3 mm above 20 taps, 2 mm below, at falloff 1).

    Example:
        >>> kernel_offsets(5, 2.0)
        array([-2. , -0.5,  0. ,  0.5,  2. ])
    """
    if num_taps < 3 or num_taps % 2 == 0:
        raise ValueError(f"num_taps must be odd and at least 3, got {num_taps}")
    if not 0 < reach < np.inf:
        raise ValueError(f"reach must be a positive length in mm, got {reach}")
    half = num_taps // 2
    ramp = np.arange(-half, half + 1) / half
    return reach * np.sign(ramp) * ramp**2


def burley_kernel(offsets: ArrayLike, d: ArrayLike) -> Array:
    """Weights of a separable kernel whose taps carry the line spread's mass around them.

    Each tap owns the cell between the midpoints to its neighbours (the outermost up to itself), whose
    mass is a difference of `line_sf`: the spread is infinite at 0 and cannot be point-sampled there.

    Args:
        offsets: ascending tap positions, mm, shape (n,).
        d: shape parameter, mm, >= 0, shape (...): one kernel each, all channels at once. Far beyond the
            reach (1e5 times in float32) the cells' masses are lost to rounding.

    Returns:
        Weights of shape (n, ...) that sum to 1 over the taps. For d = 0 the tap at 0 has all of it.

    Source: Xie 2021, Eq 2.60-2.65; the cells are those of Jimenez' sampling.

    Example:
        >>> [f"{w:.3f}" for w in burley_kernel(kernel_offsets(5, 8.0), 1.0)]
        ['0.024', '0.192', '0.566', '0.192', '0.024']
    """
    dtype = jnp.result_type(float, offsets, d)
    wide = jnp.promote_types(dtype, jnp.float32)
    offsets, d = jnp.asarray(offsets, wide), jnp.asarray(d, wide)
    edges = _cell_edges(offsets).reshape((-1,) + (1,) * d.ndim)
    # Masses on each side of 0 from that side's tail, so that none is a difference of near-ones.
    upper = line_sf(jnp.abs(edges), jnp.broadcast_to(d, edges.shape[:1] + d.shape))
    below, above = edges[:-1], edges[1:]
    one_sided = jnp.abs(upper[:-1] - upper[1:])
    mass = jnp.where((below < 0) & (above > 0), 1 - upper[:-1] - upper[1:], one_sided)
    return (mass / jnp.sum(mass, axis=0, keepdims=True)).astype(dtype)


def falloff_kernel(offsets: ArrayLike, falloff: ArrayLike, strength: ArrayLike = 1.0) -> Array:
    """Weights of the separable kernel as the published demo computes them from Gaussians.

    The radial falloff profile, point-sampled, times the width of each tap's cell, normalized, then
    mixed with an unscattered centre. (A radial Gaussian used along a line changes the Gaussians'
    relative weights by 1 / sqrt(variance); that is the demo's choice, kept.)

    Args:
        offsets: ascending tap positions, mm, shape (n,), n odd; the middle one is the centre.
        falloff: width of each channel, (0, 1], shape (...).
        strength: share of light that scatters, in [0, 1], broadcasts with falloff.

    Returns:
        Weights of shape (n, ...) that sum to 1 over the taps.

    Source: the demo of Jimenez et al. 2015.

    Example:
        >>> [f"{w:.3f}" for w in falloff_kernel(kernel_offsets(5, 2.0), 1.0, 0.48)]
        ['0.009', '0.119', '0.744', '0.119', '0.009']
    """
    dtype = jnp.result_type(float, offsets, falloff, strength)
    wide = jnp.promote_types(dtype, jnp.float32)
    offsets = jnp.asarray(offsets, wide)
    falloff, strength = jnp.broadcast_arrays(jnp.asarray(falloff, wide), jnp.asarray(strength, wide))
    column = (-1,) + (1,) * falloff.ndim
    density = gaussian_sum.falloff_profile(offsets.reshape(column), falloff[None])
    mass = jnp.diff(_cell_edges(offsets)).reshape(column) * density
    weights = strength[None] * mass / jnp.sum(mass, axis=0, keepdims=True)
    return weights.at[offsets.shape[0] // 2].add(1 - strength).astype(dtype)


def _cell_edges(offsets: Array) -> Array:
    middle = (offsets[1:] + offsets[:-1]) / 2
    return jnp.concatenate([offsets[:1], middle, offsets[-1:]])


def _bickley(order: int, y: Array) -> Array:
    """Ki_order(y) for y >= 0; order 0 is the Bessel function K0, which needs y > 0."""
    along_nodes = (1,) * y.ndim + (-1,)
    cosh = jnp.asarray(_COSH, y.dtype).reshape(along_nodes)
    weights = jnp.asarray(_WEIGHTS / _COSH**order, y.dtype).reshape(along_nodes)
    return jnp.sum(weights * jnp.exp(-y[..., None] * cosh), axis=-1)
