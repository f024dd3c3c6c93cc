"""A picture of a fit, drawn by matplotlib without a display; the same numbers give the same bytes."""

import io
import math
from typing import TYPE_CHECKING

import numpy as np

from sssfit.fitting import intervals, responses
from sssfit.fitting.measured import Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = {"r": "#c8322d", "g": "#2e8b3d", "b": "#2b5fb3"}
_OTHERS = ("#2b5fb3", "#c8322d", "#2e8b3d", "#8a5a00", "#5b3c88", "#777777")
_DPI = 110
# More points than this are a cloud, and error bars would hide it.
_MOST_BARS = 200
_WORDS = {
    "radial": ("distance from the point", "R"),
    "line": ("distance from the line", "radiant exitance"),
    "edge": ("distance into the shadow", "radiant exitance / irradiance"),
    "beam": ("distance from the beam's centre", "radiant exitance / irradiance"),
}


def plot(fit: Fit, *, title: str = "") -> bytes:
    """Data, fit and its 95 % band, and below what is left over in standard deviations of the noise.

    Args:
        fit: as `measured.fit` returns it; a radial profile has logarithmic axes.
        title: of the picture.

    Returns:
        A PNG file.

    Example:
        >>> from sssfit.fitting import measured
        >>> plot(measured.fit([1.0, 2.0, 3.0], [0.2, 0.1, 0.02], sigma=0.01))[1:4]
        b'PNG'
    """
    # Only drawing needs matplotlib.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 6.6), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    distance, quantity = _WORDS[fit.response]
    unit = responses.UNITS[fit.response]
    for i, channel in enumerate(fit.channels):
        _draw(upper, lower, fit, i, _COLOURS.get(channel, _OTHERS[i % len(_OTHERS)]))
    lower.axhline(0, color="#222222", lw=0.8)
    for level in (-2, 2):
        lower.axhline(level, color="#222222", lw=0.6, ls=":")
    if title:
        upper.set_title(title, fontsize=11)
    unit = unit.replace("^2", "\u00b2")
    upper.set_ylabel(quantity if unit == "1" else f"{quantity} [{unit}]")
    lower.set(xlabel=f"{distance} [mm]", ylabel="residual [sd]")
    if fit.response == "radial":
        positive = fit.values[fit.values > 0]
        upper.set(xscale="log", yscale="log", ylim=(0.5 * positive.min(), 2 * positive.max()))
    upper.legend(frameon=False, fontsize=9)
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.set_axisbelow(True)
    return png(figure)


def png(figure: "Figure") -> bytes:
    """A figure as a PNG file that says nothing of who drew it, and when.

    Args:
        figure: matplotlib's.

    Returns:
        The file.

    Example:
        >>> from matplotlib.figure import Figure
        >>> png(Figure())[1:4]
        b'PNG'
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _draw(upper, lower, fit: Fit, i: int, colour: str) -> None:
    """One channel."""
    r, values, fitted, band, sigma = (
        fit.r, *(a[:, i] for a in (fit.values, fit.fitted, fit.band, fit.sigma))
    )  # fmt: skip
    many = len(r) > _MOST_BARS
    points = {"color": colour, "ls": "", "marker": ".", "ms": 2 if many else 5, "alpha": 0.4 if many else 0.8}
    if many:
        upper.plot(r, values, **points)
    else:
        upper.errorbar(r, values, np.where(np.isfinite(sigma), sigma, 0), elinewidth=0.8, **points)
    channel = fit.channels[i]
    upper.plot(r, fitted, color=colour, lw=1.3, label=f"{channel or fit.model}, fit and 95 % band")
    # Noise that was estimated has Student's intervals.
    width = intervals.half_width(0.95, fit.dof if math.isnan(fit.chi2) else math.inf)
    upper.fill_between(r, fitted - width * band, fitted + width * band, color=colour, alpha=0.25, lw=0)
    lower.plot(r, (values - fitted) / sigma, **points)
