"""The inverse cdf and its approximations per unit shape: x = r / d as a function of xi.

`inverse_cdf.py` documents them; here are the formulas, each written to keep float32's relative accuracy.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.profiles import _decay

LogPolynomial = tuple[float, tuple[float, ...]]

#: The largest variate that a sampler uses, 1 - 2^-24.
LARGEST_VARIATE = 1 - 2.0**-24

# x = -factor ln(1 - xi) - xi (q0 + q1 xi + ...), from sssfit.fitting.inverse_cdf_approximation.
LOG_LINEAR: LogPolynomial = (3.056263051698966, (1.110966866322186,))
LOG_POLY4: LogPolynomial = (
    3.0,
    (1.000916437495396, 0.12983734604104546, 0.17781447282252955, -0.4399327194905364),
)
LOG_POLY8: LogPolynomial = (
    3.0,
    (
        *(0.9999974115846701, 0.16706378030867663, -0.0468542345028987, 0.0010280398422515026),
        *(-0.4866423407098388, 0.84405202140028, -1.0982548765058375, 0.4826817908676834),
    ),
)
LOG_POLY12: LogPolynomial = (
    3.0,
    (
        *(0.999999952609361, 0.16667840801514033, -0.03751027843096383, -0.08227433519554261),
        *(-0.14208005628780654, 0.14843730020801257, -0.4802148146158102, 0.2228925133547166),
        *(0.8036883359743443, -1.8554310582638793, 1.5988871565883807, -0.4800274687817124),
    ),
)


def clamped(xi: Array) -> Array:
    """xi, at most the largest variate; there its derivative is still 1, where jnp.minimum's is 1/2."""
    return jnp.where(xi > LARGEST_VARIATE, LARGEST_VARIATE, xi)


def log_complement(xi: Array) -> Array:
    """ln(1 - xi), as accurate as log1p(-xi) and cheaper: the second term is what rounding 1 - xi lost."""
    u = 1 - xi
    return jnp.log(u) + ((1 - u) - xi)


def xie(xi: Array, c: Array) -> Array:
    """g(xi | c) of Xie et al. 2020, Eq 21."""
    return ((2 - c) * xi - 2) * log_complement(xi)


def closed_form(xi: Array) -> Array:
    """Golubev's closed form."""
    u = 1 - xi
    g = jnp.cbrt(1 + 4 * u * (2 * u + jnp.sqrt(1 + 4 * u * u)))
    return 3 * jnp.log((1 + 1 / g + g) / (4 * u))


def log_polynomial(xi: Array, form: LogPolynomial) -> Array:
    """-factor ln(1 - xi) - xi (q0 + q1 xi + ...)."""
    log_factor, coefficients = form
    polynomial = jnp.full_like(xi, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        polynomial = polynomial * xi + coefficient
    return -log_factor * log_complement(xi) - xi * polynomial


def iterated(xi: Array, step, steps: int) -> Array:
    """Iterate on 1 - t where xi is small and on t elsewhere, as `burley.ppf` does; dead branches get 1/2."""
    small = xi < 0.5
    q, u = jnp.where(small, xi, 0.5), jnp.where(small, 0.5, 1 - xi)
    v, t = q * (2 + q) / 3, u * (4 - u) / 3
    for _ in range(steps):
        v = step(v, v * (v * (v - 3) + 6) - 4 * q, 3 * (v * (v - 2) + 2), 6 * (v - 1))
        t = step(t, t * (t * t + 3) - 4 * u, 3 * (t * t + 1), 6 * t)
    return jnp.where(small, -3 * log_complement(v), -3 * jnp.log(t))


def newton_step(root: Array, value: Array, slope: Array, curvature: Array) -> Array:
    """One step to the root of a function from its value and derivatives."""
    del curvature
    return root - value / slope


def halley_step(root: Array, value: Array, slope: Array, curvature: Array) -> Array:
    """One step to the root of a function from its value and derivatives."""
    return root - 2 * value * slope / (2 * slope * slope - value * curvature)


@functools.cache
def entries(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Equally spaced variates and their exact radii, in float64."""
    if size < 2:
        raise ValueError(f"size must be at least 2, got {size}")
    xi = np.minimum(np.linspace(0, 1, size), LARGEST_VARIATE)
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        return xi, np.asarray(_decay.inverse(jnp.asarray(xi), jnp.asarray(1 - xi)))


def looked_up(xi: Array, size: int) -> Array:
    """The line through the two entries around xi, whose slope is the derivative that `density` sees."""
    nodes, radii = (jnp.asarray(a, xi.dtype) for a in entries(size))
    cell = jnp.clip((xi * (size - 1)).astype(jnp.int32), 0, size - 2)
    slope = (radii[1:] - radii[:-1]) / (nodes[1:] - nodes[:-1])
    return radii[cell] + slope[cell] * (xi - nodes[cell])
