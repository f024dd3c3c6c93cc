"""What follows from fitted parameters, with its errors: linear in its logarithm."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np

from sssfit.fitting import _curve_problem, intervals
from sssfit.fitting._curve_problem import Setup
from sssfit.fitting.intervals import Estimate
from sssfit.fitting.profile_model import DERIVED_UNITS

#: A logarithm that is less certain than this is not determined: its 95 % interval spans a factor of four
#: each way.
UNDETERMINED = 0.7


def derived(
    setup: Setup,
    names: list[str],
    y: np.ndarray,
    covariance: np.ndarray,
    widths: tuple[float, ...],
    determined: list[bool],
) -> dict[str, Estimate]:
    """What follows from the parameters of each channel, by linear propagation to its logarithm."""
    found = {}
    logarithms, slopes = _derived_logarithms(setup, y)
    for i, row in enumerate(setup.layout):
        for name, logarithm in logarithms.items():
            slope = np.asarray(slopes[name])[i]
            found[name + _curve_problem.suffix(setup, row, names)] = _propagated(
                name, float(logarithm[i]), slope, covariance, widths, np.array(determined)
            )
    return found


@functools.partial(jax.jit, static_argnums=0)
def _derived_logarithms(setup, y):
    """By name, the logarithm in each channel (channels,), and its derivatives in `y` (channels, n)."""

    def logarithms(y):
        p = _curve_problem.physical(setup, y, jnp.ones(()))
        each = jax.vmap(setup.model.derived)(p[np.array(setup.layout)])
        return {name: jnp.log(value) for name, value in each.items()}

    return logarithms(y), jax.jacfwd(logarithms)(y)


def _propagated(name: str, logarithm: float, slope, covariance, widths, determined) -> Estimate:
    value, unit = math.exp(logarithm), DERIVED_UNITS[name]
    if not math.isfinite(value):
        nothing = (math.nan, math.nan)
        return Estimate(math.nan, math.nan, nothing, nothing, unit, False)
    matters = slope != 0
    apart = np.abs(slope[matters]) * np.sqrt(np.diag(covariance)[matters])
    if np.any(apart[~determined[matters]] > UNDETERMINED):
        # That such errors cancel is true of slopes, not of the ranges that those parameters may have.
        return Estimate(value, math.inf, (0.0, math.inf), (0.0, math.inf), unit, False)
    error = math.sqrt(slope[matters] @ covariance[np.ix_(matters, matters)] @ slope[matters])
    both = intervals.around(value, error, True, widths)
    return Estimate(value, value * error, both[0], both[1], unit, error < UNDETERMINED)
