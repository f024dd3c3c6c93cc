"""A picture of each table, drawn by matplotlib without a display; the same table gives the same bytes."""

import io

import numpy as np

from sssfit.tables.table import Axis, Table

_COLOURS = {"R": "#c8322d", "G": "#2e8b3d", "B": "#2b5fb3"}
_OTHER_COLOURS = ("#333333", "#8a5a00", "#5b3c88", "#007a87")

#: Width and height of a plot in pixels. Small in inches, so that its letters stay legible on a phone.
PIXELS = (720, 460)
_DPI = 125

# Entries meant one by one (kernel taps, materials), not as samples of a curve.
_SEPARATE_AXES = ("offset", "material")


def plot(table: Table) -> bytes:
    """Draw a table: a curve per channel, or for two axes the colours beside a few of its rows.

    Args:
        table: any table.

    Returns:
        A PNG file of `PIXELS` pixels.

    Example:
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> plot(Table("t", "A line.", (axis,), ("Y",), np.array([[1.0], [0.5]]), "1"))[1:4]
        b'PNG'
    """
    # Only drawing needs matplotlib; its import costs more than all of sssfit's.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(PIXELS[0] / _DPI, PIXELS[1] / _DPI), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(table.name.replace("_", " "))
    if table.axes[0].name == "material":
        _draw_materials(figure, table)
    elif len(table.axes) == 2:
        _draw_image(figure, table)
    elif "," in table.unit:
        _draw_panels(figure, table)
    else:
        _draw_curves(figure.add_subplot(), table)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _label(name: str, unit: str) -> str:
    name = name.replace("_", " ")
    return name if unit == "1" else f"{name} [{unit}]"


def _colour(channel: str, index: int) -> str:
    return _COLOURS.get(channel, _OTHER_COLOURS[index % len(_OTHER_COLOURS)])


def _draw_curves(axes, table: Table) -> None:
    axis = table.axes[0]
    marker = "o" if axis.name in _SEPARATE_AXES else None
    for i, channel in enumerate(table.channels):
        axes.plot(
            axis.values, table.values[:, i], color=_colour(channel, i), label=channel, marker=marker, ms=3
        )
    axes.set(xlabel=_label(axis.name, axis.unit), ylabel=_label("value", table.unit))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)


def _draw_panels(figure, table: Table) -> None:
    """One panel per channel, for channels with units of their own."""
    axis = table.axes[0]
    units = [unit.strip() for unit in table.unit.split(",")]
    panels = figure.subplots(1, len(table.channels))
    for i, (panel, channel, unit) in enumerate(zip(panels, table.channels, units, strict=True)):
        panel.plot(axis.values, table.values[:, i], color=_OTHER_COLOURS[i])
        panel.set(xlabel=_label(axis.name, axis.unit), title=_label(channel, unit))
        panel.locator_params(nbins=4)
        panel.grid(alpha=0.3)


def _draw_image(figure, table: Table) -> None:
    rows, columns = table.axes
    image, lines = figure.subplots(1, 2)
    image.imshow(
        np.clip(table.values, 0, 1),
        extent=(columns.values[0], columns.values[-1], rows.values[0], rows.values[-1]),
        origin="lower",
        aspect="auto",
    )
    image.set(xlabel=_label(columns.name, columns.unit), ylabel=_label(rows.name, rows.unit))
    _draw_rows(lines, table, rows, columns)


def _draw_rows(axes, table: Table, rows: Axis, columns: Axis) -> None:
    for row, style in ((0, ":"), (len(rows.values) // 4, "--"), (-1, "-")):
        for i, channel in enumerate(table.channels):
            axes.plot(columns.values, table.values[row, :, i], style, color=_colour(channel, i), lw=1.2)
        axes.plot([], [], style, color="#555555", label=f"{rows.values[row]:.3g}")
    axes.set(xlabel=_label(columns.name, columns.unit))
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, title=_label(rows.name, rows.unit), fontsize=9, title_fontsize=9)


def _draw_materials(figure, table: Table) -> None:
    names = table.parameters["materials"]
    panels = figure.subplots(1, len(table.parameters["columns"]), sharey=True)
    for j, (panel, column) in enumerate(zip(panels, table.parameters["columns"], strict=True)):
        for i, channel in enumerate(table.channels):
            values = table.values[:, j, i]
            panel.plot(values, np.arange(len(names)), "o", color=_colour(channel, i), ms=4)
        panel.set(title=column.replace("_mm", " [mm]"))
        panel.locator_params(axis="x", nbins=4)
        panel.grid(alpha=0.3)
    every = -(-len(names) // 24)  # more names than that overlap
    panels[0].set_yticks(np.arange(len(names))[::every], names[::every], fontsize=9)
    panels[0].invert_yaxis()
