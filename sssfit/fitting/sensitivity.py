"""How fitted parameters move with the data and the settings behind them: implicit differentiation.

At an optimum the gradient of the misfit is 0, whatever the problem. How the optimum moves with the problem
therefore follows from second derivatives there, without differentiating through a solver or fitting again.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.fitting.solve import Residuals


def optimum(residuals: Residuals, problem: Any, found: ArrayLike, free: ArrayLike | None = None) -> Array:
    """A least-squares optimum as a differentiable function of its problem.

    Use it within a function of the data or of settings from which the problem is made, and give that function
    to `jax.grad`, `jax.jacfwd`, `jax.jacrev` or `jax.jvp`. Whatever is computed from the result, such as a
    table, is differentiated with it.

    Args:
        residuals: JAX function from parameters (n,) and the problem to residuals (m,).
        problem: pytree of arrays.
        found: parameters at the optimum for this problem, shape (n,): from any solver, and constants here.
        free: which parameters may move, shape (n,); those on a bound do not. By default all.

    Returns:
        The parameters, shape (n,). First derivatives are those of the optimum, as good as `found` is; second
        ones are not. If the misfit does not change in some direction, derivatives are infinite or NaN.

    Source: the implicit function theorem; Blondel et al. 2022, "Efficient and Modular Implicit
    Differentiation", section 2.

    Example:
        >>> def residuals(p, square):
        ...     return p**2 - square
        >>> float(jax.grad(lambda square: optimum(residuals, square, jnp.array([2.0]))[0])(4.0))
        0.25
    """
    found = jax.lax.stop_gradient(jnp.asarray(found))
    moves = jnp.ones(found.shape, bool) if free is None else jnp.asarray(free)

    def misfit(parameters, problem):
        return jnp.sum(jnp.square(residuals(parameters, problem))) / 2

    gradient = jnp.where(moves, jax.grad(misfit)(found, problem), 0)
    curvature = jax.hessian(misfit)(found, jax.lax.stop_gradient(problem))
    curvature = jnp.where(jnp.outer(moves, moves), curvature, jnp.eye(found.size, dtype=found.dtype))
    # One step of Newton's method: of no length, as the gradient is 0, but with the optimum's derivative.
    step = jnp.linalg.solve(curvature, gradient)
    return found - (step - jax.lax.stop_gradient(step))
