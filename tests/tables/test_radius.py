import jax
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sssfit.tables import radius
from sssfit.tables.lookup_error import lookup_error


def exact_radius(survival):
    """Where the survival function has this value, by bisection in 30 digits."""
    with mpmath.workdps(30):
        low, high = mpmath.mpf(0), mpmath.mpf(64)
        for _ in range(80):
            x = (low + high) / 2
            beyond = mpmath.exp(-x) / 4 + 3 * mpmath.exp(-x / 3) / 4 < mpmath.mpf(survival)
            low, high = (low, x) if beyond else (x, high)
        return float(low)


def test_entries_match_an_independent_root():
    table = radius.radius(9)
    roots = table.axes[0].values
    expected = [exact_radius(root**4) for root in roots[:-1]] + [0.0]
    np.testing.assert_allclose(table.values[:, 0], expected, rtol=1e-12, atol=1e-14)


def test_range_is_the_float32_clamp():
    table = radius.radius()
    assert table.values.shape == (256, 1)
    assert table.axes[0].values[0] == 2.0**-6
    assert table.axes[0].values[-1] == 1
    # Burley's inverse cdf at 1 - 2^-24, to 16 digits.
    assert table.values[0, 0] == pytest.approx(49.043550782960726, rel=1e-13)
    assert table.values[-1, 0] == 0
    assert table.parameters["clamp"] == 1 - 2.0**-24


def test_coordinates_beyond_the_clamp_are_clamped():
    assert radius.evaluate([0.0]) == radius.evaluate([2.0**-6])


def test_radii_strictly_descend():
    assert np.all(np.diff(radius.radius(1024).values[:, 0]) < 0)


@settings(max_examples=30, deadline=None)
@given(d=st.floats(1e-3, 1e3), root=st.floats(2.0**-6, 1.0))
def test_one_table_serves_every_shape(d, root):
    r = d * radius.evaluate([root])[0, 0]
    survival = np.exp(-r / d) / 4 + 3 * np.exp(-r / (3 * d)) / 4
    assert survival == pytest.approx(root**4, rel=1e-11)


def test_lookup_errors_are_those_of_the_docstring():
    table = radius.radius()
    assert lookup_error(table, radius.evaluate) == pytest.approx(0.073, rel=0.01)
    survival = 2.0 ** -np.linspace(24, 0, 100_001)
    exact = radius.evaluate(survival**0.25)[:, 0]

    def rms(power):
        nodes = np.linspace(2.0 ** (-24 * power), 1, 256)
        entries = radius.evaluate(nodes ** (0.25 / power))[:, 0]
        error = np.interp(survival**power, nodes, entries) - exact
        return np.sqrt(np.trapezoid(error**2, survival))

    assert rms(0.25) == pytest.approx(7.2e-5, rel=0.01)
    assert rms(0.5) == pytest.approx(1.5e-2, rel=0.03)
    assert rms(1.0) == pytest.approx(0.97, rel=0.01)


@pytest.mark.parametrize("flag", [False, True])
def test_result_is_float64_whatever_the_flag(flag):
    with jax.enable_x64(flag):
        values = radius.radius(17).values
    assert isinstance(values, np.ndarray) and values.dtype == np.float64
    np.testing.assert_array_equal(values, radius.radius(17).values)


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_entries(count):
    with pytest.raises(ValueError, match=f"num_entries must be at least 2, got {count}"):
        radius.radius(count)
