"""The constants and the memory of a sample-count controller; public as `sssfit.estimators.sample_count`."""

from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.estimators import _recursion

Metric = Literal["accumulated", "variance_ratio"]
METRICS: tuple[Metric, ...] = get_args(Metric)
Rounding = Literal["nearest", "up", "down"]
ROUNDINGS: tuple[Rounding, ...] = get_args(Rounding)


def check_rounding(rounding: str) -> None:
    """Raise where the rounding is none of the three."""
    if rounding not in ROUNDINGS:
        raise ValueError(f"rounding must be one of {', '.join(ROUNDINGS)}, got {rounding!r}")


def _on_host(value) -> bool:
    return isinstance(value, int | float | np.ndarray | np.generic)


def _check(value, name: str, requirement: str, holds) -> None:
    if _on_host(value) and not np.all(holds(np.asarray(value))):
        raise ValueError(f"{name} must be {requirement}, got {value}")


def check_constants(controller, *, least_spp: int) -> None:
    """Raise where what every controller has is known to be out of its domain."""
    check_rounding(controller.rounding)
    _check(controller.target_variance, "target_variance", "above 0", lambda v: v > 0)
    low, high = controller.min_spp, controller.max_spp
    _check(low, "min_spp", f"at least {least_spp}", lambda v: v >= least_spp)
    if _on_host(low) and _on_host(high) and np.any(np.greater(low, high)):
        raise ValueError(f"min_spp must not exceed max_spp, got {low} and {high}")


class Controller(eqx.Module):
    """The constants of a sample-count controller, numbers or maps, all of them open to `vmap` and `grad`.

    Attributes:
        target_variance: variance of a frame's result to aim at, > 0.
        alpha: weight of the newest frame in the history, in (0, 1].
        kappa: share of the correction made at once, in [0, 1].
        min_spp, max_spp: bounds of the count, samples per pixel.
        distant_threshold: share of light from beyond a pixel below which no sample is drawn.
        metric: "accumulated" (Eq 8-10), or "variance_ratio": variance / target without the mean count.
        variance_when_missing: "target" or "zero": what a history starts from that was not there before.
        rounding: as for `round_count`.
    """

    target_variance: ArrayLike
    alpha: ArrayLike = 0.2
    kappa: ArrayLike = 0.2
    min_spp: ArrayLike = 8
    max_spp: ArrayLike = 64
    distant_threshold: ArrayLike = 0.0
    metric: Metric = eqx.field(default="accumulated", static=True)
    variance_when_missing: Literal["target", "zero"] = eqx.field(default="target", static=True)
    rounding: Rounding = eqx.field(default="nearest", static=True)

    def __check_init__(self):
        """Refuse constants that are known to be out of their domain; traced ones pass."""
        _recursion.check_alpha(self.alpha)
        if self.metric not in METRICS:
            raise ValueError(f"metric must be one of {', '.join(METRICS)}, got {self.metric!r}")
        if self.variance_when_missing not in ("target", "zero"):
            raise ValueError(
                f"variance_when_missing must be 'target' or 'zero', got {self.variance_when_missing!r}"
            )
        # A pixel without samples would never learn that it needs some.
        check_constants(self, least_spp=1)
        _check(self.kappa, "kappa", "in [0, 1]", lambda v: (v >= 0) & (v <= 1))
        _check(self.distant_threshold, "distant_threshold", "at least 0", lambda v: v >= 0)


#: The 2020 paper's setting for its comparison of quality (Fig 9): target 0.001, alpha 0.2, kappa 0.2.
PAPER_2020 = Controller(target_variance=1e-3)
#: The 2021 paper's (section 7): target 1e-4 and zero samples where less than 1 % of the light is distant.
PAPER_2021 = Controller(target_variance=1e-4, distant_threshold=0.01)
#: What Unreal Engine ships: variance / 1e-4 between 8 and 64, and a new history that starts from zero.
UNREAL = Controller(target_variance=1e-4, kappa=0.0, metric="variance_ratio", variance_when_missing="zero")
PRESETS = {"paper_2020": PAPER_2020, "paper_2021": PAPER_2021, "unreal": UNREAL}


class History(eqx.Module):
    """What a pixel remembers: three numbers of its shape.

    Attributes:
        mean_count: moving average of the samples drawn.
        mean: moving average of the frame's result.
        variance: moving variance of the frame's result.
    """

    mean_count: Array
    mean: Array
    variance: Array

    @property
    def is_lost(self) -> Array:
        """Where a NaN or an infinity has got in, which the variance tells: as good as missing."""
        return jnp.isnan(self.variance)
