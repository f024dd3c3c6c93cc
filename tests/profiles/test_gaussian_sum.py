"""Sums of Gaussians against their formulas, published tables and integrals."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sssfit.profiles import gaussian_sum

profile, falloff_profile = jax.jit(gaussian_sum.profile), jax.jit(gaussian_sum.falloff_profile)


def test_the_published_table_for_skin():
    assert gaussian_sum.SKIN_VARIANCES.tolist() == [0.0064, 0.0484, 0.187, 0.567, 1.99, 7.41]
    assert gaussian_sum.SKIN_WEIGHTS.shape == (6, 3)
    np.testing.assert_allclose(gaussian_sum.SKIN_WEIGHTS.sum(axis=0), 1, rtol=1e-15)
    assert gaussian_sum.SKIN_WEIGHTS[4].tolist() == [0.358, 0.004, 0.0]


@given(r=st.floats(0, 20))
def test_profile_is_the_sum_of_its_gaussians(x64, r):
    variances, weights = np.array([0.0484, 1.99, 7.41]), np.array([0.1, 0.358, 0.078])
    expected = np.sum(weights / (2 * np.pi * variances) * np.exp(-(r**2) / (2 * variances)))
    found = float(profile(r, variances, weights))
    # Each exponent's rounding is worth half the exponent.
    assert found == pytest.approx(expected, rel=1e-15 * (4 + r**2), abs=1e-300)


@pytest.mark.parametrize("channel", range(3))
def test_energy_is_the_sum_of_the_weights(x64, channel):
    weights = gaussian_sum.SKIN_WEIGHTS[:, channel]

    def ring(r):
        return 2 * np.pi * r * float(profile(r, gaussian_sum.SKIN_VARIANCES, weights))

    energy = quad(ring, 0, 1, epsrel=1e-12, limit=200)[0] + quad(ring, 1, 40, epsrel=1e-12, limit=200)[0]
    assert energy == pytest.approx(1, rel=1e-11)


def test_profile_keeps_the_shape_of_the_distances():
    r = np.linspace(0, 3, 12, dtype=np.float32).reshape(3, 4)
    variances, weights = np.array([0.5, 2.0], np.float32), np.array([0.4, 0.6], np.float32)
    found = profile(r, variances, weights)
    assert found.shape == (3, 4)
    one_by_one = [[profile(x, variances, weights) for x in row] for row in r]
    np.testing.assert_allclose(found, one_by_one, rtol=1e-6)


def test_profile_far_away(dtype):
    variances, weights = (
        gaussian_sum.SKIN_VARIANCES.astype(dtype),
        gaussian_sum.SKIN_WEIGHTS[:, 0].astype(dtype),
    )
    np.testing.assert_array_equal(profile(np.array([1e6, np.inf], dtype), variances, weights), 0)


def test_falloff_at_the_centre_in_print(x64):
    # P(0) of the five Gaussians, to 12 digits by mpmath; the width does not change it.
    found = falloff_profile(0.0, np.array([0.0, 0.37, 1.0]))
    np.testing.assert_allclose(found, 0.491287768902, rtol=1e-12)


@given(r=st.floats(0, 10), falloff=st.floats(0.05, 1))
def test_falloff_stretches_the_distance(x64, r, falloff):
    stretched = r / (falloff + 0.001)
    expected = profile(stretched, gaussian_sum.SKIN_VARIANCES[1:], gaussian_sum.SKIN_WEIGHTS[1:, 0])
    assert float(falloff_profile(r, falloff)) == pytest.approx(float(expected), rel=1e-14)


@pytest.mark.parametrize("falloff", [0.3, 1.0])
def test_falloff_energy_grows_with_the_square_of_the_width(x64, falloff):
    def ring(r):
        return 2 * np.pi * r * float(falloff_profile(r, falloff))

    energy = (
        quad(ring, 0, falloff, epsrel=1e-12)[0]
        + quad(ring, falloff, 30 * falloff, epsrel=1e-12, limit=200)[0]
    )
    assert energy == pytest.approx(0.767 * (falloff + 0.001) ** 2, rel=1e-10)


def test_no_falloff_is_a_spike_of_finite_height(dtype):
    found = falloff_profile(np.array([0, 1], dtype), dtype.type(0))
    assert np.all(np.isfinite(found))
    assert found[1] == 0
