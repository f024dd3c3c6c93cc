"""Rows of printed numbers: what their digits say, and when a row is reproduced, differs or fails."""

import math

import pytest

from sssfit.reproduction import Row


def row(printed, ours, **more):
    return Row("a paper", "a number", printed, ours, **more)


@pytest.mark.parametrize(
    ("printed", "value", "rounding"),
    [
        ("2.5715", 2.5715, 0.5e-4),
        ("1.25 %", 1.25, 0.005),
        (".477", 0.477, 0.5e-3),
        ("-8.53e-4", -8.53e-4, 0.5e-6),
        ("1E6", 1e6, 0.5e6),
        ("40.00", 40.0, 0.005),
        ("100", 100.0, 0.5),
        ("7.", 7.0, 0.5),
        ("x2.75", 2.75, 0.005),
        ("+3", 3.0, 0.5),
    ],
)
def test_digits_say_the_value_and_its_rounding(printed, value, rounding):
    assert row(printed, 0.0).printed_value == value
    assert row(printed, 0.0).rounding == pytest.approx(rounding, rel=1e-12)


def test_text_without_a_number_is_refused():
    with pytest.raises(ValueError, match="printed must hold a number, got 'n/a'"):
        _ = row("n/a", 0.0).verdict


@pytest.mark.parametrize("ours", [2.57145, 2.57155, 2.5715])
def test_a_number_that_rounds_to_the_printed_one_is_reproduced(ours):
    assert row("2.5715", ours).verdict == "reproduced"


@pytest.mark.parametrize("ours", [2.571449, 2.571551, -2.5715])
def test_a_number_that_does_not_fails(ours):
    assert row("2.5715", ours).verdict == "FAILS"


def test_a_known_difference_needs_a_reason():
    assert row("0.75", 0.5, differs=True, reason="halved").verdict == "differs"
    assert row("0.75", 0.5, differs=True).verdict == "FAILS"
    # A reason alone excuses nothing.
    assert row("0.75", 0.5, reason="halved").verdict == "FAILS"


def test_agreement_against_expectation_fails():
    assert row("0.50", 0.5, differs=True, reason="halved").verdict == "FAILS"
    assert row("0.50", 0.5, reason="the second reading").verdict == "reproduced"


@pytest.mark.parametrize("ours", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("differs", [False, True])
def test_no_number_of_ours_fails(ours, differs):
    assert row("0.5", ours, differs=differs, reason="known").verdict == "FAILS"
    assert row("0.5", ours, spread=(0.0, 1.0), differs=differs, reason="known").verdict == "FAILS"


def test_four_standard_errors_beyond_the_rounding_are_chance():
    # Half of a printed unit, and four times 0.01.
    assert row("0.50", 0.544, standard_error=0.01).verdict == "reproduced"
    assert row("0.50", 0.546, standard_error=0.01).verdict == "FAILS"
    assert row("0.50", 0.546, standard_error=0.01, differs=True, reason="no chance").verdict == "differs"


def test_one_printed_run_lies_in_the_spread_of_ours():
    # The mean of ours then says nothing.
    assert row("0.50", 9.0, spread=(0.4, 0.6)).verdict == "reproduced"
    assert row("0.50", 9.0, spread=(0.504, 0.6)).verdict == "reproduced"
    assert row("0.50", 0.5, spread=(0.506, 0.6)).verdict == "FAILS"
    assert row("0.50", 0.5, spread=(0.3, 0.494)).verdict == "FAILS"
    assert row("0.50", 0.5, spread=(0.506, 0.6), differs=True, reason="an outlier").verdict == "differs"
