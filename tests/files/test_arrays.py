"""CSV and NPZ bytes: every number comes back, and nothing but the content decides them."""

import csv
import io
import locale
import math
import time
import zipfile

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sssfit.files.arrays import csv_bytes, npz_bytes

floats = st.floats(allow_nan=True, allow_infinity=True)
columns_of_one_length = st.integers(0, 6).flatmap(
    lambda n: st.tuples(st.lists(floats, min_size=n, max_size=n), st.lists(floats, min_size=n, max_size=n))
)


def parsed(data):
    header, *rows = csv.reader(io.StringIO(data.decode(), newline=""))
    return header, rows


# CSV


def test_header_and_rows():
    found = csv_bytes({"frame": np.arange(2), "name": ["a", "b"], "lit": np.array([True, False])})
    assert found == b"frame,name,lit\n0,a,True\n1,b,False\n"


@given(columns_of_one_length)
def test_floats_come_back_bit_for_bit(columns):
    header, rows = parsed(csv_bytes({"x": columns[0], "y": np.array(columns[1])}))
    assert header == ["x", "y"] and len(rows) == len(columns[0])
    found = np.array([[float(cell) for cell in row] for row in rows]).reshape(-1, 2).T
    for column, expected in zip(found, columns, strict=True):
        assert np.array_equal(column, expected, equal_nan=True)
        assert np.array_equal(np.signbit(column), np.signbit(np.where(np.isnan(expected), column, expected)))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_no_shorter_text_gives_the_float_back(value):
    ((text,),) = parsed(csv_bytes({"x": [value]}))[1]
    # 17 significant digits always do; fewer must not where ours has more than they.
    digits = len(text.lower().split("e")[0].replace("-", "").replace(".", "").strip("0"))
    assert all(float(f"{value:.{fewer}e}") != value for fewer in range(max(digits - 1, 0)))


@pytest.mark.parametrize("kind", [np.float16, np.float32])
def test_small_floats_come_back(kind):
    values = np.array([0.1, 1 / 3, 65504.0, 6e-8, -0.0], kind)
    found = np.array([row[0] for row in parsed(csv_bytes({"x": values}))[1]]).astype(float).astype(kind)
    assert found.tobytes() == values.tobytes()


def test_text_that_needs_quotes():
    texts = ["a,b", 'say "c"', "two\nlines", "\u00e4 \u03b1"]
    header, rows = parsed(csv_bytes({"a,b": texts, "n": [1, 2, 3, 4]}))
    assert header == ["a,b", "n"] and [row[0] for row in rows] == texts


def test_numpy_and_pandas_read_it():
    columns = {"frame": np.arange(40), "value": np.random.default_rng(0).normal(size=40) * 1e-5}
    data = csv_bytes(columns)
    found = np.genfromtxt(io.BytesIO(data), delimiter=",", names=True, dtype=None)
    assert found.dtype.names == ("frame", "value")
    assert all((found[name] == columns[name]).all() for name in columns)
    # Pandas reads the last digit as it likes.
    assert pd.read_csv(io.BytesIO(data))["value"].to_numpy() == pytest.approx(columns["value"], rel=1e-15)


def test_columns_in_the_order_given_and_without_rows():
    assert csv_bytes({"b": [], "a": []}) == b"b,a\n"


@pytest.mark.parametrize("lengths", [(2, 3), (3, 2), (0, 1), (4, 4, 3)])
def test_unequal_lengths_are_refused(lengths):
    with pytest.raises(ValueError):
        csv_bytes({f"column {i}": np.zeros(n) for i, n in enumerate(lengths)})


def test_csv_does_not_follow_the_locale():
    columns = {"x": [1234567.5, 0.25]}
    before, earlier = csv_bytes(columns), locale.setlocale(locale.LC_ALL)
    with_comma = [name for name in ("de_DE.UTF-8", "de_DE", "fr_FR.UTF-8") if _has_locale(name)]
    try:
        for name in [*with_comma, "C"]:
            locale.setlocale(locale.LC_ALL, name)
            assert csv_bytes(columns) == before == b"x\n1234567.5\n0.25\n"
    finally:
        locale.setlocale(locale.LC_ALL, earlier)


def _has_locale(name):
    earlier = locale.setlocale(locale.LC_ALL)
    try:
        locale.setlocale(locale.LC_ALL, name)
    except locale.Error:
        return False
    locale.setlocale(locale.LC_ALL, earlier)
    return True


# NPZ

some_arrays = hnp.arrays(
    st.sampled_from([np.float32, np.float64, np.int32, np.int64, np.bool_, np.complex64]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)


@given(st.dictionaries(st.from_regex(r"[a-z_+ ]{1,12}", fullmatch=True), some_arrays, max_size=4))
def test_arrays_come_back(arrays):
    with np.load(io.BytesIO(npz_bytes(arrays)), allow_pickle=False) as archive:
        assert archive.files == list(arrays)
        for name, expected in arrays.items():
            assert archive[name].dtype == expected.dtype and archive[name].shape == expected.shape
            assert archive[name].tobytes() == expected.tobytes()


def test_layouts_come_back():
    grid = np.arange(12.0).reshape(3, 4)
    arrays = {
        "columns first": np.asfortranarray(grid),
        "slice": grid[::2, ::-1],
        "swapped": grid.astype(">f8"),
    }
    with np.load(io.BytesIO(npz_bytes(arrays))) as archive:
        assert all(np.array_equal(archive[name], value) for name, value in arrays.items())


def test_lists_and_numbers_become_arrays():
    with np.load(io.BytesIO(npz_bytes({"list": [1, 2], "number": 0.5}))) as archive:
        assert archive["list"].tolist() == [1, 2] and archive["number"].shape == ()


def test_what_only_pickle_could_hold_is_refused():
    with pytest.raises(ValueError, match="allow_pickle"):
        npz_bytes({"x": np.array([{}, None], dtype=object)})


def test_the_same_bytes_at_any_time(monkeypatch):
    arrays = {"x": np.arange(5), "y": np.zeros((2, 0))}
    before = npz_bytes(arrays)
    monkeypatch.setattr(time, "time", lambda: 2e9)
    monkeypatch.setattr(time, "localtime", lambda *_: time.gmtime(1.9e9))
    monkeypatch.setenv("TZ", "Asia/Kolkata")
    assert npz_bytes(arrays) == before
    assert npz_bytes({name: array.copy() for name, array in arrays.items()}) == before
    with zipfile.ZipFile(io.BytesIO(before)) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert {(entry.compress_type, entry.create_system) for entry in archive.infolist()} == {(0, 3)}


def test_another_content_has_other_bytes():
    assert npz_bytes({"x": [1.0]}) != npz_bytes({"x": [math.nextafter(1.0, 2.0)]})
    assert npz_bytes({"x": [1.0]}) != npz_bytes({"y": [1.0]})
