"""The file formats of tables, by name and by file name suffix."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from sssfit.tables.formats import csv, dds, exr, npz, preview, shader
from sssfit.tables.formats.encoded import Stored
from sssfit.tables.formats.shader_dialects import GLSL, HLSL
from sssfit.tables.table import Table

ENCODERS: dict[str, Callable[[Table], dict[str, bytes]]] = {
    "exr": partial(exr.encode, dtype="float"),
    "exr-half": partial(exr.encode, dtype="half"),
    "dds": dds.encode,
    "npz": npz.encode,
    "csv": csv.encode,
    "hlsl": partial(shader.encode, dialect=HLSL),
    "glsl": partial(shader.encode, dialect=GLSL),
    "png": preview.encode,
}
#: What numbers each format holds: "float", "half" or "8-bit".
STORED_AS = {
    "exr": "float",
    "exr-half": "half",
    "dds": "half",
    "npz": "float",
    "csv": "float",
    "hlsl": "float",
    "glsl": "float",
    "png": "8-bit",
}
DECODERS: dict[str, Callable[[Path], Stored]] = {
    ".exr": exr.decode,
    ".dds": dds.decode,
    ".npz": npz.decode,
    ".csv": csv.decode,
    ".hlsl": partial(shader.decode, dialect=HLSL),
    ".glsl": partial(shader.decode, dialect=GLSL),
    ".png": preview.decode,
}


def encode_table(table: Table, format_name: str) -> dict[str, bytes]:
    """Encode a table in a format, as the content of the files to write.

    The same table gives the same bytes, whenever and wherever.

    Args:
        table: the table.
        format_name: "exr" (float), "exr-half", "dds" (half), "npz", "csv", "hlsl", "glsl" or
            "png" (8-bit preview).

    Returns:
        Suffix to append to the table's name, to the content of that file.

    Raises:
        ValueError: there is no such format, or the table does not fit into it: a finite value
            beyond its range (half: 65504), or a shader axis that does not increase.

    Example:
        >>> import numpy as np
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.5]]), "1")
        >>> {name: list(encode_table(table, name)) for name in ("dds", "png")}
        {'dds': ['.dds', '.dds.json'], 'png': ['.preview.png']}
    """
    if format_name not in ENCODERS:
        raise ValueError(f"table format must be one of {', '.join(ENCODERS)}; got {format_name!r}")
    return ENCODERS[format_name](table)
