"""A profile's constants as HLSL and GLSL text to include in a shader."""

from collections.abc import Mapping, Sequence

import numpy as np

from sssfit.tables.formats.naming import identifier
from sssfit.tables.formats.shader_dialects import Dialect


def encode_constants(
    name: str, constants: Mapping[str, np.ndarray], dialect: Dialect, comments: Sequence[str] = ()
) -> bytes:
    """Write constants as shader text behind a guard, so that several such files go together.

    Args:
        name: of the profile, before the name of each constant.
        constants: by name, unit included, of shape (size, channels) with 1 to 4 channels: a number or a
            vector for size 1, an array otherwise; float32, with an infinity or NaN where there is one.
        dialect: `HLSL` or `GLSL`.
        comments: lines to stand above.

    Returns:
        The file's content.

    Example:
        >>> from sssfit.tables.formats.shader_dialects import GLSL
        >>> text = encode_constants("wax", {"d_mm": np.array([[1.5, 1.0, 0.5]])}, GLSL).decode()
        >>> print(text.splitlines()[3])
        const vec3 wax_d_mm = vec3(1.5, 1.0, 0.5);
    """
    profile = identifier(name)
    guard = f"SSSFIT_PROFILE_{profile}"
    lines = [f"// {line}" for line in comments]
    lines += [f"#ifndef {guard}", f"#define {guard}", ""]
    for key, values in constants.items():
        lines.append(_declared(f"{profile}_{key}", np.asarray(values, np.float32), dialect))
    return "\n".join([*lines, "", f"#endif // {guard}", ""]).encode("utf-8")


def _declared(name: str, values: np.ndarray, dialect: Dialect) -> str:
    size, channels = values.shape
    if size > 1:
        return dialect.array(name, values)
    kind = dialect.type_name(channels)
    text = ", ".join(map(dialect.number, values[0]))
    qualifiers = dialect.constant if np.isfinite(values).all() else dialect.bits_array
    return f"{qualifiers}{kind} {name} = {text if channels == 1 else f'{kind}({text})'};"
