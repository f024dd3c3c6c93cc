"""Lookups and disocclusion under vmap and without compilation, and the gradients of lookups."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from temporal_cases import (
    LOOKUPS,
    SIZE,
    bilinear,
    catmull_rom,
    disoccluded,
    images,
    masks,
    motions,
    nearest,
    surroundings,
)

from sssfit.frames import temporal


@pytest.mark.parametrize("lookup", [nearest, bilinear, pytest.param(catmull_rom, marks=pytest.mark.slow)])
def test_transforms(lookup):
    motion = jnp.stack([jnp.asarray(motions(seed)) for seed in (7, 8)])
    stack = jnp.stack([jnp.asarray(images(seed)) for seed in (9, 10)])
    mapped = jax.jit(jax.vmap(lookup))(stack, motion)
    for k in range(2):
        expected = np.asarray(lookup(stack[k], motion[k]))
        assert np.asarray(mapped[k]) == pytest.approx(expected, abs=16 * 2.0**-23 * float(stack.max()))
    with jax.disable_jit():
        eager = np.asarray(lookup(stack[0], motion[0]))
    # Compiled, products and sums may be fused.
    assert eager == pytest.approx(
        np.asarray(lookup(stack[0], motion[0])), abs=16 * 2.0**-23 * float(stack.max())
    )


@pytest.mark.slow
def test_disocclusion_under_transforms():
    stack = [
        jnp.stack([jnp.asarray(a), jnp.asarray(b)]) for a, b in zip(*map(surroundings, "ff"), strict=True)
    ]
    motion = jnp.stack([jnp.asarray(motions(seed)) for seed in (7, 8)])
    mapped = jax.vmap(disoccluded)(*stack, motion)
    for k in range(2):
        depth, profile_id, previous_depth, previous_id = (layer[k] for layer in stack)
        for function in (disoccluded, temporal.disoccluded):
            found = function(depth, profile_id, previous_depth, previous_id, motion[k])
            np.testing.assert_array_equal(mapped[k], found)


@pytest.mark.slow
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(
    "lookup",
    # Sixteen pixels with derivatives take seconds to compile.
    [
        bilinear,
        *(pytest.param(LOOKUPS[name], marks=pytest.mark.slow) for name in ("catmull_rom", "unclamped")),
    ],
    ids=[*LOOKUPS][1:],
)
def test_gradients_are_those_of_the_filter(lookup, masked, x64):
    image, motion = images(dtype="float64"), motions(dtype="float64")
    mask = masks() if masked else None
    spoiled = image if mask is None else np.where(mask[..., None], image, np.nan)
    weights = np.random.default_rng(11).normal(size=image.shape)
    # Where no masked pixel is around, what is found is the pixel itself, NaN here.
    lone = np.any(np.isnan(lookup(spoiled, motion, mask=mask)), axis=-1)
    weights[lone] = 0

    @jax.jit
    def found(image, motion):
        result = lookup(image, motion, mask=mask)
        return (weights * jnp.where(lone[..., None], 0, result)).sum()

    arguments = jnp.asarray(spoiled), jnp.asarray(motion)
    gradients = jax.jit(jax.grad(found, argnums=(0, 1)))(*arguments)
    assert all(np.isfinite(gradient).all() for gradient in gradients)
    if mask is not None:
        assert np.all(np.asarray(gradients[0])[~mask] == 0)
    # Along one direction of both, where motion is neither whole nor half: kinks have two slopes.
    smooth = np.all(np.abs(motion * 2 - np.round(motion * 2)) > 1e-3, axis=-1)
    steps = np.where(mask[..., None], 1.0, 0) if mask is not None else np.ones(image.shape)
    ways = (
        steps * np.random.default_rng(12).normal(size=image.shape),
        smooth[..., None] * motions(13, "float64"),
    )
    slope = sum(float((gradient * way).sum()) for gradient, way in zip(gradients, ways, strict=True))
    size = 1e-6
    up, down = (found(*(a + s * way for a, way in zip(arguments, ways, strict=True))) for s in (size, -size))
    assert slope == pytest.approx(float(up - down) / (2 * size), rel=1e-6, abs=1e-6)


def test_the_slope_at_a_still_pixel_is_that_to_the_right():
    image = jnp.asarray(images())
    slope = jax.jit(jax.grad(lambda motion: bilinear(image, motion)[2, 3, 0]))(jnp.zeros((*SIZE, 2)))
    across, down = image[2, 4, 0] - image[2, 3, 0], image[3, 3, 0] - image[2, 3, 0]
    assert slope[2, 3].tolist() == pytest.approx([float(across), float(down)], rel=1e-6)
