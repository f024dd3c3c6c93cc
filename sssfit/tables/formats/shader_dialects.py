"""How HLSL and GLSL spell the same things."""

from dataclasses import dataclass

import numpy as np

from sssfit.tables.formats.naming import float_text


@dataclass(frozen=True)
class Dialect:
    """One shading language.

    Attributes:
        name: what people call it; in lower case the file name suffix.
        vector: how names of vector types begin.
        constant: qualifiers of a constant global array.
        bits_array: qualifiers of a global array with numbers made from bits.
        open_array: what stands before the entries, to be given the type and the size.
        close_array: what stands behind the entries.
        from_bits: function that turns an unsigned integer into the float with the same bits.
        command: how to compile a file alone, to be given the output and the input file.
        entry_point: the entry point of such a file, to be given the four components of its result.

    Example:
        >>> HLSL.type_name(3), GLSL.type_name(3), GLSL.type_name(1)
        ('float3', 'vec3', 'float')
    """

    name: str
    vector: str
    constant: str
    bits_array: str
    open_array: str
    close_array: str
    from_bits: str
    command: str
    entry_point: str

    def type_name(self, channels: int) -> str:
        """Name the type of an entry with 1 to 4 channels."""
        return "float" if channels == 1 else f"{self.vector}{channels}"

    def number(self, value: np.float32) -> str:
        """Write a float32; neither language has a literal for infinity or NaN, only for bits."""
        if np.isfinite(value):
            return float_text(value)
        return f"{self.from_bits}(0x{value.view(np.uint32):08x}u)"

    def array(self, name: str, entries: np.ndarray) -> str:
        """Declare a global array, one entry a line; ``entries`` has shape (size, channels)."""
        size, channels = entries.shape
        kind = self.type_name(channels)
        lines = [", ".join(map(self.number, entry)) for entry in entries]
        if channels > 1:
            lines = [f"{kind}({line})" for line in lines]
        qualifiers = self.constant if np.isfinite(entries).all() else self.bits_array
        head = f"{qualifiers}{kind} {name}[{size}] = {self.open_array.format(kind, size)}"
        return head + "\n    " + ",\n    ".join(lines) + f"\n{self.close_array};"


HLSL = Dialect(
    name="HLSL",
    vector="float",
    constant="static const ",
    bits_array="static const ",
    open_array="{{",
    close_array="}",
    from_bits="asfloat",
    command="glslangValidator -V -D -S frag -e main -DSSSFIT_MAIN -o {} {}",
    entry_point="""\
float4 main(float2 sssfit_place : TEXCOORD0) : SV_Target
{{
    return float4({});
}}""",
)
GLSL = Dialect(
    name="GLSL",
    vector="vec",
    constant="const ",
    # glslang does not take uintBitsToFloat for a constant expression.
    bits_array="",
    open_array="{0}[{1}](",
    close_array=")",
    from_bits="uintBitsToFloat",
    command="glslangValidator -V -S frag --glsl-version 450 -DSSSFIT_MAIN -o {} {}",
    entry_point="""\
layout(location = 0) in vec2 sssfit_place;
layout(location = 0) out vec4 sssfit_entry;
void main()
{{
    sssfit_entry = vec4({});
}}""",
)
