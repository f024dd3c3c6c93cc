"""In what a pixel's moments are remembered from frame to frame."""

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.estimators import moving
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.setting import Setting

_FRAMES, _ALPHA, _MEAN, _DEVIATION = 200, 0.2, 1.0, 0.1
_FORMATS = {
    "float32": (jnp.float32, False),
    "float16, compensated": (jnp.float16, True),
    "float16": (jnp.float16, False),
    "bfloat16": (jnp.bfloat16, False),
}


def _prepare(setting: Setting) -> Task:
    pixels = 2**16 if setting.is_quick else 2**20
    key = jax.random.key(0)
    few = np.asarray(_MEAN + _DEVIATION * jax.random.normal(key, (_FRAMES, 2**12)), np.float64)
    with jax.enable_x64(True):
        exact = np.asarray(moving.emv(jnp.asarray(few), _ALPHA))[-1]
    frame = jax.device_put(np.resize(few[0].astype(np.float32), pixels))
    choices = [_choice(name, *kind, few, exact, frame) for name, kind in _FORMATS.items()]
    return Task(pixels, tuple(choices), f"{pixels} pixels, weight {_ALPHA} of the newest, {_FRAMES} frames")


def _choice(name, dtype, compensated, few, exact, frame) -> Choice:
    state = moving.init("emv", frame, dtype=dtype, compensated=compensated, weights_shape=())
    step = jax.jit(lambda state, x: moving.update(state, x, alpha=_ALPHA))

    def error() -> Error:
        _, found = moving.scan("emv", few.astype(np.float32), _ALPHA, dtype=dtype, compensated=compensated)
        off = np.asarray(found[-1], np.float64) / exact - 1
        return Error(float(np.sqrt(np.mean(np.square(off)))))

    kept = sum(leaf.nbytes for leaf in jax.tree.leaves(state)) / frame.size
    return Choice(
        name=name,
        knobs={"dtype": jnp.dtype(dtype).name, "compensated": compensated},
        run=lambda: jax.block_until_ready(step(state, frame)),
        error=error,
        bytes_moved=2 * kept + frame.dtype.itemsize,
        is_default=name == "float32",
    )


GROUP = Group(
    name="histories",
    title="What the moving mean and variance of a pixel are kept in",
    unit="pixel",
    error=f"root mean square relative error of the variance, spread {_DEVIATION / _MEAN:g} of the mean",
    reference="emv in float64 of the same samples",
    prepare=_prepare,
    stands_for=("estimators.moving.init", "estimators.moving.update", "estimators.moving.scan"),
)
