"""Values of Burley's distribution against extended precision, over the whole of each domain."""

import jax
import mpmath
import numpy as np
import pytest

from sssfit.profiles import burley

# Bounds on the relative error. In float32 they are what the docstrings promise, 6.7 roundings of 2^-24; in
# float64 the quantiles and the cdf keep to as many of 2^-53, the functions of exponentials to 9.
FLOAT32 = 4e-7
QUANTILE = {"float32": FLOAT32, "float64": 7.5e-16}
EXPONENTIAL = {"float32": FLOAT32, "float64": 1e-15}
PROFILE_BOUND = {"float32": 5e-7, "float64": 1.25e-15}

# One size for all, so that JAX compiles each operation once.
COUNT = 156_002
MODES = {"eager": lambda function: function, "jit": jax.jit}

# Arguments and results to 17 digits, by mpmath in 50 digits.
PPF = {
    1e-30: 2.0000000000000000e-30,
    1e-12: 2.0000000000013333e-12,
    1e-6: 2.0000013333343704e-6,
    0.001: 0.0020013343712105652,
    0.01: 0.020134378834810411,
    0.1: 0.21446181995490126,
    0.25: 0.60366306967574604,
    0.5: 1.5521832635441699,
    0.75: 3.3978847907026315,
    0.9: 6.0622291433267144,
    0.99: 12.952642092055086,
    0.999: 19.860221397366212,
    0.999999: 40.583485456539257,
    1 - 2.0**-24: 49.043550782960726,
}
ISF = {
    2.0**-24: 49.043550782960726,
    0.25: 3.3978847907026315,
    0.5: 1.5521832635441699,
    0.75: 0.60366306967574604,
    1 - 2.0**-24: 1.1920929428773304e-7,
}
PPF_OF_FLOAT32 = {
    2.0**-24: 1.1920929428773304e-7,
    1 - 2.0**-24: 49.043550782960726,
    1e-30: 2.0000000063421537e-30,
    0.1: 0.21446182338442959,
    0.999: 19.860260021378886,
}
CDF_AND_PDF = {
    0.001: (4.9983337961882927e-4, 0.49966680551235622),
    0.1: (0.048378570129505680, 0.46801337962949137),
    1.0: (0.37063165677679748, 0.27110268793630789),
    2.0: (0.58110333991640281, 0.16218810056730118),
    5.0: (0.85665881112205725, 0.048903387459161826),
    16.0: (0.99637900937083274, 0.0012070156322515398),
    40.0: (0.99999878530240576, 4.0489919807921477e-7),
}
PROFILE = {0.1: 0.74486642801177307, 1.0: 0.043147332870562943, 3.0: 0.0055394741297599041}
TRANSMITTANCE = {0.5: 0.78649395859611891, 1.0: 0.62936834322320252, 3.0: 0.28835634797054773}


def variates(dtype):
    """Ascending probabilities: towards both ends, at random, and one by one around 0.5 and at the ends."""
    smallest = float(np.finfo(dtype).epsneg)
    steps = np.arange(1, 4001) * smallest
    q = np.concatenate(
        [
            np.geomspace(1e-30, 0.5, 20_001),
            1 - np.geomspace(smallest, 0.5, 20_001),
            np.random.default_rng(1).random(100_000),
            *(0.5 - steps / 2, 0.5 + steps, steps, 1 - steps),
        ]
    ).astype(dtype)
    assert q.size == COUNT
    return np.sort(np.clip(q, 1e-30, 1 - smallest))


def radii(dtype, largest, smallest=1e-30):
    """Ascending radii, evenly in their logarithm and at random."""
    low = np.geomspace(smallest, largest, COUNT - 50_000)
    high = smallest + (largest - smallest) * np.random.default_rng(2).random(50_000)
    return np.sort(np.concatenate([low, high]).astype(dtype))


def exact_root(q, complement):
    """The radius by bisection of its logarithm in 40 digits."""
    with mpmath.workdps(40):
        low, high = mpmath.mpf(-80), mpmath.mpf(7)
        for _ in range(80):
            middle = (low + high) / 2
            x = mpmath.exp(middle)
            if q < complement:
                below = -(mpmath.expm1(-x) + 3 * mpmath.expm1(-x / 3)) / 4 < q
            else:
                below = (mpmath.exp(-x) + 3 * mpmath.exp(-x / 3)) / 4 > complement
            low, high = (middle, high) if below else (low, middle)
        return mpmath.exp(high)


def test_reference_has_the_digits_it_claims(reference):
    rng = np.random.default_rng(3)
    probabilities = [*10 ** rng.uniform(-30, -0.3, 50), *rng.random(49), 0.5]
    for find, mirrored in ((reference.ppf, False), (reference.isf, True)):
        for q, x in zip(probabilities, find(probabilities), strict=True):
            with mpmath.workdps(40):
                sides = (mpmath.mpf(q), 1 - mpmath.mpf(q))
                found = mpmath.mpf(float(x)) + mpmath.mpf(float(x - np.longdouble(float(x))))
                assert abs(found / exact_root(*(sides[::-1] if mirrored else sides)) - 1) < reference.accuracy


@pytest.mark.usefixtures("fine_reference")
@pytest.mark.parametrize("name", ["ppf", "isf"])
def test_quantiles_over_the_open_interval(dtype, name, reference, relative_error):
    q = variates(dtype)
    expected = getattr(reference, name)(q)
    for mode in MODES.values():
        found = mode(getattr(burley, name))(q, dtype.type(1))
        assert found.dtype == dtype
        assert relative_error(found, expected) < QUANTILE[dtype.name]
        # On the finest grid of all, neighbours may be out of order by their rounding, and by no more.
        steps = np.diff(np.asarray(found, np.float64)) * (1 if name == "ppf" else -1)
        assert np.all(steps >= -QUANTILE[dtype.name] * np.asarray(found)[1:])


@pytest.mark.usefixtures("fine_reference")
@pytest.mark.parametrize(
    "name, largest, bound",
    [
        ("cdf", 80, QUANTILE),
        ("sf", 250, EXPONENTIAL),
        ("pdf", 250, EXPONENTIAL),
        ("profile", 230, PROFILE_BOUND),
    ],
)
def test_distribution_over_its_range(dtype, name, largest, bound, reference, relative_error):
    x = radii(dtype, largest)
    expected = getattr(reference, name)(x)
    for mode in MODES.values():
        found = mode(getattr(burley, name))(x, dtype.type(1))
        assert found.dtype == dtype
        assert relative_error(found, expected) < bound[dtype.name]


def test_cdf_is_one_to_rounding_from_80_on(dtype):
    x = radii(dtype, 1e4, 80)
    assert np.all(np.abs(np.asarray(burley.cdf(x, dtype.type(1))) - 1) <= 3e-12 + np.finfo(dtype).eps)


@pytest.mark.usefixtures("fine_reference")
@pytest.mark.parametrize("name", ["pdf", "cdf", "sf", "profile"])
def test_other_shapes_lose_what_rounding_the_ratio_costs(dtype, name, reference):
    rng = np.random.default_rng(4)
    d = (10 ** rng.uniform(-3, 3, COUNT)).astype(dtype)
    r = (10 ** rng.uniform(-3, np.log10(200), COUNT) * d).astype(dtype)
    x = r.astype(np.longdouble) / d
    per_length = {"pdf": d, "cdf": 1, "sf": 1, "profile": d.astype(np.longdouble) ** 2}[name]
    expected = getattr(reference, name)(x) / per_length
    found = np.asarray(jax.jit(getattr(burley, name))(r, d))
    error = np.abs(found.astype(np.longdouble) / expected - 1)
    # x is off by half an ulp, and no logarithmic derivative here exceeds 1 + x / 3 in x.
    limit = PROFILE_BOUND[dtype.name] + (1 + x / 3) * float(np.finfo(dtype).epsneg)
    normal = expected >= np.finfo(dtype).tiny
    assert np.mean(normal) > 0.9
    assert np.all(error[normal] < limit[normal])


@pytest.mark.parametrize("name", ["ppf", "isf"])
def test_quantile_is_the_unit_quantile_times_d(dtype, name):
    q = variates(dtype)
    d = (10 ** np.random.default_rng(5).uniform(-6, 6, q.size)).astype(dtype)
    quantile = jax.jit(getattr(burley, name))
    np.testing.assert_array_equal(quantile(q, d), d * np.asarray(quantile(q, dtype.type(1))))


@pytest.mark.usefixtures("fine_reference")
def test_round_trips_are_as_good_as_their_conditioning(dtype, reference):
    e, one = EXPONENTIAL[dtype.name], dtype.type(1)
    ppf, isf, cdf, sf = (jax.jit(f) for f in (burley.ppf, burley.isf, burley.cdf, burley.sf))
    q = variates(dtype)
    for inverse, forward, mass in ((ppf, cdf, reference.cdf), (isf, sf, reference.sf)):
        x = np.asarray(inverse(q, one))
        condition = x * reference.pdf(x) / mass(x)
        assert np.all(np.abs(np.asarray(forward(x, one)) / q - 1) < e + condition * e)
    for inverse, forward, mass, largest in ((ppf, cdf, reference.cdf, 10), (isf, sf, reference.sf, 200)):
        x = radii(dtype, largest, 1e-2)
        condition = mass(x) / (x * reference.pdf(x))
        error = np.abs(np.asarray(inverse(forward(x, one), one)) / x - 1)
        assert np.all(error < e + condition * e)


@pytest.mark.parametrize("side", ["near 0", "near 1"])
def test_quantiles_have_no_backward_step(dtype, side):
    if side == "near 0":
        q = np.geomspace(1e-30, 0.6, 1_000_000).astype(dtype)
    else:
        q = (1 - np.geomspace(np.finfo(dtype).epsneg, 0.6, 1_000_000)[::-1]).astype(dtype)
    ascends = np.diff(q) > 0
    assert ascends.sum() > 300_000
    lower, upper = (np.asarray(jax.jit(f)(q, dtype.type(1))) for f in (burley.ppf, burley.isf))
    np.testing.assert_array_equal(lower[1:] > lower[:-1], ascends)
    np.testing.assert_array_equal(upper[1:] < upper[:-1], ascends)


def test_variates_of_a_generator_keep_their_order_where_branches_join():
    # Generators draw multiples of 2^-24 or 2^-23; here are 2 million of the former around the join.
    q = ((2**23 + np.arange(-(2**20), 2**20)) / 2**24).astype(np.float32)
    one = np.float32(1)
    lower, upper = (np.asarray(jax.jit(f)(q, one)) for f in (burley.ppf, burley.isf))
    assert np.all(lower[1:] >= lower[:-1])
    assert np.all(upper[1:] <= upper[:-1])


def test_quantiles_in_print(x64):
    for q, radius in PPF.items():
        # A q of few digits is no float64: what its rounding moves the radius comes on top.
        moved = 2.0**-53 * q / (radius * float(burley.pdf(radius, 1.0)))
        assert float(burley.ppf(q, 1.0)) == pytest.approx(radius, rel=7.5e-16 + moved)
    for q, radius in ISF.items():
        assert float(burley.isf(q, 1.0)) == pytest.approx(radius, rel=7.5e-16)


def test_float32_quantiles_in_print():
    for q, radius in PPF_OF_FLOAT32.items():
        assert float(burley.ppf(np.float32(q), np.float32(1))) == pytest.approx(radius, rel=FLOAT32)


def test_distribution_in_print(x64):
    for x, (mass, density) in CDF_AND_PDF.items():
        assert float(burley.cdf(x, 1.0)) == pytest.approx(mass, rel=7.5e-16)
        assert float(burley.pdf(x, 1.0)) == pytest.approx(density, rel=1e-15)


def test_profile_and_transmittance_in_print(x64):
    for r, density in PROFILE.items():
        assert float(burley.profile(r, 1.0)) == pytest.approx(density, rel=1.25e-15)
        assert float(burley.profile(r, 1.0, 0.3)) == pytest.approx(0.3 * density, rel=1.5e-15)
    for thickness, share in TRANSMITTANCE.items():
        assert float(burley.transmittance(thickness, 1.0)) == pytest.approx(share, rel=1e-15)
        assert float(burley.transmittance(2 * thickness, 2.0, 0.3)) == pytest.approx(0.3 * share, rel=1.5e-15)


@pytest.mark.usefixtures("fine_reference")
@pytest.mark.parametrize("name, sign", [("ppf", 1), ("isf", -1)])
def test_slope_of_a_quantile_is_the_reciprocal_density(dtype, name, sign, reference):
    q = variates(dtype)[::100]
    x = getattr(reference, name)(q)
    slope = np.asarray(jax.jit(jax.vmap(jax.grad(getattr(burley, name)), (0, None)))(q, dtype.type(1)))
    # The density is taken at the rounded quantile, where it is off by its logarithmic derivative.
    condition = np.abs(x * reference.pdf_slope(x) / reference.pdf(x))
    e = EXPONENTIAL[dtype.name]
    assert np.all(np.abs(sign * slope * reference.pdf(x) - 1) < e * (1.25 + condition))
