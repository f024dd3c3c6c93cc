"""The memory of one pass's scene, kept for the next.

An operating system hands a CPU's program large arrays page by page, as they are first written to, and that
takes longer than to fill them. So a pass writes its scene over that of the pass before, if it is as large.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

#: Bytes of the largest array that is kept: room for frames of 3840 x 2160.
_LARGEST = 2**28
#: At most one, so that frames of many sizes do not pile up; taken out while a pass writes to it.
_kept: dict[Any, Array] = {}


def take(shape: jax.ShapeDtypeStruct, beside: Any) -> Array | None:
    """An array of this shape and type with any values, for the pass to be given as its own.

    Args:
        shape: what is wanted.
        beside: arrays that the pass reads, on the device where it runs.

    Returns:
        None where nothing is gained: on a device that hands out memory of its own, where arrays lie on
        several devices, or for an array that is too large to be kept.
    """
    leaves = [leaf for leaf in jax.tree.leaves(beside) if isinstance(leaf, Array)]
    devices = {device for leaf in leaves for device in leaf.devices()}
    if shape.size * shape.dtype.itemsize > _LARGEST or {device.platform for device in devices} != {"cpu"}:
        return None
    if len(devices) > 1:
        return None
    (device,) = devices
    # An array that is bound to its device binds what is computed from it, too.
    bound = any(leaf.committed for leaf in leaves)
    found = _kept.pop((shape.shape, shape.dtype, device, bound), None)
    if found is not None:
        return found
    with jax.enable_x64(shape.dtype.itemsize == 8), jax.default_device(device):
        return jnp.zeros(shape.shape, shape.dtype)


def keep(array: Array) -> None:
    """Give back what was taken; the caller does not use it again."""
    (device,) = array.devices()
    _kept.clear()
    _kept[array.shape, array.dtype, device, array.committed] = array
