"""Reading whole files, with trouble told in one sentence."""

import os

from sssfit.files.errors import FileError


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Read a whole file.

    Args:
        path: the file.

    Returns:
        Its bytes; b"" for an empty file.

    Raises:
        FileError: there is no such file, or it cannot be read.

    Example:
        >>> read_bytes("no/such/file.dds")
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.dds: there is no such file; check the path
    """
    try:
        with open(path, "rb") as stream:
            return stream.read()
    except FileNotFoundError as error:
        raise FileError(path, "", "there is no such file", "check the path") from error
    except OSError as error:
        problem = f"cannot be read ({(error.strerror or str(error)).lower()})"
        raise FileError(path, "", problem, "check the path and its permissions") from error


def read_text(path: str | os.PathLike[str]) -> str:
    r"""Read a file of UTF-8 text, with ``\n`` for every kind of line end.

    Args:
        path: the file.

    Returns:
        The text; "" for an empty file.

    Raises:
        FileError: the file cannot be read or is not UTF-8.

    Example:
        >>> read_text("no/such/file.csv")
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.csv: there is no such file; check the path
    """
    try:
        text = read_bytes(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(path, "", f"is not UTF-8 text ({error})", "restore the file") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")
