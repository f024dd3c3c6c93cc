"""Shader text compiles as its first lines say, and its lookup functions interpolate."""

import shutil
import subprocess

import numpy as np
import pytest

from sssfit.tables import Axis, Table
from sssfit.tables.formats import encode_table
from sssfit.tables.formats.naming import RESERVED_WORDS, identifier

VALIDATOR = shutil.which("glslangValidator")
SPIRV_CHECKER = shutil.which("spirv-val")
CPP_COMPILER = shutil.which("g++")

needs_validator = pytest.mark.skipif(VALIDATOR is None, reason="glslangValidator is not installed")
needs_cpp = pytest.mark.skipif(CPP_COMPILER is None, reason="g++ is not installed")
every_shader = pytest.mark.parametrize("format_name", ["hlsl", "glsl"])

# What HLSL offers beyond C++, as far as the lookup functions use it.
CPP_FOR_HLSL = """
#include <cstdio>
struct float3 { float r, g, b; float3(float x, float y, float z) : r(x), g(y), b(z) {} };
float3 operator*(float3 v, float s) { return float3(v.r * s, v.g * s, v.b * s); }
float3 operator+(float3 v, float3 w) { return float3(v.r + w.r, v.g + w.g, v.b + w.b); }
float clamp(float x, float low, float high) { return x < low ? low : x > high ? high : x; }
int clamp(int x, int low, int high) { return x < low ? low : x > high ? high : x; }
int min(int x, int y) { return x < y ? x : y; }
"""


def run(command, directory):
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stdout
    return done.stdout


def compile_alone(path):
    """Run the command that the file itself gives."""
    lines = path.read_text(encoding="utf-8").splitlines()
    (command,) = [line[2:].strip() for line in lines[:8] if "glslangValidator" in line]
    run(["sh", "-c", command], path.parent)
    if SPIRV_CHECKER:
        run([SPIRV_CHECKER, f"{path.stem}.spv"], path.parent)


@needs_validator
@every_shader
@pytest.mark.parametrize("dimensions", [1, 2])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("uniform", [True, False])
def test_file_compiles_alone(make_table, write_table, tmp_path, format_name, dimensions, channels, uniform):
    table = make_table(dimensions, channels, uniform=uniform)
    compile_alone(write_table(table, format_name, tmp_path))


@needs_validator
@every_shader
@pytest.mark.parametrize("channels", [1, 3])
def test_unusual_numbers_compile(make_table, write_table, tmp_path, format_name, channels):
    values = np.ones((7, channels))
    values[:, 0] = [np.inf, -np.inf, np.nan, -0.0, 1e-45, 3.4028234663852886e38, 1e10]
    compile_alone(write_table(make_table(1, channels, values), format_name, tmp_path))


@needs_validator
@every_shader
@pytest.mark.parametrize("name", ["float", "2 layers", "gl_skin", "thickness_mm", "a__b", "_"])
def test_unusual_names_compile(make_table, write_table, tmp_path, format_name, name):
    compile_alone(write_table(make_table(2, name=name), format_name, tmp_path))


@needs_validator
@every_shader
def test_reserved_words_compile(write_table, tmp_path, format_name):
    paths = []
    for word in sorted(RESERVED_WORDS):
        axis = Axis(word, "1", np.array([0.0, 1.0]))
        table = Table(word, "", (axis,), ("R",), np.zeros((2, 1)), "1")
        paths.append(write_table(table, format_name, tmp_path))
    compile_together(paths, "float3(table_void_lookup(0.5), 0.0, 0.0)", format_name)


@needs_validator
@every_shader
def test_table_with_one_entry_compiles(write_table, tmp_path, format_name):
    axis = Axis("thickness", "mm", np.array([2.0]))
    table = Table("one", "", (axis,), ("R",), np.array([[0.5]]), "1")
    compile_alone(write_table(table, format_name, tmp_path))


@needs_validator
@every_shader
def test_files_can_be_included_together_and_twice(make_table, write_table, tmp_path, format_name):
    paths = [
        write_table(make_table(1, 3, name="skin"), format_name, tmp_path),
        write_table(make_table(2, 3, name="marble", uniform=False), format_name, tmp_path),
    ]
    result = "skin_lookup(0.5) + marble_lookup(0.5, 1.0)"
    compile_together([*paths, paths[0]], result, format_name)


def compile_together(paths, result, format_name):
    """Compile a shader that includes several files and computes a vector of three from them."""
    directory = paths[0].parent
    includes = "\n".join(f'#include "{path.name}"' for path in paths)
    if format_name == "hlsl":
        text = f"{includes}\nfloat4 main() : SV_Target {{ return float4({result}, 1.0); }}\n"
        options = ["-D", "-e", "main"]
    else:
        text = (
            "#version 450\n#extension GL_GOOGLE_include_directive : require\n"
            f"{includes}\nlayout(location = 0) out vec4 color;\n"
            f"void main() {{ color = vec4({result.replace('float3', 'vec3')}, 1.0); }}\n"
        )
        options = []
    (directory / "all.txt").write_text(text)
    run([VALIDATOR, "-V", *options, "-S", "frag", "-o", "all.spv", "all.txt"], directory)


def hlsl_lookups(path, places, tmp_path):
    """Compile the HLSL text as C++ and evaluate its lookup function."""
    calls = "\n".join(
        f"  v = {path.stem}_lookup({', '.join(f'{number!r}f' for number in place)});"
        '  std::printf("%.9g %.9g %.9g\\n", v.r, v.g, v.b);'
        for place in places.astype(np.float32).tolist()
    )
    main = f"int main()\n{{\n  float3 v(0, 0, 0);\n{calls}\n}}\n"
    (tmp_path / "main.cpp").write_text(f'{CPP_FOR_HLSL}#include "{path.name}"\n{main}')
    run([CPP_COMPILER, "-o", "main", "main.cpp"], tmp_path)
    return np.loadtxt(run([str(tmp_path / "main")], tmp_path).splitlines())


@needs_cpp
@pytest.mark.parametrize("uniform", [True, False])
def test_linear_lookup(make_table, write_table, tmp_path, uniform):
    table = make_table(1, 3, uniform=uniform)
    axis = table.axes[0].values
    places = np.concatenate([[-1e9, -1.0, 20.0, 1e9], axis, np.linspace(-0.5, 9.5, 50)])
    found = hlsl_lookups(write_table(table, "hlsl", tmp_path), places[:, np.newaxis], tmp_path)
    for channel in range(3):
        expected = np.interp(places, axis, table.values[:, channel])
        np.testing.assert_allclose(found[:, channel], expected, atol=2e-5)


@needs_cpp
@pytest.mark.parametrize("uniform", [True, False])
def test_bilinear_lookup(make_table, write_table, tmp_path, uniform):
    table = make_table(2, 3, uniform=uniform)
    rows, columns = (axis.values for axis in table.axes)
    places = np.random.default_rng(5).uniform([-1.0, 0.0], [10.0, 2.0], (60, 2))
    found = hlsl_lookups(write_table(table, "hlsl", tmp_path), places, tmp_path)
    for channel in range(3):
        expected = [
            np.interp(column, columns, [np.interp(row, rows, line) for line in by_column])
            for (row, column), by_column in ((place, table.values[:, :, channel].T) for place in places)
        ]
        np.testing.assert_allclose(found[:, channel], expected, atol=2e-5)


@every_shader
def test_axis_that_does_not_increase(make_table, format_name):
    for values in ([0.0, 1.0, 1.0], [2.0, 1.0, 0.0], [1.0, 1.0 + 1e-12, 2.0], [0.0, 1.0, 1e39]):
        axis = Axis("thickness", "mm", np.array(values))
        table = Table("skin", "", (axis,), ("R",), np.zeros((3, 1)), "1")
        with pytest.raises(ValueError, match="axis 'thickness' of table 'skin' must increase"):
            encode_table(table, format_name)


@every_shader
def test_large_array_is_marked(format_name):
    axis = Axis("thickness", "mm", np.arange(4097.0))
    table = Table("skin", "", (axis,), ("R",), np.zeros((4097, 1)), "1")
    text = encode_table(table, format_name)[f".{format_name}"].decode("utf-8")
    assert "Some compilers need minutes for 4097 entries" in text


def test_identifiers_hold_no_double_underscore():
    for text in ("a__b", "_a_", "a - b", "gl_a", "1", "µ"):
        name = identifier(text)
        assert name.isidentifier() and "__" not in name and not name.startswith(("_", "gl_"))
