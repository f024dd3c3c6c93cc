"""`sssfit render --mode`: frame after frame, each with the counts that those before it taught."""

import argparse
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from sssfit.cli import render_options, sequence_options
from sssfit.cli.sequence_work import PACKAGES, Work, begun

_INTERRUPTED = 2


class _Read(NamedTuple):
    """What was read of a frame, in the thread that reads.

    Attributes:
        place: its number and path.
        frame, profiles, mask: what the library wants; the pixels that have a profile.
        truth: its reference, if it has one.
        told: sentences about bad pixels.
        sha256: of the files, by kind and name.
    """

    place: Any
    frame: Any
    profiles: dict[int, Any]
    mask: Any
    truth: Any
    told: list[str]
    sha256: dict[str, dict[str, str]]


def run(options: argparse.Namespace) -> int:
    """Run `sssfit render --mode`."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        # Some only for those that import them later.
        from sssfit.files import ahead, exr, output  # noqa: F401
        from sssfit.frames import sequence_files
        from sssfit.frames.sequence_ledger import clear

        sequence_options.check(options)
        # Constants out of their domain are refused before anything is read.
        sequence_options.config(options, {})
    frames = sequence_files.numbered(options.frame)
    references = sequence_files.references(options.reference or (), frames)
    work = begun(options, frames, references)
    picture = Path(options.out) / "sequence.png"
    if work is None:
        print(f"all {len(frames)} frames were complete: see {picture}")
        return 0
    if options.resume:
        clear(options.out)
    try:
        _every_frame(work)
    except KeyboardInterrupt:
        done = len(work.ledger.rows)
        if not done:
            raise
        message = f"interrupted after {done} of {len(frames)} frames; run again with --resume to go on"
        print(f"sssfit: {message}", file=sys.stderr)
        return _INTERRUPTED
    with interrupt_deferred():
        summary = _finished(work)
    _tell(summary, picture)
    return 0


def _every_frame(work: Work) -> None:
    """Render and write the frames that are left; whatever stops it, it can be gone on from there."""
    from sssfit.files.ahead import read_ahead
    from sssfit.files.atomic import interrupt_deferred
    from sssfit.files.errors import FileError
    from sssfit.frames import sequence_ledger

    ledger, out = work.ledger, work.options.out
    kept = len(ledger.rows)
    left = work.frames[kept:]
    state: Any = None
    before: Any = None
    with _bar(work, kept) as bar, closing(read_ahead(_Reader(work), left)) as ahead:
        try:
            for place in left:
                bar.show(place.path.name)
                started = time.perf_counter()
                read = next(ahead)
                waited = time.perf_counter() - started
                with interrupt_deferred():
                    state, before = _one_frame(work, read, state, before, waited, bar), state
                    if sequence_ledger.is_due(len(ledger.rows), read.mask.size):
                        sequence_ledger.save(out, ledger, state)
                        kept = len(ledger.rows)
                bar.advance()
        finally:
            if len(ledger.rows) > kept:
                with interrupt_deferred(), suppress(FileError):
                    sequence_ledger.save(out, ledger, state)


class _Reader:
    """Reads the frames of a sequence one after the other, and knows every profile so far."""

    def __init__(self, work: Work):
        """Begin after the frames that are done."""
        self._work = work
        self._load = render_options.loader(work.options, work.frames[0].path, also=("motion",))
        self._profiles = self._of(work.ledger.ids) if work.ledger.ids else {}
        self._size = work.ledger.size

    def __call__(self, place) -> _Read:
        """Read one frame and its reference."""
        import numpy as np

        from sssfit.files.errors import FileError
        from sssfit.files.json_text import sha256_bytes
        from sssfit.files.reading import read_bytes
        from sssfit.frames import reference, render, sequence_files

        told: list[str] = []
        written = _state_of(place.path)
        sha256 = {"frames": {place.path.name: sha256_bytes(read_bytes(place.path))}}
        frame = self._load(place.path, told.append)
        if _state_of(place.path) != written:
            raise FileError(place.path, "", "has changed while it was read", "render it first, then this")
        sequence_files.check(frame, place.path, self._size)
        self._size = frame.camera.width, frame.camera.height
        ids = {int(number) for number in np.unique(frame.profile_id) if number} | set(self._profiles)
        if ids != set(self._profiles):
            self._profiles = self._of(sorted(ids))
        mask = render.scatters(frame, self._profiles)
        path, truth = self._work.references.get(place.number), None
        if path is not None and mask.any():
            sha256["references"] = {path.name: sha256_bytes(read_bytes(path))}
            truth = reference.load(path, mask)
        return _Read(place, frame, self._profiles, mask, truth, told, sha256)

    def _of(self, ids: list[int]) -> dict[int, Any]:
        named = next(iter(self._work.references.values()), None)
        return render_options.profiles_of(self._work.options, ids, named)


def _state_of(path: Path) -> tuple[int, ...] | None:
    """What changes where a file is written to; None where there is none, which reading it will tell."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def _one_frame(work: Work, read: _Read, state, before, waited: float, bar):
    """Render and write one frame, and enter it into the ledger; the state after it, written over `before`."""
    import numpy as np

    from sssfit.frames import sequence_output

    options, ledger, place = work.options, work.ledger, read.place
    for text in _warnings(work, read):
        bar.warn(text)
    started = time.perf_counter()
    state, image, info = _stepped(work, read, state, before)
    image, counts = np.asarray(image), np.asarray(info.counts)
    stepped = time.perf_counter()
    bounds, psnr = sequence_options.bounds(options), _psnr(read, image)
    white = options.white if ledger.white is None else ledger.white
    white = sequence_output.white(image) if white is None else white
    shown = {"white": white or 1.0, "most": bounds[1]}
    files = _written(options.out, sequence_output.files(image, counts, place.digits, **shown))
    row = sequence_output.row(place.number, counts, info.missing, read.mask, bounds, psnr)
    if ledger.rows and read.frame.motion is None:
        ledger.without_motion.append(place.number)
    for kind, digests in read.sha256.items():
        ledger.inputs.setdefault(kind, {}).update(digests)
    ledger.files |= files
    ledger.white, ledger.ids = white, sorted(read.profiles)
    ledger.size = read.frame.camera.width, read.frame.camera.height
    ledger.bad_pixels += render_options.bad_pixels(read.told)
    ledger.seconds.append((waited, stepped - started, time.perf_counter() - stepped))
    ledger.rows.append(row)
    return state


def _warnings(work: Work, read: _Read) -> list[str]:
    """What to say about a frame; that motion is missing, once in a sequence."""
    ledger = work.ledger
    if read.frame.motion is not None or not ledger.rows or ledger.without_motion:
        return read.told
    missing = f"{read.place.path}: there is no motion; this and other frames without are taken to stand still"
    return [*read.told, missing]


def _stepped(work: Work, read: _Read, state, before):
    """The library's step; before the first, the state of nothing or that which was kept."""
    from sssfit.files.errors import FileError
    from sssfit.frames import sequence, sequence_ledger

    config = sequence_options.config(work.options, read.profiles)
    if state is None:
        state = sequence.init(read.frame, config)
        if work.leaves is not None:
            state = sequence_ledger.restored(work.leaves, state, work.options.out)
    try:
        return sequence.step(state, read.frame, config, spare=before)
    except ValueError as error:
        # The other arguments have been checked.
        if read.frame.normal is None:
            remedy = "name them with --layer normal=..., or take --distance plane"
            path = read.place.path
            raise FileError(path, "", "has no normals, which are needed here", remedy) from error
        raise


def _psnr(read: _Read, image) -> float | None:
    """Of the pixels with a profile; None without a reference, and where no light is to be measured."""
    import numpy as np

    from sssfit.frames import compare

    if read.truth is None or not np.asarray(read.frame.irradiance)[read.mask].any():
        return None
    return compare.compare(image, read.truth.sss, read.truth.diff, read.mask).psnr


def _written(out: str, files: dict[str, bytes]) -> dict[str, dict[str, Any]]:
    """Write files into the directory, each in one step; what the manifest will say of them."""
    from sssfit.files.atomic import LAST_PUBLISHED, make_directory, write_bytes
    from sssfit.files.json_text import sha256_bytes

    make_directory(out)
    # That of an earlier run is about other files from here on.
    with suppress(FileNotFoundError):
        (Path(out) / LAST_PUBLISHED).unlink()
    for name, content in files.items():
        write_bytes(Path(out) / name, content)
    return {n: {"sha256": sha256_bytes(c), "bytes": len(c)} for n, c in files.items()}


def _finished(work: Work) -> dict[str, Any]:
    """Write what is known of the whole sequence, and remove what was kept to go on."""
    from sssfit.files.atomic import write_bytes
    from sssfit.files.output import output_directory
    from sssfit.frames import render_output, sequence_ledger, sequence_output

    options, ledger, out = work.options, work.ledger, Path(work.options.out)
    bounds, rows = sequence_options.bounds(options), ledger.rows
    summary = _summary(work)
    pictures = [out / f"scattered_{place.digits}.png" for place in work.frames]
    camera = {"camera": ledger.asked["camera_sha256"]}
    asked = ledger.asked["options"] | {"inputs_sha256": camera | ledger.inputs}
    write_bytes(out / "timing.csv", sequence_output.timing(rows, ledger.seconds))
    with output_directory(out, {"command": "render", "options": asked}, packages=PACKAGES) as output:
        output.manifest["files"] |= ledger.files
        output.put("sequence.csv", sequence_output.table(rows))
        output.put("sequence.png", sequence_output.plot(rows, title=_title(summary), bounds=bounds))
        output.put("sequence.webp", sequence_output.moving_preview(pictures))
        output.put("summary.json", render_output.text(summary))
    with suppress(FileNotFoundError):
        (out / sequence_ledger.UNFINISHED).unlink()
    return summary


def _summary(work: Work) -> dict[str, Any]:
    from sssfit.frames import sequence_output

    options, ledger = work.options, work.ledger
    settings = render_options.settings(options)
    named = next(iter(work.references.values()), None)
    profiles = render_options.profiles_of(options, ledger.ids, named)
    return sequence_output.summary(ledger.rows) | {
        **sequence_options.constants(options),
        "size": list(ledger.size or ()),
        "seed": options.seed,
        "cutoff": settings.cutoff,
        "settings": settings._asdict(),
        "profiles": {str(n): None if d is None else d.tolist() for n, d in sorted(profiles.items())},
        "bad_pixels": ledger.bad_pixels,
        "without_motion": ledger.without_motion,
        "pictures": {"white": ledger.white or 1.0, "count": sequence_options.bounds(options)[1]},
    }


def _title(summary: dict[str, Any]) -> str:
    target = summary["target_variance"]
    wanted = "" if target is None else f", target variance {target:g}"
    width, height = summary["size"]
    return f"{summary['mode']}{wanted}: {summary['frames']} frames of {width} x {height} pixels"


def _tell(summary: dict[str, Any], picture: Path) -> None:
    parts = [f"{summary['frames']} frames"]
    if summary["mean_count"] is not None:
        parts.append(f"mean count {summary['mean_count']:.2f}")
    if summary["psnr"] is not None:
        parts.append(f"psnr {summary['psnr']:.2f} dB in the mean of {summary['psnr_frames']}")
    print(f"{'; '.join(parts)}: see {picture}")


class _Bar:
    """Frames as they go by, on the terminal."""

    def __init__(self, progress, task):
        self._progress, self._task = progress, task

    def show(self, name: str) -> None:
        """Say which frame is at work."""
        self._progress.update(self._task, description=name)

    def advance(self) -> None:
        """One more is done."""
        self._progress.advance(self._task)

    def warn(self, text: str) -> None:
        """A line above the bar."""
        from sssfit.files import exr

        # The thread that reads the next file mutes the terminal meanwhile.
        with exr.TERMINAL:
            self._progress.console.out(f"warning: {text}", highlight=False)


@contextmanager
def _bar(work: Work, done: int) -> Iterator[_Bar]:
    """A bar on the terminal with one step for each frame."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    visible = sys.stderr is not None and sys.stderr.isatty() and not work.options.quiet
    with Progress(*columns, console=Console(file=sys.stderr), disable=not visible) as progress:
        yield _Bar(progress, progress.add_task("", total=len(work.frames), completed=done))
