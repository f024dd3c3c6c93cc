"""Where the results of a loop's steps lie that are used more than once, or that lookups wait for.

On a CPU, XLA fuses a lookup with the arithmetic of its place, and computes both number by number; it computes
again what several results need; and what reads from a whole frame it splits among its threads, though each
lane of a pass has one thread, and lanes then wait for each other. A result that is written into a row of a
larger array is spared all three: that is what `keep` does.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

Keep = Callable[[Array], Array]


def rows(step: Callable, *arguments: Any) -> list[Array]:
    """Arrays for what `step(keep, *arguments)` keeps, to begin a loop with."""

    def kept(*arguments):
        found = []

        def keep(value):
            found.append(value)
            return value

        step(keep, *arguments)
        return found

    return [_empty(row) for row in jax.eval_shape(kept, *arguments)]


def at_work(step: Callable, rows: list[Array], *arguments: Any) -> tuple[Any, list[Array]]:
    """The result of `step(keep, *arguments)`, and the rows for the next step."""
    written: list[Array] = []

    def keep(value):
        row = rows[len(written)]
        with _wide(row):
            # Places of 32 bits, whatever the width of the numbers.
            place = jnp.int32(1), *[jnp.int32(0)] * value.ndim
            row = jax.lax.dynamic_update_slice(row, value[None], place)
            written.append(row)
            return jax.lax.index_in_dim(row, 1, keepdims=False)

    return step(keep, *arguments), written


def _empty(row) -> Array:
    with _wide(row):
        return jnp.zeros((2, *row.shape), row.dtype)


def _wide(row):
    # Words of 64 bits stay what they are where JAX else makes 32 of them.
    return jax.enable_x64(row.dtype.itemsize == 8 or jax.config.read("jax_enable_x64"))
