"""What scatters within a pixel taken from its own light, and samples drawn for the rest."""

from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SHARES = (None, 0.0, 0.05, 0.2)


def _prepare(setting: Setting) -> Task:
    base = setting.settings._replace(points="fresh")
    names = {"all is sampled" if e is None else f"least share {e:g}": {"split": e} for e in _SHARES}
    return _frames.task(setting, _frames.varied(setting, base, names))


GROUP = Group(
    name="split",
    title=f"Direct and distant scattering apart, by the least distant share; {_frames.SPP} fresh samples",
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
