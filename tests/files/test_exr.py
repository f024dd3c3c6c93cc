"""EXR images keep every number and the text in the header, and their bytes do not vary."""

import os
import tempfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from sssfit.files import exr
from sssfit.files.errors import FileError
from sssfit.files.exr import encode_exr, read_exr

PIXELS = st.sampled_from([np.float16, np.float32]).flatmap(
    lambda dtype: arrays(dtype, array_shapes(min_dims=2, max_dims=2, max_side=40))
)


def round_trip(channels, attributes):
    with tempfile.NamedTemporaryFile(suffix=".exr") as stream:
        stream.write(encode_exr(channels, attributes))
        stream.flush()
        return read_exr(stream.name)


@settings(deadline=None)  # the time to write a file varies
@given(PIXELS, st.text(st.characters(codec="utf-8", exclude_characters="\0")))
def test_round_trip_keeps_every_bit(pixels, text):
    channels, attributes = round_trip({"R": pixels, "name with blanks": -pixels}, {"note": text})
    assert list(channels) == ["R", "name with blanks"]
    assert channels["R"].dtype == pixels.dtype
    assert channels["R"].tobytes() == pixels.tobytes()
    assert channels["name with blanks"].tobytes() == (-pixels).tobytes()
    assert attributes == {"note": text}


def test_pixels_need_not_be_contiguous():
    values = np.arange(30, dtype=np.float32).reshape(2, 5, 3)
    channels, _ = round_trip({name: values[..., i] for i, name in enumerate("RGB")}, {})
    for index, name in enumerate("RGB"):
        np.testing.assert_array_equal(channels[name], values[..., index])


def test_bytes_are_the_same_every_time_and_name_no_directory():
    pixels = np.linspace(0.0, 1.0, 600, dtype=np.float32).reshape(20, 30)
    data = encode_exr({"Y": pixels}, {"note": "x"})
    assert data == encode_exr({"Y": pixels.copy()}, {"note": "x"})
    assert tempfile.gettempdir().encode() not in data


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_each_channel_keeps_its_own_kind(height, width, seed):
    generator = np.random.default_rng(seed)
    words = generator.integers(0, 2**32, (height, width), np.uint32)
    halves = generator.integers(0, 2**16, (height, width), np.uint16).view(np.float16)
    # NaN of every kind included: bits are compared, not values.
    expected = {"E.R": halves, "depth": words.view(np.float32)[::-1], "id": words}
    channels, _ = round_trip(expected, {})
    for name, values in expected.items():
        assert channels[name].dtype == values.dtype
        assert channels[name].tobytes() == values.tobytes()


def test_attributes_do_not_change_how_the_image_is_stored():
    pixels = np.zeros((2, 2), dtype=np.float16)
    assert encode_exr({"Y": pixels}, {"compression": "x"}) == encode_exr({"Y": pixels}, {})


@pytest.mark.parametrize(
    "channels",
    [
        {},
        {"Y": np.zeros((2, 2))},
        {"Y": np.zeros(2, dtype=np.float32)},
        {"Y": np.zeros((0, 2), dtype=np.float32)},
        {"R": np.zeros((1, 2), dtype=np.float32), "G": np.zeros((1, 3), dtype=np.float32)},
        {"R": np.zeros((1, 2), dtype=np.float32), "G": np.zeros((1, 2), dtype=np.int32)},
        {"R": np.zeros((1, 2), dtype=np.float32), "G": np.zeros((1, 2), dtype=">f4")},
    ],
)
def test_other_pixels_are_refused(channels):
    with pytest.raises(ValueError, match="must each be float32, float16 or uint32, with one shape"):
        encode_exr(channels, {})


def test_no_room_for_the_temporary_image(monkeypatch):
    def full(*args):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(exr.tempfile, "TemporaryDirectory", full)
    with pytest.raises(FileError, match=r"cannot be written \(.*No space left.*; free space"):
        encode_exr({"Y": np.zeros((2, 2), dtype=np.float32)}, {})


@pytest.mark.parametrize("content", [b"", b"v/1", b"not an image", b"v/1\x01"])
def test_files_that_are_no_images(tmp_path, content):
    (tmp_path / "t.exr").write_bytes(content)
    with pytest.raises(FileError, match=r"t\.exr: is (not an EXR image|truncated or damaged)"):
        read_exr(tmp_path / "t.exr")


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_truncated_images_are_refused(tmp_path, part, capfd):
    values = np.random.default_rng(1).random((64, 100), dtype=np.float32)
    data = encode_exr({"Y": values}, {})
    (tmp_path / "t.exr").write_bytes(data[: int(part * len(data))])
    with pytest.raises(FileError, match="is truncated or damaged"):
        read_exr(tmp_path / "t.exr")
    # The library would print several lines.
    assert capfd.readouterr() == ("", "")
    print("heard")
    os.write(2, b"again")
    assert capfd.readouterr() == ("heard\n", "again")
