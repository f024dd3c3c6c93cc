"""A directory of outputs with a manifest: all of it appears, or none."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sssfit.files.atomic import staged_directory
from sssfit.files.json_text import json_text, sha256_bytes

_PACKAGES = ("sssfit", "jax", "numpy", "scipy", "matplotlib")


class Output:
    """Files on their way into a directory; see `output_directory`.

    Attributes:
        manifest: what is written as manifest.json at the end; its "files" lists those that were put.
        timing: what is written as timing.json, if anything, outside the promise of the same bytes.
    """

    def __init__(self, staging: Path, manifest: dict[str, Any]):
        """Collect files in the directory `staging`."""
        self.manifest = manifest
        self.timing: dict[str, Any] = {}
        self._staging = staging

    def put(self, path: str, content: bytes) -> None:
        """Add a file under its path in the directory."""
        self._write(path, content)
        self.manifest["files"][path] = {"sha256": sha256_bytes(content), "bytes": len(content)}

    def _write(self, path: str, content: bytes) -> None:
        target = self._staging / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)

    def _finish(self) -> None:
        self._write("manifest.json", json_text(self.manifest).encode())
        if self.timing:
            self._write("timing.json", json_text(self.timing).encode())


def versions(packages: Sequence[str] = ()) -> dict[str, str]:
    """The versions that a manifest states.

    Args:
        packages: more than those that every manifest has.

    Returns:
        By name.

    Example:
        >>> "jax" in versions()
        True
    """
    return {name: version(name) for name in (*_PACKAGES, *packages)}


@contextmanager
def output_directory(
    out: str | os.PathLike[str], manifest: dict[str, Any], packages: Sequence[str] = ()
) -> Iterator[Output]:
    """Write files, manifest.json and, if there are times, timing.json into a directory, together at the end.

    Args:
        out: the directory, made if missing. On a failure or Ctrl-C nothing of the new files appears, and
            what was there stays.
        manifest: what it says besides "versions" and "files", such as "options".
        packages: more packages whose versions it states.

    Yields:
        An `Output` to put files into.

    Raises:
        FileError: the directory has a fault.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with output_directory(folder, {"options": {}}) as output:
        ...         output.put("a.txt", b"1")
        ...     sorted(path.name for path in Path(folder).iterdir())
        ['a.txt', 'manifest.json']
    """
    with staged_directory(out) as staging:
        output = Output(staging, {"versions": versions(packages), **manifest, "files": {}})
        yield output
        output._finish()
