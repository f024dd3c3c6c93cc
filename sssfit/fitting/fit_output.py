"""What a fit leaves for others: numbers for JSON, its curve as CSV, its material, and its constants.

`fit_table` tabulates its profile, `fit_plot` draws its picture, and `tables.formats.shader_constants` writes
its constants for shaders.
"""

import dataclasses
import math
import re
from typing import Any

import numpy as np

from sssfit.files.arrays import csv_bytes
from sssfit.fitting._posterior_result import Posterior
from sssfit.fitting.intervals import Estimate
from sssfit.fitting.measured import Fit
from sssfit.fitting.profile_model import DERIVED_UNITS, Model
from sssfit.profiles.materials import CHANNELS


def summary(fit: Fit) -> dict[str, Any]:
    """The numbers of a fit as values that JSON holds; None for what is infinite or not defined.

    Args:
        fit: as `measured.fit` returns it.

    Returns:
        model, response, parameters (each with value, standard_error, interval_68, interval_95, unit,
        determined and derived), correlation, converged, chi2_per_dof, dof, aicc, disagreement, status, notes.

    Example:
        >>> from sssfit.fitting import measured
        >>> found = measured.fit([1.0, 2.0, 3.0], [0.2, 0.1, 0.02], sigma=0.01)
        >>> summary(found)["parameters"]["d"]["unit"]
        'mm'
    """
    found = {
        "model": fit.model,
        "response": fit.response,
        "parameters": {
            name: _estimate(estimate) | {"derived": name in fit.derived}
            for name, estimate in fit.parameters.items()
        },
        "correlation": {"names": list(fit.names), "matrix": fit.correlation.tolist()},
        "converged": bool(fit.converged),
        "chi2_per_dof": fit.chi2_per_dof,
        "dof": int(fit.dof),
        "aicc": fit.aicc,
        "disagreement": fit.disagreement,
        "status": fit.status,
        "notes": list(fit.notes),
    }
    return finite(found)


def compared(fit: Fit) -> dict[str, Any]:
    """What is told of each of several fits.

    Args:
        fit: as `measured.fit` returns it.

    Returns:
        model, aicc, chi2_per_dof, parameters (how many are fitted) and converged, as in `summary`.

    Example:
        >>> from sssfit.fitting import measured
        >>> found = measured.fit([1.0, 2.0, 3.0], [0.2, 0.1, 0.02], sigma=0.01)
        >>> compared(found)["parameters"]
        2
    """
    found = {name: getattr(fit, name) for name in ("model", "aicc", "chi2_per_dof", "converged")}
    return finite(found | {"parameters": len(fit.names)})


def posterior_summary(posterior: Posterior) -> dict[str, Any]:
    """The numbers of a posterior as values that JSON holds.

    Args:
        posterior: as `posterior.sample` returns it.

    Returns:
        parameters (each with all of its `Summary`), prior, moves, walkers, steps, burn_in, seed,
        acceptance_fraction, autocorrelation and notes.

    Raises:
        NotConverged: the chain is too short.

    Example:
        >>> from sssfit.fitting.posterior import sample
        >>> drawn = sample([1.0, 2.0, 3.0], [0.2, 0.1, 0.02], sigma=0.01, steps=4000)
        >>> posterior_summary(drawn)["walkers"]
        32
    """
    names = (
        "prior",
        "moves",
        "walkers",
        "steps",
        "burn_in",
        "seed",
        "acceptance_fraction",
        "autocorrelation",
    )
    found = {name: getattr(posterior, name) for name in names} | {"notes": list(posterior.notes)}
    parameters = {name: dataclasses.asdict(one) for name, one in posterior.summary().items()}
    return finite(found | {"parameters": parameters})


def finite(value: Any) -> Any:
    """The same nested value with None for every number that is infinite or NaN, for which JSON has no word.

    Args:
        value: dicts, lists and tuples of anything.

    Example:
        >>> finite({"interval": (0.5, float("inf"))})
        {'interval': [0.5, None]}
    """
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return finite(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _estimate(estimate: Estimate) -> dict[str, Any]:
    return {
        "value": estimate.value,
        "standard_error": estimate.standard_error,
        "interval_68": estimate.interval_68,
        "interval_95": estimate.interval_95,
        "unit": estimate.unit,
        "determined": bool(estimate.determined),
    }


def curve_csv(fit: Fit) -> bytes:
    """The curves as CSV: distance, data, fit, its standard error and what is left over.

    Args:
        fit: as `measured.fit` returns it.

    Returns:
        Columns r_mm, and data, fitted, band and residual for each channel.

    Example:
        >>> from sssfit.fitting import measured
        >>> found = measured.fit([1.0, 2.0, 3.0], [0.2, 0.1, 0.02], sigma=0.01)
        >>> curve_csv(found).splitlines()[0]
        b'r_mm,data,fitted,band,residual'
    """
    parts = {"data": fit.values, "fitted": fit.fitted, "band": fit.band, "residual": fit.values - fit.fitted}
    columns = {"r_mm": fit.r}
    for i, channel in enumerate(fit.channels):
        columns |= {_name(what, channel): array[:, i] for what, array in parts.items()}
    return csv_bytes(columns)


def materials_csv(fit: Fit, name: str) -> tuple[bytes | None, str]:
    """Burley's albedo and dmfp as a file that `sssfit tables` takes; one curve is written to all channels.

    Args:
        fit: as `measured.fit` returns it.
        name: what the material is called; what a material may not be called is replaced.

    Returns:
        The file, and "", or None and a sentence that says why there is none.

    Example:
        >>> from sssfit.fitting import measured
        >>> found = measured.fit([1.0, 2.0, 3.0, 4.0], [0.03, 0.0105, 0.0049, 0.0026], sigma=1e-4)
        >>> data, reason = materials_csv(found, "wax")
        >>> reason, data.splitlines()[0][:28]
        ('', b'material,unit,albedo_r,albed')
    """
    if fit.model != "burley":
        return None, f"there is no materials.csv: {fit.model} has no albedo and dmfp of Burley's"
    if len(fit.channels) not in (1, 3):
        return None, f"there is no materials.csv: a material has 1 or 3 channels, not {len(fit.channels)}"
    wanted = fit.channels * 3 if len(fit.channels) == 1 else fit.channels
    columns: dict[str, list[Any]] = {"material": [material_name(name)], "unit": ["mm"]}
    for what in ("albedo", "dmfp"):
        for channel, ours in zip(wanted, CHANNELS, strict=True):
            estimate, label = _lookup(fit, what, channel)
            if what == "albedo" and estimate.value > 1:
                return None, f"there is no materials.csv: {label} is {estimate.value:.6g}, above 1"
            if not (estimate.determined and math.isfinite(estimate.value)):
                return None, f"there is no materials.csv: {label} is not determined"
            columns[f"{what}_{ours}"] = [estimate.value]
    return csv_bytes(columns), ""


def material_name(name: str) -> str:
    """The nearest name that a material may have.

    Args:
        name: any.

    Example:
        >>> material_name("2024 wax (red).csv")
        'material_2024_wax_red_csv'
    """
    plain = re.sub(r"[^a-zA-Z0-9]+", "_", name).strip("_")[:50].strip("_")
    return plain if re.match("[a-zA-Z]", plain) else f"material_{plain}".strip("_")


def constants(fit: Fit, model: Model) -> dict[str, np.ndarray]:
    """What a shader needs of a fit: each parameter and what follows from it, by name and unit.

    Args:
        fit: as `measured.fit` returns it.
        model: the profile that was fitted.

    Returns:
        By names such as d_mm, shape (1, channels); numbered ones are one array, such as weight of shape
        (K, channels).

    Example:
        >>> from sssfit.fitting import measured, profile_models
        >>> found = measured.fit([1.0, 2.0, 3.0], [0.2, 0.1, 0.02], sigma=0.01)
        >>> list(constants(found, profile_models.Burley()))
        ['albedo', 'd_mm', 'dmfp_mm']
    """
    stems = {parameter.name: parameter.stem for parameter in model.parameters}
    derived = (name for name in DERIVED_UNITS if name not in stems and _has(fit, name))
    rows: dict[str, list[list[float]]] = {}
    for name in (*stems, *derived):
        estimates = [_lookup(fit, name, channel)[0] for channel in fit.channels]
        unit = estimates[0].unit
        words = {"1": "", "mm": "_mm", "mm^2": "_mm_2", "1/mm": "_per_mm"}
        key = stems.get(name, name) + words[unit]
        rows.setdefault(key, []).append([estimate.value for estimate in estimates])
    return {name: np.array(row) for name, row in rows.items()}


def _name(what: str, channel: str) -> str:
    return f"{what}_{channel}" if channel else what


def _lookup(fit: Fit, what: str, channel: str) -> tuple[Estimate, str]:
    """A parameter of a channel, its own or one that is shared, and its name."""
    own = _name(what, channel)
    name = own if own in fit.parameters else what
    return fit.parameters[name], name


def _has(fit: Fit, what: str) -> bool:
    return all(_name(what, c) in fit.parameters or what in fit.parameters for c in fit.channels)
