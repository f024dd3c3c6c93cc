"""Which profile suits a curve: Akaike's criterion, and how well each foretells points it has not seen."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from sssfit.fitting import _curve_data, measured, profile_models
from sssfit.fitting._curve_data import CurveData
from sssfit.fitting.measured import Fit
from sssfit.fitting.responses import Response


@dataclass(frozen=True)
class Candidate:
    """A model and how well it suits.

    Attributes:
        fit: of all points.
        aicc: Akaike's corrected criterion less that of the best candidate; 0 for the best, above 10 for one
            that the data speak against; inf with too few points for the criterion.
        cross_validation: root mean square of what a point misses of the fit to the other folds, in standard
            deviations of its noise where sigma is given, else over the root mean square of the weighted data.
    """

    fit: Fit
    aicc: float
    cross_validation: float


def compare(
    r: ArrayLike,
    values: ArrayLike,
    models: Sequence[str],
    *,
    folds: int = 5,
    sigma: ArrayLike | None = None,
    **options: Any,
) -> list[Candidate]:
    """Fit several models to the same curves and compare them.

    Args:
        r: as `measured.fit`, shape (m,).
        values: as `measured.fit`.
        models: names as `measured.fit` takes them, each once.
        folds: for the cross-validation, 2 to m. Point i belongs to fold i modulo this, so that each fold has
            near and far points.
        sigma: as `measured.fit`.
        options: the other arguments of `measured.fit`.

    Returns:
        Candidates, the best by Akaike's criterion first, and of those without one the best by
        cross-validation.

    Raises:
        ValueError: as `measured.fit`, models are missing or repeated, or folds outside their domain.

    Source: Hurvich and Tsai 1989; Hastie, Tibshirani and Friedman, "The Elements of Statistical Learning",
    section 7.10.

    Example:
        >>> from sssfit.profiles import burley
        >>> r = np.geomspace(0.1, 20, 40)
        >>> found = compare(r, burley.profile(r, 1.5, 0.7), ["jimenez", "burley"], sigma=1e-4)
        >>> [candidate.fit.model for candidate in found]
        ['burley', 'jimenez']
    """
    if not models or len(set(models)) != len(models):
        raise ValueError(f"models must be names, each once, got {list(models)}")
    count = np.asarray(r).size
    if not 2 <= folds <= count:
        raise ValueError(f"folds must be from 2 to the number of points, {count}, got {folds}")
    points = same_points(r, values, sigma, models, options.get("response", "radial"))
    fits = [measured.fit(*points[:2], model=model, sigma=points.sigma, **options) for model in models]
    fits = [dataclasses.replace(fit, notes=points.notes + fit.notes) for fit in fits]
    least = min((fit.aicc for fit in fits if np.isfinite(fit.aicc)), default=np.nan)
    candidates = [
        Candidate(
            fit,
            float(fit.aicc - least) if np.isfinite(fit.aicc) else np.inf,
            _foretold(points, folds, model, options),
        )
        for fit, model in zip(fits, models, strict=True)
    ]
    return sorted(candidates, key=lambda candidate: (candidate.aicc, candidate.cross_validation))


def same_points(
    r: ArrayLike, values: ArrayLike, sigma: ArrayLike | None, models: Sequence[str], response: Response
) -> CurveData:
    """What all of the models can be fitted to: criteria of different points do not compare.

    Args:
        r, values, sigma: as `measured.fit`.
        models: names as `measured.fit` takes them.
        response: as `measured.fit`.

    Returns:
        A named tuple of r (m,), values and sigma (m, channels), in float64, and notes: all points, but for
        one at r = 0 where a model is infinite there.

    Raises:
        ValueError: as `measured.fit`.

    Example:
        >>> same_points([0.0, 1.0, 2.0], [3.0, 2.0, 1.0], None, ["dipole", "burley"], "radial").r
        array([1., 2.])
    """
    profiles = [profile_models.named(model) for model in models]
    data = _curve_data.checked(r, values, sigma, profiles[0], response)
    return _curve_data.without_singular_point(data, profiles, response)


def _foretold(data: CurveData, folds: int, model: str, options: dict[str, Any]) -> float:
    """What the points of each fold miss of the fit to the others."""
    response = options.get("response", "radial")
    # The same weights for all folds: what is left out weighs nothing, and no shape changes.
    roots = _curve_data.root_weights(data, options.get("weights"), response)
    scale = roots if data.sigma is None else 1 / data.sigma
    square = 0.0
    for fold in range(folds):
        left_out = np.arange(len(data.r)) % folds == fold
        kept = np.where(left_out[:, None], 0.0, np.square(roots))
        found = measured.fit(
            data.r, data.values, model=model, sigma=data.sigma, **{**options, "weights": kept}
        )
        square += np.sum(np.square(scale * (data.values - found.fitted))[left_out])
    whole = np.sum(np.square(roots * data.values)) if data.sigma is None else roots.size
    return float(np.sqrt(square / whole))
