"""Hammersley's, Fibonacci's and Sobol's points: where they are, and how evenly they lie."""

from fractions import Fraction

import jax
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare, kstest, qmc

from sssfit.sampling import hashes, sequences

# One compilation for each shape of the index, the count and the shift.
hammersley = jax.jit(sequences.hammersley)
fibonacci = jax.jit(sequences.fibonacci)
sobol = jax.jit(sequences.sobol)
r2 = jax.jit(sequences.r2)


def of_count(function):
    """A sequence in the form of those with a fixed count."""
    return lambda index, count, shift: function(index, shift)


ALL = {"hammersley": hammersley, "fibonacci": fibonacci, "sobol": of_count(sobol)}
EACH = pytest.mark.parametrize("points", ALL.values(), ids=ALL)
FIXED = pytest.mark.parametrize("points", [hammersley, fibonacci], ids=["hammersley", "fibonacci"])

words = st.integers(0, 2**32 - 1)
ORIGIN = np.zeros((2, 1), np.uint32)
#: Largest number below 1 that the points take.
LARGEST = 1 - 2.0**-24


def random_shifts(seed, count):
    return np.random.default_rng(seed).integers(0, 2**32, (2, count), dtype=np.uint32)


def around(found, place):
    """Distance on the circle of circumference 1."""
    apart = abs(found - place) % 1
    return min(apart, 1 - apart)


def bound(count):
    return Fraction(1, 2**24) + Fraction(1, 2**30) if count <= 2**24 else Fraction(1, 2**21)


@st.composite
def numbered(draw):
    """A count, and the number of one of its points."""
    count = draw(st.one_of(st.integers(1, 100), st.integers(1, 2**24), st.integers(1, 2**31)))
    return draw(st.integers(0, count - 1)), count


@given(point=numbered(), shift=st.tuples(words, words))
def test_first_coordinates_are_equally_spaced(point, shift):
    index, count = point
    start = Fraction(shift[0], 2**32)
    for points, place in (
        (hammersley, Fraction(index, count)),
        (fibonacci, Fraction(2 * index + 1, 2 * count)),
    ):
        found = points(
            np.array([index], np.uint32), np.uint32(count), np.array([[s] for s in shift], np.uint32)
        )
        assert found.dtype == np.float32
        assert around(Fraction(float(found[0, 0])), start + place) <= bound(count)


@given(point=numbered(), shift=words)
def test_second_coordinate_of_hammersley_in_integers(point, shift):
    index, count = point
    found = hammersley(np.array([index], np.uint32), np.uint32(count), np.array([[0], [shift]], np.uint32))
    expected = (int(f"{index:032b}"[::-1], 2) + shift) % 2**32 >> 8
    assert float(found[1, 0]) * 2**24 == expected


def test_hammersley_as_printed():
    # Wong, Luk and Heng, "Sampling with Hammersley and Halton points", 1997: (k / n, 0.k reversed), n = 10.
    found = np.asarray(hammersley(np.arange(10), np.uint32(10), ORIGIN))
    inverse = np.array([0, 1 / 2, 1 / 4, 3 / 4, 1 / 8, 5 / 8, 3 / 8, 7 / 8, 1 / 16, 9 / 16])
    assert np.array_equal(found[1], inverse)
    assert found[0] == pytest.approx(np.arange(10) / 10, abs=2.0**-24)


@pytest.mark.parametrize("number", [0, 1, 2, 17, 9_999, 65_535, 10**6, 10**8])
def test_second_coordinate_of_fibonacci_is_the_golden_ratio(number):
    found = float(fibonacci(np.array([number], np.uint32), np.uint32(2**31), ORIGIN)[1, 0])
    with mpmath.workdps(50):
        place = number * (mpmath.sqrt(5) - 1) / 2 % 1
        apart = abs(mpmath.mpf(found) - place)
        assert min(apart, 1 - apart) <= number * mpmath.mpf(2) ** -33 + mpmath.mpf(2) ** -24


@pytest.mark.parametrize(("before", "count"), [(5, 8), (34, 55), (610, 987)])
def test_fibonacci_counts_give_the_fibonacci_lattice(before, count):
    index = np.arange(count)
    found = np.asarray(fibonacci(index, np.uint32(count), ORIGIN), np.float64)
    apart = np.abs(found[1] - index * before % count / count)
    apart = np.minimum(apart, 1 - apart)
    assert apart.max() <= 1 / (np.sqrt(5) * count) * 1.01 + 2.0**-23
    assert apart.max() > 0.5 / (np.sqrt(5) * count)


def test_sobol_is_scipy_s_with_scrambled_digits():
    with pytest.warns(UserWarning, match="balance properties"):
        plain = qmc.Sobol(2, scramble=False, bits=32).random(5000)
    number = np.arange(5000, dtype=np.uint32)
    gray = number ^ number >> 1  # SciPy's order of the same points.
    seeds = random_shifts(1, 1)
    digits = hashes.reversed_bits((plain.T * 2**32).astype(np.uint32))
    expected = np.asarray(hashes.nested_scramble(digits, seeds)) >> 8
    assert np.array_equal(np.asarray(sobol(gray, seeds)) * 2**24, expected)


def interval_counts(found, k):
    """The points in each elementary interval of area 2^-k, for all k + 1 shapes of interval."""
    for a in range(k + 1):
        cells = np.floor(found[0] * 2**a).astype(int) * 2 ** (k - a) + np.floor(
            found[1] * 2 ** (k - a)
        ).astype(int)
        yield np.bincount(cells, minlength=2**k)


@pytest.mark.parametrize("k", [0, 1, 2, 3, 6, 9, 12])
@pytest.mark.parametrize("block", [0, 1, 5, 1000])
def test_every_elementary_interval_holds_one_point_of_sobol(k, block):
    for shift in random_shifts(block, 3).T:
        found = np.asarray(sobol(np.arange(2**k) + block * 2**k, shift[:, None]), np.float64)
        for counts in interval_counts(found, k):
            assert np.array_equal(counts, np.ones(2**k))


@pytest.mark.parametrize("k", [0, 1, 4, 8, 12])
def test_every_elementary_interval_holds_one_point_of_hammersley(k):
    found = np.asarray(hammersley(np.arange(2**k), np.uint32(2**k), ORIGIN), np.float64)
    for counts in interval_counts(found, k):
        assert np.array_equal(counts, np.ones(2**k))


@given(index=words, count=words, shift=st.tuples(words, words))
def test_points_lie_in_the_square_and_jit_changes_nothing(index, count, shift):
    arguments = np.array([index], np.uint32), np.array([count], np.uint32)
    moved = np.array([[s] for s in shift], np.uint32)
    for name, points in ALL.items():
        found = np.asarray(points(*arguments, moved))
        assert np.all((found >= 0) & (found <= LARGEST))
        eager = getattr(sequences, name)
        eager = eager(arguments[0], moved) if name == "sobol" else eager(*arguments, moved)
        assert np.array_equal(eager, found)


@EACH
def test_vmap_shapes_and_64_bits_change_nothing(points, x64):
    index, count = np.arange(8, dtype=np.int64).reshape(8, 1, 1), np.array([[8, 9, 1000]])
    moved = random_shifts(2, 6).reshape(2, 1, 2, 3)
    found = np.asarray(points(index, count, moved))
    assert found.shape == (2, 8, 2, 3) and found.dtype == np.float32
    mapped = jax.vmap(points, in_axes=(0, None, None), out_axes=1)(index, count, moved[:, 0])
    assert np.array_equal(mapped.reshape(found.shape), found)
    one = points(np.int32(5), np.uint32(1000), moved[:, 0, 1, 2])
    assert one.shape == (2,) and np.array_equal(one, found[:, 5, 1, 2])
    assert np.array_equal(points(index + 2**32, count, moved), found)


@FIXED
def test_counts_of_none_and_one(points):
    shift = random_shifts(3, 1)
    single = np.asarray(points(np.array([0]), np.uint32(1), shift))
    assert np.array_equal(points(np.array([0]), np.uint32(0), shift), single)
    expected = shift[:, 0] / 2**32 + ((0.5 if points is fibonacci else 0), 0)
    assert single[:, 0] == pytest.approx(expected % 1, abs=2.0**-24)


@EACH
def test_a_random_shift_makes_every_point_uniform(points):
    count = 20_000
    index, moved = np.array([[0], [1], [63], [999_999]], np.uint32), random_shifts(4, count)
    found = np.asarray(points(index, np.uint32(10**6), moved[:, None]))
    for number in range(len(index)):
        for axis in range(2):
            assert kstest(found[axis, number], "uniform").pvalue > 1e-4
        cells = np.floor(found[:, number] * 16).astype(int)
        assert chisquare(np.bincount(cells[0] * 16 + cells[1], minlength=256)).pvalue > 1e-4


def disc(found):
    return np.mean(np.square(found - 0.5).sum(axis=0) < 0.25, axis=0)


def smooth(found):
    return np.mean(found[0] * np.exp(found[1]), axis=0)


#: Mean, and variance of one independent point: E x = 1/2, E x^2 = 1/3, E e^y = e - 1, E e^2y = (e^2 - 1) / 2.
DISC = disc, np.pi / 4, np.pi / 4 * (1 - np.pi / 4)
SMOOTH = smooth, (np.e - 1) / 2, (np.e**2 - 1) / 6 - (np.e - 1) ** 2 / 4


def draws(points, count, shifts):
    return np.asarray(points(np.arange(count)[:, None], np.uint32(count), shifts[:, None]), np.float64)


def variance(points, count, world, seed, repeats=2000):
    """Variance of the mean over random shifts around the true one, and its standard error."""
    estimate, mean, _ = world
    squared = (estimate(draws(points, count, random_shifts(seed, repeats))) - mean) ** 2
    return squared.mean(), squared.std() / np.sqrt(squared.size)


@EACH
@pytest.mark.parametrize("world", [DISC, SMOOTH], ids=["disc", "smooth"])
def test_means_over_points_are_unbiased(points, world):
    estimate, mean, _ = world
    found = estimate(draws(points, 37, random_shifts(5, 20_000)))
    assert abs(found.mean() - mean) < 4 * found.std() / np.sqrt(found.size)


@EACH
@pytest.mark.parametrize("world", [DISC, SMOOTH], ids=["disc", "smooth"])
@pytest.mark.parametrize("count", [8, 64, 200])
def test_variance_is_below_that_of_independent_points(points, world, count):
    found, error = variance(points, count, world, 6)
    assert found + 4 * error < 0.7 * world[2] / count


@pytest.mark.parametrize(
    ("points", "edge", "within"),
    [
        (of_count(jax.jit(sequences.hashed)), 1, 1),
        (of_count(r2), 0.19, 0.13),
        (hammersley, 0.21, 0.028),
        (fibonacci, 0.21, 0.032),
        (ALL["sobol"], 0.28, 0.0008),
    ],
    ids=["hashed", "r2", "hammersley", "fibonacci", "sobol"],
)
def test_variances_as_the_module_states_them(points, edge, within):
    for world, stated in ((DISC, edge), (SMOOTH, within)):
        found, error = (x * 64 / world[2] for x in variance(points, 64, world, 12, 5000))
        # Two digits are stated, half a unit of the second at most 6 %.
        assert abs(found - stated) < 4 * error + 0.06 * stated and error < 0.05 * stated


def test_the_error_of_sobol_falls_faster_than_any_shifted_sequence_s():
    # n^-3 up to logarithms where the integrand is smooth, n^-2 for points that are only shifted.
    for points, least, most in ((ALL["sobol"], 2.5, 3.5), (hammersley, 1.6, 2.4), (fibonacci, 1.6, 2.4)):
        (coarse, error), (fine, fine_error) = (variance(points, n, SMOOTH, 7, 1000) for n in (64, 1024))
        slope = np.log(coarse / fine) / np.log(1024 / 64)
        margin = 4 * np.hypot(error / coarse, fine_error / fine) / np.log(16)
        assert least < slope - margin and slope + margin < most


def tree_scrambled(digits, bits, generator, repeats):
    """Owen's scrambling itself: a random bit for every node of the tree, drawn when it is first needed."""
    flips = [generator.integers(0, 2, (repeats, 2**level)) for level in range(bits)]
    place = np.zeros((repeats, len(digits)), np.int64)
    prefix = np.zeros(len(digits), np.int64)
    for level, flip in enumerate(flips):
        digit = digits >> (bits - 1 - level) & 1
        place = 2 * place + (flip[:, prefix] ^ digit)
        prefix = 2 * prefix + digit
    # What is left below the last digit is uniform, and independent but for points that share all of them.
    return (place + generator.random(place.shape)) / 2**bits


@pytest.mark.parametrize("world", [DISC, SMOOTH], ids=["disc", "smooth"])
@pytest.mark.parametrize("count", [4, 16, 64])
def test_hashing_leaves_the_variance_of_owen_s_scrambling(world, count):
    plain = qmc.Sobol(2, scramble=False, bits=32).random(count)
    generator, bits = np.random.default_rng(8), 8
    repeats, (estimate, mean, _) = 20_000, world
    axes = [
        tree_scrambled(np.floor(axis * 2**bits).astype(np.int64), bits, generator, repeats)
        for axis in plain.T
    ]
    squared = (estimate(np.stack(axes).swapaxes(1, 2)) - mean) ** 2
    found, error = variance(ALL["sobol"], count, world, 9, repeats)
    margin = 4 * np.hypot(error, squared.std() / np.sqrt(repeats))
    assert abs(found - squared.mean()) < margin < 0.25 * found


@pytest.mark.parametrize("count", [64, 256])
def test_discrepancy_is_below_that_of_independent_points(count):
    def discrepancies(sets):
        found = [qmc.discrepancy(np.clip(each, 0, 1), method="L2-star") for each in sets]
        return np.mean(found), np.std(found) / np.sqrt(len(found))

    iid, iid_error = discrepancies(np.random.default_rng(10).random((100, count, 2)))
    for points, most in ((ALL["sobol"], 0.4), (hammersley, 0.5), (fibonacci, 0.5), (of_count(r2), 0.6)):
        found, error = discrepancies(
            np.moveaxis(draws(points, count, random_shifts(11, 100)), 0, 2).swapaxes(0, 1)
        )
        assert found + 4 * error < most * (iid - 4 * iid_error)
