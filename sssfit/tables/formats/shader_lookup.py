"""The text of shader functions that find a place on an axis and interpolate between entries.

Both languages share this text, which keeps to what they have in common.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sssfit.tables.formats.naming import column_name, float_text, identifier
from sssfit.tables.formats.shader_dialects import Dialect

# Spacing of an axis counts as uniform when no value is further from it than this part of a step,
# which is below what a float32 position on the axis resolves.
UNIFORM_TOLERANCE = 1e-6


@dataclass(frozen=True)
class ShaderAxis:
    """An axis under the names that it has in a shader.

    Attributes:
        name: how the names of its constants and of its function begin.
        parameter: name of an axis value, unit included.
        values: the axis values in float32, strictly increasing.
        uniform: whether the values are uniformly spaced.

    Example:
        >>> ShaderAxis("t_radius", "radius_mm", np.zeros(1, dtype=np.float32), True).parameter
        'radius_mm'
    """

    name: str
    parameter: str
    values: np.ndarray
    uniform: bool


def shader_axes(metadata: dict[str, Any]) -> list[ShaderAxis]:
    """Name the axes of a table for a shader.

    Args:
        metadata: the metadata of the table.

    Returns:
        One entry for each axis.

    Raises:
        ValueError: values of an axis do not increase strictly, or do so only beyond float32.

    Example:
        >>> axis = {"name": "sigma_t", "unit": "1/mm", "values": [1.0, 2.0, 4.0]}
        >>> [(a.name, a.parameter, a.uniform) for a in shader_axes({"name": "t", "axes": [axis]})]
        [('t_sigma_t', 'sigma_t_per_mm', False)]
    """
    table = identifier(metadata["name"])
    axes = []
    for axis in metadata["axes"]:
        exact = np.asarray(axis["values"], dtype=np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            values = exact.astype(np.float32)
            steps = np.diff(values)
        if not (np.all(steps > 0.0) and np.all(np.isfinite(steps)) and np.isfinite(values[0])):
            raise ValueError(
                f"axis {axis['name']!r} of table {metadata['name']!r} must increase strictly in "
                "float32 for a shader; sort or scale its values, or choose another format"
            )
        parameter = identifier(column_name(axis["name"], axis["unit"]))
        # A parameter must not hide the array.
        parameter = f"{parameter}_value" if parameter == table else parameter
        name = f"{table}_{identifier(axis['name'])}"
        axes.append(ShaderAxis(name, parameter, values, _is_uniform(exact)))
    return axes


def axis_constants(axis: ShaderAxis, dialect: Dialect) -> str:
    """Declare the constants of an axis: its begin and scale, or all values when not uniform.

    Args:
        axis: the axis.
        dialect: the language.

    Returns:
        The declarations.

    Example:
        >>> from sssfit.tables.formats.shader_dialects import GLSL
        >>> values = np.array([1.0, 1.5, 2.0], dtype=np.float32)
        >>> print(axis_constants(ShaderAxis("t_x", "x_mm", values, True), GLSL))
        const float t_x_first = 1.0;
        const float t_x_scale = 2.0;
    """
    if not axis.uniform:
        return dialect.array(f"{axis.name}_values", axis.values[:, np.newaxis])
    first, last = float(axis.values[0]), float(axis.values[-1])
    scale = (len(axis.values) - 1) / (last - first) if last > first else 0.0
    constants = {"first": first, "scale": scale}
    return "\n".join(
        f"{dialect.constant}float {axis.name}_{key} = {float_text(np.float32(value))};"
        for key, value in constants.items()
    )


def axis_function(axis: ShaderAxis) -> str:
    """Write the function that finds an axis value between two entries.

    Args:
        axis: the axis.

    Returns:
        A function of the axis value that gives the index of the entry below plus the part of the
        way to the next one, clamped to the axis range.

    Example:
        >>> axis = ShaderAxis("t_x", "x_mm", np.arange(3, dtype=np.float32), True)
        >>> print(axis_function(axis))
        float t_x_position(float x_mm)
        {
            return clamp((x_mm - t_x_first) * t_x_scale, 0.0, 2.0);
        }
    """
    last = len(axis.values) - 1
    head = f"float {axis.name}_position(float {axis.parameter})\n"
    if axis.uniform:
        offset = f"({axis.parameter} - {axis.name}_first)"
        return head + f"{{\n    return clamp({offset} * {axis.name}_scale, 0.0, {last}.0);\n}}"
    return (
        head
        + f"""\
{{
    int cell_low = 0;
    int cell_high = {last};
    while (cell_high - cell_low > 1)
    {{
        int cell_middle = (cell_low + cell_high) / 2;
        if ({axis.name}_values[cell_middle] <= {axis.parameter})
        {{
            cell_low = cell_middle;
        }}
        else
        {{
            cell_high = cell_middle;
        }}
    }}
    float cell_begin = {axis.name}_values[cell_low];
    float cell_width = {axis.name}_values[cell_high] - cell_begin;
    return float(cell_low) + clamp(({axis.parameter} - cell_begin) / cell_width, 0.0, 1.0);
}}"""
    )


def lookup_function(name: str, kind: str, axes: list[ShaderAxis]) -> str:
    """Write the function that looks a table up at axis values.

    Args:
        name: name of the array; the function is called ``NAME_lookup``.
        kind: type of an entry.
        axes: one axis for linear, two for bilinear interpolation.

    Returns:
        The function.

    Example:
        >>> axis = ShaderAxis("t_x", "x_mm", np.arange(3, dtype=np.float32), True)
        >>> print(lookup_function("t", "vec3", [axis]).split("\\n")[0])
        vec3 t_lookup(float x_mm)
    """
    parameters = ", ".join(f"float {axis.parameter}" for axis in axes)
    head = f"{kind} {name}_lookup({parameters})\n{{\n"
    if len(axes) == 1:
        cell = _cell_text("cell", axes[0])
        return head + cell + f"    return {_mix_text(name, 'cell', '{}')};\n}}"
    width = len(axes[1].values)
    below = _mix_text(name, "column", f"row_below * {width} + {{}}")
    above = _mix_text(name, "column", f"row_above * {width} + {{}}")
    return (
        head
        + _cell_text("row", axes[0])
        + _cell_text("column", axes[1])
        + f"    {kind} entry_below = {below};\n"
        + f"    {kind} entry_above = {above};\n"
        + "    return entry_below * (1.0 - row_weight) + entry_above * row_weight;\n}"
    )


def _cell_text(cell: str, axis: ShaderAxis) -> str:
    """Write how to find the entries on both sides; the clamp keeps a NaN inside the array."""
    last = len(axis.values) - 1
    return f"""\
    float {cell}_position = {axis.name}_position({axis.parameter});
    int {cell}_below = clamp(int({cell}_position), 0, {last});
    int {cell}_above = min({cell}_below + 1, {last});
    float {cell}_weight = {cell}_position - float({cell}_below);
"""


def _mix_text(name: str, cell: str, index: str) -> str:
    """Write the weighted sum of the entries on both sides of a place."""
    below, above = (index.format(f"{cell}_{side}") for side in ("below", "above"))
    weight = f"{cell}_weight"
    return f"{name}[{below}] * (1.0 - {weight}) + {name}[{above}] * {weight}"


def _is_uniform(values: np.ndarray) -> bool:
    """Tell whether values are spaced so uniformly that a shader cannot tell the difference."""
    even = np.linspace(values[0], values[-1], len(values))
    step = (values[-1] - values[0]) / max(len(values) - 1, 1)
    return bool(np.all(np.abs(values - even) <= UNIFORM_TOLERANCE * step))
