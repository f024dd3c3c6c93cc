"""`sssfit reproduce`: computed again what the papers print, and measured what the documentation states."""

import argparse
import importlib
import math
import sys
from collections.abc import Iterator, Sequence

_EXAMPLE = """\
examples:
  sssfit reproduce
  sssfit reproduce --json --quiet > published.json
"""
_HELP = """\
Compute again every number that the papers print and that needs no game engine, and show both side by side:
"reproduced" where the printed one is ours within its rounding and our standard error, "differs" where it is
known not to be, with the reason, and "FAILS" otherwise. It takes about a minute. Exit code 0 if none fails,
else 1.
"""
_STABILITY_EXAMPLE = """\
examples:
  sssfit reproduce stability
  sssfit reproduce stability --quick --json
"""
_STABILITY_HELP = """\
Measure the moving moments at the extremes: weights from 1e-6 to 1, large means, values whose squares
underflow or overflow, constant and alternating input, ten million updates, nearly collinear vectors, NaN and
inf, and where half formats stop following. Each line has the bound that rounding implies and the value
measured on this machine; it takes about half a minute. Exit code 0 if all bounds hold, else 1.
"""
#: Topics whose module `published` has rows of printed numbers.
PUBLISHED = ("profiles", "fitting", "tables", "estimators", "scenarios")
#: Samples of the long streams with --quick.
_QUICK = 100_000
#: Columns of a table that is not shown on a terminal: more than the longest row has.
_PIPE_WIDTH = 400
#: Columns of words, which a narrow terminal may break into lines.
_WRAPPED = ("source", "input", "quantity", "reason")


def add_command(commands) -> None:
    """Add `reproduce` and what it can reproduce to the parser's commands."""
    command = commands.add_parser(
        "reproduce",
        help="compute printed or stated numbers again (a minute)",
        description=_HELP,
        epilog=_EXAMPLE,
        # argparse alone would show WHAT as if it were required.
        usage="%(prog)s [-h] [--json] [--quiet] [WHAT ...]",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_output(command, False)
    command.set_defaults(run=run_published)
    title = "other numbers"
    subjects = command.add_subparsers(metavar="WHAT", required=False, title=title, prog=command.prog)
    stability = subjects.add_parser(
        "stability",
        help="the moving moments at the extremes",
        description=_STABILITY_HELP,
        epilog=_STABILITY_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    stability.add_argument("--quick", action="store_true", help="a hundred thousand updates, not ten million")
    # Without a default of its own, so that the option may also stand before WHAT.
    _add_output(stability, argparse.SUPPRESS)
    stability.set_defaults(run=run_stability)


def _add_output(command: argparse.ArgumentParser, default) -> None:
    table, progress = "print JSON instead of a table", "show no progress"
    command.add_argument("--json", action="store_true", default=default, help=table)
    command.add_argument("--quiet", action="store_true", default=default, help=progress)


def run_published(options: argparse.Namespace) -> int:
    """Run `sssfit reproduce`."""

    def rows():
        for topic in PUBLISHED:
            yield from importlib.import_module(f"sssfit.{topic}.published").rows()

    found = _collected(rows(), options, "computed {row.source}, {row.quantity}")
    counts = {verdict: 0 for verdict in ("reproduced", "differs", "FAILS")}
    for row in found:
        counts[row.verdict] += 1
    if options.json:
        shown = ("source", "quantity", "printed", "ours", "standard_error", "spread", "verdict", "reason")
        rows_shown = [{name: getattr(row, name) for name in shown} for row in found]
        _print_json({"rows": rows_shown, "counts": counts})
    else:
        header = ("source", "quantity", "printed", "ours", "standard\nerror", "verdict", "reason")
        _print_table(header, [_cells(row) for row in found])
        print(f"{len(found)} rows: " + ", ".join(f"{counts[verdict]} {verdict}" for verdict in counts))
    return 1 if counts["FAILS"] else 0


def _cells(row) -> tuple[str, ...]:
    """A row of printed numbers as text, ours with two digits more than are printed."""
    decimals = max(0, 2 - round(math.log10(2 * row.rounding)))
    if 0 < abs(row.ours) < 1e-4 and decimals > 5:
        ours = f"{row.ours:.4e}"
    else:
        # Rounded first, so that a tiny negative number is not "-0.00".
        ours = f"{round(row.ours, decimals) + 0.0:.{decimals}f}"
    error = "" if row.standard_error is None else f"{row.standard_error:.2g}"
    return row.source, row.quantity, row.printed, ours, error, row.verdict, row.reason


def run_stability(options: argparse.Namespace) -> int:
    """Run `sssfit reproduce stability`."""
    from sssfit.estimators import stability

    measured = stability.table(long=_QUICK if options.quick else stability.LONG)
    rows = _collected(measured, options, "measured {row.case}, {row.dtype}")
    failed = sum(not row.holds for row in rows)
    if options.json:
        _print_json([{**row._asdict(), "holds": row.holds} for row in rows])
    else:
        lines = [
            (row.case, row.quantity, row.dtype, f"{row.bound:.2g}", f"{row.measured:.2g}", _holds(row))
            for row in rows
        ]
        _print_table(("input", "quantity", "dtype", "bound", "measured", ""), lines)
        print(f"{len(rows) - failed} of {len(rows)} bounds hold")
    return 1 if failed else 0


def _holds(row) -> str:
    return "holds" if row.holds else "FAILS"


def _collected(rows: Iterator, options: argparse.Namespace, progress: str) -> list:
    """All rows, computed one after the other."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from rich.console import Console
        from rich.markup import escape
    found = []
    console = Console(stderr=True, quiet=options.quiet or options.json or not sys.stderr.isatty())
    with console.status("computing") as status:
        while True:
            # Ctrl-C inside compiled work crashes or is lost; between rows it is safe.
            with interrupt_deferred():
                row = next(rows, None)
            if row is None:
                return found
            found.append(row)
            status.update(escape(f"{len(found)}: {progress.format(row=row)}"))


def _print_json(value) -> None:
    from sssfit.files.json_text import json_text

    print(json_text(value), end="")


def _print_table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Column, Table
    from rich.text import Text

    table = Table(*(Column(name, no_wrap=name not in _WRAPPED) for name in header), box=box.SIMPLE)
    for line in lines:
        table.add_row(*(Text(cell) for cell in line))
    if sys.stdout.isatty():
        Console().print(table)
        return
    # A pipe has no width; a row is one line there.
    console = Console(width=_PIPE_WIDTH)
    with console.capture() as text:
        console.print(table)
    print("\n".join(line.rstrip() for line in text.get().splitlines()))
