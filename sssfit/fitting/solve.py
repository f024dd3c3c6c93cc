"""The one place that knows solvers: bounded nonlinear least squares by three of them.

optimistix has no bounds, so its Levenberg-Marquardt runs on a smooth map of the line onto the box that
reaches the box's ends; jaxopt's L-BFGS-B and SciPy's trust-region reflective method take boxes as they
are. Solvers are imported when they are used: importing sssfit loads none of them.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

SolverName = Literal["optimistix", "jaxopt", "scipy"]
SolverChoice = Literal["optimistix", "jaxopt", "scipy", "all"]
SOLVERS: tuple[SolverName, ...] = get_args(SolverName)

# Residuals take parameters of shape (n,) and a pytree of arrays that belong to the problem. Compiled code is
# kept by the function's identity, so a function should be made once and the problem passed to it.
Residuals = Callable[[Array, Any], Array]

_MAX_STEPS = 1000
_TOLERANCE = 1e-11
_COST_TOLERANCE = 1e-15
_REST = 1e-8
# Newton's error is squared by a step, so this one leaves rounding alone.
_ROOT_TOLERANCE = 1e-8


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

    Args:
        solver: a solver's name, or "all".

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
    residuals: Residuals,
    problem: Any,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    solver: SolverName,
) -> Solution:
    """Minimize half the sum of squared residuals inside a box, in float64.

    Args:
        residuals: JAX function from parameters (n,) and the problem to residuals (m,).
        problem: pytree of float64 arrays, passed to the residuals as it is.
        start: strictly inside the bounds, shape (n,).
        lower: lower bounds, shape (n,); -inf for none.
        upper: upper bounds, shape (n,); inf for none, and none without a lower one.
        solver: which one.

    Returns:
        A `Solution`; a solver that fails says so there, nothing is raised.

    Example:
        >>> box = np.array([-1.0]), np.array([1.0])
        >>> least_squares(lambda p, data: p - data, 3.0, np.zeros(1), *box, "scipy").parameters.round(6)
        array([1.])
    """
    run = {"optimistix": _optimistix, "jaxopt": _jaxopt, "scipy": _scipy}[solver]
    with jax.enable_x64(True):
        parameters, converged, status = run(residuals, problem, start, lower, upper)
        parameters = np.clip(np.asarray(parameters, np.float64), lower, upper)
        cost = 0.5 * float(np.sum(np.square(_compiled(residuals)[0](parameters, problem))))
    return Solution(solver, parameters, cost, bool(converged) and bool(np.isfinite(cost)), status)


def levenberg_marquardt(
    residuals: Residuals, problem: Any, start: Array, lower: ArrayLike, upper: ArrayLike
) -> tuple[Array, Any]:
    """The optimistix path of `least_squares` as pure JAX, for `jit` and `vmap`.

    Args:
        residuals: JAX function from parameters (n,) and the problem to residuals (m,).
        problem: pytree of arrays.
        start: strictly inside the bounds, shape (n,), float64.
        lower: lower bounds, shape (n,).
        upper: upper bounds, shape (n,).

    Returns:
        Parameters of shape (n,), and the solver's result, an optimistix `RESULTS` item.

    Example:
        >>> def residuals(p, square):
        ...     return p**2 - square
        >>> with jax.enable_x64(True):
        ...     p, _ = levenberg_marquardt(residuals, 4.0, jnp.ones(1), np.zeros(1), np.full(1, 9.0))
        >>> float(p[0]).__round__(9)
        2.0
    """
    import optimistix

    # The damping starts at 1, which should be small beside the Jacobian whatever the residuals' unit.
    scale = 1 / jnp.maximum(jnp.linalg.norm(residuals(start, problem)), np.finfo(np.float64).tiny)
    solution = optimistix.least_squares(
        lambda line, problem: scale * residuals(_from_line(line, lower, upper), problem),
        optimistix.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE),
        _to_line(start, lower, upper),
        args=problem,
        max_steps=_MAX_STEPS,
        throw=False,
    )
    return _from_line(solution.value, lower, upper), solution.result


def rising_root(
    function: Callable[[Array], Array], start: ArrayLike, lower: ArrayLike, upper: ArrayLike
) -> tuple[Array, Array]:
    """Where a scalar function goes from below 0 to above, by Newton's method kept in a shrinking bracket.

    A step that leaves the bracket, or that a falling slope misleads, is replaced by a bisection.

    Args:
        function: JAX function from shape () to shape (), below 0 at `lower` and above at `upper`.
        start: between the two, shape ().
        lower: lower end, shape ().
        upper: upper end, shape ().

    Returns:
        The root, and whether the search settled at one away from both ends; shape ().

    Example:
        >>> with jax.enable_x64(True):
        ...     root, ok = rising_root(lambda x: x**2 - 4.0, 1.0, 0.0, 9.0)
        >>> float(root).__round__(12), bool(ok)
        (2.0, True)
    """
    lower, upper, start = (jnp.asarray(x, float) for x in (lower, upper, start))

    def step(state):
        low, high, x, _, count = state
        value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
        low, high = jnp.where(value < 0, x, low), jnp.where(value < 0, high, x)
        change = jnp.where(slope > 0, -value / slope, jnp.inf)
        # What ends the search is a step that rounding alone may have put outside of the bracket.
        inside = ((x + change > low) & (x + change < high)) | (jnp.abs(change) <= _ROOT_TOLERANCE)
        change = jnp.where(inside, change, (low + high) / 2 - x)
        return low, high, x + change, change, count + 1

    def searching(state):
        *_, change, count = state
        return (jnp.abs(change) > _ROOT_TOLERANCE) & (count < _MAX_STEPS)

    state = (lower, upper, start, jnp.full_like(start, jnp.inf), 0)
    *_, root, change, _ = jax.lax.while_loop(searching, step, state)
    at_end = jnp.minimum(root - lower, upper - root) <= 2 * _ROOT_TOLERANCE
    return root, (jnp.abs(change) <= _ROOT_TOLERANCE) & ~at_end


def succeeded(result: Any) -> Array:
    """Whether an optimistix result means convergence, also inside `jit` and `vmap`.

    Args:
        result: the `result` of an optimistix solution.

    Example:
        >>> import optimistix
        >>> bool(succeeded(optimistix.RESULTS.successful))
        True
    """
    import optimistix

    return result == optimistix.RESULTS.successful


_compiled_levenberg_marquardt = jax.jit(levenberg_marquardt, static_argnums=0)


def _optimistix(residuals, problem, start, lower, upper):
    import optimistix

    parameters, result = _compiled_levenberg_marquardt(residuals, problem, start, lower, upper)
    if bool(succeeded(result)):
        return parameters, True, "converged"
    # Where rounding moves the cost by more than its tolerance, steps are refused until none are left.
    if _is_at_rest(residuals, problem, np.asarray(parameters), lower, upper):
        return parameters, True, "converged to rounding"
    return parameters, False, optimistix.RESULTS[result]


def _is_at_rest(residuals, problem, parameters, lower, upper) -> bool:
    """Whether a step of Gauss and Newton's method from here is nothing beside the parameters."""
    free = (parameters > lower) & (parameters < upper)
    left, slopes = (np.asarray(part(parameters, problem)) for part in _compiled(residuals))
    if not (np.all(np.isfinite(left)) and np.all(np.isfinite(slopes))):
        return False
    step = np.linalg.lstsq(slopes[:, free], left, rcond=None)[0]
    return bool(np.all(np.abs(step) <= _REST * (1 + np.abs(parameters[free]))))


@functools.cache
def _bounded_lbfgs(residuals):
    import jaxopt

    def cost(parameters, problem, scale):
        return 0.5 * scale * jnp.sum(jnp.square(residuals(parameters, problem)))

    solver = jaxopt.LBFGSB(cost, maxiter=_MAX_STEPS, tol=1e-10)
    return jax.jit(cost), jax.jit(solver.run)


def _jaxopt(residuals, problem, start, lower, upper):
    cost, run = _bounded_lbfgs(residuals)
    # The cost is scaled to 1 at the start, so that one tolerance suits every unit of the residuals.
    scale = 1 / max(float(cost(start, problem, 1.0)), np.finfo(np.float64).tiny)
    result = run(start, bounds=(lower, upper), problem=problem, scale=scale)
    error = float(result.state.error)
    status = f"projected gradient {error:.1e} after {int(result.state.iter_num)} steps"
    return result.params, error <= 1e-6, status


@functools.cache
def _compiled(residuals):
    return jax.jit(residuals), jax.jit(jax.jacfwd(residuals))


def _scipy(residuals, problem, start, lower, upper):
    from scipy.optimize import least_squares as trust_region

    function, jacobian = _compiled(residuals)
    if not np.all(np.isfinite(function(start, problem))):
        # SciPy raises here; the others carry on and say so at the end.
        return start, False, "the residuals are not finite at the start"
    result = trust_region(
        function,
        start,
        jac=jacobian,  # pyright: ignore[reportArgumentType]
        args=(problem,),
        bounds=(lower, upper),
        method="trf",
        # The cost is flat at its minimum: the parameters are as good as the root of what it changes by.
        ftol=_COST_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=_MAX_STEPS,
    )
    return result.x, result.success, result.message


def _from_line(line: Array, lower: ArrayLike, upper: ArrayLike) -> Array:
    """Map the line onto [lower, upper] by a sine, onto [lower, inf) by a hyperbola."""
    boxed, floored, width, floor = _kinds(lower, upper)
    in_box = floor + width * (1 + jnp.sin(line)) / 2
    above = floor + jnp.sqrt(jnp.square(line) + 1) - 1
    return jnp.where(boxed, in_box, jnp.where(floored, above, line))


def _to_line(parameters: Array, lower: ArrayLike, upper: ArrayLike) -> Array:
    boxed, floored, width, floor = _kinds(lower, upper)
    in_box = jnp.arcsin(2 * jnp.where(boxed, parameters - floor, width / 2) / width - 1)
    above = jnp.sqrt(jnp.square(jnp.where(floored, parameters - floor, 0) + 1) - 1)
    return jnp.where(boxed, in_box, jnp.where(floored, above, parameters))


def _kinds(lower: ArrayLike, upper: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Which parameters have two bounds and which a lower one alone; widths and floors, 1 and 0 elsewhere."""
    lower, upper = jnp.asarray(lower), jnp.asarray(upper)
    boxed = jnp.isfinite(lower) & jnp.isfinite(upper)
    floored = jnp.isfinite(lower) & ~jnp.isfinite(upper)
    return boxed, floored, jnp.where(boxed, upper - lower, 1), jnp.where(jnp.isfinite(lower), lower, 0)
