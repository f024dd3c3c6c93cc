"""Which constants of a controller spend the fewest samples for what they deliver, over a set of scenarios.

Constants are drawn at random in their ranges, simulated in every scenario with common random numbers, and
those kept that no other beats in both mean samples and delivered error: the Pareto front. What is on it has
been chosen for being lucky as well as good, so its figures are measured again with seeds not used before.

The delivered error is the standard deviation that 95 % of the pixels and frames keep where the wanted
variance decides the oracle's count, in units of the wanted one. A mean over them would not tell a good
controller: see `measure.regret`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.estimators import policies
from sssfit.estimators.policies import Policy
from sssfit.scenarios import driver, measure
from sssfit.scenarios.driver import World
from sssfit.scenarios.measure import Target

#: Ranges to draw constants from: log-uniform where a bound is a ratio, else uniform.
RANGES: dict[str, tuple[float, float]] = {
    "alpha": (0.02, 0.6),
    "kappa": (0.0, 1.0),
    "min_spp": (2.0, 16.0),
    "max_spp": (32.0, 128.0),
    "target_variance": (0.25, 4.0),
}
_LOGARITHMIC = ("alpha", "target_variance")
#: Constants that belong to a controller.
CONSTANTS: dict[str, tuple[str, ...]] = {
    "as": tuple(RANGES),
    "ocv": tuple(RANGES),
    "ccv": tuple(RANGES),
    "in_frame": tuple(name for name in RANGES if name != "kappa"),
}
#: Candidates simulated at a time.
_CHUNK = 16


class Candidates(NamedTuple):
    """Constants of one controller, and what they give.

    Attributes:
        controller: its name.
        constants: arrays (candidates,) by name; the target variance in units of the wanted one.
        samples: mean count over the oracle's mean count at the wanted variance, mean over the scenarios.
        error: root of the delivered variance that 95 % keep, over the wanted one, mean over the scenarios.
        by_scenario: the two before for each scenario, (candidates, 2), by its name.
    """

    controller: str
    constants: dict[str, np.ndarray]
    samples: np.ndarray
    error: np.ndarray
    by_scenario: dict[str, np.ndarray]


def draw(controller: str, candidates: int, *, seed: int = 0) -> dict[str, np.ndarray]:
    """Random constants of a controller.

    Args:
        controller: one of `CONSTANTS`.
        candidates: how many, >= 1.
        seed: of the random numbers.

    Returns:
        Arrays (candidates,) by name, bounds of the count whole numbers.

    Raises:
        ValueError: the controller is unknown or candidates is below 1.

    Example:
        >>> sorted(draw("in_frame", 4))
        ['alpha', 'max_spp', 'min_spp', 'target_variance']
    """
    if controller not in CONSTANTS:
        raise ValueError(f"controller must be one of {', '.join(CONSTANTS)}, got {controller!r}")
    if candidates < 1:
        raise ValueError(f"candidates must be at least 1, got {candidates}")
    random, found = np.random.default_rng(seed), {}
    for name in CONSTANTS[controller]:
        low, high = RANGES[name]
        share = random.random(candidates)
        value = low * (high / low) ** share if name in _LOGARITHMIC else low + (high - low) * share
        found[name] = np.round(value) if name.endswith("_spp") else value
    return found


def evaluate(
    key: Array,
    worlds: Mapping[str, World],
    wanted: Target,
    controller: str,
    constants: Mapping[str, np.ndarray],
    *,
    seeds: int = 2,
    first: int = measure.STEADY,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Candidates:
    """Simulate candidates in every scenario.

    Args:
        key: of the random numbers, which all candidates have in common.
        worlds: the scenarios by name, of independent samples.
        wanted: the variance to deliver and the bounds of the oracle that samples are compared with.
        controller: one of `policies.NAMES`.
        constants: arrays (candidates,) by name, such as `draw` returns.
        seeds: of each scenario.
        first: the first frame that counts.
        progress: called with the simulations done and their total.

    Returns:
        `Candidates`.

    Example:
        >>> from sssfit.scenarios import circle
        >>> worlds, wanted = {"circle": circle.uniform(60)}, Target(0.0064)
        >>> found = evaluate(jax.random.key(0), worlds, wanted, "as", draw("as", 3))
        >>> found.samples.shape
        (3,)
    """
    number = len(next(iter(constants.values())))
    scaled = dict(constants) | {"target_variance": constants["target_variance"] * wanted.variance}
    most = int(np.max(scaled.get("max_spp", wanted.max_spp)))
    keys = jax.vmap(lambda seed: jax.random.fold_in(key, seed))(jnp.arange(seeds))
    by_scenario: dict[str, np.ndarray] = {}
    total = number * len(worlds)
    for place, (name, world) in enumerate(worlds.items()):
        ideal = measure.oracle_count(world.sample_variance[first:], wanted).mean()
        unclamped = measure.is_unclamped(world.sample_variance[first:], wanted)
        rows = []
        for at in range(0, number, _CHUNK):
            progress(place * number + at, total)
            part = [np.resize(values[at : at + _CHUNK], min(_CHUNK, number)) for values in scaled.values()]
            stacked = {key_: jnp.asarray(v, jnp.float32) for key_, v in zip(scaled, part, strict=True)}
            rows.append(np.asarray(_evaluate(keys, world, unclamped, controller, stacked, most, first)))
        spent, kept = np.concatenate(rows)[:number].astype(np.float64).T
        by_scenario[name] = np.stack([spent / ideal, np.sqrt(kept / wanted.variance)], axis=1)
    progress(total, total)
    mean = np.mean(list(by_scenario.values()), axis=0)
    return Candidates(controller, dict(constants), mean[:, 0], mean[:, 1], by_scenario)


@eqx.filter_jit
def _evaluate(
    keys,
    world: World,
    unclamped: np.ndarray,
    controller: str,
    constants: dict[str, Array],
    most: int,
    first: int,
) -> Array:
    """Mean count and kept variance of stacked constants, (candidates, 2)."""

    def one(chosen):
        policy: Policy = policies.named(controller, **chosen)

        def seed_counts(key):
            return driver.trajectory(key, world, policy, most=most).count[first:]

        counts = jax.vmap(seed_counts)(keys)
        delivered = jnp.where(unclamped, world.sample_variance[first:] / jnp.maximum(counts, 1), jnp.nan)
        return jnp.stack([counts.mean(), jnp.nanquantile(delivered, 0.95)])

    return jax.vmap(one)(constants)


def front(samples: Sequence[float] | np.ndarray, error: Sequence[float] | np.ndarray) -> np.ndarray:
    """Which candidates no other beats in both.

    Args:
        samples, error: what each costs, shape (candidates,), both the less the better.

    Returns:
        Indices in the order of rising samples.

    Source: textbook.

    Example:
        >>> front([1.0, 2.0, 3.0, 2.5], [3.0, 1.0, 1.0, 0.5]).tolist()
        [0, 1, 3]
    """
    samples, error = np.asarray(samples), np.asarray(error)
    order = np.lexsort((error, samples))
    best, kept = np.inf, []
    for index in order:
        if error[index] < best:
            best = error[index]
            kept.append(index)
    return np.array(kept, dtype=np.int64)


def samples_at(found: Candidates, error: float) -> float:
    """Samples of the front where it delivers an error.

    Args:
        found: candidates of one controller.
        error: as in `Candidates`.

    Returns:
        Interpolated linearly in the logarithms along the front; NaN outside it.

    Raises:
        ValueError: there is no candidate.

    Source: none; linear interpolation.

    Example:
        >>> made = Candidates("as", {}, np.array([1.0, 4.0]), np.array([2.0, 0.5]), {})
        >>> round(samples_at(made, 1.0), 6)
        2.0
    """
    kept = front(found.samples, found.error)
    if not len(kept):
        raise ValueError("found must hold at least one candidate, got none")
    x, y = np.log(found.error[kept])[::-1], np.log(found.samples[kept])[::-1]
    if not x[0] <= np.log(error) <= x[-1]:
        return float("nan")
    return float(np.exp(np.interp(np.log(error), x, y)))
