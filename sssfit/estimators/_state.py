"""What is kept of a stream, and how one more sample changes it; public as `sssfit.estimators.moving`."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from sssfit.estimators import _recursion
from sssfit.estimators._products import MATRICES, Statistic, components_of, matrix, product_pairs, stacked


class State(eqx.Module):
    """What is kept of a stream.

    Attributes:
        mean: moving average of each component (x alone, x and y, or the vector's), of a sample's shape.
        products: moving covariances, none for "ema"; for a matrix its upper triangle, row by row.
        debias: 1 minus the sum of the squared weights.
        started: whether a valid sample has come.
        low: what storing `mean`, `products` and `debias` rounded off; None without compensation.
        statistic: which of the five this is.
    """

    mean: tuple[Array, ...]
    products: tuple[Array, ...]
    debias: Array
    started: Array
    low: tuple[tuple[Array, ...], tuple[Array, ...], Array] | None
    statistic: Statistic = eqx.field(static=True)


def init(
    statistic: Statistic,
    like: ArrayLike | Sequence,
    *,
    dtype: DTypeLike | None = None,
    compensated: bool = False,
    weights_shape: tuple[int, ...] | None = None,
) -> State:
    """A state that no sample has reached yet.

    Args:
        statistic: "ema", "emv", "emc", "emcm" or "ewma_covariance".
        like: anything of a sample's shape and dtype: an array, a pair of them for "emc", vectors on the
            last axis for the last two. A matrix of n components takes n (n + 3) / 2 numbers.
        dtype: what to keep the moments in, such as jnp.float16; the samples' by default.
        compensated: also keep what each rounding lost, twice the memory: float32 then carries weights of
            1e-6 and below, float16 (22 bits in all) half of what float32 does, bfloat16 16 bits.
        weights_shape: shape of `debias` and `started`. The samples' by default; () is enough, and saves
            5 bytes for each, where one number alpha and no `valid` serve all.

    Returns:
        A `State` whose estimates are NaN until a sample comes.

    Raises:
        ValueError: the statistic is unknown, or `like` has not its shape.

    Example:
        >>> state = init("emv", 0.0)
        >>> for x in (1.0, 2.0, 4.0):
        ...     state = update(state, x, alpha=0.5)
        >>> float(mean(state)), float(estimate(state))
        (2.75, 1.6875)
    """
    components = components_of(statistic, like)
    kept = jnp.dtype(components[0].dtype if dtype is None else dtype)
    zero = jnp.zeros(components[0].shape, kept)
    means = (zero,) * len(components)
    products = (zero,) * len(product_pairs(statistic, len(components)))
    shape = zero.shape if weights_shape is None else weights_shape
    debias = jnp.zeros(shape, _recursion.computing_dtype(kept))
    low = (means, products, debias) if compensated else None
    return State(means, products, debias, jnp.zeros(shape, bool), low, statistic)


def update(
    state: State, x: ArrayLike | Sequence, *, alpha: ArrayLike, valid: ArrayLike | None = None
) -> State:
    """The state after one more sample.

    Args:
        state: as `init` or this function returned it.
        x: the sample: of the state's shape, a pair for "emc", vectors on the last axis for matrices.
        alpha: weight of this sample, in (0, 1], broadcast to the weights' shape. At 1 the past is
            forgotten: the mean is x and the variance 0; for "ewma_covariance" the squared deviation, which
            takes one sample more to forget a NaN.
        valid: where False the state stays as it is, bit for bit, and whatever stands in x is ignored;
            broadcast to the weights' shape.

    Returns:
        A state of the same structure, shapes and dtypes, fit to be the carry of `lax.scan`.

    Raises:
        ValueError: alpha is a number of the host outside (0, 1], or x, alpha or valid do not fit the state.

    Source: Xie and Olano 2021, Eq 5, 6, 32, 33 and 34 ("ewma_covariance").

    Example:
        >>> state = update(init("emc", (0.0, 0.0)), (1.0, 2.0), alpha=0.5)
        >>> float(estimate(update(state, (3.0, 1.0), alpha=0.5)))
        -0.5
    """
    _recursion.check_alpha(alpha)
    components = _fitting(state, x)
    for name, value in (("alpha", alpha), ("valid", valid)):
        shape = () if value is None else jnp.shape(value)
        _recursion.check_fits(name, shape, state.started.shape, "init with another weights_shape")
    if valid is not None:
        # Also in the branch that is not taken a NaN would reach the gradient.
        components = [jnp.where(valid, c, 0) for c in components]
    new = _advance(state, components, jnp.asarray(alpha, components[0].dtype))
    return new if valid is None else _recursion.choose(jnp.asarray(valid), new, state)


def _fitting(state: State, x: ArrayLike | Sequence) -> list[Array]:
    """The components of a sample of the state's shape, in the dtype to compute in."""
    wide = _recursion.computing_dtype(state.mean[0].dtype)
    components = [c.astype(wide) for c in components_of(state.statistic, x)]
    shape = state.mean[0].shape
    if len(components) != len(state.mean):
        raise ValueError(f"x must have {len(state.mean)} components like the state, got {len(components)}")
    _recursion.check_fits("x", components[0].shape, shape, "that is the state's")
    return components


# Compiled also where it is called by hand, so that a frame is read and written once.
@jax.jit
def _advance(state: State, components: list[Array], alpha: Array) -> State:
    kept, wide = state.mean[0].dtype, alpha.dtype
    low_mean, low_products, low_debias = _low_parts(state, wide)
    # The first sample carries weight 1, and what stood in the mean before is no value.
    alpha = jnp.where(state.started, alpha, 1)
    old = [value.astype(wide) for value in state.mean]
    deltas = [
        jnp.where(state.started, x - m if low is None else (x - m) - low, 0)
        for x, m, low in zip(components, old, low_mean, strict=True)
    ]
    means = []
    for m, delta, x, low in zip(old, deltas, components, low_mean, strict=True):
        new, rest = _recursion.mean_step(m, delta, x, alpha, low)
        # A half format has no room for every finite sample, and an infinite mean would be NaN next.
        means.append((_recursion.within(new, kept), rest))
    pairs = product_pairs(state.statistic, len(old))
    lagged = state.statistic == "ewma_covariance"
    products = []
    for (i, j), value, low in zip(pairs, state.products, low_products, strict=True):
        new, rest = _recursion.covariance_step(
            value.astype(wide), deltas[i], deltas[j], alpha, lagged=lagged, low=low
        )
        # Two opposite infinities would add up to NaN; variances have but one sign.
        products.append((new if i == j else _recursion.saturate(new, kept), rest))
    own = jnp.broadcast_to(alpha, state.debias.shape).astype(state.debias.dtype)
    debias, rest_debias = _recursion.debias_step(state.debias, own, low_debias)
    low = None
    if rest_debias is not None:
        low = (_recursion.store_low(means, kept), _recursion.store_low(products, kept), rest_debias)
    return State(
        _recursion.store(means, kept),
        _recursion.store(products, kept),
        debias,
        jnp.ones_like(state.started),
        low,
        state.statistic,
    )


def _low_parts(state: State, wide):
    if state.low is None:
        return (None,) * len(state.mean), (None,) * len(state.products), None
    low_mean, low_products, low_debias = state.low
    return [low.astype(wide) for low in low_mean], [low.astype(wide) for low in low_products], low_debias


def estimate(state: State, *, bias: bool = True, bounded: bool = False) -> Array:
    """The statistic's value: the mean, the variance, the covariance, or the covariance matrix.

    Args:
        state: of any statistic.
        bias: False divides a variance or covariance by 1 minus the sum of the squared weights, which
            makes its expectation that of independent samples of one distribution; a mean is unaffected.
        bounded: for matrices, keep |Sxy| <= sqrt(Sxx Syy) exactly, which rounding breaks by a few ulp.
            With two components that makes the matrix positive semi-definite.

    Returns:
        Array of the state's shape and dtype, with two more axes (n, n) for matrices. NaN where no valid
        sample has come, and with bias=False where only one counts: the first, or any with alpha = 1.

    Raises:
        ValueError: bias=False for "ewma_covariance", or bounded without a matrix.

    Source: weights as in the dissertation, Eq B.18; the divisor is that of reliability weights.

    Example:
        >>> state = init("emv", 0.0)
        >>> for x in (1.0, 2.0):
        ...     state = update(state, x, alpha=0.5)
        >>> float(estimate(state)), float(estimate(state, bias=False))
        (0.25, 0.5)
    """
    is_matrix = state.statistic in MATRICES
    if bounded and not is_matrix:
        raise ValueError(f"bounded needs a covariance matrix, the state is of {state.statistic!r}")
    kept = state.mean[0].dtype
    values = list(state.mean if state.statistic == "ema" else state.products)
    if not bias and state.statistic != "ema":
        if state.statistic == "ewma_covariance":
            raise ValueError("bias=False is not defined for 'ewma_covariance'; use 'emcm'")
        values = [(value / state.debias).astype(kept) for value in values]
    values = [jnp.where(state.started, value, jnp.nan) for value in values]
    return matrix(values, len(state.mean), bounded=bounded) if is_matrix else values[0]


def mean(state: State) -> Array:
    """The moving average that every statistic keeps, with vectors on a last axis where they came so.

    Args:
        state: of any statistic.

    Returns:
        Array of the state's shape and dtype; for "emc" with a first axis of 2, for matrices a last one
        of n. NaN where no valid sample has come.

    Source: Xie and Olano 2021, Eq 5.

    Example:
        >>> mean(update(init("emcm", [0.0, 0.0]), [1.0, 2.0], alpha=0.2)).tolist()
        [1.0, 2.0]
    """
    return stacked(state.statistic, [jnp.where(state.started, m, jnp.nan) for m in state.mean])


def stagnation(mean: ArrayLike, alpha: ArrayLike, dtype: DTypeLike) -> Array:
    """Largest step up of the input that a stored mean does not follow, however long it stays.

    alpha |x - mean| below half a unit in the last place of the mean is lost when the sum is rounded.

    Args:
        mean: where the average stands, in the input's unit; exact in the dtype.
        alpha: weight of the newest sample, in (0, 1].
        dtype: what the mean is stored in, without compensation.

    Returns:
        ulp(mean) / (2 alpha), in the input's unit: a step from 0 to 1 stops at 0.9990 in float16 with
        alpha = 0.2, at 0.951 with 0.005, and at 0.0039 with 1e-6. At this very difference rounding to
        even decides.

    Source: rounding of the sum in Xie and Olano 2021, Eq 5, derived here.

    Example:
        >>> float(stagnation(1.0, 0.005, jnp.float16)).__round__(4)
        0.0977
    """
    wide = jnp.result_type(float, mean, alpha)
    info = jnp.finfo(dtype)
    magnitude = jnp.maximum(jnp.abs(jnp.asarray(mean, wide)), float(info.tiny))
    # frexp's fraction is in [1/2, 1), so the unit in the last place is eps 2^(exponent - 1).
    _, exponent = jnp.frexp(magnitude)
    return jnp.ldexp(jnp.asarray(float(info.eps), wide), exponent - 1) / (2 * jnp.asarray(alpha, wide))
