"""References: what is read, and what is refused."""

import numpy as np
import pytest

from sssfit.files.errors import FileError
from sssfit.files.exr import encode_exr
from sssfit.frames import reference

SHAPE = (5, 7)
RANDOM = np.random.default_rng(3)
SSS, DIFF = RANDOM.random((2, *SHAPE, 3)).astype(np.float16)
MASK = RANDOM.random(SHAPE) > 0.4


def written(path, **layers):
    channels = {
        f"{name}.{c}": np.ascontiguousarray(v[..., i])
        for name, v in layers.items()
        for i, c in enumerate("RGB")
    }
    path.write_bytes(encode_exr(channels, {}))
    return path


def test_both_layers_are_read(tmp_path):
    found = reference.load(written(tmp_path / "a.exr", sss=SSS, diff=DIFF), MASK)
    np.testing.assert_array_equal(found.sss, SSS.astype(np.float32))
    np.testing.assert_array_equal(found.diff, DIFF.astype(np.float32))
    assert found.noisy and found.sss.dtype == found.diff.dtype == np.float32


def test_noise_counts_in_the_mask_alone(tmp_path):
    outside = np.where(MASK[..., None], np.float16(0), DIFF)
    assert not reference.load(written(tmp_path / "a.exr", sss=SSS, diff=outside), MASK).noisy
    alone = reference.load(written(tmp_path / "b.exr", sss=SSS), MASK)
    assert not alone.noisy and not alone.diff.any()


@pytest.mark.parametrize("layer", ["sss", "diff"])
def test_numbers_that_are_not_finite(tmp_path, layer):
    layers = {"sss": SSS.copy(), "diff": DIFF.copy()}
    row, column = np.argwhere(~MASK)[0]
    layers[layer][row, column] = np.nan
    assert reference.load(written(tmp_path / "a.exr", **layers), MASK).noisy
    row, column = np.argwhere(MASK)[2]
    layers[layer][row, column, 1] = np.inf
    with pytest.raises(FileError, match=f"b.exr, column {column}, row {row}: .* infinite in 1 of the pixels"):
        reference.load(written(tmp_path / "b.exr", **layers), MASK)


def test_another_size_and_missing_channels(tmp_path):
    path = written(tmp_path / "a.exr", sss=SSS)
    with pytest.raises(FileError, match="a.exr: the reference has 7 x 5 pixels, the frame 5 x 7 pixels"):
        reference.load(path, MASK.T)
    with pytest.raises(FileError, match="there is no layer 'sss' for the reference"):
        reference.load(written(tmp_path / "b.exr", E=SSS), MASK)
    channels = {f"sss.{c}": SSS[..., 0] for c in "RGB"} | {"diff.R": SSS[..., 0]}
    (tmp_path / "c.exr").write_bytes(encode_exr(channels, {}))
    with pytest.raises(FileError, match="the reference lacks the channel 'diff.G', 'diff.B'"):
        reference.load(tmp_path / "c.exr", MASK)
