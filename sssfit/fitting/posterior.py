"""Posteriors of a profile's parameters: what curves leave open, drawn by walkers.

`sample` takes the curves, the models and the noise of `measured.fit`. Unlike the fit's intervals it asks
neither for a straight model nor for many points, and it minds a prior.

Source: emcee, Foreman-Mackey et al., "emcee: The MCMC Hammer", 2013; Goodman and Weare, "Ensemble samplers
with affine invariance", 2010.
"""

import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, get_args

import jax
import numpy as np
from jax.typing import ArrayLike

from sssfit.files.atomic import interrupt_deferred
from sssfit.fitting import (
    _curve_data,
    _posterior_density,
    _posterior_file,
    _posterior_gather,
    measured,
    profile_models,
    responses,
)
from sssfit.fitting._curve_problem import Loss
from sssfit.fitting._posterior_density import Part, Prior
from sssfit.fitting._posterior_file import Chain, Keeper
from sssfit.fitting._posterior_result import Ensemble, Posterior
from sssfit.fitting._posterior_result import Move as Move
from sssfit.fitting._posterior_result import NotConverged as NotConverged
from sssfit.fitting._posterior_result import Summary as Summary
from sssfit.fitting._posterior_result import corner_figure as corner_figure
from sssfit.fitting.responses import Response

MOVES: tuple[Move, ...] = get_args(Move)
#: emcee's own choice, stretches of up to 2.
DEFAULT_MOVES: tuple[tuple[Move, float], ...] = (("stretch", 1.0),)

# The snooker move needs three other walkers.
_FEWEST_WALKERS = 8


def sample(
    r: ArrayLike,
    values: ArrayLike,
    *,
    model: str = "burley",
    sigma: ArrayLike | None = None,
    response: Response = "radial",
    beam_radius: float | None = None,
    weights: measured.Weighting | ArrayLike | None = None,
    loss: Loss = "linear",
    shared: Sequence[str] = (),
    channels: Sequence[str] | None = None,
    eta: float = 1.3,
    cutoff: float = math.inf,
    prior: Prior | None = None,
    walkers: int = 32,
    steps: int = 5000,
    moves: Sequence[tuple[Move, float]] | None = None,
    seed: int = 0,
    backend: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool = False,
) -> Posterior:
    """Draw a profile's parameters from their posterior, given curves.

    The likelihood is normal with `sigma`. Without it the noise's size is integrated out under Jeffreys'
    prior, which makes the likelihood Student's. A robust loss is minus the likelihood's logarithm, with the
    noise that the fit found if `sigma` is not given. Channels that share nothing are sampled apart, with the
    same walkers and steps. A sum's Gaussians are told apart by ascending variances.

    Args:
        r: distances, mm, as for `measured.fit`, shape (m,).
        values: radiant exitance, as there, shape (m,) or (m, channels).
        model: "burley", "gaussians:K", "dipole" or "jimenez".
        sigma: standard deviations of the values, > 0, a number or of the values' shape.
        response: "radial", "line", "edge" or "beam".
        beam_radius: of a beam, mm.
        weights: as there, without sigma; with it none but "sigma", as a likelihood has no others.
        loss: "linear", "huber", "soft_l1" or "cauchy".
        shared: names of parameters that all channels have in common.
        channels: names of the curves.
        eta: a dipole's refractive index.
        cutoff: where Burley's profile ends, in units of d.
        prior: (low, high) by a parameter's name, as in "d_r", "d" for all channels, or "variance" for all of
            a sum's: uniform in the logarithm of a length, an area (mm^2) or a coefficient (1/mm), low > 0,
            and uniform in a share (albedo, weight or strength), low >= 0. By default shares lie in [0, 1],
            and lengths between a thousandth of the shortest and a thousandfold of the longest distance, with
            areas and coefficients as these go.
        walkers: how many, at least 8 and twice the number of parameters that are sampled together.
        steps: of each walker, > 0; of a chain that is resumed, in all.
        moves: names and weights of proposals, out of "stretch", "de", "de_snooker", "walk" and "kde"; by
            default `DEFAULT_MOVES`.
        seed: of the random numbers, >= 0; the same seed draws the same chain.
        backend: an HDF5 file to keep the chain in, which emcee's `HDFBackend` reads, too.
        resume: go on with the chain in that file, if it is there, to the same chain that would have been
            drawn in one go.
        progress: show a bar on stderr.

    Returns:
        A `Posterior`, which refuses to sum up a chain that is too short.

    Raises:
        ValueError: an argument is outside its domain.
        FileError: the file cannot be written, is there though nothing is to be resumed, or holds the chain of
            other data or options.

    Example:
        >>> from sssfit.profiles import burley
        >>> r = np.geomspace(0.1, 20, 12)
        >>> truth = np.asarray(burley.profile(r, 1.5, 0.7))
        >>> posterior = sample(r, truth, sigma=0.05 * truth, steps=2000)
        >>> d = posterior.summary()["d"]
        >>> print(f"{d.mean:.2f} +- {d.standard_deviation:.2f} {d.unit}")
        1.50 +- 0.02 mm
    """
    ensemble = _checked(walkers, steps, DEFAULT_MOVES if moves is None else moves, seed)
    if sigma is not None and not (weights is None or (isinstance(weights, str) and weights == "sigma")):
        raise ValueError("weights must be left out where sigma is given: a likelihood has no others")
    _posterior_file.check(backend, resume)
    fit = measured.fit(
        r, values, model=model, sigma=sigma, response=response, beam_radius=beam_radius, weights=weights,
        loss=loss, shared=shared, channels=channels, eta=eta, cutoff=cutoff,
    )  # fmt: skip
    profile = profile_models.named(model, eta=eta, cutoff=cutoff)
    data = _curve_data.checked(r, values, sigma, profile, response)
    roots = _curve_data.root_weights(data, weights, response)
    what = (profile, responses.function(response, beam_radius), loss)
    with jax.enable_x64(True):
        parts = _posterior_density.parts(fit, data, roots, what, tuple(shared), prior or {})
        _check_walkers(parts, ensemble)
        options = {
            "model": repr(profile),
            "response": [response, beam_radius],
            "loss": loss,
            "parameters": {name: ends for part in parts for name, ends in part.box.items()},
            "walkers": ensemble.walkers,
            "moves": ensemble.moves,
            "seed": ensemble.seed,
            "data": _posterior_file.digest(data.r, data.values, roots, np.array(sigma is None)),
        }
        keeper = Keeper(backend, options, walkers, {part.label: len(part.names) for part in parts})
        _walk_all(parts, ensemble, keeper, progress)
        return _posterior_gather.gathered(fit, parts, keeper.chains, ensemble, _autocorrelation)


def _checked(walkers: int, steps: int, moves: Sequence[tuple[Move, float]], seed: int) -> Ensemble:
    for name, value, least in (("walkers", walkers, _FEWEST_WALKERS), ("steps", steps, 1), ("seed", seed, 0)):
        if value != int(value) or value < least:
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value}")
    for name, weight in moves:
        if name not in MOVES or not 0 < weight < math.inf:
            raise ValueError(f"moves must be (name, weight > 0) of {', '.join(MOVES)}, got {(name, weight)}")
    if not moves:
        raise ValueError("moves must name one at least")
    return Ensemble(walkers, steps, tuple((name, float(weight)) for name, weight in moves), seed)


def _check_walkers(parts: list[Part], ensemble: Ensemble) -> None:
    most = max(len(part.names) for part in parts)
    if ensemble.walkers < 2 * most:
        raise ValueError(
            f"walkers must be at least {2 * most}, twice the parameters that are sampled together, "
            f"got {ensemble.walkers}"
        )


def _walk_all(parts: list[Part], ensemble: Ensemble, keeper: Keeper, progress: bool) -> None:
    """Bring the chains of all parts to so many steps."""
    left = sum(max(ensemble.steps - chain.steps, 0) for chain in keeper.chains.values())
    if left == 0:
        return
    # Not only at the end: what cannot be written should be known before the work.
    keeper.save()
    try:
        with _bar(left, progress) as advance:
            for i, part in enumerate(parts):
                if keeper.chains[part.label].steps < ensemble.steps:
                    _walk(part, i, ensemble, keeper, advance)
    finally:
        keeper.save()


def _walk(part: Part, number: int, ensemble: Ensemble, keeper: Keeper, advance: Callable[[], None]) -> None:
    """Bring one part's chain to so many steps."""
    with interrupt_deferred():
        import emcee
    size = (ensemble.walkers, len(part.names))
    backend = emcee.backends.Backend()
    backend.reset(*size)
    chain = keeper.chains[part.label]
    densities = _posterior_density.batched(part, ensemble.walkers)
    if chain.steps:
        backend.chain, backend.log_prob = chain.y, chain.log_density
        backend.accepted, backend.iteration = chain.accepted.copy(), chain.steps
        backend.random_state = chain.random_state
        state = backend.get_last_sample()
    else:
        seeds = np.random.SeedSequence([ensemble.seed, number])
        random = np.random.RandomState(np.random.MT19937(seeds))
        y = _posterior_density.starts(part, ensemble.walkers, random, densities)
        state = emcee.State(y, random_state=random.get_state())
    moves = _emcee_moves(ensemble.moves)
    sampler = emcee.EnsembleSampler(*size, densities, vectorize=True, backend=backend, moves=moves)
    further = ensemble.steps - chain.steps
    walk = sampler.sample(state, iterations=further, skip_initial_state_check=True)
    try:
        while _went_on(walk):
            advance()
            if keeper.is_due():
                keeper.chains[part.label] = _chain_of(backend)
                keeper.save()
    finally:
        keeper.chains[part.label] = _chain_of(backend)


def _went_on(walk: Iterator[Any]) -> bool:
    """Make a step, all of it: one that Ctrl-C cuts short could not be gone on from."""
    with interrupt_deferred():
        return next(walk, None) is not None


def _emcee_moves(moves: Sequence[tuple[Move, float]]) -> list[tuple[Any, float]]:
    from emcee import moves as kinds

    made = {
        "stretch": kinds.StretchMove,
        "de": kinds.DEMove,
        "de_snooker": kinds.DESnookerMove,
        "walk": kinds.WalkMove,
        "kde": kinds.KDEMove,
    }
    return [(made[name](), weight) for name, weight in moves]


def _chain_of(backend) -> Chain:
    steps = backend.iteration
    state = backend.random_state if steps else None
    return Chain(backend.chain[:steps], backend.log_prob[:steps], backend.accepted.copy(), state)


@contextmanager
def _bar(steps: int, visible: bool) -> Iterator[Callable[[], None]]:
    """What tells of a step, on a bar on stderr if it is to be seen."""
    if not visible:
        yield lambda: None
        return
    with interrupt_deferred():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=sys.stderr)) as progress:
        task = progress.add_task("steps", total=steps)
        yield lambda: progress.advance(task)


def _autocorrelation(values: np.ndarray) -> float:
    """Integrated autocorrelation time in steps, at least 1, of values of shape (steps, walkers), or NaN."""
    from emcee import autocorr

    if not np.all(np.isfinite(values)) or np.any(np.ptp(values, axis=0) == 0):
        return math.nan
    # A tolerance of 0 leaves the judgement to `Posterior`.
    time = float(autocorr.integrated_time(values, tol=0)[0])
    return max(time, 1.0) if math.isfinite(time) else math.nan
