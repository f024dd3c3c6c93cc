"""Hash functions: their listings in Python's integers, and what the bits are good for."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from sssfit.sampling import hashes

# One compilation for each shape.
pcg3d = jax.jit(hashes.pcg3d)
pcg3d16 = jax.jit(hashes.pcg3d16)
nested_scramble = jax.jit(hashes.nested_scramble)

words = st.integers(0, 2**32 - 1)
MASK = 2**32 - 1


def random_words(seed, *shape):
    return np.random.default_rng(seed).integers(0, 2**32, shape, dtype=np.uint32)


def mixed(v):
    v[0] = (v[0] + v[1] * v[2]) & MASK
    v[1] = (v[1] + v[2] * v[0]) & MASK
    v[2] = (v[2] + v[0] * v[1]) & MASK


@given(x=words, y=words, z=words)
def test_pcg3d_in_integers(x, y, z):
    v = [(word * 1664525 + 1013904223) & MASK for word in (x, y, z)]
    mixed(v)
    v = [word ^ word >> 16 for word in v]
    mixed(v)
    assert pcg3d(np.uint32(x), np.uint32(y), np.uint32(z)).tolist() == v


@given(x=words, y=words, frame=words)
def test_pcg3d16_in_integers(x, y, frame):
    # The authors' listing: constants of a generator modulo 2^16, in 32-bit arithmetic, the upper halves kept.
    v = [(word * 12829 + 47989) & MASK for word in (x, y, frame)]
    mixed(v)
    mixed(v)
    found = pcg3d16(np.uint32(x), np.uint32(y), np.uint32(frame))
    assert found.dtype == np.uint32 and found.tolist() == [word >> 16 for word in v]


def test_pcg3d16_of_the_pixels_of_some_frames_is_uniform():
    columns, rows, frames = np.arange(256), np.arange(256)[:, None], np.array([0, 1, 2, 1000])[:, None, None]
    found = np.asarray(pcg3d16(columns, rows, frames))
    assert found.shape == (3, 4, 256, 256) and found.max() < 2**16
    for words_of_one in found.reshape(3, -1):
        assert chisquare(np.bincount(words_of_one >> 8, minlength=256)).pvalue > 1e-4
    centred = (found.astype(np.float64) + 0.5) / 2**16 - 0.5
    # Neighbours in a row, in a column and in time have nothing in common, nor do the three words.
    products = [centred[:, :, :, 1:] * centred[:, :, :, :-1], centred[:, :, 1:] * centred[:, :, :-1]]
    products += [centred[:, 1:] * centred[:, :-1], centred * np.roll(centred, 1, axis=0)]
    for product in products:
        assert abs(12 * product.mean()) < 4.5 / np.sqrt(product.size)


@given(digits=words, seed=words)
def test_nested_scramble_in_integers(digits, seed):
    n = digits ^ (digits * 0x3D20ADEA & MASK)
    n = (n + seed) * (seed >> 16 | 1) & MASK
    n ^= n * 0x05526C56 & MASK
    n ^= n * 0x53A22864 & MASK
    assert int(nested_scramble(np.uint32(digits), np.uint32(seed))) == int(f"{n:032b}"[::-1], 2)


@given(digits=words, other=words, length=st.integers(0, 31), seed=words)
def test_scrambled_numbers_share_as_many_digits_as_before(digits, other, length, seed):
    # The same first digits, then different ones.
    low = (1 << length) - 1
    other = (other & ~((low << 1) | 1) & MASK) | (digits & low) | (~digits & (1 << length))
    first, second = (int(nested_scramble(np.uint32(n), np.uint32(seed))) for n in (digits, other))
    assert (first ^ second).bit_length() == 32 - length


@pytest.mark.parametrize("digits", [0, 1, 0x80000000, 0xFFFFFFFF, 123456789])
@pytest.mark.parametrize("upper", [0, 1, 0x8000, 0xFFFF, 0xBEEF])
def test_the_first_16_digits_are_exactly_uniform_over_seeds(digits, upper):
    seeds = (np.uint32(upper) << np.uint32(16)) + np.arange(2**16, dtype=np.uint32)
    found = np.asarray(nested_scramble(np.uint32(digits), seeds)) >> 16
    assert np.array_equal(np.sort(found), np.arange(2**16))


@pytest.mark.parametrize("shared", [0, 1, 2, 5, 9])
def test_digits_after_the_shared_ones_are_independent_over_seeds(shared):
    # Of a scrambled pair, all that variances depend on: the first 3 digits after those that are shared, each
    # pair of values as likely as any other but for the first digit, which differs.
    first = random_words(1, 200) & np.uint32(~(1 << shared) & MASK)
    seeds = random_words(2 + shared, 200, 400)
    pair = [first | np.uint32(n << shared) for n in (0, 1)]
    pair[1] = pair[1] ^ (random_words(3, 200) << np.uint32(shared + 1))
    a, b = (
        np.asarray(nested_scramble(digits[:, None], seeds)) >> np.uint32(29 - shared) & 7 for digits in pair
    )
    assert np.all((a ^ b) >= 4)
    cells = np.bincount(((a << 2) | (b & 3)).ravel(), minlength=32)
    assert chisquare(cells).pvalue > 1e-4


@given(word=words)
def test_reversed_bits(word):
    expected = int(f"{word:032b}"[::-1], 2)
    assert int(hashes.reversed_bits(word)) == expected
    assert int(hashes.reversed_bits(np.uint32(expected))) == word


def test_jit_and_vmap_change_nothing():
    x, y, z = random_words(4, 3, 20)
    for function, compiled in ((hashes.pcg3d, pcg3d), (hashes.pcg3d16, pcg3d16)):
        expected = np.asarray(compiled(x, y, z))
        assert np.array_equal(function(x, y, z), expected)
        assert np.array_equal(jax.vmap(function, out_axes=1)(x, y, z), expected)
    assert np.array_equal(jax.vmap(hashes.nested_scramble)(x, y), nested_scramble(x, y))


def test_integers_of_any_width(x64):
    expected = hashes.pcg3d16(5, 2**32 - 7, 3).tolist()
    assert hashes.pcg3d16(2**32 + 5, -7, np.int64(3 + 2**40)).tolist() == expected
    assert hashes.pcg3d16(np.int8(5), np.int64(-7), jax.numpy.int64(3)).tolist() == expected
