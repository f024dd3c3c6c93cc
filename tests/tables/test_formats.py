"""Every file format gives a table back within the error that it states."""

import hashlib
import io
import json
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from sssfit.tables import Axis, Table, load
from sssfit.tables.formats import ENCODERS, encode_table
from sssfit.tables.formats.naming import float_text

HALF_FORMATS = ("exr-half", "dds")
FLOAT_FORMATS = ("exr", "npz", "csv", "hlsl", "glsl")
LARGEST_HALF = 65504.0
LARGEST_FLOAT = float(np.finfo(np.float32).max)

every_format = pytest.mark.parametrize("format_name", list(ENCODERS))


def values_up_to(largest):
    """Draw values of a 1-D table, with infinities, NaN, -0.0 and subnormal numbers."""
    numbers = st.floats(-largest, largest) | st.sampled_from(
        [np.inf, -np.inf, np.nan, -0.0, 6e-8, 1e-45, 5e-324, largest]
    )
    return arrays(np.float64, (7, 3), elements=numbers)


@every_format
@pytest.mark.parametrize("dimensions", [1, 2])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_round_trip(make_table, write_table, tmp_path, format_name, dimensions, channels):
    table = make_table(dimensions, channels)
    loaded = load(write_table(table, format_name, tmp_path))
    assert (loaded.name, loaded.description, loaded.unit) == (
        table.name,
        table.description,
        table.unit,
    )
    assert loaded.channels == table.channels
    assert loaded.parameters == table.parameters | {"reach": "inf"}
    for axis, expected in zip(loaded.axes, table.axes, strict=True):
        assert (axis.name, axis.unit) == (expected.name, expected.unit)
        np.testing.assert_array_equal(axis.values, expected.values)
    errors = np.abs(loaded.values - table.values)
    assert loaded.values.dtype == np.float64
    assert errors.max() == loaded.quantization["max_abs_error"] > 0.0
    relative = (errors / np.abs(table.values)).max()
    assert relative == loaded.quantization["max_rel_error"] > 0.0


@pytest.mark.parametrize("format_name", FLOAT_FORMATS)
@settings(deadline=None)  # the time to write a file varies
@given(values=values_up_to(LARGEST_FLOAT))
def test_float_formats_keep_every_float32(make_table, write_table, format_name, values):
    assert_stored_as(np.float32, make_table(values=values), write_table, format_name)


@pytest.mark.parametrize("format_name", HALF_FORMATS)
@settings(deadline=None)  # the time to write a file varies
@given(values=values_up_to(LARGEST_HALF))
def test_half_formats_keep_every_half(make_table, write_table, format_name, values):
    assert_stored_as(np.float16, make_table(values=values), write_table, format_name)


def assert_stored_as(dtype, table, write_table, format_name):
    with tempfile.TemporaryDirectory() as directory:
        loaded = load(write_table(table, format_name, Path(directory)))
    expected = table.values.astype(dtype).astype(np.float64)
    np.testing.assert_array_equal(loaded.values, expected)
    numbers = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(loaded.values[numbers]), np.signbit(expected[numbers]))


@settings(deadline=None)  # the time to write a file varies
@given(values=values_up_to(LARGEST_FLOAT))
def test_preview_is_within_half_a_step(make_table, write_table, values):
    table = make_table(values=values)
    with tempfile.TemporaryDirectory() as directory:
        loaded = load(write_table(table, "png", Path(directory)))
    finite = np.isfinite(values)
    quantization = loaded.quantization
    low, high = quantization["minimum"], quantization["maximum"]
    assert quantization["non_finite_entries"] == np.count_nonzero(~finite)
    assert quantization["max_abs_error"] <= 0.5001 * (high - low) / 255.0
    if finite.any():
        assert (low, high) == (values[finite].min(), values[finite].max())
    np.testing.assert_array_equal(loaded.values[values == np.inf], high)
    np.testing.assert_array_equal(loaded.values[np.isnan(values) | (values == -np.inf)], low)


@given(st.floats(width=32))
def test_text_of_a_float_gives_it_back_through_a_double(number):
    value = np.float32(number)
    np.testing.assert_equal(np.float32(float(float_text(value))), value)


def test_bytes_do_not_depend_on_the_time_or_the_place(make_table, tmp_path, monkeypatch):
    table = make_table(2)
    first = {name: encode_table(table, name) for name in ENCODERS}
    # Longer than the time step of ZIP archives.
    time.sleep(2.1)
    monkeypatch.chdir(tmp_path)
    assert {name: encode_table(table, name) for name in ENCODERS} == first
    for files in first.values():
        for data in files.values():
            assert tempfile.gettempdir().encode() not in data


@every_format
def test_file_name_suffixes(make_table, format_name):
    expected = {
        "exr-half": [".half.exr"],
        "dds": [".dds", ".dds.json"],
        "png": [".preview.png"],
    }.get(format_name, [f".{format_name}"])
    assert list(encode_table(make_table(), format_name)) == expected


def test_metadata(make_table, write_table, tmp_path):
    table = make_table(2)
    loaded = load(write_table(table, "exr", tmp_path))
    metadata = loaded.metadata
    assert metadata["format_version"] == 1
    assert metadata["dtype"] == "float"
    assert set(metadata["versions"]) == {"sssfit", "jax", "numpy"}
    assert [(axis["name"], axis["unit"], axis["size"]) for axis in metadata["axes"]] == [
        ("thickness", "mm", 7),
        ("sigma_t", "1/mm", 3),
    ]
    stored = table.values.astype("<f4").tobytes()
    assert metadata["content_sha256"] == hashlib.sha256(stored).hexdigest()


def test_exr_as_other_programs_see_it(make_table, write_table, tmp_path):
    table = make_table(2)
    for format_name, dtype in (("exr", np.float32), ("exr-half", np.float16)):
        path = write_table(table, format_name, tmp_path)
        with OpenEXR.File(str(path), separate_channels=True) as image:
            for index, name in enumerate(table.channels):
                pixels = image.channels()[name].pixels
                np.testing.assert_array_equal(pixels, table.values[..., index].astype(dtype))


def test_npz_as_numpy_sees_it(make_table):
    table = make_table(2)
    data = encode_table(table, "npz")[".npz"]
    with np.load(io.BytesIO(data)) as archive:
        assert set(archive.files) == {"values", "axis_0", "axis_1", "metadata"}
        np.testing.assert_array_equal(archive["values"], table.values.astype(np.float32))
        np.testing.assert_array_equal(archive["axis_1"], table.axes[1].values)
        assert json.loads(str(archive["metadata"]))["name"] == table.name
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_csv_as_numpy_sees_it(make_table):
    table = make_table(2)
    lines = encode_table(table, "csv")[".csv"].decode("utf-8").splitlines()
    assert json.loads(lines[0].removeprefix("# "))["unit"] == table.unit
    assert lines[1] == "thickness_mm,sigma_t_per_mm,R,G,B"
    cells = np.loadtxt(lines, delimiter=",", skiprows=2)
    np.testing.assert_array_equal(cells[1, :2], [0.0, 1.0])
    np.testing.assert_array_equal(
        cells[:, 2:].astype(np.float32), table.values.reshape(-1, 3).astype(np.float32)
    )


def test_csv_survives_windows_line_ends(make_table, write_table, tmp_path):
    path = write_table(make_table(), "csv", tmp_path)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert load(path).name == "skin"


@pytest.mark.parametrize("dimensions, size", [(1, (7, 32)), (2, (3, 7))])
@pytest.mark.parametrize("channels, mode", [(1, "L"), (2, "RGB"), (3, "RGB"), (4, "RGBA")])
def test_preview_as_viewers_see_it(make_table, dimensions, size, channels, mode):
    table = make_table(dimensions, channels)
    with Image.open(io.BytesIO(encode_table(table, "png")[".preview.png"])) as image:
        assert (image.mode, image.size) == (mode, size)
        pixels = np.atleast_3d(np.asarray(image))
    low, high = table.values.min(), table.values.max()
    expected = np.rint((table.values - low) / (high - low) * 255.0)
    for row in range(size[1]):
        expected_row = expected if dimensions == 1 else expected[row]
        np.testing.assert_array_equal(pixels[row, :, :channels], expected_row)


def test_preview_of_a_constant_table(make_table, write_table, tmp_path):
    table = make_table(values=np.full((7, 3), 0.25))
    np.testing.assert_array_equal(load(write_table(table, "png", tmp_path)).values, table.values)


@pytest.mark.parametrize("format_name", HALF_FORMATS)
@pytest.mark.parametrize("value", [65504.001, -1e6, 1e300])
def test_values_beyond_half_are_refused(make_table, format_name, value):
    table = make_table()
    table.values[3, 1] = value
    with pytest.raises(ValueError) as caught:
        encode_table(table, format_name)
    assert str(caught.value) == (
        f"table 'skin' holds {value!r}, beyond the largest half number 65504.0; "
        "scale its values, or write it as exr, npz or csv"
    )


@every_format
def test_values_beyond_float_are_refused(make_table, format_name):
    table = make_table()
    table.values[3, 1] = -3.5e38
    with pytest.raises(ValueError, match=r"table 'skin' holds -3.5e\+38, .*; scale its values"):
        encode_table(table, format_name)


def test_tables_that_no_format_holds():
    axis = Axis("x", "mm", np.array([0.0, 1.0]))
    for name, axes, channels, message in (
        ("a/b", (axis,), ("R",), "table name 'a/b'"),
        ("", (axis,), ("R",), "table name ''"),
        ("t", (axis, axis), ("R",), "1 to 2 axes with distinct names"),
        ("t", (), ("R",), "1 to 2 axes"),
        ("t", (axis,), ("R", "R"), "1 to 4 channels with distinct names"),
        ("t", (axis,), tuple("abcde"), "1 to 4 channels"),
        ("t", (Axis("x", "mm", np.array([0.0, np.nan])),), ("R",), "finite values only"),
        ("t", (Axis("x", "mm", np.array([])),), ("R",), "at least one value"),
    ):
        values = np.zeros((*(len(a.values) for a in axes), len(channels)))
        with pytest.raises(ValueError, match=message):
            encode_table(Table(name, "", axes, channels, values, "1"), "npz")


def test_unknown_format(make_table):
    with pytest.raises(ValueError, match="must be one of exr, exr-half, dds.*; got 'tiff'"):
        encode_table(make_table(), "tiff")
