"""Tables as OpenEXR images, in float or half."""

from pathlib import Path

from sssfit.files.exr import encode_exr, read_exr
from sssfit.files.json_text import json_line
from sssfit.tables.formats.encoded import Stored, store
from sssfit.tables.formats.images import from_image, to_image
from sssfit.tables.formats.metadata import parse_metadata, refusal
from sssfit.tables.table import Table

ATTRIBUTE = "sssfit"


def encode(table: Table, dtype: str) -> dict[str, bytes]:
    """Encode a table as an EXR image; a 1-D table has one row, the first axis of a 2-D is down.

    The image has the table's channels under their names, and the metadata as one line of JSON in
    the header attribute ``sssfit``.

    Args:
        table: the table; infinities and NaN are kept.
        dtype: "float" or "half".

    Returns:
        File name suffix to content: ``.exr`` or ``.half.exr``.

    Raises:
        ValueError: the table cannot be encoded, or holds a finite value beyond the type's range
            (half: 65504).

    Example:
        >>> import numpy as np
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.5]]), "1")
        >>> list(encode(table, "half"))
        ['.half.exr']
    """
    stored = store(table, dtype)
    image = to_image(stored.values)
    channels = {name: image[..., index] for index, name in enumerate(table.channels)}
    data = encode_exr(channels, {ATTRIBUTE: json_line(stored.metadata)})
    return {".half.exr" if dtype == "half" else ".exr": data}


def decode(path: Path) -> Stored:
    """Read a table back from an EXR image.

    Args:
        path: the file.

    Returns:
        The stored numbers and the metadata, whose digests are not compared yet.

    Raises:
        FileError: the file is no EXR image of a table, is damaged, or its channels or shape
            disagree with its metadata.

    Example:
        >>> decode(Path("no/such/file.exr"))
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.exr: there is no such file; check the path
    """
    channels, attributes = read_exr(path)
    metadata = parse_metadata(attributes.get(ATTRIBUTE), path, f"header attribute {ATTRIBUTE}")
    names = metadata["channels"]
    if set(channels) != set(names):
        raise refusal(path, f"channels are {sorted(channels)} but the metadata say {names}")
    return Stored(metadata, from_image([channels[name] for name in names], metadata, path))
