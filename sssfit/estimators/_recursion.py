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
    if isinstance(alpha, int | float | np.ndarray | np.generic):
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
    new, left = toward(mean, alpha * delta, low)
    if left is not None:
        return jnp.where(alpha == 1, x, new), jnp.where(alpha == 1, 0, left)
    # With alpha = 1 nothing of the old is left, NaN and inf included.
    gap = jnp.where((alpha == 1) & ~jnp.isfinite(delta), 0, delta)
    return jnp.where(alpha > 0.5, x - (1 - alpha) * gap, new), None


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
    if left is None:
        return jnp.where(alpha > 0.5, fades, stays), None
    return jnp.where(alpha == 1, fades, stays), jnp.where((alpha == 1) | jnp.isinf(stays), 0, left)


def debias_step(debias: Array, alpha: Array, low: Array | None = None):
    """1 - sum of the squared weights, after one more sample: no difference of near numbers in it."""
    kept = 1 - alpha
    if low is None:
        fades = kept * (2 * alpha + kept * debias)
        grows = debias + alpha * (2 * kept - (2 - alpha) * debias)
        return jnp.where(alpha > 0.5, fades, grows), None
    return toward(debias, alpha * (2 * kept - (2 - alpha) * (debias + low)), low)


def store(values: Sequence[tuple[Array, Array | None]], dtype) -> tuple[Array, ...]:
    """Values, the first of each pair, rounded to the dtype that they are kept in."""
    return tuple(value.astype(dtype) for value, _ in values)


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
