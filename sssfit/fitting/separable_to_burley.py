"""From the separable kernel's falloff colour to Burley's albedo and diffuse mean free path.

The separable blur of real-time engines is driven by the falloff profile P(r / phi), phi = falloff + 0.001.
The papers fit Burley's profile to it by least squares, both "with the r term already included", which can be
read twice:

- reading "as_coded": r R(r) is fitted to P(r / phi), the kernel as the demo uses it along a line;
- reading "radial": r R(r) is fitted to r P(r / phi), radial density against radial density.

On an unbounded domain, with unbounded albedo, r = phi rho turns both into one problem in rho, so d is
proportional to phi, and the albedo to phi ("as_coded") or to phi^2 ("radial"): no table is needed there. The
bound albedo <= 1 breaks the law for "as_coded" from phi = 0.686 on.

Source: Xie et al. 2020, appendix A.1, Eq 25-27; Xie 2021, appendix A.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.fitting import _falloff_curves, identifiability, solve
from sssfit.fitting._falloff_curves import DEFAULT_DOMAINS as DEFAULT_DOMAINS
from sssfit.fitting._falloff_curves import OBJECTIVES as OBJECTIVES
from sssfit.fitting._falloff_curves import READINGS as READINGS
from sssfit.fitting._falloff_curves import Domain as Domain
from sssfit.fitting._falloff_curves import Objective as Objective
from sssfit.fitting._falloff_curves import Reading as Reading
from sssfit.fitting.identifiability import Identifiability
from sssfit.fitting.solve import Solution, SolverChoice
from sssfit.profiles import burley
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET

#: Default falloff of the published demo and of engines, red, green, blue.
DEFAULT_FALLOFF = (1.0, 0.37, 0.3)

# Half a millionth of the albedo's range from a bound counts as on it.
_AT_BOUND = 5e-7

# Falloffs that `fit_many` fits at once.
_BATCH = 256

# Lower bound of d in units of phi: far narrower than any node, where the profile is a delta.
_SMALLEST_D = 1e-4
# Where `fit_many` stops looking: a profile that is flat on any domain of use.
_LARGEST_D = 1e4


@dataclass(frozen=True)
class SeparableFit:
    """Burley's parameters for one falloff.

    A parameter that the data do not determine is NaN, and `reason` says why.

    Attributes:
        falloff: the input.
        objective: what was minimized.
        reading: how the profiles were compared.
        albedo: fitted albedo.
        d: fitted shape parameter, mm.
        dmfp: diffuse mean free path, mm, d scaling(albedo); NaN unless both are determined and the
            albedo lies in [0, 1].
        albedo_interval: 95 % interval of the albedo, (low, high).
        d_interval: the same of d, mm.
        dmfp_interval: the same of dmfp, mm, by linear propagation.
        relative_residual: root of the objective over that of an all-zero model.
        at_bound: the albedo lies on its bound.
        identifiability: singular values and correlations behind the intervals.
        reason: why a parameter is NaN; empty when none is.
        converged: every solver that ran met its tolerance.
        status: the solvers' own words.
        solutions: one per solver.
        disagreement: largest relative spread of a parameter among the solvers.
    """

    falloff: float
    objective: Objective
    reading: Reading
    albedo: float
    d: float
    dmfp: float
    albedo_interval: tuple[float, float]
    d_interval: tuple[float, float]
    dmfp_interval: tuple[float, float]
    relative_residual: float
    at_bound: bool
    identifiability: Identifiability
    reason: str
    converged: bool
    status: str
    solutions: tuple[Solution, ...]
    disagreement: float


def fit(
    falloff: float,
    objective: Objective = "difference",
    *,
    reading: Reading = "radial",
    domain: Domain | None = None,
    weights: Sequence[float] | np.ndarray | None = None,
    albedo_bounds: tuple[float, float] = (0.0, 1.0),
    normalize: bool = False,
    solver: SolverChoice = "optimistix",
) -> SeparableFit:
    """Fit Burley's (albedo, d) to the falloff profile of one channel.

    Args:
        falloff: dimensionless width in (0, 1].
        objective: "difference" (squared difference), "ratio" (squared relative difference) or
            "derivative" (squared difference of the slopes in r).
        reading: "radial" or "as_coded", see the module's text.
        domain: where to compare; by default `DEFAULT_DOMAINS[objective]`.
        weights: extra weight of each node's squared residual, >= 0, shape (domain.num_points,).
        albedo_bounds: box of the albedo; (0, inf) frees it.
        normalize: compare shapes only, each profile over its own integral on the domain; the albedo
            then drops out and is refused.
        solver: "optimistix", "jaxopt", "scipy", or "all" to run the three and compare.

    Returns:
        A `SeparableFit`. Optima of smooth objectives are good to 1e-7 relative.

    Raises:
        ValueError: an argument is outside its domain; the message names it.

    Source: Xie et al. 2020, Eq 25 (difference), 26 (ratio), 27 (derivative).

    Example:
        >>> result = fit(0.37)
        >>> print(f"{result.albedo:.4f} {result.d:.4f} mm {result.dmfp:.4f} mm")
        0.1196 0.3317 mm 1.2260 mm
    """
    _check(falloff, objective, reading, albedo_bounds)
    nodes, node_weights = (domain or DEFAULT_DOMAINS[objective]).nodes()
    node_weights = node_weights * _extra(weights, nodes)
    phi = falloff + FALLOFF_OFFSET
    lower, upper = _bounds(albedo_bounds)
    residuals = _falloff_curves.residual_function(objective, normalize)
    with jax.enable_x64(True):
        problem = _falloff_curves.problem(
            jnp.asarray(phi), jnp.asarray(nodes), jnp.asarray(node_weights), objective, reading, normalize
        )
        if not 0 < np.linalg.norm(problem.wanted) < np.inf:
            raise ValueError("domain must reach where the falloff profile is above 0, below 30 or so")
        start = np.asarray(_falloff_curves.start(residuals, problem, lower[0], upper[0]))
        solutions = tuple(
            solve.least_squares(residuals, problem, start, lower, upper, name)
            for name in solve.chosen(solver)
        )
        found = solutions[0].parameters
        misfit, jacobian, norm = (
            np.asarray(a) for a in _falloff_curves.linearized(residuals, found, problem)
        )
    low, high = _on_bounds(found[0], albedo_bounds)
    # A parameter held by its bound is not estimated: the data determine the other one alone.
    free = jacobian[:, 1:] if low or high else jacobian
    analysis = identifiability.analyse(free, misfit, float(norm))
    estimates = _estimates(found * np.array([1.0, phi]), analysis, objective, albedo_bounds, low, high)
    known = np.isfinite([estimates["albedo"], estimates["d"]])
    return SeparableFit(
        falloff=falloff,
        objective=objective,
        reading=reading,
        **estimates,
        relative_residual=float(np.linalg.norm(misfit) / norm),
        at_bound=low or high,
        identifiability=analysis,
        converged=all(solution.converged for solution in solutions),
        status="; ".join(f"{s.solver}: {s.status}" for s in solutions),
        solutions=solutions,
        disagreement=_disagreement(solutions, known),
    )


def fit_many(
    falloffs: np.ndarray,
    objective: Objective = "difference",
    *,
    reading: Reading = "radial",
    domain: Domain | None = None,
    albedo_bounds: tuple[float, float] = (0.0, 1.0),
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Fit many falloffs at once, without the analysis of `fit`.

    For a given d the best albedo follows from a linear problem, which leaves one unknown: Newton's method
    in ln d, under `vmap`, finds where the misfit is least.

    Args:
        falloffs: widths in (0, 1], shape (n,).
        objective: as `fit`.
        reading: as `fit`.
        domain: as `fit`.
        albedo_bounds: as `fit`.

    Returns:
        albedo (n,), d (n,) in mm, dmfp (n,) in mm (NaN where the albedo is above 1), and whether
        each converged (n,), in float64.

    Raises:
        ValueError: as `fit`.

    Source: as `fit`.

    Example:
        >>> albedo, d, dmfp, converged = fit_many(np.array([0.3, 0.37, 1.0]))
        >>> d.round(4), bool(converged.all())
        (array([0.2691, 0.3317, 0.895 ]), True)
    """
    falloffs = np.asarray(falloffs, np.float64)
    if falloffs.ndim != 1 or falloffs.size == 0:
        raise ValueError(f"falloffs must be a list of at least one number, got shape {falloffs.shape}")
    for falloff in falloffs:
        _check(float(falloff), objective, reading, albedo_bounds)
    nodes, node_weights = (domain or DEFAULT_DOMAINS[objective]).nodes()
    # Batches of one size, the last one filled up: code is compiled once, whatever the number of falloffs.
    padded = np.resize(falloffs, -(-falloffs.size // _BATCH) * _BATCH).reshape(-1, _BATCH)
    with jax.enable_x64(True):
        batches = [
            _fit_batch(
                batch + FALLOFF_OFFSET, nodes, node_weights, *_bounds(albedo_bounds), objective, reading
            )
            for batch in padded
        ]
        albedo, d, converged = (
            np.concatenate(parts)[: falloffs.size] for parts in zip(*batches, strict=True)
        )
        dmfp = np.asarray(burley.dmfp_from_shape(d, albedo))
    return albedo, d, dmfp, converged


@partial(jax.jit, static_argnums=(5, 6))
def _fit_batch(phi, rho, weights, lower, upper, objective, reading):
    residuals = _falloff_curves.residual_function(objective, False)

    def one(phi):
        problem = _falloff_curves.problem(phi, rho, weights, objective, reading, False)

        def along(log_d):
            return _falloff_curves.profile_slope(residuals, problem, log_d, lower[0], upper[0])

        log_d, converged = solve.rising_root(
            lambda log_d: along(log_d)[1], jnp.log(0.5), jnp.log(lower[1]), jnp.log(_LARGEST_D)
        )
        return along(log_d)[0], jnp.exp(log_d) * phi, converged

    return jax.vmap(one)(phi)


def _bounds(albedo_bounds: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([albedo_bounds[0], _SMALLEST_D]), np.array([albedo_bounds[1], np.inf])


def _on_bounds(albedo: float, bounds: tuple[float, float]) -> tuple[bool, bool]:
    span = 1.0 if np.isinf(bounds[1]) else bounds[1] - bounds[0]
    return albedo - bounds[0] < _AT_BOUND * span, bounds[1] - albedo < _AT_BOUND * span


def _estimates(
    parameters: np.ndarray, analysis: Identifiability, objective, bounds, low: bool, high: bool
) -> dict:
    """Values and intervals of what the data determine, NaN and a reason for the rest."""
    albedo, d = (float(p) for p in parameters)
    if low and bounds[0] == 0:
        reason = f"the {objective} objective drives the albedo to its lower bound, where it does not fit"
        nothing = (np.nan, np.nan)
        return {"albedo": np.nan, "d": np.nan, "dmfp": np.nan, "reason": reason} | dict.fromkeys(
            ("albedo_interval", "d_interval", "dmfp_interval"), nothing
        )
    held = low or high
    known = np.concatenate([[True], analysis.determined]) if held else analysis.determined
    factor = np.concatenate([[1.0], analysis.factor]) if held else analysis.factor
    dmfp, dmfp_factor, reason = np.nan, np.nan, ""
    if not known.all():
        names = [name for name, ok in zip(("albedo", "d"), known, strict=True) if not ok]
        reason = f"the data do not determine the {' and the '.join(names)}, so the dmfp neither"
    elif albedo > 1:
        reason = f"the fitted albedo {albedo:.4g} is above 1, where no diffuse mean free path is defined"
    else:
        dmfp, dmfp_factor = _dmfp(albedo, d, analysis, held)
    return {
        "albedo": albedo if known[0] else np.nan,
        "d": d if known[1] else np.nan,
        "dmfp": dmfp,
        # Beyond its bounds an albedo was never considered.
        "albedo_interval": tuple(np.clip(_interval(albedo, factor[0], known[0]), *bounds).tolist()),
        "d_interval": _interval(d, factor[1], known[1]),
        "dmfp_interval": _interval(dmfp, dmfp_factor, True),
        "reason": reason,
    }


def _dmfp(albedo: float, d: float, analysis: Identifiability, fixed_albedo: bool) -> tuple[float, float]:
    """The diffuse mean free path, and the factor of its interval propagated from ln A and ln d."""
    with jax.enable_x64(True):
        scaling, slope = jax.value_and_grad(burley.scaling)(albedo)
        dmfp = float(burley.dmfp_from_shape(d, albedo))
        elasticity = albedo * float(slope) / float(scaling)
    if fixed_albedo:
        return dmfp, float(analysis.factor[0])
    direction = np.array([elasticity, 1.0])
    return dmfp, float(identifiability.interval_factor(direction @ analysis.covariance @ direction))


def _interval(value: float, factor: float, known: bool) -> tuple[float, float]:
    return (value / float(factor), value * float(factor)) if known else (np.nan, np.nan)


def _disagreement(solutions: Sequence[Solution], known: np.ndarray) -> float:
    """Largest relative spread among the solvers of a parameter that the data determine."""
    parameters = np.stack([solution.parameters for solution in solutions])[:, known]
    return float(np.max(np.ptp(parameters, axis=0) / parameters[0], initial=0.0))


def _extra(weights, nodes: np.ndarray) -> np.ndarray:
    extra = np.ones_like(nodes) if weights is None else np.asarray(weights, np.float64)
    if extra.shape != nodes.shape or not np.all((extra >= 0) & np.isfinite(extra)) or not np.any(extra > 0):
        raise ValueError(f"weights must be {nodes.size} numbers >= 0, not all 0, got shape {extra.shape}")
    return extra


def _check(falloff: float, objective: str, reading: str, albedo_bounds: tuple[float, float]) -> None:
    if not 0 < falloff <= 1:
        raise ValueError(f"falloff must be in (0, 1], got {falloff}")
    if objective not in OBJECTIVES:
        raise ValueError(f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}")
    if reading not in READINGS:
        raise ValueError(f"reading must be one of {', '.join(READINGS)}, got {reading!r}")
    if not 0 <= albedo_bounds[0] < albedo_bounds[1]:
        raise ValueError(f"albedo_bounds must be 0 <= low < high, got {albedo_bounds}")
