"""JSON text is strict, sorted and the same whenever the content is the same."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files.errors import FileError
from sssfit.files.json_text import json_line, json_text, parse_json, read_json, sha256_bytes

JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda items: st.lists(items) | st.dictionaries(st.text(), items),
)


def strict(text):
    def refuse(name):
        raise AssertionError(f"{name} is not strict JSON")

    return json.loads(text, parse_constant=refuse)


def with_words(value):
    """Replace infinities by the words that stand for them."""
    if isinstance(value, dict):
        return {key: with_words(item) for key, item in value.items()}
    if isinstance(value, list):
        return [with_words(item) for item in value]
    return str(value) if isinstance(value, float) and math.isinf(value) else value


@given(JSON_VALUES)
def test_text_is_strict_json_and_keeps_every_digit(value):
    assert strict(json_text(value)) == strict(json_line(value)) == with_words(value)
    assert "\n" not in json_line(value)


def test_text_is_sorted_and_readable():
    assert json_text({"b": 0.1, "a": ["µm", True]}) == (
        '{\n  "a": [\n    "µm",\n    true\n  ],\n  "b": 0.1\n}\n'
    )
    assert json_text({"b": 1, "a": 2}) == json_text({"a": 2, "b": 1})


def test_numpy_values_and_negative_zero():
    value = {"a": np.float32(0.5), "b": np.array([-0.0, np.nan]), "c": np.int64(3), "d": (1,)}
    assert json_line(value) == '{"a": 0.5, "b": [-0.0, "nan"], "c": 3, "d": [1]}'


@pytest.mark.parametrize("value", [{1: "a"}, {"a": object()}, [b"bytes"], {"a": {1, 2}}])
def test_other_types_are_refused(value):
    with pytest.raises(TypeError, match="JSON"):
        json_text(value)


@pytest.mark.parametrize("text", ["", "{", "{'a': 1}", "[NaN]", "[Infinity]", "[" * 100000])
def test_text_that_is_not_json(text, tmp_path):
    with pytest.raises(FileError, match=r"^t.json, metadata: is not valid JSON"):
        parse_json(text, "t.json", "metadata")
    (tmp_path / "t.json").write_text(text)
    with pytest.raises(FileError, match=r"t.json: is not valid JSON .*; restore the file"):
        read_json(tmp_path / "t.json")


def test_read_json_round_trip(tmp_path):
    value = {"a": [0.1, None, "µm"]}
    (tmp_path / "t.json").write_text(json_text(value), encoding="utf-8")
    assert read_json(tmp_path / "t.json") == value


def test_read_json_from_what_is_no_text_file(tmp_path):
    with pytest.raises(FileError, match="cannot be read"):
        read_json(tmp_path)
    (tmp_path / "t.json").write_bytes(b'"\xff"')
    with pytest.raises(FileError, match="is not UTF-8 text"):
        read_json(tmp_path / "t.json")


def test_digest_of_a_known_text():
    assert sha256_bytes(b"abc") == ("ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad")
