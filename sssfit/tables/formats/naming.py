"""Names and numbers as text: what a table's parts are called in CSV and shader files."""

import re

import numpy as np

# Words that may not name an array in HLSL or GLSL, as far as they look like names of tables.
RESERVED_WORDS = frozenset(
    """
    active asm bool break buffer case cbuffer class coherent common compile const continue default
    discard do double dword else enum export extern external false filter fixed flat float for
    fragment goto groupshared half highp if in inline inout input int interface invariant layout
    line lineadj linear long lowp main matrix mediump namespace noinline noise nointerpolation
    noperspective out output packed packoffset partition pass patch pixelfragment point precise
    precision public readonly register resource restrict return row_major sample sampler shared
    short signed sizeof smooth static string struct subroutine superp switch tbuffer technique
    template texture this triangle triangleadj true typedef uint uniform union unorm unsigned using
    varying vector vertexfragment void volatile while writeonly
    """.split()
)


def column_name(name: str, unit: str) -> str:
    """Join the name and the unit of an axis: what it is called in a CSV file or a shader.

    Args:
        name: name of the axis.
        unit: its unit; "1" adds nothing.

    Returns:
        The name, an underscore, and the unit in letters and digits.

    Example:
        >>> [column_name("sigma_t", unit) for unit in ("1/mm", "mm", "1", "mm^2", "µm")]
        ['sigma_t_per_mm', 'sigma_t_mm', 'sigma_t', 'sigma_t_mm_2', 'sigma_t_um']
    """
    if unit in ("", "1"):
        return name
    # Both characters that look like the Greek letter are in use for micro.
    text = unit.replace("\u00b5", "u").replace("\u03bc", "u")
    text = re.sub(r"^1/", "per_", text).replace("/", "_per_")
    return f"{name}_{re.sub(r'[^A-Za-z0-9]+', '_', text).strip('_')}"


def identifier(text: str) -> str:
    """Turn a name into one that HLSL and GLSL accept for a variable.

    Args:
        text: any name.

    Returns:
        The name with one underscore for every run of other characters than ASCII letters and
        digits, and ``table_`` before it where it would begin with a digit, with ``gl_`` or be a
        reserved word, or be empty.

    Example:
        >>> [identifier(text) for text in ("skin", "skin__1 (red)", "2-layer", "float", "-")]
        ['skin', 'skin_1_red', 'table_2_layer', 'table_float', 'table']
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
    if not name:
        return "table"
    if name[0].isdigit() or name.startswith("gl_") or name in RESERVED_WORDS:
        return f"table_{name}"
    return name


def float_text(value: np.float32) -> str:
    """Write a float32 with the fewest digits that give it back.

    Args:
        value: any float32.

    Returns:
        The digits; "inf", "-inf" and "nan" for numbers that are not finite.

    Example:
        >>> [float_text(np.float32(x)) for x in (0.1, -0.0, 1e-45, 1e10, np.inf)]
        ['0.1', '-0.0', '1e-45', '1e+10', 'inf']
    """
    text = str(value)
    # Most readers go through a double, and rounding twice can miss by one unit in the last place.
    if np.float32(float(text)) == value or np.isnan(value):
        return text
    return repr(float(value))
