"""Points of the unit square: R2 against its real ratios, pcg3d in integers, and both under random shifts."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare, kstest

from sssfit.sampling import sequences

# One compilation for each shape of the index and of the shift.
r2 = jax.jit(sequences.r2)
hashed = jax.jit(sequences.hashed)
BOTH = pytest.mark.parametrize("points", [r2, hashed], ids=["r2", "hashed"])

words = st.integers(0, 2**32 - 1)
ORIGIN = np.zeros((2, 1), np.uint32)
#: Largest number below 1 that the points take.
LARGEST = 1 - 2.0**-24


@pytest.fixture(scope="module")
def ratios():
    """1 / phi and 1 / phi^2 for the real root phi of x^3 = x + 1, to 50 digits."""
    with mpmath.workdps(50):
        phi = mpmath.findroot(lambda x: x**3 - x - 1, mpmath.mpf("1.3247179572447460"))
        return 1 / phi, 1 / phi**2


def random_shifts(seed, count):
    return np.random.default_rng(seed).integers(0, 2**32, (2, count), dtype=np.uint32)


def around(found, place):
    """Distance on the circle of circumference 1."""
    apart = abs(mpmath.mpf(float(found)) - place) % 1
    return min(apart, 1 - apart)


@pytest.mark.parametrize("number", [0, 1, 2, 3, 17, 1_000, 9_999, 65_535, 10**6, 10**8])
def test_points_are_where_the_sequence_has_them(ratios, number):
    found = np.asarray(r2(np.array([number], np.int32), ORIGIN))
    assert found.dtype == np.float32
    with mpmath.workdps(50):
        for value, ratio in zip(found[:, 0], ratios, strict=True):
            bound = number * mpmath.mpf(2) ** -33 + mpmath.mpf(2) ** -24
            assert around(value, number * ratio % 1) <= bound


def test_the_first_65536_points_are_within_8e_6(ratios):
    # 65535 2^-33 + 2^-24; a product in float32 is 2e-3 off by then.
    numbers = np.arange(65_536)
    found = np.asarray(r2(numbers.astype(np.int32), ORIGIN), np.float64)
    places = np.stack([numbers * float(ratio) % 1 for ratio in ratios])
    apart = np.abs(found - places)
    # float64's own product is within 65535 2^-53.
    assert np.minimum(apart, 1 - apart).max() <= 65_535 * 2.0**-33 + 2.0**-24 + 1e-11
    naive = numbers.astype(np.float32) * np.float32(ratios[0]) % 1
    assert np.abs(naive - places[0]).max() > 1e-3


@given(number=words, shift=st.tuples(words, words))
def test_r2_in_integers(ratios, number, shift):
    steps = [int(mpmath.nint(ratio * 2**32)) for ratio in ratios]
    expected = [
        ((start + number * step) % 2**32 >> 8) / 2**24 for start, step in zip(shift, steps, strict=True)
    ]
    found = r2(np.array([number], np.uint32), np.array([[s] for s in shift], np.uint32))
    assert np.asarray(found)[:, 0].tolist() == expected


def pcg3d(x, y, z):
    """Jarzynski and Olano's function in Python's integers, as their listing has it."""
    mask = 2**32 - 1
    v = [(word * 1664525 + 1013904223) & mask for word in (x, y, z)]
    for last in (False, True):
        v[0] = (v[0] + v[1] * v[2]) & mask
        v[1] = (v[1] + v[2] * v[0]) & mask
        v[2] = (v[2] + v[0] * v[1]) & mask
        if not last:
            v = [word ^ word >> 16 for word in v]
    return v


@given(number=words, shift=st.tuples(words, words))
def test_hashed_in_integers(number, shift):
    found = hashed(np.array([number], np.uint32), np.array([[s] for s in shift], np.uint32))
    expected = [(word >> 8) / 2**24 for word in pcg3d(shift[0], shift[1], number)[:2]]
    assert np.asarray(found)[:, 0].tolist() == expected


@BOTH
@given(number=words, shift=st.tuples(words, words))
def test_points_lie_in_the_square_and_jit_changes_nothing(points, number, shift):
    index, moved = np.array([number], np.uint32), np.array([[s] for s in shift], np.uint32)
    found = np.asarray(points(index, moved))
    assert np.all((found >= 0) & (found <= LARGEST))
    eager = points.__wrapped__(index, moved)
    assert eager.dtype == jnp.float32 and np.array_equal(eager, found)


@BOTH
def test_numbers_count_modulo_2_to_the_32(points, x64):
    index = np.array([0, 1, 12_345, 2**32 - 1], np.int64)
    moved = random_shifts(1, 1)
    first = np.asarray(points(index, moved))
    assert first.dtype == np.float32
    assert np.array_equal(points(index + 2**32, moved), first)
    assert np.array_equal(points(index.astype(np.uint32), moved), first)


@BOTH
def test_numbers_may_be_python_integers(points):
    moved = random_shifts(1, 1)
    expected = points(np.array([5, 2**32 - 5], np.uint32), moved)
    found = [np.asarray(points.__wrapped__(number, moved))[:, 0] for number in (2**32 + 5, 2**32 - 5)]
    assert np.array_equal(np.stack(found, axis=1), expected)


def test_r2_goes_on_after_the_last_word():
    # Number 2^32 - 1 is the point before number 0.
    moved = random_shifts(2, 1)
    last, first = np.asarray(r2(np.array([2**32 - 1, 0], np.uint32), moved), np.float64).T
    second = np.asarray(r2(np.array([1], np.uint32), moved), np.float64)[:, 0]
    assert (first - last) % 1 == pytest.approx((second - first) % 1, abs=2 * 2.0**-24)


@BOTH
def test_shapes_of_pixels(points):
    index, moved = np.arange(8).reshape(8, 1, 1), random_shifts(3, 6).reshape(2, 1, 2, 3)
    found = np.asarray(points(index, moved))
    assert found.shape == (2, 8, 2, 3)
    one = points(np.arange(8).reshape(8, 1, 1), moved[:, :, 1:, 2:])
    assert np.array_equal(found[:, :, 1:, 2:], one)
    assert points(np.uint32(5), np.array([1, 2], np.uint32)).shape == (2,)


@BOTH
def test_a_random_shift_makes_every_point_uniform(points):
    count = 20_000
    index, moved = np.array([[0], [1], [63], [1_000_000]], np.uint32), random_shifts(4, count)
    found = np.asarray(points(index, moved[:, None]))
    for number in range(len(index)):
        for axis in range(2):
            assert kstest(found[axis, number], "uniform").pvalue > 1e-4
        cells = np.floor(found[:, number] * 16).astype(int)
        assert chisquare(np.bincount(cells[0] * 16 + cells[1], minlength=256)).pvalue > 1e-4


def inside_share(found):
    return np.mean(np.square(found - 0.5).sum(axis=0) < 0.25, axis=0)


def mean_variance(points, count, shifts):
    """Variance over random shifts of the share of points in the inscribed disc, and its standard error."""
    found = np.asarray(points(np.arange(count, dtype=np.uint32)[:, None], shifts[:, None]), np.float64)
    squared = (inside_share(found) - np.pi / 4) ** 2
    return squared.mean(), squared.std() / np.sqrt(squared.size)


@BOTH
def test_means_over_points_are_unbiased(points):
    index, moved = np.arange(37, dtype=np.uint32)[:, None], random_shifts(5, 20_000)
    found = np.asarray(points(index, moved[:, None]), np.float64)
    inside = inside_share(found)
    assert abs(inside.mean() - np.pi / 4) < 4 * inside.std() / np.sqrt(inside.size)


def test_hashed_points_are_as_good_as_independent():
    independent = np.pi / 4 * (1 - np.pi / 4)
    for count in (2, 8, 33, 64):
        variance, error = mean_variance(hashed, count, random_shifts(6, 20_000))
        assert abs(variance - independent / count) < 4 * error


def test_r2_spreads_its_points_evenly():
    # A third of the variance of independent points at 8 samples, and ever less with more.
    independent = np.pi / 4 * (1 - np.pi / 4)
    gains = []
    for count in (8, 64, 512):
        variance, error = mean_variance(r2, count, random_shifts(7, 2_000))
        gains.append((variance * count / independent, error * count / independent))
    assert gains[0][0] + 4 * gains[0][1] < 0.5
    for (gain, error), (next_gain, next_error) in zip(gains, gains[1:], strict=False):
        assert gain - next_gain > 4 * np.hypot(error, next_error)


def test_consecutive_hashed_points_and_their_axes_are_uncorrelated():
    found = np.asarray(hashed(np.arange(64, dtype=np.uint32)[:, None], random_shifts(8, 20_000)[:, None]))
    centred = (found.astype(np.float64) - 0.5) * np.sqrt(12)
    pairs = [centred[0] * centred[1]]
    for lag in (1, 2, 8, 32):
        pairs += [centred[i, lag:] * centred[j, :-lag] for i, j in ((0, 0), (1, 1), (0, 1), (1, 0))]
    for product in pairs:
        # Independent standardized uniforms have a product of mean 0 and variance 1.
        assert abs(product.mean()) < 4.5 / np.sqrt(product.size)
