"""What the papers print about fits and the inverse cdf, beside ours; shown by `sssfit reproduce`.

The error of 1.87 % that stands beside c is one of a rendered image and has no row.
"""

import math
from collections.abc import Callable, Iterator

import jax
import numpy as np

from sssfit.fitting import inverse_cdf as fits
from sssfit.fitting import separable_to_burley
from sssfit.reproduction import Row
from sssfit.sampling import inverse_cdf

#: Unreal's default albedo and diffuse mean free path, red, green, blue.
UNREAL_DEFAULTS = (("0.91058", "2.229"), ("0.338275", "0.1983"), ("0.2718", "0.1607"))


def rows() -> Iterator[Row]:
    """The rows of this topic, each computed when it is asked for.

    Returns:
        The constant c, the closed form of the inverse cdf, and the separable kernel's defaults.

    Example:
        >>> row = next(rows())
        >>> row.printed, round(row.ours, 6)
        ('2.5715', 2.5715)
    """
    yield Row(
        "Xie et al. 2020, Eq 21", "c of least mean squared cdf(g(xi | c)) - xi", "2.5715", fits.fit_c().c
    )
    yield from _closed_form()
    yield from _separable()


def _closed_form() -> Iterator[Row]:
    """The printed formulas, evaluated; one of them draws from the right distribution in reverse order."""
    swapped, base = "xi stands where 1 - xi belongs", "log_2 stands where ln belongs"
    for xi in (0.1, 0.5, 0.9):
        reason = "xi and 1 - xi are the same here" if xi == 0.5 else swapped
        yield _radius("Xie 2021, Eq 5.4", xi, _printed(xi), xi != 0.5, reason)
    for xi in (0.1, 0.9):
        yield _radius("Web article, section 4-3-1", xi, _printed(1 - xi, math.log2), True, base)


def _printed(u: float, logarithm: Callable[[float], float] = math.log) -> float:
    g = 1 + 4 * u * (2 * u + math.sqrt(1 + 4 * u * u))
    return 3 * logarithm((1 + g ** (-1 / 3) + g ** (1 / 3)) / (4 * u))


def _radius(source: str, xi: float, printed: float, differs: bool, reason: str) -> Row:
    with jax.enable_x64(True):
        ours = float(inverse_cdf.closed_form(np.float64(xi), 1.0))
    return Row(
        source, f"r / d at xi = {xi} (formula)", f"{printed:.5g}", ours, differs=differs, reason=reason
    )


def _separable() -> Iterator[Row]:
    """The reading whose d and, below its bound, albedo go with the falloff, as Unreal's do."""
    channels = zip("RGB", separable_to_burley.DEFAULT_FALLOFF, UNREAL_DEFAULTS, strict=True)
    for channel, falloff, (albedo, dmfp) in channels:
        fitted = separable_to_burley.fit(falloff, reading="as_coded")
        reason = "taken for the fit of Xie et al. 2020, Fig 16, whose range, grid and bounds are not said"
        for name, printed, ours in (("A", albedo, fitted.albedo), ("l, mm", dmfp, fitted.dmfp)):
            quantity = f"Unreal's {channel} for falloff {falloff}: {name}"
            yield Row("Web article, section 4-3-2", quantity, printed, ours, differs=True, reason=reason)
