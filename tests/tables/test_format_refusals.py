"""A file that disagrees with its own metadata is refused, with the reason and a remedy."""

import io
import re

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from sssfit.files.errors import FileError
from sssfit.files.exr import encode_exr, read_exr
from sssfit.tables import load
from sssfit.tables.formats import ENCODERS

REMEDY = "; restore the file or write the table again"
CHANGED = "values were changed: they disagree with the content_sha256" + REMEDY

every_format = pytest.mark.parametrize("format_name", list(ENCODERS))
every_shader = pytest.mark.parametrize("format_name", ["hlsl", "glsl"])


def edit(path, pattern, replacement):
    """Change the first match of a pattern in a text file."""
    text, count = re.subn(pattern, replacement, path.read_text(encoding="utf-8"), count=1)
    assert count == 1
    path.write_text(text, encoding="utf-8")


def edit_npz(path, **changes):
    with np.load(path) as archive:
        arrays = dict(archive) | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


def edit_exr(path, change):
    channels, attributes = read_exr(path)
    change(channels, attributes)
    path.write_bytes(encode_exr(channels, attributes))


def edit_png(path, change, keep_text=True):
    with Image.open(path) as image:
        pixels = np.array(image)
        text = PngImagePlugin.PngInfo()
        if keep_text:
            text.add_itxt("sssfit", image.info["sssfit"])
    stream = io.BytesIO()
    Image.fromarray(change(pixels)).save(stream, "PNG", pnginfo=text)
    path.write_bytes(stream.getvalue())


@pytest.mark.parametrize("name", ["t.tiff", "t", "t.dds.json", ".exr"])
def test_unknown_suffix(refusal_of, name):
    assert "is not one of a table; use a file with one of .exr, .dds, .npz" in refusal_of(name)


@every_format
def test_missing_file(refusal_of, tmp_path, make_table, write_table, format_name):
    path = write_table(make_table(), format_name, tmp_path)
    path.unlink()
    assert refusal_of(path) == f"{path}: there is no such file; check the path"
    path.mkdir()
    assert "cannot be read (is a directory); check the path" in refusal_of(path)


@every_format
@pytest.mark.parametrize("part", [0.0, 0.02, 0.3, 0.6, 0.9, 0.99])
def test_truncated_file(refusal_of, tmp_path, make_table, write_table, format_name, part):
    path = write_table(make_table(2), format_name, tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    message = refusal_of(path)
    assert message.startswith(str(path)) and "; " in message


@every_format
def test_every_byte_counts(tmp_path, make_table, write_table, format_name):
    """A file without its last bytes is refused, or still gives every value."""
    table = make_table(2)
    path = write_table(table, format_name, tmp_path)
    expected = load(path).values
    data = path.read_bytes()
    for missing in range(1, 30):
        path.write_bytes(data[:-missing])
        try:
            np.testing.assert_array_equal(load(path).values, expected)
        except FileError:
            continue
        assert missing <= 16, "a file that lacks content was read"


@every_format
def test_changed_bytes_never_change_values_silently(tmp_path, make_table, write_table, format_name):
    path = write_table(make_table(2), format_name, tmp_path)
    expected = load(path)
    data = path.read_bytes()
    generator = np.random.default_rng(3)
    for place in generator.integers(0, len(data), 60):
        changed = bytearray(data)
        changed[place] ^= 1 << generator.integers(0, 8)
        path.write_bytes(changed)
        try:
            loaded = load(path)
        except FileError:
            continue
        np.testing.assert_array_equal(loaded.values, expected.values)
        assert loaded.metadata == expected.metadata


@every_format
def test_metadata_missing(refusal_of, tmp_path, make_table, write_table, format_name):
    path = write_table(make_table(), format_name, tmp_path)
    expected = f"{path}: has no sssfit metadata; load a table that sssfit wrote"
    if format_name == "dds":
        path.with_name("skin.dds.json").unlink()
        expected = f"{path}: its metadata file skin.dds.json is missing beside it{REMEDY}"
    elif format_name == "npz":
        edit_npz(path, metadata=None)
    elif format_name == "png":
        edit_png(path, np.array, keep_text=False)
    elif format_name.startswith("exr"):
        edit_exr(path, lambda channels, attributes: attributes.clear())
    else:
        edit(path, r"^# .*\n|/\* sssfit metadata\n", "")
    assert refusal_of(path) == expected


@every_format
def test_metadata_not_json(refusal_of, tmp_path, make_table, write_table, format_name):
    path = write_table(make_table(), format_name, tmp_path)
    if format_name == "dds":
        path.with_name("skin.dds.json").write_text("{")
    elif format_name == "npz":
        edit_npz(path, metadata=np.array("{"))
    elif format_name == "png":
        data = path.read_bytes()
        text = PngImagePlugin.PngInfo()
        text.add_itxt("sssfit", "{")
        with Image.open(io.BytesIO(data)) as image:
            image.save(path, "PNG", pnginfo=text)
    elif format_name.startswith("exr"):
        edit_exr(path, lambda channels, attributes: attributes.update(sssfit="{"))
    else:
        edit(path, '"name":', '"name"')
    message = refusal_of(path)
    assert message.startswith(str(path)) and "is not valid JSON" in message


@every_format
def test_one_value_changed(refusal_of, tmp_path, make_table, write_table, format_name):
    path = write_table(make_table(2), format_name, tmp_path)
    if format_name == "dds":
        data = bytearray(path.read_bytes())
        data[148] ^= 1
        path.write_bytes(data)
    elif format_name == "npz":
        with np.load(path) as archive:
            values = archive["values"]
        values[2, 1, 0] *= 1.001
        edit_npz(path, values=values)
    elif format_name == "png":

        def change(pixels):
            pixels[1, 2, 0] ^= 1
            return pixels

        edit_png(path, change)
    elif format_name.startswith("exr"):

        def negate(channels, attributes):
            channels["G"][1, 2] *= -1

        edit_exr(path, negate)
    elif format_name == "csv":
        edit(path, r"\n0\.0,1\.0,-?", r"\n0.0,1.0,1")
    else:
        edit(path, r"\n    (vec3|float3)\(", r"\n    \g<1>(1")
    assert refusal_of(path) == f"{path}: {CHANGED}"


@pytest.mark.parametrize("offset", [4, 20, 84, 128, 140])
def test_dds_header_changed(refusal_of, tmp_path, make_table, write_table, offset):
    path = write_table(make_table(), "dds", tmp_path)
    data = bytearray(path.read_bytes())
    data[offset] += 1
    path.write_bytes(data)
    assert "header is not of an R16G16B16A16_FLOAT texture" in refusal_of(path)


@pytest.mark.parametrize(
    "pattern, replacement, problem",
    [
        ("thickness_mm", "thickness_cm", "columns are thickness_cm,R,G,B but the metadata say"),
        (r"\n5\.0,.*", "", "has 6 rows but the metadata say 7"),
        (r"\n0\.0,", r"\n0.001,", "line 3: axis values disagree with the metadata"),
        (r"\n0\.0,[^,]*,", r"\n0.0,x,", "line 3: holds something that is not a number"),
        (r"\n0\.0,[^,]*,", r"\n0.0,1e39,", CHANGED),
        (r"\n0\.0,[^,]*,", r"\n0.0,", "line 3: has 3 cells instead of 4"),
        (r"\nthickness_mm[^$]*", "", "columns are nothing but the metadata say"),
        (r"\n0\.0,", "\n\0,", "line 3: holds something|is not CSV text"),
    ],
)
def test_csv_changed(refusal_of, tmp_path, make_table, write_table, pattern, replacement, problem):
    path = write_table(make_table(), "csv", tmp_path)
    edit(path, pattern, replacement)
    assert any(part in refusal_of(path) for part in problem.split("|"))


@every_shader
@pytest.mark.parametrize(
    "uniform, pattern, replacement, problem",
    [
        (True, r"_scale = ", "_scale = 2", "constants skin_thickness_... disagree with the axis"),
        (False, r"\n    0\.1,", "\n    0.2,", "constants skin_thickness_... disagree with the axis"),
        (True, r"\n    (vec|float)3\(.*", "", "array skin has 6 entries but the metadata say 7"),
        (True, r"(vec|float)3\([^,]*,", r"\1(x,", "skin[0]: "),
        (True, r"3\([^,]*,", "3(1e39,", CHANGED),
        (True, r" skin\[7\]", " skim[7]", "holds no array skin"),
        (True, r"#endif // .*", "", "is truncated: it does not end with '#endif // SSSFIT_TABLE_"),
        (True, r"\*/[^$]*", "", "is truncated in its metadata"),
    ],
)
def test_shader_changed(
    refusal_of, tmp_path, make_table, write_table, format_name, uniform, pattern, replacement, problem
):
    path = write_table(make_table(uniform=uniform), format_name, tmp_path)
    edit(path, f"(?<=\n){pattern}" if pattern.startswith("\\*/") else pattern, replacement)
    message = refusal_of(path)
    assert message.startswith(str(path)) and problem in message


def test_npz_changed(refusal_of, tmp_path, make_table, write_table):
    def refusal_after(**changes):
        path = write_table(make_table(), "npz", tmp_path)
        edit_npz(path, **changes)
        return refusal_of(path)

    disagrees = "disagrees with the axes in the metadata"
    assert f"array 'axis_0' {disagrees}" in refusal_after(axis_0=np.arange(7.0))
    assert f"array 'axis_0' {disagrees}" in refusal_after(axis_0=None)
    assert f"array 'axis_1' {disagrees}" in refusal_after(axis_1=np.arange(2.0))
    assert "has no array 'values'" in refusal_after(values=None)
    flat = np.zeros(21, dtype=np.float32)
    assert "values have shape (21,) but the metadata say (7, 3)" in refusal_after(values=flat)
    double = np.zeros((7, 3))
    assert "values are float64 but the metadata say 'float'" in refusal_after(values=double)


def test_npz_that_is_no_archive(refusal_of, tmp_path, make_table, write_table):
    path = write_table(make_table(), "npz", tmp_path)
    with open(path, "wb") as stream:
        np.save(stream, np.zeros(3))
    assert "is truncated, damaged or no NumPy archive" in refusal_of(path)


def test_exr_changed(refusal_of, tmp_path, make_table, write_table):
    def refusal_after(change):
        path = write_table(make_table(), "exr", tmp_path)
        edit_exr(path, change)
        return refusal_of(path)

    def rename(channels, attributes):
        channels["B2"] = channels.pop("B")

    def halve(channels, attributes):
        channels.update({name: pixels.astype(np.float16) for name, pixels in channels.items()})

    def crop(channels, attributes):
        channels.update({name: pixels[:, :4] for name, pixels in channels.items()})

    renamed = "channels are ['B2', 'G', 'R'] but the metadata say ['R', 'G', 'B']"
    assert renamed in refusal_after(rename)
    assert "values are float16 but the metadata say 'float'" in refusal_after(halve)
    assert "the image has 4 x 1 pixels but the metadata say 7 x 1" in refusal_after(crop)


def test_preview_changed(refusal_of, tmp_path, make_table, write_table):
    def refusal_after(change, dimensions=1, channels=2):
        path = write_table(make_table(dimensions, channels), "png", tmp_path)
        edit_png(path, change)
        return refusal_of(path)

    assert "channels are not those of 2 table channels" in refusal_after(lambda p: p | 1)
    assert "channels are not those of 2 table channels" in refusal_after(lambda p: p[..., 0])
    assert "is not a strip of 32 equal rows" in refusal_after(lambda p: p[1:])
    assert "3 x 6 pixels but the metadata say 3 x 7" in refusal_after(lambda p: p[1:], 2)
