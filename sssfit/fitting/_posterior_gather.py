"""From the walkers' chains to a posterior."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sssfit.fitting import _posterior_density
from sssfit.fitting._posterior_density import Part
from sssfit.fitting._posterior_file import Chain
from sssfit.fitting._posterior_result import Ensemble, Posterior
from sssfit.fitting.measured import Fit


def gathered(
    fit: Fit,
    parts: Sequence[Part],
    chains: Mapping[str, Chain],
    ensemble: Ensemble,
    autocorrelation: Callable[[np.ndarray], float],
) -> Posterior:
    """What the chains of all parts say together.

    Args:
        fit: of all channels.
        parts: of the problem.
        chains: by the parts' labels.
        ensemble: that walked them.
        autocorrelation: integrated autocorrelation time of values of shape (steps, walkers), NaN without one.
    """
    steps = min(chain.steps for chain in chains.values())
    pieces = [chains[part.label] for part in parts]
    values, optimum, times = {}, {}, {}
    derived: list[str] = []
    for part, piece in zip(parts, pieces, strict=True):
        y = piece.y[:steps]
        found = _posterior_density.in_units(part, y)
        best = _posterior_density.in_units(part, part.optimum[None, None])
        following = [name for name in found if name not in part.names]
        derived += following
        values |= found
        optimum |= {name: float(number[0, 0]) for name, number in best.items()}
        times |= {name: autocorrelation(found[name]) for name in following}
        for i, name in enumerate(part.names):
            time = autocorrelation(y[..., i])
            times[name] = math.inf if math.isnan(time) else time
    box = {name: ends for part in parts for name, ends in part.box.items()}
    names = tuple(name for part in parts for name in part.names)
    units = {p: fit.parameters[p].unit if p in fit.parameters else "1" for p in (*names, *derived)}
    return Posterior(
        model=fit.model,
        response=fit.response,
        channels=fit.channels,
        names=names,
        derived=tuple(derived),
        units=units,
        fit=fit,
        optimum=optimum,
        prior=box,
        moves=ensemble.moves,
        walkers=ensemble.walkers,
        steps=steps,
        seed=ensemble.seed,
        chain=np.concatenate([piece.y[:steps] for piece in pieces], axis=2),
        log_density=sum((piece.log_density[:steps] for piece in pieces), np.zeros((steps, ensemble.walkers))),
        values={name: values[name] for name in (*names, *derived)},
        acceptance_fraction=float(np.mean([np.mean(p.accepted) / p.steps for p in pieces])),
        autocorrelation={name: times[name] for name in (*names, *derived)},
        notes=fit.notes + _outside(optimum, box),
    )


def _outside(optimum: dict[str, float], box: dict[str, tuple[float, float]]) -> tuple[str, ...]:
    return tuple(
        f"the fitted {name}, {optimum[name]:.4g}, lies outside of the prior, {low:.4g} to {high:.4g}"
        for name, (low, high) in box.items()
        if not low <= optimum[name] <= high
    )
