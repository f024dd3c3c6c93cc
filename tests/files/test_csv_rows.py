"""CSV files row by row, and the place named in every fault."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files import csv_rows
from sssfit.files.errors import FileError

names = st.text("abcdefghij_", min_size=1, max_size=8)
cells = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)


def quoted(text):
    return '"' + text.replace('"', '""') + '"'


@given(st.data(), st.lists(names, min_size=1, max_size=5, unique=True), st.integers(1, 4))
def test_what_was_written_is_read(data, columns, num_rows):
    # A row of blanks is no row, so the first cell is never blank.
    content = [
        [data.draw(cells.filter(str.strip)), *(data.draw(cells) for _ in columns[1:])]
        for _ in range(num_rows)
    ]
    text = "\r\n".join(",".join(map(quoted, line)) for line in [columns, *content])
    read_columns, rows = csv_rows.parse(text.encode(), "a.csv")
    assert read_columns == columns
    assert [row.line for row in rows] == list(range(2, num_rows + 2))
    for row, line in zip(rows, content, strict=True):
        assert row.cells == dict(zip(columns, (cell.strip() for cell in line), strict=True))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_come_back_to_the_bit(value):
    row = csv_rows.Row("a.csv", 2, {"x": repr(value)})
    assert row.number("x") == value


@pytest.mark.parametrize(
    "text, value", [("1", 1), ("+1.50", 1.5), (".5", 0.5), ("5.", 5), ("1E-3", 0.001), ("-0", 0)]
)
def test_ways_to_write_a_number(text, value):
    assert csv_rows.Row("a.csv", 2, {"x": text}).number("x") == value


@pytest.mark.parametrize(
    "text", ["", "one", "1,5", "1 000", "1_000", "0x10", "nan", "NaN", "inf", "-Infinity", "1e999"]
)
def test_text_that_is_no_finite_number(text):
    with pytest.raises(FileError) as caught:
        csv_rows.Row("a.csv", 7, {"x": text}).number("x")
    assert (
        str(caught.value) == f"a.csv, row 7: column 'x' has {text!r} where a number belongs; write a number"
    )


def test_the_fault_of_a_row_names_its_place():
    fault = csv_rows.Row("a.csv", 12, {}).fault("the wax is soft", "cool it")
    assert isinstance(fault, FileError)
    assert str(fault) == "a.csv, row 12: the wax is soft; cool it"


@pytest.mark.parametrize(
    "data, message",
    [
        (b"", "a.csv: the file is empty; write a header line and one row per entry"),
        (b"\xef\xbb\xbf", "a.csv: the file is empty; write a header line and one row per entry"),
        (b"\n ,\n\n", "a.csv: the file is empty; write a header line and one row per entry"),
        (b"x,y\n\n", "a.csv: there is a header but no data row; add one row per entry"),
        (b"x,x\n1,2", "a.csv, row 1: column 'x' stands there twice; keep one of them"),
        (b"x,y\n1", "a.csv, row 2: 1 cells for 2 columns; write one cell per column"),
        (b"x,y\n1,2\n\n1,2,3", "a.csv, row 4: 3 cells for 2 columns; write one cell per column"),
        (b"x\n\xff", "a.csv: this is not UTF-8 text; save it as CSV in UTF-8"),
        (b'x,y\n1,"2', "a.csv, row 2: this is not CSV (unexpected end of data); mend it"),
        (b'x,y\n1,"2"3\n', "a.csv, row 2: this is not CSV (',' expected after '\"'); mend it"),
    ],
)
def test_files_that_are_refused(data, message):
    with pytest.raises(FileError) as caught:
        csv_rows.parse(data, "a.csv")
    assert str(caught.value) == message


def test_lines_within_quotes_are_one_row_and_counted():
    columns, rows = csv_rows.parse(b'x,y\n"one\ntwo",2\n3,4\n', "a.csv")
    assert columns == ["x", "y"]
    assert [(row.line, row.cells["x"]) for row in rows] == [(3, "one\ntwo"), (4, "3")]


@given(st.binary(max_size=80))
def test_any_bytes_are_read_or_refused(data):
    try:
        columns, rows = csv_rows.parse(data, "a.csv")
    except FileError:
        return
    assert rows and all(list(row.cells) == columns for row in rows)
