"""Thousands of measured curves at once, with standard errors, in one compiled program.

`measured.fit` says more of each; this is for studies and for images of which each pixel has a curve.
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from sssfit.fitting import _curve_data, _curve_problem, intervals, profile_models, responses, solve
from sssfit.fitting._curve_problem import Curves, Setup
from sssfit.fitting.responses import Response

# Curves that are fitted side by side; more need more memory and wait for the slowest.
_BATCH = 512


class Many(NamedTuple):
    """Fits of many curves, row by row, in float64.

    Attributes:
        parameters: in the model's order, shape (number, n).
        errors: standard errors, of the logarithms of lengths, areas and coefficients and of shares as they
            are, shape (number, n).
        correlation: of the same, shape (number, n, n).
        chi2: sum of squared residuals over the noise's variance, shape (number,).
        converged: shape (number,).
    """

    parameters: np.ndarray
    errors: np.ndarray
    correlation: np.ndarray
    chi2: np.ndarray
    converged: np.ndarray


def fit(
    r: ArrayLike,
    values: ArrayLike,
    *,
    sigma: ArrayLike,
    model: str = "burley",
    response: Response = "radial",
    beam_radius: float | None = None,
    eta: float = 1.3,
    cutoff: float = math.inf,
) -> Many:
    """Fit many curves at the same distances, each alone and weighted by its sigma.

    Args:
        r: distances, mm, as `measured.fit` takes them, shape (m,).
        values: a curve in each row, shape (number, m).
        sigma: standard deviations, a number or of the values' shape, > 0.
        model: as `measured.fit`.
        response: as `measured.fit`.
        beam_radius: as `measured.fit`.
        eta: as `measured.fit`.
        cutoff: as `measured.fit`.

    Returns:
        A `Many`. Burley's profile and Jimenez' are fitted by Newton's method in the one length that is left
        when the best share is known for each; of the others each curve follows the best candidate alone,
        where `measured.fit` follows four.

    Raises:
        ValueError: as `measured.fit`.

    Source: Golub and Pereyra 1973 for what is left when the best shares are known.

    Example:
        >>> from sssfit.profiles import burley
        >>> r, d = np.geomspace(0.1, 20, 40), np.array([[0.5], [1.0], [2.0]])
        >>> fit(r, burley.profile(r, d), sigma=1e-5).parameters[:, 1].round(4)
        array([0.5, 1. , 2. ])
    """
    chosen = profile_models.named(model, eta=eta, cutoff=cutoff)
    seen = responses.function(response, beam_radius)
    rows = np.asarray(values, np.float64)
    if rows.ndim != 2 or rows.size == 0:
        raise ValueError(f"values must be of shape (number, m), got {rows.shape}")
    try:
        sigma = np.broadcast_to(np.asarray(sigma, np.float64), rows.shape)
    except ValueError:
        raise ValueError(
            f"sigma must be a number or of the shape of values {rows.shape}, got {np.shape(sigma)}"
        ) from None
    data = _curve_data.checked(r, rows.T, sigma.T, chosen, response)
    if len(data.r) < len(chosen.parameters):
        needed = f"{len(chosen.parameters)} points for the parameters of {chosen.name}"
        raise ValueError(f"values must hold at least {needed}, got {len(data.r)}")
    setup = Setup(chosen, seen, "linear", (tuple(range(len(chosen.parameters))),))
    span = _curve_data.span(data.r)
    bounds = _curve_problem.bounds(setup, *span)
    roots = 1 / np.asarray(data.sigma).T
    with jax.enable_x64(True):
        found = _fit_each(setup, data.r, data.values.T, roots, chosen.candidates(*span), *bounds)
    return Many(*map(np.asarray, found))


@functools.partial(jax.jit, static_argnums=0)
def _fit_each(setup, r, values, roots, candidates, lower, upper):
    residuals = _curve_problem.residual_function(setup)
    minimum = _along_the_length if setup.is_share.sum() == 1 == len(setup.is_share) - 1 else _everywhere

    def one(given):
        curve, root = given
        problem = Curves(r, curve[:, None], root[:, None], jnp.ones(()), jnp.ones(()))
        problem, z, converged = minimum(setup, problem, candidates, lower, upper)
        slopes, left = jax.jacfwd(residuals)(z, problem), residuals(z, problem)
        covariance = jnp.linalg.inv(slopes.T @ slopes)
        errors = jnp.sqrt(jnp.diag(covariance))
        correlation = covariance / jnp.outer(errors, errors)
        errors = jnp.where(setup.is_share, errors * problem.share, errors)
        p = _curve_problem.physical(setup, z, problem.share)
        return p, errors, correlation, jnp.sum(jnp.square(left)), converged

    return jax.lax.map(one, (values, roots), batch_size=_BATCH)


def _everywhere(setup, problem, candidates, lower, upper):
    """The minimum over all parameters."""
    first = _curve_problem.starts(setup, problem, candidates, 1)[0]
    share = jnp.max(jnp.where(setup.is_share, first, 0))
    problem = problem._replace(share=jnp.where(share > 0, share, 1.0))
    start = jnp.where(setup.is_share, first / problem.share, first)
    start = jnp.clip(start, jnp.where(setup.is_share, 1e-3, lower + 1e-3), upper - 1e-3)
    residuals = _curve_problem.residual_function(setup)
    z, result = solve.levenberg_marquardt(residuals, problem, start, lower, upper)
    return problem, z, solve.succeeded(result)


def _along_the_length(setup, problem, candidates, lower, upper):
    """The minimum over the one length, whose share is always the best."""
    place, other = int(np.flatnonzero(~setup.is_share)[0]), int(np.flatnonzero(setup.is_share)[0])
    roots = problem.root_weights[:, 0]

    def curve(logarithm, share):
        p = jnp.zeros(2).at[place].set(jnp.exp(logarithm)).at[other].set(share)
        return roots * setup.response(setup.model, p, problem.r)

    def best(logarithm):
        without = curve(logarithm, 0.0)
        column, left = curve(logarithm, 1.0) - without, roots * problem.values[:, 0] - without
        share = jnp.maximum(column @ left / (column @ column), 0)
        return share, jnp.sum(jnp.square(left - share * column)) / 2

    grid = jnp.log(candidates[:, 0])
    costs = jax.vmap(lambda logarithm: best(logarithm)[1])(grid)
    i = jnp.argmin(costs)
    # The minimum lies between the neighbours of the best candidate, or beyond the ends.
    low = jnp.where(i == 0, lower[place], grid[i - 1])
    high = jnp.where(i == len(grid) - 1, upper[place], grid[jnp.minimum(i + 1, len(grid) - 1)])
    logarithm, converged = solve.rising_root(jax.grad(lambda x: best(x)[1]), grid[i], low, high)
    z = jnp.zeros(2).at[place].set(logarithm).at[other].set(best(logarithm)[0])
    return problem, z, converged


def interval(found: Many, level: float, model: str = "burley") -> tuple[np.ndarray, np.ndarray]:
    """Central intervals of the fitted parameters: factors of lengths, differences of shares.

    Args:
        found: from `fit`.
        level: their chance to hold the truth, in (0, 1).
        model: that was fitted.

    Returns:
        Lower and upper ends, each of shape (number, n), in the parameters' units; shares are cut at 0.

    Example:
        >>> many = Many(np.ones((1, 2)), np.full((1, 2), 0.1), np.eye(2)[None], np.ones(1), np.ones(1, bool))
        >>> [end.round(3).tolist() for end in interval(many, 0.95)]
        [[[0.804, 0.822]], [[1.196, 1.217]]]
    """
    width = intervals.half_width(level, math.inf)
    is_share = np.array([parameter.is_share for parameter in profile_models.named(model).parameters])
    with np.errstate(over="ignore"):
        factor = np.exp(width * found.errors)
    reach = width * found.errors
    low = np.where(is_share, np.maximum(found.parameters - reach, 0), found.parameters / factor)
    return low, np.where(is_share, found.parameters + reach, found.parameters * factor)
