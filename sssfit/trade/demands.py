"""What the passes of a frame demand, as the dissertation counts it: passes, pixels, samples and memory.

Of its equations: k passes of a frame (3.1); in each, pixels of which every one draws samples by some
technique (3.2); each sample reads d bytes, of which R(d) come from beyond the cache (3.3, 3.5); and of m
samples that a pixel is given m' are drawn (3.4) - here more, for pixels that go through a program together
wait for the one with the most.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.frames import _lanes, _order
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.trade import addresses, cache, machine
from sssfit.trade.texture import Texture
from sssfit.trade.warps import Schedule

#: Samples of each pixel that are replayed through the caches: the first ones find them empty.
REPLAYED = 16
#: What a sample reads at least, bytes: three numbers of light and one more.
TEXEL_BYTES = 16
# The pixels of a block and their samples in the order of `frames.scatter`: one number of all, then the next.
_ROWS, _COLUMNS = 32, _order.BLOCK // 32
_in_order = jax.jit(_order.of_segments, static_argnames="lanes")


class Demand(NamedTuple):
    """What the passes of one frame demand.

    Attributes:
        passes: one for each profile.
        frame_pixels: of the frame, times the passes.
        pixels: that are sampled.
        samples: that they are given.
        drawn: that are drawn, with those of pixels that wait for others.
        from_second: bytes that the samples drawn read from beyond the first level of caches.
        from_memory: bytes that they read from beyond the second.
    """

    passes: float
    frame_pixels: float
    pixels: float
    samples: float
    drawn: float
    from_second: float
    from_memory: float


class Fetched(NamedTuple):
    """Bytes that a sample reads from beyond each level of caches, at texels of `TEXEL_BYTES`."""

    from_second: float
    from_memory: float


def fetched(frame: Frame, profile_id: int, d: Any) -> Fetched:
    """Replay a pass through this machine's caches.

    Args:
        frame: see `gbuffer.Frame`.
        profile_id: of the pass.
        d: shape parameter of each channel, mm, (C,).

    Returns:
        R(d) of equation 3.5 for each level; 0 where the profile has no pixel.

    Source: Xie, dissertation, 2021, Section 3.3 and 7.5.

    Example:
        >>> from sssfit.frames import procedural
        >>> found = fetched(procedural.frame(width=64, height=36), 1, [1.9, 0.5, 0.2])
        >>> 0 <= found.from_memory <= found.from_second <= 64
        True
    """
    height, width = frame.depth.shape
    ids = np.asarray(frame.profile_id)
    samples = REPLAYED * int((ids == profile_id).sum())
    if samples == 0:
        return Fetched(0.0, 0.0)
    # Pixels of a block read side by side; where they read is known without their surfaces.
    caches = machine.caches()
    line = caches[0].line_bytes
    order = Schedule(units=1, resident=1, warp=(_ROWS, _COLUMNS), block=1, order="rows", line_bytes=line)
    reads = addresses.of_samples(
        frame._replace(normal=None),
        {profile_id: d, **dict.fromkeys(set(ids.ravel().tolist()) - {0, profile_id})},
        counts=REPLAYED,
        settings=Settings(distance="plane", estimator="ratio"),
        texture=Texture(height, width, texel_bytes=TEXEL_BYTES, tile=(1, 1)),
        schedule=order,
    )
    counts = cache.simulate_chunks(reads, caches)
    return Fetched(*(level.bytes_from_below / samples for level in counts))


def of_frame(
    frame: Frame,
    profiles: Mapping[int, Any],
    counts: np.ndarray,
    settings: Settings,
    fetched_by_id: Mapping[int, Fetched],
) -> Demand:
    """What `frames.scatter.every_profile` has to do.

    Args:
        frame: see `gbuffer.Frame`.
        profiles: shape parameter of each channel, mm, (C,), by profile id; None where nothing scatters.
        counts: samples of each pixel, integers, (H, W).
        settings: see `points.Settings`; without a split.
        fetched_by_id: of each profile that scatters, see `fetched`.

    Returns:
        The sum over the profiles that scatter and have a pixel; all 0 without any.

    Raises:
        KeyError: such a profile is not in `fetched_by_id`.

    Source: Xie, dissertation, 2021, Eq 3.1 to 3.5.

    Example:
        >>> from sssfit.frames import procedural
        >>> scene = procedural.frame(width=64, height=36)
        >>> profiles, counts = {1: [1.0, 0.5, 0.2], 2: None}, np.full((36, 64), 16)
        >>> found = of_frame(scene, profiles, counts, Settings(), {1: Fetched(8.0, 1.0)})
        >>> found.passes, found.samples == 16 * found.pixels, found.drawn > found.samples
        (1, True, True)
    """
    ids = np.asarray(frame.profile_id)
    # The surface's depth and slopes lie beside the light: half as many bytes more; its depth alone has room.
    texels = 1.5 if settings.distance == "surface" and frame.normal is not None else 1.0
    passes, pixels, samples, drawn, second, memory = 0, 0, 0, 0.0, 0.0, 0.0
    for profile_id, d in profiles.items():
        own = np.where(ids == profile_id, np.maximum(counts, 0), 0)
        if d is None or profile_id == 0 or not (ids == profile_id).any():
            continue
        passes += 1
        pixels += int((own > 0).sum())
        samples += int(own.sum())
        of_profile = _drawn(own)
        drawn += of_profile
        second += texels * of_profile * fetched_by_id[profile_id].from_second
        memory += texels * of_profile * fetched_by_id[profile_id].from_memory
    return Demand(passes, passes * ids.size, pixels, samples, drawn, second, memory)


def _drawn(counts: np.ndarray) -> float:
    """Samples drawn by blocks of pixels, each as many as its largest count, in lanes of which all wait."""
    lanes = _lanes.number()
    largest = np.asarray(_in_order(jnp.asarray(counts, jnp.int32), lanes=lanes)[1])
    return float(_order.BLOCK * lanes * max(largest[lane::lanes].sum() for lane in range(lanes)))
