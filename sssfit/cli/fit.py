"""`sssfit fit`: c and a separable falloff here, measured profiles in `fit_profile`."""

import argparse

from sssfit.cli import fit_profile
from sssfit.cli.printing import busy, plain, print_json, print_table

_C_EXAMPLE = """\
examples:
  sssfit fit c --json
  sssfit fit c --objective kl --solver all
"""
_SEPARABLE_EXAMPLE = """\
examples:
  sssfit fit separable --falloff 1 0.37 0.3
  sssfit fit separable --falloff 0.8 --reading as_coded --objective ratio --domain 0.1 6 --json
"""


def add_command(commands) -> None:
    """Add `fit` and its two fits to the parser's commands."""
    from sssfit.fitting import inverse_cdf, separable_to_burley, solve

    command = commands.add_parser("fit", help="fit parameters", description="Fit parameters from curves.")
    fits = command.add_subparsers(metavar="WHAT", required=True)
    c = fits.add_parser(
        "c",
        help="the constant of the papers' approximate inverse cdf",
        description="Fit c of g(xi | c) = d ((2 - c) xi - 2) ln(1 - xi) to Burley's inverse cdf.",
        epilog=_C_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    c.add_argument(
        "--objective",
        choices=inverse_cdf.OBJECTIVES,
        default="cdf_mse",
        help="what to minimize (default: %(default)s, which gives the published 2.5715)",
    )
    c.set_defaults(run=run_c)
    separable = fits.add_parser(
        "separable",
        help="Burley's albedo and dmfp for a separable falloff colour",
        description="Fit Burley's albedo and diffuse mean free path to the separable kernel's falloff.",
        epilog=_SEPARABLE_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_separable_options(separable, separable_to_burley)
    separable.set_defaults(run=run_separable)
    for fit in (c, separable):
        fit.add_argument(
            "--solver",
            choices=[*solve.SOLVERS, "all"],
            default="optimistix",
            help="which solver, or all three to compare them (default: %(default)s)",
        )
        fit.add_argument("--json", action="store_true", help="print the whole result as JSON")
        fit.add_argument("--quiet", action="store_true", help="print the fitted numbers alone")
    fit_profile.add_command(fits)


def _add_separable_options(command, module) -> None:
    command.add_argument(
        "--falloff",
        type=float,
        nargs="+",
        default=list(module.DEFAULT_FALLOFF),
        metavar="F",
        help="falloff of each channel, in (0, 1] (default: 1 0.37 0.3)",
    )
    command.add_argument("--objective", choices=module.OBJECTIVES, default="difference")
    command.add_argument(
        "--reading",
        choices=module.READINGS,
        default="radial",
        help="fit r R(r) to r P(r) (radial, default) or to P(r) (as_coded)",
    )
    command.add_argument(
        "--domain",
        type=float,
        nargs=2,
        metavar=("LOWER", "UPPER"),
        help="distances to compare, in units of falloff + 0.001 (default: 0 30; ratio: 0.1 6)",
    )
    command.add_argument("--points", type=int, help="nodes on the domain (default: 64)")
    command.add_argument("--spacing", choices=["gauss", "uniform"], help="integral or plain sum")
    command.add_argument("--free-albedo", action="store_true", help="let the albedo exceed 1")
    command.add_argument("--normalize", action="store_true", help="compare shapes only, not amplitudes")


def run_c(options: argparse.Namespace) -> int:
    """Run `sssfit fit c`."""
    from sssfit.fitting.inverse_cdf import fit_c

    with busy(options, f"fitting c, {options.objective}"):
        result = fit_c(options.objective, options.solver)
    if options.json:
        print_json(plain(result))
    elif options.quiet:
        print(f"{result.c:.6g}")
    else:
        rows = [("c", f"{result.c:.10g}"), ("objective", result.objective)]
        rows += [(name.replace("_", " "), f"{value:.6g}") for name, value in plain(result.report).items()]
        print_table(["", "value"], rows)
        _print_solvers(result)
    return 0 if result.converged else 1


def run_separable(options: argparse.Namespace) -> int:
    """Run `sssfit fit separable`."""
    import numpy as np

    from sssfit.fitting import separable_to_burley

    changes = {"num_points": options.points, "spacing": options.spacing}
    if options.domain:
        changes |= {"lower": options.domain[0], "upper": options.domain[1]}
    default = separable_to_burley.DEFAULT_DOMAINS[options.objective]
    domain = default._replace(**{name: value for name, value in changes.items() if value is not None})
    with busy(options, "fitting"):
        results = [
            separable_to_burley.fit(
                falloff,
                options.objective,
                reading=options.reading,
                domain=domain,
                albedo_bounds=(0.0, np.inf if options.free_albedo else 1.0),
                normalize=options.normalize,
                solver=options.solver,
            )
            for falloff in options.falloff
        ]
    if options.json:
        print_json({"domain": domain._asdict(), "fits": [plain(result) for result in results]})
    elif options.quiet:
        for result in results:
            print(f"{result.albedo:.6g} {result.d:.6g} {result.dmfp:.6g}")
    else:
        print_table(
            ["falloff", "albedo", "d [mm]", "dmfp [mm]", "residual"],
            [_separable_row(result) for result in results],
        )
        for result in results:
            condition = f"condition number {result.identifiability.condition_number:.3g}"
            print(f"falloff {result.falloff:g}: {result.reason or condition}")
            _print_solvers(result)
    return 0 if all(result.converged for result in results) else 1


def _separable_row(result) -> tuple[str, ...]:
    def cell(value, interval):
        return f"{value:.5g}\n[{interval[0]:.3g}, {interval[1]:.3g}]" if value == value else "undetermined"

    return (
        f"{result.falloff:g}",
        cell(result.albedo, result.albedo_interval) + ("\n(at its bound)" if result.at_bound else ""),
        cell(result.d, result.d_interval),
        cell(result.dmfp, result.dmfp_interval),
        f"{result.relative_residual:.3g}",
    )


def _print_solvers(result) -> None:
    print(f"{result.status}")
    if len(result.solutions) > 1:
        print(f"the solvers disagree by at most {result.disagreement:.1e}")
