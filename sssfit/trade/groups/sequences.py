"""How the points of a pixel are spread."""

from itertools import product
from typing import get_args

from sssfit.frames import points
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting


def _prepare(setting: Setting) -> Task:
    kinds = product(get_args(points.Points), get_args(points.Sequence))
    names = {
        f"{sequence}, {shared}": {"points": shared, "sequence": sequence}
        for shared, sequence in kinds
        if not setting.is_quick or shared == "table" or sequence == "r2"
    }
    return _frames.task(setting, _frames.varied(setting, setting.settings, names))


GROUP = Group(
    name="sequences",
    title=f"Spread of {_frames.SPP} points, from a table that pixels share or each pixel's own",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    beside_the_front="Hammersley's and Fibonacci's points are even only all together: they lose where pixels "
    "have different counts, which the default has to serve.",
    stands_for=(
        *(f"sampling.sequences.{name}" for name in ("r2", "sobol", "hammersley", "fibonacci", "hashed")),
        *(f"frames.points.{name}" for name in ("table", "aimed", "weighed", "density")),
    ),
)
