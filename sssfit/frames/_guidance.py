"""What a policy is told of a frame before it is sampled, and the measure that it learns in."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from sssfit.estimators import in_frame, policies
from sssfit.estimators.policies import Known
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


@functools.partial(jax.jit, static_argnames="light")
def known(frame: Frame, exact: Array, missing: Array, config: Any, light: str | None) -> tuple[Known, Array]:
    """What is known of the frame, and which pixels are sampled; `config` is a `sequence.Config`."""
    sampled, found = jnp.zeros(missing.shape, bool), jnp.float32(0)
    lit = None if light is None else measured(frame.irradiance, config.gamma)
    for number, d in config.profiles.items():
        if number == 0 or d is None:
            continue
        here = frame.profile_id == number
        widest = jnp.max(jnp.asarray(d, jnp.float32))
        scattered, least = here & (widest > 0), config.settings.split
        if least is not None or lit is not None:
            depth, d = jnp.where(here, frame.depth, 1), jnp.where(widest > 0, widest, 1)
            share = split.distant_share(depth, frame.camera, d, config.settings)
            if least is not None:
                scattered &= share >= least
            if lit is not None:
                found = jnp.where(here, share * (surround(lit, here) if light == "surround" else lit), found)
        sampled |= scattered
    nothing = jnp.float32(0)
    control, around = (nothing, found) if light == "surround" else (found, nothing)
    return Known(control, around, exact, missing), sampled


def pooled(memory: Any, usable: Array) -> Any:
    """The memory with the gain of a low-discrepancy sequence taken from the pixels around.

    One pixel's few frames do not tell it; it is much the same nearby.
    """
    if not isinstance(memory, in_frame.History) or memory.gain is None:
        return memory
    is_lost = memory.is_lost
    own = memory.gain.temporal.astype(jnp.float32), memory.gain.spatial.astype(jnp.float32)
    # What is lost stays so.
    shared = tuple(jnp.where(is_lost, v, surround(v, usable & ~is_lost)) for v in own)
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
    height, width = light.shape
    mask = mask & jnp.isfinite(light)
    sums = [
        jnp.pad(v, ((0, -height % _SURROUND), (0, -width % _SURROUND)))
        for v in (jnp.where(mask, light, 0), mask)
    ]
    for axis in (0, 1):
        sums = [jnp.sum(_cut(v, axis), axis=axis + 1, dtype=jnp.float32) for v in sums]
    mean = jnp.where(sums[1] > 0, sums[0] / jnp.where(sums[1] > 0, sums[1], 1), 0)
    return jnp.repeat(jnp.repeat(mean, _SURROUND, 0), _SURROUND, 1)[:height, :width]


def _cut(values: Array, axis: int) -> Array:
    """An axis in pieces of the size that the light is averaged over."""
    shape = list(values.shape)
    shape[axis : axis + 1] = [shape[axis] // _SURROUND, _SURROUND]
    return values.reshape(shape)
