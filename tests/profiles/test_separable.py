"""One-dimensional views of the profile against Bessel functions, integrals and one another."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import k0

from sssfit.profiles import burley, gaussian_sum, separable

line_spread, line_sf, line_excess = (
    jax.jit(f) for f in (separable.line_spread, separable.line_sf, separable.line_excess)
)
spread_slope, sf_slope, excess_slope = (
    jax.jit(jax.grad(f)) for f in (separable.line_spread, separable.line_sf, separable.line_excess)
)
positions = st.floats(-40, 40).filter(lambda x: abs(x) > 1e-6)


def bound(dtype, x):
    """Each exponent is up to x cosh(...), of which half an ulp is lost; six more roundings."""
    return (6 + np.abs(x) / 2) * float(np.finfo(dtype).eps)


def test_line_spread_against_bessel_functions(dtype):
    largest = {"float32": 40, "float64": 80}[dtype.name]
    x = np.geomspace(1e-12, largest, 4001).astype(dtype)
    exact = x.astype(np.float64)
    expected = (k0(exact) + k0(exact / 3)) / (4 * np.pi)
    error = np.abs(np.asarray(line_spread(x, dtype.type(1))) / expected - 1)
    assert np.all(error < bound(dtype, exact))
    np.testing.assert_array_equal(line_spread(-x, dtype.type(1)), line_spread(x, dtype.type(1)))


@pytest.mark.parametrize("order, function", [(1, line_sf), (2, line_excess)])
def test_tails_against_quadrature_in_thirty_digits(x64, order, function):
    for x in (1e-12, 1e-3, 0.1, 1.0, 5.0, 20.0, 80.0):
        with mpmath.workdps(30):

            def bickley(y):
                curve = lambda u: mpmath.exp(-y * mpmath.cosh(u)) / mpmath.cosh(u) ** order  # noqa: E731
                return mpmath.quad(curve, [0, 1, 2, 4, 8, 16, 40])

            expected = (bickley(x) + 3**order * bickley(mpmath.mpf(x) / 3)) / (4 * mpmath.pi)
        assert float(function(x, 1.0)) == pytest.approx(float(expected), rel=bound(np.float64, x))


@pytest.mark.parametrize("x", [0.05, 1.0, 6.0])
def test_line_spread_is_the_profile_along_a_line(x64, x):
    profile = jax.jit(burley.profile)

    def across(y):
        return float(profile(np.hypot(x, y), 1.4))

    half = quad(across, 0, 1, epsrel=1e-12, limit=200)[0] + quad(across, 1, 300, epsrel=1e-12, limit=400)[0]
    assert float(line_spread(x, 1.4)) == pytest.approx(2 * half, rel=1e-10)


def test_line_spread_carries_all_light(x64):
    # In the logarithm of the distance, where the singularity at 0 is tame.
    mass = quad(lambda s: np.exp(s) * float(line_spread(np.exp(s), 0.7)), -40, 5, epsrel=1e-11, limit=400)[0]
    assert 2 * mass == pytest.approx(1, rel=1e-9)


@given(x=positions, d=st.floats(1e-2, 1e2))
def test_each_function_is_the_slope_of_the_next(dtype, x, d):
    x, d = dtype.type(x) * dtype.type(d), dtype.type(d)
    tolerance = 2 * bound(dtype, float(x / d)) + 4 * float(np.finfo(dtype).eps)
    assert float(sf_slope(x, d)) == pytest.approx(-float(line_spread(x, d)), rel=tolerance)
    assert float(excess_slope(x, d)) == pytest.approx(-float(line_sf(x, d)), rel=tolerance)


@given(x=positions)
def test_slopes_are_difference_quotients(x64, x):
    h = 1e-5 * min(abs(x), 1)
    for function, slope in ((line_spread, spread_slope), (line_sf, sf_slope), (line_excess, excess_slope)):
        # Rounding of the values over 2 h, and h^2 / 6 of a third derivative, which is 2 / x^2 near 0.
        noise = 1e-15 * float(function(x, 1.0)) / h
        quotient = (float(function(x + h, 1.0)) - float(function(x - h, 1.0))) / (2 * h)
        assert float(slope(x, 1.0)) == pytest.approx(quotient, rel=1e-8, abs=noise)


@given(x=st.floats(0, 100), d=st.floats(1e-3, 1e3))
def test_both_sides_of_a_line_share_one(dtype, x, d):
    x, d = dtype.type(x) * dtype.type(d), dtype.type(d)
    eps = float(np.finfo(dtype).eps)
    assert float(line_sf(-x, d)) + float(line_sf(x, d)) == pytest.approx(1, abs=2 * eps)
    # The mean excess over -x exceeds that over x by x: nothing pulls to one side.
    difference = float(line_excess(-x, d)) - float(line_excess(x, d))
    assert difference == pytest.approx(float(x), rel=2 * eps, abs=2 * eps * float(d))


@given(x=positions, d=st.floats(1e-2, 1e2), scale=st.sampled_from([2.0**-10, 0.5, 4.0, 2.0**12]))
def test_lines_scale_with_the_material(x64, x, d, scale):
    assert float(line_spread(scale * x, scale * d)) * scale == float(line_spread(x, d))
    assert float(line_sf(scale * x, scale * d)) == float(line_sf(x, d))
    assert float(line_excess(scale * x, scale * d)) == scale * float(line_excess(x, d))


def test_lines_at_the_ends(dtype):
    inf, nan = np.inf, np.nan
    table = [
        (0, 1, inf, 0.5, 2.5 / np.pi),
        (1e6, 1, 0, 0, 0),
        (-1e6, 1, 0, 1, 1e6),
        (inf, 1, 0, 0, 0),
        (-inf, 1, 0, 1, inf),
        (1, 0, 0, 0, 0),
        (0, 0, inf, 0, 0),
        (-1, 0, 0, 1, 1),
        (1, -1, nan, nan, nan),
        (0, -1, nan, nan, nan),
        (nan, 1, nan, nan, nan),
        (1, nan, nan, nan, nan),
    ]
    x, d, *expected = (np.array(column, dtype) for column in zip(*table, strict=True))
    for function, values in zip((line_spread, line_sf, line_excess), expected, strict=True):
        np.testing.assert_allclose(function(x, d), values, rtol=4 * float(np.finfo(dtype).eps))
        gradients = jax.jit(jax.vmap(jax.grad(function, (0, 1))))(x, d)
        assert np.all(np.isfinite(np.array(gradients)[:, :8]))


@pytest.mark.parametrize("taps, reach", [(3, 1.0), (5, 2.0), (25, 0.3), (101, 40.0)])
def test_offsets_are_signed_squares(taps, reach):
    offsets = separable.kernel_offsets(taps, reach)
    assert offsets.dtype == np.float64 and offsets.shape == (taps,)
    assert offsets[0] == -reach and offsets[-1] == reach and offsets[taps // 2] == 0
    np.testing.assert_array_equal(offsets, -offsets[::-1])
    roots = np.sign(offsets) * np.sqrt(np.abs(offsets))
    np.testing.assert_allclose(np.diff(roots), 2 * np.sqrt(reach) / (taps - 1), rtol=1e-12)


@pytest.mark.parametrize(
    "taps, reach", [(1, 1.0), (4, 1.0), (-3, 1.0), (3, 0.0), (3, -1.0), (3, np.inf), (3, np.nan)]
)
def test_bad_offsets_are_refused(taps, reach):
    message = (
        f"reach must be a positive length in mm, got {reach}" if taps == 3 else f"num_taps .* got {taps}"
    )
    with pytest.raises(ValueError, match=message):
        separable.kernel_offsets(taps, reach)


@given(d=st.floats(1e-3, 30))
def test_burley_weights_are_the_masses_of_the_cells(x64, d):
    offsets = separable.kernel_offsets(7, 8.0)
    edges = np.concatenate([offsets[:1], (offsets[1:] + offsets[:-1]) / 2, offsets[-1:]])
    above = np.asarray(line_sf(jnp.abs(edges), d))
    mass = np.abs(np.diff(above))
    mass[3] = 1 - above[3] - above[4]
    weights = np.asarray(separable.burley_kernel(offsets, d))
    np.testing.assert_allclose(weights, mass / mass.sum(), rtol=1e-13, atol=1e-300)
    assert weights.sum() == pytest.approx(1, rel=1e-15 * 7)


def test_burley_weights_of_the_delta_are_the_middle_tap(dtype):
    offsets = separable.kernel_offsets(5, 2.0).astype(dtype)
    weights = jax.jit(separable.burley_kernel)(offsets, np.array([0, 1e-30, 1, -1], dtype))
    np.testing.assert_array_equal(np.asarray(weights)[:, :2], [[0, 0], [0, 0], [1, 1], [0, 0], [0, 0]])
    assert np.all(np.isnan(np.asarray(weights)[:, 3]))


@given(
    falloff=st.lists(st.floats(0.01, 1), min_size=3, max_size=3),
    strength=st.lists(st.floats(0, 1), min_size=3, max_size=3),
)
def test_falloff_weights_are_those_of_the_published_demo(x64, falloff, strength):
    offsets = separable.kernel_offsets(9, 3.0)
    weights = np.asarray(separable.falloff_kernel(offsets, np.array(falloff), np.array(strength)))
    for channel in range(3):
        # The demo's loop, one channel and one tap at a time.
        taps = []
        for i, x in enumerate(offsets):
            left = abs(offsets[i] - offsets[i - 1]) if i > 0 else 0.0
            right = abs(offsets[i] - offsets[i + 1]) if i < 8 else 0.0
            stretched = x / (0.001 + falloff[channel])
            variances, energies = gaussian_sum.SKIN_VARIANCES[1:], gaussian_sum.SKIN_WEIGHTS[1:, 0]
            density = np.sum(energies * np.exp(-(stretched**2) / (2 * variances)) / (2 * np.pi * variances))
            taps.append((left + right) / 2 * density)
        expected = strength[channel] * np.array(taps) / np.sum(taps)
        expected[4] += 1 - strength[channel]
        np.testing.assert_allclose(weights[:, channel], expected, rtol=1e-11, atol=1e-300)
        assert weights[:, channel].sum() == pytest.approx(1, rel=1e-14)


def test_kernels_broadcast_over_channels():
    offsets = separable.kernel_offsets(5, 2.0).astype(np.float32)

    def shape(kernel, *parameters):
        return jax.eval_shape(kernel, offsets, *(np.ones(p, np.float32) for p in parameters)).shape

    assert shape(separable.burley_kernel, ()) == (5,)
    assert shape(separable.burley_kernel, (2, 3)) == (5, 2, 3)
    assert shape(separable.falloff_kernel, (3,), (2, 1)) == (5, 2, 3)
