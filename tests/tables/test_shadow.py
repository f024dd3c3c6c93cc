import json

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import k0

from sssfit.tables import shadow
from sssfit.tables.lookup_error import lookup_error

SKIN = np.array([0.7568628, 0.32156864, 0.2])
VALUES = np.linspace(0, 1, 33)


def sharp_ramp(x, width, sharpening, shift):
    """P': from 0 to 1 around `shift` widths right of the penumbra's middle, `sharpening` times as steep."""
    return np.clip((x / width - shift) * sharpening + 0.5, 0, 1)


def by_adaptive_quadrature(s, width, d, sharpening, shift):
    """Mean of P'(P^-1(s) + X), X from the Bessel functions of the line spread."""
    middle = width * (s - 0.5)

    def integrand(x):
        spread = (k0(abs(x) / d) + k0(abs(x) / (3 * d))) / (4 * np.pi * d)
        return spread * sharp_ramp(middle + x, width, sharpening, shift)

    corners = [width * (shift + side * 0.5 / sharpening) - middle for side in (-1, 1)]
    breaks = np.unique(np.clip([-100 * d, -d, 0, d, 100 * d, *corners], -100 * d, 100 * d))
    spans = zip(breaks[:-1], breaks[1:], strict=True)
    return sum(quad(integrand, a, b, epsabs=1e-13, epsrel=1e-11, limit=400)[0] for a, b in spans)


@pytest.mark.parametrize(("sharpening", "shift"), [(10.0, 0.0), (10.0, 0.45), (3.0, -0.2), (1.0, 0.0)])
def test_grid_matches_adaptive_quadrature(sharpening, shift):
    widths, values = np.array([40.0, 10.0, 1.0]), np.array([0.0, 0.3, 0.5, 0.56, 1.0])
    result = shadow.evaluate(1 / widths, values, np.array([1.0, 0.3, 4.0]), sharpening, shift)
    expected = [
        [[by_adaptive_quadrature(s, w, d, sharpening, shift) for d in (1.0, 0.3, 4.0)] for s in values]
        for w in widths
    ]
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("sharpening", "shift"), [(10.0, 0.0), (4.0, 0.375), (1.0, 0.0)])
def test_delta_channels_and_infinite_widths_are_the_sharp_ramp(sharpening, shift):
    table = shadow.shadow([0.0, 1.0, 0.0], 41, 5, sharpening=sharpening, shift=shift)
    ramp = sharp_ramp(table.axes[1].values - 0.5, 1.0, sharpening, shift)
    np.testing.assert_allclose(table.values[0], np.stack([ramp] * 3, -1), rtol=0, atol=1e-14)
    np.testing.assert_allclose(table.values[:, :, 0], np.stack([ramp] * 5), rtol=0, atol=1e-14)
    assert np.all(shadow.shadow(np.zeros(3)).axes[0].values == np.linspace(0, 1, 64))


@settings(max_examples=30, deadline=None)
@given(inverse_width=st.floats(0, 10), sharpening=st.floats(1, 50), share=st.floats(-1, 1))
def test_light_rises_with_the_shadow_value_within_its_range(inverse_width, sharpening, share):
    shift = share * (0.5 - 0.5 / sharpening)
    values = shadow.evaluate([inverse_width], VALUES, SKIN, sharpening, shift)
    assert np.all(np.diff(values, axis=1) >= -1e-13)
    assert values.min() >= 0 and values.max() <= 1


@settings(max_examples=20, deadline=None)
@given(inverse_width=st.floats(0, 10), sharpening=st.floats(1, 50), share=st.floats(-1, 1))
def test_dark_and_light_are_mirror_images(inverse_width, sharpening, share):
    shift = share * (0.5 - 0.5 / sharpening)
    values = shadow.evaluate([inverse_width], VALUES, SKIN, sharpening, shift)
    mirrored = shadow.evaluate([inverse_width], 1 - VALUES, SKIN, sharpening, -shift)
    np.testing.assert_allclose(values, 1 - mirrored, rtol=0, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(relative=st.floats(1e-6, 10), scale=st.floats(1e-3, 1e3))
def test_only_shape_over_width_matters(relative, scale):
    here = shadow.evaluate([relative], VALUES, np.ones(3))
    there = shadow.evaluate([relative * scale], VALUES, np.full(3, 1 / scale))
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-11)


def test_default_widths_leak_half_a_percent():
    table = shadow.shadow(SKIN)
    assert table.parameters["min_width"] == pytest.approx(20 * SKIN[0])
    assert table.axes[0].values[0] == 0
    np.testing.assert_allclose(table.values[-1, [0, -1], 0], [0.0052, 0.9948], atol=5e-5)


def test_largest_shift_has_the_edge_where_full_light_begins():
    # Half of the light of an edge a tenth of the penumbra wide is lost next to it.
    at_full_light = shadow.evaluate([0.2], [1.0], np.ones(3), 10.0, 0.45)[0, 0, 0]
    assert 0.5 < at_full_light < 0.65
    assert shadow.evaluate([0.2], [0.0], np.ones(3), 10.0, 0.45)[0, 0, 0] < 0.05


def test_layout_and_parameters():
    table = shadow.shadow(SKIN, 5, 3, min_width=8.0, sharpening=4.0, shift=0.1)
    assert [(axis.name, axis.unit) for axis in table.axes] == [("inverse_width", "1/mm"), ("shadow", "1")]
    np.testing.assert_array_equal(table.axes[0].values, [0, 0.0625, 0.125])
    np.testing.assert_array_equal(table.axes[1].values, [0, 0.25, 0.5, 0.75, 1])
    rows, columns = (axis.values for axis in table.axes)
    expected = shadow.evaluate(rows, columns, SKIN, 4.0, 0.1)
    np.testing.assert_array_equal(table.values, expected)
    assert json.loads(json.dumps(table.parameters)) == {
        "profile": "burley",
        "d": SKIN.tolist(),
        "min_width": 8.0,
        "sharpening": 4.0,
        "shift": 0.1,
    }


def test_lookup_error_is_that_of_the_ramp_corners():
    def evaluate(inverse_widths, values):
        return shadow.evaluate(inverse_widths, values, SKIN)

    # At most a quarter of a column's step times the change of slope.
    assert lookup_error(shadow.shadow(SKIN), evaluate) <= 10 / 63 / 4
    # With 61 values the corners 0.45 and 0.55 are entries.
    assert lookup_error(shadow.shadow(SKIN, num_values=61), evaluate) < 0.02


@pytest.mark.parametrize("flag", [False, True])
def test_result_is_float64_whatever_the_flag(flag):
    with jax.enable_x64(flag):
        values = shadow.shadow(SKIN, 8, 8).values
    assert isinstance(values, np.ndarray) and values.dtype == np.float64
    np.testing.assert_array_equal(values, shadow.shadow(SKIN, 8, 8).values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_values": 0}, "num_values must be at least 2, got 0"),
        ({"num_widths": 1}, "num_widths must be at least 2, got 1"),
        ({"d": [1.0, np.inf, 1.0]}, "d must be at least 0 and finite, got inf"),
        ({"d": [1.0, np.nan, 1.0]}, "d must be at least 0 and finite, got nan"),
        ({"min_width": 0.0}, "min_width must be positive and finite, in mm, got 0"),
        ({"sharpening": 0.5}, "sharpening must be at least 1 and finite, got 0.5"),
        ({"sharpening": np.nan}, "sharpening must be at least 1 and finite, got nan"),
        ({"shift": 0.5}, "shift must be at most 0.45 either way at sharpening 10, got 0.5"),
        ({"shift": np.nan}, "shift must be at most 0.45 either way at sharpening 10, got nan"),
    ],
)
def test_arguments_outside_the_domain(arguments, message):
    with pytest.raises(ValueError, match=message):
        shadow.shadow(**{"d": SKIN, **arguments})


def test_coordinates_outside_the_domain():
    with pytest.raises(ValueError, match="inverse_widths must be at least 0 and finite, got -1"):
        shadow.evaluate([-1.0], [0.0], SKIN)
    with pytest.raises(ValueError, match=r"values must be in \[0, 1\], got 2"):
        shadow.evaluate([0.0], [2.0], SKIN)
