"""The falloff table: its law, its polynomials, and the options it refuses."""

import numpy as np
import pytest

from sssfit.fitting import separable_to_burley
from sssfit.profiles import burley
from sssfit.tables import falloff


@pytest.fixture(scope="module")
def table():
    return falloff.falloff(64)


def test_entries_are_single_fits(table):
    for index in (0, 20, 63):
        fit = separable_to_burley.fit(float(table.axes[0].values[index]))
        np.testing.assert_allclose(table.values[index], [fit.albedo, fit.d, fit.dmfp], rtol=1e-6)


def test_law_gives_the_table(table):
    law = table.parameters["law"]
    phi = table.axes[0].values + 0.001
    np.testing.assert_allclose(
        table.values[:, 0], law["albedo_factor"] * phi ** law["albedo_power"], rtol=1e-6
    )
    np.testing.assert_allclose(table.values[:, 1], law["d_factor"] * phi, rtol=1e-6)


@pytest.mark.parametrize("index, channel", list(enumerate(falloff.CHANNELS)))
def test_polynomial_errors_are_the_stated_ones(table, index, channel):
    errors = []
    for polynomial in table.parameters["polynomials"][channel]:
        assert len(polynomial["coefficients"]) == polynomial["degree"] + 1
        value = np.polynomial.polynomial.polyval(table.axes[0].values, polynomial["coefficients"])
        errors.append(np.max(np.abs(value - table.values[:, index])))
        assert errors[-1] == pytest.approx(polynomial["max_error"], rel=1e-6, abs=1e-11)
    # The law is a quadratic, a line, and a polynomial of degree 9, in falloff + 0.001.
    exact = {"albedo": 1, "d": 0, "dmfp": 3}[channel]
    assert all(error < 1e-6 for error in errors[exact:])
    assert all(error > 1e-3 for error in errors[:exact])


def test_as_coded_stops_at_albedo_one():
    table = falloff.falloff(32, reading="as_coded")
    albedo, d, dmfp = table.values.T
    assert albedo.max() == pytest.approx(1.0, abs=1e-9)
    assert (np.diff(d) > 0).sum() < 31  # beyond the bound d stops growing in proportion
    with np.errstate(invalid="raise"):
        np.testing.assert_allclose(dmfp, np.asarray(burley.dmfp_from_shape(d, albedo.clip(0, 1))), rtol=1e-5)


def test_objective_that_determines_nothing():
    with pytest.raises(ValueError, match="objective 'derivative' with reading 'radial' does not determine"):
        falloff.falloff(12, "derivative")


def test_too_small():
    with pytest.raises(ValueError, match="num_entries must be at least 12, got 0"):
        falloff.falloff(0)
