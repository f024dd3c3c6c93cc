"""Exponentially weighted moments of a stream: mean, variance, covariance and covariance matrix.

`alpha` in (0, 1] is the weight of the newest sample, a number or a map that broadcasts to the samples. The
first sample carries weight 1, so that after n more the weights are (1 - alpha)^n for it and
alpha (1 - alpha)^(n - i) for sample i: they sum to 1, and no start value biases the mean. Variances are
those of these weights (`bias=True`) unless asked for otherwise.

Five statistics share one recursion. `ema`, `emv`, `emc`, `emcm` and `ewma_covariance` take a whole stream,
time on axis 0, and return the estimate after each sample; `init` and `update` take one sample at a time.
Every leading shape works: a number, a pixel, a frame, a stack of frames. Results have the samples' dtype;
half formats are computed in float32 and rounded when stored.

At the extremes: a constant stream has variance exactly 0 and no stream a negative one; where the square of
a deviation underflows the variance is 0, where it overflows it is inf, from there on until alpha is 1, and
the mean is right up to half of the largest number. A covariance whose products overflow stays finite, but
beside infinite variances it means nothing. A NaN makes the mean and the moments that it enters NaN from
then on (as the first sample, or with alpha = 1, the variances one sample later); an infinity makes mean and
variance infinite or NaN. alpha = 1 starts afresh, and `valid` keeps both out.

Source: Finch, "Incremental calculation of weighted mean and variance", 2009; Xie and Olano 2021, Eq 5-6 and
32-34; Xie, dissertation, 2021, Eq B.18-B.22.
"""

from collections.abc import Sequence
from functools import partial
from typing import Literal

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.typing import ArrayLike, DTypeLike

from sssfit.estimators import _associative, _recursion
from sssfit.estimators._products import MATRICES, Statistic, components_of, floating
from sssfit.estimators._products import STATISTICS as STATISTICS
from sssfit.estimators._state import State as State
from sssfit.estimators._state import estimate as estimate
from sssfit.estimators._state import init as init
from sssfit.estimators._state import mean as mean
from sssfit.estimators._state import stagnation as stagnation
from sssfit.estimators._state import update as update

Method = Literal["scan", "associative"]
METHODS = ("scan", "associative")


def ema(xs: ArrayLike, alpha: ArrayLike, *, method: Method = "scan") -> Array:
    """Exponential moving average of a stream.

    Args:
        xs: samples, time on axis 0, any further shape.
        alpha: weight of the newest sample, in (0, 1], broadcast to one sample's shape.
        method: "scan" goes through time once; "associative" in parallel, in about 2 log2(T) sweeps.

    Returns:
        The average after each sample, of xs' shape and dtype. The first is the first sample. The error of
        "scan" is below (2.5 min(T, 1 / alpha)) eps max |x|; see `stagnation` for what that means to a small
        alpha. "associative" has (log2(T) + 4) times that at most.

    Raises:
        ValueError: alpha is a number outside (0, 1], or the method is unknown.

    Source: Xie and Olano 2021, Eq 5; dissertation Eq B.18.

    Example:
        >>> ema(jnp.array([1.0, 2.0, 4.0]), 0.5).tolist()
        [1.0, 1.5, 2.75]
    """
    return _whole("ema", xs, alpha, method)


def emv(xs: ArrayLike, alpha: ArrayLike, *, method: Method = "scan") -> Array:
    """Exponential moving variance of a stream: that of the weights which the average has.

    Args:
        xs: samples, time on axis 0, any further shape.
        alpha: weight of the newest sample, in (0, 1], broadcast to one sample's shape.
        method: as for `ema`.

    Returns:
        The variance after each sample, >= 0, of xs' shape and dtype; the first is 0. Where the mean is off
        by d, it is off by 2 sqrt(S) d + d^2, S the largest so far, and by 4.5 min(T, 1 / alpha) eps S of
        its own rounding. For independent
        samples of variance V it expects V (1 - sum of squared weights), 8/9 V in the long run at
        alpha = 0.2; see `sssfit.estimators.bias`.

    Raises:
        ValueError: as for `ema`.

    Source: Finch 2009; Xie and Olano 2021, Eq 6. Equals pandas' ewm(alpha=alpha,
    adjust=False).var(bias=True).

    Example:
        >>> emv(jnp.array([1.0, 2.0, 4.0]), 0.5).tolist()
        [0.0, 0.25, 1.6875]
    """
    return _whole("emv", xs, alpha, method)


def emc(xs: ArrayLike, ys: ArrayLike, alpha: ArrayLike, *, method: Method = "scan") -> Array:
    """Exponential moving covariance of two streams.

    Args:
        xs, ys: samples, time on axis 0, shapes that broadcast.
        alpha: weight of the newest samples, in (0, 1], broadcast to one sample's shape.
        method: as for `ema`.

    Returns:
        The covariance after each pair of samples; the first is 0.

    Raises:
        ValueError: as for `ema`.

    Source: Xie and Olano 2021, Eq 32; dissertation Eq B.21.

    Example:
        >>> emc(jnp.array([1.0, 3.0]), jnp.array([2.0, 1.0]), 0.5).tolist()
        [0.0, -0.5]
    """
    return _whole("emc", (xs, ys), alpha, method)


def emcm(zs: ArrayLike, alpha: ArrayLike, *, method: Method = "scan", bounded: bool = False) -> Array:
    """Exponential moving covariance matrix of a stream of vectors.

    Args:
        zs: vectors on the last axis, time on axis 0: (T, ..., n), for small n, since the n (n + 1) / 2
            products are arrays of their own.
        alpha: weight of the newest vector, in (0, 1], broadcast to zs' shape without its ends.
        method: as for `ema`.
        bounded: keep |Sxy| <= sqrt(Sxx Syy) exactly.

    Returns:
        The matrix after each vector, (T, ..., n, n), exactly symmetric; the diagonal is `emv` of the
        components, the rest their `emc`. Positive semi-definite up to rounding: no eigenvalue is below
        -5 n min(T, 1 / alpha) eps times the largest trace so far.

    Raises:
        ValueError: as for `ema`.

    Source: Xie and Olano 2021, Eq 33.

    Example:
        >>> emcm(jnp.array([[1.0, 2.0], [3.0, 1.0]]), 0.5)[-1].tolist()
        [[1.0, -0.5], [-0.5, 0.25]]
    """
    return _whole("emcm", zs, alpha, method, bounded)


def ewma_covariance(
    zs: ArrayLike, alpha: ArrayLike, *, method: Method = "scan", bounded: bool = False
) -> Array:
    """The lagged covariance of finance: deviations from the mean before each vector, weighted by alpha.

    S = (1 - alpha) S + alpha (z - m)(z - m)' with m before z, and S = 0 at first. It is
    `emcm` / (1 - alpha), for every stream and alpha < 1, so a coefficient Sxy / Syy is the same by both.

    Args:
        zs, alpha, method, bounded: as for `emcm`.

    Returns:
        As `emcm`; with alpha = 1 the last product of deviations.

    Raises:
        ValueError: as for `ema`.

    Source: dissertation Eq B.22; Xie and Olano 2021, Eq 34. RiskMetrics proper has no mean:
    `sssfit.estimators.conventions.riskmetrics`.

    Example:
        >>> ewma_covariance(jnp.array([[1.0], [2.0], [4.0]]), 0.5)[:, 0, 0].tolist()
        [0.0, 0.5, 3.375]
    """
    return _whole("ewma_covariance", zs, alpha, method, bounded)


def scan(
    statistic: Statistic,
    xs: ArrayLike | Sequence,
    alpha: ArrayLike,
    *,
    valid: ArrayLike | None = None,
    bias: bool = True,
    bounded: bool = False,
    dtype: DTypeLike | None = None,
    compensated: bool = False,
    state: State | None = None,
) -> tuple[State, Array]:
    """Update by a whole stream, one sample after the other.

    Args:
        statistic: as for `init`.
        xs: samples with time on axis 0, a pair of such arrays for "emc".
        alpha: weight of the newest sample, broadcast to one sample's shape.
        valid: which samples count: (T,) for whole times, or with the axes of `xs` (without the vectors').
        bias, bounded: as for `estimate`.
        dtype, compensated: as for `init`.
        state: where to go on from, as this function returned it; the two before are then the state's.

    Returns:
        The last state, and the estimates after each sample, time on axis 0 and as long as xs.

    Raises:
        ValueError: as for `init`, `update` and `estimate`.

    Source: as `update`.

    Example:
        >>> state, variances = scan("emv", jnp.array([1.0, 2.0, 4.0]), 0.5)
        >>> variances.tolist()
        [0.0, 0.25, 1.6875]
    """
    xs, alpha, valid = _stream(statistic, xs, alpha, valid)
    if state is None:
        state = init(
            statistic,
            jax.tree.map(lambda x: jnp.zeros(x.shape[1:], x.dtype), xs),
            dtype=dtype,
            compensated=compensated,
            weights_shape=() if valid is None and alpha.ndim == 0 else None,
        )
    elif state.statistic != statistic:
        raise ValueError(f"state is of {state.statistic!r}, not of {statistic!r}")

    return _scanned(state, xs, alpha, valid, bias=bias, bounded=bounded)


# Compiled here: lax.scan alone would compile anew at each call, for its body is a new function each time.
@partial(jax.jit, static_argnames=("bias", "bounded"))
def _scanned(state: State, xs, alpha: ArrayLike, valid: Array | None, *, bias: bool, bounded: bool):
    def step(state: State, item):
        x, mask = item
        state = update(state, x, alpha=alpha, valid=mask)
        return state, estimate(state, bias=bias, bounded=bounded)

    return lax.scan(step, state, (xs, valid))


def associative(
    statistic: Statistic,
    xs: ArrayLike | Sequence,
    alpha: ArrayLike,
    *,
    valid: ArrayLike | None = None,
    bias: bool = True,
    bounded: bool = False,
) -> Array:
    """The estimates of `scan`, computed for all times in parallel by `jax.lax.associative_scan`.

    Args:
        statistic, xs, alpha, valid, bias, bounded: as for `scan`.

    Returns:
        The estimates after each sample, which differ from those of `scan` by rounding: the bounds of
        `ema` to `emcm` hold with log2(T) more of it. It does about twice the arithmetic and keeps some
        copies of the stream in memory, for 2 log2(T) steps in a row instead of T.

    Raises:
        ValueError: as for `scan`.

    Source: as `update`; joining two stretches as Chan, Golub and LeVeque, 1979, with fading weights.

    Example:
        >>> associative("emv", jnp.array([1.0, 2.0, 4.0]), 0.5).tolist()
        [0.0, 0.25, 1.6875]
    """
    xs, alpha, valid = _stream(statistic, xs, alpha, valid)
    like = init(statistic, jax.tree.map(lambda x: jnp.zeros(x.shape[1:], x.dtype), xs))
    kept, wide = like.mean[0].dtype, like.debias.dtype
    components = [c.astype(wide) for c in components_of(statistic, xs)]
    weight = alpha.astype(wide).reshape((1,) * (components[0].ndim - alpha.ndim) + alpha.shape)
    means, products, debias, started = _associative.moments(statistic, components, weight, valid)
    state = State(
        tuple(m.astype(kept) for m in means),
        tuple(p.astype(kept) for p in products),
        debias,
        started,
        None,
        statistic,
    )
    return estimate(state, bias=bias, bounded=bounded)


def _stream(statistic: Statistic, xs: ArrayLike | Sequence, alpha, valid):
    """A stream, its weights and its mask as arrays; refused where they do not go together."""
    _recursion.check_alpha(alpha)
    xs = tuple(components_of(statistic, xs)) if statistic == "emc" else floating(xs)
    whole = jax.tree.leaves(xs)[0].shape
    if len(whole) < (2 if statistic in MATRICES else 1):
        vectors = " and vectors on the last" if statistic in MATRICES else ""
        raise ValueError(f"xs must have time on axis 0{vectors}, got shape {whole}")
    sample = whole[1:-1] if statistic in MATRICES else whole[1:]
    alpha = floating(alpha)
    _recursion.check_fits("alpha", alpha.shape, sample, "that is one sample's")
    if valid is None:
        return xs, alpha, None
    valid = jnp.asarray(valid)
    # One axis is time, also where samples happen to be as many.
    valid = valid.reshape(valid.shape + (1,) * len(sample)) if valid.ndim == 1 else valid
    _recursion.check_fits("valid", valid.shape, (whole[0], *sample), "that is time and one sample's")
    return xs, alpha, jnp.broadcast_to(valid, (whole[0], *sample))


def _whole(statistic: Statistic, xs, alpha: ArrayLike, method: Method, bounded: bool = False) -> Array:
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if method == "scan":
        return scan(statistic, xs, alpha, bounded=bounded)[1]
    return associative(statistic, xs, alpha, bounded=bounded)
