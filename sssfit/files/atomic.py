"""Files that appear whole or not at all: write beside the target, then rename over it.

A rename within one file system replaces a file in one step. A reader therefore sees the earlier
file or the new one, and a failure half-way (full disk, Ctrl-C) leaves the earlier file alone.
"""

import errno
import os
import secrets
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sssfit.files.errors import FileError

DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
STAGING_PREFIX = ".sssfit-staging-"
LAST_PUBLISHED = "manifest.json"
UNTOUCHED = "earlier outputs are untouched"


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file in one step: its earlier content stays until the new content is on disk.

    A symbolic link at ``path`` is replaced by the file, not followed.

    Args:
        path: file to write; its directory must exist.
        data: the whole content; empty bytes make an empty file.

    Raises:
        FileError: the directory is missing or not writable, ``path`` is a directory, or the disk
            is full. Nothing is left behind and an earlier file is untouched, as after Ctrl-C.

    Example:
        >>> with tempfile.TemporaryDirectory() as directory:
        ...     write_bytes(Path(directory) / "note.txt", b"hello")
        ...     (Path(directory) / "note.txt").read_bytes()
        b'hello'
    """
    path = Path(path)
    # Not tempfile: its files are private, and a published file should follow the user's umask.
    temporary = path.with_name(f".sssfit-{secrets.token_hex(8)}.tmp")
    try:
        with open(temporary, "xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise _write_failure(path, error, "an earlier file is untouched") from error
        raise


@contextmanager
def staged_directory(out: str | os.PathLike[str]) -> Iterator[Path]:
    """Collect output files in a hidden directory inside ``out`` and publish them together.

    On a clean exit every staged file, in sub-directories too, is renamed over its target, with
    ``manifest.json`` last so that a manifest never describes files that are not there yet; Ctrl-C
    waits until this is done. After an exception or Ctrl-C inside the block nothing is published.

    Args:
        out: directory for the outputs; it and its parents are created when missing, and
            removed again after an exception.

    Yields:
        The staging directory: write files there under the names they shall have in ``out``.

    Raises:
        FileError: ``out`` is a file or not writable, a target is a directory or cannot be
            written, or the disk is full (inside the block too).

    Example:
        >>> with tempfile.TemporaryDirectory() as parent:
        ...     with staged_directory(Path(parent) / "out") as staging:
        ...         write_bytes(staging / "manifest.json", b"{}")
        ...     sorted(path.name for path in (Path(parent) / "out").iterdir())
        ['manifest.json']
    """
    out = Path(out)
    created: list[Path] = []
    staging = None
    try:
        _make_directory(out, created)
        staging = _make_staging(out)
        yield staging
        with interrupt_deferred():
            _publish(staging, out, created)
            shutil.rmtree(staging, ignore_errors=True)
    except BaseException as error:
        with interrupt_deferred():
            if staging is not None:
                shutil.rmtree(staging, ignore_errors=True)
            _remove_empty(created)
        if isinstance(error, OSError):
            raise _write_failure(out, error, UNTOUCHED) from error
        raise


def make_directory(path: str | os.PathLike[str]) -> None:
    """Make a directory and its missing parents; one that is there is left as it is.

    Args:
        path: the directory.

    Raises:
        FileError: it or a parent is a file, or may not be made.

    Example:
        >>> with tempfile.TemporaryDirectory() as parent:
        ...     make_directory(Path(parent) / "a" / "b")
        ...     (Path(parent) / "a" / "b").is_dir()
        True
    """
    _make_directory(Path(path), [])


def _make_staging(out: Path) -> Path:
    """Make the staging directory; inside ``out``, so that renaming never crosses file systems."""
    try:
        return Path(tempfile.mkdtemp(prefix=STAGING_PREFIX, dir=out))
    except OSError as error:
        raise _write_failure(out, error, "nothing was written") from error


def _publish(staging: Path, out: Path, created: list[Path]) -> None:
    """Check every target, then rename every staged file over its target, the manifest last."""
    files = sorted(path for path in staging.rglob("*") if path.is_file())
    files.sort(key=lambda path: path.relative_to(staging) == Path(LAST_PUBLISHED))
    targets = [out / path.relative_to(staging) for path in files]
    for target in targets:
        _make_directory(target.parent, created)
    _check_targets(targets)
    _flush_to_disk(files, out)
    for done, (path, target) in enumerate(zip(files, targets, strict=True)):
        try:
            os.replace(path, target)
        except OSError as error:
            state = f"{done} of {len(files)} files had been replaced" if done else UNTOUCHED
            raise _write_failure(target, error, state) from error


def _check_targets(targets: list[Path]) -> None:
    """Find what would make a rename fail before the first one is done."""
    for target in targets:
        if os.path.isdir(target):
            raise FileError(
                target,
                "",
                f"is a directory where a file shall be written, {UNTOUCHED}",
                "move the directory away or choose another output directory",
            )
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise FileError(
                target.parent,
                "",
                f"the directory is not writable, {UNTOUCHED}",
                "change its permissions or choose another output directory",
            )


def _flush_to_disk(files: list[Path], out: Path) -> None:
    """Wait until all content is on disk, which is also where a full disk shows at the latest."""
    for path in files:
        try:
            with open(path, "r+b") as stream:
                os.fsync(stream.fileno())
        except OSError as error:
            raise _write_failure(out, error, UNTOUCHED) from error


def _make_directory(path: Path, created: list[Path]) -> None:
    """Make a directory and its missing parents, and append those made to ``created``."""
    missing = []
    # os.path, because Path.exists raises where a parent may not be searched.
    while not os.path.exists(path) and path != path.parent:
        missing.append(path)
        path = path.parent
    if not os.path.isdir(path):
        raise FileError(path, "", "is a file, not a directory", "move it away or choose another directory")
    for directory in reversed(missing):
        try:
            directory.mkdir(exist_ok=True)
        except OSError as error:
            raise _write_failure(directory, error, UNTOUCHED) from error
        created.append(directory)


def _remove_empty(created: list[Path]) -> None:
    """Remove the directories made here, innermost first, except those that hold something."""
    with suppress(OSError):
        for directory in reversed(created):
            directory.rmdir()


@contextmanager
def interrupt_deferred() -> Iterator[None]:
    """Hold back Ctrl-C until the block is done; only the main thread may, and need, do so.

    For work that must not be left half done; for calls into compiled code that does not survive an
    exception in the middle, or loses it, such as JAX's; and for imports: an interruption inside the making
    of a class from text (a named tuple's) ends Python by the signal later, even where it was caught.

    Example:
        >>> with interrupt_deferred():
        ...     total = sum(range(10))
    """
    earlier = signal.getsignal(signal.SIGINT)
    if earlier is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    received = []
    signal.signal(signal.SIGINT, lambda number, frame: received.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, earlier)
        if received:
            signal.raise_signal(signal.SIGINT)


def _write_failure(path: Path, error: OSError, state: str) -> FileError:
    """Say in one sentence what the operating system refused, and what to do."""
    if error.errno in DISK_FULL:
        return FileError(path, "", f"the disk is full, {state}", "free space and run again")
    problem = (error.strerror or str(error)).lower()
    remedies = {
        errno.ENOENT: "create the directory or choose another path",
        errno.ENOTDIR: "choose a path whose parents are directories",
        errno.EISDIR: "move the directory away or choose another path",
        errno.EACCES: "change the permissions or choose another path",
        errno.EPERM: "change the permissions or choose another path",
        errno.EROFS: "choose a path that can be written",
    }
    remedy = remedies.get(error.errno or 0, "choose another path or run again")
    return FileError(path, "", f"cannot be written ({problem}), {state}", remedy)
