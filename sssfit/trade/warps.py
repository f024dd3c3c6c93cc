"""In which order a GPU's threads come to read: warps of pixels, spread over multiprocessors, in turns.

A warp is a tile of pixels, and some that follow each other are a block. Blocks of warps that have something
to read are dealt out to the units, one after the other and round and round; a unit deals its own warps to as
many slots as it keeps resident, in the same way. In each turn
every slot of every unit lets its warp read once, all threads together, and goes on with its next warp where
that one is done. Units and slots take their turns in a fixed order: there is no latency and no scheduler that
would follow it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from sssfit.trade.cache import Accesses

Order = Literal["morton", "rows"]
#: Reads that are worked out together.
_WINDOW = 1 << 19


@dataclass(frozen=True)
class Schedule:
    """How threads are spread; the numbers are assumptions, see `cache.PRESETS` for those of GPUs.

    Attributes:
        units: multiprocessors that have a cache of their own, >= 1.
        resident: warps that each of them works on in turn, >= 1.
        warp: rows and columns of pixels whose threads read together, >= 1.
        block: warps that follow each other in the order and are dealt out together, >= 1: a thread block.
        order: of the tiles: "morton" for a Z-order curve, "rows" for row after row.
        line_bytes: what a warp asks for in one request: threads that read within the same so many bytes
            make one read, >= 1.

    Raises:
        ValueError: a number is not whole or below 1, or the order is not known.

    Example:
        >>> Schedule(units=2).threads
        32
    """

    units: int = 28
    resident: int = 32
    warp: tuple[int, int] = (4, 8)
    block: int = 8
    order: Order = "morton"
    line_bytes: int = 128

    def __post_init__(self) -> None:
        """Refuse numbers out of their range, and an order that is not known."""
        numbers = {"units": self.units, "resident": self.resident, "block": self.block}
        numbers |= {"line_bytes": self.line_bytes}
        numbers |= {"warp's rows": self.warp[0], "warp's columns": self.warp[1]}
        for name, value in numbers.items():
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
        if self.order not in get_args(Order):
            raise ValueError(f"order must be one of {', '.join(get_args(Order))}, got {self.order!r}")

    @property
    def threads(self) -> int:
        """Threads of a warp."""
        return self.warp[0] * self.warp[1]


class Turns(NamedTuple):
    """Requests of several turns in the order in which they are made.

    Attributes:
        warp: whose request it is, (N,), -1 for none.
        step: its number among the warp's own, from 0 on, (N,).
        unit: that makes it, (N,).
    """

    warp: np.ndarray
    step: np.ndarray
    unit: np.ndarray


def tiles(height: int, width: int, schedule: Schedule) -> np.ndarray:
    """Which pixels the warps of an image have.

    Args:
        height, width: pixels, >= 1.
        schedule: see `Schedule`.

    Returns:
        Pixels counted along the rows, int32, (warps, threads), -1 for threads beyond the image.

    Source: Morton, "A computer oriented geodetic data base", 1966.

    Example:
        >>> tiles(2, 3, Schedule(warp=(2, 2)))
        array([[ 0,  1,  3,  4],
               [ 2, -1,  5, -1]], dtype=int32)
    """
    rows, columns = schedule.warp
    down, across = -(-height // rows), -(-width // columns)
    tile_row, tile_column = np.divmod(np.arange(down * across), across)
    if schedule.order == "morton":
        along = np.argsort(_interleaved(tile_row, tile_column), kind="stable")
        tile_row, tile_column = tile_row[along], tile_column[along]
    thread_row, thread_column = np.divmod(np.arange(rows * columns), columns)
    row = tile_row[:, None] * rows + thread_row
    column = tile_column[:, None] * columns + thread_column
    return np.where((row < height) & (column < width), row * width + column, -1).astype(np.int32)


def turns(lengths: np.ndarray, schedule: Schedule) -> Iterator[Turns]:
    """All requests of warps, in order.

    Args:
        lengths: requests of each warp, integers >= 0, shape (W,), in the order in which warps are dealt out;
            those without any are left out.
        schedule: see `Schedule`.

    Returns:
        Pieces of one size but for what different lengths ask for, with gaps where a slot has run out.

    Source: own; see the module.

    Example:
        >>> found = next(turns(np.array([2, 1, 1]), Schedule(units=2, resident=1, block=1)))
        >>> found.warp[:6].tolist(), found.step[:6].tolist(), found.unit[:6].tolist()
        ([0, 1, 0, -1, 2, -1], [0, 0, 1, 0, 0, 0], [0, 1, 0, 1, 0, 1])
    """
    working = np.flatnonzero(lengths > 0)
    if len(working) == 0:
        return
    block, within = np.divmod(np.arange(len(working)), schedule.block)
    turn, unit = np.divmod(block, schedule.units)
    slot = (turn * schedule.block + within) % schedule.resident
    lanes, lane = np.unique(slot * schedule.units + unit, return_inverse=True)
    slots = len(lanes)
    in_lanes = working[np.argsort(lane, kind="stable")]
    own = np.split(in_lanes, np.cumsum(np.bincount(lane))[:-1])
    longest = max(int(lengths[mine].sum()) for mine in own)
    together = min(max(_WINDOW // (slots * schedule.threads), 1), longest)
    rounds = -(-longest // together) * together
    warp, step = np.full((rounds, slots), -1, np.int32), np.zeros((rounds, slots), np.int32)
    for slot, mine in enumerate(own):
        times = lengths[mine]
        total = int(times.sum())
        warp[:total, slot] = np.repeat(mine, times)
        step[:total, slot] = np.arange(total) - np.repeat(np.cumsum(times) - times, times)
    unit = np.tile(lanes % schedule.units, together)
    for first in range(0, rounds, together):
        part = slice(first, first + together)
        yield Turns(warp[part].ravel(), step[part].ravel(), unit)


def merged(addresses: np.ndarray, units: np.ndarray, schedule: Schedule) -> Accesses:
    """Requests as reads of distinct lines.

    Args:
        addresses: of the threads' reads, bytes, int32, (requests, reads), -1 for threads that read nothing.
        units: that make the requests, (requests,).
        schedule: see `Schedule`.

    Returns:
        One read for each line that a request needs, at the line's beginning: request after request, and in
        each from the lowest address on.

    Source: own.

    Example:
        >>> merged(np.array([[130, -1, 0, 128]]), np.array([5]), Schedule())
        Accesses(addresses=array([  0, 128]), units=array([5, 5]))
    """
    lines = np.sort(addresses // schedule.line_bytes, axis=-1)
    # Nothing is at -1 / line_bytes, which rounds down to -1.
    new = lines >= 0
    new[:, 1:] &= lines[:, 1:] != lines[:, :-1]
    return Accesses(lines[new].astype(np.int64) * schedule.line_bytes, np.repeat(units, new.sum(axis=-1)))


def _interleaved(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The bits of two numbers in turn, the column's lowest first."""
    found = np.zeros(row.shape, np.int64)
    for bit in range(31):
        found |= (column >> bit & 1) << 2 * bit | (row >> bit & 1) << (2 * bit + 1)
    return found
