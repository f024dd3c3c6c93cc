"""The least-squares problem behind a fit of measured curves: what is free, its residuals, and where to begin.

What a solver moves are `z`: logarithms of lengths, areas and coefficients, and shares in units of the
problem's own share, so that all of them are of one size whatever the data's units. `y` are the same with
shares as they are. Several channels form one problem, in which they may share parameters.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.fitting.profile_model import Model, Parameter

Loss = Literal["linear", "huber", "soft_l1", "cauchy"]
LOSSES: tuple[Loss, ...] = get_args(Loss)
# Where each begins to bend, in standard deviations of the noise: 95 % efficient for normal noise.
_BENDS: dict[Loss, float] = {"linear": 1.0, "huber": 1.345, "soft_l1": 1.345, "cauchy": 2.385}

# Multiplicative updates of the first shares, which stay positive.
_SHARE_UPDATES = 300


class Curves(NamedTuple):
    """The data, a pytree of arrays: NumPy's outside of compiled programs.

    Attributes:
        r: distances, mm, shape (m,).
        values: one curve in each column, shape (m, channels).
        root_weights: what each difference is multiplied by, shape (m, channels); 0 leaves a point out.
        noise: standard deviation of the weighted differences, which robust losses need, shape ().
        share: the unit of shares in `z`, shape ().
    """

    r: Any
    values: Any
    root_weights: Any
    noise: Any
    share: Any


@dataclass(frozen=True)
class Setup:
    """What is fitted, as far as compiled code depends on it.

    Attributes:
        model: the profile.
        response: what is seen of it, a function of the model, its parameters and distances.
        loss: of each weighted difference.
        layout: for each channel the places of the model's parameters in `z`.
    """

    model: Model
    response: Callable[[Model, Array, Array], Array]
    loss: Loss
    layout: tuple[tuple[int, ...], ...]

    @functools.cached_property
    def free(self) -> tuple[Parameter, ...]:
        """The parameter behind each place of `z`, without its channel."""
        both = [pair for row in self.layout for pair in zip(row, self.model.parameters, strict=True)]
        return tuple(dict(both)[place] for place in range(len(dict(both))))

    @functools.cached_property
    def is_share(self) -> np.ndarray:
        """Which places of `z` hold shares, shape (n,)."""
        return np.array([parameter.is_share for parameter in self.free])


def laid_out(
    model: Model, channels: tuple[str, ...], shared: tuple[str, ...]
) -> tuple[tuple[tuple[int, ...], ...], list[str]]:
    """The places of each channel's parameters in `z`, and the names of those places.

    A parameter is shared if its name, or its name without a number at its end, is in `shared`.
    """
    names: list[str] = []
    layout = []
    for channel in channels:
        row = []
        for parameter in model.parameters:
            is_shared = parameter.name in shared or parameter.stem in shared
            name = parameter.name if is_shared or not channel else f"{parameter.name}_{channel}"
            if name not in names:
                names.append(name)
            row.append(names.index(name))
        layout.append(tuple(row))
    return tuple(layout), names


def physical(setup: Setup, z: Array, share: Array) -> Array:
    """Parameters in their own units from `z`, shape (n,)."""
    return jnp.where(setup.is_share, z * share, jnp.exp(jnp.where(setup.is_share, 0.0, z)))


def solved_for(setup: Setup, p: Array, share: Array) -> Array:
    """The inverse of `physical`."""
    return jnp.where(setup.is_share, p / share, jnp.log(jnp.where(setup.is_share, 1.0, p)))


def in_logarithms(setup: Setup, p: np.ndarray) -> np.ndarray:
    """`y`: logarithms, and shares as they are, shape (..., n); the logarithm of 0 is -inf."""
    with np.errstate(divide="ignore"):
        return np.where(setup.is_share, p, np.log(np.where(setup.is_share, 1.0, p)))


def suffix(setup: Setup, row: tuple[int, ...], names: Sequence[str]) -> str:
    """What a channel's own parameters have after the model's names, with its places in `names`."""
    own = [names[place][len(part.name) :] for place, part in zip(row, setup.model.parameters, strict=True)]
    return max(own, key=len)


def curves(setup: Setup, p: Array, r: Array) -> Array:
    """The model's values at distances (m,) for all channels, shape (m, channels)."""
    each = [setup.response(setup.model, p[jnp.array(row)], r) for row in setup.layout]
    return jnp.stack(each, axis=1)


@functools.partial(jax.jit, static_argnums=0)
def linearized(setup: Setup, y: Array, r: Array) -> tuple[Array, Array]:
    """Values of all channels (m, channels), and their derivatives in `y` (m, channels, n)."""

    def of(y):
        return curves(setup, physical(setup, y, jnp.ones(())), r)

    return of(y), jax.jacfwd(of)(y)


@functools.cache
def residual_function(setup: Setup) -> Callable[[Array, Any], Array]:
    """Residuals of `z`, shape (m * channels,): half their squares' sum is what a fit minimizes."""

    def residuals(z, problem: Curves):
        return bent(setup.loss, differences(setup, z, problem), problem.noise).ravel()

    return residuals


def differences(setup: Setup, z: Array, problem: Curves) -> Array:
    """Weighted differences of data and model, shape (m, channels)."""
    modelled = curves(setup, physical(setup, z, problem.share), problem.r)
    # A point that is left out may lie where a model is infinite.
    used = problem.root_weights > 0
    return problem.root_weights * (problem.values - jnp.where(used, modelled, 0))


def bent(loss: Loss, difference: Array, noise: Array) -> Array:
    """Differences whose squares are the loss: large ones count less.

    Source: Huber 1964; Triggs et al. 2000, section 4.3. With z = (difference / (bend noise))^2 the loss is
    2 sqrt(z) - 1 from z = 1 on (huber), 2 (sqrt(1 + z) - 1) (soft_l1) or ln(1 + z) (cauchy).
    """
    if loss == "linear":
        return difference
    square = jnp.square(difference / (_BENDS[loss] * noise))
    if loss == "huber":
        beyond = square > 1
        large = jnp.where(beyond, square, 1.0)
        ratio = jnp.where(beyond, (2 * jnp.sqrt(large) - 1) / large, 1.0)
    elif loss == "soft_l1":
        ratio = 2 / (1 + jnp.sqrt(1 + square))
    else:
        small = square < 1e-8
        ratio = jnp.where(small, 1 - square / 2, jnp.log1p(square) / jnp.where(small, 1.0, square))
    return difference * jnp.sqrt(ratio)


@functools.partial(jax.jit, static_argnums=(0, 3))
def starts(setup: Setup, problem: Curves, candidates: np.ndarray, number: int) -> Array:
    """The best of the candidates with their best shares, best first, as `z` of shape (number, n)."""
    is_share = np.array([parameter.is_share for parameter in setup.model.parameters])

    def in_channel(values, root_weights):
        def scored(shapes):
            p = jnp.zeros(len(is_share)).at[np.flatnonzero(~is_share)].set(shapes)

            def weighted(p):
                curve = setup.response(setup.model, p, problem.r)
                return root_weights * jnp.where(root_weights > 0, curve, 0)

            wanted = root_weights * values
            shares = _shares(weighted, p, np.flatnonzero(is_share), wanted)
            p = p.at[np.flatnonzero(is_share)].set(shares)
            cost = jnp.sum(jnp.square(weighted(p) - wanted))
            return p, jnp.where(jnp.isfinite(cost), cost, jnp.inf)

        p, cost = jax.lax.map(scored, jnp.asarray(candidates), batch_size=64)
        return p[jnp.argsort(cost)[:number]]

    best = jax.vmap(in_channel, in_axes=1)(problem.values, problem.root_weights)
    # What channels share begins at the mean of their logarithms.
    z = jnp.zeros((number, len(setup.free)))
    times = np.bincount(np.array(setup.layout).ravel(), minlength=len(setup.free))
    for row, p in zip(setup.layout, best, strict=True):
        whole = jnp.ones((number, len(setup.free))).at[:, np.array(row)].set(p)
        used = np.isin(np.arange(len(setup.free)), row)
        z = z + jnp.where(used, jax.vmap(lambda p: solved_for(setup, p, problem.share))(whole), 0)
    return z / times


def _shares(weighted, p: Array, places: np.ndarray, wanted: Array) -> Array:
    """Shares above 0 that bring a profile nearest to what is wanted, shape (shares,)."""
    if len(places) == 0:
        return jnp.zeros(0)
    base = weighted(p)
    columns = jnp.stack([weighted(p.at[place].set(1.0)) - base for place in places], axis=1)
    left = wanted - base
    gram, projection = columns.T @ columns, jnp.maximum(columns.T @ left, 0)
    tiny = jnp.finfo(gram.dtype).tiny
    first = jnp.full(len(places), jnp.sum(projection) / jnp.maximum(jnp.sum(gram), tiny))
    if len(places) == 1:
        return first

    def update(_, shares):
        # Lee and Seung 2000: columns and data are positive, so each step lowers the cost.
        return shares * projection / jnp.maximum(gram @ shares, tiny)

    return jax.lax.fori_loop(0, _SHARE_UPDATES, update, first)


def bounds(setup: Setup, shortest: float, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of `z`, each of shape (n,)."""
    ends = np.array([parameter.bounds(shortest, longest) for parameter in setup.free])
    with np.errstate(divide="ignore"):
        logarithms = np.log(np.where(setup.is_share[:, None], 1.0, ends))
    lower, upper = np.where(setup.is_share[:, None], ends, logarithms).T
    return lower, upper
