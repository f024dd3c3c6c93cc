"""What lookups are made of: words of two numbers, and rows in which a loop keeps its results."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.frames import _desk, _pairs

# Zeros of both signs, the smallest and largest numbers, infinities and a NaN that carries bits of its own.
EXTREMES = np.array([0, -0.0, 1e-45, -1e-38, 3.4e38, np.inf, -np.inf, 1], np.float32)
EXTREMES = np.concatenate([EXTREMES, np.array([0x7FC12345], np.uint32).view(np.float32)])


def bits(values):
    return np.asarray(values, np.float32).view(np.uint32)


def test_words_keep_every_bit():
    first, second = (grid.ravel() for grid in np.meshgrid(EXTREMES, EXTREMES))
    for found, given in zip(
        _pairs.unpack(_pairs.pack(jnp.asarray(first), jnp.asarray(second))), (first, second), strict=True
    ):
        assert found.dtype == jnp.float32
        np.testing.assert_array_equal(bits(found), bits(given))


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_layers_are_looked_up_as_they_are(count, wide):
    rng = np.random.default_rng(count)
    layers = [rng.normal(size=50).astype(np.float32) for _ in range(count)]
    index = rng.integers(0, 50, (4, 7)).astype(np.int32)
    with jax.enable_x64(wide):
        table = jax.jit(_pairs.side_by_side)([jnp.asarray(layer) for layer in layers])
        found = jax.jit(_pairs.at)(table, jnp.asarray(index))
        mapped = jax.vmap(_pairs.at, (None, 0))(table, jnp.asarray(index))
    # One may be left over, where a last word has room.
    assert len(found) == count + count % 2
    for layer, value, again in zip(layers, found, mapped, strict=False):
        np.testing.assert_array_equal(value, layer[index])
        np.testing.assert_array_equal(again, layer[index])


def test_where_words_would_lose_bits_each_number_is_one(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "tpu")
    layers = [np.arange(5, dtype=np.float32) + 10 * k for k in range(3)]
    table = _pairs.side_by_side([jnp.asarray(layer) for layer in layers])
    assert table.dtype == jnp.float32 and table.shape == (5, 3)
    found = _pairs.at(table, jnp.array([4, 0]))
    np.testing.assert_array_equal(found, [layer[[4, 0]] for layer in layers])


def test_lookups_are_differentiated_as_if_there_were_no_words():
    rng = np.random.default_rng(0)
    values, tangents = rng.normal(size=(2, 3, 20)).astype(np.float32)
    index = jnp.asarray(rng.integers(0, 20, 9), jnp.int32)

    def squares(layers):
        return sum(jnp.square(v) for v in _pairs.at(_pairs.side_by_side(list(layers)), index))

    value, slope = jax.jvp(jax.jit(squares), (values,), (tangents,))
    at = values[:, index], tangents[:, index]
    np.testing.assert_allclose(value, np.sum(at[0] ** 2, axis=0), rtol=1e-6)
    np.testing.assert_allclose(slope, 2 * np.sum(at[0] * at[1], axis=0), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("turns", [0, 1, 5])
def test_a_loop_that_keeps_its_results_finds_the_same(turns):
    table = _pairs.side_by_side([jnp.arange(10.0), jnp.arange(10.0) ** 2])

    def step(keep, turn, total):
        place = keep((turn + jnp.arange(6)) % 10)
        first, second = _pairs.at(table, place, keep)
        return total + first * keep(jnp.sqrt(second))

    def kept(total):
        def one(turn, state):
            return _desk.at_work(step, state[1], turn, state[0])

        return jax.lax.fori_loop(0, turns, one, (total, _desk.rows(step, 0, total)))[0]

    total = jnp.zeros(6)
    expected = sum(((turn + np.arange(6)) % 10) ** 2.0 for turn in range(turns)) + np.zeros(6)
    np.testing.assert_array_equal(jax.jit(kept)(total), expected)
    np.testing.assert_array_equal(jax.vmap(kept)(jnp.stack([total, total]))[1], expected)
