"""Total reflectances against quadrature of the dipole's profile, and Fresnel's fits against the integral."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sssfit.profiles import dipole

diffuse_reflectance = jax.jit(dipole.diffuse_reflectance)
fresnel_diffuse_reflectance = jax.jit(dipole.fresnel_diffuse_reflectance)

# Reduced scattering and absorption in 1/mm, refractive index, and the total by mpmath in 30 digits.
TOTALS = {
    "marble R": (2.19, 0.0021, 1.5, 0.830167061007),
    "marble G": (2.62, 0.0041, 1.5, 0.79093183364572596),
    "marble B": (3.00, 0.0071, 1.5, 0.752578377095),
    "skin1 R": (0.74, 0.032, 1.3, 0.43593149517457658),
}
DIGITS = {"marble R": 1e-12, "marble G": 1e-15, "marble B": 1e-12, "skin1 R": 1e-15}

coefficients = st.floats(1e-3, 1e3)


def fresnel_integral(eta):
    """Hemispherical mean of Fresnel's reflectance of unpolarized light, from inside a medium of index eta."""

    def reflected(cosine):
        sine = eta * np.sqrt(1 - cosine**2)
        if sine >= 1:
            return 2 * cosine
        refracted = np.sqrt(1 - sine**2)
        parallel = (cosine - eta * refracted) / (cosine + eta * refracted)
        perpendicular = (eta * cosine - refracted) / (eta * cosine + refracted)
        return (parallel**2 + perpendicular**2) * cosine

    critical = np.sqrt(1 - 1 / eta**2) if eta > 1 else 0.0
    return sum(
        quad(reflected, *ends, epsabs=1e-13, limit=200)[0] for ends in ((0.0, critical), (critical, 1.0))
    )


def profile(r, sigma_s, sigma_a, eta):
    """The published dipole profile, with the virtual source's term added."""
    extinction = sigma_s + sigma_a
    fresnel = -1.4399 / eta**2 + 0.7099 / eta + 0.6681 + 0.0636 * eta
    boundary = (1 + fresnel) / (1 - fresnel)
    transport = np.sqrt(3 * sigma_a * extinction)
    density = 0.0
    for z in (1 / extinction, (1 + 4 / 3 * boundary) / extinction):
        distance = np.hypot(r, z)
        density += z * (1 + transport * distance) * np.exp(-transport * distance) / distance**3
    return sigma_s / extinction * density / (4 * np.pi)


def integrated(sigma_s, sigma_a, eta):
    """The profile over the plane, in the logarithm of the radius."""
    mean_free_path = 1 / (sigma_s + sigma_a)
    ends = np.log(mean_free_path * 1e-9), np.log(60 / np.sqrt(3 * sigma_a / mean_free_path))
    return quad(
        lambda s: 2 * np.pi * np.exp(2 * s) * profile(np.exp(s), sigma_s, sigma_a, eta),
        *ends,
        epsabs=1e-13,
        epsrel=1e-12,
        limit=400,
    )[0]


def test_profile_in_print():
    # mpmath, marble G.
    for r, density in ((0.1, 0.50678165222247598), (1, 0.034326605626857633), (10, 9.2526753785047052e-5)):
        assert profile(r, 2.62, 0.0041, 1.5) == pytest.approx(density, rel=1e-14)


@pytest.mark.parametrize("name", TOTALS)
def test_totals_in_print(x64, name):
    *arguments, total = TOTALS[name]
    assert float(diffuse_reflectance(*arguments)) == pytest.approx(total, rel=DIGITS[name])


@pytest.mark.parametrize("name", TOTALS)
def test_total_is_the_integral_of_the_profile(x64, name):
    *arguments, _ = TOTALS[name]
    assert float(diffuse_reflectance(*arguments)) == pytest.approx(integrated(*arguments), rel=1e-10)


@given(sigma_s=coefficients, sigma_a=coefficients, eta=st.floats(1, 2.5))
def test_any_total_is_the_integral_of_the_profile(x64, sigma_s, sigma_a, eta):
    total = float(diffuse_reflectance(sigma_s, sigma_a, eta))
    assert total == pytest.approx(integrated(sigma_s, sigma_a, eta), rel=1e-9)


@given(sigma_s=coefficients, sigma_a=coefficients, eta=st.floats(1, 2.5))
def test_total_in_float32_and_in_other_units(sigma_s, sigma_a, eta):
    arguments = [np.float32(v) for v in (sigma_s, sigma_a, eta)]
    total = diffuse_reflectance(*arguments)
    with jax.enable_x64(True):
        exact = float(diffuse_reflectance(*(np.float64(v) for v in arguments)))
    # A dozen roundings; those of F count the most, by 2e-7 of the total at F = 0.88.
    assert float(total) == pytest.approx(exact, rel=2e-6)
    # Only the ratio of the coefficients counts, and a power of four leaves their roots' digits as they are.
    arguments[:2] = [4 * v for v in arguments[:2]]
    assert float(diffuse_reflectance(*arguments)) == float(total)


def test_totals_at_the_ends(dtype):
    table = [
        (1, 0, 1),
        (1e-30, 0, 1),
        (0, 1, 0),
        (0, 0, 0),
        (-1, 1, np.nan),
        (1, -1, np.nan),
        (np.nan, 1, np.nan),
        (1, np.nan, np.nan),
    ]
    sigma_s, sigma_a, expected = (np.array(column, dtype) for column in zip(*table, strict=True))
    np.testing.assert_array_equal(diffuse_reflectance(sigma_s, sigma_a, dtype.type(1.3)), expected)
    assert np.isnan(diffuse_reflectance(dtype.type(1), dtype.type(1), dtype.type(0)))


def test_a_white_medium_keeps_the_digits_of_its_absorption(dtype):
    # 1 - R tends to (1 + 2 A / 3) sqrt(3 (1 - a')), A = (1 + F) / (1 - F).
    fresnel = float(fresnel_diffuse_reflectance(1.3))
    slope = 1 + 2 / 3 * (1 + fresnel) / (1 - fresnel)
    for absorbed in (1e-6, 1e-8):
        total = float(diffuse_reflectance(dtype.type(1), dtype.type(absorbed), dtype.type(1.3)))
        depth = np.sqrt(3 * absorbed)
        # The next term of the series, then the rounding of R itself.
        assert 1 - total == pytest.approx(slope * depth, rel=5 * depth, abs=2 * float(np.finfo(dtype).eps))


@pytest.mark.parametrize("how", [jax.grad, jax.jacfwd, jax.jacrev])
def test_derivatives_without_absorption(dtype, how):
    # Without absorption, then without a medium.
    columns = np.array([[1, 0], [0, 0], [1.3, 1.3]], dtype)
    # sqrt(sigma_a) leads the series: the slope is infinite in it, and 0 in all else.
    expected = [0, -np.inf, 0]
    for index in range(3):
        found = jax.jit(jax.vmap(how(dipole.diffuse_reflectance, index)))(*columns)
        assert float(found[0]) == expected[index]
        assert np.isfinite(found[1])


@pytest.mark.parametrize("eta", [1.3, 1.4, 1.5, 1.75, 2.0])
def test_fresnel_fit_is_near_the_integral(eta):
    assert float(fresnel_diffuse_reflectance(eta)) == pytest.approx(fresnel_integral(eta), abs=1.1e-3)


def test_fresnel_in_print(x64):
    # The polynomials in exact decimals, and the integrals to ten digits.
    for eta, fit, exact in (
        (1.3, 0.44484508875739645, 0.4444567013),
        (1.4, 0.52956857142857143, 0.5289854824),
        (1.5, 0.59681111111111111, 0.5963457597),
        (2.0, 0.790275, 0.7901491593),
        (1 / 1.5, 0.092825, 0.091778),
    ):
        assert float(fresnel_diffuse_reflectance(eta)) == pytest.approx(fit, rel=5e-15)
        if eta > 1:
            assert fresnel_integral(eta) == pytest.approx(exact, abs=1e-9)
    assert fresnel_integral(1 / 1.5) == pytest.approx(0.091778, abs=5e-7)


def test_fresnel_outside_its_domain(dtype):
    eta = np.array([0, -1, -np.inf, np.nan], dtype)
    assert np.all(np.isnan(fresnel_diffuse_reflectance(eta)))
    # The two branches nearly meet at 1, where nothing is reflected.
    around = fresnel_diffuse_reflectance(np.array([0.999999, 1, 1.000001], dtype))
    np.testing.assert_allclose(around, 0.0017, atol=1e-5)
