"""Which tables a set of materials gives: the universal ones, then four for each material."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sssfit.profiles.materials import Material
from sssfit.tables import curvature, falloff, kernel, radius, shadow, transmittance
from sssfit.tables.lookup_error import lookup_error
from sssfit.tables.materials import materials as materials_table
from sssfit.tables.table import Table


@dataclass(frozen=True)
class Sizes:
    """How many entries the tables have.

    Attributes:
        line: entries of a 1-D table, from 12 to 65536.
        image: entries along each side of a 2-D table, from 2 to 1024. With one more than a multiple of 20 the
            kinks of the unscattered curves, at N.L = 0 and at the shadow ramp's corners, lie on
            entries, which cuts the error of lookup several times.

    Example:
        >>> Sizes().line
        512
    """

    line: int = 512
    image: int = 61

    def __post_init__(self):
        """Refuse sizes that no table can have."""
        if not 12 <= self.line <= 65536:
            raise ValueError(f"size must be from 12 to 65536, got {self.line}")
        if not 2 <= self.image <= 1024:
            raise ValueError(f"size-2d must be from 2 to 1024, got {self.image}")


@dataclass(frozen=True)
class Entry:
    """One table of a collection.

    Attributes:
        path: where it is written, without a suffix; a folder for each material.
        table: the table. That of a material has the material in its name too, so that shader text of
            several materials can be included together.
        lookup_error: largest error of interpolating it, in its unit; None where entries are not
            meant to be interpolated.
    """

    path: str
    table: Table
    lookup_error: float | None


Job = tuple[str, Callable[[], Entry]]


def jobs(materials: dict[str, Material], sizes: Sizes) -> Iterator[Job]:
    """The tables to compute, each as a title and a function that computes it.

    A material with an infinite path is left out, except from the table of parameters; `skipped` says
    so.

    Args:
        materials: by name, as `profiles.materials.load` gives them.
        sizes: how many entries.

    Example:
        >>> [title for title, _ in jobs({}, Sizes())]
        ['radius', 'falloff', 'falloff_kernel']
    """
    yield "radius", partial(_radius, sizes)
    yield "falloff", partial(_falloff, sizes)
    yield "falloff_kernel", lambda: Entry("falloff_kernel", kernel.falloff_kernel_table(), None)
    if materials:
        yield "materials", lambda: Entry("materials", materials_table(list(materials.values())), None)
    for material in materials.values():
        if not _skip_reason(material):
            for name, build in _MATERIAL_TABLES.items():
                yield f"{material.name}: {name}", partial(build, material, sizes)


def skipped(materials: dict[str, Material]) -> list[dict[str, str]]:
    """Materials without tables of their own, and why.

    Args:
        materials: by name.

    Example:
        >>> skipped({})
        []
    """
    reasons = {m.name: _skip_reason(m) for m in materials.values()}
    return [{"material": name, "reason": reason} for name, reason in reasons.items() if reason]


def _skip_reason(material: Material) -> str:
    if np.all(np.isfinite(material.d)):
        return ""
    return "a channel absorbs nothing, so its diffuse mean free path is infinite"


def _radius(sizes: Sizes) -> Entry:
    table = radius.radius(sizes.line)
    return Entry("radius", table, lookup_error(table, radius.evaluate))


def _falloff(sizes: Sizes) -> Entry:
    table = falloff.falloff(sizes.line)
    options = (table.parameters["objective"], table.parameters["reading"])
    return Entry("falloff", table, lookup_error(table, lambda x: falloff.evaluate(x, *options)))


def _of(material: Material, table: Table, error: float | None) -> Entry:
    name = f"{material.name}_{table.name}"
    parameters = {"material": material.name} | table.parameters
    return Entry(f"{material.name}/{table.name}", replace(table, name=name, parameters=parameters), error)


def _transmittance(material: Material, sizes: Sizes) -> Entry:
    table = transmittance.transmittance(material.d, material.albedo, sizes.line)
    exact = partial(transmittance.evaluate, d=material.d, albedo=material.albedo)
    return _of(material, table, lookup_error(table, exact))


def _curvature(material: Material, sizes: Sizes) -> Entry:
    table = curvature.curvature(material.d, sizes.image, sizes.image)
    return _of(material, table, lookup_error(table, partial(curvature.evaluate, d=material.d)))


def _shadow(material: Material, sizes: Sizes) -> Entry:
    table = shadow.shadow(material.d, sizes.image, sizes.image)
    return _of(material, table, lookup_error(table, partial(shadow.evaluate, d=material.d)))


def _kernel(material: Material, sizes: Sizes) -> Entry:
    del sizes  # a kernel's taps are a cost per pixel, not a resolution
    return _of(material, kernel.burley_kernel_table(material.d), None)


_MATERIAL_TABLES: dict[str, Callable[[Material, Sizes], Entry]] = {
    "transmittance": _transmittance,
    "curvature": _curvature,
    "shadow": _shadow,
    "burley_kernel": _kernel,
}
