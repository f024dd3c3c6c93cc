"""In what precision the profile is evaluated."""

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.profiles import burley
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.setting import Setting

_DTYPES = ("float64", "float32", "float16", "bfloat16")
# Farther out, where 1.4 % of the light leaves, the profile is below the normal numbers of half precision.
_NEAREST, _FARTHEST = 1e-3, 12.0


def _prepare(setting: Setting) -> Task:
    number = 2**16 if setting.is_quick else 2**20
    r = np.geomspace(_NEAREST, _FARTHEST, number)
    exact = (np.exp(-r) + np.exp(-r / 3)) / (8 * np.pi * r)
    choices = tuple(_choice(name, r, exact) for name in _DTYPES)
    return Task(number, choices, f"{number} distances from {_NEAREST:g} to {_FARTHEST:g} d")


def _choice(name: str, r: np.ndarray, exact: np.ndarray) -> Choice:
    dtype = jnp.dtype(name)
    evaluate = jax.jit(lambda r: burley.profile(r, jnp.ones((), r.dtype)))

    def run():
        with jax.enable_x64(name == "float64"):
            return jax.block_until_ready(evaluate(given))

    def error() -> Error:
        off = np.asarray(run()).astype(np.float64) / exact - 1
        return Error(float(np.sqrt(np.mean(np.square(off)))))

    with jax.enable_x64(name == "float64"):
        given = jax.device_put(r.astype(dtype))
    return Choice(
        name=name,
        knobs={"dtype": name},
        run=run,
        error=error,
        bytes_moved=2 * dtype.itemsize,
        is_default=name == "float32",
    )


GROUP = Group(
    name="precision",
    title="The precision in which the profile is stored; half formats are computed in float32",
    unit="distance",
    error="root mean square relative error of the profile, with that of the rounded distance",
    reference="NumPy in float64",
    prepare=_prepare,
    stands_for=("profiles.burley.profile",),
)
