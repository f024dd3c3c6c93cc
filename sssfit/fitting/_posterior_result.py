"""What a posterior's walkers found, told only when they walked for long enough."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from sssfit.files.atomic import interrupt_deferred
from sssfit.fitting.measured import Fit
from sssfit.fitting.responses import Response

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Move = Literal["stretch", "de", "de_snooker", "walk", "kde"]

# Autocorrelation times that a chain must last, as emcee's authors advise, and that its start is left out for.
_ENOUGH = 50
_BURN_IN = 2
_LEVELS = (0.68, 0.95)


class Ensemble(NamedTuple):
    """How walkers walk.

    Attributes:
        walkers: how many.
        steps: of each.
        moves: names and weights of their proposals.
        seed: of the random numbers.
    """

    walkers: int
    steps: int
    moves: tuple[tuple[Move, float], ...]
    seed: int


class NotConverged(RuntimeError):
    """A chain is too short for what is asked of it.

    Example:
        >>> raise NotConverged("90 steps are too few")
        Traceback (most recent call last):
        ...
        sssfit.fitting._posterior_result.NotConverged: 90 steps are too few
    """


@dataclass(frozen=True)
class Summary:
    """One parameter of a posterior.

    Attributes:
        median: in its unit.
        mean: in its unit.
        standard_deviation: in its unit.
        interval_68: the central 68 % of the draws, low and high.
        interval_95: the central 95 %.
        monte_carlo_error: standard error of the mean that comes from drawing finitely often.
        effective_samples: independent draws that would have the same.
        unit: "mm", "mm^2", "1/mm" or "1".

    Example:
        >>> Summary(1.0, 1.0, 0.1, (0.9, 1.1), (0.8, 1.2), 0.001, 1e4, "mm").unit
        'mm'
    """

    median: float
    mean: float
    standard_deviation: float
    interval_68: tuple[float, float]
    interval_95: tuple[float, float]
    monte_carlo_error: float
    effective_samples: float
    unit: str


@dataclass(frozen=True)
class Posterior:
    """Draws of a profile's parameters, and of what follows from them.

    For Burley's profile that is the diffuse mean free path, and the transmittance of a slab of 5 mm. It is
    not the constant c of the approximate inverse cdf: radii scale with d, so that one c suits all d best.

    Attributes:
        model: its name.
        response: what the curves show of it.
        channels: names of the curves, ("",) for a single one.
        names: the fitted parameters.
        derived: what follows from them.
        units: of both, by name.
        fit: the fit that the walkers began at.
        optimum: its values, by name.
        prior: low and high of each fitted parameter.
        moves: names and weights of the walkers' proposals.
        walkers: how many.
        steps: of each.
        seed: of the random numbers.
        chain: fitted numbers at every step (logarithms of lengths, areas and coefficients, and shares), shape
            (steps, walkers, n).
        log_density: there, but for a constant, shape (steps, walkers).
        values: all parameters there in their own units, by name, each of shape (steps, walkers).
        acceptance_fraction: of proposals; best from 0.2 to 0.5.
        autocorrelation: integrated autocorrelation times by name, in steps: of the fitted numbers, of which
            one that never moved has inf, and of what follows, NaN where that is not defined everywhere.
        notes: what else there is to say, a sentence each; the fit's, too.
    """

    model: str
    response: Response
    channels: tuple[str, ...]
    names: tuple[str, ...]
    derived: tuple[str, ...]
    units: dict[str, str]
    fit: Fit
    optimum: dict[str, float]
    prior: dict[str, tuple[float, float]]
    moves: tuple[tuple[Move, float], ...]
    walkers: int
    steps: int
    seed: int
    chain: np.ndarray
    log_density: np.ndarray
    values: dict[str, np.ndarray]
    acceptance_fraction: float
    autocorrelation: dict[str, float]
    notes: tuple[str, ...]

    @property
    def converged(self) -> bool:
        """Whether the chain lasts more than 50 of its longest autocorrelation time."""
        return self.steps > _ENOUGH * self._longest

    @property
    def burn_in(self) -> int:
        """Steps left out at the start: two of the longest autocorrelation time.

        Raises:
            NotConverged: the chain is too short.
        """
        self._refuse_early()
        return math.ceil(_BURN_IN * self._longest)

    @property
    def thin(self) -> int:
        """Steps from one draw to the next: half of the shortest autocorrelation time, at least 1.

        Raises:
            NotConverged: the chain is too short.
        """
        self._refuse_early()
        return max(1, int(np.nanmin(list(self.autocorrelation.values())) / 2))

    @property
    def draws(self) -> dict[str, np.ndarray]:
        """Parameters in their own units, by name, without burn-in and thinned, each of shape (draws,).

        Raises:
            NotConverged: the chain is too short.
        """
        start, step = self.burn_in, self.thin
        return {name: values[start::step].ravel() for name, values in self.values.items()}

    @property
    def effective_samples(self) -> dict[str, float]:
        """Independent draws that would tell the mean as well, by name.

        Raises:
            NotConverged: the chain is too short.
        """
        # Of draws so far apart, with an autocorrelation that falls exponentially.
        count = self.draws[self.names[0]].size
        return {name: count * math.tanh(self.thin / time) for name, time in self.autocorrelation.items()}

    def summary(self) -> dict[str, Summary]:
        """Median, mean, standard deviation and central intervals of all parameters, by name.

        Raises:
            NotConverged: the chain is too short.
        """
        effective = self.effective_samples
        return {
            name: _summed_up(values, effective[name], self.units[name]) for name, values in self.draws.items()
        }

    @property
    def _longest(self) -> float:
        return float(np.nanmax(list(self.autocorrelation.values())))

    def _refuse_early(self) -> None:
        if self.converged:
            return
        longest = self._longest
        if math.isinf(longest):
            raise NotConverged(
                f"{self.steps} steps are too few: some walkers never moved; draw more, or use other moves or "
                "a narrower prior"
            )
        raise NotConverged(
            f"{self.steps} steps are too few: more than {_ENOUGH} autocorrelation times, {_ENOUGH} x "
            f"{longest:.3g} = {math.ceil(_ENOUGH * longest)} steps at least, are needed; draw more, or "
            "resume with more if the chain is in a file"
        )


def _summed_up(values: np.ndarray, effective: float, unit: str) -> Summary:
    tails = [(1 + sign * level) / 2 for level in _LEVELS for sign in (-1, 1)]
    median, *ends = (float(q) for q in np.quantile(values, [0.5, *tails]))
    spread = float(np.std(values, ddof=1))
    return Summary(
        median=median,
        mean=float(np.mean(values)),
        standard_deviation=spread,
        interval_68=(ends[0], ends[1]),
        interval_95=(ends[2], ends[3]),
        monte_carlo_error=spread / math.sqrt(effective),
        effective_samples=effective,
        unit=unit,
    )


def corner_figure(posterior: Posterior, names: Sequence[str] | None = None) -> "Figure":
    """Every parameter's histogram and every pair's, with the fitted optimum marked.

    Dashed lines are the median and the central 68 %.

    Args:
        posterior: see `sample`.
        names: which parameters; by default all that are defined.

    Returns:
        A matplotlib figure, for `savefig`.

    Raises:
        NotConverged: the chain is too short.
        ValueError: a name is unknown.

    Example:
        >>> from sssfit.fitting.posterior import sample
        >>> from sssfit.profiles import burley
        >>> r = np.geomspace(0.1, 20, 12)
        >>> truth = np.asarray(burley.profile(r, 1.5, 0.7))
        >>> figure = corner_figure(sample(r, truth, sigma=0.05 * truth, steps=2000), ["albedo", "d"])
        >>> len(figure.axes)
        4
    """
    draws = posterior.draws
    chosen = list(names) if names is not None else [n for n in draws if np.all(np.isfinite(draws[n]))]
    for name in chosen:
        if name not in draws:
            raise ValueError(f"names must be among {', '.join(draws)}, got {name!r}")
    with interrupt_deferred():
        import corner
        from matplotlib.figure import Figure
    size = 1.2 + 2.2 * len(chosen)
    units = {name: f" ({posterior.units[name]})" if posterior.units[name] != "1" else "" for name in chosen}
    figure = Figure(figsize=(size, size))
    corner.corner(
        np.stack([draws[name] for name in chosen], axis=1),
        fig=figure,
        labels=[f"{name}{units[name]}" for name in chosen],
        truths=[posterior.optimum[name] for name in chosen],
        quantiles=[(1 - _LEVELS[0]) / 2, 0.5, (1 + _LEVELS[0]) / 2],
        max_n_ticks=4,
    )
    return figure
