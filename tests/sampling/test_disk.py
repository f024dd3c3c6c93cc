"""Offsets and axes of the sampling plane, against mpmath and the laws of an orthonormal basis."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.sampling import disk

rotation = jax.jit(disk.rotation)
offsets = jax.jit(disk.offsets)
slopes = jax.jit(jax.jacobian(disk.offsets, argnums=(0, 1)))
basis = jax.jit(disk.basis)


def turns(dtype):
    """Angles everywhere in a turn, on the axes, beside them, and tiny ones."""
    generator = np.random.default_rng(1)
    ends = np.arange(-8, 9, dtype=dtype) / 8
    tiny = np.array([1e-30, 1e-12, 1e-5], dtype)
    # Not beside 0, where numbers are too small for XLA, which flushes them.
    beside = np.concatenate([np.nextafter(ends[ends != 0], dtype.type(side)) for side in (-2, 2)])
    return np.concatenate([generator.random(2000).astype(dtype), ends, beside, tiny, -tiny])


def exact(turn):
    """Cosine and sine with 40 digits, by mpmath's functions of multiples of pi."""
    with mpmath.workdps(40):
        angles = [2 * mpmath.mpf(float(t)) for t in turn]
        return [mpmath.cospi(a) for a in angles], [mpmath.sinpi(a) for a in angles]


def test_cosine_and_sine_have_full_relative_accuracy(dtype):
    turn = turns(dtype)
    for found, expected in zip(rotation(turn), exact(turn), strict=True):
        assert found.dtype == dtype
        found = np.asarray(found, np.float64)
        zero = np.array([value == 0 for value in expected])
        assert np.all(found[zero] == 0) and zero.sum() >= 4
        relative = [
            abs(mpmath.mpf(float(f)) / e - 1)
            for f, e in zip(found[~zero], np.array(expected)[~zero], strict=True)
        ]
        assert max(relative) < 2.5 * float(np.finfo(dtype).eps)


def test_axes_are_exact(dtype):
    cosine, sine = rotation(jnp.array([0, 0.25, 0.5, 0.75, 1, -0.25, 1000.25], dtype))
    assert cosine.tolist() == [1, 0, -1, 0, 1, 0, 0]
    assert sine.tolist() == [0, 1, 0, -1, 0, -1, 1]
    assert not np.signbit(np.asarray(cosine)[[1, 3]]).any() and not np.signbit(np.asarray(sine)[[0, 2]]).any()


@given(turn=st.floats(-4, 4, width=32), radius=st.floats(0, 1e6, width=32))
def test_offsets_lie_at_their_radius_and_mirror(turn, radius):
    found = np.asarray(offsets(np.float32(radius), np.float32(turn)), np.float64)
    assert np.hypot(*found) == pytest.approx(radius, rel=4e-7, abs=1e-37)
    mirrored = offsets(np.float32(radius), np.float32(-turn))
    assert mirrored.tolist() == [found[0], -found[1]]


def test_ends(dtype):
    assert offsets(jnp.zeros(3, dtype), jnp.array([0.1, 0.5, 0.9], dtype)).tolist() == [[0, 0]] * 3
    for turn in (np.inf, -np.inf, np.nan):
        assert np.isnan(offsets(jnp.asarray(1, dtype), jnp.asarray(turn, dtype))).all()
    largest = np.finfo(dtype).max
    found = offsets(jnp.asarray(largest, dtype), jnp.asarray(0.125, dtype))
    assert np.asarray(found) / largest == pytest.approx([np.sqrt(0.5)] * 2, rel=3e-7)
    assert np.all(np.abs(rotation(jnp.asarray(3e30, dtype))) <= 1)
    half = disk.offsets(jnp.float16(1.0), jnp.float16(0.125))
    assert half.dtype == jnp.float16 and np.asarray(half) == pytest.approx([np.sqrt(0.5)] * 2, rel=1e-3)


def test_shapes_broadcast():
    found = offsets(np.ones((4, 1), np.float32), np.zeros(5, np.float32))
    assert found.shape == (4, 5, 2)


@given(turn=st.floats(0, 1, width=32))
def test_derivatives_are_those_of_the_circle(turn):
    turn, radius = jnp.float32(turn), jnp.float32(1.5)
    by_radius, by_turn = slopes(radius, turn)
    cosine, sine = (float(part) for part in rotation(turn))
    assert by_turn == pytest.approx([-3 * np.pi * sine, 3 * np.pi * cosine], rel=2e-6, abs=1e-5)
    assert by_radius.tolist() == [cosine, sine]


def test_uniform_turns_fill_the_circle_evenly():
    turn = (np.arange(4096) + 0.5) / 4096
    found = np.asarray(offsets(np.float32(1), turn.astype(np.float32)), np.float64)
    assert found.mean(axis=0) == pytest.approx([0, 0], abs=1e-7)
    assert (found.T @ found / 4096) == pytest.approx(np.eye(2) / 2, abs=1e-7)


def normals(dtype):
    """Directions all over the sphere, the axes, both zeros, and those close to where older methods fail."""
    generator = np.random.default_rng(2)
    drawn = generator.normal(size=(2000, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3), [[0, 1, -0.0], [1, -0.0, 0]]])
    near = np.array([[x, y, -1] for x in (1e-30, -1e-8, 1e-4) for y in (0, 1e-6, -1e-3)])
    flat = np.array([[1, 2, 1e-30], [1, 2, -1e-30], [-3, 1, 1e-8]])
    every = np.concatenate([drawn, axes, near, flat]).astype(dtype)
    return every / np.linalg.norm(every, axis=-1, keepdims=True).astype(dtype)


def test_axes_are_orthonormal_and_right_handed(dtype):
    normal = normals(dtype)
    tangent, bitangent = (np.asarray(axis) for axis in basis(normal))
    assert tangent.dtype == dtype
    frame = np.stack([tangent, bitangent, normal], axis=-2).astype(np.float64)
    unit = np.einsum("nij,nkj->nik", frame, frame)
    # The normals themselves are rounded, which the axes follow.
    assert np.abs(unit - np.eye(3)).max() < 8 * float(np.finfo(dtype).eps)
    assert np.abs(np.linalg.det(frame) - 1).max() < 8 * float(np.finfo(dtype).eps)


def test_axes_at_the_poles(dtype):
    found = [
        np.asarray(axis).tolist() for axis in basis(jnp.array([[0, 0, 1], [0, 0, -1], [0, 0, 0]], dtype))
    ]
    assert found[0] == [[1, 0, 0], [1, 0, 0], [1, 0, 0]]
    assert found[1] == [[0, 1, 0], [0, -1, 0], [0, 1, 0]]


def test_axes_of_nan_are_nan(dtype):
    for axis in basis(jnp.full((2, 3), jnp.nan, dtype)):
        assert np.isnan(axis).all()


def test_a_normal_that_is_too_long_costs_twice_its_error():
    normal = normals(np.dtype(np.float64))
    for error in (1e-3, -1e-3):
        scaled = normal * (1 + error)
        tangent, bitangent = (np.asarray(axis, np.float64) for axis in basis(scaled.astype(np.float32)))
        frame = np.stack([tangent, bitangent, normal], axis=-2)
        unit = np.einsum("nij,nkj->nik", frame, frame)
        assert 1e-4 < np.abs(unit - np.eye(3)).max() < 2 * abs(error) * 1.01


def test_basis_under_transforms(dtype):
    normal = normals(dtype)[:50]
    expected = [np.asarray(axis) for axis in basis(normal)]
    eps = float(np.finfo(dtype).eps)
    for found, axis in zip(disk.basis(normal), expected, strict=True):
        assert np.asarray(found) == pytest.approx(axis, abs=2 * eps)
    for found, axis in zip(jax.jit(jax.vmap(disk.basis))(normal), expected, strict=True):
        assert np.asarray(found) == pytest.approx(axis, abs=2 * eps)
    jacobian = jax.jit(jax.vmap(jax.jacobian(lambda n: jnp.stack(disk.basis(n)))))
    gradient = jacobian(jnp.asarray(normals(dtype)))
    assert np.isfinite(gradient).all()


def test_jit_and_vmap_give_the_offsets_themselves(dtype):
    turn, radius = turns(dtype), np.linspace(0, 3, turns(dtype).size, dtype=dtype)
    expected = np.asarray(offsets(radius, turn))
    close = 2 * float(np.finfo(dtype).eps)
    assert np.asarray(disk.offsets(radius, turn)) == pytest.approx(expected, rel=close, abs=0)
    assert np.asarray(jax.jit(jax.vmap(disk.offsets))(radius, turn)) == pytest.approx(
        expected, rel=close, abs=0
    )
