"""The unbiased sum or the papers' ratio, distances to the surface or in the plane, and the plane."""

from itertools import product
from typing import Any, get_args

from sssfit.frames import points
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_FIELDS: tuple[str, ...] = ("estimator", "distance", "plane")
# Which of these two is better depends on how many samples there are.
_ALSO_MANY, _MANY = (("unbiased", "surface", "screen"), ("ratio", "surface", "screen")), 256


def _prepare(setting: Setting) -> Task:
    _frames.needs_normals(setting)
    kinds = list(product(*(get_args(kind) for kind in (points.Estimator, points.Distance, points.Plane))))
    if setting.is_quick:
        kinds = [kind for kind in kinds if kind[0] == "unbiased" or kind == _ALSO_MANY[1]]
        kinds.remove(("unbiased", "surface", "tangent"))
    few: dict[str, dict[str, Any]] = {_name(kind): dict(zip(_FIELDS, kind, strict=True)) for kind in kinds}
    many = {f"{_name(kind)}, {_MANY} samples": few[_name(kind)] for kind in _ALSO_MANY}
    choices = _frames.varied(setting, setting.settings, few)
    if not setting.is_quick:
        choices += _frames.varied(setting, setting.settings, many, _MANY)
    return _frames.task(setting, choices)


def _name(kind: tuple[str, ...]) -> str:
    return "{}, {} distance, {} plane".format(*kind)


GROUP = Group(
    name="estimators",
    title=f"The estimator and its geometry, {_frames.SPP} samples where no number is given",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    beside_the_front="The default loses to the ratio at few samples, for dividing by the weights takes some "
    "of the noise away. But the ratio's error stays where its bias is, however many samples there are, and "
    "that of the default falls on.",
)
