import json

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from sssfit.tables import transmittance
from sssfit.tables.lookup_error import lookup_error

SKIN = [0.7568628, 0.32156864, 0.2]
SKIN_ALBEDO = [0.8, 0.6, 0.5]


def light_through(thickness, d):
    """The areal profile over the far side of the slab, in polar coordinates."""

    def ring(r):
        distance = np.hypot(r, thickness)
        profile = (np.exp(-distance / d) + np.exp(-distance / (3 * d))) / (8 * np.pi * d * distance)
        return 2 * np.pi * r * profile

    return quad(ring, 0, 200 * d, epsabs=1e-13, epsrel=1e-12, limit=500)[0]


def test_entries_are_the_profile_over_the_far_side():
    table = transmittance.transmittance(SKIN, SKIN_ALBEDO, 7)
    expected = [
        [a * light_through(t, d) for d, a in zip(SKIN, SKIN_ALBEDO, strict=True)]
        for t in table.axes[0].values
    ]
    np.testing.assert_allclose(table.values, expected, rtol=1e-9, atol=1e-12)


def test_default_range_ends_where_the_widest_channel_fades():
    table = transmittance.transmittance(SKIN, SKIN_ALBEDO)
    assert table.axes[0].values[0] == 0
    np.testing.assert_array_equal(table.values[0], SKIN_ALBEDO)
    assert table.values[-1, 0] == pytest.approx(0.8 / 1024, rel=1e-12)
    assert table.axes[0].values[-1] == table.parameters["max_thickness"]
    assert table.axes[0].values[-1] / SKIN[0] == pytest.approx(19.93, abs=0.005)


def test_chosen_range_and_parameters():
    table = transmittance.transmittance(SKIN, SKIN_ALBEDO, 5, max_thickness=2)
    np.testing.assert_array_equal(table.axes[0].values, [0, 0.5, 1, 1.5, 2])
    assert json.loads(json.dumps(table.parameters)) == {
        "profile": "burley",
        "d": SKIN,
        "albedo": SKIN_ALBEDO,
        "max_thickness": 2.0,
    }


def test_delta_channels_pass_light_through_no_thickness_only():
    table = transmittance.transmittance([0.0, 1.0, 0.0], [1.0, 1.0, 0.5], 4)
    np.testing.assert_array_equal(table.values[:, 0], [1, 0, 0, 0])
    np.testing.assert_array_equal(table.values[:, 2], [0.5, 0, 0, 0])
    nothing = transmittance.transmittance([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], 3)
    np.testing.assert_array_equal(nothing.axes[0].values, [0, 0.5, 1])


@settings(max_examples=30, deadline=None)
@given(
    d=st.lists(st.floats(0, 1e3, allow_subnormal=False), min_size=3, max_size=3),
    albedo=st.lists(st.floats(0, 1, allow_subnormal=False), min_size=3, max_size=3),
)
def test_transmittance_falls_from_the_albedo(d, albedo):
    values = transmittance.transmittance(d, albedo, 32).values
    np.testing.assert_array_equal(values[0], albedo)
    assert np.all(np.diff(values, axis=0) <= 0)
    assert np.all(values >= 0)


@settings(max_examples=20, deadline=None)
@given(thickness=st.floats(0, 50), scale=st.floats(1e-3, 1e3))
def test_only_thickness_over_shape_matters(thickness, scale):
    here = transmittance.evaluate([thickness], SKIN, SKIN_ALBEDO)
    there = transmittance.evaluate([thickness * scale], np.array(SKIN) * scale, SKIN_ALBEDO)
    np.testing.assert_allclose(there, here, rtol=1e-11, atol=1e-200)


@pytest.mark.parametrize("ratio", [1.0, 5.0])
def test_lookup_error_keeps_the_stated_bound(ratio):
    d, albedo = np.array([1.0, 1.0, 1 / ratio]), np.ones(3)
    table = transmittance.transmittance(d, albedo)
    error = lookup_error(table, lambda thickness: transmittance.evaluate(thickness, d, albedo))
    step = table.axes[0].values[1]
    bound = (step * ratio) ** 2 / 24
    assert 0.7 * bound < error <= bound


@pytest.mark.parametrize("flag", [False, True])
def test_result_is_float64_whatever_the_flag(flag):
    with jax.enable_x64(flag):
        values = transmittance.transmittance(SKIN, SKIN_ALBEDO, 16).values
    assert isinstance(values, np.ndarray) and values.dtype == np.float64
    np.testing.assert_array_equal(values, transmittance.transmittance(SKIN, SKIN_ALBEDO, 16).values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_entries": 0}, "num_entries must be at least 2, got 0"),
        ({"d": [1.0, np.inf, 1.0]}, "d must be at least 0 and finite, got inf"),
        ({"d": [1.0, np.nan, 1.0]}, "d must be at least 0 and finite, got nan"),
        ({"d": [-1.0, 1.0, 1.0]}, "d must be at least 0 and finite, got -1"),
        ({"d": 1.0}, r"d must hold 3 numbers, one per channel, got shape \(\)"),
        ({"albedo": [0.5, 1.5, 0.5]}, r"albedo must be in \[0, 1\], got 1.5"),
        ({"max_thickness": 0.0}, "max_thickness must be positive and finite, in mm, got 0"),
        ({"max_thickness": np.inf}, "max_thickness must be positive and finite, in mm, got inf"),
    ],
)
def test_arguments_outside_the_domain(arguments, message):
    with pytest.raises(ValueError, match=message):
        transmittance.transmittance(**{"d": SKIN, "albedo": SKIN_ALBEDO, **arguments})
