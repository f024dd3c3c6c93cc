"""The two curves that the separable-to-Burley fit compares, and where it compares them."""

import functools
from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.fitting import quadrature
from sssfit.fitting.solve import Residuals
from sssfit.profiles import burley
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET, falloff_profile

Objective = Literal["difference", "ratio", "derivative"]
Reading = Literal["as_coded", "radial"]
OBJECTIVES: tuple[Objective, ...] = get_args(Objective)
READINGS: tuple[Reading, ...] = get_args(Reading)


class Domain(NamedTuple):
    """Where the two profiles are compared: distances in units of phi, and how they are summed.

    Attributes:
        lower: smallest distance / phi, >= 0.
        upper: largest distance / phi.
        num_points: nodes.
        spacing: "gauss", the integral over distance (Gauss-Legendre nodes, dense near lower), or
            "uniform", a plain sum over equidistant points, as the papers print it.

    Example:
        >>> Domain(0.0, 10.0, 100, "uniform").nodes()[0][:3].round(2)
        array([0.05, 0.15, 0.25])
    """

    lower: float = 0.0
    upper: float = 30.0
    num_points: int = 64
    spacing: Literal["gauss", "uniform"] = "gauss"

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances in units of phi and their weights, shape (num_points,) each.

        Raises:
            ValueError: the interval is empty or negative, num_points is not from 8 to 65536, or the spacing
                is unknown.
        """
        if not 0 <= self.lower < self.upper < np.inf:
            raise ValueError(f"domain must have 0 <= lower < upper, got [{self.lower}, {self.upper}]")
        if not 8 <= self.num_points <= 65536:
            raise ValueError(f"num_points must be from 8 to 65536, got {self.num_points}")
        width = self.upper - self.lower
        if self.spacing == "gauss":
            unit, weights = quadrature.gauss_legendre(np.array([0.0, 1.0]), self.num_points)
            # The cube packs nodes at the lower end, where the profiles are steep.
            return self.lower + width * unit**3, width * 3 * unit**2 * weights
        if self.spacing == "uniform":
            cell = width / self.num_points
            return self.lower + cell * (np.arange(self.num_points) + 0.5), np.full(self.num_points, cell)
        raise ValueError(f"spacing must be 'gauss' or 'uniform', got {self.spacing!r}")


#: Domains used when none is given. The ratio has no optimum on an unbounded domain (Gaussian tails
#: against exponential ones), nor, in the radial reading, down to 0; its result depends on this choice.
DEFAULT_DOMAINS: dict[Objective, Domain] = {
    "difference": Domain(),
    "ratio": Domain(0.1, 6.0),
    "derivative": Domain(),
}


class Problem(NamedTuple):
    """What the residuals of one falloff are computed from, all of shape (num_points,) but phi.

    Attributes:
        phi: unit of d, mm.
        r: nodes, mm.
        quadrature: weights of the integral over r, mm.
        scale: weight of Burley's curve in the residual.
        wanted: the falloff profile's curve, with its weight.
    """

    phi: Array
    r: Array
    quadrature: Array
    scale: Array
    wanted: Array


def problem(
    phi: Array, rho: Array, weights: Array, objective: Objective, reading: Reading, normalize: bool
) -> Problem:
    """The data of one fit: everything that does not depend on the parameters, computed once.

    Args:
        phi: falloff + 0.001, shape ().
        rho: nodes in units of phi, shape (num_points,).
        weights: of the nodes, shape (num_points,).
        objective: what is compared.
        reading: whether the falloff profile is multiplied by r.
        normalize: whether each curve is divided by its integral.

    Example:
        >>> nodes = jnp.array([1.0, 2.0])
        >>> problem(jnp.asarray(0.5), nodes, nodes, "ratio", "radial", False).r
        Array([0.5, 1. ], dtype=float32)
    """
    r, quadrature = rho * phi, weights * phi
    root = jnp.sqrt(quadrature)

    def target(r):
        value = falloff_profile(r, phi - FALLOFF_OFFSET)
        return r * value if reading == "radial" else value

    wanted = _compared(target, r, quadrature, objective, normalize)
    if objective == "ratio":
        return Problem(phi, r, quadrature, root / wanted, root)
    return Problem(phi, r, quadrature, root, root * wanted)


def _compared(curve: Callable[[Array], Array], r: Array, quadrature: Array, objective, normalize) -> Array:
    """The values of a curve that an objective compares: its own, or its slopes."""
    values = curve(r)
    norm = jnp.sum(quadrature * values) if normalize else 1
    if objective == "derivative":
        values = jax.jvp(curve, (r,), (jnp.ones_like(r),))[1]
    return values / norm


@functools.cache
def residual_function(objective: Objective, normalize: bool) -> Residuals:
    """Residuals as a function of (albedo, d / phi) and the problem; made once for each choice, which is
    what compiled code is kept by.
    """

    def residuals(parameters: Array, problem: Problem) -> Array:
        def model(r):  # r R(r): the radial density without its 2 pi
            return parameters[0] * burley.pdf(r, parameters[1] * problem.phi) / (2 * jnp.pi)

        fitted = _compared(model, problem.r, problem.quadrature, objective, normalize)
        return problem.scale * fitted - problem.wanted

    return residuals


@partial(jax.jit, static_argnums=0)
def linearized(residuals: Residuals, found: Array, problem: Problem) -> tuple[Array, Array, Array]:
    """Residuals, their Jacobian in the parameters' logarithms, and the norm of the data."""
    jacobian = jax.jacfwd(residuals)(found, problem) * found
    return residuals(found, problem), jacobian, jnp.linalg.norm(problem.wanted)


@partial(jax.jit, static_argnums=0)
def start(residuals: Residuals, problem: Problem, lower: Array, upper: Array) -> Array:
    """d = phi / 2 and the albedo that suits it best, kept inside its bounds."""
    d = jnp.asarray(0.5)
    best = _best_albedo(_per_albedo(residuals, problem, d), problem)
    span = jnp.minimum(upper - lower, 1)
    return jnp.stack([jnp.clip(best, lower + 1e-9 * span, upper - 0.05 * span), d])


def profile_slope(
    residuals: Residuals, problem: Problem, log_d: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """The least misfit over all albedos in [lower, upper], as a function of ln(d / phi) alone.

    Returns:
        The albedo that suits log_d best, and the derivative of half the squared misfit in log_d there, to
        which the albedo's own change contributes nothing: it is the best one, or held by a bound.
    """

    def per_albedo(log_d: Array) -> Array:
        return _per_albedo(residuals, problem, jnp.exp(log_d))

    fitted, change = jax.jvp(per_albedo, (log_d,), (jnp.ones_like(log_d),))
    albedo = jnp.clip(_best_albedo(fitted, problem), lower, upper)
    return albedo, jnp.sum((albedo * fitted - problem.wanted) * albedo * change)


def _per_albedo(residuals: Residuals, problem: Problem, d: Array) -> Array:
    """Burley's curve for an albedo of 1; it is proportional to the albedo."""
    return residuals(jnp.stack([jnp.ones_like(d), d]), problem) + problem.wanted


def _best_albedo(fitted: Array, problem: Problem) -> Array:
    return jnp.sum(fitted * problem.wanted) / jnp.sum(fitted * fitted)
