"""The profile's share in rectangles and pixels, against adaptive quadrature."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from sssfit.frames import pixel_kernel

lengths = st.floats(1e-4, 1e3)


def cdf(x):
    return 1 - np.exp(-x) / 4 - 3 * np.exp(-x / 3) / 4


def areal(x, y, d):
    r = np.hypot(x, y)
    return (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r)


def by_angle(width, height, d, cutoff):
    """The cdf at the rectangle's edge, averaged over all directions of the quadrant."""
    reach = np.inf if cutoff is None else cutoff * d

    def to_edge(angle):
        edge = min(width / np.cos(angle), height / max(np.sin(angle), 1e-300), reach)
        return cdf(edge / d) / (1 if cutoff is None else cdf(cutoff))

    kinks = [np.arctan2(height, width)]
    kinks += [np.arccos(width / reach)] if width < reach else []
    kinks += [np.arcsin(height / reach)] if height < reach else []
    return integrate.quad(to_edge, 0, np.pi / 2, points=kinks, epsabs=1e-12, limit=200)[0] / (2 * np.pi)


@pytest.mark.parametrize(
    "width, height, d, cutoff",
    [(0.5, 0.5, 1, None), (0.05, 3, 1, None), (10, 0.1, 0.2, 16), (5, 5, 0.3, 16), (1e-4, 1e-4, 1, None)],
)
def test_quadrants_by_adaptive_quadrature(width, height, d, cutoff):
    found = pixel_kernel.mass_in_quadrant(width, height, d, cutoff=cutoff)
    assert found == pytest.approx(by_angle(width, height, d, cutoff), abs=1e-11)


@given(lengths, lengths, st.floats(1e-3, 1e3))
def test_shares_grow_with_the_rectangle_and_have_its_symmetry(width, height, d):
    share = pixel_kernel.mass_in_quadrant(width, height, d)
    assert 0 <= share <= 0.25 + 1e-12
    assert share == pytest.approx(float(pixel_kernel.mass_in_quadrant(height, width, d)), rel=1e-12)
    assert pixel_kernel.mass_in_quadrant(2 * width, height, d) >= share - 1e-13


def test_all_light_is_in_the_plane_and_the_delta_at_its_centre():
    assert pixel_kernel.mass_in_quadrant(1e7, 1e7, 1.0) == pytest.approx(0.25, abs=1e-13)
    assert pixel_kernel.mass_in_quadrant(16.0, 16.0, 1.0, cutoff=16.0) == pytest.approx(0.25, abs=1e-13)
    assert pixel_kernel.mass_in_quadrant(1e-9, 1e9, 0.0) == 0.25
    assert pixel_kernel.mass_in_parallelogram(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), 0.0) == 1


@pytest.mark.parametrize("row, column", [(0, 1), (3, 2), (7, 0)])
def test_pixels_away_from_the_centre_by_quadrature_of_the_profile(row, column):
    quarter = pixel_kernel.kernel((9, 9), (0.3, 0.2), 0.7)
    ends = (column - 0.5) * 0.2, (column + 0.5) * 0.2, (row - 0.5) * 0.3, (row + 0.5) * 0.3
    # No singularity inside, and the points where its slope is largest are at the ends.
    expected = integrate.dblquad(lambda y, x: areal(x, y, 0.7), *ends, epsabs=1e-10)[0]
    assert quarter[row, column] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("shape", [(1, 1), (5, 9)])
@pytest.mark.parametrize("cutoff", [None, 2.0])
def test_pixels_fill_the_rectangle(shape, cutoff):
    quarter = pixel_kernel.kernel(shape, (0.4, 0.3), 0.5, cutoff=cutoff)
    total = 4 * quarter.sum() - 2 * quarter[0].sum() - 2 * quarter[:, 0].sum() + quarter[0, 0]
    edges = (shape[1] - 0.5) * 0.3, (shape[0] - 0.5) * 0.4
    assert total == pytest.approx(4 * pixel_kernel.mass_in_quadrant(*edges, 0.5, cutoff=cutoff), abs=1e-13)
    assert np.all(quarter >= 0)


@pytest.mark.parametrize("lean", [0.0, 0.6, -3.0])
@pytest.mark.parametrize("cutoff", [None, 1.0])
def test_parallelograms_by_directions(lean, cutoff):
    """Independent of the triangles: how far each direction goes until it leaves."""
    first, second, d = np.array([0.9, 0.0]), np.array([lean, 0.7]), 0.4
    inverse = np.linalg.inv(np.stack([first, second], axis=-1))
    angle = (np.arange(400_000) + 0.5) / 400_000 * 2 * np.pi
    inside = np.abs(inverse @ np.stack([np.cos(angle), np.sin(angle)])).max(axis=0)
    edge = 0.5 / inside
    expected = np.mean(cdf(np.minimum(edge / d, np.inf if cutoff is None else cutoff)))
    expected /= 1 if cutoff is None else cdf(cutoff)
    # A midpoint rule with kinks: 1e-9 is its error, not ours.
    found = pixel_kernel.mass_in_parallelogram(np.append(first, 0), np.append(second, 0), d, cutoff=cutoff)
    assert found == pytest.approx(expected, abs=1e-8)


def test_what_is_refused():
    with pytest.raises(ValueError, match="^width and height must be above 0$"):
        pixel_kernel.mass_in_quadrant(0.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="^d must be at least 0, got -1.0$"):
        pixel_kernel.mass_in_quadrant(1.0, 1.0, -1.0)
    with pytest.raises(ValueError, match="^cutoff must be above 0, got 0$"):
        pixel_kernel.mass_in_quadrant(1.0, 1.0, 1.0, cutoff=0)
