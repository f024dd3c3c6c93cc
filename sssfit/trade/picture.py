"""The picture of a group: cost against error, and the front of the choices that none beats."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from sssfit.trade.choice import Group
from sssfit.trade.measure import Row
from sssfit.trade.pareto import beaten_by, cost

_FRONT, _BEATEN, _DEFAULT = "#0072b2", "#999999", "#d55e00"
_DPI = 110


def front(of: Group, rows: Sequence[Row], note: str = "") -> bytes:
    """Draw a group. Choices are numbered from the cheapest on, and named beside the picture.

    Args:
        of: the group.
        rows: its measurements, at least one.
        note: a line below the title, such as the frame.

    Returns:
        A PNG file.

    Example:
        >>> from sssfit.trade.registry import GROUPS
        >>> rest = {"knobs": {}, "is_default": True, "samples": 0, "bytes_moved": 8, "error_noise": 0.0}
        >>> rest |= {"time_noise": 0.02, "peak_bytes": 0, "compile_seconds": 0}
        >>> row = Row(group="precision", choice="float32", error=1e-7, nanoseconds=9.0, **rest)
        >>> front(GROUPS["precision"], [row])[1:4]
        b'PNG'
    """
    # Only drawing needs matplotlib.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.6), dpi=_DPI)
    # Fixed: an engine that looks for room takes longer than all else.
    room = {"left": 0.09, "right": 0.99, "bottom": 0.1, "top": 0.88, "wspace": 0.04}
    axes, names = figure.subplots(1, 2, width_ratios=(7, 4), gridspec_kw=room)
    ordered = sorted(rows, key=lambda row: cost(row, of))
    for number, row in enumerate(ordered, start=1):
        _mark(axes, of, row, not beaten_by(row, rows, of), number)
    _frame(axes, of, rows)
    figure.suptitle(of.title, fontsize=11)
    if note:
        axes.set_title(note, fontsize=9, color="0.35")
    _list(names, ordered, rows, of)
    _place_numbers(figure, axes)
    return as_png(figure)


def _mark(axes, of: Group, row: Row, is_best: bool, number: int) -> None:
    x, y = cost(row, of), _shown(row.error)
    colour = _DEFAULT if row.is_default else _FRONT if is_best else _BEATEN
    # What is as uncertain as it is large has no lower end on a logarithmic axis.
    spread = min(row.time_noise, 0.9) * x if of.cost == "time" else 0.0
    axes.errorbar(
        x, y, xerr=spread, yerr=min(2 * row.error_noise, 0.9 * y), fmt="o", markersize=7, color=colour,
        markerfacecolor=colour if is_best else "white", elinewidth=1, capsize=2,
    )  # fmt: skip
    axes.annotate(str(number), (x, y), xytext=(7, 5), textcoords="offset points", fontsize=9, color=colour)


def _shown(error: float) -> float:
    """An error of exactly 0 has no place on a logarithmic axis: the smallest that a double can tell."""
    return max(error, float(np.finfo(np.float64).eps))


def _frame(axes, of: Group, rows: Sequence[Row]) -> None:
    axes.set(xscale="log", yscale="log")
    paid = f"nanoseconds per {of.unit} (bars: 95 %)" if of.cost == "time" else f"samples per {of.unit}"
    axes.set_xlabel(paid)
    axes.set_ylabel(of.error)
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    axes.margins(0.1)
    axes.tick_params(which="both", labelsize=8)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        # Numbers between the powers of ten where there are few of these.
        if high < 1e3 * low:
            plain_ticks(axis)
    axes.minorticks_off()
    best = sorted((cost(row, of), _shown(row.error)) for row in rows if not beaten_by(row, rows, of))
    x, y = np.array(best).T
    axes.step(x, np.minimum.accumulate(y), where="post", color=_FRONT, linewidth=1, alpha=0.6, zorder=1)


def plain_ticks(axis: Any) -> None:
    """Write a logarithmic axis' numbers out, at 1, 2 and 5, or at each digit within a power of ten.

    Args:
        axis: of matplotlib.

    Example:
        >>> from matplotlib.figure import Figure
        >>> axes = Figure().subplots()
        >>> axes.set_xscale("log")
        >>> plain_ticks(axes.xaxis)
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high > 10 * low else range(1, 10)))
    axis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def as_png(figure: Any) -> bytes:
    """A drawn figure as a PNG file.

    Args:
        figure: of matplotlib.

    Example:
        >>> from matplotlib.figure import Figure
        >>> as_png(Figure())[1:4]
        b'PNG'
    """
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def _list(axes, ordered: Sequence[Row], rows: Sequence[Row], of: Group) -> None:
    axes.axis("off")
    longest = max(len(row.choice) + 14 * row.is_default for row in ordered)
    size = 8.5 * min(1.0, 22 / len(ordered), 46 / longest)
    for place, row in enumerate(ordered):
        is_best = not beaten_by(row, rows, of)
        text = f"{place + 1}  {row.choice}{' (default)' if row.is_default else ''}"
        axes.text(
            0, 1 - place / max(len(ordered), 12), text, transform=axes.transAxes, fontsize=size, va="top",
            color=_DEFAULT if row.is_default else "black" if is_best else "0.5",
            fontweight="bold" if is_best else "normal",
        )  # fmt: skip
    axes.text(0, -0.03, "bold, filled: no other beats it", transform=axes.transAxes, fontsize=8, color="0.35")


def _place_numbers(figure, axes) -> None:
    """Move numbers that lie on each other apart, upwards."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(figure).get_renderer()
    taken = []
    for text in sorted(axes.texts, key=lambda text: text.get_window_extent(renderer).x0):
        for _ in range(40):
            box = text.get_window_extent(renderer)
            if not any(box.overlaps(other) for other in taken):
                break
            x, y = text.get_position()
            text.set_position((x, y + 4))
        taken.append(text.get_window_extent(renderer))
