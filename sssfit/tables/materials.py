"""The parameters of a set of materials as one table, for an engine's profile buffer."""

from collections.abc import Sequence

import numpy as np

from sssfit.profiles.materials import Material
from sssfit.tables.table import Axis, Table

PARAMETERS = ("albedo", "dmfp_mm", "d_mm")


def materials(entries: Sequence[Material]) -> Table:
    """Albedo, diffuse mean free path and shape parameter of each material and channel.

    Args:
        entries: at least one material.

    Returns:
        2-D table: a row per material in the given order, columns albedo (unit 1), dmfp (mm) and d (mm),
        channels R, G, B. `parameters["materials"]` has the rows' names. A material that absorbs nothing
        in a channel has an infinite path there.

    Raises:
        ValueError: there is no material.

    Source: Xie 2021, Eq 2.44-2.47 and table C.1, computed from the coefficients.

    Example:
        >>> one = np.ones(3)
        >>> materials([Material("Wax", 0.8 * one, 8.38 * one, one)]).values[0, :, 0]
        array([0.8 , 8.38, 1.  ])
    """
    if not entries:
        raise ValueError("materials must hold at least one material")
    return Table(
        name="materials",
        description="Parameters of Burley's profile for each material: albedo, dmfp and d.",
        axes=(
            Axis("material", "1", np.arange(len(entries), dtype=np.float64)),
            Axis("parameter", "1", np.arange(len(PARAMETERS), dtype=np.float64)),
        ),
        channels=("R", "G", "B"),
        values=np.stack([np.stack([m.albedo, m.dmfp, m.d]) for m in entries]),
        unit="1, mm, mm",
        parameters={"materials": [m.name for m in entries], "columns": list(PARAMETERS)},
    )
