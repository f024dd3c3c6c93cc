"""Burley's parameters against the separable kernel's falloff, and polynomials for engines."""

import numpy as np

from sssfit.fitting import separable_to_burley
from sssfit.fitting.separable_to_burley import Objective, Reading
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET
from sssfit.tables.table import Axis, Table

CHANNELS = ("albedo", "d", "dmfp")

#: Degrees of the polynomials that may stand in for the table in a shader, each with its error.
DEGREES = (1, 2, 5, 9)


def falloff(
    num_entries: int = 256, objective: Objective = "difference", reading: Reading = "radial"
) -> Table:
    """Albedo, d and dmfp fitted to every falloff in (0, 1].

    The albedo is kept in [0, 1]. Where that bound does not act (always for the radial reading), d is
    proportional to phi = falloff + 0.001 and the albedo to phi^2 ("radial") or phi ("as_coded"): an
    engine can use the two constants under `parameters["law"]` in place of the table.

    Args:
        num_entries: at least 12; entry i belongs to falloff (i + 1) / num_entries.
        objective: as `separable_to_burley.fit`.
        reading: as `separable_to_burley.fit`.

    Returns:
        1-D table over the falloff, channels albedo (unit 1), d and dmfp (mm). `parameters` holds the
        law, and for each channel polynomials in the falloff of degrees 1, 2, 5 and 9 with their largest
        error over the table: the exact dmfp has degree 9 for "radial", 5 for "as_coded" below its bound.

    Raises:
        ValueError: fewer than twelve entries, an unknown option, or an objective that does not
            determine the parameters.

    Source: Xie et al. 2020, appendix A.1, Eq 25-27.

    Example:
        >>> falloff(12).values[-1].round(3)
        array([ 0.87 ,  0.895, 10.762])
    """
    if num_entries < 12:
        raise ValueError(f"num_entries must be at least 12, got {num_entries}")
    nodes = np.arange(1, num_entries + 1) / num_entries
    values = evaluate(nodes, objective, reading)
    return Table(
        name="falloff",
        description="Burley's albedo, shape d and diffuse mean free path for a separable falloff.",
        axes=(Axis("falloff", "1", nodes),),
        channels=CHANNELS,
        values=values,
        unit="1, mm, mm",
        parameters={
            "objective": objective,
            "reading": reading,
            "domain": list(separable_to_burley.DEFAULT_DOMAINS[objective]),
            "albedo_bounds": [0.0, 1.0],
            "law": _law(objective, reading),
            "polynomials": {
                name: [polynomial(nodes, values[:, i], degree) for degree in DEGREES]
                for i, name in enumerate(CHANNELS)
            },
        },
    )


def evaluate(falloffs: np.ndarray, objective: Objective, reading: Reading) -> np.ndarray:
    """The fits that the table of `falloff` samples.

    Args:
        falloffs: widths in (0, 1], shape (n,).
        objective: as `separable_to_burley.fit`.
        reading: as `separable_to_burley.fit`.

    Returns:
        albedo, d in mm, dmfp in mm; float64, shape (n, 3).

    Raises:
        ValueError: the parameters are not determined: the albedo runs into 0, or a fit fails.

    Source: as `falloff`.

    Example:
        >>> evaluate(np.array([0.37]), "difference", "radial").round(3)
        array([[0.12 , 0.332, 1.226]])
    """
    albedo, d, dmfp, converged = separable_to_burley.fit_many(falloffs, objective, reading=reading)
    if not converged.all() or np.any(albedo < 1e-6):
        raise ValueError(
            f"objective {objective!r} with reading {reading!r} does not determine the albedo for every "
            "falloff in (0, 1]; use objective 'difference'"
        )
    return np.stack([albedo, d, dmfp], axis=-1)


def polynomial(x: np.ndarray, y: np.ndarray, degree: int) -> dict[str, object]:
    """Least-squares polynomial of a curve, and how far it is off.

    Args:
        x: abscissae, shape (n,).
        y: values, shape (n,).
        degree: of the polynomial, below n.

    Returns:
        "degree", "coefficients", lowest power first, and "max_error" over x, in the unit of y.

    Example:
        >>> polynomial(np.linspace(0, 1, 9), np.linspace(0, 1, 9) ** 2, 1)["max_error"].__round__(4)
        0.1458
    """
    fitted = np.polynomial.Polynomial.fit(x, y, degree)
    return {
        "degree": degree,
        "coefficients": fitted.convert().coef.tolist(),
        "max_error": float(np.max(np.abs(fitted(x) - y))),
    }


def _law(objective: Objective, reading: Reading) -> dict[str, object]:
    """The constants of the exact scaling law, from the fit at phi = 1 with the albedo free."""
    free, unit = (0.0, np.inf), np.array([1 - FALLOFF_OFFSET])
    (albedo,), (d,), _, _ = separable_to_burley.fit_many(unit, objective, reading=reading, albedo_bounds=free)
    power = 2 if reading == "radial" else 1
    return {
        "albedo": f"{albedo:.9g} * (falloff + {FALLOFF_OFFSET})^{power}",
        "d": f"{d:.9g} mm * (falloff + {FALLOFF_OFFSET})",
        "albedo_factor": float(albedo),
        "albedo_power": power,
        "d_factor": float(d),
    }
