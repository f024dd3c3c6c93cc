"""`sssfit reproduce`: measured again what the documentation states."""

import argparse
import sys

_EXAMPLE = """\
examples:
  sssfit reproduce stability
  sssfit reproduce stability --quick --json
"""
_HELP = """\
Measure the moving moments at the extremes: weights from 1e-6 to 1, large means, values whose squares
underflow or overflow, constant and alternating input, ten million updates, nearly collinear vectors, NaN and
inf, and where half formats stop following. Each line has the bound that rounding implies and the value
measured on this machine; it takes about half a minute. Exit code 0 if all bounds hold, else 1.
"""
#: Samples of the long streams with --quick.
_QUICK = 100_000


def add_command(commands) -> None:
    """Add `reproduce` and what it can reproduce to the parser's commands."""
    command = commands.add_parser(
        "reproduce", help="measure stated numbers again", description="Measure stated numbers again."
    )
    subjects = command.add_subparsers(metavar="WHAT", required=True)
    stability = subjects.add_parser(
        "stability",
        help="the moving moments at the extremes",
        description=_HELP,
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    stability.add_argument("--quick", action="store_true", help="a hundred thousand updates, not ten million")
    stability.add_argument("--json", action="store_true", help="print JSON instead of a table")
    stability.add_argument("--quiet", action="store_true", help="show no progress")
    stability.set_defaults(run=run_stability)


def run_stability(options: argparse.Namespace) -> int:
    """Run `sssfit reproduce stability`."""
    from rich.console import Console

    from sssfit.estimators import stability
    from sssfit.files.atomic import interrupt_deferred

    rows = []
    measured = stability.table(long=_QUICK if options.quick else stability.LONG)
    console = Console(stderr=True, quiet=options.quiet or options.json or not sys.stderr.isatty())
    with console.status("measuring") as status:
        while True:
            # Ctrl-C inside compiled work crashes or is lost; between rows it is safe.
            with interrupt_deferred():
                row = next(measured, None)
            if row is None:
                break
            rows.append(row)
            status.update(f"measured {row.case}, {row.dtype}")
    _print(rows, as_json=options.json)
    return 0 if all(row.holds for row in rows) else 1


def _print(rows, *, as_json: bool) -> None:
    if as_json:
        from sssfit.files.json_text import json_text

        print(json_text([{**row._asdict(), "holds": row.holds} for row in rows]), end="")
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table("input", "quantity", "dtype", "bound", "measured", "", box=box.SIMPLE)
    for row in rows:
        numbers = (f"{row.bound:.2g}", f"{row.measured:.2g}")
        table.add_row(row.case, row.quantity, row.dtype, *numbers, "holds" if row.holds else "FAILS")
    # A pipe has no width; a row is one line there.
    console = Console() if sys.stdout.isatty() else Console(width=120)
    console.print(table)
    failed = sum(not row.holds for row in rows)
    print(f"{len(rows) - failed} of {len(rows)} bounds hold")
