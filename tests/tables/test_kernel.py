import json

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import k0

from sssfit.tables import kernel

SKIN = np.array([0.7568628, 0.32156864, 0.2])
# Published Gaussians of the red channel but the narrowest: variances in mm^2 and weights.
VARIANCES = np.array([0.0484, 0.187, 0.567, 1.99, 7.41])
WEIGHTS = np.array([0.1, 0.118, 0.113, 0.358, 0.078])


def line_mass(low, high, d):
    """Share of the line spread between two distances of one sign, from its Bessel functions."""
    spread = lambda x: (k0(abs(x) / d) + k0(abs(x) / (3 * d))) / (4 * np.pi * d)  # noqa: E731
    return quad(spread, low, high, epsabs=1e-14, epsrel=1e-12, limit=200)[0]


def cell_edges(offsets):
    return np.concatenate([offsets[:1], (offsets[1:] + offsets[:-1]) / 2, offsets[-1:]])


def gaussians(r, falloff):
    stretched = r / (0.001 + falloff)
    return np.sum(WEIGHTS * np.exp(-(stretched**2) / (2 * VARIANCES)) / (2 * np.pi * VARIANCES))


def test_burley_weights_are_the_masses_of_the_cells():
    table = kernel.burley_kernel_table(SKIN, 7)
    edges = cell_edges(table.axes[0].values)
    for channel, d in enumerate(SKIN):
        cells = zip(edges[:-1], edges[1:], strict=True)
        mass = [line_mass(a, b, d) if a * b >= 0 else 2 * line_mass(0, b, d) for a, b in cells]
        np.testing.assert_allclose(table.values[:, channel], np.array(mass) / np.sum(mass), rtol=1e-8)


def test_burley_reach_and_lost_mass():
    table = kernel.burley_kernel_table(SKIN)
    reach = table.parameters["reach"]
    assert table.values.shape == (25, 3)
    assert reach == table.axes[0].values[-1] == -table.axes[0].values[0]
    survival = np.exp(-reach / SKIN[0]) / 4 + 3 * np.exp(-reach / (3 * SKIN[0])) / 4
    assert survival == pytest.approx(0.003, rel=1e-9)
    expected = [2 * line_mass(reach, 60 * SKIN[0], d) for d in SKIN]
    np.testing.assert_allclose(table.parameters["truncated_mass"], expected, rtol=1e-6)
    assert kernel.burley_kernel_table(SKIN, 5, reach=2.0).axes[0].values.tolist() == [-2, -0.5, 0, 0.5, 2]


@settings(max_examples=20, deadline=None)
@given(d=st.lists(st.just(0.0) | st.floats(1e-6, 100), min_size=3, max_size=3))
def test_burley_weights_are_a_symmetric_share_of_one(d):
    values = kernel.burley_kernel_table(d, 9).values
    np.testing.assert_allclose(values.sum(axis=0), 1, rtol=1e-13)
    np.testing.assert_allclose(values, values[::-1], rtol=0, atol=1e-15)
    assert values.min() >= 0


@settings(max_examples=15, deadline=None)
@given(scale=st.floats(1e-3, 1e3))
def test_burley_offsets_scale_with_the_material(scale):
    here, there = kernel.burley_kernel_table(SKIN, 9), kernel.burley_kernel_table(SKIN * scale, 9)
    np.testing.assert_allclose(there.axes[0].values, here.axes[0].values * scale, rtol=1e-12)
    np.testing.assert_allclose(there.values, here.values, rtol=1e-9)


def test_delta_channels_keep_their_light_in_the_middle():
    table = kernel.burley_kernel_table([0.0, 1.0, 0.0], 5)
    np.testing.assert_array_equal(table.values[:, [0, 2]], [[0, 0], [0, 0], [1, 1], [0, 0], [0, 0]])
    assert table.parameters["truncated_mass"][0] == 0
    nothing = kernel.burley_kernel_table([0.0, 0.0, 0.0], 5)
    assert nothing.parameters["reach"] == 1
    np.testing.assert_array_equal(nothing.values, [[0] * 3, [0] * 3, [1] * 3, [0] * 3, [0] * 3])


def test_falloff_weights_follow_the_published_recipe():
    table = kernel.falloff_kernel_table()
    offsets = table.axes[0].values
    areas = np.diff(cell_edges(offsets))
    for channel, (falloff, strength) in enumerate(zip((1, 0.37, 0.3), (0.48, 0.41, 0.28), strict=True)):
        taps = areas * [gaussians(r, falloff) for r in offsets]
        expected = strength * taps / np.sum(taps) + (1 - strength) * (offsets == 0)
        np.testing.assert_allclose(table.values[:, channel], expected, rtol=1e-12)


@pytest.mark.parametrize(("taps", "reach"), [(11, 2.0), (17, 2.0), (25, 3.0)])
def test_falloff_reach_and_lost_mass(taps, reach):
    table = kernel.falloff_kernel_table(num_taps=taps)
    assert table.parameters["reach"] == reach == table.axes[0].values[-1]
    for lost, falloff in zip(table.parameters["truncated_mass"], (1, 0.37, 0.3), strict=True):
        kept, whole = (
            quad(gaussians, 0, end, (falloff,), points=[0.1, 0.5], epsabs=1e-13)[0] for end in (reach, 20.0)
        )
        assert lost == pytest.approx(1 - kept / whole, rel=1e-5, abs=1e-9)


def test_falloff_without_width_or_strength_does_not_blur():
    table = kernel.falloff_kernel_table((0.0, 1.0, 0.5), (1.0, 0.0, 1.0), 5)
    np.testing.assert_allclose(table.values[:, :2], [[0, 0], [0, 0], [1, 1], [0, 0], [0, 0]], atol=1e-300)
    assert table.values[2, 2] < 1


def test_parameters_are_json():
    tables = kernel.burley_kernel_table(SKIN, 5, reach=2), kernel.falloff_kernel_table(num_taps=5)
    burley, falloff = (json.loads(json.dumps(table.parameters)) for table in tables)
    assert burley["d"] == SKIN.tolist() and burley["num_taps"] == 5 and burley["reach"] == 2.0
    assert falloff["falloff"] == [1.0, 0.37, 0.3] and falloff["strength"] == [0.48, 0.41, 0.28]


@pytest.mark.parametrize("flag", [False, True])
@pytest.mark.parametrize("build", [lambda: kernel.burley_kernel_table(SKIN, 7), kernel.falloff_kernel_table])
def test_result_is_float64_whatever_the_flag(flag, build):
    with jax.enable_x64(flag):
        values = build().values
    assert isinstance(values, np.ndarray) and values.dtype == np.float64
    np.testing.assert_array_equal(values, build().values)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: kernel.burley_kernel_table(SKIN, 4), "num_taps must be odd and at least 3, got 4"),
        (lambda: kernel.burley_kernel_table(SKIN, reach=0.0), "reach must be a positive length in mm, got 0"),
        (lambda: kernel.burley_kernel_table([1, np.nan, 1]), "d must be at least 0 and finite, got nan"),
        (lambda: kernel.burley_kernel_table([1, np.inf, 1]), "d must be at least 0 and finite, got inf"),
        (lambda: kernel.falloff_kernel_table(num_taps=1), "num_taps must be odd and at least 3, got 1"),
        (lambda: kernel.falloff_kernel_table((2, 0, 0)), r"falloff must be in \[0, 1\], got 2"),
        (lambda: kernel.falloff_kernel_table(strength=(0, 0, -1)), r"strength must be in \[0, 1\], got -1"),
    ],
)
def test_arguments_outside_the_domain(build, message):
    with pytest.raises(ValueError, match=message):
        build()
