"""Tables from files, only when the file holds what was written."""

import os
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sssfit.files.errors import FileError
from sssfit.tables.formats import DECODERS
from sssfit.tables.formats.encoded import Stored, restore
from sssfit.tables.formats.metadata import check_content, refusal
from sssfit.tables.table import Axis, Table


@dataclass(frozen=True)
class LoadedTable(Table):
    """A table read from a file: its values are those stored there, in float64.

    Attributes:
        metadata: all that the file says about the table.

    Example:
        >>> axis = Axis("thickness", "mm", np.array([0.0]))
        >>> metadata = {"quantization": {"max_abs_error": 0.25}}
        >>> values = np.array([[0.5]])
        >>> LoadedTable("t", "", (axis,), ("Y",), values, "1", {}, metadata).quantization
        {'max_abs_error': 0.25}
    """

    metadata: dict[str, Any] = field(default_factory=dict)

    @property
    def quantization(self) -> dict[str, float]:
        """Largest absolute (in ``unit``) and relative errors made by storing the values."""
        return {key: float(value) for key, value in self.metadata["quantization"].items()}


def load(path: str | os.PathLike[str]) -> LoadedTable:
    """Read a table from a file of any format that sssfit writes, chosen by the file's suffix.

    Args:
        path: a ``.exr``, ``.dds`` (its ``.dds.json`` beside it), ``.npz``, ``.csv``, ``.hlsl``,
            ``.glsl`` or ``.preview.png`` file.

    Returns:
        The table with the stored values in float64, its axes and parameters, and the metadata with
        the ``quantization`` error. Parameters that were infinite or NaN are strings, "inf".

    Raises:
        FileError: there is no such file, its suffix is not known, it has no metadata, is truncated
            or damaged, or its content disagrees with its metadata, if in a single value.

    Example:
        >>> load("no/such/file.csv")
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.csv: there is no such file; check the path
    """
    path = Path(path)
    decode = DECODERS.get(path.suffix.lower())
    if decode is None:
        problem = f"suffix {path.suffix!r} is not one of a table"
        raise FileError(path, "", problem, f"use a file with one of {', '.join(DECODERS)}")
    try:
        stored = decode(path)
        check_content(path, stored.metadata, stored.values)
        return _table(stored)
    except (LookupError, TypeError, ValueError, OverflowError, struct.error) as error:
        # Damage takes more forms than checks foresee; whatever it breaks, the file is not a table.
        raise refusal(path, f"the content makes no sense ({error})") from error


def _table(stored: Stored) -> LoadedTable:
    metadata = stored.metadata
    axes = tuple(
        Axis(axis["name"], axis["unit"], np.asarray(axis["values"], dtype=np.float64))
        for axis in metadata["axes"]
    )
    return LoadedTable(
        name=metadata["name"],
        description=metadata["description"],
        axes=axes,
        channels=tuple(metadata["channels"]),
        values=restore(stored.values, metadata),
        unit=metadata["unit"],
        parameters=metadata["parameters"],
        metadata=metadata,
    )
