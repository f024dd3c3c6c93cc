"""The metadata in a table file: reading it back, and refusing what disagrees with it."""

from typing import Any

import numpy as np

from sssfit.files.errors import FileError
from sssfit.files.json_text import json_line, parse_json, sha256_bytes

FORMAT = "sssfit table"
FORMAT_VERSION = 1
STORED_TYPES = {"half": "<f2", "float": "<f4", "8-bit": "|u1"}
REMEDY = "restore the file or write the table again"
METADATA_TYPES = {
    "axes": list,
    "channels": list,
    "content_sha256": str,
    "description": str,
    "dtype": str,
    "metadata_sha256": str,
    "name": str,
    "parameters": dict,
    "quantization": dict,
    "unit": str,
    "versions": dict,
}


def refusal(path: object, problem: str, where: str = "") -> FileError:
    """Make the exception for a table file that cannot be trusted.

    Args:
        path: the file.
        problem: what is wrong or disagrees.
        where: the place in the file; "" when it is the whole file.

    Returns:
        The exception, for the caller to raise.

    Example:
        >>> print(refusal("t.csv", "is truncated"))
        t.csv: is truncated; restore the file or write the table again
    """
    return FileError(path, where, problem, REMEDY)


def content_digest(values: np.ndarray) -> str:
    """Give the SHA-256 digest of stored numbers: little-endian bytes, last dimension fastest.

    Args:
        values: the stored numbers.

    Returns:
        64 hexadecimal digits.

    Example:
        >>> content_digest(np.array([1.0], dtype="<f4")) == content_digest(np.array([1.0], ">f4"))
        True
    """
    return sha256_bytes(values.astype(values.dtype.newbyteorder("<")).tobytes())


def metadata_digest(metadata: dict[str, Any]) -> str:
    """Give the SHA-256 digest of metadata, as one line of JSON without ``metadata_sha256``.

    Args:
        metadata: the metadata, with or without its digest.

    Returns:
        64 hexadecimal digits.

    Example:
        >>> metadata_digest({"a": 1, "metadata_sha256": "?"}) == metadata_digest({"a": 1})
        True
    """
    rest = {key: value for key, value in metadata.items() if key != "metadata_sha256"}
    return sha256_bytes(json_line(rest).encode("utf-8"))


def stored_shape(metadata: dict[str, Any]) -> tuple[int, ...]:
    """Give the shape of the stored numbers that metadata announce.

    Args:
        metadata: metadata that `parse_metadata` accepted.

    Returns:
        The axis sizes, slowest first, and the number of channels.

    Example:
        >>> stored_shape({"axes": [{"size": 5}, {"size": 4}], "channels": ["R", "G", "B"]})
        (5, 4, 3)
    """
    return (*(axis["size"] for axis in metadata["axes"]), len(metadata["channels"]))


def parse_metadata(text: str | None, path: object, where: str = "metadata") -> dict[str, Any]:
    """Read the metadata of a table file, and refuse what was not written by this package.

    Args:
        text: the JSON text; None where the file holds none.
        path: the file, for messages.
        where: the place in the file, for messages.

    Returns:
        The metadata, with all entries that a table needs.

    Raises:
        FileError: there is none, it is not JSON, has another version, lacks an entry, or was
            edited.

    Example:
        >>> parse_metadata(None, "t.csv")
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: t.csv: has no sssfit metadata; load a table that sssfit wrote
    """
    if text is None:
        raise FileError(path, "", "has no sssfit metadata", "load a table that sssfit wrote")
    metadata = parse_json(text, path, where)
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        raise FileError(path, where, f"is not of a {FORMAT}", "load a table that sssfit wrote")
    if metadata.get("format_version") != FORMAT_VERSION:
        found = metadata.get("format_version")
        problem = f"format version {found!r} is not known, only {FORMAT_VERSION}"
        raise FileError(path, where, problem, "load it with the version of sssfit that wrote it")
    problem = _missing_entry(metadata) or _axes_problem(metadata["axes"])
    if not problem and metadata["dtype"] not in STORED_TYPES:
        problem = f"dtype {metadata['dtype']!r} is not one of {', '.join(STORED_TYPES)}"
    if not problem and metadata_digest(metadata) != metadata["metadata_sha256"]:
        problem = "was edited: it disagrees with its own metadata_sha256"
    if problem:
        raise refusal(path, problem, where)
    return metadata


def check_content(path: object, metadata: dict[str, Any], values: np.ndarray) -> None:
    """Refuse stored numbers that are not those the metadata were written for.

    Args:
        path: the file, for messages.
        metadata: its metadata.
        values: the stored numbers that the file holds.

    Raises:
        FileError: their type, their shape or their digest disagrees with the metadata.

    Example:
        >>> metadata = {"dtype": "half", "axes": [{"size": 3}], "channels": ["Y"]}
        >>> check_content("t.exr", metadata, np.zeros((2, 1), dtype=np.float16))
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: t.exr: values have shape (2, 1) but the metadata say \
(3, 1); restore the file or write the table again
    """
    if values.dtype != np.dtype(STORED_TYPES[metadata["dtype"]]):
        raise refusal(path, f"values are {values.dtype} but the metadata say {metadata['dtype']!r}")
    if values.shape != stored_shape(metadata):
        raise refusal(path, f"values have shape {values.shape} but the metadata say {stored_shape(metadata)}")
    if content_digest(values) != metadata["content_sha256"]:
        raise refusal(path, "values were changed: they disagree with the content_sha256")


def _missing_entry(metadata: dict[str, Any]) -> str:
    """Name the first entry that is missing or of another type; "" when there is none."""
    for key, kind in METADATA_TYPES.items():
        if not isinstance(metadata.get(key), kind):
            return f"entry {key!r} is missing or is no {kind.__name__}"
    if not all(isinstance(channel, str) for channel in metadata["channels"]):
        return "a channel has no name"
    return ""


def _axes_problem(axes: list[Any]) -> str:
    """Say what is wrong with the axes; "" when nothing is."""
    for axis in axes:
        if not isinstance(axis, dict) or not isinstance(axis.get("name"), str):
            return "an axis has no name"
        if not isinstance(axis.get("unit"), str):
            return f"axis {axis['name']!r} has no unit"
        try:
            values = np.asarray(axis.get("values"), dtype=np.float64)
        except (TypeError, ValueError):
            return f"axis {axis['name']!r} has values that are no numbers"
        if values.shape != (axis.get("size"),):
            return f"axis {axis['name']!r} holds {values.size} values but its size is {axis.get('size')!r}"
    return "" if 1 <= len(axes) <= 2 else f"a table has one or two axes, not {len(axes)}"
