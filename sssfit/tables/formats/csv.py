"""Tables as text with comma-separated values."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from sssfit.files.json_text import json_line
from sssfit.files.reading import read_text
from sssfit.tables.formats.encoded import Stored, store
from sssfit.tables.formats.metadata import parse_metadata, refusal, stored_shape
from sssfit.tables.formats.naming import column_name, float_text
from sssfit.tables.table import Table

MARK = "# "


def encode(table: Table) -> dict[str, bytes]:
    """Encode a table as CSV: the metadata in a comment, a header, and one row for each entry.

    The columns are the axes, named with their units (``thickness_mm``, ``sigma_t_per_mm``), then
    the channels. A 2-D table is in long form, its second axis fastest. Values are float32 in the
    fewest digits that give them back, "inf" and "nan" too; axis values keep all digits.

    Args:
        table: the table; infinities and NaN are kept.

    Returns:
        File name suffix to content: ``.csv``.

    Raises:
        ValueError: the table cannot be encoded, or holds a finite value beyond float32.

    Example:
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.1]]), "1")
        >>> print(encode(table)[".csv"].decode("utf-8").split("\\n", 1)[1], end="")
        thickness_mm,Y
        0.0,1.0
        1.0,0.1
    """
    stored = store(table, "float")
    stream = io.StringIO()
    stream.write(MARK + json_line(stored.metadata) + "\n")
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_header(stored.metadata))
    rows = stored.values.reshape(-1, len(table.channels))
    for place, row in zip(_places(stored.metadata), rows, strict=True):
        writer.writerow([*map(repr, place.tolist()), *map(float_text, row)])
    return {".csv": stream.getvalue().encode("utf-8")}


def decode(path: Path) -> Stored:
    """Read a table back from CSV.

    Args:
        path: the file.

    Returns:
        The stored numbers and the metadata, whose digests are not compared yet.

    Raises:
        FileError: the file is no CSV file of a table, is truncated, holds something that is not a
            number, or its columns or axis values disagree with its metadata.

    Example:
        >>> decode(Path("no/such/file.csv"))
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.csv: there is no such file; check the path
    """
    first, _, rest = read_text(path).partition("\n")
    comment = first.removeprefix(MARK) if first.startswith(MARK) else None
    metadata = parse_metadata(comment, path, "line 1")
    try:
        lines = list(csv.reader(io.StringIO(rest)))
    except csv.Error as error:
        raise refusal(path, f"is not CSV text ({error})") from error
    header = _header(metadata)
    if not lines or lines[0] != header:
        found = ",".join(lines[0]) if lines else "nothing"
        raise refusal(path, f"columns are {found} but the metadata say {','.join(header)}")
    places = _places(metadata)
    if len(lines) - 1 != len(places):
        raise refusal(path, f"has {len(lines) - 1} rows but the metadata say {len(places)}")
    values = np.empty((len(places), len(metadata["channels"])), dtype="<f4")
    for index, (row, place) in enumerate(zip(lines[1:], places, strict=True)):
        # The metadata and the header are the first two lines.
        numbers = _numbers(row, len(header), path, f"line {index + 3}")
        if numbers[: len(place)] != place.tolist():
            raise refusal(path, "axis values disagree with the metadata", f"line {index + 3}")
        with np.errstate(over="ignore"):
            values[index] = numbers[len(place) :]
    return Stored(metadata, values.reshape(stored_shape(metadata)))


def _header(metadata: dict[str, Any]) -> list[str]:
    """Name the columns."""
    axes = [column_name(axis["name"], axis["unit"]) for axis in metadata["axes"]]
    return [*axes, *metadata["channels"]]


def _places(metadata: dict[str, Any]) -> np.ndarray:
    """Give the axis values of each row, shape (rows, axes)."""
    axes = [np.asarray(axis["values"], dtype=np.float64) for axis in metadata["axes"]]
    grid = np.meshgrid(*axes, indexing="ij")
    return np.stack([values.ravel() for values in grid], axis=-1)


def _numbers(row: list[str], count: int, path: Path, where: str) -> list[float]:
    """Turn the cells of a row into numbers."""
    if len(row) != count:
        raise refusal(path, f"has {len(row)} cells instead of {count}", where)
    try:
        return [float(cell) for cell in row]
    except ValueError as error:
        raise refusal(path, f"holds something that is not a number ({error})", where) from error
