"""The circle worlds' exact answers by rays around the point in extended precision, and by sampling."""

import math

import equinox as eqx
import jax
import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import k0

from sssfit.scenarios import circle

sample = eqx.filter_jit(lambda world, uniform, frame: world.values(world.places(uniform), frame))

# Mean of Burley's profile for A = 1, d = 1 over a disc of radius r_A at distance r, by mpmath's quadrature.
DISC_AVERAGES = {
    (0, 0.1): 1.53993771516574873,
    (0, 1): 0.117975720484732175,
    (0.5, 0.1): 0.116463966588826625,
    (0.5, 0.5): 0.15991534850128937,
    (0.5, 1): 0.109012682757930438,
    (2, 1): 0.0143173464753542357,
    (2, 0.01): 0.0129066452404910165,
    (5, 2): 0.00177413648071487452,
}

lengths = st.floats(1e-3, 1e3)
# Each probability is a quadrature of its own.
few = settings(max_examples=12)


def by_rays(distance, radius, d):
    """The probability over directions around the point: the cdf between a ray's entry and exit.

    The package adds up arcs around the point instead, radius by radius.
    """
    with mpmath.workdps(20):
        x, r = mpmath.mpf(distance) / mpmath.mpf(d), mpmath.mpf(radius) / mpmath.mpf(d)

        def cdf(s):
            return -(mpmath.expm1(-s) + 3 * mpmath.expm1(-s / 3)) / 4

        gap = (r - x) * (r + x)
        # What happens close to the rim happens near a right angle, or near a ray that touches it.
        bends = [mpmath.mpf(10) ** -k for k in range(0, 13, 3)]
        if gap >= 0:

            def exit_of(angle):
                along = x * mpmath.cos(angle)
                root = mpmath.sqrt(along**2 + gap)
                # Without the difference of near numbers that a ray away from the centre would give.
                return along + root if along >= 0 else gap / (root - along)

            points = [0, *(mpmath.pi / 2 - b for b in bends), *(mpmath.pi / 2 + b for b in reversed(bends))]
            return mpmath.quad(lambda angle: cdf(exit_of(angle)), [*points, mpmath.pi]) / mpmath.pi

        def share(turn):
            # Outside, sin(angle) = (r / x) sin(turn) takes the root in the chord's length away.
            cosine = mpmath.sqrt(1 - (r / x * mpmath.sin(turn)) ** 2)
            along, half = x * cosine, r * mpmath.cos(turn)
            near = -gap / (along + half)
            return (cdf(along + half) - cdf(near)) * r * mpmath.cos(turn) / (x * cosine)

        return mpmath.quad(share, [0, *(mpmath.pi / 2 - b for b in bends), mpmath.pi / 2]) / mpmath.pi


# The uniform square


def test_constants_of_the_uniform_circle():
    with mpmath.workdps(30):
        assert float(4 / mpmath.pi - 1) == pytest.approx(circle.SAMPLE_VARIANCE, rel=4e-16, abs=0)
        assert circle.IRRADIANCE == float(4 / mpmath.pi)


def test_answers_of_the_uniform_circle(dtype):
    intensity = np.array([0.0, 0.5, 1.0, 3.0], dtype)
    world = circle.uniform(intensity)
    for answer in (world.truth, world.sample_variance, world.control, world.surround):
        assert answer.dtype == dtype and answer.shape == (4,)
    close = {"rel": 4 * float(np.finfo(dtype).eps), "abs": 0}
    light = intensity.astype(float)
    assert np.asarray(world.truth) == pytest.approx(light, **close)
    # Second moment less squared mean: h^2 pi / 4 - 1 with h = 4 / pi.
    assert np.asarray(world.sample_variance) == pytest.approx(0.27323954473516269 * light**2, **close)
    for control in (world.control, world.surround):
        assert np.asarray(control) == pytest.approx(4 / math.pi * light, **close)


def test_a_number_of_frames_is_light_that_stays():
    assert np.asarray(circle.uniform(3).truth).tolist() == [1.0, 1.0, 1.0]
    assert circle.uniform(3).truth.dtype == np.float32
    assert np.asarray(circle.uniform(np.array([1, 2])).truth).tolist() == [1.0, 2.0]


def test_samples_of_the_uniform_circle():
    world = circle.uniform(np.array([1.0, 2.0], np.float32))
    uniform = jax.random.uniform(jax.random.key(0), (2, 400_000))
    for frame in (0, 1):
        found = np.asarray(sample(world, uniform, frame), np.float64)
        assert set(np.unique(found)) == {0.0, float(np.float32(4 / math.pi) * (frame + 1))}
        lit = (found > 0).mean()
        assert abs(lit - math.pi / 4) < 4 * math.sqrt(math.pi / 4 * (1 - math.pi / 4) / found.size)


def test_the_rim_of_the_inscribed_circle():
    # Inside by one part in a thousand on every side and diagonal, and outside likewise.
    angle = np.arange(16) * math.pi / 8
    for share, expected in ((0.999, True), (1.001, False)):
        points = 0.5 + 0.5 * share * np.stack([np.cos(angle), np.sin(angle)])
        values = sample(circle.uniform(1), points.astype(np.float32), 0)
        assert np.all((np.asarray(values) > 0) == expected)


# The hit probability


@pytest.mark.parametrize("place", DISC_AVERAGES)
def test_hit_probability_is_the_disc_average_times_its_area(place):
    distance, radius = place
    found = circle.hit_probability(distance, radius=radius, d=1.0)
    # The averages have 15 digits or more.
    assert float(found) == pytest.approx(math.pi * radius**2 * DISC_AVERAGES[place], rel=2e-14, abs=1e-15)


def largest_error(distances, d):
    """Of the probabilities of a disc of radius 1."""
    found = circle.hit_probability(np.array(distances), radius=1.0, d=d)
    return max(abs(float(p - by_rays(x, 1.0, d))) for p, x in zip(found, distances, strict=True))


@pytest.mark.parametrize("d", [0.01, 0.1, 1.0, 30.0])
def test_hit_probability_by_rays(d):
    assert largest_error([1e-9, 0.3, 0.99, 1.0, 1.01, 3.0, 20.0], d) < 1e-12


@pytest.mark.parametrize("d", [1e-6, 1e-3, 0.03, 1.0])
def test_hit_probability_close_to_the_rim(d):
    gaps = np.array([1e-12, 1e-10, 1e-8, 1e-6, 1e-4])
    assert largest_error([*(1 - gaps), *(1 + gaps)], d) < 1e-12


@few
@given(radius=lengths, d=lengths)
def test_at_the_centre_it_is_the_cdf(reference, radius, d):
    found = float(circle.hit_probability(0.0, radius=radius, d=d))
    expected = float(reference.cdf(np.longdouble(radius) / np.longdouble(d)))
    # Rounding radius / d moves the cdf by less than its eps.
    assert found == pytest.approx(expected, abs=1e-15, rel=1e-15)


def test_offsets_and_sizes_at_the_extremes():
    found = circle.hit_probability
    assert float(found(1e6, radius=1.0, d=1.0)) == 0.0
    assert float(found(0.0, radius=1e6, d=1.0)) == 1.0
    assert float(found(1.0, radius=1e9, d=1.0)) == pytest.approx(1, abs=1e-15)
    assert float(found(1.0, radius=2.0, d=1e-9)) == 1.0
    assert float(found(2.0, radius=1.0, d=1e-9)) == 0.0
    # Far inside and outside of a disc of a million d.
    assert float(found(1e6 - 300, radius=1e6, d=1.0)) == pytest.approx(1, abs=1e-15)
    assert 0 <= float(found(1e6 + 300, radius=1e6, d=1.0)) < 1e-30
    assert float(found(1e6, radius=1e6, d=1e6)) == pytest.approx(float(by_rays(1, 1, 1)), abs=1e-12)


@pytest.mark.parametrize("x", [0.5, 2.0, 10.0])
def test_a_huge_disc_is_a_half_plane(x):
    tail, _ = quad(lambda s: (k0(s) + k0(s / 3)) / (4 * math.pi), x, np.inf, epsabs=1e-13)
    outside, inside = circle.hit_probability(np.array([1e6 + x, 1e6 - x]), radius=1e6, d=1.0)
    # A rim of curvature c lies c y^2 / 2 off the straight one at y along it; E y^2 is 7, and the line spread
    # at 1/2 is 0.25.
    assert outside == pytest.approx(tail, abs=1e-6)
    assert inside == pytest.approx(1 - tail, abs=1e-6)


@pytest.mark.parametrize("distance", [0.5, 2.0, 20.0])
def test_a_tiny_disc_sees_the_profile(reference, distance):
    radius = 1e-4
    found = float(circle.hit_probability(distance, radius=radius, d=1.0))
    # The mean over a disc is the value at its centre and radius^2 / 8 times the Laplacian, which of
    # exp(-r) / r is exp(-r) (1 / r^2 + 1 / r + 1) / r: below 8 / r^2 + 2 of the profile altogether.
    expected = math.pi * radius**2 * float(reference.profile(distance))
    assert abs(found - expected) < expected * radius**2 * (1 / distance**2 + 1 / 4) + 1e-15


@few
@given(distance=st.floats(0, 100), radius=lengths, d=lengths, factor=st.sampled_from([0.125, 2.0, 64.0]))
def test_only_ratios_of_lengths_count(distance, radius, d, factor):
    found = circle.hit_probability(distance, radius=radius, d=d)
    scaled = circle.hit_probability(factor * distance, radius=factor * radius, d=factor * d)
    assert float(found) == float(scaled)
    assert -1e-12 < float(found) < 1 + 1e-12


@few
@given(radius=lengths, d=lengths, share=st.floats(1.0, 3.0))
def test_less_from_afar_and_more_from_a_larger_disc(radius, d, share):
    assume(radius / d < 100)
    away = np.linspace(0, 3, 13) * radius
    found = circle.hit_probability(away, radius=radius, d=d)
    # Each is within 1e-12.
    assert np.all(np.diff(found) < 2e-12)
    assert np.all(circle.hit_probability(away, radius=share * radius, d=d) - found > -2e-12)


@pytest.mark.parametrize("radius", [0.2, 1.0, 7.0])
def test_no_light_is_lost(radius):
    # What all points of the plane receive is what the disc sends: its area.
    nodes, weights = np.polynomial.legendre.leggauss(100)
    edges = [0, radius / 2, radius, 2 * radius, 2 * radius + 10, 2 * radius + 40, 2 * radius + 160]
    received = 0.0
    for low, high in zip(edges, edges[1:], strict=False):
        # The slope at the rim is infinite; nodes gather at both ends.
        angle = (nodes + 1) * math.pi / 2
        x = low + (high - low) * (1 - np.cos(angle)) / 2
        step = weights * math.pi / 2 * (high - low) / 2 * np.sin(angle)
        received += np.sum(step * 2 * math.pi * x * circle.hit_probability(x, radius=radius, d=1.0))
    assert received == pytest.approx(math.pi * radius**2, rel=1e-8)


def test_hit_probability_takes_arrays_of_any_shape():
    distance = np.array([[0.0, 0.5], [1.0, 3.0]])
    found = circle.hit_probability(distance, radius=1.0, d=0.5)
    assert found.shape == (2, 2) and found.dtype == np.float64
    for index in np.ndindex(2, 2):
        single = float(circle.hit_probability(distance[index], radius=1.0, d=0.5))
        assert found[index] == pytest.approx(single, rel=1e-14)


# The beam

DISTANCES = np.array([0.0, 0.4, 0.95, 1.0, 1.05, 2.0, 6.0])


def test_answers_of_the_beam(dtype):
    intensity = np.array([1.0, 0.25], dtype)
    world = circle.beam(intensity, distance=DISTANCES, radius=1.0, d=0.5)
    probability = np.array([float(by_rays(x, 1.0, 0.5)) for x in DISTANCES])
    light = 4 / math.pi * intensity.astype(float)[:, None]
    expected = {
        "truth": light * probability,
        "sample_variance": light**2 * probability * (1 - probability),
        "control": light * (DISTANCES < 1),
        "surround": light * np.ones(7),
    }
    for name, answer in expected.items():
        found = getattr(world, name)
        assert found.dtype == dtype and found.shape == (2, 7)
        # To the rounding of the format, and hits within 1e-12.
        assert np.asarray(found) == pytest.approx(answer, rel=2 * float(np.finfo(dtype).eps), abs=2e-12)


def test_samples_of_the_beam(dtype):
    world = circle.beam(np.array([2.0], dtype), distance=DISTANCES, radius=1.0, d=0.5)
    number = 200_000
    uniform = jax.random.uniform(jax.random.key(3), (2, number, DISTANCES.size), dtype)
    found = np.asarray(sample(world, uniform, 0), np.float64)
    assert found.shape == (number, DISTANCES.size)
    truth, variance = (np.asarray(v, float)[0] for v in (world.truth, world.sample_variance))
    assert np.all(np.abs(found.mean(axis=0) - truth) < 4.5 * np.sqrt(variance / number))
    # The variance of a hit or miss follows from its share.
    share = truth / (8 / math.pi)
    error = (8 / math.pi) ** 2 * np.abs(1 - 2 * share) * np.sqrt(share * (1 - share) / number)
    assert np.all(np.abs(found.var(axis=0) - variance) < 4.5 * error + 20 * variance / number)


def test_a_pixel_may_be_a_number():
    world = circle.beam(2, distance=1.0, radius=1.0, d=0.5)
    assert world.truth.shape == (2,)
    assert sample(world, np.full((2, 5), 0.25, np.float32), 0).shape == (5,)


# Faults


@pytest.mark.parametrize(
    "intensity, message",
    [
        (0, "frames must be at least 1, got an intensity of shape"),
        (-2, "frames must be at least 1, got an intensity of shape"),
        (np.ones((2, 2)), r"frames must be at least 1, got an intensity of shape \(2, 2\)"),
        (1.5, r"frames must be at least 1, got an intensity of shape \(\)"),
        ([1.0, -0.5], "intensity must be finite and at least 0 in every frame"),
        ([math.nan], "intensity must be finite and at least 0 in every frame"),
        ([math.inf], "intensity must be finite and at least 0 in every frame"),
    ],
)
def test_faults_of_intensities(intensity, message):
    with pytest.raises(ValueError, match=message):
        circle.uniform(intensity)
    with pytest.raises(ValueError, match=message):
        circle.beam(intensity, distance=0.0, radius=1.0, d=1.0)


@pytest.mark.parametrize(
    "fault, message",
    [
        ({"distance": -1.0}, r"distance must be at least 0 and finite, in mm, got -1.0"),
        ({"distance": [0.0, math.inf]}, r"distance must be at least 0 and finite, in mm, got \[0.0, inf\]"),
        ({"distance": math.nan}, "distance must be at least 0 and finite, in mm, got nan"),
        ({"radius": 0.0}, "radius must be a positive length in mm, got 0.0"),
        ({"radius": math.inf}, "radius must be a positive length in mm, got inf"),
        ({"d": -0.1}, "d must be a positive length in mm, got -0.1"),
        ({"d": math.nan}, "d must be a positive length in mm, got nan"),
    ],
)
def test_faults_of_lengths(fault, message):
    lengths_given = {"distance": 0.0, "radius": 1.0, "d": 1.0} | fault
    distance = lengths_given.pop("distance")
    with pytest.raises(ValueError, match=message):
        circle.hit_probability(distance, **lengths_given)
    with pytest.raises(ValueError, match=message):
        circle.beam(1, distance=distance, **lengths_given)


def test_light_whose_squares_do_not_fit():
    with pytest.raises(ValueError, match="intensity must have squares that fit float32, got 1e"):
        circle.uniform(np.array([1e25], np.float32))
