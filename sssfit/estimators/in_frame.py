"""How many samples a pixel draws next, from the samples' variance inside its frames, in units of its light.

The papers' controller watches how a frame's result varies over time, and so takes a flickering lamp for
noise; a control variate removes part of that. The spread of the samples inside a frame does not see the
lamp at all, and it is free: one more sum in the same loop. It has count - 1 degrees of freedom a frame where
the result itself has one.

Light that changes by a factor changes that variance by the factor's square. What is remembered is
therefore the variance in units of G^2 + target, with a control G, the light on or around the pixel, that is
known before the frame is sampled: sums of squared deviations and of degrees of freedom that fade by
1 - alpha a frame. The target variance is added since light below its root needs no samples; where G is 0
all this is simply the moving in-frame variance. Light that changes otherwise, such as a moving shadow, is
followed as fast as the sums fade.

Points of low discrepancy have means that vary less than independent ones, which the spread inside a frame
does not tell. With `gain_alpha` the controller learns the ratio of the two from the frames' results.

Source: derived here; the budget: Xie and Olano 2021, Eq 10; the control: its Eq 30.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from sssfit.estimators import _recursion, sample_count
from sssfit.estimators._controller import Rounding, check_constants

#: Frames at gain 1 that a pixel is taken to have seen before its first.
_PRIOR_FRAMES = 4.0


class Controller(eqx.Module):
    """The constants, numbers or maps, all of them open to `vmap` and `grad`.

    Attributes:
        target_variance: variance of a frame's result to aim at, > 0.
        alpha: weight of the newest frame, in (0, 1].
        min_spp, max_spp: bounds of the count, samples per pixel, min_spp at least 2: a single sample has no
            spread.
        gain_alpha: weight of the newest frame in the gain of a low-discrepancy sequence, in (0, 1]; None
            for independent samples, whose gain is 1.
        rounding: as for `sample_count.round_count`.
    """

    target_variance: ArrayLike
    alpha: ArrayLike = 0.02
    min_spp: ArrayLike = 8
    max_spp: ArrayLike = 64
    gain_alpha: ArrayLike | None = None
    rounding: Rounding = eqx.field(default="nearest", static=True)

    def __check_init__(self):
        """Refuse constants that are known to be out of their domain; traced ones pass."""
        _recursion.check_alpha(self.alpha)
        if self.gain_alpha is not None:
            _recursion.check_alpha(self.gain_alpha)
        check_constants(self, least_spp=2)


class Gain(eqx.Module):
    """What is remembered of the frames' results, for the gain.

    Attributes:
        previous: the last result over sqrt(G^2 + target).
        previous_count: the samples that it is the mean of.
        temporal: fading sum of half the squared differences of a result from the one before, times the
            harmonic mean of both counts. Were samples independent, each had a sample's variance for its mean,
            from the second frame on, and whatever drifts slowly.
        spatial: fading sum of the samples' variances inside the frames.
    """

    previous: Array
    previous_count: Array
    temporal: Array
    spatial: Array


class History(eqx.Module):
    """What a pixel remembers: four numbers of its shape, eight with a gain.

    Attributes:
        square_deviation: fading sum of the samples' squared deviations from their frame's mean, in units of
            that frame's G^2 + target.
        degrees: fading sum of degrees of freedom.
        lit_degrees: those of them that light has had, times G^2 / (G^2 + target).
        uncertainty: variance of `square_deviation`, from how far the frames' parts were from expectation.
        gain: None for independent samples.
    """

    square_deviation: Array
    degrees: Array
    lit_degrees: Array
    uncertainty: Array
    gain: Gain | None

    @property
    def is_lost(self) -> Array:
        """Where a NaN or an infinity has got in: as good as missing."""
        finite = [jnp.isfinite(leaf) for leaf in jax.tree.leaves(self)]
        return ~functools.reduce(jnp.logical_and, finite)


def init(like: ArrayLike, controller: Controller, *, dtype: DTypeLike | None = None) -> History:
    """A history of nothing, all zeros.

    Args:
        like: anything of the pixels' shape and dtype.
        controller: the constants; with a gain_alpha there are eight numbers.
        dtype: what to keep the history in, such as jnp.float16; that of `like` by default. Half precision
            ends at 65504: where the samples' variance is some thousand times G^2 + target, the sums stay
            there, the counts are at their upper bound, and `safety` is lost.

    Example:
        >>> float(init(0.0, Controller(1e-3)).degrees)
        0.0
    """
    zero = jnp.zeros(jnp.shape(like), jnp.result_type(float, like) if dtype is None else dtype)
    gain = None if controller.gain_alpha is None else Gain(zero, zero, zero, zero)
    return History(zero, zero, zero, zero, gain)


def sample_variance(history: History, control: ArrayLike, controller: Controller) -> Array:
    """The variance of one sample to expect under a light.

    Args:
        history: what it is decided from; all zeros give 0.
        control: G, the light on or around the pixel in the frame to come, >= 0.
        controller: the constants.

    Returns:
        Of the history's shape, at least float32, in the squared unit of the samples. NaN where the history
        is lost.

    Source: derived here; see the module.

    Example:
        >>> history = History(*jnp.array([20.0, 100.0, 100.0, 0.0]), None)
        >>> round(float(sample_variance(history, 2.0, Controller(1e-6))), 3)
        0.8
    """
    wide = _recursion.computing_dtype(history.degrees.dtype)
    return _relative_variance(history) * _scale(jnp.asarray(control, wide), controller)


def safety(history: History) -> Array:
    """How much more than the expected variance has to be allowed for, since it is an estimate.

    A frame's variance is the sample's over the count, and the mean of an inverse is above the inverse of
    the mean: by the estimate's relative variance, for small ones. For hits that are rare and alike it comes
    to about one hit more than were seen, which for a Poisson number of mean m is exact but for a factor
    1 - exp(-m).

    Args:
        history: what it is decided from.

    Returns:
        1 + uncertainty / square_deviation^2, of the history's shape; 1 where nothing is known.

    Source: derived here; E[1 / (1 + N)] = (1 - exp(-m)) / m for a Poisson number N of mean m.

    Example:
        >>> history = History(*jnp.array([2.0, 9.0, 9.0, 1.0]), None)
        >>> float(safety(history))
        1.25
    """
    wide = _recursion.computing_dtype(history.degrees.dtype)
    total, uncertainty = history.square_deviation.astype(wide), history.uncertainty.astype(wide)
    seen = total > 0
    # Two divisions: the square may not fit the format where the total does.
    return jnp.where(seen, 1 + uncertainty / jnp.where(seen, total, 1) / jnp.where(seen, total, 1), 1)


def sequence_gain(history: History) -> Array:
    """Variance of a frame's result over that of as many independent samples.

    Args:
        history: what it is decided from.

    Returns:
        In [0, 1], of the history's shape; 1 without a gain in the history, and where nothing is known.
        A sequence is never taken to be worse than independent samples: what exceeds 1 is light that moves.

    Source: von Neumann, "Distribution of the ratio of the mean square successive difference to the
    variance", 1941, for the variance over time.

    Example:
        >>> float(sequence_gain(init(0.0, Controller(1e-3, gain_alpha=0.02))))
        1.0
    """
    wide = _recursion.computing_dtype(history.degrees.dtype)
    if history.gain is None:
        return jnp.ones(history.degrees.shape, wide)
    temporal, spatial = (v.astype(wide) for v in (history.gain.temporal, history.gain.spatial))
    seen = spatial > 0
    return jnp.where(seen, jnp.clip(temporal / jnp.where(seen, spatial, 1), 0, 1), 1)


def next_count(
    history: History, control: ArrayLike, controller: Controller, *, missing: ArrayLike = False
) -> Array:
    """How many samples each pixel draws in the next frame.

    Args:
        history: what it is decided from.
        control: G of that frame, >= 0, as for `sample_variance`. A NaN counts as no light.
        controller: the constants.
        missing: where the history is not this pixel's and is not looked at; so is a lost one.

    Returns:
        int32 within the controller's bounds: sample variance times safety and gain over the target
        variance.

    Source: Xie and Olano 2021, Eq 10, of the variance expected here.

    Example:
        >>> history = History(*jnp.array([20.0, 100.0, 100.0, 0.0]), None)
        >>> int(next_count(history, 0.5, Controller(1e-3)))
        50
    """
    wide = _recursion.computing_dtype(history.degrees.dtype)
    control = jnp.nan_to_num(jnp.asarray(control, wide), nan=0.0)
    ideal = sample_variance(history, control, controller) * safety(history) * sequence_gain(history)
    ideal = ideal / jnp.asarray(controller.target_variance, wide)
    ideal = jnp.where(missing | history.is_lost | jnp.isnan(ideal), 0, ideal)
    bounds = (jnp.asarray(v, wide) for v in (controller.min_spp, controller.max_spp))
    return sample_count.round_count(jnp.clip(ideal, *bounds), controller.rounding)


def update(
    history: History,
    mean: ArrayLike,
    square_deviation: ArrayLike,
    count: ArrayLike,
    control: ArrayLike,
    controller: Controller,
    *,
    missing: ArrayLike = False,
    valid: ArrayLike = True,
) -> History:
    """The history after a frame.

    Args:
        history: before the frame.
        mean: the frame's result, the mean of its samples.
        square_deviation: sum of the samples' squared deviations from it, >= 0: the sum of squares less
            count times mean^2, if it is summed around a number of the samples' size.
        count: samples drawn. Where below 2 nothing was learned and the history stays.
        control: G of this frame, >= 0.
        controller: the constants.
        missing: where the pixel had no history: what was there is forgotten.
        valid: where False the history stays as it is, unless it was missing.

    Returns:
        A `History` of the same structure, shape and dtype. Where there was light before, nothing is
        learned from a frame in which control, result and spread are all of the target's size or below it:
        the lamp is off. The first light after darkness starts afresh.

    Raises:
        ValueError: an argument does not broadcast to the history's shape, or the history was made without
            a gain and the controller has a gain_alpha.

    Source: derived here; see the module.

    Example:
        >>> history = update(init(0.0, Controller(1e-3)), 0.5, 2.0, 8, 1.0, Controller(1e-3), missing=True)
        >>> round(float(sample_variance(history, 1.0, Controller(1e-3))), 4)
        0.2857
    """
    given = {"mean": mean, "square_deviation": square_deviation, "count": count, "control": control}
    for name, value in (given | {"missing": missing, "valid": valid}).items():
        _recursion.check_fits(name, jnp.shape(value), history.degrees.shape, "that is the history's")
    kept = history.degrees.dtype
    wide = _recursion.computing_dtype(kept)
    mean, square_deviation, count, control = (jnp.asarray(v, wide) for v in given.values())
    fresh = jnp.asarray(missing) | history.is_lost
    old = jax.tree.map(lambda v: jnp.where(fresh, 0, v.astype(wide)), history)
    degrees, scale = jnp.maximum(count - 1, 1), _scale(control, controller)
    is_lit = jnp.square(control) >= scale / 2
    # Light that comes on shows what the dark could not.
    is_dawn = is_lit & (old.lit_degrees < old.degrees / 2)
    old = jax.tree.map(lambda v: jnp.where(is_dawn, 0, v), old)
    learned = (
        jnp.asarray(valid)
        & (count >= 2)
        & ~_is_lamp_off(old, mean, square_deviation / degrees, scale, is_lit)
    )
    relative, lit = square_deviation / scale, jnp.square(control) / scale
    # Of a first frame nothing was expected; normal samples would have this.
    unforeseen = jnp.sqrt(2 / degrees) * relative
    surprise = jnp.where(old.degrees > 0, relative - degrees * _relative_variance(old), unforeseen)
    fade = 1 - jnp.asarray(controller.alpha, wide)
    new = History(
        fade * old.square_deviation + relative,
        fade * old.degrees + degrees,
        fade * old.lit_degrees + degrees * lit,
        jnp.square(fade) * old.uncertainty + jnp.square(surprise),
        _gain_after(old, mean / jnp.sqrt(scale), relative / degrees, jnp.maximum(count, 1), controller),
    )
    new = jax.tree.map(lambda v: _recursion.within(v, kept).astype(kept), new)
    lost = ~(jnp.isfinite(mean) & jnp.isfinite(square_deviation) & jnp.isfinite(control))
    new = eqx.tree_at(lambda h: h.square_deviation, new, jnp.where(lost, jnp.nan, new.square_deviation))
    unlearned = _recursion.choose(fresh, jax.tree.map(jnp.zeros_like, history), history)
    return _recursion.choose(learned, new, unlearned)


def _is_lamp_off(old: History, mean: Array, variance: Array, scale: Array, is_lit: Array) -> Array:
    """Whether a frame is too dark to say anything of a pixel that has mostly been lit.

    Its own light, its result and its spread are all below what the target calls noise; a pixel in a
    shadow that still receives light from around is none.
    """
    is_dark = ~is_lit & (jnp.square(mean) < scale) & (variance < scale)
    return is_dark & (old.lit_degrees > old.degrees / 2)


def _scale(control: Array, controller: Controller) -> Array:
    """What a frame's variances are measured in."""
    return jnp.square(control) + jnp.asarray(controller.target_variance, control.dtype)


def _relative_variance(history: History) -> Array:
    """Variance of one sample in units of the scale."""
    wide = _recursion.computing_dtype(history.degrees.dtype)
    total, degrees = history.square_deviation.astype(wide), history.degrees.astype(wide)
    return jnp.where(degrees > 0, total / jnp.where(degrees > 0, degrees, 1), total)


def _gain_after(
    old: History, result: Array, variance: Array, count: Array, controller: Controller
) -> Gain | None:
    """The gain's memory after a frame, all in units of its scale.

    Args:
        old: before the frame.
        result: the samples' mean.
        variance: of one sample, from the frame alone.
        count: of samples.
        controller: the constants.
    """
    if controller.gain_alpha is None:
        return old.gain
    if old.gain is None:
        raise ValueError("history must keep a gain for a controller with a gain_alpha; init it with that one")
    keep = 1 - jnp.asarray(controller.gain_alpha, result.dtype)
    is_first = old.degrees == 0
    before = jnp.maximum(old.gain.previous_count, 1)
    # Half a squared difference has the mean of both results' variances.
    temporal = jnp.square(result - old.gain.previous) / (1 / count + 1 / before)
    prior = _PRIOR_FRAMES * variance
    return Gain(
        result,
        count,
        jnp.where(is_first, prior, keep * old.gain.temporal + temporal),
        jnp.where(is_first, prior, keep * old.gain.spatial + variance),
    )
