"""Two functions sampled together under one light: which coefficient and which residual to take.

f(y, t) = h(t) / (1 + y) and g(y, t) = h(t) (1 - y) on [0, 1], 16 samples a frame of both at the same points,
h = 1 or h = 1 + 3 sin(t / 10). No control, four ways to remove g from f, and the best constant one are
judged by the root of the residual's moving variance: static light should leave it as high as without a
control, since samples are counted by it, and moving light should not raise it.

The dissertation leaves the start open. Taken here, as it reproduces the table: moments begin with the first
frame, residuals with the first frame that a coefficient exists for, and neither epsilon nor bounds are used.

Source: Xie, dissertation, 2021, appendix B.3 and Table B.1.
"""

import functools
import math
from collections.abc import Callable
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.estimators import control_variate, moving
from sssfit.files.atomic import interrupt_deferred

Light = Literal["static", "dynamic"]
LIGHTS: tuple[Light, ...] = get_args(Light)
#: The residuals in the table's order.
NAMES = ("Res_f", "SF", "SF+EMA", "EMCM", "EMCM_hat", "GT")
#: Frames, samples a frame, and the index of the first frame that counts, the 25th.
FRAMES, SPP, FIRST = 100, 16, 24
#: Weights of the newest frame: in the coefficient, and in the residual's variance.
COEFFICIENT_ALPHA, RESIDUAL_ALPHA = 0.05, 0.2
# The largest number of samples drawn at a time: a second's work.
_CHUNK_SAMPLES = 1_600_000


class Moments(NamedTuple):
    """Exact moments of one sample of f and g for h = 1.

    Attributes:
        value_mean, control_mean: expectations of f and g.
        value_variance, control_variance, covariance: of f and g.
    """

    value_mean: float
    control_mean: float
    value_variance: float
    control_variance: float
    covariance: float

    @property
    def static_coefficient(self) -> float:
        """The best for light that stays: covariance / variance."""
        return self.covariance / self.control_variance

    @property
    def dynamic_coefficient(self) -> float:
        """The best for light that varies much: the ratio of the means."""
        return self.value_mean / self.control_mean


MOMENTS = Moments(math.log(2), 0.5, 0.5 - math.log(2) ** 2, 1 / 12, 2 * math.log(2) - 1 - math.log(2) / 2)


class Residuals(NamedTuple):
    """Streams of one seed, shape (frames,), NaN before a coefficient exists.

    Attributes:
        coefficient: by name of the residual.
        residual: by name.
        error: root of the residual's moving variance, by name.
    """

    coefficient: dict[str, Array]
    residual: dict[str, Array]
    error: dict[str, Array]


class Entry(NamedTuple):
    """One entry of Table B.1 over many seeds.

    Attributes:
        name: of the residual.
        mean, median, sd: of the mean error of frames `FIRST` to the last, over the seeds.
        interquartile: what the middle half of the seeds spans.
        low, high: what 99 % of the seeds lie between.
    """

    name: str
    mean: float
    median: float
    sd: float
    interquartile: float
    low: float
    high: float


def intensity(light: Light, frames: int = FRAMES) -> np.ndarray:
    """h(t) of each frame.

    Args:
        light: "static" for 1, "dynamic" for 1 + 3 sin(t / 10), which is below 0 for part of the time.
        frames: how many, >= 1.

    Returns:
        Float64, shape (frames,).

    Raises:
        ValueError: the light is unknown or there is no frame.

    Source: dissertation B.3.1.

    Example:
        >>> intensity("dynamic", 3).round(3).tolist()
        [1.0, 1.3, 1.596]
    """
    if light not in LIGHTS:
        raise ValueError(f"light must be one of {', '.join(LIGHTS)}, got {light!r}")
    if frames < 1:
        raise ValueError(f"frames must be at least 1, got {frames}")
    time = np.arange(frames)
    return np.ones(frames) if light == "static" else 1 + 3 * np.sin(time / 10)


def simulate(key: Array, light: Light, *, frames: int = FRAMES, spp: int = SPP) -> Residuals:
    """The six residuals of one seed.

    Args:
        key: of the seed.
        light: as for `intensity`.
        frames: how many, >= 3: a coefficient of two frames exists from the third on.
        spp: samples a frame, >= 2.

    Returns:
        `Residuals`, by the names of `NAMES`.

    Raises:
        ValueError: an argument is out of its domain.

    Source: dissertation B.3.1.

    Example:
        >>> streams = simulate(jax.random.key(0), "static")
        >>> round(float(streams.coefficient["GT"][-1]), 4)
        0.4766
    """
    if frames < 3:
        raise ValueError(f"frames must be at least 3, got {frames}; the first two only teach")
    if spp < 2:
        raise ValueError(f"spp must be at least 2, got {spp}; one sample has no covariance")
    y = jax.random.uniform(key, (frames, spp))
    h = jnp.asarray(intensity(light, frames), y.dtype)
    f, g = h[:, None] / (1 + y), h[:, None] * (1 - y)
    value, control = f.mean(axis=1), g.mean(axis=1)
    apart = g - control[:, None]
    single = jnp.sum((f - value[:, None]) * apart, axis=1) / jnp.sum(jnp.square(apart), axis=1)
    matrix = moving.emcm(jnp.stack([value, control], axis=-1), COEFFICIENT_ALPHA)
    over_time = control_variate.coefficient(matrix, epsilon=0.0, bound=None)
    best = MOMENTS.static_coefficient if light == "static" else MOMENTS.dynamic_coefficient
    # Each with the control it is multiplied by, and the first frame that it exists for.
    choices = {
        "Res_f": (jnp.zeros(frames), control, 0),
        "SF": (_delayed(single), control, 1),
        "SF+EMA": (_delayed(moving.ema(single, COEFFICIENT_ALPHA)), control, 1),
        "EMCM": (_delayed(over_time), control, 2),
        "EMCM_hat": (_delayed(over_time), 0.5 * h, 2),
        "GT": (jnp.full(frames, best), control, 0),
    }
    streams = {name: _residual(value, *choice) for name, choice in choices.items()}
    return Residuals(*({name: stream[i] for name, stream in streams.items()} for i in range(3)))


def table(
    key: Array,
    light: Light,
    *,
    seeds: int = 1000,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Entry]:
    """A row of Table B.1 over many seeds.

    Args:
        key: of all seeds; a seed's numbers depend on it and the seed's number.
        light: as for `intensity`.
        seeds: how many, >= 2.
        progress: called with the seeds done and their total.

    Returns:
        Six `Entry`, in the order of `NAMES`. The entries with a moving covariance have heavy tails, since
        their first coefficient is a ratio of two differences: trust their median.

    Raises:
        ValueError: seeds is below 2.

    Source: dissertation Table B.1.

    Example:
        >>> [entry.name for entry in table(jax.random.key(0), "static", seeds=2)]
        ['Res_f', 'SF', 'SF+EMA', 'EMCM', 'EMCM_hat', 'GT']
    """
    if seeds < 2:
        raise ValueError(f"seeds must be at least 2, got {seeds}; one has no spread")
    chunk = min(seeds, _CHUNK_SAMPLES // (FRAMES * SPP))
    parts = []
    for first in range(0, seeds, chunk):
        progress(first, seeds)
        # Ctrl-C inside compiled work crashes or is lost; between chunks it is safe.
        with interrupt_deferred():
            errors = _mean_errors(key, jnp.arange(first, first + chunk), light)
            parts.append(np.asarray(errors, np.float64))
    progress(seeds, seeds)
    errors = np.concatenate(parts)[:seeds]
    low, quarter, median, three_quarters, high = np.percentile(errors, (0.5, 25, 50, 75, 99.5), axis=0)
    spread = (errors.std(axis=0, ddof=1), three_quarters - quarter, low, high)
    columns = (errors.mean(axis=0), median, *spread)
    return [
        Entry(name, *map(float, row)) for name, row in zip(NAMES, zip(*columns, strict=True), strict=True)
    ]


@functools.partial(jax.jit, static_argnums=2)
def _mean_errors(key: Array, numbers: Array, light: Light) -> Array:
    def one(number):
        errors = simulate(jax.random.fold_in(key, number), light).error
        return jnp.stack([errors[name][FIRST:].mean() for name in NAMES])

    return jax.vmap(one)(numbers)


def _delayed(coefficient: Array) -> Array:
    """A frame's coefficient is that of the frames before it."""
    return jnp.concatenate([jnp.full(1, jnp.nan, coefficient.dtype), coefficient[:-1]])


def _residual(value: Array, coefficient: Array, control: Array, first: int) -> tuple[Array, Array, Array]:
    """Coefficient, residual and its error, NaN before the frame `first`."""
    before = jnp.full(first, jnp.nan, value.dtype)
    coefficient = jnp.concatenate([before, coefficient[first:]])
    residual = value - coefficient * control
    variance = moving.emv(residual[first:], RESIDUAL_ALPHA)
    return coefficient, residual, jnp.concatenate([before, jnp.sqrt(variance)])
