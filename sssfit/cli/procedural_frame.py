"""`sssfit procedural-frame`: frames to begin with, without another program."""

import argparse
import sys
from pathlib import Path
from typing import Any

_EXAMPLE = """\
examples:
  sssfit procedural-frame --out frames
  sssfit procedural-frame --frames 48 --width 480 --height 270 --out sequence
"""


def add_command(commands) -> None:
    """Add `procedural-frame` to the parser's commands."""
    command = commands.add_parser(
        "procedural-frame",
        help="write frames of a small scene: irradiance, depth, normals, ids, motion",
        description="Write frames of a ball (id 1, skin1) before a tilted board (id 2, marble) under a light "
        "with a hard edge: frame_00.exr and so on, camera.json, a picture of the first frame, and "
        "manifest.json. Ball and camera move from frame to frame. The same options give the same bytes on "
        "the same kind of machine.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("--out", required=True, metavar="DIR", help="output directory, made if missing")
    command.add_argument("--frames", type=int, default=1, metavar="N", help="how many (default: %(default)s)")
    command.add_argument("--width", type=int, default=640, help="pixels (default: %(default)s)")
    command.add_argument("--height", type=int, default=360, help="pixels (default: %(default)s)")
    command.add_argument(
        "--half", action="store_true", help="half numbers for all layers but depth and id (default: float)"
    )
    command.add_argument("--quiet", action="store_true", help="show no progress")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run `sssfit procedural-frame`."""
    from sssfit.files.atomic import interrupt_deferred

    if not options.out:
        raise ValueError("--out must name a directory; use . for the current one")
    if options.frames < 1:
        raise ValueError(f"--frames must be at least 1, got {options.frames}")
    with interrupt_deferred():
        from rich.console import Console
        from rich.progress import track

        from sssfit.files.json_text import json_text
        from sssfit.files.output import output_directory
        from sssfit.frames import gbuffer, preview, procedural
    size: dict[str, Any] = {"width": options.width, "height": options.height}
    digits = max(2, len(str(options.frames - 1)))
    names = [f"frame_{index:0{digits}}.exr" for index in range(options.frames)]
    description = procedural.describe(range(options.frames), names, **size)
    visible = sys.stderr is not None and sys.stderr.isatty() and not options.quiet
    asked = {"frames": options.frames, "half": options.half, **size}
    manifest = {"command": "procedural-frame", "options": asked}
    with output_directory(options.out, manifest, packages=("OpenEXR", "pillow")) as output:
        output.put("camera.json", json_text(description).encode())
        shown = track(names, "frames", console=Console(file=sys.stderr), disable=not visible)
        for index, name in enumerate(shown):
            with interrupt_deferred():
                made = procedural.frame(index, **size)
                output.put(name, gbuffer.encode(made, half=options.half))
                if index == 0:
                    output.put("preview.png", preview.layers(made))
    picture = Path(options.out) / "preview.png"
    print(f"frames of {options.width} x {options.height} pixels: {options.frames}; see {picture}")
    return 0
