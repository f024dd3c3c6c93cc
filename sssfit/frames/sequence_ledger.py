"""What is kept of a sequence that is being rendered, to go on after a break.

It is one hidden file in the output directory: what was asked for, the figures of the frames so far, and the
state from which the next frame goes on. It is replaced in one step after a frame's own files are whole, and
removed at the end. So a process that is killed at any moment leaves a directory in which the same command
goes on, with the bytes of one that was never stopped.
"""

import dataclasses
import io
import os
import shutil
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.files.arrays import npz_bytes
from sssfit.files.atomic import STAGING_PREFIX, write_bytes
from sssfit.files.errors import FileError
from sssfit.files.json_text import json_line, parse_json, sha256_bytes
from sssfit.files.reading import read_bytes
from sssfit.frames.sequence import State
from sssfit.frames.sequence_output import Row

#: The file, in the output directory.
UNFINISHED = ".sssfit-unfinished.npz"
#: Frames larger than this have a large state, which is then written after every `SELDOM`-th of them alone.
LARGE_PIXELS, SELDOM = 2**20, 8


@dataclasses.dataclass
class Ledger:
    """What is known of a sequence so far, besides the state that its next frame needs.

    Attributes:
        asked: what it was asked for, to be compared with what a later run is; for JSON.
        rows: figures of the frames that are done.
        seconds: of those, waiting for the file, step, writing.
        inputs: SHA-256 of the files that were read: of "frames" and "references", by name.
        files: of those that were written, by name: "sha256" and "bytes".
        size: width and height of the frames; None before the first.
        ids: every profile id so far.
        white: what the pictures show as white; None while all frames were black.
        bad_pixels: how many were masked out.
        without_motion: numbers of the frames, after the first, that had none.
    """

    asked: dict[str, Any]
    rows: list[Row] = dataclasses.field(default_factory=list)
    seconds: list[tuple[float, float, float]] = dataclasses.field(default_factory=list)
    inputs: dict[str, dict[str, str]] = dataclasses.field(default_factory=dict)
    files: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    size: tuple[int, int] | None = None
    ids: list[int] = dataclasses.field(default_factory=list)
    white: float | None = None
    bad_pixels: int = 0
    without_motion: list[int] = dataclasses.field(default_factory=list)


def is_due(done: int, pixels: int) -> bool:
    """Whether the state is to be kept now.

    Args:
        done: how many frames are.
        pixels: of a frame.

    Returns:
        True after every frame, or after every `SELDOM`-th of large ones.

    Example:
        >>> is_due(3, 640 * 360), is_due(3, 3840 * 2160)
        (True, False)
    """
    return pixels <= LARGE_PIXELS or done % SELDOM == 0


def save(out: str | os.PathLike[str], ledger: Ledger, state: State) -> None:
    """Keep what the rest of a sequence needs, in one step.

    Args:
        out: the output directory, in which all files of the frames so far are.
        ledger: of the frames so far.
        state: after them.

    Raises:
        FileError: the file cannot be written; what was kept before is kept.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as out:
        ...     save(out, Ledger({}, size=(16, 9)), State(1, (), jnp.ones((9, 16)), jnp.ones((9, 16), int)))
        ...     load(out)[0].size
        (16, 9)
    """
    text = json_line(dataclasses.asdict(ledger)).encode()
    leaves = {f"leaf_{k:02d}": np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(state))}
    write_bytes(Path(out) / UNFINISHED, npz_bytes({"ledger": np.frombuffer(text, np.uint8), **leaves}))


def load(out: str | os.PathLike[str]) -> tuple[Ledger, list[np.ndarray]] | None:
    """What an unfinished sequence kept.

    Args:
        out: the output directory.

    Returns:
        The ledger and the state's numbers for `restored`; None where nothing is unfinished.

    Raises:
        FileError: what was kept cannot be read.

    Example:
        >>> load("no/such/folder") is None
        True
    """
    path = Path(out) / UNFINISHED
    if not os.path.exists(path):
        return None
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as archive:
            text = archive["ledger"].tobytes().decode()
            leaves = [archive[name] for name in sorted(archive.files) if name.startswith("leaf_")]
        fields = parse_json(text, path)
        rows = [Row(**{n: _number(v) for n, v in zip(Row._fields, r, strict=True)}) for r in fields["rows"]]
        pairs = {"seconds": [tuple(row) for row in fields["seconds"]], "size": tuple(fields["size"])}
        return Ledger(**fields | {"rows": rows} | pairs), leaves
    except (ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        problem = f"what is left of an unfinished sequence cannot be read ({error})"
        raise FileError(path, "", problem, "remove the file to start over") from error


def restored(leaves: Sequence[np.ndarray], like: State, out: str | os.PathLike[str]) -> State:
    """The state of an unfinished sequence.

    Args:
        leaves: from `load`.
        like: `sequence.init` for one of the frames: a state of the same structure.
        out: the output directory, for the message.

    Raises:
        FileError: the numbers are not those of such a state.

    Example:
        >>> state = State(1, (), jnp.ones((9, 16)), jnp.ones((9, 16), int))
        >>> restored([np.asarray(leaf) for leaf in jax.tree.leaves(state)], state, "out").number
        1
    """
    wanted, structure = jax.tree.flatten(like)
    shapes = [(np.shape(leaf), np.asarray(leaf).dtype) for leaf in wanted]
    if [(leaf.shape, leaf.dtype) for leaf in leaves] != shapes:
        problem = "the unfinished sequence has another state than these frames and options make"
        raise FileError(Path(out), "", problem, "give another directory")
    made = [int(v) if isinstance(w, int) else jnp.asarray(v) for w, v in zip(wanted, leaves, strict=True)]
    return jax.tree.unflatten(structure, made)


def check_unchanged(
    ledger: Ledger, out: str | os.PathLike[str], inputs: Mapping[str, Iterable[Path]]
) -> None:
    """Refuse to go on with files that are no longer what they were.

    Args:
        ledger: of the frames so far.
        out: the output directory.
        inputs: the paths of all "frames" and "references".

    Raises:
        FileError: a file that was read or written so far is missing or has other content.

    Example:
        >>> check_unchanged(Ledger({}), "no/such/folder", {})
    """
    known = {Path(out) / name: entry["sha256"] for name, entry in ledger.files.items()}
    for kind, paths in inputs.items():
        digests = ledger.inputs.get(kind, {})
        known |= {path: digests[path.name] for path in paths if path.name in digests}
    for path, digest in known.items():
        if sha256_bytes(read_bytes(path)) != digest:
            problem = "has changed since the sequence was rendered so far"
            raise FileError(path, "", problem, "bring it back, or start over in another directory")


def clear(out: str | os.PathLike[str]) -> None:
    """Remove what a killed process left half written, and nothing else.

    Args:
        out: the output directory; it may be missing.

    Example:
        >>> clear("no/such/folder")
    """
    for path in Path(out).glob(".sssfit-*.tmp"):
        with suppress(OSError):
            path.unlink()
    for path in Path(out).glob(f"{STAGING_PREFIX}*"):
        shutil.rmtree(path, ignore_errors=True)


def difference(one: dict[str, Any], other: dict[str, Any]) -> str | None:
    """The name of something that was asked for differently.

    Args:
        one, other: what was asked for, nested, for JSON.

    Returns:
        The first name in the alphabet; None where there is none.

    Example:
        >>> difference({"a": 1, "b": {"c": 2}}, {"a": 1, "b": {"c": 3}})
        'c'
    """
    for name in sorted({*one, *other}):
        here, there = one.get(name), other.get(name)
        if isinstance(here, dict) and isinstance(there, dict):
            inner = difference(here, there)
            if inner is not None:
                return inner
        elif here != there:
            return name
    return None


def _number(value: Any) -> Any:
    """A number as it was before JSON, which has no infinity."""
    return float(value) if isinstance(value, str) else value
