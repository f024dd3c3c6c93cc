"""The scale of the prefiltered copy of the irradiance that a sample reads."""

from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SCALES, _QUICK_SCALES = (None, 1 / 16, 1 / 4, 1.0, 4.0), (None, 1.0)


def _prepare(setting: Setting) -> Task:
    choices, scales = [], _QUICK_SCALES if setting.is_quick else _SCALES
    for spp in (_frames.SPP,) if setting.is_quick else (16, _frames.SPP):
        names = {f"{'none' if a is None else f'a = {a:g}'}, {spp} spp": {"prefilter": a} for a in scales}
        choices += _frames.varied(setting, setting.settings, names, spp)
    return _frames.task(setting, choices)


GROUP = Group(
    name="prefilter",
    title="The MIP level that samples read, by the factor a",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    stands_for=(
        "frames.mipmap.build",
        "frames.mipmap.lookup",
        "frames.mipmap.premultiplied",
        "sampling.prefilter.level",
    ),
)
