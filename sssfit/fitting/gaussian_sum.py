"""Sums of Gaussians fitted to a radial profile, by variable projection.

Given the variances, the weights that suit the data best follow from a linear problem, which is solved inside
the residuals; the logarithms of the variances are all that is left to search. Their landscape has local
minima in which Gaussians coincide, so the search begins at the best k of a ladder of widths: choosing is
linear, too, and exchanges one width after another until no exchange helps.

Source: Golub and Pereyra, "The Differentiation of Pseudo-Inverses and Nonlinear Least Squares Problems Whose
Variables Separate", 1973; d'Eon and Luebke, "Advanced Techniques for Realistic Real-Time Skin Rendering",
GPU Gems 3, 2007, for the sum and its measure of error.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.fitting import quadrature, solve
from sssfit.fitting.solve import Solution, SolverChoice

#: The most Gaussians that are fitted.
LARGEST_COUNT = 8
#: Solvers whose variances are nearer than this, relative, agree.
AGREEMENT = 1e-6

# Standard deviations that may be found, in units of the smallest and of the largest distance.
_NARROWEST, _WIDEST = 0.25, 10.0
# Rungs of the ladder from half the smallest distance to twice the largest.
_RUNGS = 64
# Nodes come in multiples of this, so that data of about one size share compiled code.
_MULTIPLE = 256
# Panels and order of the rule for a profile that is a function.
_PANELS, _ORDER = 16, 16
# The misfit at a start, relative, below which it is rounding.
_SMALLEST_MISFIT = 1e-10
# A variance this near its bound, in its logarithm, is on it.
_AT_BOUND = 1e-3


@dataclass(frozen=True)
class GaussianSumFit:
    """A sum of Gaussians, in the form that `sssfit.profiles.gaussian_sum.profile` takes.

    Attributes:
        variances: mm^2, ascending, float64, shape (k,).
        weights: the energy of each Gaussian, shape (k,). They are free: their sum is not the profile's
            energy, and some may be negative.
        relative_error: sqrt(int r (R - G)^2 dr / int r R^2 dr), or what the given weights make of it;
            dimensionless.
        converged: every solver that ran met its tolerance.
        status: the solvers' own words, which of them stopped elsewhere, and variances on their bounds.
        solutions: one per solver; their parameters are the logarithms of the variances, ascending.
        disagreement: largest relative spread of a variance among the solvers.
    """

    variances: np.ndarray
    weights: np.ndarray
    relative_error: float
    converged: bool
    status: str
    solutions: tuple[Solution, ...]
    disagreement: float


class _Problem(NamedTuple):
    """Nodes, filled up with zeros, and the profile there; all of one shape (m,).

    Attributes:
        r: distances, mm.
        root: root of the weights.
        wanted: the profile times the root, in the unit that makes the misfit at the start 1.
    """

    r: np.ndarray
    root: np.ndarray
    wanted: np.ndarray


def fit(
    r: Sequence[float] | np.ndarray,
    values: Sequence[float] | np.ndarray,
    k: int,
    *,
    weights: Sequence[float] | np.ndarray | None = None,
    solver: SolverChoice = "optimistix",
) -> GaussianSumFit:
    """Fit k Gaussians to a sampled profile.

    Args:
        r: distances, mm, >= 0, ascending, shape (m,).
        values: the profile there, 1/mm^2, finite and not all 0, shape (m,).
        k: number of Gaussians, 1 to 8.
        weights: of each squared difference, >= 0, shape (m,); by default r dr by the trapezoid rule, under
            which a point at r = 0 counts for nothing. At least 2 k points with r > 0 must have one above 0.
        solver: "optimistix", "jaxopt", "scipy", or "all" to run the three and compare.

    Returns:
        A `GaussianSumFit`, the best of the solvers that ran. Standard deviations are sought from a quarter
        of the smallest distance that counts to ten times the largest. A profile that is such a sum, of
        positive weights and variances a factor of 2 or more apart, is found again to 1e-6; with weights of
        either sign a lesser minimum may be, which `relative_error` shows.

    Raises:
        ValueError: an argument is outside its domain; the message names it.

    Source: see the module.

    Example:
        >>> r = np.linspace(0.0, 8.0, 200)
        >>> values = np.exp(-(r**2) / 2) / (2 * np.pi)
        >>> result = fit(r, values, 1)
        >>> result.variances.round(6), result.weights.round(6)
        (array([1.]), array([1.]))
    """
    r, values = np.asarray(r, np.float64), np.asarray(values, np.float64)
    _check(r, values, k)
    first, *others = solve.chosen(solver)
    root = np.sqrt(_weights(r, weights))
    counted = r[(root > 0) & (r > 0)]
    if counted.size < 2 * k:
        raise ValueError(f"r must have at least 2 k = {2 * k} points above 0 that count, got {counted.size}")
    norm = float(np.linalg.norm(root * values))
    if not 0 < norm < np.inf:
        raise ValueError(f"values must not be all 0 where they count, got a weighted norm of {norm}")
    fill = (0, -r.size % _MULTIPLE)
    problem = _Problem(*(np.pad(a, fill) for a in (r, root, root * values / norm)))
    # As logarithms of variances.
    box = 2 * np.log(_NARROWEST * counted[0]), 2 * np.log(_WIDEST * counted[-1])
    ladder = np.linspace(2 * np.log(counted[0] / 2), 2 * np.log(2 * counted[-1]), _RUNGS)
    lower, upper = np.full(k, box[0]), np.full(k, box[1])
    starts, misfit = _starts(problem, ladder, k)
    # Solvers' tolerances of the gradient are absolute.
    unit = max(misfit, _SMALLEST_MISFIT)
    problem = problem._replace(wanted=problem.wanted / unit)

    def run(start: np.ndarray, name: solve.SolverName) -> Solution:
        found = solve.least_squares(_residuals, problem, start, lower, upper, name)
        return replace(found, parameters=np.sort(found.parameters))

    attempts = [(run(start, first), start) for start in starts]
    found, start = min(attempts, key=lambda attempt: _ranked(attempt[0]))
    return _result(problem, unit * norm, (found, *(run(start, name) for name in others)), box)


def fit_profile(
    profile: Callable[[Array], Array],
    k: int,
    lower: float,
    upper: float,
    *,
    solver: SolverChoice = "optimistix",
) -> GaussianSumFit:
    """Fit k Gaussians to a profile that is a function, with the weight r dr from lower to upper.

    Args:
        profile: areal density in 1/mm^2 of distances in mm, shape (m,) to shape (m,), in float64.
        k: number of Gaussians, 1 to 8.
        lower: smallest distance, mm, > 0.
        upper: largest distance, mm, > lower.
        solver: as `fit`.

    Returns:
        As `fit`; the integrals are sums over 256 Gauss-Legendre nodes in ln r.

    Raises:
        ValueError: as `fit`, or the interval is empty.

    Source: see the module.

    Example:
        >>> from sssfit.profiles import dipole
        >>> result = fit_profile(lambda r: dipole.profile(r, 2.62, 0.0041, 1.5), 4, 1e-4, 400.0)
        >>> print(f"{100 * result.relative_error:.4f} %")
        1.2535 %
    """
    if not 0 < lower < upper < np.inf:
        raise ValueError(f"lower and upper must be 0 < lower < upper < inf, got {lower} and {upper}")
    edges = np.linspace(np.log(lower), np.log(upper), _PANELS + 1)
    log_r, d_log_r = quadrature.gauss_legendre(edges, _ORDER)
    r = np.exp(log_r)
    with jax.enable_x64(True):
        values = np.asarray(profile(jnp.asarray(r)))
    return fit(r, values, k, weights=d_log_r * r**2, solver=solver)


def _residuals(log_variances: Array, problem: _Problem) -> Array:
    """What of the profile lies outside of the span of the Gaussians: the misfit of the best weights."""
    wanted = jnp.asarray(problem.wanted)
    basis, _ = jnp.linalg.qr(_columns(jnp, jnp.exp(log_variances), problem))
    return wanted - basis @ (basis.T @ wanted)


def _columns(numpy: Any, variances: Any, problem: _Problem) -> Any:
    """Gaussians at the nodes times the root of the weights, each of height 1 at r = 0; shape (m, k)."""
    return problem.root[:, None] * numpy.exp(-0.5 * numpy.square(problem.r)[:, None] / variances)


def _starts(problem: _Problem, ladder: np.ndarray, k: int) -> tuple[list[np.ndarray], float]:
    """The best k rungs, as exchanges find them from even ones and from those that help most in turn.

    Returns:
        One start or two, and the least of their misfits.
    """
    columns = _columns(np, np.exp(ladder), problem)
    columns = columns / np.linalg.norm(columns, axis=0)
    # A rotation leaves all misfits as they are, and as many rows as there are columns.
    compact = np.linalg.qr(np.column_stack([columns, problem.wanted]))[1]
    columns, wanted = compact[:, :-1], compact[:, -1]
    even = np.linspace(0, _RUNGS - 1, k + 2)[1:-1].astype(int)
    helpful = np.zeros(0, int)
    for place in range(k):
        helpful, _ = _best_change(columns, wanted, np.append(helpful, -1), [place])
    found = dict(_exchanged(columns, wanted, rungs) for rungs in (even, helpful))
    return [ladder[list(rungs)] for rungs in sorted(found)], min(found.values()) ** 0.5


def _exchanged(columns: np.ndarray, wanted: np.ndarray, rungs: np.ndarray) -> tuple[tuple[int, ...], float]:
    """Exchange the rung whose exchange helps most, until none does; the rungs and their squared misfit."""
    least = np.inf
    while True:
        changed, misfit = _best_change(columns, wanted, rungs, range(rungs.size))
        if not misfit < least * (1 - 1e-9):
            return tuple(np.sort(rungs).tolist()), least
        rungs, least = changed, misfit


def _best_change(columns: np.ndarray, wanted: np.ndarray, rungs: np.ndarray, places: Sequence[int]):
    """Of all exchanges of one rung among these places the best, and its squared misfit."""
    free = np.setdiff1d(np.arange(columns.shape[1]), rungs)
    sets = np.tile(rungs, (len(places), free.size, 1))
    for row, place in enumerate(places):
        sets[row, :, place] = free
    sets = sets.reshape(-1, rungs.size)
    basis, _ = np.linalg.qr(np.moveaxis(columns[:, sets], 1, 0))
    misfit = np.sum(np.square(wanted - np.einsum("spk,sk->sp", basis, wanted @ basis)), axis=1)
    best = int(np.argmin(misfit))
    return sets[best], float(misfit[best])


def _result(problem: _Problem, scale: float, solutions: tuple[Solution, ...], box) -> GaussianSumFit:
    best = min(solutions, key=_ranked)
    variances = np.exp(best.parameters)
    columns = _columns(np, variances, problem)
    heights, *_ = np.linalg.lstsq(columns, scale * problem.wanted)
    notes = [
        f"{solution.solver}: {solution.status}{_stopped_elsewhere(solution, best)}" for solution in solutions
    ]
    at_bound = int(np.sum((best.parameters < box[0] + _AT_BOUND) | (best.parameters > box[1] - _AT_BOUND)))
    if at_bound:
        notes.append(f"{at_bound} of the variances at the end of the range that the distances allow")
    spread = np.ptp([solution.parameters for solution in solutions], axis=0)
    return GaussianSumFit(
        variances=variances,
        weights=2 * np.pi * variances * heights,
        relative_error=float(np.sqrt(2 * best.cost) / np.linalg.norm(problem.wanted)),
        converged=all(solution.converged for solution in solutions),
        status="; ".join(notes),
        solutions=solutions,
        disagreement=float(np.expm1(np.max(spread))),
    )


def _ranked(solution: Solution) -> float:
    return solution.cost if np.isfinite(solution.cost) else np.inf


def _stopped_elsewhere(solution: Solution, best: Solution) -> str:
    """Why a solver's variances are not the best one's: how far it stopped, and what that cost it."""
    away = float(np.expm1(np.max(np.abs(solution.parameters - best.parameters))))
    if away <= AGREEMENT:
        return ""
    excess = np.sqrt(solution.cost / best.cost) - 1 if best.cost > 0 else np.inf
    return f", {away:.0e} away in a variance, where the error is larger by {excess:.0e} of itself"


def _weights(r: np.ndarray, weights) -> np.ndarray:
    if weights is None:
        width = np.diff(r)
        return r * (np.append(width, 0) + np.append(0, width)) / 2
    weights = np.asarray(weights, np.float64)
    if weights.shape != r.shape or not np.all((weights >= 0) & (weights < np.inf)):
        raise ValueError(f"weights must be {r.size} finite numbers >= 0, got shape {weights.shape}")
    return weights


def _check(r: np.ndarray, values: np.ndarray, k: int) -> None:
    if k not in range(1, LARGEST_COUNT + 1):
        raise ValueError(f"k must be from 1 to {LARGEST_COUNT}, got {k}")
    if r.ndim != 1 or r.size < 2 * k:
        raise ValueError(f"r must be a list of at least 2 k = {2 * k} distances, got shape {r.shape}")
    if not (r[0] >= 0 and np.all(np.diff(r) > 0) and r[-1] < np.inf):
        least = np.min(np.diff(r))
        raise ValueError(f"r must be >= 0 and ascending, got {r[0]} to {r[-1]} in steps from {least}")
    if values.shape != r.shape or not np.all(np.isfinite(values)):
        raise ValueError(f"values must be {r.size} finite numbers, got shape {values.shape}")
