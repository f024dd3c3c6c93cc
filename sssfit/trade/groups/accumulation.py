"""How noisy frames are averaged over time: what bounds the history, how it is looked up, and the weights."""

from collections.abc import Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from sssfit.frames import taa
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.groups import _waves
from sssfit.trade.setting import Setting

_FRAMES, _SEEDS = 12, 3
# Standard deviation of a pixel's noise over its light, a shadow's light, and pixels a frame that it moves.
_NOISE, _SHADOW, _EDGE_SPEED = 0.3, 0.3, 3.0

_accumulated = eqx.filter_jit(taa.accumulate)


def _prepare(setting: Setting) -> Task:
    size = 160 if setting.is_quick else 256
    motions = _waves.motions(_FRAMES)
    exact = [_lit(size, motions, number) for number in range(_FRAMES + 1)]
    noisy = [[_noisy(image, seed, number) for number, image in enumerate(exact)] for seed in range(_SEEDS)]
    everywhere = [jnp.full((size, size, 2), motion, jnp.float32) for motion in motions]
    made = [_choice(name, knobs, noisy, exact[-1], everywhere) for name, knobs in _knobs(setting.is_quick)]
    note = f"{size} x {size} pixels, noise of {_NOISE:g} of the light, and the edge of a shadow that moves"
    return Task(size * size, tuple(made), note)


def _knobs(is_quick: bool) -> Iterator[tuple[str, Mapping[str, Any]]]:
    usual = taa.DEFAULT
    for clamping in taa.CLAMPINGS[:2] if is_quick else taa.CLAMPINGS:
        for lookup in (usual.lookup,) if is_quick else taa.LOOKUPS:
            yield f"{clamping}, {lookup}", {"clamping": clamping, "lookup": lookup}
    for alpha in () if is_quick else (0.05, 0.2):
        yield f"{usual.clamping}, alpha {alpha:g}", {"alpha": alpha}


def _lit(size: int, motions: np.ndarray, number: int) -> np.ndarray:
    """The image after some motions, with a shadow that goes its own way and is half across at last."""
    edge = size / 2 + _EDGE_SPEED * (number - _FRAMES)
    light = np.where(np.arange(size) < edge, _SHADOW, 1.0)
    return _waves.image(size, motions[:number].sum(axis=0)) * light[:, None]


def _noisy(image: np.ndarray, seed: int, number: int) -> jax.Array:
    """As bright on average, and like a mean of samples never negative."""
    shape = 1 / _NOISE**2
    factor = np.random.default_rng((seed, number)).gamma(shape, 1 / shape, image.shape[:2])
    return jax.device_put((image * factor[..., None]).astype(np.float32))


def _choice(name: str, knobs: Mapping[str, Any], noisy, end: np.ndarray, motions) -> Choice:
    # As an array, a weight is no constant that another one would compile anew for.
    config = taa.Config(**{**knobs, "alpha": jnp.asarray(knobs.get("alpha", taa.DEFAULT.alpha))})

    def error() -> Error:
        found = []
        for history, *images in noisy:
            for image, motion in zip(images, motions, strict=True):
                history = _accumulated(history, image, motion=motion, config=config)
            found.append(_waves.error(np.asarray(history), end, _FRAMES))
        return Error(float(np.mean(found)), float(np.std(found, ddof=1) / len(found) ** 0.5))

    def run():
        return jax.block_until_ready(_accumulated(*noisy[0][:2], motion=motions[0], config=config))

    return Choice(
        name=name,
        knobs=knobs,
        run=run,
        error=error,
        # Two images and the motion are read, and an image written.
        bytes_moved=4 * (3 + 3 + 2 + 3),
        is_default=knobs == {"clamping": taa.DEFAULT.clamping, "lookup": taa.DEFAULT.lookup},
    )


GROUP = Group(
    name="accumulation",
    title="How noisy frames are averaged: what bounds the history, its lookup and the newest one's weight",
    unit="pixel",
    error=f"root mean square error after {_FRAMES} frames, over that of the image",
    reference="the lit image in closed form",
    prepare=_prepare,
    beside_the_front="The box of standard deviations is nearer under this noise. Where noise comes from few "
    "bright samples and is twice the light, the default is nearer.",
    stands_for=("frames.taa.accumulate",),
)
