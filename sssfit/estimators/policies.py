"""Who decides the sample counts: the papers' controllers, a fixed count, the oracle, and `in_frame`'s.

Each is a `Policy`. `named` makes them by the names of the command line.
"""

from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.estimators import control_variate, in_frame, sample_count
from sssfit.estimators._policy import Known as Known
from sssfit.estimators._policy import Learned as Learned
from sssfit.estimators._policy import Policy as Policy
from sssfit.estimators._policy import Sampled as Sampled

Light = Literal["control", "surround"]
LIGHTS: tuple[Light, ...] = get_args(Light)


class Adaptive(eqx.Module):
    """The papers' adaptive sampling, of the frame's result or of its residual.

    Attributes:
        config: constants of `control_variate.step`; a constant coefficient 0 is adaptive sampling alone.
        light: what the control is: the light on the pixel itself, or around it.
    """

    config: control_variate.Config
    light: Light = eqx.field(default="control", static=True)

    @property
    def max_spp(self) -> ArrayLike:
        """The largest count."""
        return self.config.controller.max_spp

    def init(self, like: Array) -> control_variate.History:
        """See `Policy`."""
        return control_variate.init(like, self.config)

    def count(self, state: control_variate.History, known: Known) -> Array:
        """See `Policy`."""
        return sample_count.next_count(state.count, self.config.controller, missing=known.missing)

    def learn(self, state: control_variate.History, known: Known, sampled: Sampled) -> tuple[Any, Learned]:
        """See `Policy`."""
        control = getattr(known, self.light)
        frame = control_variate.Observation(
            sampled.mean, control, control, count=sampled.count, missing=known.missing
        )
        state, info = control_variate.step(state, frame, self.config)
        return state, Learned(state.count.mean, state.count.variance, info.coefficient)


class InFrame(eqx.Module):
    """Counts from the variance inside the frames.

    Attributes:
        controller: the constants.
        light: what the variance is relative to: the light around the pixel, or on it.
    """

    controller: in_frame.Controller
    light: Light = eqx.field(default="surround", static=True)

    @property
    def max_spp(self) -> ArrayLike:
        """The largest count."""
        return self.controller.max_spp

    def init(self, like: Array) -> in_frame.History:
        """See `Policy`."""
        return in_frame.init(like, self.controller)

    def count(self, state: in_frame.History, known: Known) -> Array:
        """See `Policy`."""
        light = getattr(known, self.light)
        return in_frame.next_count(state, light, self.controller, missing=known.missing)

    def learn(self, state: in_frame.History, known: Known, sampled: Sampled) -> tuple[Any, Learned]:
        """See `Policy`."""
        light = getattr(known, self.light)
        expected = in_frame.sample_variance(state, light, self.controller) * in_frame.sequence_gain(state)
        state = in_frame.update(state, *_of(sampled), light, self.controller, missing=known.missing)
        drawn = jnp.maximum(sampled.count, 1)
        return state, Learned(sampled.mean, expected / drawn, jnp.zeros_like(expected))


class Fixed(eqx.Module):
    """The same count everywhere and always.

    Attributes:
        spp: samples per pixel, >= 1.
    """

    spp: ArrayLike

    def __check_init__(self):
        """Refuse a count that is known to be out of its domain; a traced one passes."""
        if isinstance(self.spp, int | float | np.ndarray | np.generic) and not np.all(
            np.asarray(self.spp) >= 1
        ):
            raise ValueError(f"spp must be at least 1, got {self.spp}")

    @property
    def max_spp(self) -> ArrayLike:
        """The largest count."""
        return self.spp

    def init(self, like: Array) -> tuple[()]:
        """See `Policy`."""
        return ()

    def count(self, state: tuple[()], known: Known) -> Array:
        """See `Policy`."""
        return jnp.broadcast_to(jnp.asarray(self.spp, jnp.int32), known.missing.shape)

    def learn(self, state: tuple[()], known: Known, sampled: Sampled) -> tuple[Any, Learned]:
        """See `Policy`."""
        return state, _exact(known, sampled)


class Oracle(eqx.Module):
    """The ideal count, from the exact variance of a sample: no more and no fewer than the target takes.

    Attributes:
        target_variance: variance of a frame's result to aim at, > 0.
        min_spp, max_spp: bounds of the count.
        rounding: as for `sample_count.round_count`.
    """

    target_variance: ArrayLike
    min_spp: ArrayLike = 8
    max_spp: ArrayLike = 64
    rounding: sample_count.Rounding = eqx.field(default="nearest", static=True)

    def init(self, like: Array) -> tuple[()]:
        """See `Policy`."""
        return ()

    def count(self, state: tuple[()], known: Known) -> Array:
        """See `Policy`."""
        ideal = known.sample_variance / self.target_variance
        return sample_count.round_count(jnp.clip(ideal, self.min_spp, self.max_spp), self.rounding)

    def learn(self, state: tuple[()], known: Known, sampled: Sampled) -> tuple[Any, Learned]:
        """See `Policy`."""
        return state, _exact(known, sampled)


class MedianFiltered(eqx.Module):
    """Another policy's counts after a median of three along the last axis, as a filter of the count map.

    Attributes:
        policy: the other one.
    """

    policy: Adaptive | InFrame | Fixed | Oracle

    @property
    def max_spp(self) -> ArrayLike:
        """The largest count."""
        return self.policy.max_spp

    def init(self, like: Array) -> Any:
        """See `Policy`."""
        return self.policy.init(like)

    def count(self, state: Any, known: Known) -> Array:
        """See `Policy`; the ends are repeated beyond the ends."""
        count = self.policy.count(state, known)
        before = jnp.concatenate([count[..., :1], count[..., :-1]], axis=-1)
        after = jnp.concatenate([count[..., 1:], count[..., -1:]], axis=-1)
        return jnp.median(jnp.stack([before, count, after]), axis=0).astype(count.dtype)

    def learn(self, state: Any, known: Known, sampled: Sampled) -> tuple[Any, Learned]:
        """See `Policy`."""
        return self.policy.learn(state, known, sampled)


def named(
    name: str,
    *,
    target_variance: ArrayLike = 1e-4,
    alpha: ArrayLike | None = None,
    kappa: ArrayLike = 0.2,
    min_spp: ArrayLike = 8,
    max_spp: ArrayLike = 64,
    spp: ArrayLike = 16,
    light: Light | None = None,
    gain_alpha: ArrayLike | None = None,
) -> Adaptive | InFrame | Fixed | Oracle:
    """A policy by its name, with the constants that it has.

    Args:
        name: one of `NAMES`: "spvg" and "as", adaptive sampling as in the 2020 and 2021 papers, are the same;
            "ocv" with online control variates, "ccv" with the constant coefficient 1; "unreal", the rule
            that the engine ships; "in_frame"; "fixed"; "oracle".
        target_variance: variance of a frame's result to aim at, > 0; all but "fixed".
        alpha: weight of the newest frame; by default 0.2, for "in_frame" 0.02.
        kappa: share of the correction; "spvg", "as", "ocv" and "ccv".
        min_spp, max_spp: bounds of the count; all but "fixed".
        spp: the count; "fixed".
        light: what the control is, of "ocv", "ccv" (by default "control") and "in_frame" ("surround").
        gain_alpha: of "in_frame", for points of low discrepancy.

    Returns:
        A `Policy`.

    Raises:
        ValueError: the name is unknown or a constant out of its domain.

    Example:
        >>> named("ccv").config.constant
        1.0
    """
    if light not in (None, *LIGHTS):
        raise ValueError(f"light must be one of {', '.join(LIGHTS)}, got {light!r}")
    # Refuses bad constants also where the controller has no use for them, but the figures have.
    sample_count.Controller(target_variance, min_spp=min_spp, max_spp=max_spp)
    for constant, given in (("max_spp", max_spp), ("spp", spp)):
        if isinstance(given, int | float) and not given <= MAX_SPP:
            raise ValueError(f"{constant} must be at most {MAX_SPP}, got {given}")
    if name == "fixed":
        return Fixed(spp)
    if name == "oracle":
        return Oracle(target_variance, min_spp, max_spp)
    if name == "in_frame":
        alpha = IN_FRAME_ALPHA if alpha is None else alpha
        controller = in_frame.Controller(target_variance, alpha, min_spp, max_spp, gain_alpha)
        return InFrame(controller, light or "surround")
    alpha = 0.2 if alpha is None else alpha
    if name == "unreal":
        rules = {"metric": sample_count.UNREAL.metric, "kappa": sample_count.UNREAL.kappa}
        rules["variance_when_missing"] = sample_count.UNREAL.variance_when_missing
        controller = sample_count.Controller(
            target_variance, alpha, min_spp=min_spp, max_spp=max_spp, **rules
        )
        return Adaptive(control_variate.Config(controller, constant=0.0))
    if name not in NAMES:
        raise ValueError(f"controller must be one of {', '.join(NAMES)}, got {name!r}")
    controller = sample_count.Controller(target_variance, alpha, kappa, min_spp, max_spp)
    constant = {"spvg": 0.0, "as": 0.0, "ccv": 1.0, "ocv": None}[name]
    return Adaptive(control_variate.Config(controller, constant=constant), light or "control")


#: More samples than any pixel is given.
MAX_SPP = 2**20
#: The names that `named` knows.
NAMES = ("spvg", "as", "ocv", "ccv", "unreal", "in_frame", "fixed", "oracle")
#: Weight of the newest frame in `in_frame`, by default, and in its gain where points are not independent.
IN_FRAME_ALPHA, GAIN_ALPHA = 0.02, 0.02


def _of(sampled: Sampled) -> tuple[Array, Array, Array]:
    return sampled.mean, sampled.square_deviation, sampled.count


def _exact(known: Known, sampled: Sampled) -> Learned:
    """What is known without learning."""
    variance = known.sample_variance / jnp.maximum(sampled.count, 1)
    return Learned(sampled.mean, variance, jnp.zeros_like(variance))
