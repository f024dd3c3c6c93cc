"""What the papers print about tables, beside ours; shown by `sssfit reproduce`."""

from collections.abc import Iterator

import jax
import numpy as np

from sssfit.profiles import burley
from sssfit.reproduction import Row
from sssfit.tables import curvature, kernel

_SOURCE = "Web article, section 4-1"
#: Of the article's check: d = 1 / S in mm, radius in mm, and angle to the light.
_D, _RADIUS, _ANGLE = 0.7568628, 3.0, np.pi / 4


def rows() -> Iterator[Row]:
    """The rows of this topic, each computed when it is asked for.

    Returns:
        Both integrals of pre-integrated skin, each by the article's two ways, and a kernel's range.

    Example:
        >>> row = next(rows())
        >>> row.printed, round(row.ours, 9)
        ('0.563473', 0.563473121)
    """
    ratio = curvature.evaluate([1 / _RADIUS], [np.cos(_ANGLE)], np.full(3, _D), average="great_circle")[
        0, 0, 0
    ]
    with jax.enable_x64(True):
        disc = float(burley.cdf(2 * _RADIUS, _D))
    quantity = "D(pi / 4, 3), {}"
    yield Row(_SOURCE, quantity.format("numerator polar"), "0.563473", float(ratio) * disc)
    numerator, denominator = _ring()
    yield Row(_SOURCE, quantity.format("numerator ring"), "0.563473", numerator)
    yield Row(_SOURCE, quantity.format("denominator polar"), "0.946522", disc)
    yield Row(_SOURCE, quantity.format("denominator ring"), "0.946522", denominator)
    offsets = kernel.falloff_kernel_table(num_taps=25).axes[0].values
    yield Row("Web article, section 4-2", "range of the separable kernel, mm", "6", float(np.ptp(offsets)))


def _ring() -> tuple[float, float]:
    """Both integrals over the angle, by the table's own quadrature before it divides one by the other."""
    cosine = np.array([np.cos(_ANGLE)])
    edges = curvature._panel_edges(cosine)
    angles, mass = curvature._kernel(edges, np.array([_D / _RADIUS]), "chord", "great_circle")
    light = curvature._mean_clamped_cosine(cosine, angles, "great_circle")
    return float(np.sum(light * mass[:, 0])), float(np.sum(mass))
