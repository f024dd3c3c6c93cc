"""`sssfit reproduce`: its tables, their JSON, and what a row that fails does."""

import json
import sys
from types import SimpleNamespace

import pytest

from sssfit.cli import reproduce
from sssfit.cli.main import main
from sssfit.estimators import stability
from sssfit.reproduction import Row


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


RIGHT = Row("Paper 1, Eq 2", "a root", "1.41", 2**0.5)
WRONG = Row("Paper 1, Eq 3", "a ratio", "0.75", 0.5, differs=True, reason="[the other] side")
DRAWN = Row("Paper 2, Fig 4", "a mean, mm", "-8.53e-4", -8.51e-4, 1.3e-5)
RUN = Row("Paper 2, Fig 5", "one run", "7", 7.4, spread=(6.0, 8.5))
LOST = Row("Paper 2, Table 6", "a total", "12", -0.001, reason="nothing excuses it")


@pytest.fixture
def published(monkeypatch):
    """Replace the topics by two, of given rows; how many rows were asked for is kept."""
    asked = []

    def give(first, second=()):
        def topic(rows):
            def generate():
                for row in rows:
                    asked.append(row)
                    yield row

            return SimpleNamespace(rows=generate)

        monkeypatch.setattr(reproduce, "PUBLISHED", ("first", "second"))
        monkeypatch.setitem(sys.modules, "sssfit.first.published", topic(first))
        monkeypatch.setitem(sys.modules, "sssfit.second.published", topic(second))
        return asked

    return give


def test_printed_numbers_beside_ours(published, capsys):
    asked = published([RIGHT, WRONG], [DRAWN, RUN])
    assert main(["reproduce"]) == 0
    assert asked == [RIGHT, WRONG, DRAWN, RUN]
    printed = capsys.readouterr()
    assert printed.err == ""
    lines = [line for line in printed.out.splitlines() if "Paper" in line]
    # Each row is one line without trailing blanks, ours with two digits more than are printed.
    assert all(line == line.rstrip() for line in printed.out.splitlines())
    cells = [[cell.strip() for cell in line.split("   ") if cell.strip()] for line in lines]
    assert cells == [
        ["Paper 1, Eq 2", "a root", "1.41", "1.4142", "reproduced"],
        ["Paper 1, Eq 3", "a ratio", "0.75", "0.5000", "differs", "[the other] side"],
        ["Paper 2, Fig 4", "a mean, mm", "-8.53e-4", "-0.00085100", "1.3e-05", "reproduced"],
        ["Paper 2, Fig 5", "one run", "7", "7.40", "reproduced"],
    ]
    assert printed.out.splitlines()[-1] == "4 rows: 3 reproduced, 1 differs, 0 FAILS"


def test_a_printed_number_that_fails_is_the_exit_code(published, capsys):
    published([RIGHT, LOST])
    assert main(["reproduce", "--quiet"]) == 1
    printed = capsys.readouterr().out
    (line,) = [line for line in printed.splitlines() if "Table 6" in line]
    assert line.split("   ")[-1].strip() == "nothing excuses it" and " FAILS " in line
    # A tiny negative number is no "-0.00".
    assert " 0.00 " in line and "-0.00" not in line
    assert printed.endswith("2 rows: 1 reproduced, 0 differs, 1 FAILS\n")


def test_numbers_far_below_the_printed_digits_keep_theirs():
    far = RIGHT._replace(printed="3.1e-9", ours=3.1416e-9)
    assert reproduce._cells(far)[3] == "3.1416e-09"
    assert reproduce._cells(far._replace(printed="2e3", ours=2345.6))[3] == "2346"
    assert reproduce._cells(far._replace(printed="0.5", ours=float("nan")))[3] == "nan"


def test_json_of_printed_numbers(published, capsys):
    published([RIGHT, WRONG], [RUN, LOST])
    assert main(["reproduce", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["counts"] == {"reproduced": 2, "differs": 1, "FAILS": 1}
    assert [row["verdict"] for row in found["rows"]] == ["reproduced", "differs", "reproduced", "FAILS"]
    assert found["rows"][2] == {
        "source": "Paper 2, Fig 5",
        "quantity": "one run",
        "printed": "7",
        "ours": 7.4,
        "standard_error": None,
        "spread": [6.0, 8.5],
        "verdict": "reproduced",
        "reason": "",
    }


def test_every_topic_named_has_its_module():
    from importlib.util import find_spec

    assert len(reproduce.PUBLISHED) >= 4
    assert all(find_spec(f"sssfit.{topic}.published") for topic in reproduce.PUBLISHED)


def test_options_may_stand_before_what(measured, capsys):
    asked = measured(HOLDS)
    assert main(["reproduce", "--json", "stability", "--quick"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["holds"] is True and asked == [100_000]


def test_the_help_says_how_long_it_takes(capsys):
    with pytest.raises(SystemExit):
        main(["reproduce", "--help"])
    printed = capsys.readouterr().out
    assert "It takes about a minute" in printed and "sssfit reproduce --json --quiet" in printed
