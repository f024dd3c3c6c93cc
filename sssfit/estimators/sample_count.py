"""How many samples a pixel draws next, from the variance that its own history has shown.

The variance tracked is that of the frame's result, a mean of n samples, so n = variance / target * mean
count brings it to the target (Eq 10 of the 2021 paper); a correction makes up at once for the frames that
the history still remembers (Eq 9, with squares: the 2020 paper's Eq 15 has lost them). kappa scales the
correction: with relative deviations small, the count then follows its neutral point with the factor
(1 - alpha)(1 - 2 kappa) a frame, so that it overshoots from kappa = 1/2 on; see `count_prediction`.

Counts, variances and targets are of one pixel or of maps of them, of any shapes that broadcast; variances are
in the squared unit of what is tracked, counts in samples per pixel. A history that a NaN or an infinity
has got into counts as missing: the pixel starts afresh with the next frame.

Source: Xie et al. 2020, Eq 7-17; Xie and Olano 2021, Eq 5-10 and 18, Algorithm 1; Unreal Engine's
BurleyNormalizedSSSCommon.ush.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from sssfit.estimators import _recursion
from sssfit.estimators._controller import PAPER_2020 as PAPER_2020
from sssfit.estimators._controller import PAPER_2021 as PAPER_2021
from sssfit.estimators._controller import PRESETS as PRESETS
from sssfit.estimators._controller import UNREAL as UNREAL
from sssfit.estimators._controller import Controller as Controller
from sssfit.estimators._controller import History as History
from sssfit.estimators._controller import Rounding, check_rounding
from sssfit.profiles import burley


def estimate(
    mean_count: ArrayLike,
    variance: ArrayLike,
    *,
    target_variance: ArrayLike,
    alpha: ArrayLike,
    kappa: ArrayLike,
    min_spp: ArrayLike,
    max_spp: ArrayLike,
) -> Array:
    """The count that the next frame needs, not rounded, within its bounds.

    Args:
        mean_count: moving average of the counts so far; 0 where nothing is known, which gives min_spp.
        variance: moving variance of the frames' results, >= 0; inf gives max_spp where anything was drawn.
        target_variance: what to bring it to, > 0.
        alpha: weight of the newest frame in both averages, in (0, 1]; at 1 there is no correction.
        kappa: share of the correction, in [0, 1].
        min_spp, max_spp: bounds, samples per pixel.

    Returns:
        kappa Delta + E within [min_spp, max_spp], Delta = (variance - target) / target * mean_count *
        (2 / alpha - 2) and E = variance / target * mean_count, of the arguments' shape and dtype.
        Error below 4 eps (1 + g) max(variance / target, 1) mean_count, g = kappa (2 / alpha - 2): relative
        to the count itself only where the correction does not cancel it. NaN for a NaN.

    Source: Xie and Olano 2021, Eq 8-10; Xie et al. 2020, Eq 14, whose Eq 15 lacks the squares.

    Example:
        >>> setting = dict(target_variance=1e-3, alpha=0.2, kappa=0.2, min_spp=8, max_spp=64)
        >>> float(estimate(16.0, 1.1e-3, **setting)).__round__(3)
        20.16
    """
    _recursion.check_alpha(alpha)
    dtype = jnp.result_type(float, mean_count, variance, target_variance, alpha, kappa)
    wide = _recursion.computing_dtype(dtype)
    mean_count, variance, target_variance, alpha, kappa = (
        jnp.asarray(v, wide) for v in (mean_count, variance, target_variance, alpha, kappa)
    )
    largest = float(jnp.finfo(wide).max)
    # As large as a number can be is as much as any bound needs, and times 0 it is no NaN.
    ratio = jnp.minimum(variance / target_variance, largest)
    correction = kappa * (2 / alpha - 2) * (ratio - 1)
    count = mean_count * jnp.minimum(ratio + correction, largest)
    return jnp.clip(count, jnp.asarray(min_spp, wide), jnp.asarray(max_spp, wide)).astype(dtype)


def basic_estimate(
    count: ArrayLike, variance: ArrayLike, *, target_variance: ArrayLike, min_spp: ArrayLike
) -> Array:
    """The count that would have met the target, from the last frame's count and variance alone.

    Args:
        count: samples drawn, of the variance's frame.
        variance: variance of that frame's result, >= 0.
        target_variance: what to bring it to, > 0.
        min_spp: lower bound.

    Returns:
        max(variance / target_variance * count, min_spp), not rounded.

    Source: Xie et al. 2020, Eq 7.

    Example:
        >>> float(basic_estimate(16.0, 2e-3, target_variance=1e-3, min_spp=8))
        32.0
    """
    dtype = jnp.result_type(float, count, variance, target_variance, min_spp)
    count, variance, target_variance, min_spp = (
        jnp.asarray(v, dtype) for v in (count, variance, target_variance, min_spp)
    )
    ratio = jnp.minimum(variance / target_variance, float(jnp.finfo(dtype).max))
    return jnp.maximum(ratio * count, min_spp)


def round_count(count: ArrayLike, rounding: Rounding = "nearest") -> Array:
    """A whole number of samples.

    Args:
        count: >= 0, samples per pixel.
        rounding: "nearest" (halves to the even number), "up" or "down".

    Returns:
        int32; 0 for NaN and below 0, at most 2^31 - 1.

    Raises:
        ValueError: the rounding is none of the three.

    Source: the papers leave it open; "nearest" reproduces the 2020 circle figures best.

    Example:
        >>> round_count(jnp.array([8.5, 9.5, jnp.nan])).tolist()
        [8, 10, 0]
    """
    check_rounding(rounding)
    count = jnp.asarray(count, jnp.result_type(float, count))
    count = count.astype(_recursion.computing_dtype(count.dtype))
    whole = {"nearest": jnp.round, "up": jnp.ceil, "down": jnp.floor}[rounding](count)
    limit = 2**31 - 1
    inside = jnp.clip(jnp.where(jnp.isnan(whole), 0, whole), 0, limit)
    # float32 has no 2^31 - 1: what rounds up to 2^31 would not fit.
    return jnp.where(inside >= limit, limit, jnp.where(inside >= limit, 0, inside).astype(jnp.int32))


def distant_share(depth: ArrayLike, pixel_width: ArrayLike, pixel_height: ArrayLike, d: ArrayLike) -> Array:
    """Share of the scattered light that comes from beyond a pixel's own disc.

    Args:
        depth: distance along the view axis, mm; at 0 all light is distant.
        pixel_width, pixel_height: a pixel's size at unit depth, dimensionless: 2 tan(fov / 2) / pixels.
        d: Burley's shape parameter, mm, the widest channel's for a pixel.

    Returns:
        sf(r0, d) with r0 = depth sqrt(width^2 + height^2) / 2, in [0, 1]; accuracy as `burley.sf`, plus what
        rounding r0 adds, (r0 / d) eps.

    Source: Xie and Olano 2021, Eq 14 and Table 2 (gamma).

    Example:
        >>> float(distant_share(1000.0, 1e-3, 1e-3, 0.5)).__round__(4)
        0.5289
    """
    radius = jnp.asarray(depth) * jnp.hypot(jnp.asarray(pixel_width), jnp.asarray(pixel_height)) / 2
    return burley.sf(radius, d)


def distant_count(count: ArrayLike, share: ArrayLike, *, threshold: ArrayLike) -> Array:
    """Samples for the distant light alone, none where there is too little of it.

    Args:
        count: samples that all of the light would take.
        share: share of distant light, in [0, 1]; see `distant_share`.
        threshold: below this share no samples are drawn; the light left out biases the pixel by at most it.

    Returns:
        count * share, or 0 where share < threshold; not rounded.

    Source: Xie and Olano 2021, Eq 18.

    Example:
        >>> distant_count(32.0, jnp.array([0.5, 0.004]), threshold=0.01).tolist()
        [16.0, 0.0]
    """
    share = jnp.asarray(share)
    return jnp.where(share < threshold, 0, jnp.asarray(count) * share)


def init(like: ArrayLike, *, dtype: DTypeLike | None = None) -> History:
    """A history of nothing: a cold start, all zeros.

    Args:
        like: anything of the pixels' shape and dtype.
        dtype: what to keep the history in, such as jnp.float16; that of `like` by default.

    Source: Xie et al. 2020, section 4.1.3.

    Example:
        >>> float(init(0.0).variance)
        0.0
    """
    zero = jnp.zeros(jnp.shape(like), jnp.result_type(float, like) if dtype is None else dtype)
    return History(zero, zero, zero)


def next_count(
    history: History,
    controller: Controller,
    *,
    distant_share: ArrayLike = 1.0,
    missing: ArrayLike = False,
) -> Array:
    """How many samples each pixel draws in the next frame.

    Args:
        history: what it is decided from.
        controller: its constants.
        distant_share: see `distant_share`; 0 samples below the controller's threshold.
        missing: where the history is not this pixel's and is not looked at, as if it were all zeros; so
            is one with a NaN or an infinity in it.

    Returns:
        int32 within the controller's bounds, or 0.

    Source: Xie and Olano 2021, Algorithm 1.

    Example:
        >>> history = History(jnp.array(16.0), jnp.array(1.0), jnp.array(1.1e-3))
        >>> int(next_count(history, PAPER_2020))
        20
    """
    wide = _recursion.computing_dtype(history.variance.dtype)
    mean_count, variance = (
        jnp.where(missing | history.is_lost, 0, jnp.asarray(v, wide))
        for v in (history.mean_count, history.variance)
    )
    limits = {"min_spp": controller.min_spp, "max_spp": controller.max_spp}
    target = {"target_variance": jnp.asarray(controller.target_variance, wide)}
    if controller.metric == "accumulated":
        alpha, kappa = (jnp.asarray(v, wide) for v in (controller.alpha, controller.kappa))
        count = estimate(mean_count, variance, **target, alpha=alpha, kappa=kappa, **limits)
    else:
        count = basic_estimate(jnp.ones((), wide), variance, **target, min_spp=controller.min_spp)
        count = jnp.minimum(count, controller.max_spp)
    drawn = round_count(count, controller.rounding)
    return jnp.where(jnp.asarray(distant_share) < controller.distant_threshold, 0, drawn)


def update(
    history: History,
    value: ArrayLike,
    count: ArrayLike,
    controller: Controller,
    *,
    missing: ArrayLike = False,
    valid: ArrayLike = True,
) -> History:
    """The history after a frame.

    Args:
        history: before the frame.
        value: the frame's result, the mean of its samples.
        count: samples drawn for it. Where 0, nothing was learned and the history stays.
        controller: its constants.
        missing: where the pixel had no history, such as a surface just uncovered: the frame then weighs 1
            and the variance starts from the target (or zero). Where nothing is learned from it either, what
            is left is a history of nothing.
        valid: where False the history stays as it is, bit for bit, unless it was missing.

    Returns:
        A `History` of the same shape and dtype. What does not fit the dtype stays at its largest number.

    Raises:
        ValueError: value, count, missing or valid do not broadcast to the history's shape.

    Source: Xie and Olano 2021, Eq 5-7; Xie et al. 2020, Eq 16-17.

    Example:
        >>> history = update(init(0.0), 1.0, 8, PAPER_2020, missing=True)
        >>> [round(float(v), 6) for v in (history.mean_count, history.mean, history.variance)]
        [8.0, 1.0, 0.001]
    """
    for name, given in (("value", value), ("count", count), ("missing", missing), ("valid", valid)):
        _recursion.check_fits(name, jnp.shape(given), history.variance.shape, "that is the history's")
    kept = history.variance.dtype
    wide = _recursion.computing_dtype(kept)
    learned = jnp.asarray(valid) & (jnp.asarray(count) > 0)
    value = jnp.where(learned, jnp.asarray(value, wide), 0)
    fresh = jnp.asarray(missing) | history.is_lost
    alpha = jnp.where(fresh, 1, jnp.asarray(controller.alpha, wide))
    mean = history.mean.astype(wide)
    delta = value - mean
    new_mean, _ = _recursion.mean_step(mean, delta, value, alpha)
    drawn = jnp.asarray(count, wide)
    counted = history.mean_count.astype(wide)
    new_count, _ = _recursion.mean_step(counted, drawn - counted, drawn, alpha)
    variance, _ = _recursion.covariance_step(history.variance.astype(wide), delta, delta, alpha, lagged=False)
    start = controller.target_variance if controller.variance_when_missing == "target" else 0.0
    variance = jnp.where(fresh, jnp.asarray(start, wide), variance)
    # One sample too bright for the format, or for its square, must not decide for ever.
    variance = jnp.where(jnp.isfinite(value), _recursion.saturate(variance, kept), jnp.nan)
    stored = (_recursion.within(v, kept) for v in (new_count, new_mean))
    new = History(*(v.astype(kept) for v in (*stored, variance)))
    nothing = History(*(jnp.zeros_like(v) for v in (new.mean_count, new.mean, new.variance)))
    return _recursion.choose(learned, new, _recursion.choose(jnp.asarray(missing), nothing, history))
