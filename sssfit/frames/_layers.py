"""Layers of EXR images by the names that files really use."""

import os
import re
from pathlib import Path

import numpy as np

from sssfit.files.errors import FileError
from sssfit.files.exr import MAGIC, read_exr
from sssfit.files.reading import read_bytes

#: Names of the components that a kind of layer may have, the usual ones first.
COLOUR = (("R", "G", "B"), ("r", "g", "b"))
VECTOR = (("X", "Y", "Z"), ("x", "y", "z"), *COLOUR)
PAIR = (("X", "Y"), ("x", "y"), ("U", "V"), ("R", "G"))
# A single number stands alone, or as the one component that a renderer calls V, Z, Y, R or X.
NUMBER = (("",), ("V",), ("Z",), ("Y",), ("R",), ("X",))

# What people save by mistake; none of it holds linear light above 1.
_OTHER_IMAGES = {b"\x89PNG": "a PNG", b"\xff\xd8\xff": "a JPEG", b"BM": "a BMP", b"GIF8": "a GIF"}
_FILE = re.compile(r"(.*\.(?:exr|png|jpe?g|bmp|gif|tiff?|tga|hdr))(?::(.*))?", re.IGNORECASE | re.DOTALL)


class Layers:
    """The layers of a frame's file and of files beside it; each file is read once.

    Attributes:
        frame: the frame's own file.
    """

    def __init__(self, frame: str | os.PathLike[str]):
        """Begin with the frame's own file; nothing is read yet."""
        self.frame = Path(frame)
        self._read: dict[Path, dict[str, np.ndarray]] = {}

    def place(self, name: str) -> tuple[Path, str]:
        """The file and the layer in it that a name such as "E" or "other.exr:E" means."""
        match = _FILE.fullmatch(name)
        if match is None:
            return self.frame, name
        # A path that starts at the root is left as it is.
        return self.frame.parent / match.group(1), match.group(2) or ""

    def channels(self, file: Path) -> dict[str, np.ndarray]:
        """All channels of a file."""
        if file not in self._read:
            _refuse_other_images(file)
            self._read[file] = read_exr(file)[0]
        return self._read[file]

    def find(
        self, name: str, kinds: tuple[tuple[str, ...], ...], what: str, *, needed: bool
    ) -> np.ndarray | None:
        """Pixels of a layer, (height, width, components); None where it is missing and not needed.

        Raises:
            FileError: the layer is missing and needed, or only a part of it is there.
        """
        file, layer = self.place(name)
        channels = self.channels(file)
        every = [[_channel(layer, component) for component in kind] for kind in kinds]
        for names in every:
            if all(channel in channels for channel in names):
                return np.stack([channels[channel] for channel in names], axis=-1)
        held = f"the file has {', '.join(sorted(channels))}"
        for names in every:
            if any(channel in channels for channel in names):
                missing = ", ".join(repr(channel) for channel in names if channel not in channels)
                raise FileError(file, "", f"the {what} lacks the channel {missing}", held)
        if needed:
            problem = f"there is no layer {layer!r} for the {what}"
            raise FileError(file, "", problem, f"{held}: say which of them it is")
        return None


def _channel(layer: str, component: str) -> str:
    return f"{layer}.{component}" if layer and component else layer or component


def _refuse_other_images(file: Path) -> None:
    start = read_bytes(file)[: len(MAGIC)]
    for magic, kind in _OTHER_IMAGES.items():
        if start.startswith(magic):
            problem = f"is {kind} image, whose few bits hold no linear light"
            raise FileError(file, "", problem, "give an EXR image of float or half numbers")
