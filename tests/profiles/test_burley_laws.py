"""What must hold between Burley's functions, for any radius and shape."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sssfit.profiles import burley

# Relative error of a value, float32 as documented; see test_burley_values.py.
ERROR = {"float32": 5e-7, "float64": 1.25e-15}

lengths = st.floats(1e-6, 1e6)
probabilities = st.floats(1e-12, 1 - 2.0**-24)
powers_of_two = st.integers(-20, 20).map(lambda n: 2.0**n)

# Compiled once: a law is tried on many scalars.
pdf, cdf, sf, ppf, isf, profile, transmittance = (
    jax.jit(f)
    for f in (
        burley.pdf,
        burley.cdf,
        burley.sf,
        burley.ppf,
        burley.isf,
        burley.profile,
        burley.transmittance,
    )
)
cdf_slopes = jax.jit(jax.grad(burley.cdf, (0, 1)))
sf_slopes = jax.jit(jax.grad(burley.sf, (0, 1)))


@given(x=st.floats(1e-6, 60), d=lengths, scale=powers_of_two)
def test_a_scaled_world_has_the_scaled_profile(dtype, x, d, scale):
    d, r, scale = dtype.type(d), dtype.type(x) * dtype.type(d), dtype.type(scale)
    # A power of two scales without rounding, so the laws hold to the bit.
    assert pdf(scale * r, scale * d) * scale == pdf(r, d)
    assert cdf(scale * r, scale * d) == cdf(r, d)
    assert sf(scale * r, scale * d) == sf(r, d)
    density = profile(r, d)
    if density > 1e-20:
        assert profile(scale * r, scale * d) * scale**2 == density


@given(q=probabilities, d=lengths, scale=powers_of_two)
def test_scaled_quantiles(dtype, q, d, scale):
    q, d, scale = dtype.type(q), dtype.type(d), dtype.type(scale)
    assert ppf(q, scale * d) == scale * ppf(q, d)
    assert isf(q, scale * d) == scale * isf(q, d)


@given(x=st.floats(0, 300), d=lengths)
def test_cdf_and_sf_share_one(dtype, x, d):
    d, r = dtype.type(d), dtype.type(x) * dtype.type(d)
    below, above = np.float64(cdf(r, d)), np.float64(sf(r, d))
    assert 0 <= below <= 1 and 0 <= above <= 1
    assert abs(below + above - 1) <= ERROR[dtype.name]


@given(x=st.floats(1e-6, 80), d=st.floats(1e-3, 1e3))
def test_the_density_is_the_slope_of_the_distribution(dtype, x, d):
    d, r = dtype.type(d), dtype.type(x) * dtype.type(d)
    density = float(pdf(r, d))
    for slopes, sign in ((cdf_slopes, 1), (sf_slopes, -1)):
        in_r, in_d = (float(s) for s in slopes(r, d))
        assert in_r == pytest.approx(sign * density, rel=2 * ERROR[dtype.name])
        assert in_d == pytest.approx(-sign * density * float(r) / float(d), rel=3 * ERROR[dtype.name])


@given(x=st.floats(1e-3, 60), d=st.floats(1e-3, 1e3))
def test_the_density_is_the_difference_quotient_of_the_distribution(x64, x, d):
    r, h = x * d, 1e-5 * min(x, 1) * d
    # From whichever of the two is small: 1e-10 of rounding. The rest of the series, h^2 / 6, is 2e-11.
    difference = cdf(r + h, d) - cdf(r - h, d) if x < 1.5 else sf(r - h, d) - sf(r + h, d)
    quotient = float(difference) / (2 * h)
    assert quotient == pytest.approx(float(pdf(r, d)), rel=5e-10)


@given(r=lengths, d=lengths, albedo=st.floats(0, 1))
def test_radial_density_is_the_profile_over_a_ring(dtype, r, d, albedo):
    r, d, albedo = (dtype.type(v) for v in (r, d, albedo))
    ring = 2 * np.pi * float(r) * float(profile(r, d, albedo))
    tiny = float(np.finfo(dtype).tiny) * 2 * np.pi * max(1, float(r))
    assert ring == pytest.approx(float(albedo) * float(pdf(r, d)), rel=2 * ERROR[dtype.name], abs=tiny)


@given(thickness=st.floats(0, 100), d=lengths, albedo=st.floats(0, 1))
def test_transmittance_is_the_albedo_times_the_survival(dtype, thickness, d, albedo):
    d, thickness, albedo = dtype.type(d), dtype.type(thickness) * dtype.type(d), dtype.type(albedo)
    expected = float(albedo) * float(sf(thickness, d))
    tiny = float(np.finfo(dtype).tiny)
    found = float(transmittance(thickness, d, albedo))
    assert found == pytest.approx(expected, rel=2 * ERROR[dtype.name], abs=tiny)


@given(q=probabilities, d=lengths)
def test_quantiles_of_complements_agree(x64, q, d):
    # 1 - q is off by half an ulp of 1, which moves the radius by that over its density.
    x = float(ppf(q, 1.0))
    slack = 2.0**-53 / (x * float(pdf(x, 1.0)))
    assert float(isf(1 - q, d)) == pytest.approx(d * x, rel=2e-15 + slack)


@pytest.mark.parametrize("d", [1e-3, 0.3, 1.0, 40.0])
def test_moments_by_quadrature(x64, d):
    def moment(function):
        # In x = r / d, so that the quadrature sees the same curve for every shape.
        value, error = quad(lambda x: function(d * x) * d, 0, 300, epsabs=0, epsrel=1e-12, limit=200)
        assert error < 1e-10 * value
        return value

    assert moment(lambda r: 2 * np.pi * r * float(profile(r, d, 0.7))) == pytest.approx(0.7, rel=1e-11)
    mean = moment(lambda r: r * float(pdf(r, d)))
    second = moment(lambda r: r**2 * float(pdf(r, d)))
    assert float(burley.mean(d)) == pytest.approx(mean, rel=1e-11)
    assert float(burley.variance(d)) == pytest.approx(second - mean**2, rel=1e-10)
    assert second == pytest.approx(14 * d**2, rel=1e-11)


@pytest.mark.parametrize("thickness", [0.1, 1.0, 4.0])
def test_transmittance_is_the_profile_seen_through_a_slab(x64, thickness):
    # Light from under the slab's far side has come the distance sqrt(r^2 + thickness^2).
    def seen(r):
        return 2 * np.pi * r * float(profile(np.hypot(r, thickness), 1.5, 0.6))

    passed = quad(seen, 0, 450, epsabs=0, epsrel=1e-11, limit=400)[0]
    assert float(transmittance(thickness, 1.5, 0.6)) == pytest.approx(passed, rel=1e-10)


@pytest.mark.parametrize("x", [0.3, 2.0, 20.0])
def test_the_cdf_by_quadrature_of_the_density(x64, x):
    mass = quad(lambda r: float(pdf(r, 0.8)), 0, 0.8 * x, epsabs=0, epsrel=1e-12)[0]
    assert float(cdf(0.8 * x, 0.8)) == pytest.approx(mass, rel=1e-12)


def test_a_quantile_spreads_uniform_variates_as_the_density(x64):
    # The mean over the variates of a function of the radius is its mean over the density.
    nodes, weights = np.polynomial.legendre.leggauss(200)
    s = (1 + nodes) / 2
    # The survival probability s^6 tames the tail.
    r = np.asarray(isf(jnp.asarray(s**6), 2.0))
    for function, expected in ((np.ones_like, 1), (lambda r: r, 5), (lambda r: np.exp(-r / 2), 0.3125)):
        assert np.sum(weights / 2 * 6 * s**5 * function(r)) == pytest.approx(expected, rel=1e-9)
