"""What a lookup table is: values on axes, with units and the parameters that made them."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Axis:
    """One axis of a table: entry ``i`` of the table belongs to ``values[i]``, in ``unit``.

    Example:
        >>> axis = Axis("thickness", "mm", np.linspace(0.0, 5.0, 3))
        >>> axis.values
        array([0. , 2.5, 5. ])
    """

    name: str
    unit: str
    values: np.ndarray


@dataclass(frozen=True)
class Table:
    """A lookup table in float64, before a file format rounds it.

    Attributes:
        name: what the table holds, a valid identifier ("transmittance").
        description: one sentence for a reader of the file.
        axes: one or two axes, slowest first (a 2-D table is an image: rows, then columns).
        channels: names of the entries along the last dimension of ``values``, at most four.
        values: float64, shape ``(*[len(a.values) for a in axes], len(channels))``.
        unit: unit of the values; "1" when they have none.
        parameters: what made the values, as JSON-compatible numbers, strings, lists and dicts.

    Example:
        >>> axis = Axis("thickness", "mm", np.array([0.0, 1.0]))
        >>> values = np.array([[1.0], [0.5]])
        >>> Table("t", "A demonstration.", (axis,), ("Y",), values, "1").values.shape
        (2, 1)
    """

    name: str
    description: str
    axes: tuple[Axis, ...]
    channels: tuple[str, ...]
    values: np.ndarray
    unit: str
    parameters: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        """Refuse values whose shape the axes and channels do not give."""
        expected = (*(len(axis.values) for axis in self.axes), len(self.channels))
        if self.values.shape != expected:
            raise ValueError(
                f"values of table {self.name!r} must have shape {expected} from its axes and "
                f"channels, got {self.values.shape}"
            )
