"""`sssfit render`: a frame from a file, or a sequence of them, scattered and compared with references."""

import argparse
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sssfit.cli import render_options, render_sequence, sequence_options

_DESCRIPTION = """\
Scatter a frame: irradiance, depth, normals and profile ids from an EXR file. Lengths are in mm.

Written are scattered.exr (layer sss: irradiance after scattering, for albedo 1), count.exr, error.exr with a
reference, pictures of them, summary.json, timing.json and manifest.json. The same options give the same bytes
on the same kind of machine, timing.json apart.

With --mode, frames numbered at the end of their names are a sequence, in which the counts follow from what
was learned from the frames before. Written are scattered_NNNN.exr, count_NNNN.exr and pictures of both for
each frame NNNN; sequence.csv, sequence.png and sequence.webp, summary.json, timing.csv and manifest.json.
What is interrupted goes on with --resume, and gives the same bytes.
"""
_EXAMPLE = """\
examples:
  sssfit render frame_00.exr --camera camera.json --profile skin1 --out scattered
  sssfit render frame.exr --camera camera.json --profile marble --spp 8:64 --target-variance 1e-4 --out few
  sssfit render frame.exr --fov-x-deg 29 --d 1.9,0.5,0.2 --method exact --out exact
  sssfit render 'frame_*.exr' --camera camera.json --profile skin1 --mode ocv --target-variance 1e-3 --out all
"""


def add_command(commands) -> None:
    """Add `render` to the parser's commands."""
    command = commands.add_parser(
        "render",
        help="scatter a frame or a sequence from EXR files, and compare it with references",
        description=_DESCRIPTION,
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "frame", nargs="+", metavar="FRAME.exr",
        help="linear, without anti-aliasing; with --mode several, or a quoted 'frame_*.exr'",
    )  # fmt: skip
    command.add_argument("--out", required=True, metavar="DIR", help="output directory, made if missing")
    render_options.add_scene(command)
    render_options.add_method(command)
    sequence_options.add(command)
    command.add_argument(
        "--reference", nargs="+", metavar="REF.exr",
        help="layers sss and diff, to be compared with; of a sequence those with the frames' numbers",
    )  # fmt: skip
    command.add_argument(
        "--replicates", type=int, metavar="K",
        help="repetitions that give the bias its standard error: 0 or from 8 on (default: 8)",
    )  # fmt: skip
    command.add_argument("--quiet", action="store_true", help="show no progress")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run `sssfit render`."""
    from sssfit.files.atomic import interrupt_deferred

    if not options.out:
        raise ValueError("--out must name a directory; use . for the current one")
    if options.mode is not None:
        return render_sequence.run(options)
    sequence_options.check_single(options)
    with interrupt_deferred():
        from sssfit.files.errors import FileError
        from sssfit.files.output import output_directory
        from sssfit.frames import reference, render, render_output, sequence_ledger
    render_options.check(options)
    if (Path(options.out) / sequence_ledger.UNFINISHED).exists():
        remedy = "finish it with --mode and --resume, or give another directory"
        raise FileError(options.out, "", "holds an unfinished sequence", remedy)
    settings, counts = render_options.settings(options), render_options.counts(options)
    started = time.perf_counter()
    with interrupt_deferred():
        frame, bad_pixels = render_options.frame(options)
        profiles = render_options.profiles(options, frame)
        mask = render.scatters(frame, profiles)
    if not mask.any():
        remedy = "give one of the frame's ids a profile"
        raise FileError(options.frame, "", "no pixel has a profile that scatters", remedy)
    truth = None if options.reference is None else reference.load(options.reference, mask)
    manifest = {"command": "render", "options": render_options.asked(options)}
    with (
        output_directory(options.out, manifest, packages=("OpenEXR", "pillow")) as output,
        _passes(options, frame, profiles) as step,
    ):
        step.seconds["reading"] = time.perf_counter() - started
        made = _made(options, frame, profiles, settings, counts, step)
        found = _compared(options, frame, profiles, settings, made, truth, mask, step)
        with step("writing"):
            error = None if truth is None else made.image - truth.sss
            files, shown = render_output.files(made, error, mask)
            summary = render_output.summary(made, mask, found) | {
                "method": options.method,
                "size": [frame.camera.width, frame.camera.height],
                "profiles": {str(n): None if d is None else d.tolist() for n, d in sorted(profiles.items())},
                "cutoff": settings.cutoff,
                "bad_pixels": bad_pixels,
                "reference_noise": None if truth is None else truth.noisy,
                "pictures": shown,
                **_sampling(options, settings),
            }
            output.put("summary.json", render_output.text(summary))
            for name, content in files.items():
                output.put(name, content)
        output.timing = {"seconds": step.seconds}
    _tell(options, summary)
    return 0


def _made(options: argparse.Namespace, frame, profiles, settings, counts: tuple[int, int], step):
    from sssfit.files.errors import FileError
    from sssfit.frames import render

    try:
        if options.method == "exact":
            limit = options.radius_limit
            return render.by_sums(frame, profiles, cutoff=settings.cutoff, radius_limit=limit, step=step)
        least, most = counts
        target = options.target_variance
        asked = {"least": least, "most": most, "target_variance": target, "seed": options.seed}
        return render.by_sampling(frame, profiles, settings, **asked, step=step)
    except ValueError as error:
        # The other arguments have been checked.
        if frame.normal is None:
            remedy = "name them with --layer normal=..., or take --method scatter --distance plane"
            raise FileError(options.frame, "", "has no normals, which are needed here", remedy) from error
        raise


def _compared(options: argparse.Namespace, frame, profiles, settings, made, truth, mask, step):
    """How far the image is from the reference; None without one."""
    from sssfit.frames import compare, render

    if truth is None:
        return None
    repeated: Any = None
    if options.method == "exact":
        # Without random numbers, every repetition is the image.
        repeated = [made.image] * compare.LEAST_REPLICATES
    elif options.replicates:
        numbers = {"number": options.replicates, "seed": options.seed}
        repeated = render.replicates(frame, profiles, settings, made.counts, **numbers, step=step)
    with step.rest("comparing"):
        return compare.compare(made.image, truth.sss, truth.diff, mask, replicates=repeated)


def _sampling(options: argparse.Namespace, settings) -> dict[str, Any]:
    """What the samples were asked to be, None where there are none."""
    if options.method == "exact":
        return dict.fromkeys(("spp", "target_variance", "seed", "settings"))
    asked = {"spp": options.spp or "64", "target_variance": options.target_variance, "seed": options.seed}
    return asked | {"settings": settings._asdict()}


def _tell(options: argparse.Namespace, summary: dict[str, Any]) -> None:
    parts = [f"{summary['pixels']} pixels"]
    if options.method == "scatter":
        parts.append(f"mean count {summary['mean_count']:.2f}")
    if summary["bias"] is not None:
        errors = summary["bias_se"] or (math.nan,) * 3
        bias = ", ".join(f"{b:+.5f} +- {e:.5f}" for b, e in zip(summary["bias"], errors, strict=True))
        error = ", ".join(f"{100 * e:.2f}" for e in summary["relative_l2"])
        parts += [f"psnr {summary['psnr']:.2f} dB", f"relative L2 {error} %", f"bias {bias}"]
    print(f"{'; '.join(parts)}: see {Path(options.out) / 'scattered.png'}")


class _Steps:
    """Passes as they go by: shown, timed, and not torn apart by Ctrl-C."""

    def __init__(self, progress, task):
        self.seconds: dict[str, float] = {}
        self._progress, self._task = progress, task

    @contextmanager
    def __call__(self, name: str, share: float = 1.0) -> Iterator[None]:
        """A pass, or a piece of one; Ctrl-C waits for its end."""
        from sssfit.files.atomic import interrupt_deferred

        self._progress.update(self._task, description=name)
        with interrupt_deferred():
            start = time.perf_counter()
            yield
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
        self._progress.advance(self._task, share)

    @contextmanager
    def rest(self, name: str) -> Iterator[None]:
        """What is done between other passes, without their time."""
        start, before = time.perf_counter(), sum(self.seconds.values())
        yield
        self.seconds[name] = time.perf_counter() - start - (sum(self.seconds.values()) - before)


@contextmanager
def _passes(options: argparse.Namespace, frame, profiles) -> Iterator[_Steps]:
    """A bar on the terminal with one step for each pass."""
    import numpy as np

    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    if options.method == "exact":
        total = sum(profiles.get(int(number)) is not None for number in np.unique(frame.profile_id)) + 1
    else:
        repeated = options.replicates if options.reference else 0
        total = 3 + 2 * (options.target_variance is not None) + repeated
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    visible = sys.stderr is not None and sys.stderr.isatty() and not options.quiet
    with Progress(*columns, console=Console(file=sys.stderr), disable=not visible) as progress:
        yield _Steps(progress, progress.add_task("", total=total))
