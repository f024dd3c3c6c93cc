"""The radii that each method draws: finite, ordered, as near the exact ones as stated."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.fitting import inverse_cdf_approximation as approximation
from sssfit.profiles import burley
from sssfit.sampling import _unit_radius, inverse_cdf
from sssfit.sampling.inverse_cdf import METHODS

LARGEST = 1 - 2.0**-24
#: Methods whose radius grows with the variate.
MONOTONE = [name for name in METHODS if name != "mixture"]

# g(xi | 2.5715) by mpmath, 17 digits.
XIE = {
    0.01: 0.020158109376405643,
    0.1: 0.21674238478549738,
    0.5: 1.5843611679648950,
    0.9: 5.7895048285695788,
    0.99: 11.815876585655455,
    0.999: 17.759344917760627,
}

# Largest relative error of the radius for variates from 1e-30 to 1 - 2^-24, in float32 and in float64. The
# float32 figures of the polynomials and of `halley` add the rounding, 4e-7, to the approximation's own.
RELATIVE_ERROR = {
    "exact": (4e-7, 7.5e-16),
    "newton": (2.32e-4, 2.31e-4),
    "halley": (1.3e-6, 8.6e-7),
    "log_linear": (0.0274, 0.0274),
    "log_poly4": (4.6e-4, 4.6e-4),
    "log_poly8": (2e-6, 1.3e-6),
    "log_poly12": (5e-7, 2.5e-8),
}


def variates(dtype, count=40_001):
    """From 1e-30 to 1 - 2^-24: towards both ends, at random, and all multiples of 2^-24 at the ends."""
    low = np.geomspace(1e-30, 0.5, count)
    steps = np.arange(1, count) * 2.0**-24
    high = 1 - np.geomspace(2.0**-24, 0.5, count)
    at_random = LARGEST * np.random.default_rng(5).random(count) + 2.0**-25
    return np.sort(np.concatenate([low, high, at_random, steps, 1 - steps]).astype(dtype))


def exact(xi):
    with jax.enable_x64(True):
        return np.asarray(jax.jit(burley.ppf)(xi.astype(np.float64), 1.0))


@pytest.mark.parametrize("name", METHODS)
def test_every_float32_variate_gets_a_finite_radius(name):
    special = np.array([0, 1e-45, 1e-38, 1e-30, 2.0**-25, 2.0**-24, 0.25, 0.5, 0.75, LARGEST, 1], np.float32)
    method = METHODS[name]
    for xi in (special, variates(np.float32)):
        radius, density = (np.asarray(jax.jit(f)(xi, np.float32(1))) for f in (method.radius, method.pdf))
        assert np.all(np.isfinite(radius)) and np.all(np.isfinite(density))
        # The published closed form loses what is below its rounding of 1, and its sign.
        assert np.all(radius >= (-1e-6 if name == "closed_form" else 0))
        assert np.all(density > 0)
        assert radius.max() < 50


@pytest.mark.parametrize("name", METHODS)
def test_variates_beyond_the_largest_are_clamped_to_it(dtype, name):
    method = METHODS[name]
    xi = np.array([LARGEST, 1, 1.5, np.inf], dtype)
    for function in (jax.jit(method.radius), jax.jit(method.pdf)):
        values = np.asarray(function(xi, dtype.type(2)))
        assert np.isfinite(values[0])
        np.testing.assert_array_equal(values, values[0])
    # mpmath: the exact radius there. The approximations of one logarithm come near it, g does not.
    expected = {"xie": 42.778270, "log_linear": 49.731594, "log_poly4": 49.037961}.get(
        name, 49.043550782960726
    )
    assert float(jax.jit(method.radius)(xi, dtype.type(1))[1]) == pytest.approx(expected, rel=1e-6)


def test_the_largest_variate_is_the_largest_float32_below_one():
    assert inverse_cdf.LARGEST_VARIATE == np.nextafter(np.float32(1), np.float32(0)) == LARGEST


@pytest.mark.parametrize("name", METHODS)
def test_the_delta_gets_radius_zero_and_infinite_density(dtype, name):
    xi = np.array([0, 1e-30, 0.3, 0.5, LARGEST, 1], dtype)
    np.testing.assert_array_equal(jax.jit(METHODS[name].radius)(xi, dtype.type(0)), 0)
    np.testing.assert_array_equal(jax.jit(METHODS[name].pdf)(xi, dtype.type(0)), np.inf)


@pytest.mark.parametrize("name", METHODS)
def test_radii_scale_with_the_shape(dtype, name):
    xi = variates(dtype, 101)
    radius, density = jax.jit(METHODS[name].radius), jax.jit(METHODS[name].pdf)
    unit, unit_density = radius(xi, dtype.type(1)), density(xi, dtype.type(1))
    for d in (2.0**-30, 8.0, 2.0**20):
        np.testing.assert_array_equal(radius(xi, dtype.type(d)), d * unit)
        np.testing.assert_allclose(density(xi, dtype.type(d)) * dtype.type(d), unit_density, rtol=3e-7)


@pytest.mark.parametrize("name", RELATIVE_ERROR)
def test_relative_errors_are_those_stated(dtype, name):
    xi = variates(dtype)
    limit = RELATIVE_ERROR[name][dtype == np.float64]
    for mode in (METHODS[name].radius, jax.jit(METHODS[name].radius)):
        error = np.abs(np.asarray(mode(xi, dtype.type(1))) / exact(xi) - 1).max()
        assert error < limit
    if name != "exact" and dtype == np.float64:
        # The bound is a statement of how good it is, not a guess above it.
        assert error > 0.9 * limit


def test_the_exact_method_is_the_quantile(dtype):
    xi = variates(dtype)
    np.testing.assert_array_equal(
        jax.jit(inverse_cdf.exact)(xi, dtype.type(1)), jax.jit(burley.ppf)(xi, dtype.type(1))
    )
    outside = inverse_cdf.exact(np.array([-0.1, np.nan], dtype), dtype.type(1))
    assert np.all(np.isnan(outside))


def test_the_closed_form_is_exact_but_for_small_radii(dtype):
    xi = variates(dtype)
    radius = exact(xi)
    error = np.abs(np.asarray(jax.jit(inverse_cdf.closed_form)(xi, dtype.type(1))) - radius)
    scale = float(np.finfo(dtype).eps) / 2.0**-23
    assert np.all(error < scale * np.maximum(1e-6, 2e-7 * radius))


def test_more_steps_reach_rounding(dtype):
    xi = variates(dtype)
    rounding = {"float32": 4e-7, "float64": 8e-16}[dtype.name]
    for method, steps in ((inverse_cdf.halley, 2), (inverse_cdf.newton, 4)):
        found = jax.jit(lambda xi, d, method=method, steps=steps: method(xi, d, steps))(xi, dtype.type(1))
        assert np.abs(np.asarray(found) / exact(xi) - 1).max() < rounding


def test_the_papers_approximation_in_print(x64):
    for xi, radius in XIE.items():
        # The variate's own rounding is worth xi g' / g times as much, up to 150 for 0.999.
        assert float(inverse_cdf.xie(xi, 1.0)) == pytest.approx(radius, rel=3e-16 * (2 + 0.15 / (1 - xi)))
        assert float(inverse_cdf.xie(xi, 2.0)) == 2 * float(inverse_cdf.xie(xi, 1.0))
    # Another constant: ((2 - c) / 2 - 2) ln(1 / 2).
    assert float(inverse_cdf.xie(0.5, 1.0, 2.6)) == pytest.approx(2.3 * np.log(2), rel=1e-15)


def test_the_papers_approximation_keeps_float32(relative_error):
    xi = variates(np.float32)
    with jax.enable_x64(True):
        expected = np.asarray(inverse_cdf.xie(xi.astype(np.float64), 1.0))
    assert relative_error(inverse_cdf.xie(xi, np.float32(1)), expected) < 4e-7


@pytest.mark.parametrize("name", MONOTONE)
def test_radii_keep_the_order_of_the_variates(name):
    xi = np.unique(
        np.concatenate([np.geomspace(1e-30, 0.5, 200_001), 1 - np.geomspace(2.0**-24, 0.5, 200_001)])
    )
    xi = np.unique(xi.astype(np.float32))
    radius = np.asarray(jax.jit(METHODS[name].radius)(xi, np.float32(1)))
    if name == "closed_form":
        # Its absolute error makes steps of rounding below 1e-3.
        assert np.all(np.diff(radius) >= -1e-6)
        xi, radius = xi[xi > 0.03], radius[xi > 0.03]
    assert np.all(np.diff(radius) > 0)


@pytest.mark.parametrize(
    "form, fit",
    [
        (_unit_radius.LOG_LINEAR, approximation.fit_log_linear),
        (_unit_radius.LOG_POLY4, lambda: approximation.fit_log_polynomial(4)),
        (_unit_radius.LOG_POLY8, lambda: approximation.fit_log_polynomial(8)),
        (_unit_radius.LOG_POLY12, lambda: approximation.fit_log_polynomial(12)),
    ],
    ids=["log_linear", "log_poly4", "log_poly8", "log_poly12"],
)
def test_coefficients_are_those_the_fit_finds(form, fit):
    log_factor, coefficients = fit()
    assert form[0] == pytest.approx(log_factor, rel=1e-13)
    # Powers of xi magnify a solver's rounding by the coefficients of a shifted Chebyshev polynomial.
    condition = (1 + 2**0.5) ** (2 * len(coefficients) - 2)
    np.testing.assert_allclose(form[1], coefficients, rtol=0, atol=8 * condition * 2.0**-53)
    # Their sum is as good as ever.
    xi = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(np.polyval(form[1][::-1], xi), np.polyval(coefficients[::-1], xi), rtol=1e-12)


def test_the_fits_refuse_impossible_orders():
    for count in (0, 15, -1):
        with pytest.raises(ValueError, match=f"num_coefficients must be from 1 to 14, got {count}"):
            approximation.fit_log_polynomial(count)


@pytest.mark.parametrize("size", [2, 3, 16, 256, 1000])
def test_the_table_is_exact_at_its_entries_and_linear_between(x64, size):
    nodes = np.minimum(np.linspace(0, 1, size), LARGEST)
    entries = exact(nodes)
    looked_up = jax.jit(lambda xi: inverse_cdf.table(xi, 1.0, size))
    np.testing.assert_allclose(looked_up(nodes), entries, rtol=1e-14, atol=0)
    xi = np.random.default_rng(6).random(1000) * LARGEST
    np.testing.assert_allclose(looked_up(xi), np.interp(xi, nodes, entries), rtol=1e-12)


@pytest.mark.parametrize("size", [1, 0, -5])
def test_a_table_needs_two_entries(size):
    with pytest.raises(ValueError, match=f"size must be at least 2, got {size}"):
        inverse_cdf.table(0.5, 1.0, size)


def test_a_table_made_under_jit_or_in_another_precision_is_the_same():
    inverse_cdf._unit_radius.entries.cache_clear()
    inside = jax.jit(lambda xi: inverse_cdf.table(xi, 1.0, 77))(jnp.float32(0.4))
    with jax.enable_x64(True):
        wide = inverse_cdf.table(0.4, 1.0, 77)
    assert float(inside) == float(inverse_cdf.table(jnp.float32(0.4), 1.0, 77))
    assert float(inside) == pytest.approx(float(wide), rel=4e-7)


def test_the_mixture_draws_each_exponential_from_its_share(dtype):
    # 1/4 of the variates give the narrow exponential, 3/4 the wide one, each by its own inverse.
    narrow = np.linspace(0, 0.25, 1001)[:-1].astype(dtype)
    wide = np.linspace(0.25, 1, 1001)[:-1].astype(dtype)
    eps = float(np.finfo(dtype).eps)
    found = np.asarray(inverse_cdf.mixture(narrow, dtype.type(2)))
    np.testing.assert_allclose(
        found, -2 * np.log1p(-4 * narrow.astype(np.longdouble)).astype(float), rtol=4 * eps
    )
    found = np.asarray(inverse_cdf.mixture(wide, dtype.type(2)))
    # Here 1 - xi is exact from 1/2 on, and half an ulp of 1 is lost below.
    expected = -6 * np.log(4 * (1 - wide.astype(np.longdouble)) / 3).astype(float)
    np.testing.assert_allclose(found, expected, rtol=4 * eps, atol=6 * eps)
    assert found[0] == 0


@pytest.mark.parametrize("name", METHODS)
def test_dtypes_ranks_and_transformations(name):
    for function in (METHODS[name].radius, METHODS[name].pdf):
        for dtype in (jnp.float16, jnp.bfloat16, jnp.float32):
            xi = jnp.array([0.1, 0.5, 0.9], dtype)
            assert jax.eval_shape(function, xi, xi).dtype == dtype
        with jax.enable_x64(True):
            assert jax.eval_shape(function, np.float64(0.5), np.float64(1)).dtype == jnp.float64
            assert jax.eval_shape(function, jnp.float32(0.5), jnp.float32(1)).dtype == jnp.float32
        assert jax.eval_shape(function, 0, 1).dtype == jnp.float32
        assert jax.eval_shape(function, jnp.zeros((5, 1)), jnp.ones(3)).shape == (5, 3)
        xi, d = jnp.array([0.1, 0.4, 0.9], jnp.float32), jnp.array([1.0, 2.0, 0.5], jnp.float32)
        with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
            # Promotion is refused while tracing, so shapes are all that has to be computed.
            assert jax.eval_shape(function, xi, d) == jax.eval_shape(jax.vmap(function), xi, d)
            assert jax.eval_shape(partial(function, 0.5, 1.0)).shape == ()
            gradients = jax.jit(jax.vmap(jax.grad(function, (0, 1))))(xi, d)
        assert np.all(np.isfinite(gradients))


@pytest.mark.parametrize("name", METHODS)
def test_half_precision_is_the_rounded_float32(name):
    xi = jnp.array([0, 0.1, 0.3, 0.9], jnp.bfloat16)
    for function in (METHODS[name].radius, METHODS[name].pdf):
        wide = jax.jit(function)(xi.astype(jnp.float32), jnp.float32(1))
        narrow = jax.jit(function)(xi, jnp.bfloat16(1))
        # The density is taken at the radius before that is rounded; one last rounding is left.
        np.testing.assert_allclose(narrow.astype(jnp.float32), wide, rtol=2.0**-8, atol=1e-6)
