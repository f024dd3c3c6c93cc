"""What all table formats share: a table rounded to stored numbers, with its metadata.

A stored table is an array of little-endian numbers, and metadata that says what they are, how far
they are from the float64 values, and what their SHA-256 digest is. Each format is a way to put
the two into a file.
"""

import re
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from sssfit.tables.formats.metadata import (
    FORMAT,
    FORMAT_VERSION,
    STORED_TYPES,
    content_digest,
    metadata_digest,
)
from sssfit.tables.formats.naming import column_name
from sssfit.tables.table import Table

LARGEST_HALF = float(np.finfo(np.float16).max)
LARGEST_FLOAT = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Stored:
    """A table as a file holds it.

    Attributes:
        metadata: what `describe` gave when the file was written.
        values: the stored numbers, in the shape of the table's values.

    Example:
        >>> Stored({"name": "t"}, np.zeros((2, 1), dtype=np.float32)).values.shape
        (2, 1)
    """

    metadata: dict[str, Any]
    values: np.ndarray


def store(table: Table, dtype: str) -> Stored:
    """Round a table to stored numbers and describe the result.

    Args:
        table: the table; its values may be infinite or NaN.
        dtype: "half", "float" or "8-bit".

    Returns:
        The stored numbers with their metadata.

    Raises:
        ValueError: as `quantize` and `check_encodable`.

    Example:
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.1]]), "1")
        >>> stored = store(table, "half")
        >>> stored.values.ravel(), stored.metadata["quantization"]["max_abs_error"] < 1e-4
        (array([1. , 0.1], dtype=float16), True)
    """
    check_encodable(table)
    values = quantize(table, dtype)
    return Stored(describe(table, values, dtype), values)


def check_encodable(table: Table) -> None:
    """Refuse a table that no file format can hold.

    Args:
        table: the table.

    Raises:
        ValueError: the name is no plain file name, there are not one or two axes and one to four
            channels with distinct names, or an axis is empty or not finite.

    Example:
        >>> check_encodable(Table("a/b", "", (), ("Y",), np.zeros((1,)), "1"))
        Traceback (most recent call last):
        ...
        ValueError: table name 'a/b' must consist of letters, digits, '_', '-', '+', '.' and ' '
    """
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_ .+-]*", table.name):
        raise ValueError(
            f"table name {table.name!r} must consist of letters, digits, '_', '-', '+', '.' and ' '"
        )
    columns = [column_name(axis.name, axis.unit) for axis in table.axes]
    for names, most, what in ((columns, 2, "axes"), (list(table.channels), 4, "channels")):
        if not 1 <= len(names) <= most or len(set(names)) < len(names) or not all(names):
            raise ValueError(
                f"table {table.name!r} must have 1 to {most} {what} with distinct names, got {names}"
            )
    for axis in table.axes:
        if len(axis.values) == 0 or not np.all(np.isfinite(axis.values)):
            raise ValueError(
                f"axis {axis.name!r} of table {table.name!r} must hold at least one value and "
                "finite values only"
            )


def quantize(table: Table, dtype: str) -> np.ndarray:
    """Round a table's values to the numbers that a file stores.

    Half and float round to nearest; every NaN becomes the same NaN. "8-bit" maps the range of the
    finite values linearly to 0...255; NaN and minus infinity become 0, infinity becomes 255.

    Args:
        table: the table.
        dtype: "half", "float" or "8-bit".

    Returns:
        float16, float32 or uint8 values (little-endian) in the shape of the table's values.

    Raises:
        ValueError: a finite value is beyond the largest number of the type (half: 65504).

    Example:
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("radius", "mm", np.array([0.0, 1.0, 2.0]))
        >>> values = np.array([[np.inf], [3.0], [1.0]])
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), values, "1")
        >>> quantize(table, "half").ravel(), quantize(table, "8-bit").ravel()
        (array([inf,  3.,  1.], dtype=float16), array([255, 255,   0], dtype=uint8))
    """
    exact = np.asarray(table.values, dtype=np.float64)
    _check_range(table, exact, dtype)
    if dtype == "8-bit":
        low, high = finite_range(exact)
        span = high - low if high > low else 1.0
        scaled = (np.nan_to_num(exact, nan=low, posinf=high, neginf=low) - low) / span
        return np.rint(255.0 * scaled).astype(np.uint8)
    stored = exact.astype(STORED_TYPES[dtype])
    # A NaN has many bit patterns, and text keeps none of them.
    stored[np.isnan(stored)] = np.nan
    return stored


def restore(values: np.ndarray, metadata: dict[str, Any]) -> np.ndarray:
    """Turn stored numbers into float64 values: the inverse of `quantize`, up to its rounding.

    Args:
        values: the stored numbers.
        metadata: their metadata.

    Returns:
        float64 values in the same shape.

    Example:
        >>> mapping = {"quantization": {"minimum": 1.0, "maximum": 2.0}, "dtype": "8-bit"}
        >>> restore(np.array([0, 255], dtype=np.uint8), mapping)
        array([1., 2.])
    """
    values = values.astype(np.float64)
    if metadata["dtype"] == "8-bit":
        low, high = (float(metadata["quantization"][key]) for key in ("minimum", "maximum"))
        part = values / 255.0
        # In this form both ends of the range come back exactly.
        return low * (1.0 - part) + high * part
    return values


def describe(table: Table, values: np.ndarray, dtype: str) -> dict[str, Any]:
    """Give the metadata of a stored table.

    Args:
        table: the table before rounding.
        values: what `quantize` made of it.
        dtype: "half", "float" or "8-bit".

    Returns:
        JSON-compatible metadata. ``quantization`` holds the largest absolute and relative errors
        measured over the finite values (relative: over those that are not zero), 0.0 when there
        are none; for "8-bit" also the mapping, and the number of entries that are not finite.
        ``content_sha256`` is the digest of the stored bytes (little-endian, last dimension
        fastest), ``metadata_sha256`` that of the other metadata on one line.

    Example:
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[0.5]]), "1")
        >>> describe(table, quantize(table, "half"), "half")["quantization"]
        {'max_abs_error': 0.0, 'max_rel_error': 0.0}
    """
    exact = np.asarray(table.values, dtype=np.float64)
    metadata: dict[str, Any] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "name": table.name,
        "description": table.description,
        "unit": table.unit,
        "axes": [
            {
                "name": axis.name,
                "unit": axis.unit,
                "size": len(axis.values),
                "values": np.asarray(axis.values, dtype=np.float64).tolist(),
            }
            for axis in table.axes
        ],
        "channels": list(table.channels),
        "dtype": dtype,
        "parameters": table.parameters,
        "versions": {name: version(name) for name in ("sssfit", "jax", "numpy")},
        "quantization": {},
        "content_sha256": content_digest(values),
    }
    if dtype == "8-bit":
        low, high = finite_range(exact)
        lost = int(np.count_nonzero(~np.isfinite(exact)))
        metadata["quantization"] = {"minimum": low, "maximum": high, "non_finite_entries": lost}
    metadata["quantization"] |= measured_error(exact, restore(values, metadata))
    return metadata | {"metadata_sha256": metadata_digest(metadata)}


def measured_error(exact: np.ndarray, stored: np.ndarray) -> dict[str, float]:
    """Measure how far stored values are from exact ones, over the finite exact values.

    Args:
        exact: float64 values.
        stored: float64 values of what a file holds, in the same shape.

    Returns:
        ``max_abs_error`` in the unit of the values, and ``max_rel_error`` over the values that
        are not zero; 0.0 where there is no such value, infinite where the quotient overflows.

    Example:
        >>> measured_error(np.array([2.0, np.inf]), np.array([2.5, np.inf]))
        {'max_abs_error': 0.5, 'max_rel_error': 0.25}
    """
    finite = np.isfinite(exact)
    exact, stored = exact[finite], stored[finite]
    errors = np.abs(stored - exact)
    relevant = exact != 0.0
    with np.errstate(over="ignore"):
        relative = errors[relevant] / np.abs(exact[relevant])
    return {
        "max_abs_error": float(errors.max(initial=0.0)),
        "max_rel_error": float(relative.max(initial=0.0)),
    }


def finite_range(values: np.ndarray) -> tuple[float, float]:
    """Give the least and the greatest finite value.

    Args:
        values: any values.

    Returns:
        Both, equal when there is one; (0.0, 0.0) when no value is finite.

    Example:
        >>> finite_range(np.array([np.nan, 2.0, 1.0, np.inf]))
        (1.0, 2.0)
    """
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def _check_range(table: Table, exact: np.ndarray, dtype: str) -> None:
    """Refuse finite values that rounding would turn into infinity."""
    kind, largest = ("half", LARGEST_HALF) if dtype == "half" else ("float", LARGEST_FLOAT)
    sizes = np.where(np.isfinite(exact), np.abs(exact), 0.0)
    if sizes.max(initial=0.0) > largest:
        worst = float(exact.flat[np.argmax(sizes)])
        remedy = "scale its values" + (", or write it as exr, npz or csv" if kind == "half" else "")
        raise ValueError(
            f"table {table.name!r} holds {worst!r}, beyond the largest {kind} number {largest!r}; {remedy}"
        )
