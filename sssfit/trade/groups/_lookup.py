"""What the groups of tables share: entries as files store them, linear lookup, and its error."""

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.tables.formats import encoded
from sssfit.tables.table import Table
from sssfit.trade.choice import Choice, Error, Task

#: What a table's error is, and against what.
ERROR = "root mean square error in units of each channel's largest value"
_FORMATS = ("float", "half", "8-bit")
#: Entries of tables with one axis, for a first look.
QUICK_LINES = (64, 512)
#: What the choices of every table call.
STANDS_FOR = tuple(f"tables.formats.encoded.{name}" for name in ("store", "quantize", "restore"))
_QUICK_LOOKUPS, _LOOKUPS = 2**18, 2**20


class Places(NamedTuple):
    """Where tables are looked up.

    Attributes:
        coordinates: along each axis, float32, (n,).
        exact: values there, float64, (m, channels): of the first m places, after which they begin anew.
    """

    coordinates: tuple[Array, ...]
    exact: np.ndarray

    def error(self, found: Array) -> Error:
        """Of values that were found at the places, (n, channels)."""
        off = np.asarray(found[: len(self.exact)], np.float64) - self.exact
        return Error(float(np.sqrt(np.mean(np.square(off / np.max(np.abs(self.exact), axis=0))))))


def places(
    evaluate: Callable[..., np.ndarray],
    ends: Sequence[tuple[float, float]],
    numbers: Sequence[int],
    is_quick: bool,
) -> Places:
    """Places on a grid in random order, each of which is met several times.

    Args:
        evaluate: exact values on the grid of coordinates along each axis.
        ends: of each axis.
        numbers: of different coordinates along each axis, one at random in each of as many equal parts.
        is_quick: fewer places.
    """
    random = np.random.default_rng(0)
    parts = [(np.arange(number) + random.random(number)) / number for number in numbers]
    axes = [
        (low + part * (high - low)).astype(np.float32) for part, (low, high) in zip(parts, ends, strict=True)
    ]
    exact = evaluate(*(axis.astype(np.float64) for axis in axes))
    order = random.permutation(math.prod(numbers))
    every = _QUICK_LOOKUPS if is_quick else _LOOKUPS
    given = (
        jax.device_put(np.resize(grid.ravel()[order], every)) for grid in np.meshgrid(*axes, indexing="ij")
    )
    return Places(tuple(given), exact.reshape(len(order), -1)[order])


def choices(make: Callable[[int], Table], sizes: Sequence[int], at: Places, default: int) -> Iterator[Choice]:
    """A choice for each number of entries along an axis and each format."""
    for size in sizes:
        table = make(size)
        for stored in _FORMATS:
            yield _choice(table, size, stored, at, (size, stored) == (default, "float"))


def task(made: Iterable[Choice], at: Places) -> Task:
    """A group's task at the places."""
    number = len(at.coordinates[0])
    return Task(number, tuple(made), f"{number} lookups at {len(at.exact)} random places between the ends")


def _choice(table: Table, size: int, stored: str, at: Places, is_default: bool) -> Choice:
    kept = encoded.store(table, stored)
    # Eight bits are restored by one multiply-add, which goes through linear lookup unchanged.
    low, next_ = encoded.restore(np.arange(2, dtype=kept.values.dtype), kept.metadata)
    ends = tuple((float(axis.values[0]), float(axis.values[-1])) for axis in table.axes)
    entries = jax.device_put(kept.values)
    look_up = functools.partial(_looked_up, ends=ends, mapping=(float(low), float(next_ - low)))
    reads = 2 ** len(table.axes) * len(table.channels) * kept.values.dtype.itemsize
    return Choice(
        name=f"{size if len(ends) == 1 else f'{size} x {size}'}, {stored}",
        knobs={"num_entries": size, "stored": stored, "table_bytes": kept.values.nbytes},
        run=lambda: jax.block_until_ready(look_up(at.coordinates, entries)),
        error=lambda: at.error(look_up(at.coordinates, entries)),
        bytes_moved=4 * (len(ends) + len(table.channels)) + reads,
        is_default=is_default,
    )


@functools.partial(jax.jit, static_argnames=("ends", "mapping"))
def _looked_up(coordinates: tuple[Array, ...], entries: Array, ends, mapping: tuple[float, float]) -> Array:
    """Values at coordinates, (n, channels), linear between entries along each axis."""
    cells, parts = [], []
    for coordinate, (first, last), size in zip(coordinates, ends, entries.shape, strict=False):
        place = (coordinate - first) * ((size - 1) / (last - first))
        cells.append(jnp.clip(place.astype(jnp.int32), 0, size - 2))
        parts.append((place - cells[-1])[:, None])

    def between(*at: Array) -> Array:
        if len(at) == len(cells):
            return entries[at].astype(jnp.float32)
        below, above = (between(*at, cells[len(at)] + i) for i in (0, 1))
        return below + parts[len(at)] * (above - below)

    return mapping[0] + mapping[1] * between()
