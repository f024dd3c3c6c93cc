"""Tables as HLSL and GLSL text to include in a shader: an array and a lookup function."""

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from sssfit.files.json_text import json_text
from sssfit.files.reading import read_text
from sssfit.tables.formats.encoded import Stored, store
from sssfit.tables.formats.metadata import parse_metadata, refusal, stored_shape
from sssfit.tables.formats.naming import identifier
from sssfit.tables.formats.shader_dialects import Dialect
from sssfit.tables.formats.shader_lookup import (
    ShaderAxis,
    axis_constants,
    axis_function,
    lookup_function,
    shader_axes,
)
from sssfit.tables.table import Table

METADATA_BEGIN = "/* sssfit metadata\n"
METADATA_END = "*/\n"
# Beyond this size some compilers take long: their time grows with the square of the size.
LARGE_ARRAY = 4096


def encode(table: Table, dialect: Dialect) -> dict[str, bytes]:
    """Encode a table as shader text: an array of float vectors and a lookup function.

    ``NAME_lookup`` takes the axis values, their unit in the name of the parameter, clamps them to
    the range of the axis, and interpolates linearly (bilinearly for two axes). A 2-D table is
    stored row by row, its second axis fastest. Several such files can be included together.
    Above 4096 entries some compilers need minutes; a texture serves better there.

    Args:
        table: the table; an infinite or NaN entry makes lookups in the cells beside it so.
        dialect: `HLSL` or `GLSL`.

    Returns:
        File name suffix to content: ``.hlsl`` or ``.glsl``.

    Raises:
        ValueError: the table cannot be encoded, holds a finite value beyond float32, or the values
            of an axis do not increase strictly in float32.

    Example:
        >>> from sssfit.tables.formats.shader_dialects import GLSL
        >>> from sssfit.tables.table import Axis
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> table = Table("t", "A demonstration.", (axis,), ("Y",), np.array([[1.0], [0.5]]), "1")
        >>> text = encode(table, GLSL)[".glsl"].decode("utf-8")
        >>> print(text[text.index("const float t[2]") :].split(";")[0])
        const float t[2] = float[2](
            1.0,
            0.5
        )
    """
    stored = store(table, "float")
    name = identifier(table.name)
    axes = shader_axes(stored.metadata)
    kind = dialect.type_name(len(table.channels))
    entries = stored.values.reshape(-1, len(table.channels))
    parts = [
        _introduction(table, dialect, axes),
        f"#ifndef SSSFIT_TABLE_{name}\n#define SSSFIT_TABLE_{name}\n",
        METADATA_BEGIN + _comment_safe(json_text(stored.metadata)) + METADATA_END,
        *(axis_constants(axis, dialect) + "\n" for axis in axes),
        dialect.array(name, entries) + "\n",
        *(axis_function(axis) + "\n" for axis in axes),
        lookup_function(name, kind, axes) + "\n",
        f"#ifdef SSSFIT_MAIN\n{_entry_point(name, dialect, stored.metadata)}\n#endif\n",
        _last_line(name) + "\n",
    ]
    suffix = f".{dialect.name.lower()}"
    return {suffix: "\n".join(parts).encode("utf-8")}


def decode(path: Path, dialect: Dialect) -> Stored:
    """Read a table back from shader text: its metadata and its array.

    Args:
        path: the file.
        dialect: `HLSL` or `GLSL`.

    Returns:
        The stored numbers and the metadata, whose digests are not compared yet.

    Raises:
        FileError: the file is no shader text of a table, is truncated, or its array or axis
            constants disagree with its metadata. The functions are not compared.

    Example:
        >>> from sssfit.tables.formats.shader_dialects import HLSL
        >>> decode(Path("no/such/file.hlsl"), HLSL)
        Traceback (most recent call last):
        ...
        sssfit.files.errors.FileError: no/such/file.hlsl: there is no such file; check the path
    """
    text = read_text(path)
    _, begin, rest = text.partition(METADATA_BEGIN)
    comment, end, code = rest.partition(METADATA_END)
    if begin and not end:
        raise refusal(path, "is truncated in its metadata")
    metadata = parse_metadata(comment if begin else None, path, "metadata comment")
    try:
        axes = shader_axes(metadata)
    except ValueError as error:
        raise refusal(path, str(error), "metadata comment") from error
    for axis in axes:
        if axis_constants(axis, dialect) not in code:
            raise refusal(path, f"constants {axis.name}_... disagree with the axis in the metadata")
    name = identifier(metadata["name"])
    if not code.rstrip().endswith(_last_line(name)):
        raise refusal(path, f"is truncated: it does not end with {_last_line(name)!r}")
    found = re.search(rf"\b{name}\[\d+\] = [^\n]*\n(.*?)\n[}})];", code, re.DOTALL)
    if not found:
        raise refusal(path, f"holds no array {name}")
    values = _parse_entries(found[1], name, metadata, dialect, path)
    return Stored(metadata, values)


def _introduction(table: Table, dialect: Dialect, axes: list[ShaderAxis]) -> str:
    """Tell in a comment how to use the file and how to compile it alone."""
    name = identifier(table.name)
    parameters = ", ".join(axis.parameter for axis in axes)
    entries = table.values[..., 0].size
    source = shlex.quote(f"{table.name}.{dialect.name.lower()}")
    lines = [
        f"Lookup table {name} for {dialect.name}, written by sssfit. Include this file and call",
        f"    {name}_lookup({parameters})",
        "which interpolates linearly and clamps to the range of each axis.",
        "sssfit.tables.load reads the table back, and refuses it when its numbers were edited.",
        "To compile this file alone, with an entry point that only SSSFIT_MAIN adds:",
        "    " + dialect.command.format(shlex.quote(f"{table.name}.spv"), source),
    ]
    if entries > LARGE_ARRAY:
        lines.append(f"Some compilers need minutes for {entries} entries: consider a texture.")
    return "".join(f"// {line}\n" for line in lines)


def _last_line(name: str) -> str:
    """Write the last line, by which a truncated file is told from a whole one."""
    return f"#endif // SSSFIT_TABLE_{name}"


def _entry_point(name: str, dialect: Dialect, metadata: dict[str, Any]) -> str:
    """Write an entry point that calls the lookup function, so that compiling checks it."""
    arguments = ["sssfit_place.x", "sssfit_place.y"][: len(metadata["axes"])]
    components = [f"{name}_lookup({', '.join(arguments)})"]
    components += ["0.0"] * (4 - len(metadata["channels"]))
    return dialect.entry_point.format(", ".join(components))


def _comment_safe(text: str) -> str:
    r"""Keep JSON text from ending or nesting a comment: ``\/`` is JSON for ``/``."""
    return text.replace("*/", "*\\/").replace("/*", "\\/*")


def _parse_entries(
    body: str, name: str, metadata: dict[str, Any], dialect: Dialect, path: Path
) -> np.ndarray:
    """Read the entries of the array, one a line."""
    shape = stored_shape(metadata)
    lines = body.split("\n")
    size = int(np.prod(shape[:-1]))
    if len(lines) != size:
        raise refusal(path, f"array {name} has {len(lines)} entries but the metadata say {size}")
    values = np.empty((size, shape[-1]), dtype="<f4")
    constructor = f"{dialect.type_name(shape[-1])}("
    for index, line in enumerate(lines):
        entry = line.strip().removesuffix(",")
        if shape[-1] > 1:
            entry = entry.removeprefix(constructor).removesuffix(")")
        numbers = [_parse_number(word.strip(), dialect) for word in entry.split(",")]
        if len(numbers) != shape[-1] or None in numbers:
            raise refusal(path, f"{line.strip()!r} is no entry of {shape[-1]} numbers", f"{name}[{index}]")
        with np.errstate(over="ignore"):
            values[index] = numbers
    return values.reshape(shape)


def _parse_number(word: str, dialect: Dialect) -> float | None:
    """Read a number as `Dialect.number` writes it; None when it is none."""
    for special in (np.inf, -np.inf, np.nan):
        if word == dialect.number(np.float32(special)):
            return special
    try:
        return float(word)
    except ValueError:
        return None
