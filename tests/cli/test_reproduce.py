"""`sssfit reproduce`: the table, its JSON, and what a failed bound does."""

import json

import pytest

from sssfit.cli.main import main
from sssfit.estimators import stability


@pytest.fixture
def measured(monkeypatch):
    """Replace the measurement by given rows; what was asked for is kept."""
    asked = []

    def give(*rows):
        def table(cases=None, *, long):
            asked.append(long)
            return iter(rows)

        monkeypatch.setattr(stability, "table", table)
        return asked

    return give


HOLDS = stability.Row("alpha 0.2", "error of the mean", "float32", 1e-6, 1e-7)
FAILS = stability.Row("constant input", "largest variance", "float16", 0.0, 0.25)


def test_a_line_for_each_row_and_a_count(measured, capsys):
    asked = measured(HOLDS, HOLDS._replace(dtype="float64"))
    assert main(["reproduce", "stability"]) == 0
    printed = capsys.readouterr()
    assert printed.out.count("alpha 0.2") == 2 and "2 of 2 bounds hold" in printed.out
    assert printed.err == "" and asked == [10_000_000]


def test_a_failed_bound_is_the_exit_code(measured, capsys):
    measured(HOLDS, FAILS)
    assert main(["reproduce", "stability", "--quick"]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "constant input" in line]
    assert line.split()[-1] == "FAILS" and "0.25" in line


def test_json(measured, capsys):
    asked = measured(HOLDS, FAILS)
    assert main(["reproduce", "stability", "--quick", "--json"]) == 1
    rows = json.loads(capsys.readouterr().out)
    assert rows[0] == {**HOLDS._asdict(), "holds": True} and rows[1]["holds"] is False
    assert asked == [100_000]


def test_what_is_unknown_is_refused(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["reproduce", "everything"])
    assert stop.value.code == 2
    assert "invalid choice: 'everything'" in capsys.readouterr().err


def test_the_help_shows_the_examples(capsys):
    with pytest.raises(SystemExit):
        main(["reproduce", "stability", "--help"])
    assert "sssfit reproduce stability --quick --json" in capsys.readouterr().out
