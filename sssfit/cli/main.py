"""`sssfit`: parse the command line, run one command, and turn trouble into one sentence."""

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version

#: Exit code of bad input, and of an interrupted run.
BAD_INPUT = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `sssfit` with these arguments (those of the process by default).

    Returns:
        The exit code: 0, 1 for a fit that did not converge or a bound or row that failed, 2 for bad input or
        an interruption.

    Example:
        >>> main(["fit", "c", "--objective", "mean_radius", "--quiet"])
        2.66667
        0
    """
    # Interrupting during the imports below must be no traceback either.
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        message = "interrupted; outputs are either as before or complete, run again to finish"
        print(f"sssfit: {message}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:
        # The reader of our output has gone; Python would complain again when it flushes at exit.
        sys.stdout = None
        return BAD_INPUT


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    from sssfit.files.atomic import interrupt_deferred

    # Ctrl-C inside the imports of compiled code crashes or is lost.
    with interrupt_deferred():
        from sssfit.cli import fit, procedural_frame, render, reproduce, simulate, tables, trade

    top = argparse.ArgumentParser(
        prog="sssfit",
        description="Fits, tables, simulations and frames for subsurface scattering. Lengths are in mm.",
        epilog="example: sssfit tables --out tables",
    )
    top.add_argument("--version", action="version", version=f"sssfit {version('sssfit')}")
    commands = top.add_subparsers(metavar="COMMAND", required=True)
    with interrupt_deferred():
        fit.add_command(commands)
        tables.add_command(commands)
        simulate.add_command(commands)
        procedural_frame.add_command(commands)
        render.add_command(commands)
        trade.add_command(commands)
        reproduce.add_command(commands)
    return top


def _run(arguments: Sequence[str] | None) -> int:
    from sssfit.files.errors import FileError

    options = parser().parse_args(arguments)
    try:
        return options.run(options)
    except (FileError, ValueError) as error:
        print(f"sssfit: {error}", file=sys.stderr)
        return BAD_INPUT
