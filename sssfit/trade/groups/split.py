"""What scatters within a pixel taken from its own light, and samples drawn for the rest."""

from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SHARES, _QUICK_SHARES = (None, 0.0, 0.05, 0.2), (None, 0.05)


def _prepare(setting: Setting) -> Task:
    shares = _QUICK_SHARES if setting.is_quick else _SHARES
    base = setting.settings._replace(points="fresh")
    names = {"all is sampled" if e is None else f"least share {e:g}": {"split": e} for e in shares}
    return _frames.task(setting, _frames.varied(setting, base, names))


GROUP = Group(
    name="split",
    title=f"Direct and distant scattering apart, by the least distant share; {_frames.SPP} fresh samples",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    stands_for=(
        "frames.points.inner",
        "frames.split.radius",
        "frames.split.distant_share",
        "frames.split.counts",
        "estimators.sample_count.distant_share",
        "estimators.sample_count.distant_count",
    ),
)
