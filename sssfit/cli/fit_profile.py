"""`sssfit fit profile`: a profile's parameters, with intervals, from a measured curve or an image."""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from sssfit.cli.printing import busy, print_json, print_table

_DESCRIPTION = """\
Fit a profile's parameters to measured curves. Lengths are in mm.

DATA is a CSV file with the columns r_mm; R, or R_r, R_g, R_b; and, where the noise is known, sigma, or
sigma_r, sigma_g, sigma_b. Or it is a linear EXR image of a flat surface, seen from above, of which --pixel-mm
gives the scale: it is averaged in rings around a point or a beam of light, or along a line or an edge.

Written are fit.json, curve.csv, fit.png, table.csv (profile, cdf and transmittance with standard errors),
profile.hlsl, profile.glsl and manifest.json; for burley materials.csv, which `sssfit tables` takes; with
--posterior corner.png. The same options give the same bytes on the same kind of machine. The chain of a
posterior is DIR/chain.h5, written every few seconds: killed at any moment, it goes on with --resume.
"""
_EXAMPLE = """\
examples:
  sssfit fit profile data/profile.csv --out fit
  sssfit fit profile data/profile.csv --model burley dipole gaussians:2 --out compared
  sssfit fit profile data/profile.csv --posterior --steps 2000 --out posterior
"""
_IMAGE = ("pixel_mm", "layer", "center", "axis", "flip", "irradiance")
_MOST_IN_CORNER = 6
_CHAIN = ("walkers", "steps", "seed", "resume")


def add_command(fits) -> None:
    """Add `profile` to the fits."""
    from sssfit.fitting import measured, profile_models, responses, solve

    command = fits.add_parser(
        "profile",
        help="a profile's parameters from measured curves",
        description=_DESCRIPTION,
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.add_argument("data", metavar="DATA", help="a CSV file or an EXR image")
    command.add_argument("--out", required=True, metavar="DIR", help="output directory, made if missing")
    command.add_argument(
        "--model", nargs="+", default=["burley"], metavar="MODEL",
        help=f"{', '.join(profile_models.MODELS)}; of several the best by AICc is written (default: burley)",
    )  # fmt: skip
    command.add_argument(
        "--response", choices=responses.RESPONSES, default="radial",
        help="what the light is: a point (radial, default), a line, an edge or a beam",
    )  # fmt: skip
    command.add_argument("--beam-radius", type=float, metavar="MM", help="of a beam")
    command.add_argument(
        "--weights", choices=measured.WEIGHTINGS,
        help="of squared differences (default: sigma where the noise is known, else area)",
    )  # fmt: skip
    command.add_argument(
        "--loss", choices=measured.LOSSES, default="linear", help="what outliers cost (default: %(default)s)"
    )
    command.add_argument(
        "--shared",
        nargs="+",
        default=[],
        metavar="NAME",
        help="parameters that all channels share, such as d",
    )
    command.add_argument("--eta", type=float, help="a dipole's refractive index (default: 1.3)")
    command.add_argument("--cutoff", type=float, metavar="D", help="end of burley's profile in d; Cycles: 16")
    command.add_argument(
        "--solver", choices=[*solve.SOLVERS, "all"], default="optimistix",
        help="which solver, or all three to compare them (default: %(default)s)",
    )  # fmt: skip
    _add_image_options(command.add_argument_group("of an image"))
    _add_chain_options(command.add_argument_group("posterior"))
    command.add_argument("--json", action="store_true", help="print fit.json")
    command.add_argument("--quiet", action="store_true", help="print names and fitted numbers alone")
    command.set_defaults(run=run)


def _add_image_options(group) -> None:
    group.add_argument("--pixel-mm", type=float, metavar="MM", help="width of a pixel")
    group.add_argument("--layer", metavar="NAME", help="as in sss (default: R, G, B, or the only layer)")
    group.add_argument(
        "--center", type=float, nargs=2, metavar=("COLUMN", "ROW"),
        help="of the light, in pixels from the upper left corner (default: the middle)",
    )  # fmt: skip
    group.add_argument("--axis", choices=["x", "y"], help="across a line or an edge (default: x)")
    group.add_argument("--flip", action="store_true", help="an edge's light is to the right, or below")
    group.add_argument("--irradiance", type=float, help="what values are divided by (default: 1)")


def _add_chain_options(group) -> None:
    group.add_argument("--posterior", action="store_true", help="draw the parameters from it, too")
    group.add_argument("--walkers", type=int, metavar="N", help="(default: 32)")
    group.add_argument("--steps", type=int, metavar="N", help="of each, in all (default: 5000)")
    group.add_argument("--seed", type=int, metavar="N", help="of the random numbers (default: 0)")
    group.add_argument("--resume", action="store_true", help="go on with DIR/chain.h5")


def run(options: argparse.Namespace) -> int:
    """Run `sssfit fit profile`."""
    from sssfit.files.atomic import interrupt_deferred

    if not options.out:
        raise ValueError("--out must name a directory; use . for the current one")
    with interrupt_deferred():
        from sssfit.files.output import output_directory
        from sssfit.frames.sequence_ledger import clear
    models = _models(options)
    _check(options, models)
    data = _same_points(options, models, _measurement(options))
    manifest = {"command": "fit profile", "options": _asked(options)}
    if options.resume:
        clear(options.out)
    with output_directory(options.out, manifest) as output:
        fits = _fitted(options, models, data)
        fit = fits[0]
        posterior, trouble = _sampled(options, fit, data) if options.posterior else (None, "")
        with busy(options, "writing"):
            found, files = _files(options, models[fit.model], fits, data.notes, posterior)
            for name, content in files.items():
                output.put(name, content)
    _tell(options, found)
    if trouble:
        print(f"sssfit: {trouble}", file=sys.stderr)
    return 0 if found["converged"] and not trouble else 1


def _models(options: argparse.Namespace) -> dict[str, Any]:
    """The models that are asked for, by name."""
    from sssfit.fitting import profile_models

    eta = 1.3 if options.eta is None else options.eta
    cutoff = math.inf if options.cutoff is None else options.cutoff
    return {name: profile_models.named(name, eta=eta, cutoff=cutoff) for name in options.model}


def _check(options: argparse.Namespace, models) -> None:
    """Refuse options that do not go together."""
    from sssfit.fitting import responses

    responses.function(options.response, options.beam_radius)
    is_image = Path(options.data).suffix.lower() == ".exr"
    owners = (
        (_IMAGE, is_image, "an EXR image"),
        (_CHAIN, options.posterior, "--posterior"),
        (("eta",), "dipole" in models, "--model dipole"),
        (("cutoff",), "burley" in models, "--model burley"),
        (("axis", "flip"), options.response in ("line", "edge"), "--response line and edge"),
    )
    for names, is_there, owner in owners:
        # A number may be 0, which equals False.
        given = [name for name in names if not any(getattr(options, name) is no for no in (None, False))]
        if given and not is_there:
            raise ValueError(f"--{given[0].replace('_', '-')} belongs to {owner}")
    if is_image and options.pixel_mm is None:
        raise ValueError("--pixel-mm must say how many mm wide a pixel of the image is")


def _measurement(options: argparse.Namespace):
    from sssfit.fitting import measurement, measurement_image

    if Path(options.data).suffix.lower() != ".exr":
        return measurement.load(options.data, response=options.response)
    given = {name: getattr(options, name) for name in _IMAGE if getattr(options, name) is not None}
    with busy(options, "reading"):
        return measurement_image.load_image(options.data, response=options.response, **given)


def _same_points(options: argparse.Namespace, models, data):
    """The points that every model is fitted to."""
    from sssfit.fitting import model_choice

    if len(models) == 1:
        return data
    points = model_choice.same_points(data.r, data.values, data.sigma, list(models), options.response)
    return data._replace(
        r=points.r, values=points.values, sigma=points.sigma, notes=data.notes + points.notes
    )


def _asked(options: argparse.Namespace) -> dict[str, Any]:
    """The options, for the record; the data by its name, and what was in it."""
    from sssfit.files.json_text import sha256_bytes
    from sssfit.files.reading import read_bytes

    left_out = ("run", "out", "quiet", "json", "resume")
    asked = {name: value for name, value in vars(options).items() if name not in left_out}
    data = {"data": Path(options.data).name, "data_sha256": sha256_bytes(read_bytes(options.data))}
    return asked | data


def _arguments(options: argparse.Namespace, data) -> dict[str, Any]:
    """What a fit and a posterior are given alike."""
    names = ("response", "beam_radius", "weights", "loss", "shared")
    given = {name: getattr(options, name) for name in names} | {"channels": data.channels}
    optional = {name: getattr(options, name) for name in ("eta", "cutoff")}
    return given | {name: value for name, value in optional.items() if value is not None}


def _fitted(options: argparse.Namespace, models, data) -> list:
    """A fit by each model, the best first."""
    from sssfit.fitting import measured

    fits = []
    for name in models:
        with busy(options, f"fitting {name}"):
            fits.append(
                measured.fit(
                    data.r, data.values, sigma=data.sigma, model=name, solver=options.solver,
                    **_arguments(options, data),
                )
            )  # fmt: skip
    return sorted(fits, key=lambda fit: fit.aicc if math.isfinite(fit.aicc) else math.inf)


def _sampled(options: argparse.Namespace, fit, data):
    """The posterior, or None and a sentence."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from sssfit.fitting import posterior
    given = {name: getattr(options, name) for name in _CHAIN if getattr(options, name) is not None}
    made = posterior.sample(
        data.r,
        data.values,
        sigma=data.sigma,
        model=fit.model,
        backend=Path(options.out) / "chain.h5",
        progress=not (options.quiet or options.json) and sys.stderr is not None and sys.stderr.isatty(),
        **_arguments(options, data),
        **given,
    )
    if made.converged:
        return made, ""
    try:
        made.summary()
    except posterior.NotConverged as error:
        return None, f"{error}; raise --steps and give --resume"
    return made, ""


def _files(options: argparse.Namespace, model, fits: list, notes, posterior):
    """What fit.json holds, and the content of all files by name."""
    from sssfit.files.json_text import json_text
    from sssfit.fitting import fit_output, fit_plot, fit_table
    from sssfit.tables.formats import shader_constants, shader_dialects

    fit, stem = fits[0], Path(options.data).stem
    found, files = fit_output.summary(fit), {}
    found["notes"] += notes
    if len(fits) > 1:
        found["compared"] = [fit_output.compared(each) for each in fits]
    if fit.model == "burley":
        materials, reason = fit_output.materials_csv(fit, stem)
        found["notes"] += [reason] if materials is None else []
        files |= {} if materials is None else {"materials.csv": materials}
    if posterior is not None:
        from sssfit.fitting.posterior import corner_figure

        found["posterior"] = fit_output.posterior_summary(posterior)
        # With what follows from the parameters as long as the picture can be read.
        names = None if len(posterior.units) <= _MOST_IN_CORNER else posterior.names
        files["corner.png"] = fit_plot.png(corner_figure(posterior, names))
    name, constants = fit_output.material_name(stem), fit_output.constants(fit, model)
    comments = (
        f"{fit.model}, fitted to {Path(options.data).name} by sssfit; lengths are in mm.",
        "Standard errors and intervals are in fit.json.",
    )
    for dialect in (shader_dialects.HLSL, shader_dialects.GLSL):
        text = shader_constants.encode_constants(name, constants, dialect, comments)
        files[f"profile.{dialect.name.lower()}"] = text
    return found, files | {
        "fit.json": json_text(found).encode(),
        "curve.csv": fit_output.curve_csv(fit),
        "table.csv": fit_table.table_csv(fit, model),
        "fit.png": fit_plot.plot(fit, title=f"{Path(options.data).name}: {fit.model}, {fit.response}"),
    }


def _tell(options: argparse.Namespace, found: dict[str, Any]) -> None:
    """Print what was asked for."""
    if options.json:
        print_json(found)
        return
    parameters = found["parameters"]
    if options.quiet:
        for name, one in parameters.items():
            print(f"{name} {_number(one['value'])}")
        return
    print_table(
        [found["model"], "value", "68 %", "95 %", "unit"],
        [_row(name, one) for name, one in parameters.items()],
    )
    for each in found.get("compared", []):
        print(f"{each['model']}: AICc {_number(each['aicc'])}, {each['parameters']} parameters")
    for note in found["notes"]:
        print(f"note: {note}")
    # Channels that are fitted apart mostly end alike.
    status = "; ".join(dict.fromkeys(found["status"].split("; ")))
    print(f"{status}: see {Path(options.out) / 'fit.png'}")


def _row(name: str, one: dict[str, Any]) -> tuple[str, ...]:
    def interval(ends) -> str:
        low, high = (math.inf if end is None else end for end in ends)
        # Blanks that do not break, for terminals of 80 columns.
        return f"{low:.5g}\u00a0to\u00a0{high:.5g}"

    value = "not defined" if one["value"] is None else _number(one["value"])
    value += "" if one["determined"] or one["value"] is None else "\nnot determined"
    both = (interval(one[key]) if one["value"] is not None else "" for key in ("interval_68", "interval_95"))
    return name, value, *both, one["unit"]


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g}"
