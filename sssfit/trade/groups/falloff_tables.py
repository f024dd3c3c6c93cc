"""How a falloff becomes Burley's parameters: by a table, polynomials, or the law behind both."""

import functools
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.profiles import burley
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET
from sssfit.tables import falloff
from sssfit.tables.collection import Sizes
from sssfit.tables.table import Table
from sssfit.trade.choice import Choice, Group, Task
from sssfit.trade.groups import _lookup
from sssfit.trade.groups._lookup import Places
from sssfit.trade.setting import Setting

_SIZES, _POINTS = (16, 64, 256, 512, 1024), 4096
_DEFAULT = Sizes().line


def _prepare(setting: Setting) -> Task:
    sizes = _lookup.QUICK_LINES if setting.is_quick else _SIZES
    make = functools.cache(falloff.falloff)
    table = make(_DEFAULT)
    options = table.parameters["objective"], table.parameters["reading"]
    # Between the entries of all tables: the first one of n is at 1 / n.
    ends = 1 / min(sizes), 1.0
    at = _lookup.places(lambda x: falloff.evaluate(x, *options), [ends], [_POINTS], setting.is_quick)
    made = [*_lookup.choices(make, sizes, at, _DEFAULT), *_formulas(table, at)]
    return _lookup.task(made, at)


def _formulas(table: Table, at: Places) -> Iterator[Choice]:
    """What the table's parameters offer in place of the table."""
    columns = [table.parameters["polynomials"][name] for name in table.channels]
    for each in zip(*columns, strict=True):
        powers = np.array([one["coefficients"] for one in each], np.float32).T
        degree = len(powers) - 1
        yield _computed(
            f"polynomials of degree {degree}", {"degree": degree}, functools.partial(_polynomials, powers), at
        )
    yield _computed("the law", {"law": True}, functools.partial(_law, table.parameters["law"]), at)


def _polynomials(powers: np.ndarray, x: Array) -> Array:
    found = jnp.broadcast_to(powers[-1], (len(x), powers.shape[1]))
    for power in powers[-2::-1]:
        found = found * x[:, None] + power
    return found


def _law(law: dict, x: Array) -> Array:
    phi = x + FALLOFF_OFFSET
    albedo, d = law["albedo_factor"] * phi ** law["albedo_power"], law["d_factor"] * phi
    return jnp.stack([albedo, d, burley.dmfp_from_shape(d, albedo)], axis=-1)


def _computed(name: str, knobs: dict, formula: Callable[[Array], Array], at: Places) -> Choice:
    compiled = jax.jit(formula)
    (given,) = at.coordinates
    return Choice(
        name=name,
        knobs=knobs,
        run=lambda: jax.block_until_ready(compiled(given)),
        error=lambda: at.error(compiled(given)),
        bytes_moved=4 * (1 + at.exact.shape[1]),
    )


GROUP = Group(
    name="falloff_tables",
    title="From a falloff to Burley's parameters: a table's entries and format, polynomials, or the law",
    unit="lookup",
    error=_lookup.ERROR,
    reference="fits in float64",
    prepare=_prepare,
    stands_for=("tables.falloff.falloff", "tables.falloff.polynomial", *_lookup.STANDS_FOR),
    beside_the_front="Engines load all tables alike; this one's file has the polynomials and the law, too.",
)
