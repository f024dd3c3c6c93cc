"""Prefiltered copies of a frame at half the size each, in which only the masked pixels count.

A texel holds the mean over its square of the frame's values times the mask, and the mean of the mask itself:
the coverage. Pixels outside the mask and places beyond the frame's edge count as nothing, so that no
background and no other profile bleeds in, and no pixel of an odd size is lost or counted twice: 4^l times the
sum over level l is the sum over the frame. A lookup blends both means and divides at the end.

Source: Williams, "Pyramidal parametrics", 1983; premultiplied coverage: Porter and Duff, "Compositing digital
images", 1984.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


class Mipmap(eqx.Module):
    """A frame and its prefiltered levels; see the module's text.

    Attributes:
        texels: all levels one after the other, rows first, shape (N, C + 1): values times coverage, then the
            coverage, in [0, 1].
        sizes: height and width of each level; level 0 is the frame.
    """

    texels: Array
    sizes: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def level(self, number: int) -> Array:
        """The texels of one level, shape (height, width, C + 1)."""
        starts = _starts(self.sizes)
        height, width = self.sizes[number]
        first = starts[number]
        return self.texels[first : first + height * width].reshape(height, width, -1)


class Filtered(NamedTuple):
    """What a lookup finds.

    Attributes:
        values: mean of the masked pixels in the filter's footprint, shape (..., C); 0 where there are none.
        coverage: share of the footprint that they fill, in [0, 1], shape (...). values times coverage is the
            mean with everything else counted as 0.
    """

    values: Array
    coverage: Array


def build(values: ArrayLike, mask: ArrayLike, levels: int | None = None) -> Mipmap:
    """The levels of a frame, each of half the size (rounded up) of the one before.

    Args:
        values: the frame, shape (H, W, C). What it holds outside the mask does not matter, NaN included.
        mask: which pixels count, boolean, shape (H, W); or their weights in [0, 1].
        levels: how many, the frame itself included; None, and at most, down to a single texel.

    Returns:
        The mipmap, in the values' dtype.

    Raises:
        ValueError: shapes that do not fit, an empty frame, or fewer than one level.

    Source: see the module.

    Example:
        >>> mipmap = build(jnp.full((3, 5, 3), 2.0), jnp.ones((3, 5), bool))
        >>> mipmap.sizes, mipmap.level(3).tolist()
        (((3, 5), (2, 3), (1, 2), (1, 1)), [[[0.46875, 0.46875, 0.46875, 0.234375]]])
    """
    dtype = jnp.result_type(float, values)
    wide = jnp.promote_types(dtype, jnp.float32)
    values, mask = jnp.asarray(values, wide), jnp.asarray(mask)
    if values.ndim != 3 or mask.shape != values.shape[:2]:
        raise ValueError(
            f"values must have shape (H, W, C) and mask (H, W), got {values.shape} and {mask.shape}"
        )
    if 0 in mask.shape:
        raise ValueError(f"values must have at least one pixel, got shape {values.shape}")
    if levels is not None and levels < 1:
        raise ValueError(f"levels must be at least 1, got {levels}")
    weight = mask.astype(wide)[..., None]
    # Chosen, not multiplied: 0 times NaN is NaN.
    chain = [jnp.concatenate([jnp.where(weight > 0, values, 0) * weight, weight], axis=-1)]
    full = max(mask.shape[0] - 1, mask.shape[1] - 1).bit_length() + 1
    for _ in range(1, full if levels is None else min(levels, full)):
        chain.append(_halved(chain[-1]))
    texels = jnp.concatenate([level.reshape(-1, level.shape[-1]) for level in chain])
    return Mipmap(texels.astype(dtype), tuple((level.shape[0], level.shape[1]) for level in chain))


def lookup(mipmap: Mipmap, column: ArrayLike, row: ArrayLike, level: ArrayLike) -> Filtered:
    """The frame around a place, filtered: bilinear in the two nearest levels and linear between them.

    Args:
        mipmap: from `build`.
        column, row: the place in pixels of the frame, shape (...); pixel (i, j) has its centre at
            (i + 0.5, j + 0.5). Beyond the frame nothing is covered.
        level: 0 for the frame itself; it is moved into the levels that there are. The three broadcast.

    Returns:
        `Filtered`, in the mipmap's dtype. Level 0 at the centre of a masked pixel gives that pixel itself.

    Example:
        >>> mipmap = build(jnp.array([[[1.0], [9.0]]]), jnp.array([[True, False]]))
        >>> [field.tolist() for field in lookup(mipmap, 1.0, 0.5, 0.0)]
        [[1.0], 0.5]
    """
    found = premultiplied(mipmap, column, row, level)
    total, coverage = found[..., :-1], found[..., -1]
    covered = coverage[..., None] != 0
    values = jnp.where(covered, total / jnp.where(covered, coverage[..., None], 1), 0)
    return Filtered(values.astype(mipmap.texels.dtype), coverage.astype(mipmap.texels.dtype))


def premultiplied(mipmap: Mipmap, column: ArrayLike, row: ArrayLike, level: ArrayLike) -> Array:
    """What `lookup` finds before it divides: values times coverage, then the coverage.

    Args:
        mipmap, column, row, level: as for `lookup`.

    Returns:
        Shape (..., C + 1), float32 or the mipmap's dtype, whichever is wider: the mean over the footprint
        with everything else counted as 0.

    Source: see the module.

    Example:
        >>> mipmap = build(jnp.array([[[1.0], [9.0]]]), jnp.array([[True, False]]))
        >>> premultiplied(mipmap, 1.0, 0.5, 0.0).tolist()
        [0.5, 0.5]
    """
    # A place needs more digits than a colour in half precision.
    wide = jnp.promote_types(mipmap.texels.dtype, jnp.float32)
    column, row, level = jnp.broadcast_arrays(*(jnp.asarray(a, wide) for a in (column, row, level)))
    last = len(mipmap.sizes) - 1
    level = jnp.clip(level, 0, last)
    fine = jnp.floor(level).astype(jnp.int32)
    fraction = (level - fine)[..., None]
    # At the last level the next one is itself, with weight 0.
    coarse = _bilinear(mipmap, column, row, jnp.minimum(fine + 1, last))
    return (1 - fraction) * _bilinear(mipmap, column, row, fine) + fraction * coarse


def _halved(level: Array) -> Array:
    """Means over 2 x 2 texels; nothing lies beyond the edge of an odd size."""
    height, width = level.shape[:2]
    level = jnp.pad(level, ((0, height % 2), (0, width % 2), (0, 0)))
    return (level[0::2, 0::2] + level[0::2, 1::2] + level[1::2, 0::2] + level[1::2, 1::2]) / 4


def _bilinear(mipmap: Mipmap, column: Array, row: Array, level: Array) -> Array:
    """Values times coverage, and coverage, at a place in one level, shape (..., C + 1)."""
    heights, widths = (jnp.asarray(size, jnp.int32) for size in zip(*mipmap.sizes, strict=True))
    height, width = heights[level], widths[level]
    start = jnp.asarray(_starts(mipmap.sizes), jnp.int32)[level]
    scale = jnp.asarray([0.5**number for number in range(len(mipmap.sizes))], column.dtype)[level]
    left, right_share = _cell(column * scale, width)
    upper, lower_share = _cell(row * scale, height)
    total = 0.0
    for down, vertical in ((0, 1 - lower_share), (1, lower_share)):
        for across, horizontal in ((0, 1 - right_share), (1, right_share)):
            i, j = left + across, upper + down
            inside = (i >= 0) & (i < width) & (j >= 0) & (j < height)
            texel = mipmap.texels[start + jnp.clip(j, 0, height - 1) * width + jnp.clip(i, 0, width - 1)]
            total = total + (vertical * horizontal * inside)[..., None] * texel
    return jnp.asarray(total)


def _cell(place: Array, size: Array) -> tuple[Array, Array]:
    """The texel whose centre is at or before a place, and the share of the texel after it."""
    # Farther off nothing is covered either, and an integer has no room for it.
    place = jnp.clip(place - 0.5, -1, size)
    before = jnp.floor(place)
    return before.astype(jnp.int32), place - before


def _starts(sizes: tuple[tuple[int, int], ...]) -> list[int]:
    """Where each level begins among the texels."""
    starts = [0]
    for height, width in sizes[:-1]:
        starts.append(starts[-1] + height * width)
    return starts
