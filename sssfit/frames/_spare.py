"""The memory of one frame's arrays, kept for the next.

An operating system hands a CPU's program large arrays page by page, as they are first written to, and that
takes longer than to fill them. So a pass writes its scene over that of the pass before, if it is as large,
and so does what else a frame needs for itself alone.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

#: Bytes of the largest array that is kept: room for frames of 3840 x 2160.
_LARGEST = 2**28
#: At most one tree of arrays for each use, so that frames of many sizes do not pile up; taken out while it is
#: written to.
_kept: dict[str, tuple[Any, Any]] = {}


def take(use: str, shapes: Any, beside: Any) -> Any:
    """Arrays of these shapes and types with any values, for a program to be given as its own.

    Args:
        use: what for.
        shapes: what is wanted, a tree of arrays or `jax.ShapeDtypeStruct`.
        beside: arrays that the program reads, on the device where it runs.

    Returns:
        A tree; None where nothing is gained: on a device that hands out memory of its own, where arrays lie
        on several devices, or for an array that is too large to be kept.
    """
    leaves = [leaf for leaf in jax.tree.leaves(beside) if isinstance(leaf, Array)]
    devices = {device for leaf in leaves for device in leaf.devices()}
    sizes = [leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(shapes)]
    if max(sizes, default=0) > _LARGEST or {device.platform for device in devices} != {"cpu"}:
        return None
    if len(devices) > 1:
        return None
    (device,) = devices
    # An array that is bound to its device binds what is computed from it, too.
    bound = any(leaf.committed for leaf in leaves)
    wanted, found = _key(shapes, device, bound), _kept.pop(use, None)
    if found is not None and found[0] == wanted:
        return found[1]
    wide = any(leaf.dtype.itemsize == 8 for leaf in jax.tree.leaves(shapes))
    with jax.enable_x64(wide), jax.default_device(device):
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)


def keep(use: str, arrays: Any) -> None:
    """Give back what was taken; the caller does not use it again."""
    leaves = jax.tree.leaves(arrays)
    if leaves:
        (device,) = leaves[0].devices()
        _kept[use] = _key(arrays, device, any(leaf.committed for leaf in leaves)), arrays


def _key(shapes: Any, device: Any, bound: bool) -> Any:
    leaves, structure = jax.tree.flatten(shapes)
    return structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves), device, bound
