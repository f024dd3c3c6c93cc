"""The density that a posterior is drawn from: likelihood, prior box, and where walkers begin.

`y` are the fitted numbers: logarithms of lengths, areas and coefficients, and shares as they are.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.fitting import _curve_data, _curve_problem
from sssfit.fitting._curve_data import CurveData
from sssfit.fitting._curve_problem import Curves, Loss, Setup
from sssfit.fitting.measured import Fit
from sssfit.fitting.profile_model import Model, Parameter
from sssfit.fitting.profile_models import GaussianSum

# Walkers begin as far from the optimum as this share of the box at most, however little the data say.
_WIDEST_START = 0.1
_START_ROUNDS = 60


@dataclass(frozen=True)
class Density:
    """What compiled code depends on.

    Attributes:
        setup: the profile, the response, the loss and the places of parameters in `y`.
        is_noise_known: else its size, one for all points, is integrated out.
        ascending: places of `y` whose values must ascend: a sum's variances, whose order means nothing.
    """

    setup: Setup
    is_noise_known: bool
    ascending: tuple[int, ...]


class Part(NamedTuple):
    """Channels that are sampled together.

    Attributes:
        label: of the part, "" for a single one.
        names: of the fitted numbers, length n.
        density: what is compiled.
        curves: its data; differences are in standard deviations.
        box: the prior's ends in the parameters' own units, by name.
        lower, upper: the same in `y`, shape (n,).
        optimum: of the fit, in `y`, shape (n,).
        covariance: of the fit, in `y`, shape (n, n); inf where the data say nothing.
    """

    label: str
    names: tuple[str, ...]
    density: Density
    curves: Curves
    box: dict[str, tuple[float, float]]
    lower: np.ndarray
    upper: np.ndarray
    optimum: np.ndarray
    covariance: np.ndarray


Prior = Mapping[str, tuple[float, float]]


def boxes(
    setup: Setup, names: Sequence[str], prior: Prior, span: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """The prior's ends in the parameters' own units, each of shape (n,).

    What is named in full counts more than a parameter of all channels, and that more than a stem.
    """
    ends = []
    for name, parameter in zip(names, setup.free, strict=True):
        usual = (0.0, 1.0) if parameter.is_share else parameter.bounds(*span)
        keys = [key for key in (name, parameter.name, parameter.stem) if key in prior]
        ends.append(_checked_ends(keys[0], prior[keys[0]], parameter) if keys else usual)
    low, high = np.array(ends, float).T
    return low, high


def _checked_ends(key: str, ends: tuple[float, float], parameter: Parameter) -> tuple[float, float]:
    low, high = (float(end) for end in ends)
    if not low < high < np.inf or low < 0 or (low == 0 and not parameter.is_share):
        least = "0 or more" if parameter.is_share else "above 0"
        raise ValueError(
            f"prior of {key!r} must be (low, high) in {parameter.unit}, low {least} and below high, "
            f"got ({low:g}, {high:g})"
        )
    return low, high


def ascending(setup: Setup, shared: Sequence[str]) -> tuple[int, ...]:
    """The places of a sum's variances where its Gaussians can be exchanged for one another."""
    stems = {parameter.stem for parameter in setup.model.parameters}
    if not isinstance(setup.model, GaussianSum) or not set(shared) <= stems:
        return ()
    # Channels that share weights or variances exchange Gaussians all at once.
    return setup.layout[0][: setup.model.number]


def sorted_places(density: Density, y: np.ndarray) -> np.ndarray:
    """Places that bring the Gaussians of `y` into ascending order, shape (n,)."""
    places = np.arange(len(y))
    if density.ascending:
        order = np.argsort(y[list(density.ascending)], kind="stable")
        order = np.concatenate([order, len(order) + order])
        for row in density.setup.layout:
            places[list(row)] = np.array(row)[order]
    return places


def curves_of(data: CurveData, fit: Fit, roots: np.ndarray, columns: Sequence[int]) -> Curves:
    """The data of some channels with differences in standard deviations, as far as they are known.

    Without sigma these are those that the fit found: a robust loss bends by them, and for squares they are
    the inverse roots of the weights but for a factor, which does not matter.
    """
    columns = list(columns)
    used = roots[:, columns] > 0
    return Curves(
        r=jnp.asarray(data.r),
        values=jnp.asarray(data.values[:, columns]),
        root_weights=jnp.asarray(used / fit.sigma[:, columns]),
        noise=jnp.ones(()),
        share=jnp.ones(()),
    )


@functools.partial(jax.jit, static_argnums=0)
def log_densities(density: Density, y: Array, curves: Curves, lower: Array, upper: Array) -> Array:
    """`log_density` of many `y`, shape (k, n), at once, shape (k,)."""
    return jax.vmap(lambda y: log_density(density, y, curves, lower, upper))(y)


def log_density(density: Density, y: Array, curves: Curves, lower: Array, upper: Array) -> Array:
    """Logarithm of the posterior's density in `y`, shape (n,), but for a constant; -inf outside of the box.

    Half the sum of squared differences, bent by a robust loss. Where the noise's size is unknown, Jeffreys'
    prior, 1 / size, is integrated out: the squares' sum to the power of minus half the number of points.
    """
    inside = jnp.all((y >= lower) & (y <= upper))
    if density.ascending:
        inside = inside & jnp.all(jnp.diff(y[jnp.array(density.ascending)]) >= 0)
    differences = _curve_problem.differences(density.setup, jnp.clip(y, lower, upper), curves)
    squares = jnp.sum(jnp.square(_curve_problem.bent(density.setup.loss, differences, curves.noise)))
    if density.is_noise_known:
        value = -squares / 2
    else:
        points = jnp.sum(curves.root_weights > 0)
        value = -points / 2 * jnp.log(jnp.maximum(squares, jnp.finfo(squares.dtype).tiny))
    return jnp.where(inside & jnp.isfinite(squares), value, -jnp.inf)


@functools.partial(jax.jit, static_argnums=0)
def natural(setup: Setup, y: Array) -> tuple[Array, dict[str, Array]]:
    """Parameters in their own units (k, n), and what follows from them in each channel (k, channels)."""

    def each(y):
        p = _curve_problem.physical(setup, y, jnp.ones(()))
        rows = p[np.array(setup.layout)]
        found = jax.vmap(setup.model.derived)(rows)
        if setup.model.name == "burley":
            # What a flat slab lets through is what leaves beyond its thickness as a distance.
            found["transmittance_5mm"] = jax.vmap(lambda p: setup.model.beyond(p, 5.0))(rows)
        return p, found

    return jax.lax.map(each, y, batch_size=4096)


def in_units(part: Part, y: np.ndarray) -> dict[str, np.ndarray]:
    """All parameters in their own units by name, each of shape (steps, walkers), from `y` (.., .., n).

    What follows from them in a channel has its suffix if the channel has parameters of its own.
    """
    setup = part.density.setup
    p, derived = natural(setup, y.reshape(-1, y.shape[-1]))
    found = {name: np.asarray(p[:, i]) for i, name in enumerate(part.names)}
    for channel, row in enumerate(setup.layout):
        suffix = _curve_problem.suffix(setup, row, part.names)
        found |= {name + suffix: np.asarray(values[:, channel]) for name, values in derived.items()}
    return {name: values.reshape(y.shape[:-1]) for name, values in found.items()}


def batched(part: Part, walkers: int) -> Callable[[np.ndarray], np.ndarray]:
    """The log density of any number of points, by one compiled program for half of the walkers."""
    size = (walkers + 1) // 2
    curves, lower, upper = jax.device_put((part.curves, part.lower, part.upper))

    def densities(y: np.ndarray) -> np.ndarray:
        blocks = []
        for start in range(0, len(y), size):
            block = y[start : start + size]
            padded = np.concatenate([block, np.repeat(block[-1:], size - len(block), axis=0)])
            found = log_densities(part.density, padded, curves, lower, upper)
            blocks.append(np.asarray(found)[: len(block)])
        return np.concatenate(blocks)

    return densities


def starts(
    part: Part,
    walkers: int,
    random: np.random.RandomState,
    densities: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Different points of the box around the optimum with a density above 0, shape (walkers, n)."""
    width = part.upper - part.lower
    known = np.isfinite(np.diag(part.covariance)) & (np.diag(part.covariance) > 0)
    covariance = np.where(np.outer(known, known), part.covariance, 0.0)
    covariance[~known, ~known] = np.square(_WIDEST_START * width[~known])
    # Correlations are kept; what is less certain than the box is wide shrinks.
    shrunk = np.minimum(1.0, _WIDEST_START * width / np.sqrt(np.diag(covariance)))
    strengths, directions = np.linalg.eigh(covariance * np.outer(shrunk, shrunk))
    scale = np.sqrt(np.maximum(strengths, 0.0))
    centre = np.clip(part.optimum, part.lower, part.upper)
    y = np.full((walkers, len(centre)), np.nan)
    missing = np.ones(walkers, bool)
    for attempt in range(_START_ROUNDS):
        steps = (random.standard_normal(y.shape) * scale) @ directions.T
        drawn = _folded(centre + steps * 0.8**attempt, part.lower, part.upper)
        y[missing] = drawn[missing]
        missing = ~np.isfinite(densities(y))
        if not np.any(missing):
            return y
    raise ValueError("prior must hold points near the fit where the model is defined, but none were found")


def _folded(y: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Points beyond the walls, reflected into the box."""
    width = upper - lower
    phase = np.mod(y - lower, 2 * width)
    reflected = np.clip(lower + np.minimum(phase, 2 * width - phase), lower, upper)
    # Inside nothing is rounded: walkers may begin very near to each other.
    return np.where((y >= lower) & (y <= upper), y, reflected)


def parts(
    fit: Fit,
    data: CurveData,
    roots: np.ndarray,
    what: tuple[Model, Callable[[Model, Array, Array], Array], Loss],
    shared: tuple[str, ...],
    prior: Prior,
) -> list[Part]:
    """Channels that share nothing apart, or all together, as the fit has them.

    Raises:
        ValueError: the prior is no box of known parameters.
    """
    number = len(fit.channels)
    groups = [tuple(range(number))] if shared else [(i,) for i in range(number)]
    found, known = [], set()
    for columns in groups:
        layout, names = _curve_problem.laid_out(what[0], tuple(fit.channels[i] for i in columns), shared)
        setup = Setup(*what, layout)
        known |= {*names, *(key for p in setup.free for key in (p.name, p.stem))}
        used = np.any(roots[:, list(columns)] > 0, axis=1)
        low, high = boxes(setup, names, prior, _curve_data.span(data.r[used]))
        density = Density(setup, data.sigma is not None or setup.loss != "linear", ascending(setup, shared))
        optimum = _curve_problem.in_logarithms(
            setup, np.array([fit.parameters[name].value for name in names])
        )
        take = sorted_places(density, optimum)
        here = np.array([fit.names.index(name) for name in names])[take]
        found.append(
            Part(
                label="" if len(groups) == 1 else fit.channels[columns[0]],
                names=tuple(names),
                density=density,
                curves=curves_of(data, fit, roots, columns),
                box={n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)},
                lower=_curve_problem.in_logarithms(setup, low),
                upper=_curve_problem.in_logarithms(setup, high),
                optimum=optimum[take],
                covariance=fit.covariance[np.ix_(here, here)],
            )
        )
    unknown = sorted(set(prior) - known)
    if unknown:
        raise ValueError(f"prior must name some of {', '.join(sorted(known))}, got {unknown[0]!r}")
    return found
