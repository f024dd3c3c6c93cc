"""The two exponentials of Burley's profile and the inverse of their mixture, per unit shape.

Functions of the dimensionless radius x = r / d >= 0, written so that float32 keeps its relative accuracy
from the smallest normal number to the far tail. `burley.py` adds lengths, domains and edge values.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero


@jax.custom_jvp
def decays(x: Array) -> tuple[Array, Array]:
    """exp(-x) and exp(-x / 3).

    Both come from y = exp(-x / 4), whose argument is exact: rounding x / 3 alone would cost a
    relative error of x / 3 ulp in the tail.
    """
    y = jnp.exp(-0.25 * x)
    return jnp.square(jnp.square(y)), y * jnp.cbrt(y)


@decays.defjvp
def _decays_jvp(primals, tangents):
    fast, slow = decays(*primals)
    (dx,) = tangents
    return (fast, slow), (-fast * dx, -slow * dx / 3)


def pdf(x: Array) -> Array:
    """(exp(-x) + exp(-x / 3)) / 4."""
    fast, slow = decays(x)
    return 0.25 * (fast + slow)


@jax.custom_jvp
def cdf(x: Array) -> Array:
    """1 - exp(-x) / 4 - 3 exp(-x / 3) / 4, as a sum of two terms of one sign."""
    return -0.25 * jnp.expm1(-x) - 0.75 * jnp.expm1(-x / 3)


@cdf.defjvp
def _cdf_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    # Not the derivative of expm1, which is expm1 + 1 and loses the tail.
    return cdf(x), pdf(x) * dx


def sf(x: Array) -> Array:
    """exp(-x) / 4 + 3 exp(-x / 3) / 4."""
    fast, slow = decays(x)
    return 0.25 * fast + 0.75 * slow


def inverse(q: Array, complement: Array) -> Array:
    """x with cdf(x) = q and sf(x) = complement, where q + complement = 1 up to rounding.

    With t = exp(-x / 3) the survival function is a cubic, t^3 + 3 t = 4 sf. It is solved for t where
    the tail matters and for v = 1 - t where small radii do; two Halley steps from a quadratic start
    leave an error below 1e-17, so rounding is all that remains in float32 and in float64.
    """
    small = q < 0.5
    # A dead branch is fed 1/2, so that neither its value nor its derivative can be infinite.
    v = _one_minus_t(jnp.where(small, q, 0.5))
    t = _t(jnp.where(small, 0.5, complement))
    u = 1 - v
    # log1p(-v), but XLA's own is off by 120 ulp in float64 for v from 0.3 to 0.45 on the CPU.
    log_of_small = jnp.log(u) + ((1 - u) - v) / u
    return jnp.where(small, -3 * log_of_small, -3 * jnp.log(t))


def _one_minus_t(q: Array) -> Array:
    v = q * (2 + q) / 3
    for _ in range(2):
        residual = v * (v * (v - 3) + 6) - 4 * q
        slope = 3 * (v * (v - 2) + 2)
        v = v - residual * slope / (slope * slope - 3 * residual * (v - 1))
    return v


def _t(complement: Array) -> Array:
    t = complement * (4 - complement) / 3
    for _ in range(2):
        residual = t * (t * t + 3) - 4 * complement
        slope = t * t + 1
        t = t - residual * slope / (3 * slope * slope - t * residual)
    return t


def _quantile(q: Array, d: Array, x: Array) -> Array:
    # The products inf * 0 that d = 0 and d = inf would make are zero: the delta, and the origin.
    r = jnp.where((d == 0) | (x == 0), 0, d * x)
    return jnp.where((q >= 0) & (q <= 1) & (d >= 0), r, jnp.nan)


def _quantile_tangent(r: Array, x: Array, slope: Array, dq, dd) -> Array:
    tangent = jnp.zeros_like(r)
    if not isinstance(dq, SymbolicZero):
        tangent = tangent + slope * dq
    if not isinstance(dd, SymbolicZero):
        tangent = tangent + jnp.where(jnp.isfinite(r) & jnp.isfinite(x), x, 0) * dd
    return tangent


def _slope(x: Array, d: Array) -> Array:
    """d / pdf(x), and 0 for the delta d = 0 at x = inf too."""
    density = pdf(x)
    return d / jnp.where((d == 0) & (density == 0), 1, density)


@jax.custom_jvp
def lower_quantile(q: Array, d: Array) -> Array:
    """Radius with cdf(r / d) = q, its derivatives right at both ends."""
    return _quantile(q, d, inverse(q, 1 - q))


def _lower_quantile_jvp(primals, tangents):
    q, d = primals
    r = lower_quantile(q, d)
    x = lower_quantile(q, jnp.ones_like(d))
    return r, _quantile_tangent(r, x, _slope(x, d), *tangents)


lower_quantile.defjvp(_lower_quantile_jvp, symbolic_zeros=True)


@jax.custom_jvp
def upper_quantile(q: Array, d: Array) -> Array:
    """Radius with sf(r / d) = q, its derivatives right at both ends."""
    return _quantile(q, d, inverse(1 - q, q))


def _upper_quantile_jvp(primals, tangents):
    q, d = primals
    r = upper_quantile(q, d)
    x = upper_quantile(q, jnp.ones_like(d))
    return r, _quantile_tangent(r, x, -_slope(x, d), *tangents)


upper_quantile.defjvp(_upper_quantile_jvp, symbolic_zeros=True)
