"""What the papers print about profiles and materials, beside ours; shown by `sssfit reproduce`.

Constants that the papers choose have no row. Where a formula is printed and no number, the "printed" number
is the formula's value, and the quantity says "(formula)"; of an equation it is the sides' difference, 0.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import numpy as np

from sssfit.files import csv_rows
from sssfit.files.reading import read_bytes
from sssfit.profiles import burley, dipole, gaussian_sum, materials
from sssfit.reproduction import Row

_TABLE = "Xie 2021, Table C.1"


class Entry(NamedTuple):
    """A line of Table C.1: what it prints in red, green and blue."""

    dmfp: tuple[str, ...]
    albedo: tuple[str, str, str]


TABLE_C1 = {
    "Apple": Entry(("6.97", "6.40", "1.92"), ("0.85", "0.84", "0.53")),
    "Chicken1": Entry(("12.12", "4.37", "2.23"), ("0.31", "0.15", "0.10")),
    "Chicken2": Entry(("9.84", "3.76", "2.16"), ("0.32", "0.16", "0.10")),
    "Cream": Entry(("15.03", "4.67", "2.57"), ("0.98", "0.90", "0.73")),
    "Ketchup": Entry(("5.33", "0.80", "0.56"), ("0.16", "0.01", "0.00")),
    "Marble": Entry(("8.51", "5.57", "3.96"), ("0.83", "0.79", "0.75")),
    "Potato": Entry(("14.29", "7.27", "2.31"), ("0.77", "0.62", "0.21")),
    "Skimmilk": Entry(("18.44", "10.45", "3.51"), ("0.81", "0.81", "0.69")),
    "Skin1": Entry(("3.75", "1.47", "0.79"), ("0.44", "0.22", "0.13")),
    "Skin2": Entry(("4.85", "1.11", "0.62"), ("0.63", "0.44", "0.34")),
    "Spectralon": Entry((), ("1.00", "1.00", "1.00")),
    "Wholemilk": Entry(("10.90", "6.58", "2.54"), ("0.91", "0.88", "0.76")),
}


class Misprint(NamedTuple):
    """How a mean free path came out wrong: the two coefficients that it was computed from."""

    scattering_is_cut: bool = True
    absorption_of: str = ""


MISPRINTS = {
    ("Chicken1", "b"): Misprint(),
    ("Chicken2", "b"): Misprint(),
    ("Cream", "b"): Misprint(),
    ("Ketchup", "b"): Misprint(),
    ("Potato", "b"): Misprint(),
    ("Skin1", "b"): Misprint(),
    ("Skin2", "g"): Misprint(scattering_is_cut=False, absorption_of="Skin1"),
    ("Skin2", "b"): Misprint(absorption_of="Skin1"),
    ("Wholemilk", "b"): Misprint(),
}

#: Reflectances that are not those of the printed coefficients, and whether rounding of those explains it.
REFLECTANCES_OFF = {
    ("Chicken1", "g"): True,
    ("Chicken1", "b"): False,
    ("Chicken2", "b"): True,
    ("Cream", "b"): True,
    ("Potato", "r"): True,
    ("Potato", "g"): False,
    ("Skimmilk", "b"): False,
    ("Skin1", "g"): True,
    ("Skin2", "r"): True,
    ("Skin2", "g"): False,
}


def rows() -> Iterator[Row]:
    """The rows of this topic, each computed when it is asked for.

    Returns:
        Scalings and integrals of Burley's profile, the dipole's formulas, and the table of materials.

    Example:
        >>> next(rows()).verdict
        'reproduced'
    """
    yield from _scalings()
    yield from _integrals()
    yield from _gaussians()
    yield from _fresnel()
    yield from _transport()
    yield from _mean_free_paths()
    yield from _reflectances()


def _float64(function: Callable, *arguments) -> float:
    with jax.enable_x64(True):
        return float(function(*arguments))


def _formula(value: float) -> str:
    """The value of a printed formula, to more digits than any misprint needs."""
    return f"{value:.5g}"


def _scalings() -> Iterator[Row]:
    """Each constant of the three fits, from the function alone."""
    source = "Xie et al. 2020, Eq 5"
    fits = (
        ("searchlight", 0.8, 3, 1, "1.85", "7"),
        ("diffuse", 0.8, 2, 1, "1.9", "3.5"),
        ("dmfp", 0.33, 4, 0, "3.5", "100"),
    )
    for configuration, middle, power, slope, constant, factor in fits:
        least = _float64(burley.scaling, middle, configuration) + slope * middle
        yield Row(source, f"constant of s(A), {configuration}", constant, least)
        rise = _float64(burley.scaling, 0.0, configuration) - least
        yield Row(source, f"factor of |A - {middle}|^{power}, {configuration}", factor, rise / middle**power)
    d = 0.071144
    dmfp = _float64(burley.dmfp_from_shape, d, 0.9)
    yield Row(
        "Xie et al. 2020, Fig 5",
        f"l at A = 0.9 and d = {d} mm, mm",
        "1.0",
        dmfp,
        reason="the caption gives no d",
    )


def _integral(function: Callable[[np.ndarray], np.ndarray], end: float) -> float:
    """From 0 to an end, by Gauss-Legendre panels that are dense at 0."""
    edges = np.concatenate([[0.0], np.geomspace(1e-3, end, 100)])
    nodes, weights = np.polynomial.legendre.leggauss(16)
    half = np.diff(edges)[:, None] / 2
    return float(np.sum(half * weights * function(edges[:-1, None] + half * (nodes + 1))))


def _integrals() -> Iterator[Row]:
    """The profile over discs and over a slab's far side, d = 1 mm and A = 0.7; its tail ends at 130 mm."""

    def around(r, height=0.0):
        with jax.enable_x64(True):
            return 2 * np.pi * r * np.asarray(burley.profile(np.hypot(r, height), 1.0, 0.7))

    whole = _integral(around, 130.0)
    quantity = "integral of R over the plane / A - 1, in 1e-12"
    yield Row("Xie et al. 2020, Eq 4", quantity, "0", (whole / 0.7 - 1) * 1e12)
    discs = [_integral(around, r) / 0.7 - _float64(burley.cdf, r, 1.0) for r in (0.1, 1.0, 5.0, 20.0)]
    quantity = "integral of R over a disc / A - cdf, in 1e-12"
    yield Row("Xie and Olano 2021, section 5", quantity, "0", max(discs, key=abs) * 1e12)
    slabs = [
        _integral(lambda r, t=t: around(r, t), 130.0) - _float64(burley.transmittance, t, 1.0, 0.7)
        for t in (0.1, 0.5, 1.0, 3.0)
    ]
    quantity = "integral of R over a slab's far side - T, in 1e-12"
    yield Row("Web article, section 5-2", quantity, "0", max(slabs, key=abs) * 1e12)


def _gaussians() -> Iterator[Row]:
    source, number = "Web article, section 4-2", float(len(gaussian_sum.SKIN_VARIANCES))
    yield Row(source, "Gaussians of d'Eon's skin", "6", number)
    yield Row(source, "their one-dimensional blurs", "12", 2 * number)


def _printed_fresnel(eta: float) -> float:
    if eta < 1:
        return -0.4399 + 0.7099 / eta - 0.3319 / eta**2 + 0.0636 / eta**3
    return -1.4399 / eta**2 + 0.7099 / eta + 0.6681 + 0.0636 / eta**3


def _fresnel() -> Iterator[Row]:
    for text, eta in (("1 / 1.5", 1 / 1.5), ("1.3", 1.3), ("1.5", 1.5)):
        yield Row(
            "Xie 2021, Eq 2.42",
            f"F_dr at eta = {text} (formula)",
            _formula(_printed_fresnel(eta)),
            _float64(dipole.fresnel_diffuse_reflectance, eta),
            differs=eta > 1,
            reason="the last term is 0.0636 eta, not 0.0636 / eta^3" if eta > 1 else "",
        )


def _coefficients() -> dict[str, csv_rows.Row]:
    """The shipped materials' rows, for their coefficients."""
    file = materials.shipped()
    return {row.cells["material"]: row for row in csv_rows.parse(read_bytes(file), file.name)[1]}


def _of(row: csv_rows.Row, channel: str) -> tuple[float, float]:
    return row.number(f"sigma_s_reduced_{channel}"), row.number(f"sigma_a_{channel}")


def _transport() -> Iterator[Row]:
    """The dipole's sign, and the coefficient beside it that the table of materials does not follow."""
    given = _coefficients()
    (scattering, absorption), eta = _of(given["Marble"], "g"), given["Marble"].number("eta")
    extinction = scattering + absorption
    fresnel = _float64(dipole.fresnel_diffuse_reflectance, eta)
    depths = 1, 1 + 4 / 3 * (1 + fresnel) / (1 - fresnel)
    real, virtual = (math.exp(-math.sqrt(3 * absorption / extinction) * depth) for depth in depths)
    yield Row(
        "Xie 2021, Eq 2.41",
        "diffuse reflectance of Marble G, R_d over the plane (formula)",
        _formula(scattering / extinction / 2 * (real - virtual)),
        _float64(dipole.diffuse_reflectance, scattering, absorption, eta),
        differs=True,
        reason="the virtual source is added, since its depth is positive",
    )
    scattering, absorption = _of(given["Ketchup"], "b")
    yield Row(
        "Xie 2021, below Eq 2.41",
        "l_d of Ketchup B by the dipole's sigma_tr, mm (formula)",
        _formula(1 / math.sqrt(3 * absorption * (scattering + absorption))),
        _float64(burley.dmfp_from_coefficients, scattering, absorption),
        differs=True,
        reason="Table C.1 follows the other definition of sigma_tr, Eq 2.46",
    )


def _mean_free_paths() -> Iterator[Row]:
    given, ours = _coefficients(), materials.load(materials.shipped())
    for name, entry in TABLE_C1.items():
        for channel, text, dmfp in zip(materials.CHANNELS, entry.dmfp, ours[name].dmfp, strict=False):
            quantity = f"l_d of {name} {channel.upper()}, mm"
            misprint = MISPRINTS.get((name, channel))
            if misprint is None:
                yield Row(_TABLE, quantity, text, float(dmfp))
                continue
            scattering, absorption = _of(given[name], channel)
            causes = []
            if misprint.scattering_is_cut:
                # In tenths the coefficients are whole numbers to rounding, or clearly none.
                scattering = math.floor(10 * scattering + 1e-9) / 10
                causes.append(f"sigma_s' cut to {scattering}")
            if misprint.absorption_of:
                absorption = _of(given[misprint.absorption_of], channel)[1]
                causes.append(f"{misprint.absorption_of}'s sigma_a {absorption}")
            cause = " and ".join(causes)
            wrong = _float64(burley.dmfp_from_coefficients, scattering, absorption)
            reason = f"{cause} gives {wrong:.4g}"
            yield Row(_TABLE, quantity, text, float(dmfp), differs=True, reason=reason)
            yield Row(_TABLE, f"{quantity}, with {cause}", text, wrong, reason="the cause of the misprint")


def _reflectances() -> Iterator[Row]:
    given, ours = _coefficients(), materials.load(materials.shipped())
    for name, entry in TABLE_C1.items():
        for channel, text, albedo in zip(materials.CHANNELS, entry.albedo, ours[name].albedo, strict=True):
            explained, reason = REFLECTANCES_OFF.get((name, channel)), ""
            if explained is not None:
                low, high = _allowed(given[name], channel)
                known = "" if explained else "no cause found: "
                reason = f"{known}the coefficients' rounding allows {low:.4f} to {high:.4f}"
            quantity = f"diffuse reflectance of {name} {channel.upper()}"
            yield Row(_TABLE, quantity, text, float(albedo), differs=explained is not None, reason=reason)


def _allowed(row: csv_rows.Row, channel: str) -> tuple[float, float]:
    """Reflectances of coefficients that round to those given: more with scattering, less with absorption."""
    scattering, absorption = _of(row, channel)
    half, other_half = (_half_unit(row.cells[f"{of}_{channel}"]) for of in ("sigma_s_reduced", "sigma_a"))
    eta = row.number("eta")
    return (
        _float64(dipole.diffuse_reflectance, scattering - half, absorption + other_half, eta),
        _float64(dipole.diffuse_reflectance, scattering + half, absorption - other_half, eta),
    )


def _half_unit(text: str) -> float:
    return Row("", "", text, 0.0).rounding
