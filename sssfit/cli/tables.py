"""`sssfit tables`: from a file of materials to tables that an engine loads."""

import argparse
import sys
from pathlib import Path

_EXAMPLE = """\
examples:
  sssfit tables --out tables
  sssfit tables data/materials.csv --out tables --formats exr-half hlsl --size 256
"""

_HELP = """\
Write lookup tables for the materials of a CSV file: the inverse cdf, the separable falloff fitted to Burley's
parameters, and for each material transmittance, pre-integrated skin lighting, its shadow companion and a
separable kernel; with a plot of each, report.html and manifest.json. Without a file the shipped measurements
are used. The same input and options give the same bytes on the same kind of machine, except timing.json.
"""


def add_command(commands) -> None:
    """Add `tables` to the parser's commands."""
    from sssfit.tables.collection import Sizes
    from sssfit.tables.formats import ENCODERS

    command = commands.add_parser(
        "tables",
        help="write lookup tables for materials",
        description=_HELP,
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument(
        "materials",
        nargs="?",
        metavar="MATERIALS.csv",
        help="a CSV file, named before --formats; columns material, unit, and either "
        "sigma_s_reduced_{r,g,b}, sigma_a_{r,g,b}, eta, or "
        "albedo_{r,g,b}, dmfp_{r,g,b} (default: the shipped measurements)",
    )
    command.add_argument("--out", required=True, metavar="DIR", help="output directory, made if missing")
    command.add_argument(
        "--formats",
        nargs="+",
        choices=[*ENCODERS, "all"],
        default=["all"],
        metavar="FORMAT",
        help=f"some of {', '.join(ENCODERS)} (default: all)",
    )
    command.add_argument(
        "--size",
        type=int,
        default=Sizes.line,
        metavar="N",
        help="entries of 1-D tables, from 12 to 65536 (default: %(default)s)",
    )
    command.add_argument(
        "--size-2d",
        type=int,
        default=Sizes.image,
        metavar="N",
        help="entries along each side of 2-D tables, from 2 to 1024; one more than a multiple of 20 puts the "
        "kinks on entries (default: %(default)s)",
    )
    command.add_argument("--quiet", action="store_true", help="show no progress")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run `sssfit tables`."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        from sssfit.tables.collection import Sizes
        from sssfit.tables.writing import FORMATS, write

    formats = FORMATS if "all" in options.formats else tuple(dict.fromkeys(options.formats))
    columns = (TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    sizes = Sizes(options.size, options.size_2d)
    visible = sys.stderr is not None and sys.stderr.isatty() and not options.quiet
    if not options.out:
        raise ValueError("--out must name a directory; use . for the current one")
    with Progress(*columns, console=Console(file=sys.stderr), disable=not visible) as progress:
        task = progress.add_task("reading", total=None)

        def show(title: str, done: int, total: int) -> None:
            progress.update(task, description=title, completed=done, total=total)

        manifest = write(options.out, options.materials, formats, sizes, show)
    out = Path(options.out)
    for left_out in manifest["skipped"]:
        print(f"{left_out['material']}: no tables, {left_out['reason']}")
    for table in manifest["tables"]:
        for name, stored in table["formats"].items():
            if "omitted" in stored:
                print(f"{table['path']}: not written as {name}, {stored['omitted']}")
    print(f"{len(manifest['tables'])} tables in {len(manifest['files'])} files: open {out / 'report.html'}")
    return 0
