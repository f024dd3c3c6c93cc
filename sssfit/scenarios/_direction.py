"""The direction of a sample, as far as it matters: its cosine."""

import math

import jax.numpy as jnp
from jax import Array

# Coefficients of sin(pi s) / s in s^2, up to the power that leaves 6e-12 at s = 1/2.
_COEFFICIENTS = [(-1) ** k * math.pi ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(8)]


def cosine_of_half_turn(uniform: Array) -> Array:
    """cos(pi u) of u in [0, 1], within 1e-9 or its rounding, at a fraction of the cost of `jnp.cos`.

    The cosine of a direction that is uniform over the half turn has the same distribution as over the whole,
    since the other half mirrors it.
    """
    s = 0.5 - uniform
    squared = jnp.square(s)
    total = jnp.full_like(s, _COEFFICIENTS[-1])
    for coefficient in reversed(_COEFFICIENTS[:-1]):
        total = total * squared + coefficient
    return s * total
