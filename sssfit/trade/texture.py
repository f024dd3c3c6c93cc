"""Where the texels of an image and of its MIP levels lie in memory."""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

#: Where levels begin: multiples of it, in bytes, so that no line has texels of two levels.
ALIGNMENT = 256


@dataclass(frozen=True)
class Texture:
    """An image in memory, each MIP level after the one before.

    Texels lie in tiles, tile after tile along the rows of tiles, and row after row within a tile. A GPU's own
    order is not public; tiles as large as a line are what all have in common.

    Attributes:
        height, width: of level 0, texels, >= 1. Each level has half the size of the one before, rounded up,
            down to a single texel.
        texel_bytes: of a texel, >= 1: 8 for four half numbers, 4 for R11G11B10.
        tile: rows and columns of a tile, >= 1; (1, 1) for plain rows. 4 x 4 texels of 8 bytes fill a line of
            128 bytes.

    Raises:
        ValueError: a number is not whole or below 1, or all levels have 2^31 bytes or more.

    Example:
        >>> Texture(5, 3).sizes, Texture(5, 3).size_bytes
        (((5, 3), (3, 2), (2, 1), (1, 1)), 1024)
    """

    height: int
    width: int
    texel_bytes: int = 8
    tile: tuple[int, int] = (4, 4)

    def __post_init__(self) -> None:
        """Refuse numbers out of their range, and a texture that is too large."""
        numbers = {"height": self.height, "width": self.width, "texel_bytes": self.texel_bytes}
        numbers |= {"tile's rows": self.tile[0], "tile's columns": self.tile[1]}
        for name, value in numbers.items():
            if not isinstance(value, int) or value < 1:
                raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
        if self.size_bytes >= 2**31:
            raise ValueError(
                f"a texture must be smaller than 2^31 bytes, got {self.size_bytes}: "
                "take fewer texels, or fewer bytes for each"
            )

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """Height and width of each level, those of `frames.mipmap`."""
        sizes = [(self.height, self.width)]
        while sizes[-1] != (1, 1):
            height, width = sizes[-1]
            sizes.append((-(-height // 2), -(-width // 2)))
        return tuple(sizes)

    @property
    def starts(self) -> tuple[int, ...]:
        """Where each level begins, and where the last one ends, bytes."""
        starts = [0]
        for size in self.sizes:
            rows, columns = (-(-length // step) * step for length, step in zip(size, self.tile, strict=True))
            level_bytes = rows * columns * self.texel_bytes
            starts.append(starts[-1] + -(-level_bytes // ALIGNMENT) * ALIGNMENT)
        return tuple(starts)

    @property
    def size_bytes(self) -> int:
        """Bytes of all levels."""
        return self.starts[-1]

    @functools.partial(jax.jit, static_argnames="self")
    def address(self, level: ArrayLike, row: ArrayLike, column: ArrayLike) -> Array:
        """Where texels are.

        Args:
            level: integers, 0 for the image itself to `len(sizes) - 1`, shape (...).
            row, column: of the texel in its level, integers; beyond the level the texel of its edge is
                meant. The three broadcast.

        Returns:
            Bytes from the texture's beginning, int32, shape (...).

        Source: own.

        Example:
            >>> Texture(8, 8).address(0, [0, 1, 0], [1, 0, 4]).tolist()
            [8, 32, 128]
        """
        level, row, column = (jnp.asarray(v, jnp.int32) for v in (level, row, column))
        height, width = (jnp.asarray(side, jnp.int32)[level] for side in zip(*self.sizes, strict=True))
        start = jnp.asarray(self.starts, jnp.int32)[level]
        row, column = jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)
        rows, columns = self.tile
        tile = row // rows * -(-width // columns) + column // columns
        within = row % rows * columns + column % columns
        return start + (tile * (rows * columns) + within) * self.texel_bytes
