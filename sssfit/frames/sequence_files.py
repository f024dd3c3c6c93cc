"""The files of a sequence: frames and references by the numbers at the end of their names."""

import glob
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sssfit.files.errors import FileError
from sssfit.frames.gbuffer import Frame


class Numbered(NamedTuple):
    """A file with a number at the end of its name.

    Attributes:
        number: the number.
        digits: as the name has it.
        path: of the file.
    """

    number: int
    digits: str
    path: Path


def expanded(names: Iterable[str]) -> list[Path]:
    """Files from their names and from patterns.

    Args:
        names: paths, or patterns with `*`, `?` or `[...]` such as a quoted glob; a file that is called like
            a pattern is that file.

    Returns:
        Paths; the files of a pattern in the order of their names.

    Raises:
        FileError: a pattern matches no file.

    Example:
        >>> expanded(["frame_01.exr", "frame_02.exr"])[1].name
        'frame_02.exr'
    """
    found = []
    for name in names:
        if not glob.has_magic(name) or os.path.exists(name):
            found.append(Path(name))
            continue
        matching = sorted(glob.glob(name))
        if not matching:
            raise FileError(name, "", "no file has such a name", "check the folder and the pattern")
        found.extend(map(Path, matching))
    return found


def numbered(names: Iterable[str], *, gaps: bool = False) -> list[Numbered]:
    """Files in the order of the numbers at the end of their names.

    Args:
        names: as for `expanded`.
        gaps: whether numbers may be missing in between.

    Returns:
        The files; the numbers increase, by one from one to the next unless gaps are allowed.

    Raises:
        FileError: a pattern matches no file, a name has no number at its end, two names have the same, or
            one is missing.

    Example:
        >>> [file.number for file in numbered(["f_10.exr", "f_09.exr"])]
        [9, 10]
    """
    found: dict[int, Numbered] = {}
    for path in expanded(names):
        match = re.search(r"(\d+)$", path.stem, re.ASCII)
        if match is None:
            remedy = "number the frames as in frame_0001.exr"
            raise FileError(path, "", "the name has no number at its end", remedy)
        file = Numbered(int(match.group()), match.group(), path)
        if file.number in found:
            problem = f"has the number {file.digits} as {found[file.number].path} has"
            raise FileError(path, "", problem, "give one file for each number")
        found[file.number] = file
    every = [found[number] for number in sorted(found)]
    for before, after in zip(every, every[1:], strict=False):
        if after.number != before.number + 1 and not gaps:
            missing = f"{before.number + 1:0{len(before.digits)}d}"
            problem = f"after this frame, number {missing} is missing; the next one is {after.digits}"
            remedy = f"bring {missing} back, or give the frames before or after it alone"
            raise FileError(before.path, "", problem, remedy)
    return every


def references(names: Iterable[str], frames: Sequence[Numbered]) -> dict[int, Path]:
    """References by the number of the frame that they belong to.

    Args:
        names: as for `expanded`; their numbers may have gaps.
        frames: of the sequence.

    Returns:
        Paths by number; those that belong to no frame are left out.

    Raises:
        FileError: as `numbered`; or none of them belongs to a frame.

    Example:
        >>> references(["exact_12.exr", "exact_99.exr"], numbered(["frame_012.exr"]))[12].name
        'exact_12.exr'
    """
    every = numbered(names, gaps=True)
    known = {frame.number for frame in frames}
    found = {file.number: file.path for file in every if file.number in known}
    if every and not found:
        problem = f"neither this reference nor another has the number of a frame, {_span(frames)}"
        raise FileError(every[0].path, "", problem, "number the references as the frames are")
    return found


def check(frame: Frame, path: str | os.PathLike[str], size: tuple[int, int] | None) -> None:
    """Refuse a frame that does not belong into a sequence.

    Args:
        frame: as it was read.
        path: of its file, for messages.
        size: width and height of the frames before it; None for the first, whose motion is of no use.

    Raises:
        FileError: it has another size, or a surface that moved by more than the frame is wide or high.

    Example:
        >>> from sssfit.frames import procedural
        >>> check(procedural.frame(width=64, height=36), "frame_00.exr", (64, 36))
    """
    if size is None:
        return
    width, height = frame.camera.width, frame.camera.height
    if (width, height) != tuple(size):
        problem = f"has {width} x {height} pixels, the frames before it {size[0]} x {size[1]}"
        raise FileError(path, "", problem, "render all frames in one size")
    if frame.motion is None:
        return
    surface = (np.asarray(frame.profile_id) > 0)[..., None]
    moved = np.where(surface, np.abs(np.asarray(frame.motion)), 0)
    beyond = moved > (width, height)
    if beyond.any():
        row, column, axis = np.argwhere(beyond)[0]
        where, name = f"column {column}, row {row}", "XY"[axis]
        problem = f"motion.{name} is {float(np.asarray(frame.motion)[row, column, axis]):g}"
        problem += f", more than the frame of {width} x {height} pixels holds"
        remedy = "write motion in pixels, where a point was in the frame before minus where it is, y down"
        raise FileError(path, where, problem, remedy)


def _span(frames: Sequence[Numbered]) -> str:
    first, last = frames[0].digits, frames[-1].digits
    return first if first == last else f"{first} to {last}"
