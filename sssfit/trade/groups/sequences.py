"""How the points of a pixel are spread."""

from typing import get_args

from sssfit.frames import points
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SPP = 64


def _prepare(setting: Setting) -> Task:
    base = _frames.base(setting)
    choices = []
    for shared in get_args(points.Points):
        for sequence in get_args(points.Sequence):
            if setting.is_quick and shared == "fresh" and sequence not in ("r2", "iid"):
                continue
            settings = base._replace(points=shared, sequence=sequence)
            knobs = {"points": shared, "sequence": sequence, "spp": _SPP}
            is_default = settings == base
            choices.append(
                _frames.choice(setting, f"{sequence}, {shared}", knobs, settings, _SPP, is_default)
            )
    return _frames.task(setting, choices)


GROUP = Group(
    name="sequences",
    title=f"Spread of {_SPP} points, from a table that pixels share or each pixel's own",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    stands_for=tuple(
        f"sampling.sequences.{name}" for name in ("r2", "sobol", "hammersley", "fibonacci", "hashed")
    ),
)
