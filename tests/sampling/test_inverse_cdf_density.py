"""The densities that the methods draw: right for their radii, unbiased as weights, as far off as stated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from sssfit.profiles import burley
from sssfit.sampling import inverse_cdf
from sssfit.sampling.inverse_cdf import METHODS

CLAMP = 1 - 2.0**-24
MONOTONE = [name for name in METHODS if name != "mixture"]
UNBIASED = ["exact", "closed_form", "mixture"]

# The papers' g(xi | 2.5715), by mpmath: its density 1 / g' and the weight p(g) / density.
XIE = {
    0.1: (0.426269132498591243, 1.01780652148801906),
    0.5: (0.201303090719927276, 0.987057771427734649),
    0.9: (0.0377937128273401656, 0.980531177645478429),
    0.999: (3.88368174011117667e-4, 1.72890451432805364),
}


def quadrature():
    """Nodes and weights for the variates from 0 to the clamp, exact to rounding for smooth pieces.

    The pieces end where a method's formula changes (1/4, 1/2, a table's entries), halve towards the
    logarithmic ends at 1 and, for the mixture, at 1/4, and are Gauss-Legendre in each.
    """
    towards_one, towards_quarter = 1 - 2.0 ** -np.arange(1, 25), 0.25 - 2.0 ** -np.arange(3, 50)
    ends = np.unique([*np.minimum(np.linspace(0, 1, 256), CLAMP), 0.25, *towards_one, *towards_quarter])
    nodes, weights = np.polynomial.legendre.leggauss(16)
    half = np.diff(ends)[:, None] / 2
    return (ends[:-1, None] + half * (1 + nodes)).ravel(), (half * weights).ravel()


def tail_moments(r):
    """Mass, mean of exp(-r) and mean of r that the profile of d = 1 has beyond a radius."""
    fast, slow = np.exp(-r), np.exp(-r / 3)
    damped = np.exp(-2 * r) / 8 + 3 * np.exp(-4 * r / 3) / 16
    return (fast + 3 * slow) / 4, damped, ((r + 1) * fast + (3 * r + 9) * slow) / 4


def below(r):
    return -(np.expm1(-r) + 3 * np.expm1(-r / 3)) / 4


def samples(name, xi, d=1.0):
    """Radii, densities and weights in float64."""
    method = METHODS[name]
    r, density = (np.asarray(jax.jit(f)(xi, d)) for f in (method.radius, method.pdf))
    return r, density, np.asarray(jax.jit(burley.pdf)(r, d)) / density


@pytest.mark.parametrize("name", MONOTONE)
def test_the_density_is_the_reciprocal_slope_of_the_radius(x64, name):
    rng = np.random.default_rng(8)
    xi = np.concatenate(
        [10 ** rng.uniform(-6, -0.31, 400), rng.random(400), 1 - 10 ** rng.uniform(-7, -0.31, 400)]
    )
    # No quotient may straddle a place where a table turns or a branch changes.
    h = 1e-6 * np.minimum(xi, 1 - xi)
    cells = np.stack([np.floor(255 * (xi - h)), np.floor(255 * (xi + h))])
    xi, h = (a[(cells[0] == cells[1]) & (np.abs(xi - 0.5) > 2e-6)] for a in (xi, h))
    assert xi.size > 1000
    d = 1.7
    radius = jax.jit(METHODS[name].radius)
    moved = np.asarray(radius(xi + h, d)) - np.asarray(radius(xi - h, d))
    # The steps as they are in floating point.
    quotient = moved / ((xi + h) - (xi - h))
    density = np.asarray(jax.jit(METHODS[name].pdf)(xi, d))
    # h^2 of a third derivative is 1e-11 here; the rest is the rounding of the two radii.
    noise = 1e-15 * (np.asarray(radius(xi, d)) + (2 if name == "closed_form" else 0)) / (h * quotient)
    assert np.all(np.abs(density * quotient - 1) < 1e-9 + noise)


@pytest.mark.parametrize("name", METHODS)
def test_the_clamp_does_not_change_the_slope_at_the_clamp(x64, name):
    # There the slope is a one-sided one: not half of it, and not 0.
    xi = np.array([CLAMP - 1e-13, CLAMP])
    density = np.asarray(jax.jit(METHODS[name].pdf)(xi, 1.0))
    slope = np.asarray(jax.jit(jax.vmap(jax.grad(METHODS[name].radius), (0, None)))(xi, 1.0))
    # 1e-13 is 2e-6 of what is left.
    assert density[1] == pytest.approx(density[0], rel=1e-5)
    assert slope[1] == pytest.approx(slope[0], rel=1e-5)


def test_those_that_draw_the_profile_say_so(x64):
    xi, _ = quadrature()
    error = {name: np.abs(samples(name, xi)[2] - 1).max() for name in METHODS}
    assert {name for name in METHODS if METHODS[name].draws_profile} == {*UNBIASED, "log_poly12"}
    # float32 rounds at 6e-8; the next best method is at 1.7e-6.
    assert {name for name in METHODS if error[name] < 3e-7} == {*UNBIASED, "log_poly12"}


def test_the_mixture_draws_the_profile_from_its_two_branches(x64):
    # At a radius, each branch has one variate; their densities add up, as do their probabilities.
    r = np.geomspace(1e-3, 40, 300)
    narrow, wide = (1 - np.exp(-r)) / 4, 1 - 3 * np.exp(-r / 3) / 4
    radius = jax.jit(inverse_cdf.mixture)
    # The rounding of a variate near the end of its branch counts by the branch's reciprocal density.
    assert np.all(np.abs(radius(narrow, 1.0) - r)[r < 30] < (1e-15 * r + 2.0**-52 * np.exp(r))[r < 30])
    assert np.all(np.abs(radius(wide, 1.0) - r) < 1e-15 * r + 2.0**-50 * np.exp(r / 3))
    # Both branches rise, so the variates of radii up to r are those up to these two: together the cdf.
    for ends in ((0, 0.25), (0.25, CLAMP)):
        drawn = np.asarray(radius(np.linspace(*ends, 10_001)[:-1], 1.0))
        assert np.all(drawn[1:] > drawn[:-1])
    np.testing.assert_allclose(narrow + (wide - 0.25), burley.cdf(r, 1.0), rtol=0, atol=3e-16)
    r, narrow, wide = (a[r < 5] for a in (r, narrow, wide))
    densities = []
    for xi in (narrow, wide):
        h = 1e-6 * np.minimum(np.abs(xi - 0.25), np.minimum(xi, 1 - xi))
        densities.append(
            ((xi + h) - (xi - h)) / (np.asarray(radius(xi + h, 1.0)) - np.asarray(radius(xi - h, 1.0)))
        )
    drawn = jax.jit(METHODS["mixture"].pdf)(wide, 1.0)
    np.testing.assert_allclose(densities[0] + densities[1], drawn, rtol=1e-6)


def test_mixture_samples_follow_the_profile():
    # Kolmogorov and Smirnov at a fixed key: the statistic that 99.9 % of the keys stay below.
    count = 200_000

    def distance(radii):
        """The largest difference between the samples' cdf and the profile's."""
        mass = below(np.sort(np.asarray(radii, np.float64)) / 2)
        steps = np.arange(count + 1) / count
        return max(np.abs(mass - steps[:-1]).max(), np.abs(mass - steps[1:]).max())

    xi = jax.random.uniform(jax.random.key(20), (count,))
    limit = stats.kstwo.ppf(0.999, count)
    assert distance(jax.jit(inverse_cdf.mixture)(xi, 2.0)) < limit
    # The test can tell: g's density is 0.0099 off, which is five times the limit.
    assert distance(jax.jit(inverse_cdf.xie)(xi, 2.0)) > 2 * limit


@pytest.mark.parametrize("name", METHODS)
def test_weighted_estimates_have_the_profiles_expectation(x64, name):
    xi, weights = quadrature()
    r, _, importance = samples(name, xi)
    # The variates beyond the clamp would have drawn the radii beyond its radius.
    beyond = tail_moments(float(METHODS[name].radius(1.0, 1.0)))
    expected = (1, 0.3125, 2.5)
    for function, target, missing in zip(
        (np.ones_like, lambda r: np.exp(-r), lambda r: r), expected, beyond, strict=True
    ):
        found = np.sum(weights * importance * function(r))
        assert found + missing == pytest.approx(target, rel=2e-11)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("d", [0.01, 30.0])
def test_weights_do_not_depend_on_the_shape(x64, name, d):
    xi, _ = quadrature()
    np.testing.assert_allclose(samples(name, xi, d)[2], samples(name, xi)[2], rtol=1e-12)


@pytest.mark.parametrize("name", UNBIASED)
def test_methods_that_draw_the_profile_have_weight_one(name):
    xi = np.linspace(0, 1, 10_001, dtype=np.float32)
    method = METHODS[name]

    def both(xi, d):
        return method.pdf(xi, d), burley.pdf(method.radius(xi, d), d)

    np.testing.assert_array_equal(*jax.jit(both)(xi, np.float32(2)))


@pytest.mark.parametrize("name", METHODS)
def test_float32_densities_are_those_of_float64(name, reference):
    xi = np.concatenate([np.geomspace(1e-30, 0.5, 5001), 1 - np.geomspace(2.0**-24, 0.5, 5001)]).astype(
        np.float32
    )
    found = np.asarray(jax.jit(METHODS[name].pdf)(xi, np.float32(1)))
    with jax.enable_x64(True):
        expected = np.asarray(jax.jit(METHODS[name].pdf)(xi.astype(np.float64), 1.0))
    error = np.abs(found / expected - 1)
    if name == "table":
        # Differences over steps of 1 / 255 of entries that have lost half an ulp; r / r' is 1/3 or less.
        assert error.max() < 255 * 2.0**-24
    elif name in UNBIASED:
        # Taken at the radius, whose rounding counts by the density's logarithmic derivative.
        with jax.enable_x64(True):
            x = np.asarray(jax.jit(METHODS[name].radius)(xi.astype(np.float64), 1.0))
        condition = np.abs(x * reference.pdf_slope(x) / reference.pdf(x))
        absolute = {"exact": 0, "closed_form": 1e-6, "mixture": 5e-7}[name]
        assert np.all(error < 4e-7 * (1 + condition) + absolute)
    else:
        assert error.max() < 6e-7


def exact_radius(xi):
    with jax.enable_x64(True):
        return np.asarray(jax.jit(burley.ppf)(xi.astype(np.float64), 1.0))


def test_the_papers_density_in_print(x64):
    for xi, (density, weight) in XIE.items():
        # A variate's rounding, 2^-53, counts by up to 1 / (1 - xi).
        digits = 1e-15 + 2.0**-53 / (1 - xi)
        assert float(inverse_cdf.xie_pdf(xi, 1.0)) == pytest.approx(density, rel=digits)
        assert float(inverse_cdf.xie_pdf(xi, 4.0)) == pytest.approx(density / 4, rel=digits)
        r = inverse_cdf.xie(xi, 1.0)
        found = float(burley.pdf(r, 1.0) / inverse_cdf.xie_pdf(xi, 1.0))
        assert found == pytest.approx(weight, rel=digits + 2e-15)


def test_the_papers_estimates_are_biased_as_they_are_used(x64):
    # Without weights the mean over g's own density: relative bias in percent, and the discs' in probability.
    xi, weights = quadrature()
    r, _, _ = samples("xie", xi)
    last, clamped = 1 - CLAMP, float(inverse_cdf.xie(1.0, 1.0))

    def mean(function):
        return np.sum(weights * function(r)) + last * function(clamped)

    # The variates beyond the clamp would have gone 2.6 further: 2e-7 of a mean radius, 2e-5 of its square.
    assert 100 * (mean(lambda r: r) / 2.5 - 1) == pytest.approx(-2.8550, abs=6e-5)
    assert 100 * (mean(lambda r: r**2) / 14 - 1) == pytest.approx(-10.6099, abs=3e-4)
    assert 100 * (mean(lambda r: np.exp(-r)) / 0.3125 - 1) == pytest.approx(-1.0132, abs=6e-5)
    inside = {0.5: -0.00341, 1: -0.00643, 2: -0.00485, 4: 0.00568, 7: 0.00973, 10: 0.00665}
    for radius, bias in inside.items():
        # The variate that draws the radius is the probability of the disc.
        variates = np.linspace(0, 1, 2_000_001)[:-1]
        drawn = np.searchsorted(np.asarray(jax.jit(inverse_cdf.xie)(variates, 1.0)), radius) / 2_000_000
        assert drawn - below(radius) == pytest.approx(bias, abs=6e-6)


def errors(name):
    """Largest errors of a method: of the cdf, of the radius in the mean square, and its weights."""
    xi, weights = quadrature()
    r, _, importance = samples(name, xi)
    root_mean_square = np.sqrt(np.sum(weights * (r - exact_radius(xi)) ** 2))
    return np.abs(below(r) - xi).max(), root_mean_square, importance


def test_what_the_papers_approximation_costs(x64):
    worst, root_mean_square, importance = errors("xie")
    assert worst == pytest.approx(9.868e-3, abs=1e-6)
    assert root_mean_square == pytest.approx(0.2437, abs=1e-4)
    last = samples("xie", np.array([CLAMP]))[2][0]
    assert last == pytest.approx(6.92, abs=0.005)
    assert importance.max() < last


def test_log_linear_is_better_by_what_it_says(x64):
    worst, root_mean_square, importance = errors("log_linear")
    assert worst == pytest.approx(2.28e-3, abs=5e-6)
    assert worst <= 9.868e-3 / 2.6
    assert root_mean_square == pytest.approx(0.0144, abs=5e-5)
    assert root_mean_square <= 0.2437 / 11
    assert 1.015 < importance.max() <= 1.016


@pytest.mark.parametrize(
    "name, worst, lowest, highest",
    [
        ("log_poly4", 1.5e-4, 0.998, 1.002),
        ("log_poly8", 4.3e-7, 1 - 1e-5, 1 + 1e-5),
        ("log_poly12", 8e-9, 1 - 1e-6, 1 + 1e-6),
        ("halley", 2.8e-7, 1 - 2e-6, 1 + 2e-6),
        ("newton", 7.4e-5, 0.9997, 1.0004),
    ],
)
def test_cdf_errors_and_weights_are_those_stated(x64, name, worst, lowest, highest):
    error, _, importance = errors(name)
    assert 0.9 * worst < error < worst
    assert lowest < importance.min() < 1 < importance.max() < highest


def test_a_method_is_what_its_contract_says():
    for name, method in METHODS.items():
        assert getattr(inverse_cdf, name) is method.radius
        assert method.summary
    # Static for jit: a method can be closed over and its functions are not remade.
    assert METHODS["xie"].pdf is inverse_cdf.xie_pdf
    xi = jnp.array([0.2, 0.7])
    weights = burley.pdf(METHODS["log_linear"].radius(xi, 1.0), 1.0) / METHODS["log_linear"].pdf(xi, 1.0)
    assert np.all(np.abs(np.asarray(weights) - 1) < 0.03)
