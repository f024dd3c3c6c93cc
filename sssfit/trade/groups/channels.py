"""For which channel a radius is drawn."""

from typing import get_args

from sssfit.frames import points
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SPP = 64


def _prepare(setting: Setting) -> Task:
    base = _frames.base(setting)
    choices = []
    for name in get_args(points.Channels):
        settings = base._replace(channels=name)
        knobs = {"channels": name, "spp": _SPP}
        choices.append(_frames.choice(setting, name, knobs, settings, _SPP, settings == base))
    return _frames.task(setting, choices)


GROUP = Group(
    name="channels",
    title=f"The channel that each of {_SPP} radii is drawn for",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
)
