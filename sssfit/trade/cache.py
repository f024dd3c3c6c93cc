"""Texture caches replayed access by access: who finds a line, and how many bytes come from memory.

A hierarchy is a sequence of `Level`s from the one next to the shaders down to the one before memory. Each
holds lines in sets and replaces the least recently used line of a set; the set of a line is its number modulo
the sets, without a hash. What a level does not hold is read from the next one, in the order in which it was
asked for, and from memory at last. A line is there at once: time, requests under way and sectors of a line
are not modelled, nor are writes.

Source: least recently used: Mattson, Gecsei, Slutz, Traiger, "Evaluation techniques for storage hierarchies",
1970. Which caches GPUs have: Xie, dissertation, 2021, Section 3.1.1.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sssfit.trade import _replacement

#: Accesses that are replayed together; it bounds the memory that a replay needs.
CHUNK = 1 << 21
_KIB = 1024


@dataclass(frozen=True)
class Level:
    """The caches of one level.

    Attributes:
        size_bytes: of each cache, a multiple of `line_bytes` times `ways`.
        line_bytes: of a line, >= 1; what is read from below at a time.
        ways: lines of a set, >= 1; as many as there are lines for a fully associative cache, 1 for a
            directly mapped one.
        units: how many such caches there are, each with its own share of the shaders, >= 1.

    Raises:
        ValueError: a number is not whole or below 1, or the size holds no whole number of sets.

    Example:
        >>> Level(48 * 1024, 128, 24, units=28).sets
        16
    """

    size_bytes: int
    line_bytes: int
    ways: int
    units: int = 1

    def __post_init__(self) -> None:
        """Refuse numbers out of their range, and a size that holds no whole number of sets."""
        for name in ("size_bytes", "line_bytes", "ways", "units"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
        set_bytes = self.line_bytes * self.ways
        if self.size_bytes % set_bytes:
            raise ValueError(
                f"size_bytes must be a multiple of line_bytes times ways, {set_bytes} bytes, "
                f"got {self.size_bytes}: change the size or the ways"
            )

    @property
    def sets(self) -> int:
        """Sets of each cache."""
        return self.size_bytes // (self.line_bytes * self.ways)


#: Hierarchies by the name of a GPU. From the dissertation are which levels there are and who shares them,
#: and RDNA's 16 and 128 KiB. All other numbers are assumptions:
#:
#: - "titan_x_pascal", the GPU of its simulation, has what GPGPU-Sim's configuration SM6_TITANX gives it: 28
#:   multiprocessors, a texture cache of 48 KiB with 24 ways in each, 3 MiB of 16 ways below, lines of 128
#:   bytes. Whether the dissertation changed that is not said.
#: - "turing", a T4: 40 multiprocessors, and of the memory that is cache and shared memory at once 64 KiB as
#:   cache, in lines of 128 bytes and 4 ways; 4 MiB of 16 ways below.
#: - "rdna", an RX 5700 XT: 40 computing units with 16 KiB each and 4 arrays with 128 KiB each; 4 and 16 ways,
#:   lines of 128 bytes, and 4 MiB of 16 ways below.
PRESETS: Mapping[str, tuple[Level, ...]] = MappingProxyType(
    {
        "titan_x_pascal": (
            Level(48 * _KIB, 128, 24, units=28),
            Level(3 * _KIB * _KIB, 128, 16),
        ),
        "turing": (
            Level(64 * _KIB, 128, 4, units=40),
            Level(4 * _KIB * _KIB, 128, 16),
        ),
        "rdna": (
            Level(16 * _KIB, 128, 4, units=40),
            Level(128 * _KIB, 128, 16, units=4),
            Level(4 * _KIB * _KIB, 128, 16),
        ),
    }
)


class Accesses(NamedTuple):
    """Reads in the order in which they are made.

    Attributes:
        addresses: bytes, integers from 0 on, shape (N,); a read ends within the line that it begins in.
        units: which cache of the first level reads, integers from 0 on, shape (N,).
    """

    addresses: np.ndarray
    units: np.ndarray


class Counts(NamedTuple):
    """What became of the reads of a level, all its caches together.

    Attributes:
        reads: how many there were.
        hits: those whose line was there.
        misses: those whose line was not, and was read from below.
        bytes_from_below: misses times the bytes of a line; for the last level the bytes from memory.
    """

    reads: int
    hits: int
    misses: int
    bytes_from_below: int

    @property
    def miss_rate(self) -> float:
        """Misses over reads, in [0, 1]; 0 without reads."""
        return self.misses / self.reads if self.reads else 0.0


def simulate(addresses: ArrayLike, units: ArrayLike, levels: Sequence[Level]) -> tuple[Counts, ...]:
    """Replay reads through caches that are empty at first.

    Args:
        addresses: bytes, integers >= 0, shape (N,), in the order of the reads; N may be 0. They must be
            below 2^31 times the line's bytes times the sets, for every level: 4 TiB for 16 sets of 128 bytes.
        units: which cache of the first level reads, integers, 0 to `levels[0].units` - 1, shape (N,) or one
            number for all.
        levels: from the one next to the shaders to the one before memory. The units of each are a multiple
            of those of the next, neighbours share one, and no line is longer than one of the next level.

    Returns:
        The counts of each level, exactly. One level's misses are the next one's reads.

    Raises:
        ValueError: shapes that do not fit, numbers that are not whole or out of their range, no level, or
            levels that do not follow from each other.

    Source: see the module.

    Example:
        >>> level = Level(size_bytes=256, line_bytes=64, ways=4)
        >>> simulate([0, 8, 64, 0, 640], 0, [level])[0]
        Counts(reads=5, hits=2, misses=3, bytes_from_below=192)
    """
    addresses = np.asarray(addresses)
    units = np.asarray(units)
    if addresses.ndim != 1 or units.shape not in ((), addresses.shape):
        raise ValueError(
            "addresses must have the shape (N,) and units the same or none, "
            f"got {addresses.shape} and {units.shape}"
        )
    return simulate_chunks([Accesses(addresses, np.broadcast_to(units, addresses.shape))], levels)


def simulate_chunks(chunks: Iterable[Accesses], levels: Sequence[Level]) -> tuple[Counts, ...]:
    """`simulate`, of reads that are not all in memory at once.

    Args:
        chunks: reads, one chunk after the other; how they are cut does not matter.
        levels: as for `simulate`.

    Returns:
        The counts of each level.

    Raises:
        ValueError: as `simulate`.

    Source: see the module.

    Example:
        >>> chunks = (Accesses(np.array([64 * line]), np.array([0])) for line in (0, 1, 0))
        >>> simulate_chunks(chunks, [Level(256, 64, 4)])[0].misses
        2
    """
    levels = tuple(levels)
    _check_levels(levels)
    states = [_replacement.start(level.units * level.sets, level.ways) for level in levels]
    reads, misses = np.zeros(len(levels), int), np.zeros(len(levels), int)
    for addresses, units in _checked(chunks, levels):
        for k, level in enumerate(levels):
            reads[k] += len(addresses)
            lines = addresses // level.line_bytes
            cache = units // (levels[0].units // level.units)
            states[k], hit = _replacement.replay(
                states[k], cache * level.sets + lines % level.sets, lines // level.sets
            )
            addresses, units = addresses[~hit], units[~hit]
            misses[k] += len(addresses)
    return tuple(
        Counts(int(read), int(read - miss), int(miss), int(miss) * level.line_bytes)
        for level, read, miss in zip(levels, reads, misses, strict=True)
    )


def _check_levels(levels: tuple[Level, ...]) -> None:
    if not levels:
        raise ValueError("levels must hold at least one level, got none")
    for number, (above, below) in enumerate(zip(levels, levels[1:], strict=False), 1):
        if above.units % below.units:
            raise ValueError(
                f"levels[{number}] has {below.units} units, which do not divide the {above.units} before it: "
                "give each as many caches above it as the others"
            )
        if below.line_bytes % above.line_bytes:
            raise ValueError(
                f"levels[{number}] has lines of {below.line_bytes} bytes, no multiple of the "
                f"{above.line_bytes} before it: a line must come from one line"
            )


def _checked(chunks: Iterable[Accesses], levels: tuple[Level, ...]) -> Iterable[Accesses]:
    """The same reads in int64, in chunks of bounded size."""
    limit = min(_replacement.TAGS * level.line_bytes * level.sets for level in levels)
    for addresses, units in chunks:
        for name, values, end in (("addresses", addresses, limit), ("units", units, levels[0].units)):
            if values.size and not np.issubdtype(values.dtype, np.integer):
                raise ValueError(f"{name} must be integers, got {values.dtype}")
            if values.size and not 0 <= values.min() <= values.max() < end:
                raise ValueError(f"{name} must be from 0 to {end - 1}, got {values.min()} to {values.max()}")
        if addresses.shape != units.shape:
            raise ValueError(f"addresses and units must be as many, got {addresses.shape} and {units.shape}")
        for first in range(0, len(addresses), CHUNK):
            part = slice(first, first + CHUNK)
            yield Accesses(addresses[part].astype(np.int64), units[part].astype(np.int64))
