"""Burley's three scalings, shapes and mean free paths, and the diffuse mean free path of coefficients."""

import jax
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.profiles import burley

# s(albedo) for searchlight, diffuse, dmfp; from the published polynomials in exact decimals.
SCALING = {
    0: (5.434, 4.14, 4.685921),
    0.2: (3.162, 2.96, 3.528561),
    0.33: (2.246761, 2.34315, 3.5),
    0.5: (1.539, 1.715, 3.583521),
    0.8: (1.05, 1.1, 8.379681),
    0.9: (0.957, 1.035, 14.056001),
    1: (0.906, 1.04, 23.651121),
}
CONFIGURATIONS = ("searchlight", "diffuse", "dmfp")

albedos = st.floats(0, 1)
lengths = st.floats(1e-6, 1e6)


@pytest.mark.parametrize("column, configuration", list(enumerate(CONFIGURATIONS)))
def test_scaling_in_print(x64, column, configuration):
    for albedo, values in SCALING.items():
        # s adds up at most five terms below 6 (24 for dmfp), of which it keeps 0.9 or more.
        assert float(burley.scaling(albedo, configuration)) == pytest.approx(values[column], rel=2e-15)


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_scaling_outside_the_fit_is_nan(dtype, configuration):
    step = np.finfo(dtype).eps
    albedo = np.array([-step, -1, -np.inf, 1 + step, 2, np.inf, np.nan], dtype)
    scaling = jax.jit(burley.scaling, static_argnums=1)
    assert np.all(np.isnan(scaling(albedo, configuration)))
    ends = np.array([0, 1], dtype)
    assert np.all(np.isfinite(scaling(ends, configuration)))


@pytest.mark.parametrize("configuration", CONFIGURATIONS)
def test_scaling_is_smooth(x64, configuration):
    albedo = np.array([0.0, 0.33, 0.5, 0.8, 0.9, 1.0])
    slope = jax.jit(jax.vmap(jax.grad(lambda albedo: burley.scaling(albedo, configuration))))(albedo)
    # The cube of |albedo - 0.8| has no kink at 0.8.
    expected = {
        "searchlight": -1 + 21 * (albedo - 0.8) * np.abs(albedo - 0.8),
        "diffuse": -1 + 7 * (albedo - 0.8),
        "dmfp": 400 * (albedo - 0.33) ** 3,
    }[configuration]
    np.testing.assert_allclose(slope, expected, rtol=1e-13)


@given(path=lengths, albedo=albedos)
def test_shapes_and_paths_are_inverse(dtype, path, albedo):
    path, albedo = dtype.type(path), dtype.type(albedo)
    two_roundings = 2 * float(np.finfo(dtype).eps)
    for configuration in ("searchlight", "diffuse"):
        d = burley.shape_from_mfp(path, albedo, configuration)
        assert float(d * burley.scaling(albedo, configuration)) == pytest.approx(
            float(path), rel=two_roundings
        )
        back = burley.mfp_from_shape(d, albedo, configuration)
        assert float(back) == pytest.approx(float(path), rel=two_roundings)
    back = burley.dmfp_from_shape(burley.shape_from_dmfp(path, albedo), albedo)
    assert float(back) == pytest.approx(float(path), rel=two_roundings)


def test_shapes_in_print(x64):
    # The published example: albedo 0.9 and a diffuse mean free path of 1.
    assert float(burley.shape_from_dmfp(1.0, 0.9)) == pytest.approx(0.071143990385316563, rel=1e-15)
    assert float(burley.shape_from_mfp(1.0, 0.5)) == pytest.approx(1 / 1.539, rel=1e-15)
    assert float(burley.shape_from_mfp(1.0, 0.5, "diffuse")) == pytest.approx(1 / 1.715, rel=1e-15)


@pytest.mark.parametrize(
    "convert",
    [burley.shape_from_mfp, burley.mfp_from_shape, burley.shape_from_dmfp, burley.dmfp_from_shape],
)
def test_paths_at_the_ends(dtype, convert):
    path = np.array([0, np.inf, -1, np.nan, 1, 1], dtype)
    albedo = np.array([0.5, 0.5, 0.5, 0.5, 1.5, np.nan], dtype)
    expected = np.array([0, np.inf, np.nan, np.nan, np.nan, np.nan], dtype)
    np.testing.assert_array_equal(jax.jit(convert)(path, albedo), expected)


def test_unknown_configurations_are_refused():
    with pytest.raises(ValueError, match="'searchlight', 'diffuse' or 'dmfp', got 'Diffuse'"):
        burley.scaling(0.5, "Diffuse")  # pyright: ignore[reportArgumentType]
    for convert in (burley.shape_from_mfp, burley.mfp_from_shape):
        with pytest.raises(ValueError, match="use shape_from_dmfp and dmfp_from_shape"):
            convert(1.0, 0.5, "dmfp")
        with pytest.raises(ValueError, match="got 'surface'"):
            convert(1.0, 0.5, "surface")  # pyright: ignore[reportArgumentType]


def exact_dmfp(sigma_s, sigma_a, g):
    with mpmath.workdps(40):
        reduced = mpmath.mpf(sigma_s) * (1 - mpmath.mpf(g))
        total = mpmath.mpf(sigma_a) + reduced
        return float(mpmath.sqrt((2 * mpmath.mpf(sigma_a) + reduced) / (3 * total**2 * mpmath.mpf(sigma_a))))


@given(
    sigma_s=st.floats(1e-9, 1e9),
    sigma_a=st.floats(1e-9, 1e9),
    g=st.sampled_from([0.0, 0.5, 0.75, -0.5, 1.0, -1.0]),
)
def test_dmfp_of_coefficients(dtype, sigma_s, sigma_a, g):
    sigma_s, sigma_a, g = dtype.type(sigma_s), dtype.type(sigma_a), dtype.type(g)
    expected = exact_dmfp(float(sigma_s), float(sigma_a), float(g))
    found = float(burley.dmfp_from_coefficients(sigma_s, sigma_a, g))
    assert found == pytest.approx(expected, rel=4 * float(np.finfo(dtype).eps))


def test_dmfp_of_coefficients_at_the_ends(dtype):
    table = [
        (1, 0, 0, np.inf),
        (0, 0, 0, np.inf),
        (0, 2, 0, (2 / 3) ** 0.5 / 2),
        (5, 2, 1, (2 / 3) ** 0.5 / 2),
        (-1, 1, 0, np.nan),
        (1, -1, 0, np.nan),
        (1, 1, 1.5, np.nan),
        (1, 1, -1.5, np.nan),
        (np.nan, 1, 0, np.nan),
        (1, np.nan, 0, np.nan),
        (1, 1, np.nan, np.nan),
    ]
    sigma_s, sigma_a, g, expected = (np.array(column, dtype) for column in zip(*table, strict=True))
    found = jax.jit(burley.dmfp_from_coefficients)(sigma_s, sigma_a, g)
    np.testing.assert_allclose(found, expected, rtol=2 * float(np.finfo(dtype).eps))
    gradients = jax.jit(jax.vmap(jax.grad(burley.dmfp_from_coefficients, (0, 1, 2))))(sigma_s, sigma_a, g)
    # Without absorption the path is infinite whatever else changes; elsewhere it depends on all.
    assert np.all(np.array(gradients)[:, :2] == 0)
    assert np.all(np.isfinite(np.array(gradients)[:, 2:4]))
