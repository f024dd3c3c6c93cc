"""Materials from CSV files: measured coefficients or artist's parameters to (albedo, dmfp, d).

A file has one row per material and a header. Two sets of columns are known:

- measured: material, unit (1/mm, 1/cm or 1/m), sigma_s_reduced_r, _g, _b, sigma_a_r, _g, _b, eta;
- artist's: material, unit (mm, cm or m), albedo_r, _g, _b, dmfp_r, _g, _b.

Other columns, such as source, are ignored. `data/materials.csv` holds Jensen's measurements.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from sssfit.files import csv_rows
from sssfit.files.csv_rows import Row
from sssfit.files.errors import FileError
from sssfit.files.reading import read_bytes
from sssfit.profiles import burley, dipole

CHANNELS = ("r", "g", "b")

_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
_LENGTHS = (1e-9, 1e9)
_MEASURED = [f"{name}_{c}" for name in ("sigma_s_reduced", "sigma_a") for c in CHANNELS] + ["eta"]
_ARTIST = [f"{name}_{c}" for name in ("albedo", "dmfp") for c in CHANNELS]


@dataclass(frozen=True)
class Material:
    """What Burley's profile needs of a material, per channel (red, green, blue), in float64.

    Attributes:
        name: as in the file.
        albedo: diffuse reflectance, shape (3,).
        dmfp: diffuse mean free path, mm, shape (3,); inf where nothing absorbs, 0 for the delta.
        d: shape parameter, mm, shape (3,); dmfp / scaling(albedo, "dmfp").

    Example:
        >>> load(shipped())["Marble"].dmfp.round(3)
        array([8.513, 5.571, 3.956])
    """

    name: str
    albedo: np.ndarray
    dmfp: np.ndarray
    d: np.ndarray


def shipped() -> Path:
    """Path of the measured materials that come with the package.

    Source: Jensen et al. 2001, figure 5; see data/SOURCES.md.

    Example:
        >>> shipped().name
        'materials.csv'
    """
    package = Path(__file__).resolve().parents[1]
    # A wheel carries data/ inside the package; a source tree keeps it beside.
    installed = package / "data" / "materials.csv"
    return installed if installed.exists() else package.parent / "data" / "materials.csv"


def load(path: str | Path) -> dict[str, Material]:
    """Read a CSV file of materials.

    Args:
        path: the file, in one of the two forms above.

    Returns:
        Materials by name, in the file's order.

    Raises:
        FileError: names file, row and remedy for a missing or repeated column, an unknown unit, text
            where a number belongs, a negative coefficient or path, an albedo outside [0, 1], a
            refractive index outside [0.3, 3.5], a path that is neither 0 nor from 1e-9 to 1e9 mm, or a
            name that is missing, repeated or unfit for a folder.

    Source: dmfp from Xie 2021, Eq 2.45-2.47; albedo from the dipole, Jensen et al. 2001, section 2.4;
    d from Christensen and Burley 2015, Eq 8.

    Example:
        >>> load(shipped())["Skin1"].albedo.round(2)
        array([0.44, 0.23, 0.13])
    """
    return parse(read_bytes(path), Path(path).name)


def parse(data: bytes, file: str) -> dict[str, Material]:
    """Materials from the bytes of a CSV file; `load` for a file already read.

    Args:
        data: the file's bytes.
        file: its name, for messages.

    Raises:
        FileError: as `load`.

    Example:
        >>> text = b"material,unit,albedo_r,albedo_g,albedo_b,dmfp_r,dmfp_g,dmfp_b\\nWax,cm,1,1,1,1,1,0\\n"
        >>> parse(text, "wax.csv")["Wax"].dmfp
        array([10., 10.,  0.])
    """
    columns, rows = csv_rows.parse(data, file)
    derive = _artist if any(c in columns for c in _ARTIST) else _measured
    needed = ["material", "unit", *(_ARTIST if derive is _artist else _MEASURED)]
    missing = [c for c in needed if c not in columns]
    if missing:
        problem = f"column {missing[0]!r} is missing"
        raise FileError(file, "row 1", problem, f"the columns are {', '.join(needed)}")
    materials: dict[str, Material] = {}
    for row in rows:
        name = _name(row, materials)
        albedo, dmfp = derive(row)
        _check_lengths(row, dmfp)
        with jax.enable_x64(True):
            d = np.asarray(burley.shape_from_dmfp(dmfp, albedo))
        materials[name] = Material(name, albedo, dmfp, d)
    return materials


def _name(row: Row, earlier: dict[str, Material]) -> str:
    name = row.cells["material"]
    # A folder, and part of a variable's name in shader text.
    if not re.fullmatch(r"[a-zA-Z]([\w -]{0,62}[a-zA-Z0-9])?", name, re.ASCII):
        problem = f"the material name {name!r} cannot name a folder and a variable"
        remedy = "use up to 64 letters a to z, digits, spaces, '_' and '-', beginning with a letter"
        raise row.fault(problem, f"{remedy} and ending with a letter or digit")
    # Neither file systems nor shader text tell all names apart: "Wax 1" and "wax_1" are one.
    if _key(name) in map(_key, earlier):
        raise row.fault(f"the material {name!r} stands there twice", "give each row its own name")
    return name


def _key(name: str) -> str:
    return re.sub(r"[ _-]+", "_", name).lower()


def _measured(row: Row) -> tuple[np.ndarray, np.ndarray]:
    lengths = {f"1/{unit}": 1 / size for unit, size in _MILLIMETRES.items()}
    per_millimetre = _unit(row, lengths)
    sigma_s_reduced = _channels(row, "sigma_s_reduced", "a coefficient") * per_millimetre
    sigma_a = _channels(row, "sigma_a", "a coefficient") * per_millimetre
    eta = row.number("eta")
    low, high = dipole.ETA_RANGE
    if not low <= eta <= high:
        remedy = f"write a number from {low:g} to {high:g}, such as 1.3"
        raise row.fault(f"the refractive index eta is {eta:g}", remedy)
    with jax.enable_x64(True):
        albedo = dipole.diffuse_reflectance(sigma_s_reduced, sigma_a, eta)
        dmfp = burley.dmfp_from_coefficients(sigma_s_reduced, sigma_a)
        return np.asarray(albedo), np.asarray(dmfp)


def _artist(row: Row) -> tuple[np.ndarray, np.ndarray]:
    millimetres = _unit(row, _MILLIMETRES)
    albedo = _channels(row, "albedo", "an albedo")
    for channel, value in zip(CHANNELS, albedo, strict=True):
        if value > 1:
            raise row.fault(f"albedo_{channel} is {value:g}", "an albedo lies in [0, 1]")
    return albedo, _channels(row, "dmfp", "a path length") * millimetres


def _check_lengths(row: Row, dmfp: np.ndarray) -> None:
    """Refuse paths that no float32 table holds; infinite ones are a medium without absorption."""
    for channel, value in zip(CHANNELS, dmfp, strict=True):
        if not (value in (0, np.inf) or _LENGTHS[0] <= value <= _LENGTHS[1]):
            problem = f"the diffuse mean free path of channel {channel} is {value:g} mm"
            raise row.fault(problem, f"it must be 0 or from {_LENGTHS[0]:g} to {_LENGTHS[1]:g} mm")


def _unit(row: Row, known: dict[str, float]) -> float:
    unit = row.cells["unit"]
    if unit not in known:
        raise row.fault(f"the unit {unit!r} is not known", f"use one of {', '.join(known)}")
    return known[unit]


def _channels(row: Row, name: str, what: str) -> np.ndarray:
    values = np.array([row.number(f"{name}_{channel}") for channel in CHANNELS])
    for channel, value in zip(CHANNELS, values, strict=True):
        if value < 0:
            raise row.fault(f"{name}_{channel} is {value:g}", f"{what} cannot be negative")
        if value > 1e12:
            raise row.fault(f"{name}_{channel} is {value:g}", f"{what} cannot be that large")
    return values
