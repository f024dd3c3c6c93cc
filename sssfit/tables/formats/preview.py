"""Tables as 8-bit images to look at; too coarse to render with."""

import io
from pathlib import Path

import numpy as np
from PIL import Image, PngImagePlugin

from sssfit.files.json_text import json_line
from sssfit.files.reading import read_bytes
from sssfit.tables.formats.encoded import Stored, store
from sssfit.tables.formats.images import from_image, to_image
from sssfit.tables.formats.metadata import parse_metadata, refusal
from sssfit.tables.table import Table

TEXT_KEY = "sssfit"
# The last chunk of every PNG file; Pillow reads files that end before it.
END_CHUNK = b"\0\0\0\0IEND\xaeB`\x82"
# A single row of pixels would hardly be seen.
STRIP_HEIGHT = 32


def encode(table: Table) -> dict[str, bytes]:
    """Encode a table as a PNG image of 8 bits a channel.

    The range of all finite values is mapped linearly to 0...255, the same for every channel. One
    channel gives a grey image, two to four give red, green, blue (0 when missing) and alpha. A
    1-D table is a strip of 32 equal rows. The metadata, which hold the mapping, are one line of
    JSON in the text chunk ``sssfit``.

    Args:
        table: the table; minus infinity and NaN are drawn as the least, infinity as the greatest
            finite value.

    Returns:
        File name suffix to content: ``.preview.png``.

    Raises:
        ValueError: the table cannot be encoded, or holds a finite value beyond float32.

    Example:
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.5]]), "1")
        >>> with Image.open(io.BytesIO(encode(table)[".preview.png"])) as image:
        ...     image.size, image.getpixel((0, 0))
        ((2, 32), 255)
    """
    stored = store(table, "8-bit")
    pixels = to_image(stored.values)
    if pixels.shape[-1] == 1:
        pixels = pixels[..., 0]
    elif pixels.shape[-1] == 2:
        pixels = np.pad(pixels, ((0, 0), (0, 0), (0, 1)))
    if len(table.axes) == 1:
        pixels = np.repeat(pixels, STRIP_HEIGHT, axis=0)
    text = PngImagePlugin.PngInfo()
    text.add_itxt(TEXT_KEY, json_line(stored.metadata))
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, "PNG", pnginfo=text)
    return {".preview.png": stream.getvalue()}


def decode(path: Path) -> Stored:
    """Read a table back from its preview, as coarse as it is.

    Args:
        path: the file.

    Returns:
        The 8-bit numbers and the metadata, whose digests are not compared yet.

    Raises:
        FileError: the file is no preview of a table, is damaged, or its size or channels disagree
            with its metadata.

    Example:
        >>> decode(Path("no/such/file.preview.png"))
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.preview.png: there is no such file; check \
the path
    """
    data = read_bytes(path)
    if not data.endswith(END_CHUNK):
        raise refusal(path, "is truncated or no PNG image")
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            pixels = np.atleast_3d(np.asarray(image))
            text = image.info.get(TEXT_KEY)
    # Pillow has several exceptions for damaged data, SyntaxError among them.
    except Exception as error:
        raise refusal(path, f"is damaged or no PNG image ({error})") from error
    metadata = parse_metadata(text, path, f"text chunk {TEXT_KEY}")
    count = len(metadata["channels"])
    if pixels.shape[-1] != (3 if count == 2 else count) or pixels[..., count:].any():
        raise refusal(path, f"its channels are not those of {count} table channels")
    if len(metadata["axes"]) == 1:
        if len(pixels) != STRIP_HEIGHT or (pixels != pixels[:1]).any():
            raise refusal(path, f"is not a strip of {STRIP_HEIGHT} equal rows")
        pixels = pixels[:1]
    return Stored(metadata, from_image([pixels[..., i] for i in range(count)], metadata, path))
