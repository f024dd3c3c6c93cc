"""One step of the exponentially weighted recursions, on plain arrays of one shape.

For weights up to 1/2 they are written as an old value plus an increment: alpha multiplies what has changed,
so that a small weight keeps its digits (1 - alpha does not) and an unchanged input changes nothing. Above
1/2, where 1 - alpha is exact, the old value is multiplied by it, so that what is nearly forgotten leaves no
rounding behind. Numbers are computed in float32 at least, whatever they are stored in.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike


def computing_dtype(stored) -> jnp.dtype:
    """What values stored in a dtype are computed in: float32 for the half formats."""
    return jnp.promote_types(stored, jnp.float32)


def check_alpha(alpha: ArrayLike) -> None:
    """Raise where a weight known on the host is outside (0, 1]; traced and device values pass."""
    if isinstance(alpha, int | float | np.ndarray | np.generic | list | tuple):
        values = np.asarray(alpha, np.float64)
        if not bool(np.all((values > 0) & (values <= 1))):
            worst = values.flat[int(np.argmin((values > 0) & (values <= 1)))]
            raise ValueError(
                f"alpha must be in (0, 1], got {worst:g}; it is the weight of the newest sample, "
                "1 minus what other conventions call decay"
            )


def check_fits(name: str, shape: tuple[int, ...], kept: tuple[int, ...], remedy: str) -> None:
    """Raise where an argument does not broadcast to what is kept, or would make it larger."""
    missing = len(kept) - len(shape)
    if missing < 0 or any(n not in (1, k) for n, k in zip(shape, kept[missing:], strict=True)):
        raise ValueError(f"{name} must broadcast to the shape {kept}, got {shape}; {remedy}")


def toward(old: Array, increment: Array, low: Array | None = None) -> tuple[Array, Array | None]:
    """old + increment; with the low part of a compensated sum, both parts of the new one."""
    if low is None:
        return old + increment, None
    increment = increment + low
    total = old + increment
    # Knuth's two-sum: what rounding `total` lost, exactly.
    virtual = total - old
    return total, (old - (total - virtual)) + (increment - virtual)


def mean_step(mean: Array, delta: Array, x: Array, alpha: Array, low: Array | None = None):
    """The moving average after x, delta = x - mean; exactly x where alpha is 1."""
    stays, left = toward(mean, alpha * delta, low)
    # With alpha = 1 nothing of the old is left, NaN and inf included.
    gap = jnp.where((alpha == 1) & ~jnp.isfinite(delta), 0, delta)
    fades = x - (1 - alpha) * gap
    return jnp.where(alpha > 0.5, fades, stays), _rest(left, stays, alpha)


def _rest(left: Array | None, stays: Array, alpha: Array) -> Array | None:
    """What a compensated sum keeps beside the value: nothing where that fades or is infinite."""
    return None if left is None else jnp.where((alpha > 0.5) | ~jnp.isfinite(stays), 0, left)


def covariance_step(
    covariance: Array,
    delta_x: Array,
    delta_y: Array,
    alpha: Array,
    *,
    lagged: bool,
    low: Array | None = None,
):
    """(1 - alpha) (c + alpha dx dy), or (1 - alpha) c + alpha dx dy for the lagged (EWMA) form.

    Deltas are to the mean before this sample. An infinite c stays so, whatever comes but alpha = 1.
    """
    product = delta_x * delta_y
    arriving = product if lagged else (1 - alpha) * product
    if low is None:
        stays, left = covariance + alpha * (arriving - covariance), None
    else:
        stays, left = toward(covariance, alpha * (arriving - (covariance + low)), low)
    # inf - inf would be NaN.
    stays = jnp.where(jnp.isinf(covariance), covariance + product, stays)
    # With alpha = 1 nothing of the old is left, NaN and inf included.
    held, counted = (
        jnp.where((alpha == 1) & ~jnp.isfinite(value), 0, value) for value in (covariance, product)
    )
    fades = (1 - alpha) * held + alpha * product if lagged else (1 - alpha) * (held + alpha * counted)
    return jnp.where(alpha > 0.5, fades, stays), _rest(left, stays, alpha)


def debias_step(debias: Array, alpha: Array, low: Array | None = None):
    """1 - sum of the squared weights, after one more sample: no difference of near numbers in it."""
    kept = 1 - alpha
    held = debias if low is None else debias + low
    stays, left = toward(debias, alpha * (2 * kept - (2 - alpha) * held), low)
    fades = kept * (2 * alpha + kept * debias)
    return jnp.where(alpha > 0.5, fades, stays), _rest(left, stays, alpha)


def store(values: Sequence[tuple[Array, Array | None]], dtype) -> tuple[Array, ...]:
    """Values, the first of each pair, rounded to the dtype that they are kept in."""
    return tuple(value.astype(dtype) for value, _ in values)


def within(value: Array, dtype) -> Array:
    """A finite value kept within the dtype's range, where storing would make it infinite."""
    return jnp.where(jnp.isfinite(value), saturate(value, dtype), value)


def store_low(values: Sequence[tuple[Array, Array | None]], dtype) -> tuple[Array, ...]:
    """What `store` rounds off, with the low part of each pair."""
    rests = (
        (value - value.astype(dtype).astype(value.dtype)) + low for value, low in values if low is not None
    )
    return tuple(jnp.where(jnp.isfinite(rest), rest, 0).astype(dtype) for rest in rests)


def saturate(value: Array, dtype) -> Array:
    """The value, or the largest finite number of the dtype with its sign; NaN stays."""
    largest = float(jnp.finfo(dtype).max)
    return jnp.clip(value, -largest, largest)


def choose(keep_new: Array, new, old):
    """new where the condition holds, else old, for every array of two equal pytrees."""
    return jax.tree.map(lambda a, b: jnp.where(keep_new, a, b), new, old)
