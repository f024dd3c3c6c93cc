"""The unbiased sum or the papers' ratio, distances to the surface or in the plane, and the plane."""

from itertools import product
from typing import get_args

from sssfit.frames import points
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SPP = 64


def _prepare(setting: Setting) -> Task:
    _frames.needs_normals(setting)
    base = _frames.base(setting)
    choices = []
    kinds = product(*(get_args(kind) for kind in (points.Estimator, points.Distance, points.Plane)))
    for estimator, distance, plane in kinds:
        settings = base._replace(estimator=estimator, distance=distance, plane=plane)
        knobs = {"estimator": estimator, "distance": distance, "plane": plane, "spp": _SPP}
        name = f"{estimator}, {distance} distance, {plane} plane"
        choices.append(_frames.choice(setting, name, knobs, settings, _SPP, settings == base))
    return _frames.task(setting, choices)


GROUP = Group(
    name="estimators",
    title=f"The estimator and its geometry, {_SPP} samples",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
)
