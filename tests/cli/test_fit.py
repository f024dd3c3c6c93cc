"""`sssfit fit`: what it prints, its exit codes, and its messages."""

import json

import pytest

from sssfit.cli.main import main


def test_c_as_json(capsys):
    assert main(["fit", "c", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["c"] == pytest.approx(2.5715004252, abs=5e-6)
    assert result["converged"] is True
    assert result["report"]["cdf_rms"] == pytest.approx(5.3831636648e-3, rel=1e-9)


def test_c_as_a_table_names_what_was_minimized(capsys):
    assert main(["fit", "c", "--objective", "mean_radius"]) == 0
    out = capsys.readouterr().out
    assert "2.666666667" in out and "mean_radius" in out and "optimistix: converged" in out


def test_separable_as_json(capsys):
    assert main(["fit", "separable", "--falloff", "0.37", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["domain"] == {"lower": 0.0, "upper": 30.0, "num_points": 64, "spacing": "gauss"}
    (fit,) = result["fits"]
    assert fit["d"] == pytest.approx(0.894085873 * 0.371, rel=1e-6)
    assert fit["identifiability"]["condition_number"] == pytest.approx(2.92, abs=0.01)


def test_separable_table_says_what_is_not_determined(capsys):
    assert main(["fit", "separable", "--falloff", "0.37", "--normalize"]) == 0
    out = capsys.readouterr().out
    assert "falloff 0.37: the data do not determine the albedo, so the dmfp neither" in out


def test_separable_options_reach_the_fit(capsys):
    arguments = ["--reading", "as_coded", "--objective", "ratio", "--domain", "0", "6", "--free-albedo"]
    assert main(["fit", "separable", "--falloff", "0.999", "--quiet", *arguments]) == 0
    albedo, d, dmfp = capsys.readouterr().out.split()
    assert (float(albedo), float(d)) == pytest.approx((1.01, 0.278), rel=2e-3)
    assert dmfp == "nan"


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["fit", "separable", "--falloff", "0"], "sssfit: falloff must be in (0, 1], got 0.0"),
        (["fit", "separable", "--domain", "3", "1"], "sssfit: domain must have 0 <= lower < upper"),
        (["fit", "separable", "--points", "0"], "sssfit: num_points must be from 8 to 65536, got 0"),
    ],
)
def test_bad_values_are_one_sentence_and_exit_code_2(arguments, message, capsys):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(message) and captured.err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [["fit", "c", "--objective", "mse"], ["fit", "c", "--solver", "bfgs"], ["fit"], [], ["fit", "d"]],
)
def test_unknown_words_exit_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert "usage: sssfit" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--help"], ["fit", "c", "--help"], ["fit", "separable", "--help"]])
def test_help_shows_an_example(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    assert "example" in capsys.readouterr().out
