"""`sssfit trade`: what each approximation costs and loses, here and now."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_EXAMPLE = """\
examples:
  sssfit trade --quick --out trade
  sssfit trade --only inverse_cdfs radius_tables --out trade
  sssfit trade --frame frame.exr --camera camera.json --profile skin1 --only counts --out trade
"""
_QUICK_ROUNDS, _ROUNDS = 5, 9


def add_command(commands) -> None:
    """Add `trade` to the parser's commands."""
    command = commands.add_parser(
        "trade",
        help="measure what each approximation costs and what it loses, with Pareto fronts",
        description="Run the approximations of the package side by side on this machine, in turns, and write "
        "a picture for each group and study, report.html, trade.csv, trade.json, a CSV for each study and "
        "manifest.json. What is measured is kept in DIR/measured as it comes; --resume goes on with it.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("--out", required=True, metavar="DIR", help="output directory, made if missing")
    command.add_argument("--quick", action="store_true", help="fewer choices, smaller arrays, fewer rounds")
    command.add_argument(
        "--only", nargs="+", metavar="GROUP", help="these groups or studies alone (default: all)"
    )
    command.add_argument("--rounds", type=int, metavar="N", help=f"default: {_ROUNDS}, quick {_QUICK_ROUNDS}")
    command.add_argument("--frame", metavar="FRAME.exr", help="to be scattered (default: a procedural one)")
    command.add_argument("--camera", metavar="FILE", help="camera.json of the frame")
    command.add_argument("--profile", help="of the frame, as for sssfit render")
    command.add_argument("--resume", action="store_true", help="go on with what DIR/measured has")
    command.add_argument("--quiet", action="store_true", help="show no progress")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run `sssfit trade`."""
    from sssfit.files.atomic import interrupt_deferred

    if not options.out:
        raise ValueError("--out must name a directory; use . for the current one")
    with interrupt_deferred():
        from sssfit.cli import render_options
        from sssfit.trade import registry, writing
    groups, studies = registry.chosen(options.only)
    rounds = options.rounds or (_QUICK_ROUNDS if options.quick else _ROUNDS)
    if options.rounds is not None and options.rounds < 3:
        raise ValueError(f"--rounds must be at least 3, got {options.rounds}")
    setting = _setting(options)
    ledger = writing.Ledger(Path(options.out), writing.conditions(setting, rounds), options.resume)
    found, studied = [], []
    with _progress(options, len(groups) + len(studies)) as (tell, advance):
        for group in groups:
            found.append(ledger.measured(group, setting, rounds, tell))
            advance()
        for study in studies:
            studied.append(ledger.studied(study, setting, rounds, tell))
            advance()
    writing.write(options.out, found, studied, ledger.conditions, render_options.asked(options))
    for each in found:
        print(_sentence(each))
    for each in studied:
        for sentence in each.finding.sentences if each.finding else [f"not measured, {each.skipped}"]:
            print(f"{each.study.name}: {sentence}")
    print(f"see {Path(options.out) / 'report.html'}")
    return 0


def _setting(options: argparse.Namespace):
    """What is measured on."""
    from sssfit.cli import render_options
    from sssfit.frames import gbuffer
    from sssfit.trade import setting

    if options.frame is None:
        for name in ("camera", "profile"):
            if getattr(options, name) is not None:
                raise ValueError(f"--{name} belongs to --frame")
        return setting.procedural_setting(options.quick)
    for name in ("camera", "profile"):
        if getattr(options, name) is None:
            raise ValueError(f"--frame needs --{name}")
    frame = gbuffer.load(options.frame, options.camera, tell=_warn)
    ids = sorted(set(frame.profile_id.ravel().tolist()) - {0})
    profiles = render_options.profiles_of(options, ids, None)
    return setting.Setting(options.quick, frame, profiles, Path(options.frame).name)


def _warn(text: str) -> None:
    print(f"warning: {text}", file=sys.stderr)


@contextmanager
def _progress(
    options: argparse.Namespace, groups: int
) -> Iterator[tuple[Callable[[str], None], Callable[[], None]]]:
    """What is told what is done, and what is called after each group; a bar on a terminal."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("groups"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    visible = sys.stderr is not None and sys.stderr.isatty() and not options.quiet
    with Progress(*columns, console=Console(file=sys.stderr), disable=not visible) as progress:
        task = progress.add_task("", total=groups)
        yield lambda text: progress.update(task, description=text), lambda: progress.advance(task)


def _sentence(each) -> str:
    """What is printed of a group."""
    from sssfit.trade.pareto import beaten_by

    name = each.group.name
    if each.skipped:
        return f"{name}: not measured, {each.skipped}"
    best = [row.choice for row in each.rows if not beaten_by(row, each.rows, each.group)]
    return f"{name}: {len(each.rows)} choices, on the front {'; '.join(best)}"
