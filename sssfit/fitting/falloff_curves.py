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
    upper: float = 40.0
    num_points: int = 128
    spacing: Literal["gauss", "uniform"] = "gauss"

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Distances in units of phi and their weights, shape (num_points,) each.

        Raises:
            ValueError: the interval is empty or negative, there are fewer than 8 points, or the spacing
                is unknown.
        """
        if not 0 <= self.lower < self.upper < np.inf:
            raise ValueError(f"domain must have 0 <= lower < upper, got [{self.lower}, {self.upper}]")
        if self.num_points < 8:
            raise ValueError(f"num_points must be at least 8, got {self.num_points}")
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
    """What the residuals are computed from: phi, the nodes in units of phi, and their weights."""

    phi: Array
    rho: Array
    weights: Array


@functools.cache
def functions(objective: Objective, reading: Reading, normalize: bool) -> tuple[Callable, Residuals]:
    """The weighted curves (Burley's, the falloff profile's) that the objective compares, and their
    difference, as functions of the albedo and d / phi, and of the problem. Made once for each choice, which
    is what compiled code is kept by.
    """

    def target(r, phi):
        value = falloff_profile(r, phi - FALLOFF_OFFSET)
        return r * value if reading == "radial" else value

    def curves(parameters: Array, problem: Problem) -> tuple[Array, Array]:
        phi, rho, weights = problem
        r = rho * phi

        def model(r):  # r R(r): the radial density without its 2 pi
            return parameters[0] * burley.pdf(r, parameters[1] * phi) / (2 * jnp.pi)

        pair = [model, lambda r: target(r, phi)]
        if normalize:
            pair = [lambda r, f=f: f(r) / jnp.sum(weights * phi * f(rho * phi)) for f in pair]
        if objective == "derivative":
            pair = [lambda r, f=f: jax.jvp(f, (r,), (jnp.ones_like(r),))[1] for f in pair]
        fitted, wanted = pair[0](r), pair[1](r)
        if objective == "ratio":
            fitted, wanted = fitted / wanted, jnp.ones_like(wanted)
        root = jnp.sqrt(weights * phi)
        return root * fitted, root * wanted

    def residuals(parameters: Array, problem: Problem) -> Array:
        fitted, wanted = curves(parameters, problem)
        return fitted - wanted

    return curves, residuals


@partial(jax.jit, static_argnums=0)
def linearized(curves, found: Array, problem: Problem) -> tuple[Array, Array, Array]:
    """Residuals, their Jacobian in the parameters' logarithms, and the norm of the data."""

    def residuals(parameters):
        fitted, wanted = curves(parameters, problem)
        return fitted - wanted

    jacobian = jax.jacfwd(residuals)(found) * found
    return residuals(found), jacobian, jnp.linalg.norm(curves(found, problem)[1])


@partial(jax.jit, static_argnums=0)
def start(curves, problem: Problem, lower: Array, upper: Array) -> Array:
    """d = phi / 2 and the albedo that suits it best, which is a linear problem, kept inside its bounds."""
    d = jnp.asarray(0.5)
    fitted, wanted = curves(jnp.stack([jnp.ones_like(d), d]), problem)
    best = jnp.sum(fitted * wanted) / jnp.sum(fitted * fitted)
    span = jnp.minimum(upper - lower, 1)
    return jnp.stack([jnp.clip(best, lower + 1e-9 * span, upper - 0.05 * span), d])
