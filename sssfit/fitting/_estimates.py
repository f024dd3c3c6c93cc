"""From solvers' answers to estimates: covariance, intervals and notes, for `y` of `_curve_problem`."""

import dataclasses
import functools
import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.fitting import _curve_problem, _derived, intervals, sensitivity, solve
from sssfit.fitting._curve_data import CurveData
from sssfit.fitting._curve_problem import Curves, Loss, Setup
from sssfit.fitting.intervals import Estimate
from sssfit.fitting.solve import Solution

# A logarithm, or a share over itself, that is less certain than this has intervals from the likelihood.
_BADLY_KNOWN = 0.2
_AT_BOUND = 1e-7
# What is left of a value below this share of it is rounding, and a solver's.
_ROUNDING = 1e-11


@dataclass(frozen=True)
class Found:
    """What is known of some channels that were fitted together.

    Attributes:
        names: of the fitted parameters.
        estimates: by name, derived ones after the fitted ones.
        derived: the names of those.
        covariance: of `y`, shape (n, n).
        fitted: the model at the data's distances, shape (m, channels).
        band: its standard error.
        influence: of each value on `y`, shape (n, m, channels).
        sigma: the noise's standard deviation, shape (m, channels).
        chi2: over the noise's variance; of estimated noise, the degrees of freedom.
        log_likelihood: but for a constant.
        count: of points.
        solutions: the solvers'.
        disagreement: among them.
        notes: sentences.
    """

    names: tuple[str, ...]
    estimates: dict[str, Estimate]
    derived: tuple[str, ...]
    covariance: np.ndarray
    fitted: np.ndarray
    band: np.ndarray
    influence: np.ndarray
    sigma: np.ndarray
    chi2: float
    log_likelihood: float
    count: int
    solutions: tuple[Solution, ...]
    disagreement: float
    notes: tuple[str, ...]


def found(
    setup: Setup,
    problem: Curves,
    solutions: tuple[Solution, ...],
    data: CurveData,
    columns: list[int],
    names: list[str],
    bounds: tuple[np.ndarray, np.ndarray],
) -> Found:
    """Everything about the first solver's answer."""
    z, is_known = solutions[0].parameters, data.sigma is not None
    unit = np.where(setup.is_share, float(problem.share), 1.0)
    y = z * unit
    p = _natural(y, setup.is_share)
    fitted, slopes = (np.asarray(a) for a in _curve_problem.linearized(setup, y, problem.r))
    used = np.asarray(problem.root_weights) > 0
    dof = int(used.sum()) - len(y)
    left = np.where(used, data.values[:, columns] - fitted, 0)
    # Of rounding the signs are no misfit.
    left[np.abs(left) < _ROUNDING * np.abs(fitted)] = 0
    sigma = data.sigma[:, columns] if data.sigma is not None else _noise(setup.loss, problem, left, dof)
    standardized = left / sigma
    held = (z - bounds[0] < _AT_BOUND) | (bounds[1] - z < _AT_BOUND)
    covariance = _covariance(setup.loss, problem, slopes, sigma, standardized, held)
    # Whether differences weigh as their noise says: chi2 then is what was minimized.
    weighed = (np.asarray(problem.root_weights) * sigma)[used]
    is_weighed = not is_known or np.ptp(weighed) < _ROUNDING * np.max(weighed)
    judged = standardized if is_weighed else _at_the_noises_optimum(slopes, sigma, used, standardized, held)
    factor, misfit = intervals.misfit(judged, dof, is_known and setup.loss == "linear")
    covariance = factor * covariance
    widths = tuple(intervals.half_width(level, math.inf if is_known else dof) for level in intervals.LEVELS)
    roots = used / sigma / math.sqrt(factor)
    likelihood = _Likelihood(setup, problem._replace(root_weights=roots, noise=np.ones(())), z, bounds)
    pulled = _pulled(setup, problem, slopes, p, held, bounds[1] - z < _AT_BOUND)
    estimates = {}
    for i, name in enumerate(names):
        number, along = (y[i], p[i], unit[i]), likelihood if is_weighed else None
        found = _estimate(setup, i, number, covariance, held, widths, along, bool(pulled[i]))
        estimates[name] = _opened(found, pulled[i])
    determined = [one.determined for one in estimates.values()]
    derived = _derived.derived(setup, names, y, covariance, widths, determined)
    in_logarithms = (slopes * np.where(setup.is_share, y, 1.0) * roots[..., None])[used]
    notes = [misfit] if misfit else []
    notes += [f"{names[i]} lies on its bound, {p[i]:.4g}" for i in np.flatnonzero(held)]
    notes += intervals.directions(in_logarithms, names, np.where(held, 0.0, p))
    return Found(
        names=tuple(names),
        estimates=estimates | derived,
        derived=tuple(derived),
        covariance=covariance,
        fitted=fitted,
        band=_band(slopes, covariance),
        influence=unit[:, None, None] * np.asarray(_influence(setup, problem, z, ~held)),
        sigma=np.broadcast_to(sigma, fitted.shape),
        chi2=float(np.sum(np.square(standardized))),
        log_likelihood=_log_likelihood(
            setup.loss, standardized[used], sigma[used], None if is_known else dof
        ),
        count=int(used.sum()),
        solutions=solutions,
        disagreement=_disagreement(setup, solutions, problem, [estimates[name] for name in names]),
        notes=tuple(notes),
    )


@functools.partial(jax.jit, static_argnums=0)
def _influence(setup, problem, z, free):
    residuals = _curve_problem.residual_function(setup)

    def fitted(values):
        return sensitivity.optimum(residuals, problem._replace(values=values), z, free)

    return jax.jacrev(fitted)(jnp.asarray(problem.values))


def _noise(loss: Loss, problem: Curves, left: np.ndarray, dof: int) -> np.ndarray:
    """The noise's standard deviation at each point, from the residuals."""
    roots = np.asarray(problem.root_weights)
    variance = np.sum(np.square(roots * left)) / dof if loss == "linear" else float(problem.noise) ** 2
    # Data without any noise are as good as rounding.
    floor = (1e-15 * np.max(np.abs(roots * np.asarray(problem.values)))) ** 2
    return math.sqrt(max(variance, floor)) / np.where(roots > 0, roots, 1.0)


def _covariance(loss, problem, slopes, sigma, standardized, held) -> np.ndarray:
    """The sandwich: noise of any size under weights of any kind; shape (n, n), inf where nothing is known."""
    roots = np.asarray(problem.root_weights)[..., None]
    free = ~held
    size = len(held)
    design = (roots * slopes).reshape(-1, size)[:, free]
    noise = (np.asarray(problem.root_weights) * sigma).ravel()
    covariance = np.zeros((size, size))
    covariance[np.ix_(free, free)] = intervals.covariance(design, noise)
    if loss != "linear":
        covariance *= _lost_to_bending(loss, standardized[roots[..., 0] > 0])
    covariance[np.diag_indices(size)] = np.where(held, np.inf, np.diag(covariance))
    return covariance


def _at_the_noises_optimum(slopes, sigma, used, standardized, held) -> np.ndarray:
    """What would be left where differences weigh as their noise says, for a model that is linear so far."""
    design = (slopes / sigma[..., None])[used][:, ~held]
    left = standardized.copy()
    left[used] -= design @ np.linalg.lstsq(design, standardized[used], rcond=None)[0]
    return left


def _pulled(setup, problem, slopes, p, held, at_upper) -> np.ndarray:
    """Which parameters go along when one goes on beyond its bound, and where: -1, 0 or 1, shape (n,).

    Bounds of lengths and coefficients are only where a search ends; that of shares is physics.
    """
    design = np.asarray(problem.root_weights)[..., None] * slopes * np.where(setup.is_share, p, 1.0)
    design = design.reshape(-1, len(p))
    pulled = np.zeros(len(p))
    for place in np.flatnonzero(held & ~setup.is_share):
        follow = np.linalg.lstsq(design[:, ~held], -design[:, place], rcond=None)[0]
        follow *= 1 if at_upper[place] else -1
        pulled[~held] = np.where(np.abs(follow) > _BADLY_KNOWN, np.sign(follow), pulled[~held])
    return pulled


def _lost_to_bending(loss: Loss, standardized: np.ndarray) -> float:
    """By how much a robust loss changes the variance of all parameters (Huber 1981, Eq 7.6.5)."""

    def bent(difference):
        return _curve_problem.bent(loss, difference, jnp.ones(())) ** 2 / 2

    influence, slope = jax.grad(bent), jax.grad(jax.grad(bent))
    change = jax.jit(
        lambda given: jnp.mean(jax.vmap(influence)(given) ** 2) / jnp.mean(jax.vmap(slope)(given)) ** 2
    )
    return float(change(standardized))


def _log_likelihood(loss: Loss, standardized: np.ndarray, sigma: np.ndarray, dof: int | None) -> float:
    """At its largest but for a constant; with the degrees of freedom, the noise was estimated, too."""
    # Of estimated noise the likelihood has its maximum where the squares count as many as there are points.
    likeliest = 1.0 if dof is None or loss != "linear" else math.sqrt(dof / len(sigma))
    losses = np.square(_curve_problem.bent(loss, jnp.asarray(standardized / likeliest), jnp.ones(())))
    return float(-np.sum(losses) / 2 - np.sum(np.log(sigma * likeliest)))


class _Likelihood:
    """Half of chi2 with one of the solved-for numbers held and the others fitted anew."""

    def __init__(self, setup: Setup, problem: Curves, z: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]):
        self.setup, self.problem, self.z, self.bounds = setup, problem, z, bounds

    def along(self, place: int, step: float, widths: tuple[float, ...]) -> tuple[tuple[float, float], ...]:
        """Intervals of the number at a place."""
        lower, upper = self.bounds
        others = np.arange(len(self.z)) != place
        room = 1e-6 * np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        start = np.clip(self.z, lower + room, upper - room)[others]

        def cost(value: float) -> float:
            return float(
                _cost_with(self.setup, place, self.problem, value, start, lower[others], upper[others])
            )

        return intervals.along_likelihood(cost, self.z[place], step, widths, lower[place], upper[place])


@functools.partial(jax.jit, static_argnums=(0, 1))
def _cost_with(setup, place, problem, value, start, lower, upper):
    whole = _curve_problem.residual_function(setup)

    def residuals(others, problem):
        return whole(jnp.insert(others, place, value), problem)

    if len(setup.free) == 1:
        return jnp.sum(jnp.square(residuals(start, problem))) / 2
    others, _ = solve.levenberg_marquardt(residuals, problem, start, lower, upper)
    return jnp.sum(jnp.square(residuals(others, problem))) / 2


def _estimate(setup, place, number, covariance, held, widths, likelihood, is_pulled) -> Estimate:
    """One fitted parameter."""
    y, p, unit = number
    parameter = setup.free[place]
    error = float(np.sqrt(covariance[place, place]))
    relative = error / p if parameter.is_share and p > 0 else error
    if likelihood is not None and (held[place] or is_pulled or relative > _BADLY_KNOWN):
        step = min(error, 1.0 if not parameter.is_share else max(p, unit)) / unit
        ends = likelihood.along(place, max(step, 1e-6), widths)
        pairs = [tuple(float(_natural(end * unit, parameter.is_share)) for end in pair) for pair in ends]
        bounds = _natural(np.array([b[place] for b in likelihood.bounds]) * unit, parameter.is_share)
        both = [_beyond_search(pair, bounds) for pair in pairs]
    else:
        both = intervals.around(p, error, not parameter.is_share, widths)
    standard_error = error if parameter.is_share else p * error
    closes = math.isfinite(both[-1][1]) and (both[-1][0] > 0 or parameter.is_share)
    determined = bool(not held[place] and relative < _derived.UNDETERMINED and closes)
    return Estimate(float(p), float(standard_error), both[0], both[1], parameter.unit, determined)


def _natural(y, is_share):
    with np.errstate(over="ignore"):
        return np.where(is_share, y, np.exp(np.where(is_share, 0.0, y)))


def _opened(estimate: Estimate, side: float) -> Estimate:
    """Intervals that do not end on a side, -1 or 1; as they are for 0."""
    if side == 0:
        return estimate
    both = (estimate.interval_68, estimate.interval_95)
    inner, outer = ((low, math.inf) if side > 0 else (0.0, high) for low, high in both)
    return dataclasses.replace(estimate, interval_68=inner, interval_95=outer, determined=False)


def _beyond_search(pair: tuple[float, ...], bounds: np.ndarray) -> tuple[float, float]:
    """An interval that ends at a bound of the search does not end: the data do not close it."""
    low, high = map(float, pair)
    return (
        0.0 if low <= bounds[0] * (1 + 1e-9) else low,
        math.inf if high >= bounds[1] * (1 - 1e-9) else high,
    )


def _band(slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    known = np.isfinite(np.diag(covariance))
    inner = covariance[np.ix_(known, known)]
    return np.sqrt(np.einsum("mci,ij,mcj->mc", slopes[..., known], inner, slopes[..., known]))


def _disagreement(setup, solutions, problem, estimates) -> float:
    """Largest relative spread among the solvers of a parameter that the data determine."""
    unit = np.where(setup.is_share, float(problem.share), 1.0)
    values = np.stack([_natural(solution.parameters * unit, setup.is_share) for solution in solutions])
    known = np.array([estimate.determined for estimate in estimates])
    return float(np.max(np.ptp(values[:, known], axis=0) / np.abs(values[0, known]), initial=0.0))
