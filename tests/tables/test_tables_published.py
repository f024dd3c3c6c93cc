"""The printed numbers on tables: none fails, and ours are those of SciPy's quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from sssfit.tables import published


@pytest.fixture(scope="module")
def rows():
    return list(published.rows())


def test_no_row_fails(rows):
    assert [row.verdict for row in rows] == 5 * ["reproduced"]
    assert [row.source for row in rows] == 4 * ["Web article, section 4-1"] + ["Web article, section 4-2"]
    assert all(isinstance(row.ours, float) for row in rows)


def test_the_integrals_of_pre_integrated_skin_over_the_distance(rows):
    shape, radius, theta = 0.7568628, 3.0, np.pi / 4

    def density(r):
        return (np.exp(-r / shape) + np.exp(-r / (3 * shape))) / (4 * shape)

    def lit(r, side):
        return density(r) * max(0.0, np.cos(theta + side * 2 * np.arcsin(r / (2 * radius)))) / 2

    # Where the light sets, on the near side: the chord of 45 degrees.
    sets = 2 * radius * np.sin(theta / 2)
    numerator = quad(lit, 0, sets, (1,), epsabs=1e-13)[0]
    risen = 2 * radius * np.sin(3 * theta / 2)
    numerator += sum(quad(lit, *ends, (-1,), epsabs=1e-13)[0] for ends in ((0, sets), (sets, risen)))
    denominator = quad(density, 0, 2 * radius, epsabs=1e-13)[0]
    ours = [row.ours for row in rows[:4]]
    assert ours == pytest.approx([numerator, numerator, denominator, denominator], abs=2e-9)
    # Published to more digits elsewhere: mpmath.
    assert ours[1] == pytest.approx(0.56347312112818184615, abs=1e-9)
    assert ours[3] == pytest.approx(0.94652180600877005704, abs=1e-12)


def test_the_sphere_in_place_of_the_circle_fails(monkeypatch):
    right = published.curvature.evaluate
    monkeypatch.setattr(published.curvature, "evaluate", lambda *a, average: right(*a, average="sphere"))
    assert next(published.rows()).verdict == "FAILS"
