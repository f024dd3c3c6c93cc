"""How many entries an engine's tables have, and in what format they are stored: a group for each table."""

from collections.abc import Callable
from functools import partial

import numpy as np

from sssfit.tables import curvature, shadow, transmittance
from sssfit.tables.collection import Sizes
from sssfit.tables.table import Table
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _lookup
from sssfit.trade.setting import Setting, skin

# Entries along each axis, by the number of axes.
_SIZES = {1: (16, 32, 64, 128, 256, 512, 1024), 2: (16, 21, 32, 61, 64, 121, 128)}
_QUICK_SIZES = {1: _lookup.QUICK_LINES, 2: (21, 61)}
_POINTS = {1: (4096,), 2: (64, 512)}


def _prepare(make: Callable[[int], Table], evaluate: Callable[..., np.ndarray], setting: Setting) -> Task:
    axes = make(2).axes
    sizes = (_QUICK_SIZES if setting.is_quick else _SIZES)[len(axes)]
    ends = [(float(axis.values[0]), float(axis.values[-1])) for axis in axes]
    at = _lookup.places(evaluate, ends, _POINTS[len(axes)], setting.is_quick)
    default = Sizes().line if len(axes) == 1 else Sizes().image
    return _lookup.task(_lookup.choices(make, sizes, at, default), at)


def _group(name: str, what: str, make: Callable[[int], Table], evaluate: Callable[..., np.ndarray]) -> Group:
    return Group(
        name=f"{name}_tables",
        title=f"A table of {what}: entries and format",
        unit="lookup",
        error=_lookup.ERROR,
        reference=f"{name}.evaluate in float64",
        prepare=partial(_prepare, make, evaluate),
        stands_for=(f"tables.{name}.{name}", *_lookup.STANDS_FOR),
        beside_the_front="Entries are paid for in memory and in loading, and hardly in the time of a lookup.",
    )


GROUPS = (
    _group(
        "transmittance",
        "the light through a slab",
        lambda size: transmittance.transmittance(skin(), np.ones(3), size),
        lambda thickness: transmittance.evaluate(thickness, skin(), np.ones(3)),
    ),
    _group(
        "curvature",
        "the light on a curved surface",
        lambda size: curvature.curvature(skin(), size, size),
        lambda curvatures, cosines: curvature.evaluate(curvatures, cosines, skin()),
    ),
    _group(
        "shadow",
        "the light in a penumbra",
        lambda size: shadow.shadow(skin(), size, size),
        lambda inverse_widths, values: shadow.evaluate(inverse_widths, values, skin()),
    ),
)
