"""The one place that knows solvers: bounded nonlinear least squares by three of them.

optimistix has no bounds, so its Levenberg-Marquardt runs on a smooth map of the line onto the box that
reaches the box's ends; jaxopt's L-BFGS-B and SciPy's trust-region reflective method take boxes as they
are. Solvers are imported when they are used: importing sssfit loads none of them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

SolverName = Literal["optimistix", "jaxopt", "scipy"]
SolverChoice = Literal["optimistix", "jaxopt", "scipy", "all"]
SOLVERS: tuple[SolverName, ...] = get_args(SolverName)

Residuals = Callable[[Array], Array]

_MAX_STEPS = 1000
_TOLERANCE = 1e-11


@dataclass(frozen=True)
class Solution:
    """What one solver found.

    Attributes:
        solver: its name.
        parameters: float64, shape (n,), inside the bounds.
        cost: half the sum of squared residuals there.
        converged: the solver met its tolerance.
        status: the solver's own words on how it ended.
    """

    solver: SolverName
    parameters: np.ndarray
    cost: float
    converged: bool
    status: str


def chosen(solver: SolverChoice) -> tuple[SolverName, ...]:
    """The solvers that a choice names: itself, or the three for "all".

    Raises:
        ValueError: the choice is unknown.

    Example:
        >>> chosen("all")
        ('optimistix', 'jaxopt', 'scipy')
    """
    if solver == "all":
        return SOLVERS
    if solver not in SOLVERS:
        raise ValueError(f"solver must be one of {', '.join(SOLVERS)} or all, got {solver!r}")
    return (solver,)


def least_squares(
    residuals: Residuals, start: np.ndarray, lower: np.ndarray, upper: np.ndarray, solver: SolverName
) -> Solution:
    """Minimize half the sum of squared residuals inside a box, in float64.

    Args:
        residuals: JAX function from parameters (n,) to residuals (m,).
        start: strictly inside the bounds, shape (n,).
        lower: lower bounds, shape (n,); -inf for none.
        upper: upper bounds, shape (n,); inf for none.
        solver: which one.

    Returns:
        A `Solution`; a solver that fails says so there, nothing is raised.

    Example:
        >>> box = np.array([-1.0]), np.array([1.0])
        >>> least_squares(lambda p: p - 3.0, np.zeros(1), *box, "scipy").parameters.round(6)
        array([1.])
    """
    run = {"optimistix": _optimistix, "jaxopt": _jaxopt, "scipy": _scipy}[solver]
    with jax.enable_x64(True):
        parameters, converged, status = run(residuals, start, lower, upper)
        parameters = np.clip(np.asarray(parameters, np.float64), lower, upper)
        cost = 0.5 * float(np.sum(np.square(residuals(jnp.asarray(parameters)))))
    return Solution(solver, parameters, cost, bool(converged) and bool(np.isfinite(cost)), status)


def levenberg_marquardt(
    residuals: Residuals, start: Array, lower: np.ndarray, upper: np.ndarray
) -> tuple[Array, Array]:
    """The optimistix path of `least_squares` as pure JAX, for `jit` and `vmap`.

    Args:
        residuals: JAX function from parameters (n,) to residuals (m,).
        start: strictly inside the bounds, shape (n,), float64.
        lower: lower bounds, constants of shape (n,).
        upper: upper bounds, constants of shape (n,).

    Returns:
        Parameters of shape (n,), and whether the solver converged, shape ().

    Example:
        >>> with jax.enable_x64(True):
        ...     p, ok = levenberg_marquardt(lambda p: p**2 - 4.0, jnp.ones(1), np.zeros(1), np.full(1, 9.0))
        >>> float(p[0]).__round__(9), bool(ok)
        (2.0, True)
    """
    solution = _run_optimistix(residuals, start, lower, upper)
    import optimistix

    return _from_line(solution.value, lower, upper), solution.result == optimistix.RESULTS.successful


def _run_optimistix(residuals, start, lower, upper):
    import optimistix

    start = jnp.asarray(start)
    # The damping starts at 1, which should be small beside the Jacobian whatever the residuals' unit.
    scale = 1 / jnp.maximum(jnp.linalg.norm(residuals(start)), np.finfo(np.float64).tiny)
    return optimistix.least_squares(
        lambda line, _: scale * residuals(_from_line(line, lower, upper)),
        optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE),
        _to_line(start, lower, upper),
        max_steps=_MAX_STEPS,
        throw=False,
    )


def _optimistix(residuals, start, lower, upper):
    import optimistix

    solution = _run_optimistix(residuals, start, lower, upper)
    converged = bool(solution.result == optimistix.RESULTS.successful)
    status = "converged" if converged else optimistix.RESULTS[solution.result]
    return _from_line(solution.value, lower, upper), converged, status


def _jaxopt(residuals, start, lower, upper):
    import jaxopt

    def cost(parameters):
        return 0.5 * jnp.sum(jnp.square(residuals(parameters)))

    # The cost is scaled to 1 at the start, so that one tolerance suits every unit of the residuals.
    scale = 1 / jnp.maximum(cost(jnp.asarray(start)), np.finfo(np.float64).tiny)
    solver = jaxopt.LBFGSB(lambda p: scale * cost(p), maxiter=_MAX_STEPS, tol=1e-10)
    result = solver.run(jnp.asarray(start), bounds=(jnp.asarray(lower), jnp.asarray(upper)))
    error = float(result.state.error)
    status = f"projected gradient {error:.1e} after {int(result.state.iter_num)} steps"
    return result.params, error <= 1e-6, status


def _scipy(residuals, start, lower, upper):
    from scipy.optimize import least_squares as trust_region

    result = trust_region(
        jax.jit(residuals),
        start,
        jac=jax.jit(jax.jacfwd(residuals)),  # pyright: ignore[reportArgumentType]
        bounds=(lower, upper),
        method="trf",
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_MAX_STEPS,
    )
    return result.x, result.success, result.message


def _from_line(line: Array, lower: np.ndarray, upper: np.ndarray) -> Array:
    """Map the line onto [lower, upper] by a sine, onto [lower, inf) by a hyperbola."""
    boxed, floored, width, floor = _kinds(lower, upper)
    in_box = floor + width * (1 + jnp.sin(line)) / 2
    above = floor + jnp.sqrt(jnp.square(line) + 1) - 1
    return jnp.where(boxed, in_box, jnp.where(floored, above, line))


def _to_line(parameters: Array, lower: np.ndarray, upper: np.ndarray) -> Array:
    boxed, floored, width, floor = _kinds(lower, upper)
    in_box = jnp.arcsin(2 * jnp.where(boxed, parameters - floor, width / 2) / width - 1)
    above = jnp.sqrt(jnp.square(jnp.where(floored, parameters - floor, 0) + 1) - 1)
    return jnp.where(boxed, in_box, jnp.where(floored, above, parameters))


def _kinds(lower: np.ndarray, upper: np.ndarray):
    boxed = np.isfinite(lower) & np.isfinite(upper)
    floored = np.isfinite(lower) & ~np.isfinite(upper)
    if np.any(~np.isfinite(lower) & np.isfinite(upper)):
        raise ValueError("a parameter with an upper bound needs a lower bound too")
    return boxed, floored, np.where(boxed, upper - lower, 1.0), np.where(np.isfinite(lower), lower, 0.0)
