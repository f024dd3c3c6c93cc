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
    found, is_kept = _at("seen", seen, place)
    missing = _missing(now, found, frame.motion, depth_tolerance)
    if is_kept:
        _spare.keep("seen", found)
    found, is_kept = _at("memory", memory, place)
    return found, missing, is_kept


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


def _at(use: str, history: Any, place: Array) -> tuple[Any, bool]:
    """A history at places, in memory that is to be given back; or, where there is none, in new one."""
    given = history, place
    spare = None if _lanes.is_traced(given) else _spare.take(use, history, given)
    return _footprint.look_up(history, place, spare), spare is not None


@jax.jit
def _missing(now: tuple, seen: tuple, motion: Array | None, depth_tolerance: ArrayLike) -> Array:
    """As `temporal.disoccluded`; what was seen at the points is looked up."""
    (depth, number), (seen_depth, seen_number) = now, seen
    lost = temporal.disoccluded(depth, number, seen_depth, seen_number, None, depth_tolerance=depth_tolerance)
    return lost if motion is None else lost | temporal.off_screen(motion)
