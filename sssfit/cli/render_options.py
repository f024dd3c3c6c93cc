"""The options of `sssfit render`, and what they mean: camera, frame, profiles, counts and settings."""

import argparse
import math
import re
import sys
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

_LARGEST = 65536
_SETTINGS_HELP = {
    "channels": "for which channel a radius is drawn",
    "estimator": "unbiased, with darkness where nothing is known, or the papers' ratio, which fills it",
    "distance": "along a straight line to the surface, or the radius itself, for frames of one depth",
    "plane": "in which radii are drawn: the screen's, or that tangent to the surface",
    "sequence": "how samples are spread",
    "points": "a table of samples that pixels turn, or fresh ones for each pixel",
    "split": "take from the pixel itself what scatters no farther, and sample where at least this share does",
    "prefilter": "samples look into a prefiltered copy, of a level for this factor of their number",
}


def add_scene(command) -> None:
    """Add the options that say what is in the frame's file."""
    camera = command.add_argument_group("camera, one of")
    camera.add_argument("--camera", metavar="camera.json", help="that of the frame's file name")
    camera.add_argument("--fx", type=float, metavar="PIXELS", help="focal length")
    camera.add_argument("--fov-x-deg", type=float, metavar="DEGREES", help="field of view across")
    camera.add_argument("--mm-per-pixel", type=float, metavar="MM", help="of an orthographic camera")
    for name, text in (("fy", "focal length down, if another"), ("cx", "viewing axis from the left edge"),
                       ("cy", "the same from the upper edge")):  # fmt: skip
        camera.add_argument(
            f"--{name}", type=float, metavar="PIXELS", help=f"{text}, with --fx or --fov-x-deg"
        )
    profile = command.add_argument_group("profile, one of")
    profile.add_argument(
        "--profile", metavar="NAME|A,dmfp",
        help="a name in camera.json, a material, or albedo and dmfp in mm, two numbers or six",
    )  # fmt: skip
    profile.add_argument("--d", metavar="R,G,B", help="Burley's d of every id, mm")
    layers = command.add_argument_group("the frame's file")
    layers.add_argument(
        "--layer", action="append", default=[], metavar="NAME=LAYER",
        help="another name of irradiance, depth, normal or profile_id; other.exr:LAYER in another file",
    )  # fmt: skip
    layers.add_argument("--world-scale", type=float, default=1.0, metavar="MM", help="in a unit of depth (1)")
    layers.add_argument("--background-depth", type=float, default=1e6, metavar="MM", help="of nothing (1e6)")
    layers.add_argument("--strict", action="store_true", help="refuse bad pixels instead of masking them out")


def add_method(command) -> None:
    """Add the options that say how it is scattered."""
    from sssfit.sampling import inverse_cdf

    method = command.add_argument_group("method")
    method.add_argument(
        "--method", choices=["scatter", "exact"], default="scatter",
        help="Monte Carlo (default), or the sum over all visible pixels that it converges to",
    )  # fmt: skip
    method.add_argument(
        "--cutoff-radius", default="16", metavar="D|none", help="end of the profile in d (16)"
    )
    method.add_argument(
        "--radius-limit", type=float, metavar="MM", help="exact: leave out what is farther away"
    )
    method.add_argument(
        "--spp", metavar="N|MIN:MAX", help="samples per pixel, or their bounds with --target-variance (64)"
    )
    method.add_argument(
        "--target-variance", type=float, metavar="V", help="wanted of the Rec. 709 luminance of result / pi"
    )
    method.add_argument("--seed", type=int, default=0, metavar="N", help="of the random numbers (0)")
    method.add_argument("--importance", choices=list(inverse_cdf.METHODS), help="which sampler draws radii")
    method.add_argument("--uncorrected", action="store_true", help="the papers' weights, with their bias")
    for name, values in _choices().items():
        method.add_argument(f"--{name}", choices=values, help=_SETTINGS_HELP.get(name))
    for name in _numbers_of_settings():
        method.add_argument(f"--{name}", type=float, metavar="X", help=_SETTINGS_HELP.get(name))


def check(options: argparse.Namespace) -> None:
    """Refuse options that do not go together."""
    from sssfit.frames import compare, render

    _one_of(options, "camera", ("camera", "fx", "fov_x_deg", "mm_per_pixel"))
    axis = [name for name in ("fy", "cx", "cy") if getattr(options, name) is not None]
    if axis and options.fx is None and options.fov_x_deg is None:
        raise ValueError(f"--{axis[0]} belongs to --fx or --fov-x-deg")
    _one_of(options, "profile", ("profile", "d"))
    sampling = ("spp", "target_variance", "importance", "uncorrected", *_choices(), *_numbers_of_settings())
    strange = sampling if options.method == "exact" else ("radius_limit",)
    given = [name.replace("_", "-") for name in strange if getattr(options, name) not in (None, False)]
    if given:
        other = "scatter" if options.method == "exact" else "exact"
        raise ValueError(f"--{given[0]} belongs to --method {other}")
    least, most = compare.LEAST_REPLICATES, render.MOST_REPLICATES
    if options.replicates and not least <= options.replicates <= most:
        raise ValueError(f"--replicates must be 0 or from {least} to {most}, got {options.replicates}")
    if not 0 <= options.seed <= render.LARGEST_SEED:
        raise ValueError(f"--seed must be from 0 to {render.LARGEST_SEED}, got {options.seed}")
    limit = options.radius_limit
    if limit is not None and not 0 < limit < math.inf:
        raise ValueError(f"--radius-limit must be a number above 0, got {limit:g}")
    if options.split is not None and options.points != "fresh":
        raise ValueError("--split needs --points fresh")


def _one_of(options: argparse.Namespace, what: str, names: tuple[str, ...]) -> None:
    """Refuse none and more than one of some options."""
    every = [f"--{name.replace('_', '-')}" for name in names]
    given = [flag for flag, name in zip(every, names, strict=True) if getattr(options, name) is not None]
    if len(given) != 1:
        known = f"{', '.join(every[:-1])} and {every[-1]}"
        raise ValueError(f"the {what} must be one of {known}, got {' and '.join(given) or 'none'}")


def counts(options: argparse.Namespace) -> tuple[int, int]:
    """The smallest and the largest count of a pixel."""
    text = "64" if options.spp is None else options.spp
    found = bounds(text)
    target = options.target_variance
    if (":" in text) != (target is not None):
        raise ValueError("--spp MIN:MAX and --target-variance must be given together")
    if target is not None and not 0 < target < math.inf:
        raise ValueError(f"--target-variance must be a number above 0, got {target:g}")
    return found


def bounds(text: str) -> tuple[int, int]:
    """What `--spp` says."""
    found = re.fullmatch(r"(\d+)(?::(\d+))?", text, re.ASCII)
    least, most = (int(n or found.group(1)) for n in found.groups()) if found else (0, 0)
    if not 1 <= least <= most <= _LARGEST:
        raise ValueError(f"--spp must be N or MIN:MAX, whole numbers from 1 to {_LARGEST}, got {text!r}")
    return least, most


def settings(options: argparse.Namespace):
    """The `points.Settings` that the options name."""
    from sssfit.frames import points

    given = {name: getattr(options, name) for name in ("importance", *_choices(), *_numbers_of_settings())}
    given = {name: value for name, value in given.items() if value is not None}
    cutoff = _numbers(options.cutoff_radius) if options.cutoff_radius != "none" else [math.inf]
    if len(cutoff) != 1 or not cutoff[0] > 0:
        got = options.cutoff_radius
        raise ValueError(f"--cutoff-radius must be a number above 0 (in d) or none, got {got!r}")
    end = cutoff[0] if math.isfinite(cutoff[0]) else None
    made = points.Settings(**given, corrected=not options.uncorrected, cutoff=end)
    made.check()
    return made


def _choices() -> dict[str, tuple[str, ...]]:
    """The settings that are one of a few words, and those words."""
    from sssfit.frames import points

    hints = typing.get_type_hints(points.Settings)
    return {n: typing.get_args(h) for n, h in hints.items() if typing.get_origin(h) is typing.Literal}


def _numbers_of_settings() -> list[str]:
    """The settings that are a number or left out; the cut-off has an option of its own."""
    from sssfit.frames import points

    hints = typing.get_type_hints(points.Settings)
    return [name for name, hint in hints.items() if hint == float | None and name != "cutoff"]


def frame(options: argparse.Namespace):
    """The frame, and how many pixels of it are bad; a warning about those is a line on the terminal."""
    told: list[str] = []
    loaded = loader(options, options.frame)(options.frame, told.append)
    for text in told:
        print(f"warning: {text}", file=sys.stderr)
    return loaded, bad_pixels(told)


def loader(
    options: argparse.Namespace, first: str | Path, also: tuple[str, ...] = ()
) -> Callable[[str | Path, Callable[[str], None]], Any]:
    """What reads a frame from its path and tells of bad pixels; numbers of a camera get the first's size.

    Motion is among the layers to be read if `also` names it.
    """
    from sssfit.frames import camera, gbuffer, render

    layers: dict[str, str | None] = {n: None for n in ("albedo", "motion") if n not in also}
    known = [name for name in gbuffer.LAYERS if name not in layers]
    for text in options.layer:
        name, _, layer = text.partition("=")
        if name not in known or not layer:
            raise ValueError(f"--layer must be NAME=LAYER, NAME one of {', '.join(known)}, got {text!r}")
        layers[name] = layer
    view = options.camera
    if view is None:
        size = render.size(first, layers.get("irradiance"))
        if options.mm_per_pixel is not None:
            view = camera.orthographic(*size, options.mm_per_pixel)
        else:
            lens = {name: getattr(options, name) for name in ("fx", "fy", "cx", "cy")}
            view = camera.perspective(*size, **lens, fov_x_degrees=options.fov_x_deg)
    numbers = {"world_scale": options.world_scale, "background_depth": options.background_depth}
    more: dict[str, Any] = {"layers": layers, **numbers, "strict": options.strict}
    return lambda path, tell: gbuffer.load(path, view, **more, tell=tell)


def bad_pixels(told: list[str]) -> int:
    """How many faults of pixels the sentences of `loader` tell of."""
    return sum(int(n) for text in told for n in re.findall(r"(\d+) pixels? ha(?:s|ve) ", text))


def profiles(options: argparse.Namespace, frame) -> dict[int, Any]:
    """d in mm of every id, None where nothing scatters."""
    import numpy as np

    ids = [int(number) for number in np.unique(frame.profile_id) if number]
    return profiles_of(options, ids, options.reference)


def profiles_of(options: argparse.Namespace, ids: list[int], reference: Any) -> dict[int, Any]:
    """The same for some ids, under the names of a reference if there is one."""
    import numpy as np

    from sssfit.files.errors import FileError
    from sssfit.frames import scene_profiles

    if options.profile is None:
        d = _numbers(options.d)
        if len(d) != 3 or not all(0 <= n < math.inf for n in d) or not any(d):
            text = "three numbers R,G,B in mm, none below 0 and one above it"
            raise ValueError(f"--d must be {text}, got {options.d!r}")
        return {number: np.array(d) for number in ids}
    found = scene_profiles.by_id(options.camera, options.profile, reference, ids=ids)
    lacking = [number for number in ids if number not in found]
    if lacking:
        problem = f"id {lacking[0]} of the frame has no profile beside {options.profile!r}"
        remedy = "write it into profiles_by_id, null where nothing scatters"
        raise FileError(options.camera, "", problem, remedy)
    return found


def _numbers(text: str) -> list[float]:
    """Numbers with commas between them; none where that is not what the text is."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return []


def asked(options: argparse.Namespace) -> dict[str, Any]:
    """The options, for the record; files by their names, and what was in them."""
    from sssfit.files.json_text import sha256_bytes
    from sssfit.files.reading import read_bytes

    every = {name: value for name, value in vars(options).items() if name not in ("run", "out", "quiet")}
    files = {n: Path(every[n]) for n in ("frame", "camera", "reference") if every.get(n) is not None}
    inputs = {name: sha256_bytes(read_bytes(path)) for name, path in files.items()}
    return every | {name: path.name for name, path in files.items()} | {"inputs_sha256": inputs}
