"""Reading a CSV file row by row, with every fault named by its place."""

import csv
import io
import math
from dataclasses import dataclass

from sssfit.files.errors import FileError


@dataclass(frozen=True)
class Row:
    """One data row: its file and line for messages, its cells by column name, stripped.

    Example:
        >>> Row("a.csv", 2, {"unit": "mm", "x": "1.5"}).number("x")
        1.5
    """

    file: str
    line: int
    cells: dict[str, str]

    def number(self, column: str) -> float:
        """The finite number in a column.

        Raises:
            FileError: the cell is empty, text, infinite or not a number.
        """
        text = self.cells[column]
        try:
            # Python takes 1_000 for a number; a spreadsheet does not.
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.fault(f"column {column!r} has {text!r} where a number belongs", "write a number")
        return value

    def fault(self, problem: str, remedy: str) -> FileError:
        """The error to raise about this row."""
        return FileError(self.file, f"row {self.line}", problem, remedy)


def parse(data: bytes, file: str) -> tuple[list[str], list[Row]]:
    """Column names and data rows of a CSV file with one header line; blank lines are skipped.

    Args:
        data: the file's bytes, UTF-8, with or without a byte order mark.
        file: its name, for messages.

    Raises:
        FileError: not UTF-8, empty, no data rows, a repeated column, or a row with other than one
            cell per column.

    Example:
        >>> columns, rows = parse(b"x,unit\\n1,mm\\n", "a.csv")
        >>> columns, rows[0].line, rows[0].cells
        (['x', 'unit'], 2, {'x': '1', 'unit': 'mm'})
    """
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FileError(file, "", "this is not UTF-8 text", "save it as CSV in UTF-8") from None
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        lines = [(reader.line_num, cells) for cells in reader if any(cell.strip() for cell in cells)]
    except csv.Error as error:
        raise FileError(file, f"row {reader.line_num}", f"this is not CSV ({error})", "mend it") from None
    if not lines:
        raise FileError(file, "", "the file is empty", "write a header line and one row per entry")
    columns = [cell.strip() for cell in lines[0][1]]
    repeated = sorted({c for c in columns if columns.count(c) > 1})
    if repeated:
        raise FileError(file, "row 1", f"column {repeated[0]!r} stands there twice", "keep one of them")
    if len(lines) == 1:
        raise FileError(file, "", "there is a header but no data row", "add one row per entry")
    return columns, [_row(file, line, columns, cells) for line, cells in lines[1:]]


def _row(file: str, line: int, columns: list[str], cells: list[str]) -> Row:
    row = Row(file, line, dict(zip(columns, (cell.strip() for cell in cells), strict=False)))
    if len(cells) != len(columns):
        raise row.fault(f"{len(cells)} cells for {len(columns)} columns", "write one cell per column")
    return row
