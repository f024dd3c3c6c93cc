import json
import os
import subprocess
import sys

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, simpson

from sssfit.tables import curvature
from sssfit.tables.lookup_error import lookup_error

SKIN = np.array([0.7568628, 0.32156864, 0.2])
DISTANCES = ("chord", "arc")
AVERAGES = ("sphere", "great_circle")
COSINES = np.linspace(-1, 1, 33)
conventions = pytest.mark.parametrize(
    ("distance", "average"), [(distance, average) for distance in DISTANCES for average in AVERAGES]
)


def radial_density(s, d):
    return (np.exp(-s / d) + np.exp(-s / (3 * d))) / (4 * d)


def light_on_circle(theta, x, average):
    """Mean of max(0, N.L) over the sphere's points at angle x, from the azimuths that are lit."""
    if average == "great_circle":
        return (max(0.0, np.cos(theta + x)) + max(0.0, np.cos(theta - x))) / 2
    a, b = np.cos(theta) * np.cos(x), np.sin(theta) * np.sin(x)
    if a >= b:
        return a
    if a <= -b:
        return 0.0
    lit = np.arccos(-a / b)
    return (a * lit + b * np.sin(lit)) / np.pi


def by_adaptive_quadrature(cosine, d, distance, average):
    """On a sphere of radius 1, over the arc between the places where the integrand is not smooth."""
    theta = np.arccos(cosine)
    kink = abs(np.pi / 2 - theta)
    breaks = np.unique(np.clip([0, kink, np.pi - kink, np.pi, *(d * 3.0 ** np.arange(-4, 6))], 0, np.pi))

    def mass(x):
        if distance == "chord":
            return radial_density(2 * np.sin(x / 2), d) * np.cos(x / 2)
        return radial_density(x, d) * (np.sinc(x / np.pi) if average == "sphere" else 1.0)

    def integral(function):
        spans = zip(breaks[:-1], breaks[1:], strict=True)
        return sum(quad(function, a, b, epsabs=1e-13, epsrel=1e-11, limit=200)[0] for a, b in spans)

    return integral(lambda x: mass(x) * light_on_circle(theta, x, average)) / integral(mass)


@conventions
def test_grid_matches_adaptive_quadrature(distance, average):
    shapes = np.array([1e-6, 1e-3, 0.03, 0.25, 1.0, 30.0])
    cosines = np.array([-1, -0.6, -0.01, 0, 0.3, 0.9, 1])
    # One channel holds the curvature, so that a row of curvatures is a row of relative shapes.
    values = curvature.evaluate(shapes, cosines, np.ones(3), distance, average)[:, :, 0]
    expected = [[by_adaptive_quadrature(c, d, distance, average) for c in cosines] for d in shapes]
    np.testing.assert_allclose(values, expected, rtol=0, atol=1e-7)


@conventions
@pytest.mark.parametrize("cosine", [-0.3, 0.02, 0.7])
def test_single_cosines_keep_the_accuracy(distance, average, cosine):
    value = curvature.evaluate([0.25], [cosine], np.ones(3), distance, average)[0, 0, 0]
    assert value == pytest.approx(by_adaptive_quadrature(cosine, 0.25, distance, average), abs=1e-6)


@pytest.mark.parametrize("distance", DISTANCES)
def test_sphere_matches_a_sum_over_points(distance):
    d, light = 0.25, np.array([np.sin(2.0), 0.0, np.cos(2.0)])
    # Points around the pole, denser near it as the kernel is: chord or arc s = 2 t^2.
    t = (np.arange(2000) + 0.5) / 2000
    polar = np.pi * t**2
    azimuth = 2 * np.pi * (np.arange(400) + 0.5) / 400
    sine = np.sin(polar)[:, None]
    points = np.stack(
        [sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)[:, None] + 0 * azimuth], -1
    )
    pole = np.array([0.0, 0.0, 1.0])
    length = np.linalg.norm(points - pole, axis=-1) if distance == "chord" else polar[:, None]
    area = sine * t[:, None]
    weight = area * radial_density(length, d) / length
    expected = np.sum(weight * np.maximum(0, points @ light)) / np.sum(weight * np.ones(400))
    value = curvature.evaluate([1.0], [light[2]], np.full(3, d), distance)[0, 0, 0]
    assert value == pytest.approx(expected, abs=2e-6)


def test_published_setting():
    # Dissertation supplement: S = 1 / 0.7568628, radius 3, theta pi / 4. Integrals to 30 digits: the
    # great circle's is 0.563473121128182 of a mass of 0.946521806008770; the sphere's is this ratio.
    setting = ([1 / 3], [np.sqrt(0.5)], np.full(3, 0.7568628))
    sphere = curvature.evaluate(*setting)
    circle = curvature.evaluate(*setting, average="great_circle")
    np.testing.assert_allclose(sphere, 0.576285275203597, rtol=0, atol=1e-6)
    np.testing.assert_allclose(circle, 0.563473121128182 / 0.946521806008770, rtol=0, atol=1e-9)


@conventions
def test_flat_rows_and_delta_channels_are_unscattered(distance, average):
    table = curvature.curvature(
        [1.0, 0.0, 0.3], num_cosines=64, num_curvatures=5, distance=distance, average=average
    )
    clamped = np.maximum(0, table.axes[1].values)
    np.testing.assert_array_equal(table.values[0], np.stack([clamped] * 3, -1))
    np.testing.assert_array_equal(table.values[:, :, 1], np.stack([clamped] * 5))


@settings(max_examples=25, deadline=None)
@given(
    relative=st.floats(1e-8, 1e3),
    scale=st.floats(1e-3, 1e3),
    distance=st.sampled_from(DISTANCES),
    average=st.sampled_from(AVERAGES),
)
def test_only_shape_times_curvature_matters(relative, scale, distance, average):
    here = curvature.evaluate([relative], COSINES, np.ones(3), distance, average)
    there = curvature.evaluate([relative * scale], COSINES, np.full(3, 1 / scale), distance, average)
    np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-13)


@settings(max_examples=25, deadline=None)
@given(relative=st.floats(0, 1e3), distance=st.sampled_from(DISTANCES), average=st.sampled_from(AVERAGES))
def test_light_rises_with_the_cosine_within_its_range(relative, distance, average):
    values = curvature.evaluate([relative], COSINES, np.ones(3), distance, average)[0, :, 0]
    assert np.all(np.diff(values) >= -1e-15)
    assert values.min() >= -1e-15 and values.max() <= 1


@settings(max_examples=15, deadline=None)
@given(relative=st.floats(1e-3, 1e2), distance=st.sampled_from(DISTANCES))
def test_the_sphere_keeps_its_energy(relative, distance):
    # Lit from all sides in turn, every point receives the mean of max(0, cos), a quarter, scattered
    # or not. Only an average over the whole sphere can know that.
    cosines = np.linspace(-1, 1, 257)
    values = curvature.evaluate([relative], cosines, np.ones(3), distance)[0, :, 0]
    assert simpson(values, cosines) / 2 == pytest.approx(0.25, abs=2e-5)


@settings(max_examples=25, deadline=None)
@given(
    relative=st.floats(1e-12, 1e-2), distance=st.sampled_from(DISTANCES), average=st.sampled_from(AVERAGES)
)
def test_scattering_vanishes_with_the_curvature(relative, distance, average):
    # No light travels further than the arc to its point: 2.5 d on average, pi / 2 more than the chord.
    values = curvature.evaluate([relative], COSINES, np.ones(3), distance, average)[0, :, 0]
    moved = np.abs(values - np.maximum(0, COSINES))
    assert moved.max() <= 2.5 * np.pi / 2 * relative * 1.001 + 1e-9


@pytest.mark.parametrize("average", AVERAGES)
def test_chord_and_arc_agree_where_the_surface_is_flat_to_the_profile(average):
    chord = curvature.evaluate([1e-3], COSINES, SKIN, "chord", average)
    arc = curvature.evaluate([1e-3], COSINES, SKIN, "arc", average)
    np.testing.assert_allclose(chord, arc, rtol=0, atol=1e-5)
    assert np.max(np.abs(chord - curvature.evaluate([1.0], COSINES, SKIN, "arc", average))) > 0.1


def test_layout_and_parameters():
    table = curvature.curvature(SKIN, 9, 3, max_curvature=0.5, distance="arc", average="great_circle")
    assert [(axis.name, axis.unit) for axis in table.axes] == [("curvature", "1/mm"), ("cosine", "1")]
    np.testing.assert_array_equal(table.axes[0].values, [0, 0.25, 0.5])
    np.testing.assert_array_equal(table.axes[1].values, np.linspace(-1, 1, 9))
    rows, columns = (axis.values for axis in table.axes)
    expected = curvature.evaluate(rows, columns, SKIN, "arc", "great_circle")
    np.testing.assert_array_equal(table.values, expected)
    assert json.loads(json.dumps(table.parameters)) == {
        "profile": "burley",
        "d": SKIN.tolist(),
        "max_curvature": 0.5,
        "distance": "arc",
        "average": "great_circle",
    }


def test_lookup_error_is_that_of_the_terminator():
    # 64 cosines straddle N.L = 0, the kink of the flat row; an odd number has it on an entry.
    def evaluate(curvatures, cosines):
        return curvature.evaluate(curvatures, cosines, SKIN)

    assert lookup_error(curvature.curvature(SKIN), evaluate) == pytest.approx(0.5 / 63, rel=1e-6)
    assert lookup_error(curvature.curvature(SKIN, num_cosines=65), evaluate) < 0.002


@pytest.mark.parametrize("flag", [False, True])
def test_result_is_float64_whatever_the_flag(flag):
    with jax.enable_x64(flag):
        values = curvature.curvature(SKIN, 8, 8).values
    assert isinstance(values, np.ndarray) and values.dtype == np.float64
    np.testing.assert_array_equal(values, curvature.curvature(SKIN, 8, 8).values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_cosines": 0}, "num_cosines must be at least 2, got 0"),
        ({"num_curvatures": 1}, "num_curvatures must be at least 2, got 1"),
        ({"d": [1.0, np.nan, 1.0]}, "d must be at least 0 and finite, got nan"),
        ({"d": [1.0, np.inf, 1.0]}, "d must be at least 0 and finite, got inf"),
        ({"d": [1.0, 1.0]}, r"d must hold 3 numbers, one per channel, got shape \(2,\)"),
        ({"max_curvature": np.inf}, "max_curvature must be positive and finite, in 1/mm, got inf"),
        ({"distance": "ring"}, "distance must be 'chord' or 'arc', got 'ring'"),
        ({"average": "circle"}, "average must be 'sphere' or 'great_circle', got 'circle'"),
    ],
)
def test_arguments_outside_the_domain(arguments, message):
    with pytest.raises(ValueError, match=message):
        curvature.curvature(**{"d": SKIN, **arguments})


def test_coordinates_outside_the_domain():
    with pytest.raises(ValueError, match=r"cosines must be in \[-1, 1\], got 1.5"):
        curvature.evaluate([0.0], [0.0, 1.5], SKIN)
    with pytest.raises(ValueError, match="curvatures must be at least 0 and finite, got -1"):
        curvature.evaluate([-1.0], [0.0], SKIN)


def test_bytes_do_not_depend_on_the_number_of_threads():
    code = (
        "import hashlib; from sssfit.tables import curvature; "
        "print(hashlib.sha256(curvature.curvature([2.0, 1.2, 0.7]).values.tobytes()).hexdigest())"
    )
    digests = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"OPENBLAS_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(digests) == 1
