"""The scale of the prefiltered copy of the irradiance that a sample reads."""

from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SCALES = (None, 1 / 16, 1 / 4, 1.0, 4.0)


def _prepare(setting: Setting) -> Task:
    base = _frames.base(setting)
    choices = []
    for spp in (16,) if setting.is_quick else (16, 64):
        for scale in _SCALES:
            settings = base._replace(prefilter=scale)
            knobs = {"prefilter": scale, "spp": spp}
            name = f"{'none' if scale is None else f'a = {scale:g}'}, {spp} spp"
            choices.append(_frames.choice(setting, name, knobs, settings, spp, scale is None and spp == 64))
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
