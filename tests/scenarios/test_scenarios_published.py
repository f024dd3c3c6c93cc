"""The printed numbers on scenarios: none fails, each can, and ours are those of other computations."""

import math
from collections import Counter
from itertools import groupby

import numpy as np
import pytest

from sssfit.scenarios import batch_mean, published

#: Table B.1 by an independent simulation of 4000 seeds in NumPy: mean, or median where tails are heavy, and
#: the seeds' deviation.
INDEPENDENT = {
    "static": {
        "Res_f": (0.03211, 0.00257),
        "SF": (0.01561, 0.00142),
        "SF+EMA": (0.00590, 0.00047),
        "GT": (0.00569, 0.00045),
    },
    "dynamic": {
        "Res_f": (0.57616, 0.00503),
        "SF": (0.37636, 0.00221),
        "SF+EMA": (0.37435, 0.00242),
        "GT": (0.13408, 0.0125),
    },
}
#: Its medians, and between which 95 % of its seeds lie.
INDEPENDENT_MEDIANS = {
    "static": {"EMCM": (0.00694, 0.0056, 0.0170), "EMCM_hat": (0.0327, 0.0276, 0.0403)},
    "dynamic": {"EMCM": (0.1380, 0.113, 0.229), "EMCM_hat": (0.0778, 0.062, 0.174)},
}


# Without simulating


def test_exact_coefficients():
    static, _, left, dynamic = published._coefficients()
    # By Gauss's rule of 40 points, exact to rounding for functions as smooth as these.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    y, weights = (nodes + 1) / 2, weights / 2
    f, g = 1 / (1 + y), 1 - y
    f_mean, g_mean = weights @ f, weights @ g
    best = (weights @ ((f - f_mean) * (g - g_mean))) / (weights @ (g - g_mean) ** 2)
    assert static.ours == pytest.approx(best, rel=1e-13)
    assert left.ours == pytest.approx(f_mean - 1.388 * g_mean, rel=1e-12)
    assert dynamic.ours == pytest.approx(f_mean / g_mean, rel=1e-14)
    assert all(row.verdict == "reproduced" for row in (static, left, dynamic))


def test_the_coefficient_of_many_samples():
    found = published._many_samples(spp=1024, seeds=200)
    # 1.38582 for 1024 samples, with a deviation of 0.00224, by the moments of the frames' means.
    assert abs(found.mean() - 1.38582) < 4 * 0.00224 / math.sqrt(200)
    assert 0.00224 * (1 - 4 / math.sqrt(400)) < found.std(ddof=1) < 0.00224 * (1 + 4 / math.sqrt(400))


def test_a_peak_lasts_as_long_as_it_is_high():
    random = np.random.default_rng(0)
    is_peak = random.random((50, 40)) < 0.6
    runs = [[len(list(run)) for high, run in groupby(row) if high] for row in is_peak.tolist()]
    length, error = published._peak_length(is_peak)
    assert length == pytest.approx(np.mean([n for row in runs for n in row]), rel=1e-14)
    # Geometric runs of mean 1 / 0.4, cut off at the ends: the error of a ratio, by leaving rows out.
    left_out = [published._peak_length(np.delete(is_peak, i, axis=0))[0] for i in range(50)]
    jackknife = math.sqrt(49 / 50 * np.sum((np.array(left_out) - np.mean(left_out)) ** 2))
    # They agree to the relative order of 1 / rows.
    assert error == pytest.approx(jackknife, rel=0.1)


def test_another_coefficient_fails(monkeypatch):
    wrong = batch_mean.MOMENTS._replace(covariance=batch_mean.MOMENTS.covariance * 1.002)
    monkeypatch.setattr(batch_mean, "MOMENTS", wrong)
    assert next(published._coefficients()).verdict == "FAILS"


def test_a_biased_result_fails(monkeypatch):
    """The first row, with a tenth of its seeds and a bias of eight standard errors."""
    monkeypatch.setattr(published, "_CIRCLE_SEEDS", 200)
    right = published.driver.run

    def biased(*arguments, **options):
        record = right(*arguments, **options)
        # 200 seeds of 100 frames, whose variance is some 1.2 times the target.
        return record._replace(value=record.value + 8 * 0.088 / math.sqrt(200 * 100))

    first = next(published._circle())
    assert first.verdict == "reproduced" and first.printed == "0"
    monkeypatch.setattr(published.driver, "run", biased)
    assert next(published._circle()).verdict == "FAILS"


# All of them


@pytest.fixture(scope="module")
def rows():
    return list(published.rows())


def of(rows, source, quantity):
    (row,) = [row for row in rows if row.source == source and row.quantity.startswith(quantity)]
    return row


@pytest.mark.slow
def test_no_row_fails(rows):
    assert [row for row in rows if row.verdict == "FAILS"] == []
    assert all(isinstance(row.ours, float) for row in rows)
    assert len({(row.source, row.quantity) for row in rows}) == len(rows)


@pytest.mark.slow
def test_what_is_there(rows):
    assert Counter(row.source for row in rows) == {
        "Xie et al. 2020, section 4.1.3": 5,
        "Xie and Olano 2021, Fig 2": 2,
        "Xie and Olano 2021, section 6.2.4": 2,
        "Xie 2021, appendix B.3.2": 3,
        "Xie and Olano 2021, section 6.1.2": 1,
        "Xie 2021, Table B.1": 12,
    }
    assert {(row.source, row.quantity) for row in rows if row.verdict == "differs"} == {
        *(
            ("Xie et al. 2020, section 4.1.3", quantity)
            for quantity in (
                'variance "within the given quality level", kappa = 0, % of sigma_0^2',
                'variance "within the given quality level", kappa = 1, % of sigma_0^2',
                "frames that a peak above 24 spp usually lasts, kappa = 1, R2 points",
            )
        ),
        ("Xie and Olano 2021, Fig 2", "samples under dynamic light, % of static"),
        ("Xie and Olano 2021, Fig 2", "rmse under dynamic light"),
        ("Xie and Olano 2021, section 6.2.4", "samples of a = 1 less those of the online a"),
        ("Xie and Olano 2021, section 6.2.4", "rmse of a = 1 over that of the online a (.0031 / .0028)"),
        ("Xie 2021, Table B.1", "Res_f, dynamic"),
    }
    assert all(row.reason for row in rows if row.differs)


@pytest.mark.slow
def test_the_circle_by_an_independent_simulation(rows):
    source = "Xie et al. 2020, section 4.1.3"
    # Variances of a frame's result of 20000 seeds, whose errors are a third of ours.
    for kappa, variance in ((0, 7.784e-3), (1, 1.0752e-2)):
        row = of(rows, source, f'variance "within the given quality level", kappa = {kappa}')
        assert abs(row.ours - 100 * variance / 0.0064) < 4 * math.hypot(
            row.standard_error, row.standard_error / 3
        )
    peaks = of(rows, source, "frames that a peak above 24 spp")
    # 2.8 on average, to the printed digit.
    assert abs(peaks.ours - 2.8) < 0.05 + 4 * peaks.standard_error


@pytest.mark.slow
def test_the_line_by_an_independent_simulation(rows):
    """That of the same setting: 2.32 times the samples, and 20.8 against 22.5 for the coefficients."""
    ratio = of(rows, "Xie and Olano 2021, Fig 2", "samples under dynamic light")
    assert abs(ratio.ours - 232) < 0.5 + 4 * ratio.standard_error * math.sqrt(2)
    less = of(rows, "Xie and Olano 2021, section 6.2.4", "samples of a = 1 less")
    assert abs(less.ours - (20.8 - 22.5)) < 0.1 + 4 * less.standard_error * math.sqrt(2)
    worse = of(rows, "Xie and Olano 2021, section 6.2.4", "rmse of a = 1 over")
    # Both printed with two digits: .0075 / .0073.
    assert 0.00745 / 0.00735 < worse.ours + 4 * worse.standard_error
    assert worse.ours - 4 * worse.standard_error < 0.00755 / 0.00725


@pytest.mark.slow
@pytest.mark.parametrize("light", batch_mean.LIGHTS)
def test_table_b1_by_an_independent_simulation(light, rows):
    for name, (value, deviation) in INDEPENDENT[light].items():
        row = of(rows, "Xie 2021, Table B.1", f"{name}, {light}")
        errors = math.hypot(deviation / math.sqrt(4000), row.standard_error)
        # And half a unit in the independent figure's last digit.
        assert abs(row.ours - value) < 0.5e-5 + 4 * errors, name
        assert row.standard_error == pytest.approx(deviation / math.sqrt(published._TABLE_SEEDS), rel=0.1)
        # 99 % of nearly normal seeds.
        low, high = row.spread
        assert low == pytest.approx(value - 2.58 * deviation, abs=0.4 * deviation)
        assert high == pytest.approx(value + 2.58 * deviation, abs=0.8 * deviation)


@pytest.mark.slow
@pytest.mark.parametrize("light", batch_mean.LIGHTS)
def test_medians_of_table_b1_by_an_independent_simulation(light, rows):
    for name, (median, low, high) in INDEPENDENT_MEDIANS[light].items():
        row = of(rows, "Xie 2021, Table B.1", f"{name}, {light}")
        digits = 0.5e-5 if median < 0.01 else 0.5e-4
        assert abs(row.ours - median) < digits + 4 * row.standard_error * math.sqrt(1 + 1 / 4), name
        # Its 95 % of the seeds are within our 99 %.
        assert row.spread[0] < low and high < row.spread[1]


@pytest.mark.slow
def test_the_table_in_its_order(rows):
    table = [row.quantity for row in rows if row.source == "Xie 2021, Table B.1"]
    assert table == [f"{name}, {light}" for light in batch_mean.LIGHTS for name in batch_mean.NAMES]
