"""The options of `sssfit render --mode`, and what they mean: the policy, its bounds, the record."""

import argparse
import glob
import math
import os
from pathlib import Path
from typing import Any

from sssfit.cli import render_options

#: Which modes an option belongs to; "target_variance" must be given in those.
_BELONGS = {
    "target_variance": ("as", "ocv", "ccv", "unreal", "in_frame", "oracle"),
    "alpha": ("as", "ocv", "ccv", "unreal", "in_frame"),
    "kappa": ("as", "ocv", "ccv"),
    "gamma": ("as", "ocv", "ccv", "unreal"),
    "history": ("as", "ocv", "ccv", "unreal", "in_frame"),
    "light": ("ocv", "ccv", "in_frame"),
}
MODES = ("fixed", *_BELONGS["target_variance"])
#: What a single frame does not have.
_ALONE = ("mode", "alpha", "kappa", "gamma", "history", "light", "white", "resume")
_REPLICATES = 8
#: No part of what a sequence is, or of one frame alone.
_ASIDE = ("run", "out", "quiet", "resume", "replicates", "method", "radius_limit")


def add(command) -> None:
    """Add the options of a sequence."""
    group = command.add_argument_group("sequence")
    group.add_argument("--mode", choices=MODES, help="who decides the counts; makes a sequence of the frames")
    for name, text in (
        ("alpha", "weight of the newest frame (0.2; in_frame 0.02)"),
        ("kappa", "share of the correction made at once (0.2)"),
        ("gamma", "learn from luminance to the power of 1 / X (1)"),
    ):
        group.add_argument(f"--{name}", type=float, metavar="X", help=text)
    group.add_argument("--history", choices=("float32", "float16"), help="what it is kept in (float32)")
    group.add_argument(
        "--light", choices=("control", "surround"),
        help="on the pixel itself (ocv, ccv), or around it (in_frame)",
    )  # fmt: skip
    group.add_argument(
        "--white", type=float, metavar="X",
        help="shown as white (twice the brightest of the first frame with light)",
    )  # fmt: skip
    group.add_argument("--resume", action="store_true", help="go on where an interrupted run stopped")


def check_single(options: argparse.Namespace) -> None:
    """Refuse what only a sequence has, and leave one frame and one reference."""
    for name, flag in (("frame", "FRAME.exr"), ("reference", "--reference")):
        given = getattr(options, name)
        if given is not None:
            if len(given) > 1 or (glob.has_magic(given[0]) and not os.path.exists(given[0])):
                raise ValueError(f"{flag} names more than one file; give --mode to render a sequence")
            setattr(options, name, given[0])
    given = {name: getattr(options, name) for name in _ALONE}
    alone = [name for name, value in given.items() if value is not None and value is not False]
    if alone:
        raise ValueError(f"--{alone[0]} needs --mode")
    if options.replicates is None:
        options.replicates = _REPLICATES
    for name in _ALONE:
        delattr(options, name)


def check(options: argparse.Namespace) -> None:
    """Refuse options of a sequence that do not go together."""
    mode = options.mode
    if options.method == "exact":
        raise ValueError("--method exact has no --mode: nothing is sampled")
    if options.replicates is not None:
        raise ValueError("--replicates belongs to a frame without --mode")
    for name, modes in _BELONGS.items():
        if getattr(options, name) is not None and mode not in modes:
            flag = name.replace("_", "-")
            raise ValueError(f"--{flag} belongs to --mode {', '.join(modes[:-1])} or {modes[-1]}, not {mode}")
    if options.target_variance is None and mode in _BELONGS["target_variance"]:
        raise ValueError(f"--mode {mode} needs --target-variance")
    for name in ("target_variance", "gamma", "white"):
        value = getattr(options, name)
        if value is not None and not 0 < value < math.inf:
            flag = name.replace("_", "-")
            raise ValueError(f"--{flag} must be a number above 0, got {value:g}")
    bounds(options)
    options.replicates = 0
    render_options.check(options)


def bounds(options: argparse.Namespace) -> tuple[int, int]:
    """The smallest and the largest count of a pixel."""
    text = spp(options)
    if (":" in text) == (options.mode == "fixed"):
        wanted = "a single number" if options.mode == "fixed" else "MIN:MAX"
        raise ValueError(f"--spp must be {wanted} with --mode {options.mode}, got {text!r}")
    return render_options.bounds(text)


def spp(options: argparse.Namespace) -> str:
    """What `--spp` says, or would."""
    default = "64" if options.mode == "fixed" else "8:64"
    return default if options.spp is None else options.spp


def policy(options: argparse.Namespace) -> Any:
    """Who decides the counts."""
    from sssfit.estimators import policies
    from sssfit.frames import sequence

    least, most = bounds(options)
    given = {name: getattr(options, name) for name in ("target_variance", "alpha", "kappa", "light")}
    given = {name: value for name, value in given.items() if value is not None}
    if options.mode == "in_frame" and render_options.settings(options).sequence != "iid":
        # Evenly spread points vary less than what the spread inside a frame tells.
        given["gain_alpha"] = sequence.GAIN_ALPHA
    return policies.named(options.mode, min_spp=least, max_spp=most, spp=most, **given)


def config(options: argparse.Namespace, profiles) -> Any:
    """What the sequence is rendered with."""
    from sssfit.frames import sequence

    return sequence.Config(
        policy(options),
        profiles,
        settings=render_options.settings(options),
        gamma=1.0 if options.gamma is None else options.gamma,
        history_dtype=options.history or "float32",
        seed=options.seed,
    )


def constants(options: argparse.Namespace) -> dict[str, Any]:
    """The policy's constants, None for those that it does not have."""
    decides = policy(options)
    adaptive = getattr(decides, "config", None)
    controller = getattr(decides, "controller", None) if adaptive is None else adaptive.controller
    least, most = bounds(options)
    found = {
        "alpha": getattr(controller, "alpha", None),
        "kappa": getattr(controller, "kappa", None),
        "gamma": 1.0 if options.gamma is None else options.gamma,
        "history": options.history or "float32",
        "light": getattr(decides, "light", None),
    }
    found = {name: value if options.mode in _BELONGS[name] else None for name, value in found.items()}
    found["gain_alpha"] = getattr(controller, "gain_alpha", None)
    asked = {"mode": options.mode, "target_variance": options.target_variance}
    return asked | {"min_spp": least, "max_spp": most} | found


def asked(options: argparse.Namespace, frames, references) -> dict[str, Any]:
    """What makes the sequence what it is, for the record and to compare with; files by their names."""
    every = {name: value for name, value in vars(options).items() if name not in _ASIDE}
    return every | {
        "spp": spp(options),
        "frame": [frame.path.name for frame in frames],
        "reference": [path.name for path in references.values()],
        "camera": None if options.camera is None else Path(options.camera).name,
    }
