"""The least recently used line of each set replaced, for all sets at once.

Sets know nothing of each other: the reads of each are put in a column of their own, in order, and a scan goes
down all columns together. It carries the lines of each set from the most recently used one on.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

#: Tags are below it, and -1 where a way is empty.
TAGS = 2**31
#: Entries of a piece of columns that are scanned in one go.
_PIECE = 1 << 19


def start(sets: int, ways: int) -> Array:
    """Empty sets, (ways, sets), int32."""
    return jnp.full((ways, sets), -1, jnp.int32)


def replay(tags: Array, sets: np.ndarray, wanted: np.ndarray) -> tuple[Array, np.ndarray]:
    """Read tags from sets.

    Args:
        tags: what the sets hold, (ways, sets), used up.
        sets: which set each read goes to, integers, (N,).
        wanted: the tag that it asks for, integers from 0 to `TAGS` - 1, (N,).

    Returns:
        What the sets hold then, and whether each read was a hit, boolean, (N,).

    It takes as many steps as the busiest set has reads, some microseconds each; sets that are done are left
    out but for the last few.
    """
    hit = np.ones(len(sets), bool)
    order = _by_set(sets, tags.shape[1])
    sets, wanted = sets[order], wanted[order].astype(np.int32)
    # A set that is asked for the same line again has it, and stays as it is.
    again = np.zeros(len(sets), bool)
    again[1:] = (sets[1:] == sets[:-1]) & (wanted[1:] == wanted[:-1])
    order, sets, wanted = order[~again], sets[~again], wanted[~again]
    lengths = np.bincount(sets, minlength=tags.shape[1])
    first = np.cumsum(lengths) - lengths
    by_length = np.argsort(-lengths, kind="stable")
    lengths, first = lengths[by_length], first[by_length]
    row = 0
    while len(lengths) and row < lengths[0]:
        # The sets that are not done come first.
        columns = min(_few_sizes(int(np.count_nonzero(lengths > row))), len(lengths))
        rows = min(_few_sizes(int(lengths[0]) - row), 1024, max(_PIECE // columns, 1))
        which = np.arange(row, row + rows)[:, None]
        there = which < lengths[:columns]
        at = np.where(there, first[:columns] + which, 0)
        asked = np.where(there, wanted[at], -1)
        tags, found = _scanned(tags, by_length[:columns].astype(np.int32), asked)
        hit[order[at[there]]] = np.asarray(found)[there]
        row += rows
    return tags, hit


def _few_sizes(wanted: int) -> int:
    """64 or a multiple that holds what is wanted; few of them, for each is a program of its own."""
    size = 64
    while size < wanted:
        size *= 16
    return size


def _by_set(sets: np.ndarray, many: int) -> np.ndarray:
    """Places of the reads, set by set and in order within each."""
    # NumPy sorts words of 16 bits by their digits, ten times as fast as longer ones by comparison.
    order = np.argsort((sets & 0xFFFF).astype(np.uint16), kind="stable")
    if many > 1 << 16:
        order = order[np.argsort((sets[order] >> 16).astype(np.uint16), kind="stable")]
    return order


@functools.partial(jax.jit, donate_argnames="tags")
def _scanned(tags: Array, columns: Array, asked: Array) -> tuple[Array, Array]:
    """The sets after the reads of some of them, (rows, columns), -1 for none; and which were hits."""
    ways = jnp.arange(len(tags), dtype=jnp.int32)[:, None]

    def step(held, tag):
        # A set holds a line once: the sum is the way that has it, from 1 on, and 0 for none.
        place = jnp.sum(jnp.where(held == tag, ways + 1, 0), axis=0)
        hit = place > 0
        # The ways before the line, or all, move on by one; nothing moves where nothing is read.
        last = jnp.where(tag < 0, -1, jnp.where(hit, place - 1, len(held) - 1))
        moved = jnp.concatenate([tag[None], held[:-1]])
        return jnp.where(ways <= last, moved, held), hit

    held, hits = jax.lax.scan(step, tags[:, columns], asked)
    return tags.at[:, columns].set(held, unique_indices=True), hits
