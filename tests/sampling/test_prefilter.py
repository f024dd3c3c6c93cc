"""The level of a prefiltered image for a sample: areas that agree, units that cancel, and the ends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.profiles import burley
from sssfit.sampling import prefilter

level = jax.jit(prefilter.level)
level_published = jax.jit(prefilter.level_published)

positive = st.floats(1e-6, 1e6)


def test_a_texel_has_the_area_of_a_sample(dtype):
    # Of n samples of density p, one stands for 1 / (n p); a texel of level l has 4^l pixels.
    number = jnp.array([0, 0.5, 1, 2, 3.25, 8], dtype)
    count, pixel_area = 16, 0.01
    density = 1 / (4**number * count * pixel_area)
    found = level(density, count, jnp.asarray(pixel_area, dtype))
    assert found.dtype == dtype
    assert np.asarray(found) == pytest.approx(np.asarray(number), abs=8 * float(np.finfo(dtype).eps))


@given(density=positive, count=st.integers(1, 4096), area=positive, unit=st.floats(1e-3, 1e3))
def test_the_unit_of_length_cancels(density, count, area, unit):
    found = float(level(density, count, area))
    assert float(level(density / unit**2, count, area * unit**2)) == pytest.approx(found, abs=2e-6)
    assert 0 <= found <= prefilter.TOP


@given(density=positive, count=st.integers(1, 1000), area=positive)
def test_four_times_the_samples_are_one_level(density, count, area):
    few, many = (float(level(density, n, area, bias=20.0, top=99.0)) for n in (count, 4 * count))
    assert few - many == pytest.approx(min(1, few), abs=4e-6)


def test_the_example_of_a_1080p_frame():
    # 60 degrees across 1920 pixels at 500 mm, d = 0.15 mm, 16 samples; density by mpmath below.
    import mpmath

    pixel = 2 * 500 * mpmath.tan(mpmath.pi / 6) / 1920
    for radius in (0.3, 1, 3):
        x = mpmath.mpf(radius) / mpmath.mpf("0.15")
        pdf = (mpmath.exp(-x) + mpmath.exp(-x / 3)) / (4 * mpmath.mpf("0.15"))
        areal = pdf / (2 * mpmath.pi * radius)
        expected = max(0, mpmath.log(1 / (16 * areal * pixel**2), 2) / 2)
        found = level(burley.pdf(radius, 0.15) / (2 * np.pi * radius), 16, float(pixel) ** 2)
        assert float(found) == pytest.approx(float(expected), abs=2e-6)


def test_bias_is_the_papers_factor():
    assert float(prefilter.bias_from_scale(1 / 16)) == 2
    assert float(prefilter.bias_from_scale(1.0)) == 0
    # a beside n under the logarithm.
    scaled = level(1e-3 / 16, 8, 0.1)
    assert float(level(1e-3, 8, 0.1, bias=prefilter.bias_from_scale(1 / 16))) == pytest.approx(float(scaled))


def test_bias_counts_before_the_ends():
    assert float(level(100.0, 1, 1.0, bias=2.0)) == 0
    assert float(level(1.0, 1, 1.0, bias=2.0)) == 2
    assert float(level(1.0, 1, 1.0, bias=-2.0)) == 0
    assert float(level(1.0, 1, 1.0, bias=50.0)) == prefilter.TOP


@pytest.mark.parametrize(
    ("density", "count", "area", "expected"),
    [
        (0.0, 16, 1.0, "top"),
        (1.0, 0, 1.0, "top"),
        (np.inf, 0, 1.0, "top"),
        (1.0, 16, 0.0, "top"),
        (1e-44, 1, 1e-44, "top"),
        (np.inf, 16, 1.0, 0.0),
        (1e38, 4096, 1e38, 0.0),
        (np.nan, 16, 1.0, np.nan),
    ],
)
def test_ends(dtype, density, count, area, expected):
    for top in (prefilter.TOP, 7.0):
        found = float(level(jnp.asarray(density, dtype), count, jnp.asarray(area, dtype), top=top))
        assert found == pytest.approx(top if expected == "top" else expected, nan_ok=True)


def test_levels_as_printed():
    # Xie et al. 2020, Eq 22-23, in Python: a p n / (l^2 t), t = (w / D)^2 AR.
    pdf, count, dmfp, depth, aspect, unit, scale = 0.02, 4, 5.0, 30.0, 16 / 9, 10.0, 1 / 16
    argument = scale * pdf * count / (dmfp**2 * (unit / depth) ** 2 * aspect)
    found = level_published(pdf, count, dmfp, depth, aspect, world_unit=unit)
    assert float(found) == pytest.approx(-np.log2(argument) / 2, rel=1e-6)
    assert float(found) > 3


def test_the_printed_form_is_0_at_usual_depths():
    # In mm, at 200 mm to 2 m, with a density of 1/mm^2 and more; the consistent one is not.
    for depth in (200.0, 500.0, 2000.0):
        assert float(level_published(1.0, 16, 1.0, depth, 16 / 9)) == 0
    assert float(level(1.0, 16, 0.01)) > 1


@pytest.mark.parametrize(("pdf", "count"), [(0.0, 16), (1.0, 0), (np.inf, 0)])
def test_the_printed_form_without_samples(dtype, pdf, count):
    assert float(level_published(jnp.asarray(pdf, dtype), count, 1.0, 1.0, 1.0)) == prefilter.TOP
    assert float(level_published(jnp.asarray(np.inf, dtype), 16, 1.0, 1.0, 1.0)) == 0


def test_transforms(dtype):
    density = jnp.array([0, 1e-6, 1e-3, 1, 1e3, np.inf], dtype)
    expected = np.asarray(level(density, 16, 0.01))
    close = 8 * float(np.finfo(dtype).eps)
    assert np.asarray(prefilter.level(density, 16, 0.01)) == pytest.approx(expected, abs=close * 10)
    mapped = jax.jit(jax.vmap(lambda p: prefilter.level(p, 16, 0.01)))(density)
    assert np.asarray(mapped) == pytest.approx(expected, abs=close * 10)
    gradient = jax.jit(jax.vmap(jax.grad(lambda p: prefilter.level(p, 16, 0.01))))(density)
    assert np.isfinite(gradient).all()
    # d level / dp = -1 / (2 ln 2 p) inside.
    assert float(gradient[2]) == pytest.approx(-1 / (2 * np.log(2) * 1e-3), rel=1e-5)
    assert level(np.ones((4, 1)), np.ones(3, np.int32), 1.0).shape == (4, 3)
