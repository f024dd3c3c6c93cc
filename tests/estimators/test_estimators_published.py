"""The printed numbers on estimators: none fails, each can, and ours are those of other computations."""

from collections import Counter
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2

from sssfit.estimators import bias, count_prediction, moving, published


@pytest.fixture(scope="module")
def rows():
    return list(published.rows())


def of(rows, source):
    (row,) = [row for row in rows if row.source == source]
    return row


def test_no_row_fails(rows):
    assert [row for row in rows if row.verdict == "FAILS"] == []
    assert all(isinstance(row.ours, float) for row in rows)
    assert len({(row.source, row.quantity) for row in rows}) == len(rows)


def test_what_is_there(rows):
    assert Counter(row.source.rsplit(", ", 1)[0] for row in rows) == {
        "Xie et al. 2020": 5,
        "Xie and Olano 2021": 12,
        "Xie 2021": 16,
    }
    assert {row.source for row in rows if row.differs} == {
        "Xie et al. 2020, Eq 15",
        *(f"Xie 2021, {place}" for place in ("above Eq 2.19", "below Eq 2.25", "Eq 2.26", "Eq 2.31")),
        *(f"Xie 2021, {place}" for place in ("below Eq 2.34", "section 6.5.3", "section B.1.2", "Eq B.33")),
    }


def test_whole_numbers_to_rounding(rows):
    # Their printed digits alone would allow a half.
    whole = [row for row in rows if row.printed.isdigit() and row.printed != "0" and not row.differs]
    assert len(whole) == 11
    assert [row.ours for row in whole] == pytest.approx([row.printed_value for row in whole], rel=1e-12)


def test_the_count_with_and_without_squares(rows):
    # By hand: 16 (1.21 + 0.2 * 8 * 0.21), and 16 (1.21 + 0.2 * 8 * 0.008 / 0.0064).
    row = of(rows, "Xie et al. 2020, Eq 15")
    assert row.ours == pytest.approx(24.736, rel=1e-12) and row.printed == "51.36"


def test_the_variance_of_a_product_by_fractions(rows):
    values = [t * (f - Fraction(3, 2) * g) for t, (f, g) in product((1, 3), ((0, 1), (1, 2), (5, 3)))]
    mean = sum(values) / 6
    variance = sum((value - mean) ** 2 for value in values) / 6
    assert variance == Fraction(41, 6)
    for source in ("Xie and Olano 2021, Eq 22", "Xie 2021, Eq B.33"):
        assert of(rows, source).ours == pytest.approx(41 / 6, rel=1e-14)
    # Twice E[T]^2 Var, and Var T E^2: 2 * 4 * 7 / 6 + 1.
    assert of(rows, "Xie 2021, Eq B.33").printed_value == pytest.approx(31 / 3, rel=1e-4)


def test_weights_without_the_first(rows):
    assert of(rows, "Xie 2021, section B.1.2").ours == pytest.approx(1 - 0.95**10, rel=1e-13)


def test_every_entry_of_the_lagged_covariance_is_a_quarter_larger(rows, x64):
    pairs = np.random.default_rng(7).normal(size=(50, 2))
    ratios = np.asarray(moving.ewma_covariance(pairs, 0.2))[1:] / np.asarray(moving.emcm(pairs, 0.2))[1:]
    assert ratios == pytest.approx(np.full((49, 2, 2), 1.25), rel=1e-12)
    assert of(rows, "Xie and Olano 2021, Eq 33-34").ours == pytest.approx(1.25, rel=1e-12)


def test_chi_square_statements_against_the_distribution(rows):
    exact = {
        "Xie 2021, Eq 2.27": 1 - chi2.cdf(chi2.ppf(0.05, 15), 15),
        "Xie 2021, below Eq 2.25": 15 / 16,
        "Xie 2021, Eq 2.26": 15.0,
    }
    errors = {
        "Xie 2021, Eq 2.27": np.sqrt(0.05 * 0.95 / 400_000),
        "Xie 2021, below Eq 2.25": np.sqrt(2 * 15 / 16**2 / 400_000),
        "Xie 2021, Eq 2.26": np.sqrt(2 * 15 / 400_000),
    }
    for source, value in exact.items():
        row = of(rows, source)
        # The error of an estimated error, of 400000 values, is below 1 %.
        assert row.standard_error == pytest.approx(errors[source], rel=0.01)
        assert abs(row.ours - value) < 4 * errors[source]
    assert of(rows, "Xie 2021, below Eq 2.25").printed_value == pytest.approx(15 / 256, rel=1e-4)


def test_probabilities_without_exponents(rows):
    # Two samples come as (2, 0), (1, 1), (0, 2) in 1, 2, 1 ways.
    row = of(rows, "Xie 2021, Eq 2.31")
    assert row.printed_value == pytest.approx(4 * 0.09) and row.ours == pytest.approx(1, rel=1e-14)


def test_the_other_sample_variance_fails(monkeypatch):
    right = count_prediction.target_variance

    def with_divisor_one_less(variances, size, *, confidence):
        return right(variances * size / (size - 1), size, confidence=confidence)

    monkeypatch.setattr(count_prediction, "target_variance", with_divisor_one_less)
    assert next(published._chi_square()).verdict == "FAILS"


def test_a_bias_off_by_a_billionth_fails(monkeypatch):
    right = bias.pilot_bias
    monkeypatch.setattr(bias, "pilot_bias", lambda *arguments: right(*arguments) + 1e-9)
    assert [row.verdict for row in published._pilots()][:2] == ["FAILS", "FAILS"]


def test_a_covariance_off_by_a_billionth_fails(monkeypatch):
    right = moving.emcm
    monkeypatch.setattr(moving, "emcm", lambda *arguments: right(*arguments) * (1 + 1e-9))
    assert next(published._covariances()).verdict == "FAILS"
