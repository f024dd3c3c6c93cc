"""Parameters with intervals from measured, rendered or published curves.

`fit` takes one curve, or one per channel: a radial profile, or what a line, an edge or a beam of light shows
of it. It says what the data cannot tell, and where the model does not fit.

Source: the usual theory of nonlinear least squares, such as Seber and Wild, "Nonlinear Regression", 1989,
chapters 2 and 5.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jax.typing import ArrayLike

from sssfit.fitting import (
    _curve_data,
    _curve_problem,
    _estimates,
    intervals,
    profile_models,
    responses,
    solve,
)
from sssfit.fitting._curve_data import WEIGHTINGS as WEIGHTINGS
from sssfit.fitting._curve_data import Weighting as Weighting
from sssfit.fitting._curve_problem import LOSSES as LOSSES
from sssfit.fitting._curve_problem import Curves, Setup
from sssfit.fitting._curve_problem import Loss as Loss
from sssfit.fitting._estimates import Found
from sssfit.fitting.intervals import Estimate
from sssfit.fitting.responses import Response
from sssfit.fitting.solve import Solution, SolverChoice

# Starts that are followed to their minima; a sum of Gaussians has several.
_STARTS = 4
# How often the noise is estimated anew around a robust fit.
_NOISE_ROUNDS = 4
# From the median absolute deviation of normal noise to its standard deviation.
_FROM_MEDIAN = 1.482602218505602


@dataclass(frozen=True)
class Fit:
    """What curves say of a profile's parameters.

    Attributes:
        model: its name.
        response: what the curves show of it.
        channels: names of the curves, ("",) for a single one.
        parameters: by name, with what follows from them; suffix _r, _g, _b for a channel of three.
        derived: the names among them that follow from others.
        names: the fitted ones, in the order of `correlation` and `covariance`.
        correlation: of the fitted numbers (logarithms of lengths, shares), shape (n, n).
        covariance: of the same, shape (n, n); inf where the data say nothing.
        r: distances that were used, mm, shape (m,).
        values: the data there, shape (m, channels).
        fitted: the model there, of the same shape.
        band: standard error of `fitted`, of the same shape.
        influence: derivative of each fitted number (logarithms of lengths, shares) in each value, by implicit
            differentiation, shape (n, m, channels): what an error of a value does to all that follows.
        sigma: standard deviation of the data's noise, given or estimated, of the same shape.
        chi2: sum of squared residuals over the noise's variance; NaN if the noise was not given.
        dof: degrees of freedom.
        aicc: Akaike's criterion, corrected for few points; NaN if these are too few.
        converged: every solver that ran met its tolerance.
        status: the solvers' own words.
        solutions: one of each solver for each separate problem.
        disagreement: largest relative spread of a determined parameter among the solvers.
        notes: what else there is to say, a sentence each.
    """

    model: str
    response: Response
    channels: tuple[str, ...]
    parameters: dict[str, Estimate]
    derived: tuple[str, ...]
    names: tuple[str, ...]
    correlation: np.ndarray
    covariance: np.ndarray
    r: np.ndarray
    values: np.ndarray
    fitted: np.ndarray
    band: np.ndarray
    influence: np.ndarray
    sigma: np.ndarray
    chi2: float
    dof: int
    aicc: float
    converged: bool
    status: str
    solutions: tuple[tuple[Solution, ...], ...]
    disagreement: float
    notes: tuple[str, ...]

    @property
    def chi2_per_dof(self) -> float:
        """About 1 for a model that fits; NaN if the noise was not given or nothing is left over."""
        return self.chi2 / self.dof if self.dof > 0 else math.nan


def fit(
    r: ArrayLike,
    values: ArrayLike,
    *,
    model: str = "burley",
    sigma: ArrayLike | None = None,
    response: Response = "radial",
    beam_radius: float | None = None,
    weights: Weighting | ArrayLike | None = None,
    loss: Loss = "linear",
    shared: Sequence[str] = (),
    channels: Sequence[str] | None = None,
    eta: float = 1.3,
    cutoff: float = math.inf,
    solver: SolverChoice = "optimistix",
) -> Fit:
    """Fit a profile's parameters to curves, with intervals.

    Args:
        r: distances, mm, strictly ascending, shape (m,): from the point, the line or the beam's centre where
            light enters, >= 0; from an edge, above 0 in the shadow and below in the light. At r = 0 Burley's
            profile is infinite, and a point there is left out, which `notes` say.
        values: radiant exitance, shape (m,) or (m, channels): in 1/mm^2 for a pencil of unit power, in 1/mm
            for a line of unit power per mm, over the irradiance for an edge and a beam.
        model: "burley" (albedo, d), "gaussians:K" (variances, weights; K from 1 to 8), "dipole"
            (sigma_s_reduced, sigma_a) or "jimenez" (falloff, strength).
        sigma: standard deviations of the values, > 0, a number or of the values' shape. Without them the
            noise is estimated from the residuals, and the intervals are Student's.
        response: "radial", "line", "edge" or "beam".
        beam_radius: of a beam, mm.
        weights: of squared differences, of shape (m,) or (m, channels), or "sigma" (1 / sigma^2, the default
            where sigma is given), "area" (r dr, or dx for lines and edges; the default else) or "relative"
            (1 / values^2). Without sigma they are read as inverse variances but for one factor.
        loss: "linear", or "huber", "soft_l1" or "cauchy", which outliers pull less.
        shared: names of parameters that all channels have in common, such as "d", or "variance" for all of a
            sum's variances. Channels that share nothing are fitted apart.
        channels: names of the curves; by default none for one, r, g, b for three.
        eta: a dipole's refractive index, which is not fitted.
        cutoff: where Burley's profile ends, in units of d; Cycles' ends at 16.
        solver: "optimistix", "jaxopt", "scipy", or "all" to run the three and compare.

    Returns:
        A `Fit`. Where the model does not fit within the noise, the intervals are wider and `notes` say so;
        where the logarithm of a parameter is uncertain by more than .2, they are of the profile likelihood.

    Raises:
        ValueError: an argument is outside its domain, or there are fewer points than parameters.

    Example:
        >>> from sssfit.profiles import burley
        >>> r = np.geomspace(0.1, 20, 40)
        >>> found = fit(r, burley.profile(r, 1.5, 0.7), sigma=1e-5)
        >>> print(f"{found.parameters['d'].value:.4f} mm, albedo {found.parameters['albedo'].value:.4f}")
        1.5000 mm, albedo 0.7000
    """
    chosen = profile_models.named(model, eta=eta, cutoff=cutoff)
    seen = responses.function(response, beam_radius)
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    data = _curve_data.checked(r, values, sigma, chosen, response)
    roots = _curve_data.root_weights(data, weights, response)
    names = _curve_data.channel_names(data.values.shape[1], channels)
    if isinstance(shared, str):
        raise ValueError(f"shared must be a sequence of names, got {shared!r}")
    known = {name for parameter in chosen.parameters for name in (parameter.name, parameter.stem)}
    if not set(shared) <= known:
        raise ValueError(
            f"shared must be among {', '.join(sorted(known))}, got {sorted(set(shared) - known)[0]!r}"
        )
    columns = [list(range(len(names)))] if shared else [[i] for i in range(len(names))]
    with jax.enable_x64(True):
        parts = [
            _fit_together(chosen, seen, loss, data, roots, names, column, tuple(shared), solver)
            for column in columns
        ]
    return _merged(chosen.name, response, names, data, parts)


def _merged(model: str, response: Response, channels: tuple[str, ...], data, parts: list[Found]) -> Fit:
    """One result of channels that were fitted apart, or together."""
    covariance = _blocks([part.covariance for part in parts])
    free, count = len(covariance), sum(part.count for part in parts)
    is_known = data.sigma is not None
    # The noise, too, was fitted, once for each part.
    fitted = free if is_known else free + len(parts)
    deviance = -2 * sum(part.log_likelihood for part in parts)
    room = count - fitted - 1
    estimates = {name: estimate for part in parts for name, estimate in part.estimates.items()}
    return Fit(
        model=model,
        response=response,
        channels=channels,
        parameters=estimates,
        derived=tuple(name for part in parts for name in part.derived),
        names=tuple(name for part in parts for name in part.names),
        correlation=intervals.correlation(covariance),
        covariance=covariance,
        r=data.r,
        values=data.values,
        fitted=np.concatenate([part.fitted for part in parts], axis=1),
        band=np.concatenate([part.band for part in parts], axis=1),
        influence=_influences(parts),
        sigma=np.concatenate([part.sigma for part in parts], axis=1),
        chi2=sum(part.chi2 for part in parts) if is_known else math.nan,
        dof=count - free,
        aicc=deviance + 2 * fitted * (1 + (fitted + 1) / room) if room > 0 else math.nan,
        converged=all(solution.converged for part in parts for solution in part.solutions),
        status="; ".join(f"{s.solver}: {s.status}" for part in parts for s in part.solutions),
        solutions=tuple(part.solutions for part in parts),
        disagreement=max(part.disagreement for part in parts),
        notes=data.notes + tuple(note for part in parts for note in part.notes),
    )


def _influences(parts: list[Found]) -> np.ndarray:
    """Of all parts: none on each other, as they were fitted apart."""
    names, channels = (sum(part.influence.shape[axis] for part in parts) for axis in (0, 2))
    whole = np.zeros((names, parts[0].influence.shape[1], channels))
    row = column = 0
    for part in parts:
        rows, columns = part.influence.shape[0], part.influence.shape[2]
        whole[row : row + rows, :, column : column + columns] = part.influence
        row, column = row + rows, column + columns
    return whole


def _blocks(matrices: list[np.ndarray]) -> np.ndarray:
    """A matrix with these along its diagonal."""
    size, at = sum(map(len, matrices)), 0
    whole = np.zeros((size, size))
    for matrix in matrices:
        whole[at : at + len(matrix), at : at + len(matrix)] = matrix
        at += len(matrix)
    return whole


def _fit_together(model, seen, loss, data, roots, names, columns, shared, solver) -> Found:
    """Fit some channels as one problem."""
    layout, free = _curve_problem.laid_out(model, tuple(names[i] for i in columns), shared)
    setup = Setup(model, seen, loss, layout)
    roots = roots[:, columns]
    used, points = roots > 0, int(np.sum(roots > 0))
    if points < len(free) or (data.sigma is None and points == len(free)):
        needed = len(free) + (data.sigma is None)
        raise ValueError(
            f"values must hold at least {needed} points for the {len(free)} parameters of {model.name}"
            f"{' and the noise' if data.sigma is None else ''}, got {points}"
        )
    span = _curve_data.span(data.r[np.any(used, axis=1)])
    lower, upper = _curve_problem.bounds(setup, *span)
    problem, starts = _begun(setup, data, roots, columns, span, lower, upper)

    def minimized(problem, start, name) -> Solution:
        residuals = _curve_problem.residual_function(setup)
        return solve.least_squares(residuals, problem, start, lower, upper, name)

    ends = [minimized(problem, start, "optimistix") for start in starts]
    best = int(np.argmin([end.cost if np.isfinite(end.cost) else np.inf for end in ends]))
    start, end = starts[best], ends[best]
    if loss != "linear" and data.sigma is None:
        problem, end = _with_noise(setup, problem, start, end, minimized)
    names = solve.chosen(solver)
    solutions = tuple(end if name == "optimistix" else minimized(problem, start, name) for name in names)
    return _estimates.found(setup, problem, solutions, data, columns, free, (lower, upper))


def _begun(setup, data, roots, columns, span, lower, upper) -> tuple[Curves, list[np.ndarray]]:
    """The problem as solvers take it, and where they begin, strictly inside the bounds."""
    # With sigma and weights of another kind a residual's noise differs from point to point; the loss then
    # bends at their mean.
    noise = 1.0 if data.sigma is None else np.sqrt(np.mean(np.square(roots * data.sigma[:, columns])))
    problem = Curves(data.r, data.values[:, columns], roots, np.asarray(noise), np.ones(()))
    candidates = setup.model.candidates(*span)
    starts = np.asarray(_curve_problem.starts(setup, problem, candidates, min(_STARTS, len(candidates))))
    share = np.max(starts[0], where=setup.is_share, initial=0.0)
    if share > 0:
        problem = problem._replace(share=np.asarray(share))
        starts = np.where(setup.is_share, starts / share, starts)
    room = 1e-3 * np.where(np.isfinite(upper), upper - np.where(np.isfinite(lower), lower, 0), 1.0)
    return problem, list(np.clip(starts, lower + room, upper - room))


def _with_noise(setup, problem, start, end, minimized) -> tuple[Curves, Solution]:
    """The noise by the median of the differences, around a fit that bends where this noise says."""
    for _ in range(_NOISE_ROUNDS):
        left = np.abs(_curve_problem.differences(setup, end.parameters, problem))
        noise = _FROM_MEDIAN * float(np.median(left[problem.root_weights > 0]))
        problem = problem._replace(noise=np.asarray(max(noise, 1e-15)))
        end = minimized(problem, start, "optimistix")
    return problem, end
