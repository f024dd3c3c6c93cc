"""Measured curves from CSV files, with every fault named by its file, row and remedy.

A file has a row for each distance and a header: r_mm; R, or R_r, R_g, R_b; and, where the noise is known,
sigma for all curves, or sigma_r, sigma_g, sigma_b. `measurement_image` makes the same of photographs.
"""

import os
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sssfit.files import csv_rows
from sssfit.files.csv_rows import Row
from sssfit.files.errors import FileError
from sssfit.files.reading import read_bytes
from sssfit.fitting import _curve_data
from sssfit.fitting.responses import Response

CHANNELS = ("r", "g", "b")

_COLUMNS = "r_mm, R or R_r, R_g, R_b, and sigma or sigma_r, sigma_g, sigma_b if the noise is known"
# What people call a distance: without a unit, or with another one than ours.
_DISTANCE = re.compile(r"(r|x|[Rr]adius|[Dd]istance)(_?(nm|um|mm|cm|m|in|px|pixels?))?")


class Measurement(NamedTuple):
    """What `measured.fit` takes.

    Attributes:
        r: distances, mm, strictly ascending, shape (m,).
        values: one curve in each column, shape (m, channels).
        sigma: standard deviations of the values, shape (m, channels), or None.
        channels: names of the curves, ("",) or ("r", "g", "b").
        notes: what was done to the data, a sentence each.
    """

    r: np.ndarray
    values: np.ndarray
    sigma: np.ndarray | None
    channels: tuple[str, ...]
    notes: tuple[str, ...] = ()


def load(path: str | os.PathLike[str], *, response: Response = "radial") -> Measurement:
    """Read curves from a CSV file.

    Args:
        path: the file.
        response: what it shows; only a line and an edge have distances below 0.

    Returns:
        The curves, in float64.

    Raises:
        FileError: names file, row and remedy for a distance without its unit or in another one; a missing,
            unknown or superfluous column; text where a number belongs; distances that do not ascend, or
            below 0 where there are none; a standard deviation that is not above 0; a curve that is nowhere
            above 0, or below it without a sigma to explain that; an edge whose lit side is not below 0.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "wax.csv"
        ...     _ = path.write_text("r_mm,R,sigma\\n0.5,0.2,0.01\\n1,0.05,0.01\\n")
        ...     load(path).r
        array([0.5, 1. ])
    """
    return parse(read_bytes(path), Path(path).name, response=response)


def parse(data: bytes, file: str, *, response: Response = "radial") -> Measurement:
    """Curves from the bytes of a CSV file; `load` for a file already read.

    Args:
        data: the file's bytes.
        file: its name, for messages.
        response: as `load`.

    Raises:
        FileError: as `load`.

    Example:
        >>> parse(b"r_mm,R_r,R_g,R_b\\n1,0.3,0.2,0.1\\n", "wax.csv").values
        array([[0.3, 0.2, 0.1]])
    """
    columns, rows = csv_rows.parse(data, file)
    channels, noise = _columns(columns, file)
    r = np.array([row.number("r_mm") for row in rows])
    _check_distances(r, rows, response)
    values = np.array([[row.number(_name("R", c)) for c in channels] for row in rows])
    sigma = None
    if noise:
        sigma = np.array([[_deviation(row, name) for name in noise] for row in rows])
        sigma = np.broadcast_to(sigma, values.shape).copy()
    _check_values(values, sigma, rows, [_name("R", c) for c in channels], file)
    found = Measurement(r, values, sigma, channels)
    if is_turned(found, response):
        problem = "R is larger at distances above 0, but an edge's light lies below 0"
        raise FileError(file, "column 'r_mm'", problem, "change the signs of all distances")
    return found


def is_turned(measurement: Measurement, response: Response) -> bool:
    """Whether what is called an edge has its lit side above 0, where the shadow should be.

    Args:
        measurement: the curves.
        response: what they show; False for all but an edge.

    Example:
        >>> x = np.array([-1.0, 1.0])
        >>> is_turned(Measurement(x, np.array([[0.1], [0.9]]), None, ("",)), "edge")
        True
    """
    below, above = measurement.r < 0, measurement.r > 0
    if response != "edge" or not (below.any() and above.any()):
        return False
    return bool(measurement.values[above].mean() > measurement.values[below].mean())


def _columns(columns: list[str], file: str) -> tuple[tuple[str, ...], list[str]]:
    """The curves' names, and the columns of their standard deviations."""

    def fault(problem: str, remedy: str = f"the columns are {_COLUMNS}") -> FileError:
        return FileError(file, "row 1", problem, remedy)

    if "r_mm" not in columns:
        distances = [found for column in columns if (found := _DISTANCE.fullmatch(column))]
        if not distances:
            only = len(columns) == 1 and any(mark in columns[0] for mark in ";\t")
            raise fault("there is no column 'r_mm'", *["put commas between columns"] * only)
        unit = "in another unit than mm" if distances[0][3] else "without a unit"
        remedy = "name it 'r_mm' and write millimetres"
        raise fault(f"column {distances[0][0]!r} is a distance {unit}", remedy)
    of_three = [_name("R", c) for c in CHANNELS]
    channels = CHANNELS if any(name in columns for name in of_three) else ("",)
    missing = [_name("R", c) for c in channels if _name("R", c) not in columns]
    if missing:
        raise fault(f"there is no column {missing[0]!r}")
    noise = [name for name in ("sigma", *(f"sigma_{c}" for c in CHANNELS)) if name in columns]
    known = ["r_mm", *(_name("R", c) for c in channels), *noise]
    unknown = [column for column in columns if column not in known]
    if unknown:
        raise fault(f"column {unknown[0]!r} is not known beside {known[1]!r}")
    if noise not in ([], ["sigma"], [_name("sigma", c) for c in channels]):
        wanted = "'sigma'" if channels == ("",) else "'sigma', or 'sigma_r', 'sigma_g' and 'sigma_b'"
        raise fault(f"column {noise[-1]!r} does not go with {known[1]!r}", f"call what goes with it {wanted}")
    return channels, noise


def _name(what: str, channel: str) -> str:
    return f"{what}_{channel}" if channel else what


def _check_distances(r: np.ndarray, rows: list[Row], response: Response) -> None:
    for row, distance, before in zip(rows[1:], r[1:], r[:-1], strict=True):
        if distance == before:
            raise row.fault(f"r_mm {distance:g} stands there twice", "keep one row for each distance")
        if distance < before:
            raise row.fault(f"r_mm {distance:g} follows {before:g}", "sort the rows by their distance")
    if response in ("radial", "beam") and r[0] < 0:
        where = "a point" if response == "radial" else "a beam's centre"
        raise rows[0].fault(f"r_mm is {r[0]:g}", f"a distance from {where} is at least 0")


def _deviation(row: Row, column: str) -> float:
    value = row.number(column)
    if value <= 0:
        remedy = "write a standard deviation above 0, or leave the column out if the noise is not known"
        raise row.fault(f"{column} is {value:g}", remedy)
    return value


def _check_values(
    values: np.ndarray, sigma: np.ndarray | None, rows: list[Row], names: list[str], file: str
) -> None:
    for name, curve in zip(names, values.T, strict=True):
        if not np.any(curve > 0):
            raise FileError(file, f"column {name!r}", "no value is above 0", "write what was measured there")
    below = np.argwhere(values < (0 if sigma is None else -_curve_data.FAR_BELOW * sigma))
    if len(below):
        place, curve = below[0]
        problem = f"{names[curve]} is {values[place, curve]:g}, below 0"
        by_noise = "give its sigma if that is noise" if sigma is None else "by more than noise"
        if sigma is None:
            raise rows[place].fault(problem, by_noise)
        raise rows[place].fault(f"{problem} {by_noise}", "subtract less darkness, or state more noise")
