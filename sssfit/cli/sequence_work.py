"""What is left to do of a sequence: a new one, or one that was interrupted, if it is the same."""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

from sssfit.cli import sequence_options

#: Besides those that every manifest has.
PACKAGES = ("OpenEXR", "pillow")


class Work(NamedTuple):
    """A sequence to be rendered, and how far it is.

    Attributes:
        frames: all of them, numbered.
        references: their paths by number.
        ledger: of the frames that are done; grows.
        leaves: the state's numbers after those; None before the first.
    """

    options: argparse.Namespace
    frames: list
    references: dict[int, Path]
    ledger: Any
    leaves: list | None


def begun(options: argparse.Namespace, frames, references) -> Work | None:
    """The work that is left in the output directory; None where all is done."""
    from sssfit.files.errors import FileError
    from sssfit.frames import sequence_ledger

    out = Path(options.out)
    if out.exists() and not out.is_dir():
        raise FileError(out, "", "is a file, not a directory", "move it away or choose another directory")
    inputs = {"frames": [frame.path for frame in frames], "references": list(references.values())}
    _refuse_overwriting(options, frames, inputs)
    asked = _asked(options, frames, references)
    found = sequence_ledger.load(out)
    if found is None:
        if options.resume and _is_complete(out, asked, inputs):
            return None
        return Work(options, frames, references, sequence_ledger.Ledger(asked), None)
    ledger, leaves = found
    if not options.resume:
        done, every = len(ledger.rows), len(ledger.asked["options"]["frame"])
        problem = f"holds an unfinished sequence, {done} of {every} frames"
        raise FileError(out, "", problem, "give --resume to go on with it, or another directory")
    _refuse_another(out, "an unfinished", ledger.asked, asked)
    sequence_ledger.check_unchanged(ledger, out, inputs)
    return Work(options, frames, references, ledger, leaves)


def _asked(options: argparse.Namespace, frames, references) -> dict[str, Any]:
    """What makes the sequence what it is, as it comes back from a file."""
    from sssfit.files.json_text import json_text, parse_json, sha256_bytes
    from sssfit.files.output import versions
    from sssfit.files.reading import read_bytes

    camera = None if options.camera is None else sha256_bytes(read_bytes(options.camera))
    asked = {"options": sequence_options.asked(options, frames, references), "camera_sha256": camera}
    return parse_json(json_text(asked | {"versions": versions(PACKAGES)}), options.out)


def _refuse_overwriting(options: argparse.Namespace, frames, inputs: dict[str, list[Path]]) -> None:
    """Refuse an output directory in which an output would take the place of an input."""
    from sssfit.files.errors import FileError
    from sssfit.frames import sequence_output

    out = Path(options.out)
    written = {(out / name).resolve() for name in sequence_output.names([f.digits for f in frames])}
    camera = [] if options.camera is None else [Path(options.camera)]
    for path in [*inputs["frames"], *inputs["references"], *camera]:
        if path.resolve() in written:
            problem = "an output of this name would take its place, nothing was written"
            raise FileError(path, "", problem, "give another --out")


def _is_complete(out: Path, asked: dict[str, Any], inputs: dict[str, list[Path]]) -> bool:
    """Whether the directory holds a whole sequence; one of other options or files is refused."""
    from sssfit.files.json_text import read_json
    from sssfit.frames import sequence_ledger

    path = out / "manifest.json"
    manifest = read_json(path) if path.exists() else None
    if not isinstance(manifest, dict):
        return False
    options = manifest.get("options")
    if not isinstance(options, dict) or "mode" not in options:
        return False
    digests = options.pop("inputs_sha256", {})
    camera, stated = digests.pop("camera", None), manifest.get("versions")
    _refuse_another(
        out, "a complete", {"options": options, "camera_sha256": camera, "versions": stated}, asked
    )
    known = sequence_ledger.Ledger({}, inputs=digests, files=manifest.get("files", {}))
    sequence_ledger.check_unchanged(known, out, inputs)
    return True


def _refuse_another(out: Path, which: str, found: dict[str, Any], asked: dict[str, Any]) -> None:
    """Refuse to go on with a sequence that was asked for otherwise."""
    from sssfit.files.errors import FileError
    from sssfit.frames import sequence_ledger

    name = sequence_ledger.difference(found, asked)
    if name is None:
        return
    words = {"frame": "FRAME.exr", "camera_sha256": "content of the --camera file"}
    words |= {package: f"version of {package}" for package in asked["versions"]}
    word = words.get(name, f"--{name.replace('_', '-')}")
    problem = f"holds {which} sequence with another {word}"
    raise FileError(out, "", problem, "give what it was begun with, or another directory")
