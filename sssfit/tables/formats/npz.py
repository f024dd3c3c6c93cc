"""Tables as NumPy archives."""

import io
from pathlib import Path

import numpy as np

from sssfit.files.arrays import npz_bytes
from sssfit.files.json_text import json_line
from sssfit.files.reading import read_bytes
from sssfit.tables.formats.encoded import Stored, store
from sssfit.tables.formats.metadata import parse_metadata, refusal
from sssfit.tables.table import Table


def encode(table: Table) -> dict[str, bytes]:
    """Encode a table as an uncompressed ``.npz`` archive that loads without pickle.

    The archive holds ``values`` (float32), ``axis_0`` and for a 2-D table ``axis_1`` (float64),
    and ``metadata`` (a string of JSON). Its bytes do not depend on the time of writing.

    Args:
        table: the table; infinities and NaN are kept.

    Returns:
        File name suffix to content: ``.npz``.

    Raises:
        ValueError: the table cannot be encoded, or holds a finite value beyond float32.

    Example:
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.5]]), "1")
        >>> with np.load(io.BytesIO(encode(table)[".npz"])) as archive:
        ...     archive["axis_0"]
        array([0., 1.])
    """
    stored = store(table, "float")
    arrays = {"values": stored.values, "metadata": np.array(json_line(stored.metadata))}
    arrays |= {
        f"axis_{index}": np.asarray(axis["values"], dtype="<f8")
        for index, axis in enumerate(stored.metadata["axes"])
    }
    return {".npz": npz_bytes(arrays)}


def decode(path: Path) -> Stored:
    """Read a table back from a NumPy archive.

    Args:
        path: the file.

    Returns:
        The stored numbers and the metadata, whose digests are not compared yet.

    Raises:
        FileError: the file is no archive of a table, is damaged, or its axes disagree with its
            metadata.

    Example:
        >>> decode(Path("no/such/file.npz"))
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.npz: there is no such file; check the path
    """
    data = read_bytes(path)
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    # zipfile, zlib and numpy each have exceptions of their own for damaged data.
    except Exception as error:
        raise refusal(path, f"is truncated, damaged or no NumPy archive ({error})") from error
    text = arrays.pop("metadata", None)
    metadata = parse_metadata(None if text is None else str(text), path, "array metadata")
    values = arrays.pop("values", None)
    if values is None:
        raise refusal(path, "has no array 'values'")
    expected = {f"axis_{index}": axis["values"] for index, axis in enumerate(metadata["axes"])}
    for name in sorted(expected.keys() | arrays.keys()):
        if not np.array_equal(arrays.get(name, np.nan), expected.get(name, np.nan)):
            raise refusal(path, f"array {name!r} disagrees with the axes in the metadata")
    return Stored(metadata, values)
