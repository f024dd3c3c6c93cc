"""The dipole's profile and what leaves beyond a distance: mpmath, quadrature, laws, ends and derivatives."""

import jax
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sssfit.profiles import dipole

profile = jax.jit(dipole.profile)
sf = jax.jit(dipole.sf)
effective_transport = jax.jit(dipole.effective_transport)
diffuse_reflectance = jax.jit(dipole.diffuse_reflectance)

FUNCTIONS = {"profile": profile, "sf": sf}
# All derivatives, for vectors of the arguments.
GRADIENTS = {
    name: jax.jit(jax.vmap(jax.grad(function, (0, 1, 2, 3)))) for name, function in FUNCTIONS.items()
}

INF, NAN = np.inf, np.nan

# Reduced scattering and absorption in 1/mm, refractive index.
MEDIA = {
    "marble R": (2.19, 0.0021, 1.5),
    "marble G": (2.62, 0.0041, 1.5),
    "marble B": (3.00, 0.0071, 1.5),
    "skin1 R": (0.74, 0.032, 1.3),
    "white": (1.0, 0.0, 1.3),
    "dark": (0.01, 10.0, 1.1),
    "no step": (1.0, 0.1, 1.0),
}

# r, sigma_s', sigma_a at eta = 1.5, then profile and sf.
ENDS = [
    (-1e-30, 1, 1, 0, 1),
    (-INF, 1, 1, 0, 1),
    (INF, 1, 1, 0, 0),
    (INF, 1, 0, 0, 0),
    (1e6, 1, 1, 0, 0),
    (-1, 1, 0, 0, 1),
    (0, 0, 1, 0, 1),
    (1, 0, 0, 0, 1),
    (0, 0, 0, 0, 1),
    (-1, 0, 0, 0, 1),
    (INF, 0, 0, 0, 0),
    (1e6, 1e6, 1e6, 0, 0),
    (NAN, 1, 1, NAN, NAN),
    (NAN, 0, 0, NAN, NAN),
    (1, NAN, 1, NAN, NAN),
    (1, 1, NAN, NAN, NAN),
    (1, -1, 1, NAN, NAN),
    (1, 1, -1, NAN, NAN),
    (-1, -1, 3, NAN, NAN),
    (INF, 1, -0.5, NAN, NAN),
]


class Medium:
    """The dipole in 40 digits."""

    def __init__(self, sigma_s, sigma_a, eta):
        with mpmath.workdps(40):
            sigma_s, sigma_a, eta = (mpmath.mpf(float(v)) for v in (sigma_s, sigma_a, eta))
            extinction = sigma_s + sigma_a
            fresnel = mpmath.mpf("-1.4399") / eta**2 + mpmath.mpf("0.7099") / eta
            fresnel += mpmath.mpf("0.6681") + mpmath.mpf("0.0636") * eta
            boundary = (1 + fresnel) / (1 - fresnel)
            self.albedo = sigma_s / extinction
            self.transport = mpmath.sqrt(3 * sigma_a * extinction)
            self.depths = (1 / extinction, (1 + 4 * boundary / 3) / extinction)

    def summed(self, r, term):
        with mpmath.workdps(40):
            s = self.transport
            distances = [mpmath.sqrt(mpmath.mpf(float(r)) ** 2 + z**2) for z in self.depths]
            return sum(term(z, s, d) for z, d in zip(self.depths, distances, strict=True))

    def profile(self, r):
        total = self.summed(r, lambda z, s, d: z * (1 + s * d) * mpmath.exp(-s * d) / d**3)
        return float(self.albedo * total / (4 * mpmath.pi))

    def sf(self, r):
        beyond, every = (self.summed(x, lambda z, s, d: z * mpmath.exp(-s * d) / d) for x in (r, 0))
        return float(beyond / every)

    def decay(self, r):
        """s d, which multiplies the rounding of either."""
        return float(self.transport * mpmath.hypot(r, self.depths[0]))


def energy(r, medium):
    """2 pi r R, with r in its logarithm."""
    return 2 * np.pi * r**2 * float(profile(r, *medium))


def test_profile_in_print(x64):
    r = np.array([0, 0.1, 1, 10])
    printed = [0.55878328563706680, 0.50678165222247598, 0.034326605626857633, 9.2526753785047052e-5]
    np.testing.assert_allclose(profile(r, *MEDIA["marble G"]), printed, rtol=2e-15)


@pytest.mark.parametrize("name", MEDIA)
def test_energy_beyond_is_the_integral_of_the_profile(x64, name):
    medium = MEDIA[name]
    total = float(diffuse_reflectance(*medium))
    path = 1 / (medium[0] + medium[1])
    # The white medium's light beyond this falls as 1 / r and has to be told.
    far = np.log(path * 1e7)
    rest = float(sf(np.exp(far), *medium)) * total
    for r in (1e-9 * path, 0.3 * path, 3 * path, 30 * path):
        near = np.log(r)
        middle = min(near + 8, far)
        beyond = sum(
            quad(lambda s: energy(np.exp(s), medium), *ends, epsabs=0, epsrel=1e-11, limit=200)[0]
            for ends in ((near, middle), (middle, far))
        )
        assert float(sf(r, *medium)) * total == pytest.approx(beyond + rest, rel=1e-10)


def test_accuracy_over_twelve_decades(dtype):
    rng = np.random.default_rng(1)
    r, sigma_s, sigma_a = (10 ** rng.uniform(-6, 6, (3, 400))).astype(dtype)
    eta = rng.uniform(1, 2, 400).astype(dtype)
    found = np.stack([profile(r, sigma_s, sigma_a, eta), sf(r, sigma_s, sigma_a, eta)])
    transport = np.asarray(effective_transport(sigma_s, sigma_a))
    assert found.dtype == transport.dtype == dtype
    eps, smallest = float(np.finfo(dtype).eps), float(np.finfo(dtype).smallest_normal)
    judged = 0
    for i, distance in enumerate(r):
        medium = Medium(sigma_s[i], sigma_a[i], eta[i])
        assert float(transport[i]) == pytest.approx(float(medium.transport), rel=2.5 * eps)
        for value, exact in zip(found[:, i], (medium.profile(distance), medium.sf(distance)), strict=True):
            if exact < 2 * smallest:
                assert value <= 4 * smallest
                continue
            judged += 1
            assert float(value) == pytest.approx(exact, rel=3 * eps * (2 + medium.decay(distance)))
    assert judged > 300


@pytest.mark.parametrize("eta", [0.3, 0.7, 1.0, 3.5])
def test_accuracy_at_the_ends_of_the_refractive_indices(x64, eta):
    # mpmath has the branch above 1 alone; below, the depth of the virtual source stands for it.
    r = np.array([0.0, 0.1, 1.0, 100.0])
    fresnel = float(dipole.fresnel_diffuse_reflectance(eta))
    virtual = 1 + 4 / 3 * (1 + fresnel) / (1 - fresnel)
    expected = sum(
        z * (1 + d) * np.exp(-d) / d**3 for z, d in ((z, np.hypot(r, z)) for z in (1.0, virtual))
    ) * (2 / 3 / (4 * np.pi))
    # Coefficients with sigma_t' = s = 1.
    np.testing.assert_allclose(profile(r, 2 / 3, 1 / 3, eta), expected, rtol=1e-13)


@given(
    r=st.floats(1e-6, 1e6),
    sigma_s=st.floats(1e-6, 1e6),
    sigma_a=st.one_of(st.just(0.0), st.floats(1e-6, 1e6)),
    eta=st.floats(1, 2),
    power=st.integers(-5, 5),
)
def test_laws(r, sigma_s, sigma_a, eta, power):
    medium = [np.float32(v) for v in (sigma_s, sigma_a, eta)]
    r = np.float32(r)
    density, share = float(profile(r, *medium)), float(sf(r, *medium))
    assert density >= 0 and 0 <= share <= 1 + 2e-7
    assert float(sf(np.float32(0), *medium)) == 1
    # Both fall with the distance.
    further = np.float32(1.01) * r
    assert float(profile(further, *medium)) <= density * (1 + 1e-6)
    assert float(sf(further, *medium)) <= share * (1 + 1e-6)
    # Another unit of length: a power of four leaves the digits of roots as they are, denormal results aside.
    scale = np.float32(4.0**power)
    scaled = [medium[0] / scale, medium[1] / scale, medium[2]]
    other = float(profile(scale * r, *scaled)) * float(scale) ** 2
    assert other == pytest.approx(density, rel=3e-7 if min(density, other) < 1e-30 else 0, abs=1e-37)
    assert float(sf(scale * r, *scaled)) == share


@pytest.mark.parametrize("column, name", [(0, "profile"), (1, "sf")])
def test_ends(dtype, column, name):
    r, sigma_s, sigma_a, *expected = (np.array(values, dtype) for values in zip(*ENDS, strict=True))
    function = jax.jit(jax.vmap(getattr(dipole, name)))
    np.testing.assert_array_equal(
        function(r, sigma_s, sigma_a, np.full_like(r, 1.5)), expected[column].astype(dtype)
    )
    one = np.ones(3, dtype)
    assert np.all(np.isnan(function(one, one, one, np.array([0.29, 3.6, NAN], dtype))))


def test_effective_transport_at_the_ends(dtype):
    table = [
        (1, 0, 0),
        (0, 0, 0),
        (0, 1, np.sqrt(3)),
        (1e-30, 1e-30, np.sqrt(6) * 1e-30),
        (1e30, 1e30, np.sqrt(6) * 1e30),
        (-1, 2, NAN),
        (1, -1, NAN),
        (NAN, 1, NAN),
        (1, NAN, NAN),
    ]
    sigma_s, sigma_a, expected = (np.array(column, dtype) for column in zip(*table, strict=True))
    np.testing.assert_allclose(
        effective_transport(sigma_s, sigma_a), expected, rtol=4 * float(np.finfo(dtype).eps)
    )
    by_scattering = jax.jit(jax.vmap(jax.grad(dipole.effective_transport)))(sigma_s[:4], sigma_a[:4])
    np.testing.assert_allclose(by_scattering, [0, 0, np.sqrt(0.75), np.sqrt(0.375)], rtol=1e-6)


def test_without_absorption_the_tail_is_a_power(dtype):
    # z / d^3 and z / d over the two sources, at a distance that dwarfs both.
    fresnel = float(dipole.fresnel_diffuse_reflectance(1.3))
    both = 2 + 4 / 3 * (1 + fresnel) / (1 - fresnel)
    r = np.array([1e4, 1e6, 1e9], dtype)
    np.testing.assert_allclose(profile(r, 1, 0, 1.3), both / (4 * np.pi) / r / r / r, rtol=1e-6)
    np.testing.assert_allclose(sf(r, 1, 0, 1.3), both / 2 / r, rtol=1e-6)


def test_little_scattering_is_a_limit(dtype):
    medium = (dtype.type(1), dtype.type(1.4))
    for r in (0.0, 0.5, 3.0):
        r = dtype.type(r)
        limit = float(sf(r, dtype.type(0), *medium))
        assert float(sf(r, dtype.type(1e-20), *medium)) == limit and (limit < 1) == (r > 0)
        # Its profile vanishes with the scattering, in proportion.
        less, more = (float(profile(r, dtype.type(v), *medium)) for v in (1e-21, 1e-20))
        assert more == pytest.approx(10 * less, rel=1e-6) and more > 0
        assert float(profile(r, dtype.type(0), *medium)) == 0


@pytest.mark.parametrize("name", ["profile", "sf"])
def test_gradients_are_difference_quotients(x64, name):
    function = FUNCTIONS[name]
    rng = np.random.default_rng(2)
    r, sigma_s, sigma_a = 10 ** rng.uniform(-1, 1, (3, 64))
    arguments = (r, sigma_s, sigma_a, rng.uniform(0.6, 2.5, 64))
    value = np.asarray(function(*arguments))
    for index, gradient in enumerate(GRADIENTS[name](*arguments)):
        h = 1e-5 * arguments[index]
        moved = [[a + sign * h * (i == index) for i, a in enumerate(arguments)] for sign in (1, -1)]
        quotient = (np.asarray(function(*moved[0])) - np.asarray(function(*moved[1]))) / (2 * h)
        # h^2 times a third derivative, which grows as (s d)^2, and rounding over h.
        bound = 1e-6 * np.abs(gradient) + 1e-8 * value / arguments[index]
        assert np.all(np.abs(gradient - quotient) <= bound)


def no_absorption(dtype):
    r = np.array([0, 1e-25, 1e-6, 1e-3, 1, 10, 1e3, 1e6], dtype).repeat(8)
    return r, *(np.full_like(r, v) for v in (2, 0, 1.5))


def assert_slopes_without_absorption(of_profile, of_sf, r):
    of_profile, of_sf = np.stack(of_profile), np.stack(of_sf)
    assert np.all(np.isfinite(of_profile))
    assert np.all((of_profile[0] < 0) == (r > 0)) and np.all(of_profile[2] < 0)
    # The share's slope in the absorption is infinite, but at the origin, where the share is 1 in any medium.
    np.testing.assert_array_equal(of_sf[2], np.where(r < 1e-20, 0, -INF))
    assert np.all(np.isfinite(of_sf[[0, 1, 3]]))


def test_derivatives_without_absorption(dtype):
    arguments = no_absorption(dtype)
    slopes = GRADIENTS["profile"](*arguments)
    assert_slopes_without_absorption(slopes, GRADIENTS["sf"](*arguments), arguments[0])
    if dtype == np.float64:
        # The next term of the series goes with the root of the step.
        r, sigma_s, sigma_a, eta = (a[:40] for a in arguments)
        quotient = (profile(r, sigma_s, sigma_a + 1e-9, eta) - profile(r, sigma_s, sigma_a, eta)) / 1e-9
        np.testing.assert_allclose(slopes[2][:40], quotient, rtol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["jacfwd", "jacrev"])
def test_derivatives_without_absorption_by_other_means(dtype, how):
    derivative = getattr(jax, how)
    arguments = no_absorption(dtype)
    # One argument at a time: forward mode would else multiply the infinite slope by 0.
    of_profile, of_sf = (
        [jax.jit(jax.vmap(derivative(f, i)))(*arguments) for i in range(4)] for f in (profile, sf)
    )
    assert_slopes_without_absorption(of_profile, of_sf, arguments[0])


@pytest.mark.parametrize("name", ["profile", "sf"])
def test_derivatives_at_the_extremes_are_finite(dtype, name):
    r, sigma_s, sigma_a = (
        axis.ravel() for axis in np.meshgrid(*[np.array([0, 1e-6, 1, 1e6], dtype)] * 3, indexing="ij")
    )
    gradients = np.stack(GRADIENTS[name](r, sigma_s, sigma_a, np.full_like(r, 1.5)))
    # Infinite in the absorption where there is none, and nowhere else.
    finite = np.isfinite(gradients)
    assert np.all(finite[[0, 1, 3]])
    assert not np.any(np.isnan(gradients))
    assert np.all(finite[2] | ((sigma_a == 0) & (name == "sf")))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["profile", "sf"])
def test_second_derivatives_are_those_of_the_first(x64, name):
    slope = jax.grad(getattr(dipole, name))
    both = jax.jit(lambda r: (slope(r, 2.0, 0.1, 1.4), jax.grad(slope)(r, 2.0, 0.1, 1.4)))
    above, below = float(both(1.3 + 1e-5)[0]), float(both(1.3 - 1e-5)[0])
    assert float(both(1.3)[1]) == pytest.approx((above - below) / 2e-5, rel=1e-7)


def test_arguments_broadcast_and_half_precision_is_computed_in_single():
    r, sigma_a = np.linspace(0, 3, 4, dtype=np.float32), np.array([[0], [0.1]], np.float32)
    for function in (profile, sf):
        found = function(r, np.float32(1), sigma_a, np.float32(1.4))
        assert found.shape == (2, 4) and found.dtype == np.float32
        one_by_one = [[function(x, 1, a, 1.4) for x in r] for a in sigma_a[:, 0]]
        np.testing.assert_allclose(found, one_by_one, rtol=1e-6)
        halves = [np.float16(v) for v in (0.5, 1, 0.1, 1.4)]
        found = function(*halves)
        assert found.dtype == np.float16
        single = function(*(np.float32(v) for v in halves))
        assert float(found) == float(np.float16(single))
