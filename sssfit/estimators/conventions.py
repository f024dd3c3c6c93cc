"""The same moving moments in other packages' conventions, and their weights as ours.

| here | pandas `ewm` | river | RiskMetrics, arch, optax |
| --- | --- | --- | --- |
| alpha, weight of the newest | `alpha`; `com`, `span`, `halflife` | `fading_factor` | 1 - decay |
| first sample weighs 1 | `adjust=False` | so | RiskMetrics: a start value |
| weights' own variance | `bias=True` | so | no mean, one step late |

pandas' defaults are `adjust=True`, which weighs the first samples like all others and divides by the sum of
the weights, and `bias=False`, which divides variances by 1 minus the sum of the squared weights.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from sssfit.estimators import _recursion, moving


def alpha_from_span(span: ArrayLike) -> Array:
    """Weight of the newest sample from a span in samples, as of an "N-day" average.

    Args:
        span: >= 1.

    Returns:
        2 / (span + 1).

    Raises:
        ValueError: a span known on the host is out of its domain.

    Source: pandas' `ewm(span=...)`; Xie et al. 2020, section 4.1.2, k = 2 / alpha - 1.

    Example:
        >>> round(float(alpha_from_span(9.0)), 6)
        0.2
    """
    _check_on_host("span", span, "at least 1", np.greater_equal, 1)
    return 2 / (jnp.asarray(span) + 1.0)


def alpha_from_center_of_mass(center_of_mass: ArrayLike) -> Array:
    """Weight of the newest sample from the weights' mean age in samples.

    Args:
        center_of_mass: >= 0.

    Returns:
        1 / (1 + center_of_mass).

    Raises:
        ValueError: a center_of_mass known on the host is out of its domain.

    Source: pandas' `ewm(com=...)`.

    Example:
        >>> round(float(alpha_from_center_of_mass(4.0)), 6)
        0.2
    """
    _check_on_host("center_of_mass", center_of_mass, "at least 0", np.greater_equal, 0)
    return 1 / (1.0 + jnp.asarray(center_of_mass))


def alpha_from_halflife(halflife: ArrayLike) -> Array:
    """Weight of the newest sample from the number of samples after which a weight has halved.

    Args:
        halflife: > 0.

    Returns:
        1 - exp(-ln 2 / halflife), without the loss of digits for long ones.

    Raises:
        ValueError: a halflife known on the host is out of its domain.

    Source: pandas' `ewm(halflife=...)`.

    Example:
        >>> float(alpha_from_halflife(1.0))
        0.5
    """
    _check_on_host("halflife", halflife, "above 0", np.greater, 0)
    return -jnp.expm1(-jnp.log(2.0) / jnp.asarray(halflife))


def alpha_from_decay(decay: ArrayLike) -> Array:
    """Weight of the newest sample from that of the past: RiskMetrics' lambda, arch's lam, optax's decay.

    Args:
        decay: in [0, 1). In float32 a decay near 1 has lost digits that alpha would have kept.

    Returns:
        1 - decay.

    Raises:
        ValueError: a decay known on the host is out of its domain.

    Source: RiskMetrics Technical Document, 1996, section 5.2: 0.94 for days, 0.97 for months.

    Example:
        >>> round(float(alpha_from_decay(0.94)), 6)
        0.06
    """
    _check_on_host("decay", decay, "at least 0", np.greater_equal, 0)
    _check_on_host("decay", decay, "below 1", np.less, 1)
    return 1.0 - jnp.asarray(decay)


def alpha_from_fading_factor(fading_factor: ArrayLike) -> Array:
    """Weight of the newest sample from river's: the same number.

    `moving.ema`, `emv` and `emc` with it are river's `stats.EWMean`, `EWVar` and `EWCov`, from the first
    sample on, and without the cancellation in river's mean of squares minus square of the mean.

    Args:
        fading_factor: in (0, 1]; river's default is 0.5.

    Returns:
        The same.

    Raises:
        ValueError: a fading_factor known on the host is out of its domain.

    Source: river's `stats.EWMean`.

    Example:
        >>> float(alpha_from_fading_factor(0.5))
        0.5
    """
    _recursion.check_alpha(fading_factor)
    return jnp.asarray(fading_factor)


def _check_on_host(name: str, value: ArrayLike, requirement: str, holds: np.ufunc, limit: float) -> None:
    """Raise where a value known on the host is out of its domain; traced and device values pass."""
    if isinstance(value, int | float | np.ndarray | np.generic) and not np.all(holds(value, limit)):
        raise ValueError(f"{name} must be {requirement}, got {value}")


class Ewm(NamedTuple):
    """Moving mean and covariance after each sample, time on axis 0.

    Attributes:
        mean: (T, ..., n).
        covariance: (T, ..., n, n).
    """

    mean: Array
    covariance: Array


def pandas_ewm(zs: ArrayLike, alpha: ArrayLike, *, adjust: bool = True, bias: bool = False) -> Ewm:
    """pandas' `DataFrame.ewm(alpha=alpha, adjust=adjust)`, its `mean()` and `cov(bias=bias)`.

    Args:
        zs: vectors on the last axis, time on axis 0: (T, ..., n).
        alpha: weight of the newest vector, in (0, 1], a number.
        adjust: weights (1 - alpha)^age over their sum, also for the first sample; else it weighs 1 at first.
        bias: leave variances as they are rather than divided by 1 minus the sum of the squared weights.

    Returns:
        An `Ewm`, the covariance NaN after the first sample with bias=False, as in pandas. NaN in zs is no
        gap as it is there, but stays.

    Raises:
        ValueError: alpha is not a number in (0, 1].

    Source: pandas' documentation of `DataFrame.ewm`; adjusted weights are our recursion with
    alpha / (1 - (1 - alpha)^t) for the sample number t.

    Example:
        >>> pandas_ewm(jnp.array([[1.0], [2.0]]), 0.5).covariance[:, 0, 0].tolist()
        [nan, 0.5]
    """
    _recursion.check_alpha(alpha)
    if jnp.ndim(alpha) != 0:
        raise ValueError(f"alpha must be one number for pandas' convention, got shape {jnp.shape(alpha)}")
    zs = jnp.asarray(zs, jnp.result_type(float, zs))
    if len(zs) == 0:
        raise ValueError("zs must have at least one vector, got none")
    wide = _recursion.computing_dtype(zs.dtype)
    alpha = jnp.asarray(alpha, wide)
    number = jnp.arange(1, len(zs) + 1, dtype=wide)
    adjusted = alpha / -jnp.expm1(number * jnp.log1p(-alpha)) if adjust else jnp.full_like(number, alpha)

    return _weighted(zs, adjusted, bias=bias)


@partial(jax.jit, static_argnames="bias")
def _weighted(zs: Array, alphas: Array, *, bias: bool) -> Ewm:
    """Moments after each vector, each with a weight of its own."""

    def step(state: moving.State, item):
        z, weight = item
        state = moving.update(state, z, alpha=weight)
        return state, Ewm(moving.mean(state), moving.estimate(state, bias=bias))

    return lax.scan(step, moving.init("emcm", zs[0], weights_shape=()), (zs, alphas))[1]


def riskmetrics(returns: ArrayLike, *, decay: ArrayLike = 0.94) -> Array:
    """RiskMetrics' covariance forecast: no mean, and each value from the returns before it.

    Args:
        returns: vectors on the last axis, time on axis 0: (T, ..., n), T >= 1.
        decay: weight of the past, in [0, 1).

    Returns:
        (T, ..., n, n): entry t is the moving average of the returns' outer products up to t - 1, which the
        first product starts; entry 0 is NaN, nothing being known. Not comparable with `moving.emcm`, whose
        deviations are from a mean and which includes the newest sample.

    Source: RiskMetrics Technical Document, 1996, section 5.2.

    Example:
        >>> riskmetrics(jnp.array([[1.0], [2.0], [0.0]]), decay=0.5)[:, 0, 0].tolist()
        [nan, 1.0, 2.5]
    """
    dtype = jnp.result_type(float, returns)
    returns = jnp.asarray(returns, _recursion.computing_dtype(dtype))
    products = returns[..., :, None] * returns[..., None, :]
    forecasts = moving.ema(products[:-1], alpha_from_decay(decay))
    return jnp.concatenate([jnp.full_like(products[:1], jnp.nan), forecasts]).astype(dtype)
