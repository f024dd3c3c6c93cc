"""What is remembered of the pixels, looked up where their points were, and the memory that it is kept in."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames import _footprint, _lanes, _spare, temporal
from sssfit.frames.gbuffer import Frame


def looked_up(
    memory: Any, seen: tuple[Array, Array], frame: Frame, depth_tolerance: ArrayLike
) -> tuple[Any, Array, bool]:
    """What was remembered of the pixels' points, and of which nothing was.

    Args:
        memory: after the frame before, a tree of (H, W).
        seen: depth and profile ids of that frame.
        frame: the new one.
        depth_tolerance: see `temporal.disoccluded`.

    Returns:
        The memory at the points, whether it is missing, and whether it is for `give_back`.
    """
    now = frame.depth, frame.profile_id
    if frame.motion is None:
        return memory, _missing(now, seen, None, depth_tolerance), False
    place = _footprint.nearest_place(frame.motion)
    missing = _missing(now, seen, place, depth_tolerance)
    given = memory, place
    spare = None if _lanes.is_traced(given) else _spare.take("memory", memory, given)
    return _footprint.look_up(memory, place, spare), missing, spare is not None


def give_back(memory: Any) -> None:
    """Keep what was looked up for the next frame to be written over; nobody uses it again."""
    _spare.keep("memory", memory)


def check_spare(spare: Any, memory: Any) -> None:
    """Refuse a policy's memory that cannot be written over with the one after another."""
    given, used = jax.tree.leaves(spare), jax.tree.leaves(memory)
    if jax.tree.structure(spare) != jax.tree.structure(memory) or any(
        (jnp.shape(a), jnp.result_type(a)) != (jnp.shape(b), jnp.result_type(b))
        for a, b in zip(given, used, strict=True)
    ):
        raise ValueError("spare must be a state of the same sequence, with the same policy, size and history")
    if any(a is b for a in given for b in used):
        raise ValueError("spare must be another state than the one that the step begins with")
    if any(isinstance(leaf, Array) and leaf.is_deleted() for leaf in given):
        raise ValueError("spare must not have been given before: its memory is gone")


@jax.jit
def _missing(now: tuple, then: tuple, place: Array | None, depth_tolerance: ArrayLike) -> Array:
    """As `temporal.disoccluded`, at places that are known."""
    if place is not None:
        then = _footprint.at(then[0], place), _footprint.at(then[1], place)
    (depth, number), (seen_depth, seen_number) = now, then
    lost = temporal.disoccluded(depth, number, seen_depth, seen_number, None, depth_tolerance=depth_tolerance)
    return lost if place is None else lost | (place < 0)
