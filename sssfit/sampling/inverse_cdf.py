"""Ways to draw a radius from Burley's profile, each with the density it really draws.

Every method maps a uniform variate xi in [0, 1) to a radius. All but "exact", "closed_form" and
"mixture" draw a density that differs a little from the profile's; an estimate stays unbiased when each
sample is weighted by profile density / drawn density, that is by `burley.pdf(r, d) / method.pdf(xi, d)`.

The contract of a method: `radius(xi, d)` in mm and `pdf(xi, d)` in 1/mm, the density drawn at
`radius(xi, d)`, which is 1 / (d radius / d xi) and known for free at the sample. Arguments broadcast; the
result has their dtype. Variates are clamped to 1 - 2^-24, the largest that float32 generators draw, so no
radius is infinite (the largest is 49.04 d for the exact inverse); variates below 0 are the caller's error.
A shape d of 0 gives radius 0 and density inf.

    x = r / d, u = 1 - xi, t = exp(-x / 3):   t^3 + 3 t = 4 u,   x = -3 ln u - 3 ln(4 / (3 + t^2))

The first logarithm carries the whole singularity and the second is smooth, between 0 and 0.87. The
methods log_linear, log_poly4, log_poly8 and log_poly12 replace it with a polynomial in xi.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles import burley
from sssfit.profiles._elementwise import broadcast
from sssfit.sampling import _unit_radius
from sssfit.sampling._unit_radius import LARGEST_VARIATE as LARGEST_VARIATE

#: The constant of the papers' approximation, as printed; `sssfit.fitting.inverse_cdf` fits it.
PUBLISHED_C = 2.5715


class Method(NamedTuple):
    """A way to draw radii: see the module's text for the contract.

    Attributes:
        radius: (xi, d) -> radius in mm.
        pdf: (xi, d) -> density in 1/mm that is drawn at that radius.
        summary: what it is, in a few words.
        draws_profile: whether that density is the profile's own, `burley.pdf`, within 3e-7, so that float32
            need not compute it to weigh a sample.

    Example:
        >>> method = METHODS["log_linear"]
        >>> weight = burley.pdf(method.radius(0.5, 1.0), 1.0) / method.pdf(0.5, 1.0)
        >>> float(weight).__round__(3)
        1.005
    """

    radius: Callable[[ArrayLike, ArrayLike], Array]
    pdf: Callable[[ArrayLike, ArrayLike], Array]
    summary: str
    draws_profile: bool = False


def exact(xi: ArrayLike, d: ArrayLike) -> Array:
    """The inverse cdf itself, to rounding: `burley.ppf` of the clamped variate.

    Args:
        xi: uniform variate in [0, 1]; NaN below.
        d: shape parameter, mm.

    Returns:
        Radius in mm. Relative error in float32 below 4e-7.

    Source: root of the cubic by Halley's method, see `burley.ppf`.

    Example:
        >>> float(exact(0.5, 1.0)).__round__(6)
        1.552183
    """
    dtype, (xi, d) = broadcast(xi, d)
    return burley.ppf(_unit_radius.clamped(xi), d).astype(dtype)


def closed_form(xi: ArrayLike, d: ArrayLike) -> Array:
    """The inverse cdf by the published closed form, as shaders evaluate it.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.

    Returns:
        3 d ln((1 + G^(-1/3) + G^(1/3)) / (4 u)), G = 1 + 4 u (2 u + sqrt(1 + 4 u^2)), u = 1 - xi, in mm.
        Exact in real arithmetic; in float32 the absolute error is up to 1e-6 d (or 2e-7 of the radius),
        so radii below 1e-3 d lose digits and those near 0 may come out as 0 or slightly negative.

    Source: Golubev 2019. Natural logarithm and the complement u, as there (Xie 2021, Eq 5.4-5.5,
    prints xi for u, which draws the same density in reverse order).

    Example:
        >>> float(closed_form(0.5, 1.0)).__round__(5)
        1.55218
    """
    dtype, (xi, d) = broadcast(xi, d)
    return (d * _unit_radius.closed_form(_unit_radius.clamped(xi))).astype(dtype)


def xie(xi: ArrayLike, d: ArrayLike, c: ArrayLike = PUBLISHED_C) -> Array:
    """The papers' approximate inverse cdf g(xi | c).

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.
        c: the constant, >= 2. Its published value minimizes the mean square error of the cdf; engines
            ship 2.6. See `sssfit.fitting.inverse_cdf.fit_c` for others.

    Returns:
        ((2 - c) xi - 2) ln(1 - xi) d, mm. For 2.5715 the cdf is off by up to 0.0099, the mean radius by
        -2.9 %, and the weight of the tail grows without bound (6.9 at the clamp).

    Source: Xie et al. 2020, Eq 21.

    Example:
        >>> float(xie(0.5, 1.0)).__round__(6)
        1.584361
    """
    dtype, (xi, d, c) = broadcast(xi, d, c)
    return (d * _unit_radius.xie(_unit_radius.clamped(xi), c)).astype(dtype)


def xie_pdf(xi: ArrayLike, d: ArrayLike, c: ArrayLike = PUBLISHED_C) -> Array:
    """The density that `xie` draws at xie(xi, d, c): 1 / g'(xi | c), not the profile's.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.
        c: the constant, >= 2.

    Returns:
        Density in 1/mm.

    Source: derivative of Xie et al. 2020, Eq 21.

    Example:
        >>> float(xie_pdf(0.5, 1.0)).__round__(6)
        0.201303
    """
    dtype, (xi, d, c) = broadcast(xi, d, c)
    return _density(lambda xi: _unit_radius.xie(xi, c), xi, d).astype(dtype)


def mixture(xi: ArrayLike, d: ArrayLike) -> Array:
    """A radius of the profile without an inverse: one of its two exponentials, chosen by xi itself.

    The density drawn is the profile's, but the radius is not an increasing function of xi, so
    stratified and low-discrepancy variates lose some of their benefit.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.

    Returns:
        Radius in mm: exponential of mean d for xi < 1/4, of mean 3 d above.

    Source: the density is a mixture of 1/4 exp(-r/d) / d and 3/4 exp(-r/3d) / 3d; the selection is
    pbrt-v3's.

    Example:
        >>> float(mixture(0.0, 1.0)), float(mixture(0.25, 1.0))
        (0.0, 0.0)
    """
    dtype, (xi, d) = broadcast(xi, d)
    xi = _unit_radius.clamped(xi)
    narrow = xi < 0.25
    # The complement of the reused variate: 4 (1 - xi) / 3 is exact where 1 - (xi - 1/4) / (3/4) is not.
    within_narrow = 0 - _unit_radius.log_complement(4 * jnp.where(narrow, xi, 0))
    within_wide = -3 * jnp.log(4 * (1 - jnp.where(narrow, 0.5, xi)) / 3)
    return (d * jnp.where(narrow, within_narrow, jnp.maximum(within_wide, 0))).astype(dtype)


def newton(xi: ArrayLike, d: ArrayLike, steps: int = 1) -> Array:
    """The inverse cdf by Newton steps on its cubic, from a quadratic start.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.
        steps: how many, >= 1. One leaves a relative error of 2.3e-4.

    Returns:
        Radius in mm.

    Source: Newton's method on t^3 + 3 t = 4 (1 - xi), t = exp(-r / 3d).

    Example:
        >>> float(newton(0.5, 1.0)).__round__(4)
        1.5518
    """
    dtype, (xi, d) = broadcast(xi, d)
    return (d * _unit_radius.iterated(_unit_radius.clamped(xi), _unit_radius.newton_step, steps)).astype(
        dtype
    )


def halley(xi: ArrayLike, d: ArrayLike, steps: int = 1) -> Array:
    """The inverse cdf by Halley steps on its cubic, from a quadratic start.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.
        steps: how many, >= 1. One leaves a relative error of 8.6e-7, two reach rounding.

    Returns:
        Radius in mm.

    Source: Halley's method on t^3 + 3 t = 4 (1 - xi), t = exp(-r / 3d).

    Example:
        >>> float(halley(0.5, 1.0)).__round__(5)
        1.55218
    """
    dtype, (xi, d) = broadcast(xi, d)
    return (d * _unit_radius.iterated(_unit_radius.clamped(xi), _unit_radius.halley_step, steps)).astype(
        dtype
    )


def table(xi: ArrayLike, d: ArrayLike, size: int = 256) -> Array:
    """The inverse cdf looked up linearly in a table of equal steps of xi.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.
        size: entries, >= 2. The last cell spans the whole tail beyond 1 - 1 / (size - 1).

    Returns:
        Radius in mm, between exact ones at the entries.

    Raises:
        ValueError: size is below 2.

    Source: the usual engine practice; the drawn density is constant in each cell.

    Example:
        >>> float(table(0.5, 1.0, size=3)).__round__(5)
        1.55218
    """
    dtype, (xi, d) = broadcast(xi, d)
    return (d * _unit_radius.looked_up(_unit_radius.clamped(xi), size)).astype(dtype)


def log_linear(xi: ArrayLike, d: ArrayLike) -> Array:
    """Our replacement for the papers' g at its very cost: one logarithm and one multiply-add.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.

    Returns:
        (-3.0563 ln(1 - xi) - 1.1110 xi) d, mm: least squares in the radius. The cdf is off by at most
        0.0023 (g: 0.0099), the root mean square radius error is 0.014 d (g: 0.244 d), and the weight
        of a sample never exceeds 1.016 (g: unbounded).

    Source: own fit, `sssfit.fitting.inverse_cdf_approximation.fit_log_linear`.

    Example:
        >>> float(log_linear(0.5, 1.0)).__round__(4)
        1.563
    """
    return _log_polynomial(xi, d, _unit_radius.LOG_LINEAR)


def log_poly4(xi: ArrayLike, d: ArrayLike) -> Array:
    """The inverse cdf to a relative error of 4.6e-4: one logarithm and four multiply-adds.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.

    Returns:
        Radius in mm; cdf error at most 1.5e-4, weights in [0.998, 1.002].

    Source: own fit, `sssfit.fitting.inverse_cdf_approximation.fit_log_polynomial(4)`.

    Example:
        >>> float(log_poly4(0.5, 1.0)).__round__(3)
        1.552
    """
    return _log_polynomial(xi, d, _unit_radius.LOG_POLY4)


def log_poly8(xi: ArrayLike, d: ArrayLike) -> Array:
    """The inverse cdf to a relative error of 1.3e-6 (2e-6 in float32): one logarithm.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.

    Returns:
        Radius in mm; weights within 1e-5 of 1.

    Source: own fit, `sssfit.fitting.inverse_cdf_approximation.fit_log_polynomial(8)`.

    Example:
        >>> float(log_poly8(0.5, 1.0)).__round__(5)
        1.55218
    """
    return _log_polynomial(xi, d, _unit_radius.LOG_POLY8)


def log_poly12(xi: ArrayLike, d: ArrayLike) -> Array:
    """The inverse cdf at float32 accuracy, without division, branch or iteration: one logarithm.

    Args:
        xi: uniform variate in [0, 1].
        d: shape parameter, mm.

    Returns:
        Radius in mm; relative error below 5e-7 in float32 and 2.5e-8 in float64, weights within 1e-6
        of 1.

    Source: own fit, `sssfit.fitting.inverse_cdf_approximation.fit_log_polynomial(12)`.

    Example:
        >>> float(log_poly12(0.5, 1.0)).__round__(5)
        1.55218
    """
    return _log_polynomial(xi, d, _unit_radius.LOG_POLY12)


def _log_polynomial(xi: ArrayLike, d: ArrayLike, form: _unit_radius.LogPolynomial) -> Array:
    dtype, (xi, d) = broadcast(xi, d)
    return (d * _unit_radius.log_polynomial(_unit_radius.clamped(xi), form)).astype(dtype)


def _density(radius: Callable[[Array], Array], xi: Array, d: Array) -> Array:
    """1 / (d x'(xi)): the change of variables, from the derivative of the very code that draws."""
    xi = _unit_radius.clamped(xi)
    slope = jax.jvp(radius, (xi,), (jnp.ones_like(xi),))[1]
    return 1 / (d * slope)


def _approximate(radius: Callable[[ArrayLike, ArrayLike], Array], summary: str) -> Method:
    """A method that draws a density of its own."""

    def pdf(xi: ArrayLike, d: ArrayLike) -> Array:
        dtype, (xi, d) = broadcast(xi, d)
        return _density(lambda xi: radius(xi, 1.0), xi, d).astype(dtype)

    return Method(radius, pdf, summary)


def _unbiased(radius: Callable[[ArrayLike, ArrayLike], Array], summary: str) -> Method:
    """A method that draws the profile's own density."""

    def pdf(xi: ArrayLike, d: ArrayLike) -> Array:
        return burley.pdf(radius(xi, d), d)

    return Method(radius, pdf, summary, draws_profile=True)


#: Every method by name; see `Method`.
METHODS: dict[str, Method] = {
    "exact": _unbiased(exact, "Halley on the cubic, both ends"),
    "closed_form": _unbiased(closed_form, "published closed form"),
    "mixture": _unbiased(mixture, "one of two exponentials"),
    "xie": Method(xie, xie_pdf, "papers' g(xi | 2.5715)"),
    "newton": _approximate(newton, "one Newton step"),
    "halley": _approximate(halley, "one Halley step"),
    "table": _approximate(table, "256 entries, linear"),
    "log_linear": _approximate(log_linear, "log and 1 coefficient"),
    "log_poly4": _approximate(log_poly4, "log and 4 coefficients"),
    "log_poly8": _approximate(log_poly8, "log and 8 coefficients"),
    "log_poly12": _approximate(log_poly12, "log and 12 coefficients")._replace(draws_profile=True),
}
