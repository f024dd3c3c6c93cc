"""The picture of docs/benchmarks.md: speed against error, a panel for each measure of error."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, ScalarFormatter
from matplotlib.transforms import Bbox, IdentityTransform

STYLES = {
    "sssfit": ("#0072b2", "o"),
    "NumPy": ("#d55e00", "s"),
    "SciPy": ("#aa4499", "D"),
    "Numba": ("#117733", "^"),
}
PIXELS = IdentityTransform()
#: Error, the mark of its front, and the axis label.
PANELS = (
    ("radius_rms", "front_radius", "root mean square error of the radius, in d"),
    ("cdf_max", "front_cdf", "largest error of the cdf"),
)


def draw(rows: Sequence, floor: float, path: Path) -> None:
    """Draw `inverse_cdf.Row`s, and the time of the memory traffic alone as a line."""
    figure = Figure(figsize=(9.5, 11), dpi=110, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    panels = figure.subplots(2, 1, sharex=True)
    for axes, (error, front, label) in zip(panels, PANELS, strict=True):
        _decorate(axes, label)
        axes.axvline(floor, color="0.5", linestyle=":", linewidth=1.2)
        for row in rows:
            _mark(axes, row, getattr(row.errors, error), getattr(row, front))
    panels[-1].set_xlabel("nanoseconds per sample (median, bar: quartiles)")
    panels[0].set_title("Radii from Burley's profile in float32: faster is left, more accurate is down")
    figure.legend(handles=_legend(), loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    canvas.draw()
    figure.set_layout_engine("none")  # names are placed in pixels, which must stay
    for axes, (error, front, _) in zip(panels, PANELS, strict=True):
        _label(axes, rows, error, front)
    figure.savefig(path)


def _decorate(axes: Axes, label: str) -> None:
    axes.set(xscale="log", yscale="log", ylabel=label)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_locator(LogLocator(subs=()))
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    axes.margins(x=0.08, y=0.16)


def _mark(axes: Axes, row, error: float, on_front: bool) -> None:
    color, marker = STYLES[row.library]
    time = row.time
    axes.plot([time.lower, time.upper], [error, error], color=color, linewidth=1, alpha=0.6)
    face = color if on_front else "white"
    axes.plot(time.median, error, marker, color=color, markerfacecolor=face, markersize=7)


def _legend() -> list[Line2D]:
    def handle(label: str, **style) -> Line2D:
        return Line2D([], [], linestyle=style.pop("linestyle", ""), label=label, **style)

    libraries = [handle(name, color=color, marker=marker) for name, (color, marker) in STYLES.items()]
    return [
        *libraries,
        handle("not beaten (on the front)", color="0.3", marker="o"),
        handle("beaten", color="0.3", marker="o", markerfacecolor="white"),
        handle("reading and writing alone", color="0.5", linestyle=":"),
    ]


def _label(axes: Axes, rows: Sequence, error: str, front: str) -> None:
    """Name each marker at the nearest place that is free of markers, bars and earlier names."""
    to_pixels = axes.transData.transform
    spots, taken = {}, []
    for row in rows:
        (left, y), (x, _), (right, _) = (to_pixels((t, getattr(row.errors, error))) for t in row.time)
        spots[row.name] = (x, y)
        taken += [Bbox.from_extents(x - 7, y - 7, x + 7, y + 7), Bbox.from_extents(left, y - 1, right, y + 1)]
    for row in sorted(rows, key=lambda row: not getattr(row, front)):
        text = axes.text(0, 0, row.name, transform=PIXELS, fontsize=8.5, verticalalignment="bottom")
        text.set_color(STYLES[row.library][0])
        text.set_fontweight("bold" if getattr(row, front) else "normal")
        size = text.get_window_extent()
        box = _free_place(spots[row.name], size.width, size.height, taken, axes.bbox.padded(-4))
        taken.append(box)
        text.set_position((box.x0, box.y0))
        _leader(axes, spots[row.name], box)


def _free_place(spot, width: float, height: float, taken: list[Bbox], frame: Bbox) -> Bbox:
    """The first box, in growing circles around a spot, that is inside the frame and overlaps nothing."""
    for reach in range(9, 150, 5):
        for angle in np.deg2rad([0, 90, 270, 180, 45, 315, 135, 225, 20, 340, 160, 200, 70, 290]):
            x = spot[0] + np.cos(angle) * (reach + width / 2)
            y = spot[1] + np.sin(angle) * (reach + height / 2)
            box = Bbox.from_bounds(x - width / 2, y - height / 2, width, height)
            inside = frame.x0 < box.x0 and box.x1 < frame.x1 and frame.y0 < box.y0 and box.y1 < frame.y1
            if inside and not any(box.padded(1).overlaps(other) for other in taken):
                return box
    return Bbox.from_bounds(spot[0], spot[1], width, height)


def _leader(axes: Axes, spot, box: Bbox) -> None:
    """A thin line from a marker to its name where the two are apart."""
    end = np.clip(spot, (box.x0, box.y0), (box.x1, box.y1))
    if np.hypot(*(end - spot)) > 16:
        line = Line2D([spot[0], end[0]], [spot[1], end[1]], transform=PIXELS, color="0.6", linewidth=0.7)
        line.set_zorder(1)
        axes.add_artist(line)
