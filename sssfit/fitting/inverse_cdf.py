"""The constant c of the papers' approximate inverse cdf, under every objective one might mean.

g(xi | c) = d ((2 - c) xi - 2) ln(1 - xi) replaces the inverse of Burley's cdf. Its one constant depends
on what is minimized; the published 2.5715 is the mean square error of cdf(g(xi)) - xi.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.fitting import quadrature, sensitivity, solve
from sssfit.fitting.solve import Solution, SolverChoice
from sssfit.profiles import burley

Objective = Literal["cdf_mse", "cdf_minimax", "relative_radius", "radius", "mean_radius", "kl"]
OBJECTIVES: tuple[Objective, ...] = get_args(Objective)

# g is monotone for c >= 2, and for c > 3 its tail is heavier than the profile's.
LOWER_C, UPPER_C = 2.0, 4.0
_START_C = 2.5


@dataclass(frozen=True)
class ErrorReport:
    """How far g(xi | c) is from the exact inverse; radii in units of d, integrals over xi in (0, 1).

    Attributes:
        cdf_rms: root mean square of cdf(g) - xi.
        cdf_max: its largest magnitude.
        radius_rms: root mean square of g - ppf.
        relative_radius_rms: root mean square of g / ppf - 1.
        relative_radius_max: its largest magnitude for xi <= 1 - 2^-24.
        mean_radius_bias: E[g] / 2.5 - 1.
        kl: Kullback-Leibler divergence of the density that g draws from the profile's.
        weight_max: largest ratio of the profile's density to the one drawn, for xi <= 1 - 2^-24.
    """

    cdf_rms: float
    cdf_max: float
    radius_rms: float
    relative_radius_rms: float
    relative_radius_max: float
    mean_radius_bias: float
    kl: float
    weight_max: float


@dataclass(frozen=True)
class InverseCdfFit:
    """A fitted c.

    Attributes:
        objective: what was minimized.
        c: the constant, from the first of the solutions.
        converged: every solver that ran met its tolerance.
        status: the solvers' own words.
        report: the errors of g(xi | c).
        solutions: one `Solution` per solver that ran.
        disagreement: largest minus smallest c among them; 0 for one.
    """

    objective: Objective
    c: float
    converged: bool
    status: str
    report: ErrorReport
    solutions: tuple[Solution, ...]
    disagreement: float


def fit_c(objective: Objective = "cdf_mse", solver: SolverChoice = "optimistix") -> InverseCdfFit:
    """Fit the constant c of g(xi | c), as a continuous integral over xi, in float64.

    Args:
        objective: what is minimized over c:
            "cdf_mse", the mean square of cdf(g(xi)) - xi (gives the published 2.5715);
            "cdf_minimax", its largest magnitude;
            "relative_radius", the mean square of g / ppf - 1;
            "radius", the mean square of g - ppf;
            "mean_radius", the difference of the mean radii (8/3 makes it zero);
            "kl", the Kullback-Leibler divergence of the drawn density from the profile's.
        solver: "optimistix", "jaxopt", "scipy", or "all" to run the three and compare.

    Returns:
        An `InverseCdfFit`; `c` is good to 1e-7 for every objective and solver.

    Raises:
        ValueError: the objective or the solver is unknown.

    Source: Xie et al. 2020, section 4.2, Eq 21, for "cdf_mse"; the other objectives are ours.

    Example:
        >>> round(fit_c("cdf_mse").c, 6)
        2.5715
    """
    if objective not in OBJECTIVES:
        raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
    names = solve.chosen(solver)
    with jax.enable_x64(True):
        solutions = tuple(
            solve.least_squares(
                _RESIDUALS[objective],
                _grid(),
                np.array([_START_C]),
                np.array([LOWER_C]),
                np.array([UPPER_C]),
                name,
            )
            for name in names
        )
    values = [float(solution.parameters[0]) for solution in solutions]
    return InverseCdfFit(
        objective=objective,
        c=values[0],
        converged=all(solution.converged for solution in solutions),
        status="; ".join(f"{s.solver}: {s.status}" for s in solutions),
        report=report(values[0]),
        solutions=solutions,
        disagreement=max(values) - min(values),
    )


def weight_sensitivity(objective: Objective, c: float) -> tuple[np.ndarray, np.ndarray]:
    """How a fitted c moves when a part of xi is given more weight: dc / dw(xi), where w is 1 everywhere.

    Args:
        objective: what c minimizes, one whose misfit is an integral of squares: not "cdf_minimax" or
            "mean_radius".
        c: the fitted constant, from `fit_c`.

    Returns:
        xi, ascending in (0, 1), and the density of the derivative there, each of shape (768,). Weighting
        (xi, xi + dxi) by 1 + e moves c by e dxi times it; its integral is 0, as weighting all of xi alike
        changes nothing.

    Raises:
        ValueError: the objective has no weights.

    Source: the implicit function theorem, see `sensitivity`.

    Example:
        >>> xi, moved = weight_sensitivity("cdf_mse", fit_c("cdf_mse").c)
        >>> abs(float(np.trapezoid(moved, xi))) < 1e-4
        True
    """
    if objective not in OBJECTIVES or objective in ("cdf_minimax", "mean_radius"):
        raise ValueError(f"objective must be an integral over xi, got {objective!r}")
    with jax.enable_x64(True):
        grid = _grid()

        def fitted(extra):
            weighted = grid._replace(weights=grid.weights * (1 + extra))
            return sensitivity.optimum(_RESIDUALS[objective], weighted, jnp.array([c]))[0]

        moved = jax.jit(jax.grad(fitted))(jnp.zeros_like(grid.weights))
        return np.asarray(-jnp.expm1(-grid.s)), np.asarray(moved / grid.weights)


def report(c: float) -> ErrorReport:
    """The errors of g(xi | c), by quadrature in float64.

    Args:
        c: the constant, >= 2.

    Returns:
        An `ErrorReport`; its figures are good to six digits.

    Raises:
        ValueError: c is below 2, where g is not monotone.

    Example:
        >>> f"{report(2.5715).cdf_max:.4e}"
        '9.8677e-03'
    """
    if not c >= LOWER_C:
        raise ValueError(f"c must be at least 2, where g increases with xi, got {c}")
    with jax.enable_x64(True):
        return ErrorReport(*(float(value) for value in _errors(jnp.asarray(c, float), _grid())))


class _Grid(NamedTuple):
    """Quadrature over xi = 1 - exp(-s), with the exact radius at each node."""

    s: Array
    weights: Array
    radius: Array


@functools.cache
def _grid() -> _Grid:
    with jax.enable_x64(True):
        s, weights = (jnp.asarray(a) for a in quadrature.uniform_variate())
        return _Grid(s, weights, jax.jit(_exact)(s))


def _exact(s: Array) -> Array:
    # Each end of xi from the function that is accurate there.
    small = s < 0.5
    lower = burley.ppf(-jnp.expm1(-jnp.where(small, s, 0)), 1.0)
    return jnp.where(small, lower, burley.isf(jnp.exp(-s), 1.0))


def _g(s, c) -> Array:
    xi = -jnp.expm1(-s)
    return (2 - (2 - c) * xi) * s


def _cdf_error(s, c) -> Array:
    return jnp.exp(-s) - burley.sf(_g(s, c), 1.0)


def _weight(s, c) -> Array:
    """The profile's density over the drawn one, p(g) g'(xi); d xi = exp(-s) ds."""
    s = jnp.asarray(s)
    slope = jax.jvp(lambda s: _g(s, c), (s,), (jnp.ones_like(s),))[1]
    return burley.pdf(_g(s, c), 1.0) * slope * jnp.exp(s)


def _peak(s: Array, c, sign: float) -> Array:
    """The extremum of the cdf error of one sign, at the vertex of the parabola through the extreme nodes."""
    error = _cdf_error(s, c)
    middle = jnp.clip(jnp.argmax(sign * error), 1, s.size - 2)
    x = s[middle + np.array([-1, 1])] - s[middle]
    y = error[middle + np.array([-1, 1])] - error[middle]
    curvature = (y[1] / x[1] - y[0] / x[0]) / (x[1] - x[0])
    slope = y[0] / x[0] - curvature * x[0]
    return _cdf_error(s[middle] - slope / (2 * curvature), c)


@jax.jit
def _errors(c: Array, grid: _Grid) -> tuple[Array, ...]:
    """The fields of an `ErrorReport`, in their order."""
    cdf_error = _cdf_error(grid.s, c)
    radius_error = _g(grid.s, c) - grid.radius
    # Extremes over the variates that float32 samplers draw: the nodes, and the last variate itself.
    drawn = jnp.minimum(grid.s, 24 * np.log(2))
    relative = radius_error / grid.radius

    def mean(values):
        return jnp.sum(grid.weights * values)

    return (
        jnp.sqrt(mean(cdf_error**2)),
        jnp.maximum(jnp.abs(_peak(grid.s, c, 1.0)), jnp.abs(_peak(grid.s, c, -1.0))),
        jnp.sqrt(mean(radius_error**2)),
        jnp.sqrt(mean(relative**2)),
        jnp.max(jnp.abs(_g(drawn, c) / _exact(drawn) - 1)),
        mean(radius_error) / 2.5,
        mean(jnp.square(_root_deviance(_weight(grid.s, c))) / 2),
        jnp.max(_weight(drawn, c)),
    )


def _root_deviance(weight: Array) -> Array:
    """sign(w - 1) sqrt(2 (w - 1 - ln w)): half its square is a KL integrand that is never negative.

    The mean of w - 1 over the drawn density is 0, so adding it changes no integral.
    """
    z = jnp.log(weight)
    near = jnp.abs(z) < 1e-3
    away = jnp.where(near, 1.0, z)
    root = jnp.sign(away) * jnp.sqrt(2 * (jnp.expm1(away) - away))
    return jnp.where(near, z * (1 + z / 6 + z * z / 36), root)


def _weighted(error: Callable[[Array, _Grid], Array]) -> solve.Residuals:
    return lambda parameters, grid: jnp.sqrt(grid.weights) * error(parameters[0], grid)


# Each objective as residuals, so that half their sum of squares has its minimum at the same c.
_RESIDUALS: dict[Objective, solve.Residuals] = {
    "cdf_mse": _weighted(lambda c, grid: _cdf_error(grid.s, c)),
    # The largest error is smallest where the largest errors of both signs are equal.
    "cdf_minimax": lambda c, grid: _peak(grid.s, c, 1.0) + _peak(grid.s, c, -1.0),
    "relative_radius": _weighted(lambda c, grid: _g(grid.s, c) / grid.radius - 1),
    "radius": _weighted(lambda c, grid: _g(grid.s, c) - grid.radius),
    "mean_radius": lambda c, grid: jnp.sum(grid.weights * (_g(grid.s, c) - grid.radius), keepdims=True),
    "kl": _weighted(lambda c, grid: _root_deviance(_weight(grid.s, c))),
}
