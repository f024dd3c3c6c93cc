"""The printed numbers on fits: none fails, and ours are those of independent computations."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from sssfit.fitting import published
from sssfit.profiles import gaussian_sum


@pytest.fixture(scope="module")
def rows():
    return list(published.rows())


def test_no_row_fails(rows):
    assert [row for row in rows if row.verdict == "FAILS"] == []
    assert all(isinstance(row.ours, float) for row in rows)


def test_what_is_there(rows):
    assert Counter((row.source, row.verdict) for row in rows) == {
        ("Xie et al. 2020, Eq 21", "reproduced"): 1,
        ("Xie 2021, Eq 5.4", "differs"): 2,
        ("Xie 2021, Eq 5.4", "reproduced"): 1,
        ("Web article, section 4-3-1", "differs"): 2,
        ("Web article, section 4-3-2", "differs"): 6,
    }


def test_c(rows):
    # The continuous integral's minimum by mpmath in 20 digits.
    assert rows[0].ours == pytest.approx(2.571500425201475819, abs=1e-7)


def test_the_closed_form_as_printed_and_as_it_is(rows, reference):
    of_xi = {0.1: (6.062229143326714, 0.3094030041089578), 0.9: (0.2144618199549013, 8.74594792181)}
    for xi, (swapped, base) in of_xi.items():
        found = [row for row in rows if row.quantity == f"r / d at xi = {xi} (formula)"]
        assert [row.printed_value for row in found] == pytest.approx([swapped, base], rel=1e-4)
        for row in found:
            assert row.ours == pytest.approx(float(reference.ppf(xi)[0]), rel=1e-12)


def test_the_separable_fit_by_the_law_below_the_bound(rows):
    # d and, below its bound, the albedo are proportional to falloff + 0.001; constants from SciPy, 13 digits.
    for channel, falloff in (("G", 0.37), ("B", 0.3)):
        albedo, dmfp = [row.ours for row in rows if row.quantity.startswith(f"Unreal's {channel}")]
        expected = 1.45715644870843 * (falloff + 0.001)
        d = 0.193150096888229 * (falloff + 0.001)
        assert albedo == pytest.approx(expected, rel=1e-7)
        assert dmfp == pytest.approx(d * (3.5 + 100 * (expected - 0.33) ** 4), rel=1e-6)


def test_the_separable_fit_at_the_bound(rows):
    albedo, dmfp = [row.ours for row in rows if row.quantity.startswith("Unreal's R")]
    assert albedo == pytest.approx(1, abs=1e-6)
    # With the albedo 1 only d is left: a search on a sum over a million points.
    r = (np.arange(1_000_000) + 0.5) * 3e-5
    variances, weights = gaussian_sum.SKIN_VARIANCES[1:], gaussian_sum.SKIN_WEIGHTS[1:, 0]
    stretched = (r / 1.001) ** 2 / 2
    wanted = sum(
        w * np.exp(-stretched / v) / (2 * np.pi * v) for v, w in zip(variances, weights, strict=True)
    )

    def misfit(d):
        return np.sum((wanted - (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d)) ** 2)

    found: Any = minimize_scalar(misfit, bounds=(0.05, 0.5), method="bounded", options={"xatol": 1e-8})
    # A minimum found from its values has half of their digits.
    assert dmfp == pytest.approx(found.x * (3.5 + 100 * 0.67**4), rel=1e-5)


def test_the_closed_form_with_another_logarithm_fails(monkeypatch):
    monkeypatch.setattr(published.inverse_cdf, "closed_form", lambda xi, d: published._printed(1 - xi))
    assert {row.verdict for row in published._closed_form()} == {"differs", "reproduced"}
    monkeypatch.setattr(published.inverse_cdf, "closed_form", lambda xi, d: published._printed(xi))
    assert [row.verdict for row in published._closed_form()].count("FAILS") == 2
