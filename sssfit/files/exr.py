"""OpenEXR images: named channels of float, half or whole numbers, and text in the header."""

import io
import os
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

import numpy as np
import OpenEXR

from sssfit.files.errors import FileError
from sssfit.files.reading import read_bytes

# Every EXR file begins with these bytes; checked first because the library itself prints to the
# terminal about files that are something else.
MAGIC = b"\x76\x2f\x31\x01"
#: Held while a file is read, when nothing that the process prints reaches the terminal: to be held by whoever
#: prints while another thread reads.
TERMINAL = threading.RLock()


def encode_exr(channels: dict[str, np.ndarray], attributes: dict[str, str]) -> bytes:
    """Make the bytes of an EXR image: one part, scan lines, ZIP compression.

    The same input gives the same bytes: the header holds no time and no name of a machine.

    Args:
        channels: channel name to pixels, all of one shape (height, width), each float32, float16 or
            uint32; infinities and NaN are kept. The file holds them in alphabetical order.
        attributes: header attribute name to text; "" is kept too.

    Returns:
        The content of the file.

    Raises:
        ValueError: no channel, no pixel, or pixels of another kind or of different shapes.
        FileError: the directory for temporary files cannot be written.

    Example:
        >>> pixels = np.array([[0.0, np.inf]], dtype=np.float32)
        >>> encode_exr({"Y": pixels}, {"comments": "a demonstration"})[:4] == MAGIC
        True
    """
    _check_pixels(list(channels.values()))
    header = {
        **attributes,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
    }
    # The library reads the memory as if it were contiguous, whatever the strides say.
    pixels = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    # Older versions of the library write to a path only, not to memory.
    try:
        with tempfile.TemporaryDirectory() as directory:
            path = Path(directory) / "image.exr"
            with OpenEXR.File(header, pixels) as image:
                image.write(str(path))
            return path.read_bytes()
    except (OSError, RuntimeError) as error:
        raise FileError(
            "temporary EXR image", "", f"cannot be written ({error})", "free space and run again"
        ) from error


def read_exr(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read the first part of an EXR image.

    Args:
        path: the file.

    Returns:
        Channel name to pixels of shape (height, width), float32 or float16 (uint32 where the file
        holds integers), and attribute name to text for those header attributes that are text.

    Raises:
        FileError: the file cannot be read, is truncated or is not an EXR image.

    Example:
        >>> pixels = np.array([[0.5, -np.inf]], dtype=np.float16)
        >>> with tempfile.TemporaryDirectory() as directory:
        ...     path = Path(directory) / "t.exr"
        ...     _ = path.write_bytes(encode_exr({"Y": pixels}, {"comments": "a demonstration"}))
        ...     channels, attributes = read_exr(path)
        >>> channels["Y"], attributes
        (array([[ 0.5, -inf]], dtype=float16), {'comments': 'a demonstration'})
    """
    remedy = "restore the file or write it again"
    if not read_bytes(path).startswith(MAGIC):
        raise FileError(path, "", "is not an EXR image", remedy)
    try:
        with _muted(), OpenEXR.File(str(path), separate_channels=True) as image:
            channels = {name: part.pixels.copy() for name, part in image.channels().items()}
            # The header is empty once the image is closed.
            attributes = {n: t for n, t in image.header().items() if isinstance(t, str)}
    # The library does not say which exceptions a damaged file raises.
    except Exception as error:
        problem = f"is truncated or damaged ({error})"
        raise FileError(path, "", problem, remedy) from error
    return channels, attributes


@contextmanager
def _muted() -> Iterator[None]:
    """Keep what the library prints about damaged files off the terminal: the exception says it."""
    # Its binding prints through Python to one stream, its core past Python to the other. Both streams are the
    # whole process's: of two threads, one might take the other's replacement for the original.
    with TERMINAL, redirect_stdout(io.StringIO()):
        try:
            original = os.dup(2)
        except OSError:  # closed: nothing to be muted
            yield
            return
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(original, 2)
            os.close(original)


def _check_pixels(pixels: list[np.ndarray]) -> None:
    """Refuse what the library would write wrongly or not at all."""
    shapes = {values.shape for values in pixels}
    if len(shapes) == 1 and {values.dtype.str for values in pixels} <= {"<f2", "<f4", "<u4"}:
        shape = shapes.pop()
        if len(shape) == 2 and 0 not in shape:
            return
    raise ValueError(
        "channels of an EXR image must each be float32, float16 or uint32, with one shape "
        f"(height, width) and at least one pixel, got {[(p.dtype.name, p.shape) for p in pixels]}"
    )
