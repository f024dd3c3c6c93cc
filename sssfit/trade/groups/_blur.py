"""Blurs along rows and along columns: taps between pixels, read linearly."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from sssfit.trade.groups._kernels import Kernels


def blurred(image: Array, kernels: Kernels, pixel: float) -> Array:
    """An image (H, W, 3) blurred along both of its axes; it is dark beyond its edge.

    Args:
        image: linear.
        kernels: see `Kernels`.
        pixel: its width and height, mm.
    """
    offsets = kernels.offsets / pixel
    given = (np.asarray(part, np.float32) for part in (kernels.shares, offsets, kernels.weights))
    return _blurred(image, Kernels(*given), math.ceil(np.max(np.abs(offsets))))


@functools.partial(jax.jit, static_argnames="reach")
def _blurred(image: Array, kernels: Kernels, reach: int) -> Array:
    def channel(given):
        plane, offsets, weights = given

        def add(total, kernel):
            share, at, weight = kernel
            once = _along(plane, at, weight, reach, axis=0)
            return total + share * _along(once, at, weight, reach, axis=1), None

        return lax.scan(add, jnp.zeros_like(plane), (kernels.shares, offsets, weights))[0]

    channels = (jnp.moveaxis(part, -1, 0) for part in (image, kernels.offsets, kernels.weights))
    return jnp.moveaxis(lax.map(channel, tuple(channels)), 0, -1)


def _along(plane: Array, offsets: Array, weights: Array, reach: int, axis: int) -> Array:
    size = plane.shape[axis]
    padded = jnp.pad(plane, [(reach, reach + 1) if a == axis else (0, 0) for a in (0, 1)])
    whole = jnp.floor(offsets)
    first = reach + whole.astype(jnp.int32)

    def tap(number, total):
        below, above = (lax.dynamic_slice_in_dim(padded, first[number] + i, size, axis) for i in (0, 1))
        part = offsets[number] - whole[number]
        return total + weights[number] * (below + part * (above - below))

    return lax.fori_loop(0, len(offsets), tap, jnp.zeros_like(plane))
