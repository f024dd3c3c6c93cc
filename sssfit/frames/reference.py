"""References to compare with: two halves' mean and half their difference, from an EXR file."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sssfit.files.errors import FileError
from sssfit.frames import _layers


class Reference(NamedTuple):
    """What an image is compared with.

    Attributes:
        sss: mean of two independent halves, (H, W, 3), float32.
        diff: half their difference, same shape; zeros where the file has none.
        noisy: whether diff is anything but zero in the mask.
    """

    sss: np.ndarray
    diff: np.ndarray
    noisy: bool


def load(path: str | os.PathLike[str], mask: ArrayLike) -> Reference:
    """Read a reference.

    Args:
        path: EXR file with the layer `sss` and, if it has noise, `diff`.
        mask: (H, W), the pixels that shall be compared; the others may hold anything.

    Returns:
        See `Reference`. Without `diff` it is taken as free of noise.

    Raises:
        FileError: the file is missing, truncated or no EXR image, lacks a channel, has another size than the
            mask, or is not finite in it.

    Example:
        >>> import tempfile
        >>> from sssfit.files.exr import encode_exr
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "exact.exr"
        ...     ones = np.ones((9, 16), np.float32)
        ...     _ = path.write_bytes(encode_exr({f"sss.{c}": ones for c in "RGB"}, {}))
        ...     load(path, ones > 0).noisy
        False
    """
    layers, lit = _layers.Layers(path), np.asarray(mask, bool)
    held = sorted(layers.channels(Path(path)))
    if not any(name.startswith("sss.") for name in held):
        problem = f"there is no layer 'sss' for the reference; the file has {', '.join(held)}"
        raise FileError(Path(path), "", problem, "give a scattered frame, such as a scattered.exr")
    found = {
        name: layers.find(name, _layers.COLOUR, "reference", needed=name == "sss") for name in ("sss", "diff")
    }
    sss, diff = (None if v is None else v.astype(np.float32) for v in found.values())
    assert sss is not None
    diff = np.zeros_like(sss) if diff is None else diff
    if sss.shape[:2] != lit.shape:
        sizes = [f"{shape[1]} x {shape[0]} pixels" for shape in (sss.shape, lit.shape)]
        problem = f"the reference has {sizes[0]}, the frame {sizes[1]}"
        raise FileError(Path(path), "", problem, "give the reference of this frame")
    bad = lit & ~(np.isfinite(sss) & np.isfinite(diff)).all(axis=-1)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        problem = f"the reference is NaN or infinite in {bad.sum()} of the pixels to compare"
        raise FileError(Path(path), f"column {column}, row {row}", problem, "mend the file")
    return Reference(sss, diff, bool(diff[lit].any()))
