"""The pixels that a lookup between pixels looks at, and their weights; what `temporal` is made of."""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


class Place(NamedTuple):
    """Where points were: the pixel whose centre is at or before it, and the share of the way to the next.

    Attributes:
        row, column: of that pixel, (H, W), int32; beyond the frame too, by a few pixels.
        down, right: shares, (H, W), in [0, 1].
    """

    row: Array
    column: Array
    down: Array
    right: Array

    def nearest(self) -> tuple[Array, Array]:
        """Row and column of the pixel that the place is in, beyond the frame too."""
        # On the line between two pixels it is in the further one, which begins there.
        return self.row + (self.down >= 0.5), self.column + (self.right >= 0.5)


class Footprint(NamedTuple):
    """The pixels that a filter looks at, one entry each.

    Attributes:
        values: at the pixel, (H, W, C).
        weights: (H, W, 1); they sum to 1 over the entries.
    """

    values: list[Array]
    weights: list[Array]


def place(motion: ArrayLike, size: tuple[int, ...] | None = None) -> Place:
    """Where the points at the centres of pixels were; of the frame's size where that is given."""
    motion = jnp.asarray(motion, jnp.promote_types(jnp.result_type(float, motion), jnp.float32))
    if motion.ndim != 3 or motion.shape[2] != 2 or motion.shape[:2] != (size or motion.shape[:2]):
        wanted = "(H, W, 2)" if size is None else (*size, 2)
        raise ValueError(f"motion must have shape {wanted}, got {motion.shape}")
    height, width = motion.shape[:2]
    if 0 in (height, width):
        raise ValueError(f"motion must have at least one pixel, got shape {motion.shape}")
    motion = jnp.where(jnp.isnan(motion), 0, motion)
    right, across = _split(motion[..., 0], width)
    down, along = _split(motion[..., 1], height)
    rows, columns = jnp.arange(height, dtype=jnp.int32), jnp.arange(width, dtype=jnp.int32)
    return Place(rows[:, None] + along, columns + across, down, right)


def pixels(values: Array, row: Array, column: Array) -> Array:
    """Values at pixels; beyond the frame those of its edge."""
    height, width = values.shape[:2]
    return values[jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)]


# Two programs: in one, XLA computes the places anew for each array, number by number, and that takes seven
# times as long as to look up places that are an array of their own.
@jax.jit
def nearest_place(motion: ArrayLike) -> Array:
    """Which pixel each pixel's point was in, counted along the rows.

    Off the screen or unknown it is the complement, which is below 0, of the pixel of the edge next to it.
    """
    row, column = place(motion).nearest()
    height, width = row.shape
    inside = jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)
    is_off = (inside[0] != row) | (inside[1] != column) | jnp.isnan(jnp.asarray(motion)).any(axis=-1)
    found = inside[0] * width + inside[1]
    return jnp.where(is_off, ~found, found)


def at(values: Array, place: Array) -> Array:
    """What an array (H, W, ...) holds at `nearest_place`."""
    flat = values.reshape(place.size, *values.shape[2:])
    # Either the place or its complement is not below 0.
    return flat.at[place ^ (place >> 31)].get(mode="promise_in_bounds", wrap_negative_indices=False)


def look_up(history: Any, place: Array, spare: Any = None) -> Any:
    """What a tree of arrays (H, W, ...) holds at `nearest_place`.

    Args:
        history: the tree.
        place: (H, W).
        spare: a tree of the same arrays, used up: memory for the result. By default that is new.

    Raises:
        ValueError: an array has other pixels than the places.
    """
    history = jax.tree.map(jnp.asarray, history)
    for leaf in jax.tree.leaves(history):
        if leaf.shape[:2] != place.shape:
            size = f"({place.shape[0]}, {place.shape[1]}, ...)"
            raise ValueError(f"history must have the motion's shape {size}, got {leaf.shape}")
    return _looked_up(spare, history, place)


@partial(jax.jit, donate_argnames="spare", keep_unused=True)
def _looked_up(spare: Any, history: Any, place: Array) -> Any:
    return jax.tree.map(lambda values: at(values, place), history)


def footprint(
    values: Array, place: Place, first: int, kernel: Callable[[Array], Sequence[Array]]
) -> Footprint:
    """The pixels of a separable filter.

    Args:
        values: (H, W, C), converted to float32 where they are narrower.
        place: where the filter is.
        first: where its first pixel is along an axis, seen from the place's own.
        kernel: from the share of the way to the next pixel to the weights along an axis.
    """
    wide = jnp.promote_types(values.dtype, jnp.float32)
    found = Footprint([], [])
    rows, columns = kernel(place.down), kernel(place.right)
    for j, vertical in enumerate(rows, first):
        for i, horizontal in enumerate(columns, first):
            found.values.append(pixels(values, place.row + j, place.column + i).astype(wide))
            found.weights.append((vertical * horizontal)[..., None].astype(wide))
    return found


def linear(share: Array) -> tuple[Array, ...]:
    """Weights of the two pixels around a place."""
    return 1 - share, share


def spline(share: Array) -> tuple[Array, ...]:
    """Catmull-Rom's weights of the four pixels around a place, from the one before its own on."""
    t, rest = share, 1 - share
    before, after = -t * rest * rest / 2, -rest * t * t / 2
    return before, 1 + t * t * (1.5 * t - 2.5), t * (0.5 + t * (2 - 1.5 * t)), after


def total(found: Footprint) -> Array:
    """Sum of weights times values, (H, W, C)."""
    # A pixel without weight has no say, be it NaN. Finite ones stay: the derivative by the motion needs them
    # where their weight is only just 0.
    terms = (
        weight * jnp.where((weight == 0) & ~jnp.isfinite(value), 0, value)
        for value, weight in zip(*found, strict=True)
    )
    return reduce(jnp.add, terms)


def bounds(found: Footprint) -> tuple[Array, Array]:
    """The smallest and the largest value among the pixels with a weight, (H, W, C)."""
    pairs = list(zip(*found, strict=True))
    low = reduce(jnp.minimum, (jnp.where(weight == 0, jnp.inf, value) for value, weight in pairs))
    high = reduce(jnp.maximum, (jnp.where(weight == 0, -jnp.inf, value) for value, weight in pairs))
    return low, high


def _split(motion: Array, size: int) -> tuple[Array, Array]:
    """The share of a pixel in a motion along an axis, and its whole pixels."""
    # Farther off it is at the edge too, and an integer has no room for it.
    motion = jnp.clip(motion, -size, size)
    whole = jnp.floor(motion)
    return motion - whole, whole.astype(jnp.int32)
