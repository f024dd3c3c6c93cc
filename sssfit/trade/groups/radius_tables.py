"""How many entries a radius table has, and in what format they are stored."""

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.profiles import burley
from sssfit.tables import radius
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.setting import Setting

_SIZES, _QUICK_SIZES = (32, 64, 128, 256, 512, 1024), (64, 256, 1024)
_FORMATS = ("float32", "float16", "bfloat16", "unorm16", "unorm8")
_DEFAULT = (256, "float32")


def _prepare(setting: Setting) -> Task:
    number = 2**18 if setting.is_quick else 2**21
    variates = (np.arange(number) + 0.5) / number
    with jax.enable_x64(True):
        exact = np.asarray(burley.ppf(jnp.asarray(variates), 1.0))
    given = jax.device_put(variates.astype(np.float32))
    sizes = _QUICK_SIZES if setting.is_quick else _SIZES
    choices = [_choice(size, name, given, exact) for size in sizes for name in _FORMATS]
    return Task(number, tuple(choices), f"{number} variates at equal steps, linear lookup")


def _choice(size: int, stored: str, given, exact: np.ndarray) -> Choice:
    table = radius.radius(size)
    first, last = (float(table.axes[0].values[i]) for i in (0, -1))
    scale, entries = _stored(table.values[:, 0], stored)
    entries = jax.device_put(entries)

    @jax.jit
    def look_up(xi, entries):
        place = (jnp.sqrt(jnp.sqrt(1 - xi)) - first) * ((size - 1) / (last - first))
        cell = jnp.clip(place.astype(jnp.int32), 0, size - 2)
        low, high = (entries[cell + i].astype(jnp.float32) for i in (0, 1))
        return scale * (low + (place - cell) * (high - low))

    def error() -> Error:
        off = np.asarray(look_up(given, entries), np.float64) - exact
        return Error(float(np.sqrt(np.mean(np.square(off)))))

    return Choice(
        name=f"{size}, {stored}",
        knobs={"num_entries": size, "stored": stored, "table_bytes": entries.nbytes},
        run=lambda: jax.block_until_ready(look_up(given, entries)),
        error=error,
        bytes_moved=8 + 2 * entries.dtype.itemsize,
        is_default=(size, stored) == _DEFAULT,
    )


def _stored(values: np.ndarray, name: str) -> tuple[float, np.ndarray]:
    """Entries as they are stored, and what they are multiplied by when they are read."""
    if not name.startswith("unorm"):
        return 1.0, np.asarray(values).astype(jnp.dtype(name))
    most = 2 ** int(name.removeprefix("unorm")) - 1
    largest = float(values.max())
    return largest / most, np.rint(values * (most / largest)).astype(f"uint{name.removeprefix('unorm')}")


GROUP = Group(
    name="radius_tables",
    title="A table of radii: entries and format",
    unit="radius",
    error="root mean square error of the radius, in d",
    reference="burley.ppf in float64",
    prepare=_prepare,
    beside_the_front="Entries are paid for in memory, and hardly in the time of a lookup: the default fills "
    "1 KiB.",
    stands_for=("tables.radius.radius",),
)
