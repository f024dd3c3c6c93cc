"""Draw docs/images/tables_overview.png: four of the tables, for Skin1.

Run from the repository root: python docs/scripts/tables_overview.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from sssfit.profiles import materials
from sssfit.tables import curvature, radius, shadow, transmittance

IMAGE = Path(__file__).resolve().parents[1] / "images" / "tables_overview.png"
COLOURS = ("#c8322d", "#2e8b3d", "#2b5fb3")


def lines(axes, table, title, xlabel, ylabel):
    colours = COLOURS if len(table.channels) == 3 else ("#333333",)
    for i, (channel, colour) in enumerate(zip(table.channels, colours, strict=True)):
        axes.plot(table.axes[0].values, table.values[:, i], color=colour, label=channel)
    axes.set(title=title, xlabel=xlabel, ylabel=ylabel)
    axes.grid(alpha=0.3)
    if len(table.channels) == 3:
        axes.legend(frameon=False)


def image(axes, table, title, xlabel, ylabel):
    rows, columns = (axis.values for axis in table.axes)
    axes.imshow(
        table.values, extent=(columns[0], columns[-1], rows[0], rows[-1]), origin="lower", aspect="auto"
    )
    axes.set(title=title, xlabel=xlabel, ylabel=ylabel)


def main():
    skin = materials.load(materials.shipped())["Skin1"]
    figure, axes = plt.subplots(2, 2, figsize=(9, 6.4), dpi=100, layout="constrained")
    lines(
        axes[0, 0],
        radius.radius(512),
        "radius (all materials)",
        "fourth root of 1 - xi",
        "radius / d, no unit",
    )
    table = transmittance.transmittance(skin.d, skin.albedo, 512)
    lines(axes[0, 1], table, "transmittance, Skin1", "thickness [mm]", "share that passes, no unit")
    table = curvature.curvature(skin.d, 61, 61)
    image(axes[1, 0], table, "curvature, Skin1", "N.L", "curvature 1/r [1/mm]")
    axes[1, 0].set_xticks([-1, -0.5, 0, 0.5, 1])
    table = shadow.shadow(skin.d, 61, 61)
    image(axes[1, 1], table, "shadow, Skin1", "shadow value s", "inverse width 1/w [1/mm]")
    figure.savefig(IMAGE, metadata={"Software": None})


if __name__ == "__main__":
    main()
