"""The unbiased sum or the papers' ratio, distances to the surface or in the plane, and the plane."""

from itertools import product
from typing import get_args

from sssfit.frames import points
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting


def _prepare(setting: Setting) -> Task:
    _frames.needs_normals(setting)
    # Of the planes a first look has the tangent one for what is right on it alone.
    kinds = (
        kind
        for kind in product(*(get_args(kind) for kind in (points.Estimator, points.Distance, points.Plane)))
        if not setting.is_quick or kind[2] == "screen" or kind[:2] == ("unbiased", "plane")
    )
    names = {
        f"{estimator}, {distance} distance, {plane} plane": {
            "estimator": estimator, "distance": distance, "plane": plane,
        }
        for estimator, distance, plane in kinds
    }  # fmt: skip
    return _frames.task(setting, _frames.varied(setting, setting.settings, names))


GROUP = Group(
    name="estimators",
    title=f"The estimator and its geometry, {_frames.SPP} samples",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
)
