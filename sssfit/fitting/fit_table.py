"""The fitted profile as a table for engines, with standard errors."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.files.arrays import csv_bytes
from sssfit.fitting import _curve_problem, responses
from sssfit.fitting._curve_problem import Setup
from sssfit.fitting.measured import Fit
from sssfit.fitting.profile_model import Model

# Radii of a table, and the shares of the energy within the first and the last one.
_RADII = 128
_FIRST, _LAST = 1e-3, 1 - 1e-4
# A slope below this share of the value is 0 but for rounding.
_ROUNDING = 1e-12
# What a table holds of each radius, and the unit of each.
_COLUMNS = {"R": "per_mm_2", "cdf": "", "transmittance": ""}


def table_csv(fit: Fit, model: Model) -> bytes:
    """The fitted profile as a table for engines, with standard errors.

    Args:
        fit: as `measured.fit` returns it.
        model: the profile that was fitted.

    Returns:
        Columns r_mm; and for each channel R_per_mm_2; cdf, the share of the energy within r; transmittance,
        the share of uniform irradiance that passes a flat slab of thickness r; and, beside each, its standard
        error with the suffix _se: inf where the data do not determine it. 128 radii in equal ratios, from
        .1 % to 99.99 % of the energy.

    Example:
        >>> from sssfit.fitting import measured, profile_models
        >>> found = measured.fit([1.0, 2.0, 3.0], [0.2, 0.1, 0.02], sigma=0.01)
        >>> table_csv(found, profile_models.Burley()).splitlines()[0]
        b'r_mm,R_per_mm_2,R_se_per_mm_2,cdf,cdf_se,transmittance,transmittance_se'
    """
    layout, _ = _curve_problem.laid_out(model, fit.channels, _shared(fit, model))
    setup = Setup(model, _tabulated, "linear", layout)
    y = _curve_problem.in_logarithms(setup, np.array([fit.parameters[name].value for name in fit.names]))
    with jax.enable_x64(True):
        r = _radii(setup, y)
        stacked = np.tile(r, len(_COLUMNS))
        values, slopes = (np.asarray(a) for a in _curve_problem.linearized(setup, y, stacked))
    errors = _errors(values, slopes, fit.covariance)
    columns = {"r_mm": r}
    for i, channel in enumerate(fit.channels):
        for (what, unit), at in zip(_COLUMNS.items(), range(0, len(stacked), len(r)), strict=True):
            for suffix, array in (("", values), ("_se", errors)):
                name = "_".join(filter(None, (what, channel, suffix[1:], unit)))
                columns[name] = array[at : at + len(r), i]
    return csv_bytes(columns)


def _shared(fit: Fit, model: Model) -> tuple[str, ...]:
    if fit.channels == ("",):
        return ()
    return tuple(p.name for p in model.parameters if p.name in fit.names)


def _tabulated(model: Model, p: Array, r: Array) -> Array:
    """Profile, cdf and transmittance in the three parts of r."""
    r = jnp.reshape(r, (len(_COLUMNS), -1))
    beyond = model.beyond(p, r[2])
    # What leaves beyond a distance t from a point is what passes a slab of thickness t: the same integral.
    return jnp.concatenate(
        [responses.radial(model, p, r[0]), 1 - model.beyond(p, r[1]) / model.energy(p), beyond]
    )


def _radii(setup: Setup, y: np.ndarray) -> np.ndarray:
    p = np.asarray(_curve_problem.physical(setup, jnp.asarray(y), jnp.ones(())))
    each = [jnp.asarray(p[np.array(row)]) for row in setup.layout]
    reach = max(float(setup.model.reach(p)) for p in each)
    r = reach * np.geomspace(1e-7, 1, 2048)
    within = np.stack([1 - setup.model.beyond(p, r) / setup.model.energy(p) for p in each])
    first = r[np.argmax(np.any(within > _FIRST, axis=0))]
    last = r[np.argmax(np.all(within > _LAST, axis=0))]
    return np.geomspace(first, last, _RADII)


def _errors(values: np.ndarray, slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Standard errors of shape (m, channels), by linear propagation."""
    known = np.isfinite(np.diag(covariance))
    inner = slopes[..., known]
    errors = np.sqrt(np.einsum("mci,ij,mcj->mc", inner, covariance[np.ix_(known, known)], inner))
    matters = np.abs(slopes[..., ~known]) > _ROUNDING * np.abs(values)[..., None]
    return np.where(np.any(matters, axis=-1), np.inf, errors)
