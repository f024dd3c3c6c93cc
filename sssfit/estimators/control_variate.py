"""Control variates: take the change of the light out of the variance that decides the sample count.

A frame brings f, the mean of its samples of distant light, and a control g of known integral G, such as the
pixel's own lighting. The variance tracked is that of the residual f - a G, with the coefficient
a = Cov(f, g) / Var(g) of the history (online), or a fixed one (1 is main part separation; 0 is none, plain
adaptive sampling). `step` does it all for a frame: coefficient, residual, history, and the next count.

All quantities are of one pixel or maps of them; f, g and G are radiances in one linear unit, the coefficient
has none.

Source: Xie and Olano 2021, section 6 and Algorithms 1-3; dissertation section 6.5 for the bound's a_0.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from sssfit.estimators import _recursion, sample_count
from sssfit.estimators._control_state import MAIN_PART as MAIN_PART
from sssfit.estimators._control_state import NONE as NONE
from sssfit.estimators._control_state import ONLINE as ONLINE
from sssfit.estimators._control_state import Config as Config
from sssfit.estimators._control_state import History as History
from sssfit.estimators._control_state import Info as Info
from sssfit.estimators._control_state import Moments as Moments
from sssfit.estimators._control_state import Observation as Observation


def upper_bound(value: ArrayLike, control: ArrayLike, *, bound_offset: ArrayLike = 1.0) -> Array:
    """The largest coefficient, at which the residual may become -a_0 g and no less.

    Args:
        value: f, >= 0.
        control: g, >= 0.
        bound_offset: a_0 >= 0; 1 is the paper's, more keeps dim pixels from too few samples.

    Returns:
        a_0 + f / g, at least 0. Where g is not above 0, as in shadow, inf: no light, no bound.

    Source: Xie and Olano 2021, section 6.2.3; dissertation section 6.5.4 for a_0.

    Example:
        >>> upper_bound(jnp.array([1.0, 1.0]), jnp.array([2.0, 0.0])).tolist()
        [1.5, inf]
    """
    value, control = jnp.asarray(value), jnp.asarray(control)
    lit = control > 0
    bound = jnp.maximum(bound_offset + value / jnp.where(lit, control, 1), 0)
    return jnp.where(lit, bound, jnp.where(jnp.isnan(control), jnp.nan, jnp.inf))


def coefficient(
    covariance: ArrayLike,
    *,
    epsilon: ArrayLike,
    bound: ArrayLike | Sequence[ArrayLike] | None,
) -> Array:
    """The control's coefficient, from a covariance matrix of (f, g).

    Args:
        covariance: (..., 2, 2), such as `moving.emcm` returns; only the last row is read.
        epsilon: >= 0, added to both; where both vanish, as in a hard shadow, the coefficient is 1. With 0
            it is 1 wherever the variance vanishes.
        bound: the largest coefficient, the least being 0; a pair gives both; None leaves it free.

    Returns:
        (Sxy + epsilon) / (Syy + epsilon) within the bound, of the leading shape. 0 for an infinite Syy
        and finite Sxy. It is the same for `moving.emcm` and `moving.ewma_covariance` with epsilon 0.

    Raises:
        ValueError: the covariance's last axes are not (2, 2).

    Source: Xie and Olano 2021, Algorithm 2; dissertation Eq 6.21.

    Example:
        >>> float(coefficient(jnp.array([[2.0, 0.5], [0.5, 1.0]]), epsilon=0.0, bound=2.0))
        0.5
    """
    covariance = jnp.asarray(covariance)
    if covariance.shape[-2:] != (2, 2):
        raise ValueError(f"covariance must have (2, 2) for its last axes, got shape {covariance.shape}")
    return _coefficient(covariance[..., 1, 0], covariance[..., 1, 1], epsilon, bound)


def _coefficient(covariance: Array, variance: Array, epsilon: ArrayLike, bound) -> Array:
    above, below = covariance + epsilon, variance + epsilon
    # A control that has not varied says nothing, whatever rounding has left above it.
    vanishing = below == 0
    ratio = jnp.where(vanishing, 1, above / jnp.where(vanishing, 1, below))
    if bound is None:
        return ratio
    lower, upper = bound if isinstance(bound, tuple | list) else (0.0, bound)
    return jnp.clip(ratio, lower, upper)


def residual(value: ArrayLike, control_integral: ArrayLike, coefficient: ArrayLike) -> Array:
    """What is left of a frame's value without the control: f - a G.

    Args:
        value: f.
        control_integral: G, not the sampled g: in the pixel's own frame g would take the spatial variance
            out too, which the samples are counted for.
        coefficient: a.

    Source: Xie and Olano 2021, Eq 38.

    Example:
        >>> float(residual(1.0, 0.5, 1.5))
        0.25
    """
    integral = jnp.asarray(control_integral)
    # In full shadow nothing is taken off, also with a coefficient that is not bounded there.
    return jnp.asarray(value) - jnp.where(integral == 0, 0, jnp.asarray(coefficient) * integral)


def init(
    like: ArrayLike, config: Config = ONLINE, *, packed: bool = False, dtype: DTypeLike | None = None
) -> History:
    """A history of nothing, all zeros.

    Args:
        like: anything of the pixels' shape and dtype.
        config: with a constant coefficient three numbers are kept.
        packed: keep seven numbers instead of nine, without the variance of f (and the covariance once, as
            ever).
        dtype: what to keep the history in, such as jnp.float16; that of `like` by default.

    Example:
        >>> init(0.0, packed=True).moments.value_variance is None
        True
    """
    count = sample_count.init(like, dtype=dtype)
    if config.constant is not None:
        return History(count, None)
    zero = jnp.zeros_like(count.mean)
    return History(count, Moments(zero, zero, zero, zero, None if packed else zero))


def pack(history: History) -> Array:
    """The seven numbers of a history, for two textures.

    Args:
        history: packed or not, with an estimated coefficient.

    Returns:
        (..., 7): mean count, mean and variance of the residual, means of f and g, covariance, variance of g.

    Raises:
        ValueError: the history has a constant coefficient and three numbers.

    Source: Xie and Olano 2021, section 6.2.4, "Number of textures".

    Example:
        >>> pack(init(jnp.zeros((4, 4)))).shape
        (4, 4, 7)
    """
    count, moments = history.count, history.moments
    if moments is None:
        raise ValueError("a history with a constant coefficient has three numbers and needs no packing")
    of_count = (count.mean_count, count.mean, count.variance)
    means = (moments.value_mean, moments.control_mean)
    return jnp.stack([*of_count, *means, moments.covariance, moments.control_variance], axis=-1)


def unpack(packed: ArrayLike) -> History:
    """A packed history from its seven numbers: the inverse of `pack`.

    Args:
        packed: (..., 7).

    Returns:
        A `History` without the variance of f, which `step` takes like any other.

    Raises:
        ValueError: the last axis has not 7 numbers.

    Source: as `pack`.

    Example:
        >>> float(unpack(jnp.arange(7.0)).moments.covariance)
        5.0
    """
    packed = jnp.asarray(packed)
    if packed.ndim == 0 or packed.shape[-1] != 7:
        raise ValueError(f"a packed history must have 7 numbers on its last axis, got shape {packed.shape}")
    numbers = [packed[..., i] for i in range(7)]
    count = sample_count.History(numbers[0], numbers[1], numbers[2])
    return History(count, Moments(numbers[3], numbers[4], numbers[5], numbers[6], None))


def step(state: History, observation: Observation, config: Config = ONLINE) -> tuple[History, Info]:
    """One frame: coefficient, residual, history, and the count of the next frame.

    The coefficient comes from the frames before this one and is bounded by this frame's f and g. A pixel
    that had no history, or one that a NaN or an infinity has got into, starts from this frame:
    coefficient 1, variance of the residual at the target, covariance 0. Where no sample was drawn, nothing
    is learned.

    Args:
        state: as `init`, `unpack` or this function returned it.
        observation: what the frame brought.
        config: the constants.

    Returns:
        The history after the frame, of the same structure, shapes and dtype, and an `Info`.

    Raises:
        ValueError: the state was made for a constant coefficient and config has none.

    Source: Xie and Olano 2021, Algorithms 1-3; dissertation Algorithms 3-5.

    Example:
        >>> frame = Observation(value=0.4, control=0.5, control_integral=0.5, count=8, missing=True)
        >>> state, info = step(init(0.0), frame)
        >>> round(float(info.residual), 3), int(info.count)
        (-0.1, 8)
    """
    controller = config.controller
    wide = _recursion.computing_dtype(state.count.mean.dtype)
    value, control, integral = (
        jnp.asarray(v, wide) for v in (observation.value, observation.control, observation.control_integral)
    )
    for name in ("value", "control", "control_integral"):
        shape = jnp.shape(getattr(observation, name))
        _recursion.check_fits(name, shape, state.count.mean.shape, "that is the state's")
    count = observation.count
    if count is None:
        count = sample_count.next_count(
            state.count, controller, distant_share=observation.distant_share, missing=observation.missing
        )
    learned = jnp.asarray(observation.valid) & (jnp.asarray(count) > 0)
    found = _current(state.moments, value, control, config, jnp.asarray(observation.missing))
    left = residual(value, integral, jnp.broadcast_to(found, state.count.mean.shape))
    counted = sample_count.update(
        state.count, left, count, controller, missing=observation.missing, valid=observation.valid
    )
    moments = state.moments
    if moments is not None:
        new = _after(
            moments, jnp.where(learned, value, 0), jnp.where(learned, control, 0), config, observation
        )
        nothing = jax.tree.map(jnp.zeros_like, moments)
        old = _recursion.choose(jnp.asarray(observation.missing), nothing, moments)
        moments = _recursion.choose(learned, new, old)
    following = observation.next_distant_share
    following = observation.distant_share if following is None else following
    asked = sample_count.next_count(counted, controller, distant_share=following)
    return History(counted, moments), Info(jnp.broadcast_to(found, left.shape), left, asked)


def _current(moments: Moments | None, value: Array, control: Array, config: Config, missing: Array) -> Array:
    """The coefficient of this frame, from the moments before it."""
    if config.constant is not None:
        return jnp.asarray(config.constant, value.dtype)
    if moments is None:
        raise ValueError(
            "config estimates the coefficient, but the state keeps no moments; init it with config"
        )
    bound = upper_bound(value, control, bound_offset=config.bound_offset)
    covariance, variance = (
        jnp.where(missing | moments.is_lost, 0, v.astype(value.dtype))
        for v in (moments.covariance, moments.control_variance)
    )
    return _coefficient(covariance, variance, config.epsilon, bound)


def _after(
    moments: Moments, value: Array, control: Array, config: Config, observation: Observation
) -> Moments:
    """The moments after a frame."""
    kept, wide = moments.covariance.dtype, value.dtype
    fresh = jnp.asarray(observation.missing) | moments.is_lost
    alpha = jnp.where(fresh, 1, jnp.asarray(config.alpha, wide))
    value_mean, control_mean = moments.value_mean.astype(wide), moments.control_mean.astype(wide)
    # A control that stays must not vary by what storing its mean rounds off: the coefficient would be noise.
    control = control.astype(kept).astype(wide)
    of_value, of_control = value - value_mean, control - control_mean

    def product(old: Array, dx: Array, dy: Array) -> Array:
        return _recursion.covariance_step(old.astype(wide), dx, dy, alpha, lagged=False)[0]

    variance = moments.value_variance
    new = Moments(
        _recursion.mean_step(value_mean, of_value, value, alpha)[0],
        _recursion.mean_step(control_mean, of_control, control, alpha)[0],
        _recursion.saturate(product(moments.covariance, of_value, of_control), kept),
        product(moments.control_variance, of_control, of_control),
        None if variance is None else product(variance, of_value, of_value),
    )
    # As in the sample count's history, what is too large for the format stays at its largest number.
    new = jax.tree.map(lambda v: _recursion.within(v, kept).astype(kept), new)
    bad = ~(jnp.isfinite(value) & jnp.isfinite(control))
    return eqx.tree_at(lambda m: m.covariance, new, jnp.where(bad, jnp.nan, new.covariance))
