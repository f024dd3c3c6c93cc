"""Tables as DirectDraw Surface textures of four half channels, which game engines load directly.

The layout is that of Microsoft's DDS programming guide: magic number, 124-byte header, 20-byte
DX10 header, then rows of texels. DDS has no place for text, so the metadata are in a JSON file
beside the texture.
"""

import struct
from pathlib import Path

import numpy as np

from sssfit.files.json_text import json_text
from sssfit.files.reading import read_bytes, read_text
from sssfit.tables.formats.encoded import Stored, store
from sssfit.tables.formats.images import from_image, to_image
from sssfit.tables.formats.metadata import parse_metadata, refusal
from sssfit.tables.table import Table

HEADER_BYTES = 4 + 124 + 20
TEXEL_BYTES = 8
FLAGS = 0x1 | 0x2 | 0x4 | 0x8 | 0x1000  # caps, height, width, pitch, pixel format
FOURCC_FLAG = 0x4
TEXTURE_CAPS = 0x1000
R16G16B16A16_FLOAT = 10
TEXTURE_2D = 3
FILLED = np.array([0.0, 0.0, 0.0, 1.0], dtype="<f2")


def encode(table: Table) -> dict[str, bytes]:
    """Encode a table as a DDS texture in R16G16B16A16_FLOAT, with its metadata beside it.

    A 1-D table is one row of texels; the first axis of a 2-D table runs down. Missing channels
    are 0, a missing fourth channel is 1.

    Args:
        table: the table; infinities and NaN are kept.

    Returns:
        File name suffix to content: ``.dds`` and ``.dds.json``.

    Raises:
        ValueError: the table cannot be encoded, or holds a finite value beyond 65504.

    Example:
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.5]]), "1")
        >>> files = encode(table)
        >>> files[".dds"][:4], np.frombuffer(files[".dds"][HEADER_BYTES:], "<f2").tolist()
        (b'DDS ', [1.0, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0, 1.0])
    """
    stored = store(table, "half")
    image = to_image(stored.values)
    height, width, channels = image.shape
    texels = np.broadcast_to(FILLED, (height, width, 4)).copy()
    texels[..., :channels] = image
    return {
        ".dds": _header(width, height) + texels.tobytes(),
        ".dds.json": json_text(stored.metadata).encode("utf-8"),
    }


def decode(path: Path) -> Stored:
    """Read a table back from a DDS texture and the JSON file beside it.

    Args:
        path: the ``.dds`` file; the metadata are in the file of that name with ``.json`` added.

    Returns:
        The stored numbers and the metadata, whose digests are not compared yet.

    Raises:
        FileError: one of the two files is missing or damaged, or they disagree.

    Example:
        >>> decode(Path("no/such/file.dds"))
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.dds: there is no such file; check the path
    """
    data = read_bytes(path)
    beside = path.with_name(path.name + ".json")
    if not beside.is_file():
        raise refusal(path, f"its metadata file {beside.name} is missing beside it")
    metadata = parse_metadata(read_text(beside), beside, "")
    if data[:4] != b"DDS " or len(data) < HEADER_BYTES:
        raise refusal(path, "is truncated or is not a DDS texture")
    height, width = struct.unpack_from("<2I", data, 12)
    if data[:HEADER_BYTES] != _header(width, height):
        raise refusal(path, "its header is not of an R16G16B16A16_FLOAT texture by sssfit")
    expected = HEADER_BYTES + TEXEL_BYTES * width * height
    if len(data) != expected:
        raise refusal(path, f"has {len(data)} bytes where its header asks for {expected}")
    texels = np.frombuffer(data, "<f2", offset=HEADER_BYTES).reshape(height, width, 4)
    count = len(metadata["channels"])
    values = from_image([texels[..., index] for index in range(count)], metadata, path)
    if not np.array_equal(texels[..., count:], np.broadcast_to(FILLED, texels.shape)[..., count:]):
        raise refusal(path, f"its channels beyond the first {count} are not 0, 0, 1 as written")
    return Stored(metadata, values)


def _header(width: int, height: int) -> bytes:
    """Make the magic number and both headers of a texture without mipmaps."""
    pitch = width * TEXEL_BYTES
    pixel_format = struct.pack("<2I4s5I", 32, FOURCC_FLAG, b"DX10", 0, 0, 0, 0, 0)
    return (
        b"DDS "
        + struct.pack("<7I44x", 124, FLAGS, height, width, pitch, 0, 0)
        + pixel_format
        + struct.pack("<5I", TEXTURE_CAPS, 0, 0, 0, 0)
        + struct.pack("<5I", R16G16B16A16_FLOAT, TEXTURE_2D, 0, 1, 0)
    )
