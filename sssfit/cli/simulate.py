"""`sssfit simulate circle`, `line` and `batch-mean`: small worlds whose exact answers are known."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_CIRCLE_EXAMPLE = """\
examples:
  sssfit simulate circle --controller spvg --kappa 1 --out circle
  sssfit simulate circle --controller in_frame --light sine --frequency 5 --out flicker
  sssfit simulate circle --profile burley --radius 10 --distance 10.5 --d 0.5 --out beam
"""
_LINE_EXAMPLE = """\
examples:
  sssfit simulate line --controller as --light sine --out as
  sssfit simulate line --controller ocv --light candle --out ocv
  sssfit simulate line --controller in_frame --profile step --light on_off --out in_frame
"""
_BATCH_EXAMPLE = """\
example:
  sssfit simulate batch-mean --seeds 1000 --out batch_mean
"""
_OUTPUTS = """
Written are summary.json, a picture, CSV and NPZ files of counts, variances and results, and manifest.json.
The same options give the same bytes on the same kind of machine.
"""


def add_command(commands) -> None:
    """Add `simulate` and its scenarios to the parser's commands."""
    command = commands.add_parser(
        "simulate",
        help="simulate sample counts where the right answer is known",
        description="Simulate sample counts in small worlds whose exact answers are known.",
    )
    scenarios = command.add_subparsers(metavar="SCENARIO", required=True)

    def add(name: str, summary: str, text: str, epilog: str, run: Callable, seeds: int):
        scenario = scenarios.add_parser(
            name,
            help=summary,
            description=text + _OUTPUTS,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        scenario.add_argument("--out", required=True, metavar="DIR", help="output directory, made if missing")
        scenario.add_argument(
            "--seeds", type=int, default=seeds, metavar="S", help="repetitions (default: %(default)s)"
        )
        scenario.add_argument(
            "--seed", type=int, default=0, metavar="N", help="of the random numbers (default: %(default)s)"
        )
        scenario.add_argument("--quiet", action="store_true", help="show no progress")
        scenario.set_defaults(run=run)
        return scenario

    circle = add(
        "circle",
        "one pixel and a circle of light",
        "One pixel averages uniform points over a circle of light, or Burley's profile over a beam.",
        _CIRCLE_EXAMPLE,
        run_circle,
        1000,
    )
    _add_controller(circle, "spvg", 0.0064, "cold", frames=150)
    circle.add_argument("--profile", choices=["uniform", "burley"], default="uniform")
    circle.add_argument("--radius", type=float, default=1.0, help="of burley's beam, mm (default: 1)")
    circle.add_argument(
        "--distance", type=float, default=0.5, help="from the beam's centre, mm (default: 0.5)"
    )
    circle.add_argument("--d", type=float, default=0.5, help="burley's shape parameter, mm (default: 0.5)")
    line = add(
        "line",
        "a line of texels under varying light",
        "A line of texels, lit by a profile times an intensity over time, scatters by Burley's line spread.",
        _LINE_EXAMPLE,
        run_line,
        16,
    )
    _add_controller(line, "as", 1e-4, "disocclusion", frames=120)
    line.add_argument(
        "--profile",
        default="ramp",
        metavar="NAME|FILE.csv",
        help="step, ramp or pulse, or a CSV file with the columns x (mm) and irradiance (default: ramp)",
    )
    line.add_argument(
        "--amplitude", type=float, default=0.5, help="irradiance of a named profile (default: 0.5)"
    )
    line.add_argument("--length", type=float, default=4.0, metavar="MM", help="of the line (default: 4)")
    line.add_argument("--texels", type=int, default=512, metavar="N", help="on it (default: 512)")
    line.add_argument("--d", type=float, default=0.05, help="burley's shape parameter, mm (default: 0.05)")
    line.add_argument(
        "--kernel",
        choices=["line", "radial"],
        default="line",
        help="burley's line spread (default), or his radius to either side",
    )
    add(
        "batch-mean",
        "Table B.1 of the dissertation",
        "The five residuals of the dissertation's appendix B, and its ground truth.",
        _BATCH_EXAMPLE,
        run_batch_mean,
        1000,
    )


def _add_controller(scenario, controller: str, target_variance: float, start: str, *, frames: int) -> None:
    from sssfit.estimators import policies
    from sssfit.scenarios import driver, light

    def number(name: str, default, text: str, kind=float) -> None:
        scenario.add_argument(name, type=kind, default=default, help=f"{text} (default: %(default)s)")

    scenario.add_argument(
        "--controller", choices=policies.NAMES, default=controller, help="default: %(default)s"
    )
    number("--target-variance", target_variance, "of a frame's result")
    scenario.add_argument(
        "--alpha", type=float, help="weight of the newest frame (default: 0.2; in_frame: 0.02)"
    )
    number("--kappa", 0.2, "share of the correction made at once, in [0, 1]")
    number("--min-spp", 8, "smallest count", int)
    number("--max-spp", 64, "largest count", int)
    number("--spp", 16, "the count of the controller fixed", int)
    scenario.add_argument(
        "--control",
        choices=policies.LIGHTS,
        help="the light that ocv, ccv and in_frame know of: on the pixel (control, the default of ocv and "
        "ccv) or around it (surround, that of in_frame)",
    )
    number("--frames", frames, "how many", int)
    scenario.add_argument(
        "--start", choices=driver.STARTS, default=start, help="history before the first frame"
    )
    scenario.add_argument(
        "--sequence",
        choices=driver.SEQUENCES,
        default="iid",
        help="independent points, or the R2 sequence from a random start in each frame (default: iid)",
    )
    scenario.add_argument(
        "--light",
        default="static",
        metavar="NAME|FILE.csv",
        help=f"{', '.join(light.LIGHTS)}, or a CSV file with the columns time (s) and intensity "
        "(default: static)",
    )
    scenario.add_argument("--frequency", type=float, help="of sine and on_off, 1/s (default: 1)")
    scenario.add_argument(
        "--depth", type=float, help="of sine (default: 0.5) and on_off (default: 1), in [0, 1]"
    )
    number("--fps", light.FPS, "frames per second")


def run_circle(options: argparse.Namespace) -> int:
    """Run `sssfit simulate circle`."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from sssfit.scenarios import circle, writing

        intensity, policy, target = _world_options(options)
        if options.profile == "uniform":
            world = circle.uniform(intensity)
        else:
            world = circle.beam(intensity, distance=options.distance, radius=options.radius, d=options.d)
    with _writable(options), _progress(options) as show:
        found, record = writing.simulate(world, policy, target, **_run_options(options), progress=show)
        summary = writing.write_circle(options.out, found, record, _asked(options))
    print(
        f"steady mean count {summary['steady_mean_count']:.3f} +- {summary['steady_mean_count_se']:.3f}, "
        f"oracle {summary['oracle_count']:.3f}; delivered variance "
        f"{summary['delivered_variance_over_target']:.3f} x target: see "
        f"{Path(options.out) / 'simulation.png'}"
    )
    return 0


def run_line(options: argparse.Namespace) -> int:
    """Run `sssfit simulate line`."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        import numpy as np

        from sssfit.scenarios import light, line, writing

        intensity, policy, target = _world_options(options)
    x = line.centres(options.texels, options.length)
    if options.profile in line.PROFILES:
        lit = line.PROFILES[options.profile](x, amplitude=options.amplitude)
    else:
        lit = line.load(_file(options.profile, "profile", line.PROFILES), x)
    shape: dict[str, Any] = {"length": options.length, "d": options.d, "kernel": options.kernel}

    def simulate(brightness, show):
        irradiance = (brightness[:, None] * lit).astype(np.float32)
        with interrupt_deferred():
            world = line.world(irradiance, **shape)
        return writing.simulate(world, policy, target, **_run_options(options), first=0, progress=show)

    with _writable(options), _progress(options) as show:
        found, record = simulate(intensity, show)
        unchanged = light.static(options.frames)
        static = found if np.array_equal(intensity, unchanged) else simulate(unchanged, show)[0]
        shown: dict[str, Any] = {"static": static, "x": x, "light": lit, "intensity": intensity}
        summary = writing.write_line(options.out, found, record, _asked(options), **shown)
    print(
        f"mean count {summary['mean_count']:.2f}, {summary['static_ratio']:.2f} x that of static light, "
        f"oracle {summary['oracle_count']:.2f}; image rmse {summary['image_rmse']:.5f}: see "
        f"{Path(options.out) / 'simulation.png'}"
    )
    return 0


def run_batch_mean(options: argparse.Namespace) -> int:
    """Run `sssfit simulate batch-mean`."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from sssfit.scenarios import writing
    with _writable(options), _progress(options) as show:
        summary = writing.write_batch_mean(options.out, seeds=options.seeds, seed=options.seed, progress=show)
    for light in ("static", "dynamic"):
        medians = ", ".join(f"{row['name']} {row['median']:.4f}" for row in summary[light])
        print(f"{light}, medians: {medians}")
    print(f"see {Path(options.out) / 'simulation.png'}")
    return 0


def _world_options(options: argparse.Namespace):
    """Intensities, controller and target that the options name."""
    from sssfit.estimators import policies
    from sssfit.scenarios import light
    from sssfit.scenarios.measure import Target

    varied = {name: getattr(options, name) for name in ("frequency", "depth")}
    varied = {name: value for name, value in varied.items() if value is not None}
    if options.light in light.LIGHTS:
        if varied and options.light not in ("sine", "on_off"):
            raise ValueError(
                f"--{next(iter(varied))} belongs to sine and on_off, the light is {options.light}"
            )
        intensity = light.LIGHTS[options.light](options.frames, fps=options.fps, **varied)
    else:
        path = _file(options.light, "light", light.LIGHTS)
        intensity = light.load(path, options.frames, fps=options.fps)
    policy = policies.named(
        options.controller,
        target_variance=options.target_variance,
        alpha=options.alpha,
        kappa=options.kappa,
        min_spp=options.min_spp,
        max_spp=options.max_spp,
        spp=options.spp,
        light=options.control,
        gain_alpha=policies.GAIN_ALPHA if options.sequence == "r2" else None,
    )
    return intensity, policy, Target(options.target_variance, options.min_spp, options.max_spp)


def _file(name: str, what: str, known) -> Path:
    if not name.endswith(".csv"):
        raise ValueError(f"--{what} must be one of {', '.join(known)}, or a CSV file, got {name!r}")
    return Path(name)


def _run_options(options: argparse.Namespace) -> dict[str, Any]:
    return {name: getattr(options, name) for name in ("seeds", "seed", "start", "sequence")}


def _asked(options: argparse.Namespace) -> dict[str, Any]:
    """The options, for the record; files by their names, and what was in them."""
    from sssfit.files.json_text import sha256_bytes
    from sssfit.files.reading import read_bytes

    left_out = ("run", "out", "quiet")
    asked = {name: value for name, value in vars(options).items() if name not in left_out}
    files = {name: Path(asked[name]) for name in ("light", "profile") if asked[name].endswith(".csv")}
    inputs = {name: sha256_bytes(read_bytes(path)) for name, path in files.items()}
    return asked | {name: path.name for name, path in files.items()} | {"inputs_sha256": inputs}


def _writable(options: argparse.Namespace):
    """Find out before the work, and not after it, whether its result can be written."""
    from sssfit.files.atomic import staged_directory

    if not options.out:
        raise ValueError("--out must name a directory; use . for the current one")
    return staged_directory(options.out)


@contextmanager
def _progress(options: argparse.Namespace) -> Iterator[Callable[[int, int], None]]:
    """A bar on the terminal, which is told what is done and how much there is."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    columns = (TextColumn("seeds"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    visible = sys.stderr is not None and sys.stderr.isatty() and not options.quiet
    with Progress(*columns, console=Console(file=sys.stderr), disable=not visible) as progress:
        task = progress.add_task("", total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)
