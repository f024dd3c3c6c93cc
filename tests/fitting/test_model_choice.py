"""Which profile suits a curve: planted ones win, folds are those of a loop by hand, refusals."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from sssfit.fitting import measured, model_choice

POINTS = 48
R = np.geomspace(0.1, 20, POINTS)


def burley(r, albedo, d):
    return albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r)


def noisy(seed=2):
    clean = burley(R, 0.7, 1.5)
    return clean * (1 + 0.05 * np.random.default_rng(seed).normal(size=POINTS)), 0.05 * clean


def by_hand(values, roots, folds):
    """Sum of squares that the points of each fold miss of SciPy's fit to the others."""
    total = 0.0
    for fold in range(folds):
        out = np.arange(POINTS) % folds == fold
        kept = np.where(out, 0, roots)
        found = least_squares(
            lambda p: kept * (burley(R, *p) - values),  # noqa: B023
            (0.5, 1.0),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        total += np.sum(np.square(roots * (values - burley(R, *found.x)))[out])
    return total


@pytest.fixture(scope="module")
def compared():
    values, sigma = noisy()
    return model_choice.compare(R, values, ["gaussians:1", "burley"], folds=4, sigma=sigma)


def test_the_planted_model_wins_by_both_measures(compared):
    assert compared[0].fit.model == "burley" and compared[0].aicc == 0
    assert [c.aicc for c in compared] == sorted(c.aicc for c in compared)
    assert all(candidate.aicc > 10 for candidate in compared[1:])
    assert min(compared, key=lambda candidate: candidate.cross_validation).fit.model == "burley"
    # A point misses by its own noise, and by the fit's: a root mean square of 48 squares, and 2 parameters.
    assert compared[0].cross_validation == pytest.approx(1, abs=4 / np.sqrt(2 * POINTS))


def test_differences_are_akaikes(compared):
    least = compared[0].fit
    for candidate in compared:
        assert candidate.aicc == pytest.approx(candidate.fit.aicc - least.aicc, rel=1e-12)
        # All three have two parameters and the same noise: what differs is chi2.
        assert candidate.aicc == pytest.approx(candidate.fit.chi2 - least.chi2, rel=1e-9)


def test_folds_are_those_of_a_loop_by_hand(compared):
    values, sigma = noisy()
    expected = np.sqrt(by_hand(values, 1 / sigma, 4) / POINTS)
    assert compared[0].cross_validation == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("folds", [2, POINTS])
def test_any_number_of_folds_without_sigma(folds):
    values, _ = noisy()
    (found,) = model_choice.compare(R, values, ["burley"], folds=folds, weights="relative")
    expected = np.sqrt(by_hand(values, 1 / values, folds) / POINTS)
    assert found.cross_validation == pytest.approx(expected, rel=1e-6)
    assert found.aicc == 0


def test_misses_are_in_units_of_the_noise_whatever_the_weights():
    values, sigma = noisy()
    (found,) = model_choice.compare(R, values, ["burley"], folds=4, sigma=sigma, weights="relative")
    # Relative weights are nearly those of this noise.
    assert found.cross_validation == pytest.approx(1, abs=4 / np.sqrt(2 * POINTS))


def test_models_are_compared_on_the_same_points():
    values, sigma = noisy()
    r, values, sigma = np.append(0, R), np.append(9.0, values), np.append(1.0, sigma)
    found = model_choice.compare(r, values, ["gaussians:1", "burley"], folds=4, sigma=sigma)
    assert {len(candidate.fit.r) for candidate in found} == {POINTS}
    assert {candidate.fit.notes[0][:18] for candidate in found} == {"the point at r = 0"}


def test_a_point_at_0_is_in_no_fold():
    values, sigma = noisy()
    r, values, sigma = np.append(0, R), np.append(9.0, values), np.append(1.0, sigma)
    (found,) = model_choice.compare(r, values, ["burley"], folds=4, sigma=sigma)
    expected = np.sqrt(by_hand(values[1:], 1 / sigma[1:], 4) / POINTS)
    assert found.cross_validation == pytest.approx(expected, rel=1e-6)


def test_options_are_the_fits():
    values, sigma = noisy()
    (found,) = model_choice.compare(R, values, ["burley"], folds=2, sigma=sigma, weights="area")
    expected = measured.fit(R, values, sigma=sigma, weights="area")
    assert found.fit.parameters["d"] == expected.parameters["d"]


@pytest.mark.slow
def test_too_few_points_for_the_criterion_come_last():
    r = R[4:40:8]
    values = burley(r, 0.7, 1.5)
    found = model_choice.compare(r, values, ["gaussians:2", "burley"], folds=5, sigma=0.05 * values)
    assert [candidate.fit.model for candidate in found] == ["burley", "gaussians:2"]
    assert found[1].aicc == np.inf and np.isnan(found[1].fit.aicc)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"models": []}, r"models must be names, each once, got \[\]"),
        ({"models": ["burley", "burley"]}, "models must be names, each once"),
        ({"models": ["lambert"]}, "model must be one of"),
        ({"folds": 1}, "folds must be from 2 to the number of points, 48, got 1"),
        ({"folds": 49}, "folds must be from 2 to the number of points, 48, got 49"),
        ({"sigma": -1.0}, "sigma must be above 0"),
        ({"response": "beam"}, "beam_radius must be"),
    ],
)
def test_refusals(arguments, message):
    values, _ = noisy()
    with pytest.raises(ValueError, match=message):
        model_choice.compare(**({"r": R, "values": values, "models": ["burley"]} | arguments))


def test_an_unknown_option_is_refused():
    values, _ = noisy()
    with pytest.raises(TypeError, match="colour"):
        model_choice.compare(R, values, ["burley"], colour="red")
