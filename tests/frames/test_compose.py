"""Texturing before and after scattering: energies, ends, and what a blur does to either."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.frames import compose

each_texturing = pytest.mark.parametrize("texturing", ["post", "pre_and_post"])


def rendered(texturing, irradiance, albedo, scatter, specular=None):
    scattered = scatter(compose.irradiance_for(texturing, irradiance, albedo))
    return compose.compose(scattered, albedo, specular=specular, texturing=texturing)


def frames(dtype, seed=1):
    generator = np.random.default_rng(seed)
    return generator.lognormal(size=(6, 8, 3)).astype(dtype), generator.random((6, 8, 3)).astype(dtype)


@each_texturing
def test_unscattered_light_is_lambert_s(texturing, dtype):
    irradiance, albedo = frames(dtype)
    found = rendered(texturing, irradiance, albedo, lambda light: light)
    assert found.dtype == dtype
    expected = irradiance.astype(np.float64) * albedo / np.pi
    assert np.asarray(found) == pytest.approx(expected, rel=4 * float(np.finfo(dtype).eps))


def average(light):
    """Scattering so far that all light is everywhere."""
    return jnp.broadcast_to(light.mean(axis=(0, 1)), light.shape)


def test_both_agree_on_a_uniform_albedo(dtype):
    irradiance, _ = frames(dtype)
    albedo = np.array([0.2, 0.5, 0.9], dtype)
    found = [np.asarray(rendered(t, irradiance, albedo, average)) for t in ("post", "pre_and_post")]
    assert found[0] == pytest.approx(found[1], rel=16 * float(np.finfo(dtype).eps))


def test_detail_is_kept_or_half_blurred(x64):
    # Stripes of albedo 0.9 and 0.1 under uniform light that scatters everywhere.
    albedo = np.where(np.arange(8) % 2, 0.9, 0.1)[None, :, None] * np.ones((6, 1, 3))
    irradiance = np.full_like(albedo, np.pi)
    post, split = (np.asarray(rendered(t, irradiance, albedo, average)) for t in ("post", "pre_and_post"))
    assert post == pytest.approx(albedo)
    mean_root = (np.sqrt(0.9) + np.sqrt(0.1)) / 2
    assert split == pytest.approx(np.sqrt(albedo) * mean_root)


@each_texturing
def test_black_and_white(texturing, dtype):
    irradiance, _ = frames(dtype)
    assert np.all(np.asarray(rendered(texturing, irradiance, np.zeros((), dtype), average)) == 0)
    white = rendered(texturing, irradiance, np.ones((), dtype), average)
    assert np.asarray(white) == pytest.approx(
        np.asarray(average(irradiance) / np.pi), rel=4 * float(np.finfo(dtype).eps)
    )


@each_texturing
def test_specular_is_added_untouched(texturing, dtype):
    irradiance, albedo = frames(dtype)
    specular = frames(dtype, 2)[0]
    without = rendered(texturing, irradiance, albedo, average)
    found = rendered(texturing, irradiance, albedo, average, specular)
    assert np.asarray(found) == pytest.approx(
        np.asarray(without) + specular, rel=2 * float(np.finfo(dtype).eps)
    )
    black = rendered(texturing, irradiance, np.zeros_like(albedo), average, specular)
    assert np.array_equal(black, specular)


def test_post_scatters_the_irradiance_itself():
    irradiance, albedo = frames(np.float32)
    assert np.array_equal(compose.irradiance_for("post", irradiance, albedo), irradiance)
    assert np.array_equal(
        compose.irradiance_for("post", irradiance, np.full_like(albedo, np.nan)), irradiance
    )


@given(albedo=st.floats(0, 1, width=32), light=st.floats(0, 2.0**100, width=32))
def test_no_texturing_makes_energy(albedo, light):
    for texturing in ("post", "pre_and_post"):
        found = float(rendered(texturing, np.float32(light), np.float32(albedo), lambda x: x))
        assert 0 <= found <= light / np.pi * (1 + 4 * 2.0**-23)


@each_texturing
def test_transforms_and_gradients(texturing, dtype):
    irradiance, albedo = (jnp.asarray(x) for x in frames(dtype))
    albedo = albedo.at[0, 0].set(jnp.array([0, 1, 0.5], dtype))

    def render(irradiance, albedo):
        return rendered(texturing, irradiance, albedo, average)

    expected = np.asarray(render(irradiance, albedo))
    close = 8 * float(np.finfo(dtype).eps)
    assert np.asarray(jax.jit(render)(irradiance, albedo)) == pytest.approx(expected, rel=close)
    stack = jax.vmap(render)(jnp.stack([irradiance, irradiance]), jnp.stack([albedo, 0 * albedo]))
    assert np.asarray(stack[0]) == pytest.approx(expected, rel=close)
    for gradient in jax.grad(lambda *a: render(*a).sum(), argnums=(0, 1))(irradiance, albedo):
        assert np.isfinite(gradient).all()
    slope = jax.grad(lambda a: compose.compose(1.0, a, texturing=texturing))(0.25)
    assert float(slope) == pytest.approx(1 / np.pi, rel=1e-6)


def test_an_albedo_below_0_is_not_hidden():
    assert np.isnan(compose.compose(1.0, -0.1, texturing="pre_and_post"))
    assert float(compose.compose(1.0, -0.1)) < 0


def test_other_texturings_are_refused():
    message = 'texturing must be "post" or "pre_and_post", got \'pre\''
    for call in (
        lambda: compose.compose(1.0, 0.5, texturing="pre"),  # pyright: ignore[reportArgumentType]
        lambda: compose.irradiance_for("pre", 1.0, 0.5),  # pyright: ignore[reportArgumentType]
    ):
        with pytest.raises(ValueError, match=message):
            call()
