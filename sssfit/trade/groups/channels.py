"""For which channel a radius is drawn."""

from typing import get_args

from sssfit.frames import points
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting


def _prepare(setting: Setting) -> Task:
    names = {name: {"channels": name} for name in get_args(points.Channels)}
    return _frames.task(setting, _frames.varied(setting, setting.settings, names))


GROUP = Group(
    name="channels",
    title=f"The channel that each of {_frames.SPP} radii is drawn for",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
)
