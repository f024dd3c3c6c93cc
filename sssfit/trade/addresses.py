"""What a frame's passes read from their texture, in the order in which a GPU would: food for `cache`.

The samples are those of `frames.scatter`, drawn by its own code: what is replayed is what would be read. The
texture alone is read, and that of the light, whose texels can be as large as whatever a sample needs: that
depth or normals are textures of their own, counts and results written, is not in it.
"""

import functools
from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from sssfit.frames import scatter
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.trade import _samples, warps
from sssfit.trade.cache import Accesses
from sssfit.trade.texture import Texture
from sssfit.trade.warps import Schedule

Filter = Literal["nearest", "bilinear"]

DEFAULT = Schedule()


def of_samples(
    frame: Frame,
    profiles: Mapping[int, Any],
    *,
    counts: ArrayLike,
    settings: Settings = scatter.DEFAULT,
    level: int | None = None,
    filtering: Filter = "nearest",
    texture: Texture | None = None,
    schedule: Schedule = DEFAULT,
    seed: int = 0,
    number: int = 0,
) -> Iterator[Accesses]:
    """Reads of the passes of `frames.scatter.every_profile`, one profile after the other.

    A thread is a pixel, and sample i of all threads of a warp one request. A warp goes on until its last
    thread has its samples; threads that are done, and samples beyond the frame, read nothing.

    Args:
        frame: see `gbuffer.Frame`.
        profiles: shape parameter of each channel, mm, (C,), by profile id; None where nothing scatters.
        counts: samples of each pixel, integers, (H, W) or one number: fixed or adaptive; 0 for pixels that
            are left out.
        settings: see `points.Settings`.
        level: the MIP level that all samples read, from 0 on. None: as `settings.prefilter` says, in two
            levels and bilinear in both, or else level 0.
        filtering: of a given level: "nearest" for the texel in which a sample falls, "bilinear" for the four
            around it.
        texture: that is read, of the frame's size; by default one of 8 bytes a texel in tiles of 4 x 4.
        schedule: see `warps.Schedule`; its units must be those of the first level of caches.
        seed, number: as for `every_profile`.

    Returns:
        Chunks of reads for `cache.simulate_chunks`, made while they are used.

    Raises:
        ValueError: an unknown setting; a level that the texture has not, a texture of another size, or a
            normal that is missing.

    Source: Xie, dissertation, 2021, Section 7.5: reads of the irradiance, fixed and adaptive, by MIP level.

    Example:
        >>> from sssfit.frames import procedural
        >>> scene = procedural.frame(width=64, height=36)
        >>> reads = of_samples(scene, {1: [1.0, 0.5, 0.3], 2: None}, counts=4)
        >>> 0 < sum(len(chunk.addresses) for chunk in reads) <= 4 * int((scene.profile_id == 1).sum())
        True
    """
    settings.check()
    height, width = frame.depth.shape
    texture = Texture(height, width) if texture is None else texture
    if (texture.height, texture.width) != (height, width):
        raise ValueError(
            f"texture must have the frame's size {height} x {width}, got {texture.height} x {texture.width}"
        )
    if level is not None and not 0 <= level < len(texture.sizes):
        raise ValueError(f"level must be from 0 to {len(texture.sizes) - 1} or None, got {level}")
    if filtering not in get_args(Filter):
        raise ValueError(f"filtering must be one of {', '.join(get_args(Filter))}, got {filtering!r}")
    if level is None and settings.prefilter is None:
        level = 0
    read = functools.partial(
        _samples.addresses, settings=settings, texture=texture, bilinear=filtering == "bilinear"
    )
    most = int(np.max(np.asarray(counts), initial=0))
    wanted = jnp.broadcast_to(jnp.asarray(counts, jnp.int32), (height, width))

    def every_profile():
        for profile_id, d in profiles.items():
            mask = jnp.asarray(frame.profile_id) == profile_id
            if profile_id != 0 and d is not None and bool(mask.any()):
                d = jnp.asarray(d, jnp.float32)
                of = _samples.prepared(frame, d, mask, wanted, most, settings, seed, number)
                yield from _of_profile(of, functools.partial(read, of, level=level), texture, schedule)

    return every_profile()


def of_transform(texture: Texture, *, columns: int = 1, schedule: Schedule = DEFAULT) -> Iterator[Accesses]:
    """Reads of one two-dimensional Fourier transform of the texture's level 0: all rows, then all columns.

    A warp transforms a row in the memory that its threads share, and reads each texel once, as many at a time
    as it has threads; then columns in the same way. What it writes is not counted, and the second pass reads
    the same places as the first wrote. A convolution has two transforms for each channel.

    Args:
        texture: see `texture.Texture`; 8 bytes a texel are a complex number of two float32. Pad it to the
            size that is transformed.
        columns: neighbouring columns that a warp transforms together, a divisor of the warp's threads: with
            as many as a line has, lines are not read again for each of their columns.
        schedule: see `warps.Schedule`.

    Returns:
        Chunks of reads for `cache.simulate_chunks`, made while they are used.

    Raises:
        ValueError: `columns` does not divide the threads.

    Source: the row-column algorithm; the order is an assumption.

    Example:
        >>> rows, columns = of_transform(Texture(32, 32, tile=(1, 1)))
        >>> len(rows.addresses), len(columns.addresses)
        (64, 1024)
    """
    threads = schedule.threads
    if columns < 1 or threads % columns:
        raise ValueError(f"columns must divide the warp's threads, {threads}, got {columns}")

    def both_passes():
        yield from _along_rows(texture.height, texture.width, 1, texture.address, schedule)
        turned = functools.partial(_transposed, texture)
        yield from _along_rows(texture.width, texture.height, columns, turned, schedule)

    return both_passes()


def _along_rows(rows: int, columns: int, together: int, address, schedule: Schedule) -> Iterator[Accesses]:
    """Reads of rows from their beginnings on; a warp has some neighbouring ones together."""
    line, along = np.divmod(np.arange(schedule.threads), schedule.threads // together)
    requests = -(-columns * together // schedule.threads)
    for found in warps.turns(np.full(-(-rows // together), requests), schedule):
        row = found.warp[:, None] * together + line
        column = found.step[:, None] * (schedule.threads // together) + along
        used = (found.warp[:, None] >= 0) & (row < rows) & (column < columns)
        asked = np.where(used, np.asarray(address(0, row, column)), -1)
        yield warps.merged(asked, found.unit, schedule)


def _transposed(texture: Texture, level, row, column):
    return texture.address(level, column, row)


def _of_profile(of, read, texture, schedule) -> Iterator[Accesses]:
    """Reads of one profile's pass."""
    pixels = warps.tiles(texture.height, texture.width, schedule)
    counts = np.where(pixels >= 0, of.counts[pixels], 0)
    places = np.where(counts > 0, of.places[pixels], -1)
    for found in warps.turns(counts.max(axis=1), schedule):
        place = np.where(found.warp[:, None] >= 0, places[found.warp], -1)
        address = read(place=place, number=found.step[:, None])
        yield warps.merged(np.asarray(address), found.unit, schedule)
