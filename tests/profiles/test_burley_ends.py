"""Where Burley's functions end: 0, 1, infinity, the delta, what lies outside, and the derivatives there."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.profiles import burley

INF, NAN = np.inf, np.nan

# (q, d): the radius of ppf; that of isf is the same at 1 - q.
QUANTILES = [
    (0, 1, 0),
    (1, 1, INF),
    (-1e-30, 1, NAN),
    (-INF, 1, NAN),
    (1.0000002, 1, NAN),
    (INF, 1, NAN),
    (NAN, 1, NAN),
    (0, 0, 0),
    (0.5, 0, 0),
    (1, 0, 0),
    (-0.5, 0, NAN),
    (1.5, 0, NAN),
    (0, INF, 0),
    (0.5, INF, INF),
    (1, INF, INF),
    (0.5, -1, NAN),
    (0, -1, NAN),
    (1, -INF, NAN),
    (0.5, NAN, NAN),
]

# (r, d): pdf, cdf, sf, profile. Where r / d is inf / inf nothing is defined.
DISTRIBUTION = [
    (0, 1, 0.5, 0, 1, INF),
    (0, 4, 0.125, 0, 1, INF),
    (-1e-30, 1, 0, 0, 1, 0),
    (-1, 1, 0, 0, 1, 0),
    (-INF, 1, 0, 0, 1, 0),
    (INF, 1, 0, 1, 0, 0),
    (1e6, 1, 0, 1, 0, 0),
    (1, 1e-30, 0, 1, 0, 0),
    (1e6, 1e-30, 0, 1, 0, 0),
    (-1, 0, 0, 0, 1, 0),
    (0, 0, INF, 1, 0, INF),
    (1e-30, 0, 0, 1, 0, 0),
    (INF, 0, 0, 1, 0, 0),
    (0, INF, 0, 0, 1, INF),
    (1e6, INF, 0, 0, 1, 0),
    (INF, INF, NAN, NAN, NAN, NAN),
    (1, -1, NAN, NAN, NAN, NAN),
    (0, -1, NAN, NAN, NAN, NAN),
    (-1, -1, NAN, NAN, NAN, NAN),
    (INF, -INF, NAN, NAN, NAN, NAN),
    (NAN, 1, NAN, NAN, NAN, NAN),
    (NAN, 0, NAN, NAN, NAN, NAN),
    (1, NAN, NAN, NAN, NAN, NAN),
    (-1, NAN, NAN, NAN, NAN, NAN),
]


def by_argument(derivative):
    """Both derivatives, each with the other argument held: forward mode would else multiply inf by 0."""
    return lambda f: lambda q, d: (derivative(lambda q: f(q, d), q), derivative(lambda d: f(q, d), d))


# Ways to differentiate a function of (q, d), for vectors of both.
DERIVATIVES = {
    "grad": lambda f: jax.vmap(jax.grad(f, (0, 1))),
    "jacrev": lambda f: jax.vmap(jax.jacrev(f, (0, 1))),
    "jacfwd": lambda f: jax.vmap(by_argument(lambda g, x: jax.jacfwd(g)(x))(f)),
    "jvp": by_argument(lambda g, x: jax.jvp(g, (x,), (jnp.ones_like(x),))[1]),
    "grad of sum": lambda f: jax.grad(lambda q, d: jnp.sum(f(q, d)), (0, 1)),
}


@pytest.mark.parametrize(
    "transform", [lambda f: f, jax.jit, lambda f: jax.jit(jax.vmap(f))], ids=["eager", "jit", "vmap"]
)
def test_quantiles_at_the_ends(dtype, transform):
    q, d, radius = (np.array(column, dtype) for column in zip(*QUANTILES, strict=True))
    with np.errstate(invalid="ignore"):
        complement = 1 - q
    np.testing.assert_array_equal(transform(burley.ppf)(q, d), radius)
    # -1e-30 has no complement in floating point.
    told_apart = (complement <= 1) == (q >= 0)
    found = transform(burley.isf)(complement, d)
    np.testing.assert_array_equal(np.asarray(found)[told_apart], radius[told_apart])
    assert np.isnan(burley.isf(dtype.type(-1e-30), dtype.type(1)))


@pytest.mark.parametrize("transform", [jax.jit, lambda f: jax.jit(jax.vmap(f))], ids=["jit", "vmap"])
@pytest.mark.parametrize("column, name", [(0, "pdf"), (1, "cdf"), (2, "sf"), (3, "profile")])
def test_distribution_at_the_ends(dtype, column, name, transform):
    r, d, *expected = (np.array(values, dtype) for values in zip(*DISTRIBUTION, strict=True))
    np.testing.assert_array_equal(transform(getattr(burley, name))(r, d), expected[column])


def test_a_slab_of_no_thickness_passes_the_albedo(dtype):
    albedo = np.array([0, 0.3, 1], dtype)
    d = np.array([[0], [1e-30], [1], [1e30], [INF]], dtype)
    for thickness in (0, -1):
        passed = jax.jit(burley.transmittance)(dtype.type(thickness), d, albedo)
        np.testing.assert_array_equal(passed, np.broadcast_to(albedo, (5, 3)))
    table = [
        (1e-30, 0, 0),
        (1e6, 1, 0),
        (INF, 1, 0),
        (1e6, INF, 1),
        (1, -1, NAN),
        (0, -1, NAN),
        (1, NAN, NAN),
        (NAN, 1, NAN),
    ]
    thickness, d, passed = (np.array(column, dtype) for column in zip(*table, strict=True))
    np.testing.assert_array_equal(jax.jit(burley.transmittance)(thickness, d), passed)


def test_moments_at_the_ends(dtype):
    d = np.array([0, 2, INF, -1, NAN], dtype)
    np.testing.assert_array_equal(burley.mean(d), np.array([0, 5, INF, NAN, NAN], dtype))
    np.testing.assert_array_equal(burley.variance(d), np.array([0, 31, INF, NAN, NAN], dtype))


def test_shapes_of_any_size(dtype):
    ppf, pdf, cdf, sf = (jax.jit(f) for f in (burley.ppf, burley.pdf, burley.cdf, burley.sf))
    d = np.array([1e-30, 1e-15, 1e-6, 1, 1e6, 1e15, 1e30], dtype)
    for q, x in ((0.5, 1.5521832635441699), (1 - 2.0**-24, 49.043550782960726)):
        np.testing.assert_allclose(ppf(dtype.type(q), d), x * d.astype(np.float64), rtol=4e-7)
    np.testing.assert_allclose(cdf(d, d), 0.37063165677679748, rtol=4e-7)
    np.testing.assert_allclose(sf(d, d), 0.62936834322320252, rtol=4e-7)
    np.testing.assert_allclose(pdf(d, d) * d, 0.27110268793630789, rtol=4e-7)
    slopes = jax.jit(jax.vmap(jax.grad(burley.cdf, (0, 1))))(d, d)
    np.testing.assert_allclose(slopes[0] * d, 0.27110268793630789, rtol=1e-6)
    np.testing.assert_allclose(slopes[1] * d, -0.27110268793630789, rtol=1e-6)


def test_far_offsets_keep_their_relative_position(dtype):
    # A radius of 1e6 shapes is beyond the tail, one of 1e6 mm is not when the shape is as large.
    r, d = np.array([1e6, 2e6, 1e6], dtype), np.array([1e6, 1e6, 1e3], dtype)
    mass = np.array([0.37063165677679748, 0.58110333991640281, 1.0])
    np.testing.assert_allclose(jax.jit(burley.cdf)(r, d), mass, rtol=4e-7)
    np.testing.assert_allclose(jax.jit(burley.sf)(r, d), 1 - mass, rtol=4e-7, atol=1e-100)


# (q, d) and the derivatives of ppf in q and in d. The delta d = 0 stays at 0 whatever q is.
SLOPES = [
    (0, 1, 2, 0),
    (0, 3, 6, 0),
    (0.5, 1, 4.951373035591441, 1.5521832635441699),
    (1 - 2.0**-24, 1, 50331648, 49.043550782960726),
    (1, 1, INF, 0),
    (1, 3, INF, 0),
    (0, 0, 0, 0),
    (0.5, 0, 0, 1.5521832635441699),
    (1, 0, 0, 0),
    (0, INF, INF, 0),
    (0.5, INF, INF, 0),
    (1, INF, INF, 0),
]


@pytest.mark.parametrize("how", DERIVATIVES)
def test_derivatives_of_the_quantiles_at_the_ends(dtype, how):
    q, d, in_q, in_d = (np.array(column, dtype) for column in zip(*SLOPES, strict=True))
    for quantile, arguments, sign in ((burley.ppf, q, 1), (burley.isf, 1 - q, -1)):
        found = jax.jit(DERIVATIVES[how](quantile))(arguments, d)
        # At 1 - 2^-24 the slope takes a third of the radius, 16, times the radius' error.
        np.testing.assert_allclose(found[0], sign * in_q, rtol=17 * 4e-7)
        np.testing.assert_allclose(found[1], in_d, rtol=4e-7)


def test_the_derivative_of_a_scalar_without_compilation():
    for q, d, in_q, in_d in SLOPES[:5]:
        found = jax.grad(burley.ppf, (0, 1))(np.float32(q), np.float32(d))
        np.testing.assert_allclose([float(g) for g in found], [in_q, in_d], rtol=17 * 4e-7)


@pytest.mark.parametrize("how", DERIVATIVES)
@pytest.mark.parametrize("name", ["ppf", "isf"])
def test_the_derivative_in_d_is_finite_for_any_arguments(how, name):
    ends = np.array([0, 1e-30, 0.5, 1, -1, 2, INF, -INF, NAN], np.float32)
    q, d = (a.ravel() for a in np.meshgrid(ends, ends))
    assert np.all(np.isfinite(jax.jit(DERIVATIVES[how](getattr(burley, name)))(q, d)[1]))


def test_one_bad_variate_does_not_spoil_the_gradient_of_the_others(dtype):
    q = jnp.array([0, 0.5, 1, -1, NAN, 0.5], dtype)

    def total(d):
        r = burley.ppf(q, d)
        return jnp.sum(jnp.where(jnp.isfinite(r), r, 0))

    assert float(jax.jit(jax.grad(total))(dtype.type(2))) == pytest.approx(2 * 1.5521832635441699, rel=4e-7)


@pytest.mark.parametrize("name", ["ppf", "isf"])
def test_second_derivatives_inside(dtype, name, reference, relative_error):
    q = np.array([0, 1e-30, 1e-10, 1e-3, 0.25, 0.4999, 0.5, 0.75, 0.9, 1 - 2.0**-20, 1 - 2.0**-24], dtype)
    if name == "isf":
        q = (1 - q.astype(np.float64)).astype(dtype)[3:]
    hessian = jax.jit(jax.vmap(jax.hessian(getattr(burley, name), (0, 1)), (0, None)))(q, dtype.type(1))
    inside = (q > 0) & (q < 1)
    x = np.where(inside, 1, 0).astype(np.longdouble)
    x[inside] = getattr(reference, name)(q[inside])
    second = -reference.pdf_slope(x) / reference.pdf(x) ** 3
    # Twice the logarithmic derivative of the density, x / 3 at most, and as much again for its slope.
    bound = (3 + 50) * np.finfo(dtype).eps
    assert relative_error(hessian[0][0], second) < bound
    sign = 1 if name == "ppf" else -1
    for mixed in (hessian[0][1], hessian[1][0]):
        assert relative_error(mixed, sign / reference.pdf(x)) < bound
    np.testing.assert_array_equal(hessian[1][1], 0)


@pytest.mark.parametrize("name", ["pdf", "cdf", "sf", "profile", "transmittance"])
def test_first_derivatives_of_the_distribution_are_never_nan(dtype, name):
    r = np.array([-INF, -1, 0, 1e-30, 1, 250, 1e6, INF], dtype)
    d = np.array([0, 1e-4, 1, 1e15], dtype)
    r, d = (a.ravel() for a in np.meshgrid(r, d))
    found = np.array(jax.jit(DERIVATIVES["grad"](getattr(burley, name)))(r, d))
    assert not np.isnan(found).any()
    constant = (d == 0) | (r < 0) | (r == INF) | ((name == "profile") & (r == 0))
    assert np.all(found[:, constant] == 0)
    assert np.all(found[0, ~constant & (r <= d)] != 0)


@pytest.mark.parametrize("half", [jnp.float16, jnp.bfloat16])
@pytest.mark.parametrize("name", ["ppf", "isf", "pdf", "cdf", "sf", "profile"])
def test_half_precision_is_the_rounded_float32(half, name):
    arguments = jnp.array([0, 0.1, 0.5, 0.9, 1], half), jnp.array([0.5, 1, 2, 0.25, 3], half)
    found = getattr(burley, name)(*arguments)
    assert found.dtype == half
    single = getattr(burley, name)(*(a.astype(jnp.float32) for a in arguments))
    np.testing.assert_array_equal(found, single.astype(half))


@pytest.mark.parametrize("name", ["ppf", "isf", "pdf", "cdf", "sf", "profile", "transmittance"])
def test_integers_count_as_floats(dtype, name):
    function = jax.jit(getattr(burley, name))
    r, d = [0, 1, 1, 1], [1, 2, 0, 1]
    found = function(np.array(r, np.int32), np.array(d, np.int32))
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, function(np.array(r, dtype), np.array(d, dtype)))
    # Python's own numbers.
    np.testing.assert_array_equal(function(1, 2), function(1.0, 2.0))


@pytest.mark.parametrize("name", ["ppf", "isf", "pdf", "cdf", "sf", "profile", "transmittance"])
def test_arguments_broadcast(name):
    function = jax.jit(getattr(burley, name))
    q = np.array([[0.1], [0.5], [0.9]], np.float32)
    d = np.array([0.5, 1, 2, 4], np.float32)
    found = function(q, d)
    assert found.shape == (3, 4)
    # Scalars are compiled differently: each of the two is within 4e-7 of the truth.
    np.testing.assert_allclose(found, [[function(a, b) for b in d] for a in q[:, 0]], rtol=8e-7)
    assert function(q[:0], d).shape == (0, 4)
    assert function(np.float32(0.5), np.float32(1)).shape == ()
    with pytest.raises(ValueError, match="shape"):
        function(q[:, 0], d)
