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
_BATCH = 1024
# Lengths that are tried for each curve before Newton's method begins; they cost less than its steps.
_STARTS = 128


class Many(NamedTuple):
    """Fits of many curves, row by row, in float64.

    Attributes:
        parameters: in the model's order, shape (number, n).
        errors: standard errors, of the logarithms of lengths, areas and coefficients and of shares as they
            are, shape (number, n).
        correlation: of the same, shape (number, n, n).
        chi2: sum of squared residuals over the noise's variance, shape (number,).
        converged: shape (number,).
        is_share: which parameters are shares, shape (n,).
    """

    parameters: np.ndarray
    errors: np.ndarray
    correlation: np.ndarray
    chi2: np.ndarray
    converged: np.ndarray
    is_share: np.ndarray


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
    batches = -(-len(rows) // _BATCH)
    with jax.enable_x64(True):
        given = _in_batches(data.values.T, batches), _in_batches(roots, batches)
        found = _fit_each(setup, data.r, *given, chosen.candidates(*span), *bounds)
    found = (np.asarray(each).reshape(-1, *each.shape[2:])[: len(rows)] for each in found)
    return Many(*found, is_share=setup.is_share)


def _in_batches(rows: np.ndarray, batches: int) -> np.ndarray:
    """Rows in batches of one size, of shape (batches, size, m): the last row again fills the last batch."""
    size = -(-len(rows) // batches)
    filled = np.pad(rows, ((0, batches * size - len(rows)), (0, 0)), mode="edge")
    return filled.reshape(batches, size, -1)


@functools.partial(jax.jit, static_argnums=0)
def _fit_each(setup, r, values, roots, candidates, lower, upper):
    minimum = _along_the_length if setup.is_share.sum() == 1 == len(setup.is_share) - 1 else _everywhere

    def one(given):
        curve, root = given
        p, slopes, left, converged = minimum(setup, r, curve, root, candidates, lower, upper)
        # Columns of one length, whatever the units, lose the least to rounding.
        lengths = jnp.linalg.norm(slopes, axis=0)
        covariance = jnp.linalg.inv((slopes / lengths).T @ (slopes / lengths))
        errors = jnp.sqrt(jnp.diag(covariance))
        correlation = covariance / jnp.outer(errors, errors)
        return p, errors / lengths, correlation, jnp.sum(jnp.square(left)), converged

    return jax.lax.map(jax.vmap(one), (values, roots))


# Each of the two returns the parameters (n,), the weighted curve's derivatives in their logarithms and in
# shares (m, n), its weighted differences from the data (m,), and whether the search converged.


def _everywhere(setup, r, curve, root, candidates, lower, upper):
    """The minimum over all parameters."""
    problem = Curves(r, curve[:, None], root[:, None], jnp.ones(()), jnp.ones(()))
    first = _curve_problem.starts(setup, problem, candidates, 1)[0]
    share = jnp.max(jnp.where(setup.is_share, first, 0))
    problem = problem._replace(share=jnp.where(share > 0, share, 1.0))
    unit = jnp.where(setup.is_share, problem.share, 1.0)
    start = jnp.clip(first / unit, jnp.where(setup.is_share, 1e-3, lower + 1e-3), upper - 1e-3)
    residuals = _curve_problem.residual_function(setup)
    z, result = solve.levenberg_marquardt(residuals, problem, start, lower, upper)
    slopes = jax.jacfwd(residuals)(z, problem) / unit
    p = _curve_problem.physical(setup, z, problem.share)
    return p, slopes, residuals(z, problem), solve.succeeded(result)


def _along_the_length(setup, r, curve, root, candidates, lower, upper):
    """The minimum over the one length, whose share is always the best."""
    place, other = int(np.flatnonzero(~setup.is_share)[0]), int(np.flatnonzero(setup.is_share)[0])
    # What does not scatter is the same for all lengths; without it the curve is proportional to the share.
    unscattered = setup.response(setup.model, jnp.zeros(2).at[place].set(candidates[0, 0]), r)
    wanted = root * (curve - unscattered)

    def of_share_1(logarithm):
        p = jnp.ones(2).at[place].set(jnp.exp(logarithm))
        return setup.response(setup.model, p, r) - unscattered

    def fitted(logarithm):
        """The best share, the weighted curve of share 1, and the derivative of that."""
        column, change = jax.jvp(lambda x: root * of_share_1(x), (logarithm,), (jnp.ones(()),))
        return jnp.maximum(column @ wanted / (column @ column), 0), column, change

    def slope_of_cost(logarithm):
        share, column, change = fitted(logarithm)
        return share * change @ (share * column - wanted)

    first, last = jnp.log(candidates[0, 0]), jnp.log(candidates[-1, 0])
    grid = jnp.linspace(first, last, _STARTS)
    # The same curves for all data: their costs are products of matrices.
    curves = jax.vmap(of_share_1)(grid)
    explained = jnp.square(jnp.maximum(curves @ (root * wanted), 0)) / (jnp.square(curves) @ jnp.square(root))
    i = jnp.argmax(jnp.where(jnp.isfinite(explained), explained, -1))
    # The minimum lies between the neighbours of the best candidate, or beyond the ends.
    low = jnp.where(i == 0, lower[place], grid[i - 1])
    high = jnp.where(i == len(grid) - 1, upper[place], grid[jnp.minimum(i + 1, len(grid) - 1)])
    # A parabola through the three is nearer, and saves steps for which a whole batch would wait.
    left, middle, right = (explained[jnp.clip(i + step, 0, len(grid) - 1)] for step in (-1, 0, 1))
    vertex = (right - left) / (2 * (2 * middle - left - right)) * (grid[1] - grid[0])
    start = grid[i] + jnp.where(
        jnp.isfinite(vertex), jnp.clip(vertex, grid[0] - grid[1], grid[1] - grid[0]), 0
    )
    logarithm, converged = solve.rising_root(slope_of_cost, jnp.clip(start, low, high), low, high)
    share, column, change = fitted(logarithm)
    p = jnp.zeros(2).at[place].set(jnp.exp(logarithm)).at[other].set(share)
    slopes = jnp.zeros((len(r), 2)).at[:, place].set(share * change).at[:, other].set(column)
    return p, slopes, wanted - share * column, converged


def interval(found: Many, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Central intervals of the fitted parameters: factors of lengths, differences of shares.

    Args:
        found: from `fit`.
        level: their chance to hold the truth, in (0, 1).

    Returns:
        Lower and upper ends, each of shape (number, n), in the parameters' units; shares are cut at 0.

    Raises:
        ValueError: level is outside its domain.

    Example:
        >>> from sssfit.profiles import burley
        >>> r = np.geomspace(0.1, 20, 40)
        >>> many = fit(r, burley.profile(r, 1.0)[None], sigma=1e-3)
        >>> [end.round(3).tolist() for end in interval(many, 0.95)]
        [[[0.98, 0.978]], [[1.02, 1.022]]]
    """
    if not 0 < level < 1:
        raise ValueError(f"level must be between 0 and 1, got {level}")
    reach = intervals.half_width(level, math.inf) * found.errors
    with np.errstate(over="ignore"):
        factor = np.exp(reach)
    low = np.where(found.is_share, np.maximum(found.parameters - reach, 0), found.parameters / factor)
    return low, np.where(found.is_share, found.parameters + reach, found.parameters * factor)
