"""How a long series is gone through: one value after the other, or in parallel."""

import jax
import numpy as np
from scipy.signal import lfilter

from sssfit.estimators import moving
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.setting import Setting

_ALPHA, _MEAN, _DEVIATION = 0.02, 1.0, 0.1
_WAYS = {"scan": ("scan", False), "scan, compensated": ("scan", True), "associative": ("associative", False)}


def _prepare(setting: Setting) -> Task:
    length = 2**12 if setting.is_quick else 2**18
    series = np.random.default_rng(0).normal(_MEAN, _DEVIATION, length).astype(np.float32)
    exact = _reference(series)
    # What is associative compiles for seconds.
    ways = {name: way for name, way in _WAYS.items() if not setting.is_quick or way[0] == "scan"}
    choices = [_choice(name, *way, series, exact) for name, way in ways.items()]
    return Task(
        length, tuple(choices), f"{length} values with a spread of {_DEVIATION / _MEAN:g}, weight {_ALPHA}"
    )


def _reference(series: np.ndarray) -> np.ndarray:
    """The mean square less the squared mean, each by a linear filter, in the longest numbers there are."""
    from_mean = series.astype(np.longdouble) - _MEAN
    alpha = np.longdouble(_ALPHA)
    filters = np.array([alpha]), np.array([1, alpha - 1])
    # The first value weighs 1, as if it had always been there.
    mean, square = (lfilter(*filters, x, zi=(1 - alpha) * x[:1])[0] for x in (from_mean, from_mean**2))
    return square - mean**2


def _choice(name: str, method: str, compensated: bool, series: np.ndarray, exact: np.ndarray) -> Choice:
    given = jax.device_put(series)

    @jax.jit
    def variance(xs):
        if method == "associative":
            return moving.associative("emv", xs, _ALPHA)
        return moving.scan("emv", xs, _ALPHA, compensated=compensated)[1]

    def error() -> Error:
        # The first variance is 0.
        off = np.asarray(variance(given))[1:] / exact[1:] - 1
        return Error(float(np.sqrt(np.mean(np.square(off)))))

    return Choice(
        name=name,
        knobs={"method": method, "compensated": compensated},
        run=lambda: jax.block_until_ready(variance(given)),
        error=error,
        bytes_moved=2 * given.dtype.itemsize,
        is_default=(method, compensated) == ("scan", False),
    )


GROUP = Group(
    name="recursions",
    title="How the moving variance of a long series is computed",
    unit="value",
    error="root mean square relative error of the variance",
    reference="two linear filters in extended precision",
    prepare=_prepare,
    stands_for=("estimators.moving.emv", "estimators.moving.scan", "estimators.moving.associative"),
)
