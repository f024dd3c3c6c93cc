"""What a policy is told of a frame before it is sampled, and the measure that it learns in."""

import functools
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from sssfit.estimators import in_frame, policies
from sssfit.frames import split
from sssfit.frames._block import LUMINANCE
from sssfit.frames.gbuffer import Frame

#: What is around a pixel is a mean over so many by so many pixels.
_SURROUND = 8


def light_of(policy: Any) -> str | None:
    """Which light the policy looks at, if any: that on the pixel itself ("control") or around it."""
    if isinstance(policy, policies.Adaptive):
        constant = policy.config.constant
        return None if isinstance(constant, int | float) and constant == 0 else policy.light
    if isinstance(policy, policies.Fixed | policies.Oracle):
        return None
    return getattr(policy, "light", "control")


def sampled(frame: Frame, config: Any) -> Array:
    """Which pixels are sampled; `config` is a `sequence.Config`."""
    found, least = jnp.zeros(frame.depth.shape, bool), config.settings.split
    for here, d in _scattering(frame, config):
        is_wide = here & (d > 0)
        found |= is_wide if least is None else is_wide & (_share(frame, here, d, config) >= least)
    return found


@functools.partial(jax.jit, static_argnames="light")
def light_on(frame: Frame, lit: Array, config: Any, light: str) -> Array:
    """The light that a policy looks at, on each pixel or around it, times the share of it that goes beyond.

    Args:
        frame: the frame.
        lit: its light, `measured`.
        config: a `sequence.Config`.
        light: see `light_of`.
    """
    found = jnp.zeros_like(lit)
    for here, d in _scattering(frame, config):
        near = surround(lit, here) if light == "surround" else lit
        found = jnp.where(here, _share(frame, here, d, config) * near, found)
    return found


def _scattering(frame: Frame, config: Any) -> Iterator[tuple[Array, Array]]:
    """Of each profile that scatters its pixels and the widest channel's shape."""
    for number, d in config.profiles.items():
        if number != 0 and d is not None:
            yield frame.profile_id == number, jnp.max(jnp.asarray(d, jnp.float32))


def _share(frame: Frame, here: Array, d: Array, config: Any) -> Array:
    depth = jnp.where(here, frame.depth, 1)
    return split.distant_share(depth, frame.camera, jnp.where(d > 0, d, 1), config.settings)


def pooled(memory: Any, usable: Array) -> Any:
    """The memory with the gain of a low-discrepancy sequence taken from the pixels around.

    One pixel's few frames do not tell it; it is much the same nearby.
    """
    if not isinstance(memory, in_frame.History) or memory.gain is None:
        return memory
    own = memory.gain.temporal.astype(jnp.float32), memory.gain.spatial.astype(jnp.float32)
    is_known = jnp.isfinite(own[0]) & jnp.isfinite(own[1])
    temporal, spatial = (_sums(jnp.where(usable & is_known, v, 0)) for v in own)
    gain = _spread(jnp.where(spatial > 0, temporal / jnp.where(spatial > 0, spatial, 1), 1), usable.shape)
    # As a quotient of which the lower number is 1. What is lost stays so.
    shared = jnp.where(is_known, gain, jnp.nan), jnp.ones_like(gain)
    return eqx.tree_at(lambda m: (m.gain.temporal, m.gain.spatial), memory, shared)


@functools.partial(jax.jit, static_argnames="gamma")
def measured(image: Array, gamma: float) -> Array:
    """Luminance / pi of what leaves the surface, to the power 1 / gamma."""
    linear = luminance(image) / jnp.pi
    return linear if gamma == 1 else jnp.maximum(linear, 0) ** (1 / gamma)


def luminance(image: Array) -> Array:
    """As `sequence.luminance`."""
    return sum(share * image[..., c] for c, share in enumerate(LUMINANCE))  # pyright: ignore


def surround(light: Array, mask: Array) -> Array:
    """The mean of something around the pixels of a mask, 0 where there are none; a NaN is left out."""
    mask = mask & jnp.isfinite(light)
    total, number = _sums(jnp.where(mask, light, 0)), _sums(mask)
    return _spread(jnp.where(number > 0, total / jnp.where(number > 0, number, 1), 0), light.shape)


def _sums(values: Array) -> Array:
    """Over each square of pixels, of which the last ones may be cut off."""
    height, width = values.shape
    values = jnp.pad(values, ((0, -height % _SURROUND), (0, -width % _SURROUND)))
    for axis in (0, 1):
        shape = list(values.shape)
        shape[axis : axis + 1] = [shape[axis] // _SURROUND, _SURROUND]
        values = jnp.sum(values.reshape(shape), axis=axis + 1, dtype=jnp.float32)
    return values


def _spread(values: Array, shape: tuple[int, ...]) -> Array:
    """What each square has, at its pixels."""
    return jnp.repeat(jnp.repeat(values, _SURROUND, 0), _SURROUND, 1)[: shape[0], : shape[1]]
