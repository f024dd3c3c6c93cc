"""Pictures of simulations, drawn by matplotlib without a display; the same numbers give the same bytes."""

import io
from collections.abc import Sequence

import numpy as np

from sssfit.scenarios.batch_mean import FIRST, Entry, Residuals
from sssfit.scenarios.measure import Statistics, count_quantiles, oracle_count

_BLUE, _RED, _GREEN, _GREY = "#2b5fb3", "#c8322d", "#2e8b3d", "#777777"
_COLOURS = (_GREY, "#8a5a00", "#5b3c88", _BLUE, _RED, _GREEN)
_DPI = 110


def circle(found: Statistics, *, title: str, one: np.ndarray) -> bytes:
    """Counts, variance and result of one pixel over time, with bands over the seeds.

    Args:
        found: the statistics; of several pixels the mean is drawn.
        title: of the picture.
        one: the results of one seed, (frames,).

    Returns:
        A PNG file.

    Example:
        >>> import jax
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle as scenario, driver, measure
        >>> world, fixed = scenario.uniform(60), policies.named("fixed")
        >>> record = driver.run(jax.random.key(0), world, fixed, seeds=2)
        >>> found = measure.collect([record], world, measure.Target(0.0064))
        >>> circle(found, title="fixed", one=record.value[0])[1:4]
        b'PNG'
    """
    figure, panels = _figure(title, 2, 2, (10.5, 6.6))
    counts, variances, results, shares = panels.ravel()
    frames, target = np.arange(1, len(found.truth) + 1), found.target
    band = count_quantiles(found.histogram, (0.05, 0.95)).T
    _draw_counts(counts, frames, found, band, "5-95 % of the seeds")
    variances.plot(
        frames, found.variance.mean(axis=1), color=_BLUE, lw=1.3, label="believed by the controller"
    )
    variances.plot(frames, found.delivered.mean(axis=1), color=_RED, lw=1.3, label="delivered")
    variances.axhline(target.variance, color="#222222", ls=":", lw=1, label="target")
    variances.set(xlabel="frame", ylabel="variance of a frame's result", yscale="log")
    truth, spread = found.truth.mean(axis=1), np.sqrt(found.squared_error.mean(axis=1))
    results.fill_between(frames, truth - spread, truth + spread, color=_BLUE, alpha=0.2, lw=0)
    results.plot(frames, one, color=_GREY, lw=0.8, label="one seed")
    results.plot(frames, found.value.mean(axis=1), color=_BLUE, lw=1.3, label="mean and deviation of all")
    results.plot(frames, truth, color="#222222", ls=":", lw=1, label="truth")
    results.set(xlabel="frame", ylabel="result")
    steady = found.histogram[found.first :].sum(axis=0)
    shares.bar(np.arange(len(steady)), 100 * steady / steady.sum(), width=1.0, color=_BLUE)
    ideal = oracle_count(found.sample_variance[found.first :], target).mean()
    shares.axvline(ideal, color="#222222", ls=":", lw=1, label="oracle")
    shares.set(xlabel=f"count, frames {found.first + 1} on [spp]", ylabel="share [%]")
    shares.set_xlim(max(0, target.min_spp - 2), target.max_spp + 2)
    for axes in (variances, results, shares):
        axes.legend(frameon=False, fontsize=8)
    return _png(figure)


def line(found: Statistics, *, title: str, x: np.ndarray, light: np.ndarray, intensity: np.ndarray) -> bytes:
    """Counts, variance and result along a line and over time.

    Args:
        found: the statistics.
        title: of the picture.
        x: of the texels, mm.
        light: irradiance on the texels at intensity 1, (texels,).
        intensity: of each frame, (frames,).

    Returns:
        A PNG file.

    Example:
        >>> import jax
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import driver, line as scenario, measure
        >>> x = scenario.centres(16, 4.0)
        >>> world = scenario.world(scenario.step(x)[None].repeat(3, 0), length=4.0, d=0.1)
        >>> records = driver.chunks(jax.random.key(0), world, policies.named("as"), seeds=2)
        >>> found = measure.collect(records, world, measure.Target(1e-4), first=0)
        >>> line(found, title="as", x=x, light=scenario.step(x), intensity=np.ones(3))[1:4]
        b'PNG'
    """
    figure, panels = _figure(title, 2, 3, (14.5, 7.2))
    frames = np.arange(1, len(found.truth) + 1)
    first, target = found.first, found.target
    (lit, along, counts), (over_time, variances, errors) = panels
    lit.fill_between(x, light, color="#e8c35a", alpha=0.6, lw=0, label="light")
    lit.plot(
        x, found.truth[first:].mean(axis=0), color="#222222", lw=1, ls=":", label="truth, mean over time"
    )
    lit.plot(x, found.value[first:].mean(axis=0), color=_BLUE, lw=1.1, label="result, mean")
    lit.set(xlabel="x [mm]", ylabel="irradiance")
    ideal = oracle_count(found.sample_variance, target)
    along.plot(x, found.count[first:].mean(axis=0), color=_BLUE, lw=1.3, label="mean count")
    along.plot(x, ideal[first:].mean(axis=0), color="#222222", ls=":", lw=1, label="oracle")
    along.set(xlabel="x [mm]", ylabel="count, mean over time [spp]", ylim=(0, 1.05 * target.max_spp))
    image = counts.imshow(
        found.count,
        origin="lower",
        aspect="auto",
        extent=(0, x[0] + x[-1], 0.5, len(frames) + 0.5),
        vmin=0,
        vmax=target.max_spp,
        cmap="viridis",
    )
    figure.colorbar(image, ax=counts, label="mean count [spp]")
    counts.set(xlabel="x [mm]", ylabel="frame")
    band = np.quantile(found.count_by_seed, (0.05, 0.95), axis=0)
    _draw_counts(over_time, frames, found, band, "5-95 % of the seeds' means")
    over_time.plot(
        frames,
        intensity / max(intensity.max(), 1e-30) * target.max_spp,
        color="#b08a1e",
        lw=0.8,
        label="light",
    )
    over_time.legend(frameon=False, fontsize=8)
    for values, colour, label in (
        (found.variance, _BLUE, "believed by the controller"),
        (found.delivered, _RED, "delivered"),
        (found.sample_variance / ideal, _GREEN, "delivered by the oracle"),
    ):
        variances.plot(x, values[first:].mean(axis=0) / target.variance, color=colour, lw=1.2, label=label)
    variances.axhline(1, color="#222222", ls=":", lw=1)
    variances.set(xlabel="x [mm]", ylabel="variance / target", yscale="log", ylim=(1e-3, None))
    error = np.sqrt(found.error_by_seed)
    errors.fill_between(frames, *np.quantile(error, (0.05, 0.95), axis=0), color=_BLUE, alpha=0.2, lw=0)
    errors.plot(
        frames, np.sqrt(found.error_by_seed.mean(axis=0)), color=_BLUE, lw=1.2, label="all texels, 5-95 %"
    )
    errors.set(xlabel="frame", ylabel="root mean square error", ylim=(0, None))
    for axes in (lit, along, variances, errors):
        axes.legend(frameon=False, fontsize=8)
    return _png(figure)


def batch_mean(entries: dict[str, Sequence[Entry]], streams: dict[str, Residuals]) -> bytes:
    """Coefficients, errors of one seed, and the table's spread over the seeds, a row for each light.

    Args:
        entries: of each light, as `batch_mean.table` returns them.
        streams: of each light, as `batch_mean.simulate` returns them.

    Returns:
        A PNG file.

    Example:
        >>> import jax
        >>> from sssfit.scenarios import batch_mean as scenario
        >>> key = jax.random.key(0)
        >>> entries = {"static": scenario.table(key, "static", seeds=3)}
        >>> batch_mean(entries, {"static": scenario.simulate(key, "static")})[1:4]
        b'PNG'
    """
    figure, panels = _figure("", len(entries), 3, (14.5, 3.8 * len(entries)))
    for (coefficients, errors, spread), light in zip(np.atleast_2d(panels), entries, strict=True):
        stream, rows = streams[light], entries[light]
        frames = np.arange(1, len(stream.error["GT"]) + 1)
        for name, colour in zip(stream.error, _COLOURS, strict=True):
            if name != "Res_f":
                coefficients.plot(frames, stream.coefficient[name], color=colour, lw=1.2, label=name)
            errors.plot(frames, stream.error[name], color=colour, lw=1.2, label=name)
        best = float(stream.coefficient["GT"][-1])
        coefficients.set(
            xlabel="frame", ylabel="coefficient", title=f"{light}, one seed", ylim=(-0.5, best + 1)
        )
        errors.axvline(FIRST + 1, color="#222222", ls=":", lw=1)
        errors.set(xlabel="frame", ylabel="root of the residual's moving variance", yscale="log")
        errors.set_title(f"{light}, one seed")
        places = np.arange(len(rows))
        median = np.array([row.median for row in rows])
        low, high = (np.array([getattr(row, name) for row in rows]) for name in ("low", "high"))
        spread.errorbar(places, median, (median - low, high - median), fmt="o", color=_BLUE, capsize=3)
        spread.set_xticks(places, [row.name for row in rows], rotation=25)
        spread.set(ylabel="mean error", title=f"{light}, median and 99 % of the seeds", yscale="log")
        for axes in (coefficients, errors):
            axes.legend(frameon=False, fontsize=8)
    return _png(figure)


def _draw_counts(axes, frames, found: Statistics, band: np.ndarray, label: str) -> None:
    """Mean count over time with its band, and the oracle's."""
    low, high = band
    target = found.target
    axes.fill_between(frames, low, high, color=_BLUE, alpha=0.2, lw=0, label=label, step="mid")
    axes.plot(frames, found.count.mean(axis=1), color=_BLUE, lw=1.3, label="mean count")
    ideal = oracle_count(found.sample_variance, target).mean(axis=1)
    axes.plot(frames, ideal, color="#222222", ls=":", lw=1, label="oracle")
    axes.set(xlabel="frame", ylabel="count [spp]", ylim=(0, 1.05 * max(target.max_spp, high.max())))
    axes.legend(frameon=False, fontsize=8)


def _figure(title: str, rows: int, columns: int, inches: tuple[float, float]):
    # Only drawing needs matplotlib; its import costs more than all of sssfit's.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=11)
    panels = figure.subplots(rows, columns)
    for axes in np.ravel(panels):
        axes.grid(alpha=0.3)
        axes.set_axisbelow(True)
    return figure, panels


def _png(figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()
