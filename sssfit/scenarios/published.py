"""What the papers print about their scenarios, beside ours; shown by `sssfit reproduce`."""

import math
from collections.abc import Iterator

import jax
import numpy as np

from sssfit.estimators import policies
from sssfit.reproduction import Row
from sssfit.scenarios import batch_mean, circle, driver, light, line, measure

#: Repetitions of the circle, of the line, and of Table B.1.
_CIRCLE_SEEDS, _LINE_SEEDS, _TABLE_SEEDS = 2000, 8, 1000
#: Table B.1, in the order of `batch_mean.NAMES`.
_TABLE: dict[batch_mean.Light, tuple[str, ...]] = {
    "static": ("0.0325", "0.0160", "0.0058", "0.0070", "0.0324", "0.0055"),
    "dynamic": ("0.5585", "0.3797", "0.3742", "0.1295", "0.0732", "0.1243"),
}
_HEAVY_TAILS = "ours is the median: its first coefficient is a ratio of two differences, without a variance"


def rows() -> Iterator[Row]:
    """The rows of this topic, each computed when it is asked for.

    Returns:
        The circle, the line, the coefficients of appendix B and its Table B.1.

    Example:
        >>> next(rows()).verdict
        'reproduced'
    """
    yield from _circle()
    yield from _line()
    yield from _coefficients()
    yield from _table()


def _circle() -> Iterator[Row]:
    world, source = circle.uniform(150), "Xie et al. 2020, section 4.1.3"
    variance = 0.08**2
    for kappa in (0.0, 1.0):
        policy = policies.named("spvg", target_variance=variance, kappa=kappa)
        record = driver.run(jax.random.key(1), world, policy, seeds=_CIRCLE_SEEDS, start="cold")
        results = np.asarray(record.value, np.float64)[:, measure.STEADY :]
        by_seed = 1e3 * (results.mean(axis=1) - 1)
        quantity = f"result less 1 after the cold start, kappa = {kappa:g}, in 1e-3"
        yield Row(source, quantity, "0", float(by_seed.mean()), measure.standard_error(by_seed))
        delivered = 100 * np.square(results - 1).mean(axis=1) / variance
        yield Row(
            source,
            f'variance "within the given quality level", kappa = {kappa:g}, % of sigma_0^2',
            "100",
            float(delivered.mean()),
            measure.standard_error(delivered),
            differs=True,
            reason="counts scatter around the neutral one, and the mean of 1 / n exceeds 1 / the mean",
        )
    policy = policies.named("spvg", target_variance=variance, kappa=1.0)
    record = driver.run(jax.random.key(1), world, policy, seeds=_CIRCLE_SEEDS, start="cold", sequence="r2")
    length, error = _peak_length(np.asarray(record.count)[:, measure.STEADY :] > 24)
    yield Row(
        source,
        "frames that a peak above 24 spp usually lasts, kappa = 1, R2 points",
        "1",
        length,
        error,
        differs=True,
        reason="the sequence is not stated; independent points are at a bound for most of the time",
    )


def _peak_length(is_peak: np.ndarray) -> tuple[float, float]:
    """Mean length of runs along the last axis, and its standard error over the rows."""
    starts = is_peak & ~np.pad(is_peak, ((0, 0), (1, 0)))[:, :-1]
    frames, peaks = is_peak.sum(axis=1), starts.sum(axis=1)
    length = frames.sum() / peaks.sum()
    error = np.std(frames - length * peaks, ddof=1) / np.sqrt(len(peaks)) / peaks.mean()
    return float(length), float(error)


def _line() -> Iterator[Row]:
    """Fig 2 and 7 of 2021, in one setting that shows what they say."""
    x = line.centres(256, 4.0)
    found = {}
    for name, brightness in (("static", light.static(120)), ("sine", light.sine(120))):
        irradiance = (brightness[:, None] * line.ramp(x)).astype(np.float32)
        world = line.world(irradiance, length=4.0, d=0.05, kernel="radial")
        for controller in ("as", "ocv", "ccv") if name == "sine" else ("as",):
            policy = policies.named(controller)
            records = driver.chunks(jax.random.key(1), world, policy, seeds=_LINE_SEEDS)
            statistics = measure.collect(records, world, measure.Target(1e-4), first=0)
            found[name, controller] = measure.summarize(statistics)
    adaptive, online, constant = (found["sine", name] for name in ("as", "ocv", "ccv"))
    static = found["static", "as"]
    relative = math.hypot(
        adaptive.mean_count_se / adaptive.mean_count, static.mean_count_se / static.mean_count
    )
    ratio = 100 * adaptive.mean_count / static.mean_count
    setting = (
        "the setup is not stated; ours: a ramp over [1, 2] of 4 mm to 0.5, d = 0.05 mm, 1 + 0.5 sin(2 pi t)"
    )
    source = "Xie and Olano 2021, Fig 2"
    yield Row(
        source,
        "samples under dynamic light, % of static",
        "242",
        ratio,
        ratio * relative,
        None,
        True,
        setting,
    )
    reason = "a frame's result cannot have it at a target of 1e-4; one averaged over frames has"
    figures = (adaptive.image_rmse, adaptive.image_rmse_se)
    yield Row(source, "rmse under dynamic light", ".0028", *figures, None, True, reason)
    source = "Xie and Olano 2021, section 6.2.4"
    less = constant.mean_count - online.mean_count
    error = math.hypot(constant.mean_count_se, online.mean_count_se)
    yield Row(source, "samples of a = 1 less those of the online a", "-3", less, error, None, True, setting)
    worse = constant.image_rmse / online.image_rmse
    error = worse * math.hypot(
        constant.image_rmse_se / constant.image_rmse, online.image_rmse_se / online.image_rmse
    )
    yield Row(
        source,
        "rmse of a = 1 over that of the online a (.0031 / .0028)",
        "1.11",
        worse,
        error,
        None,
        True,
        setting,
    )


def _coefficients() -> Iterator[Row]:
    moments, source = batch_mean.MOMENTS, "Xie 2021, appendix B.3.2"
    yield Row(source, "best coefficient of static light", "0.477", moments.static_coefficient)
    estimates = _many_samples(spp=1024, seeds=400)
    spread = np.percentile(estimates, (0.5, 99.5))
    yield Row(
        source,
        "best coefficient of dynamic light, from 100 frames of 1024 samples",
        "1.388",
        float(estimates.mean()),
        measure.standard_error(estimates),
        spread=(float(spread[0]), float(spread[1])),
        reason="one run's; exactly 2 ln 2 = 1.386 for infinitely many samples",
    )
    left = moments.value_mean - 1.388 * moments.control_mean
    yield Row(source, "integral of f - 1.388 g", "-8.53e-4", left)
    source = "Xie and Olano 2021, section 6.1.2"
    yield Row(source, "ln 4, best coefficient of a constant control", "1.386", moments.dynamic_coefficient)


def _many_samples(*, spp: int, seeds: int) -> np.ndarray:
    """Cov / Var of the frames' means under dynamic light, (seeds,)."""
    h = batch_mean.intensity("dynamic")
    estimates = np.empty(seeds)
    for seed in range(seeds):
        y = np.random.default_rng(seed).random((len(h), spp))
        value, control = (h * a.mean(axis=1) for a in (1 / (1 + y), 1 - y))
        estimates[seed] = np.cov(value, control)[0, 1] / np.var(control, ddof=1)
    return estimates


def _table() -> Iterator[Row]:
    for lit, printed in _TABLE.items():
        entries = batch_mean.table(jax.random.key(1), lit, seeds=_TABLE_SEEDS)
        for entry, text in zip(entries, printed, strict=True):
            is_heavy = entry.name.startswith("EMCM")
            outlier = (entry.name, lit) == ("Res_f", "dynamic")
            reason = "below the range of 99 % of our runs; no cause found" if outlier else ""
            yield Row(
                "Xie 2021, Table B.1",
                f"{entry.name}, {lit}",
                text,
                entry.median if is_heavy else entry.mean,
                (1.2533 if is_heavy else 1.0) * _deviation(entry) / math.sqrt(_TABLE_SEEDS),
                spread=(entry.low, entry.high),
                differs=outlier,
                reason=_HEAVY_TAILS if is_heavy else reason,
            )


def _deviation(entry: batch_mean.Entry) -> float:
    """The seeds' deviation; of heavy tails that of the middle, by a normal distribution's quartiles."""
    return entry.sd if not entry.name.startswith("EMCM") else entry.interquartile / 1.349
