"""What scatters within a pixel taken from its own light, and samples drawn for the rest."""

from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SPP = 64
_SHARES = (None, 0.0, 0.05, 0.2)


def _prepare(setting: Setting) -> Task:
    base = _frames.base(setting)._replace(points="fresh")
    choices = []
    for share in _SHARES:
        settings = base._replace(split=share)
        name = "all is sampled" if share is None else f"least share {share:g}"
        choices.append(
            _frames.choice(setting, name, {"split": share, "spp": _SPP}, settings, _SPP, share is None)
        )
    return _frames.task(setting, choices)


GROUP = Group(
    name="split",
    title=f"Direct and distant scattering apart, by the least distant share; {_SPP} fresh samples",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    stands_for=(
        "frames.split.radius",
        "frames.split.distant_share",
        "frames.split.counts",
        "estimators.sample_count.distant_share",
        "estimators.sample_count.distant_count",
    ),
)
