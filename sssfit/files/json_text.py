"""JSON text that is the same, byte for byte, whenever the content is the same."""

import hashlib
import json
import math
import os
from typing import Any, NoReturn

from sssfit.files.errors import FileError
from sssfit.files.reading import read_text


def json_text(value: Any) -> str:
    """Write a value as JSON to be read by people: sorted keys, two blanks of indentation.

    Floats keep all digits (``repr``). JSON has no infinity and no NaN: they are written as the
    strings "inf", "-inf" and "nan", which ``float`` turns back into numbers.

    Args:
        value: nested dicts (string keys), lists, tuples, strings, numbers, booleans, None, and
            NumPy numbers and arrays.

    Returns:
        The text, ending in a newline.

    Raises:
        TypeError: a value or key of another type.

    Example:
        >>> print(json_text({"unit": "mm", "range": (0.0, float("inf"))}), end="")
        {
          "range": [
            0.0,
            "inf"
          ],
          "unit": "mm"
        }
    """
    return json.dumps(_plain(value), sort_keys=True, indent=2, ensure_ascii=False) + "\n"


def json_line(value: Any) -> str:
    """Write a value as JSON on one line, otherwise as `json_text`, without a newline at the end.

    Args:
        value: as for `json_text`.

    Returns:
        The text; it holds no newline, as JSON escapes those inside strings.

    Raises:
        TypeError: a value or key of another type.

    Example:
        >>> json_line({"b": -0.0, "a": [1, None]})
        '{"a": [1, null], "b": -0.0}'
    """
    return json.dumps(_plain(value), sort_keys=True, ensure_ascii=False)


def parse_json(text: str, file: object, where: str = "") -> Any:
    """Read strict JSON text that came from a file.

    Args:
        text: the JSON text.
        file: the file, for the message.
        where: the place in the file, for the message; "" when it is the whole file.

    Returns:
        Dicts, lists, strings, numbers, booleans and None.

    Raises:
        FileError: the text is not JSON; ``NaN`` and ``Infinity`` are not either.

    Example:
        >>> parse_json('{"values": [0.5, "inf"]}', "t.json")
        {'values': [0.5, 'inf']}
    """
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise FileError(
            file, where, f"is not valid JSON ({error})", "restore the file or write it again"
        ) from error


def read_json(path: str | os.PathLike[str]) -> Any:
    """Read a file of strict JSON in UTF-8.

    Args:
        path: the file.

    Returns:
        Dicts, lists, strings, numbers, booleans and None.

    Raises:
        FileError: the file cannot be read or is not JSON.

    Example:
        >>> read_json("no/such/file.json")
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.json: there is no such file; check the path
    """
    return parse_json(read_text(path), path)


def sha256_bytes(data: bytes) -> str:
    """Give the SHA-256 digest of some bytes.

    Args:
        data: any bytes, empty ones too.

    Returns:
        64 hexadecimal digits in lower case.

    Example:
        >>> sha256_bytes(b"")[:16]
        'e3b0c44298fc1c14'
    """
    return hashlib.sha256(data).hexdigest()


def _plain(value: Any) -> Any:
    """Turn a value into what the ``json`` module writes strictly and always the same way."""
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(f"JSON keys must be strings, got {key!r}")
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # a NumPy number or array
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(float(value))
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise TypeError(f"JSON cannot hold {value!r} of type {type(value).__name__}")


def _refuse_constant(name: str) -> NoReturn:
    """Refuse the non-finite numbers that Python reads although they are not JSON."""
    raise ValueError(f"{name} is not a JSON number")
