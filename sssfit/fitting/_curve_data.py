"""Measured curves as they are given, checked, and the weights of their points."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np
from jax.typing import ArrayLike

from sssfit.fitting.profile_model import Model
from sssfit.fitting.profile_models import Burley
from sssfit.fitting.responses import Response

Weighting = Literal["sigma", "area", "relative"]
WEIGHTINGS: tuple[Weighting, ...] = get_args(Weighting)

# A value so many standard deviations below 0 is no noise.
FAR_BELOW = 5.0


class CurveData(NamedTuple):
    """Checked data in float64.

    Attributes:
        r: distances, mm, strictly ascending, shape (m,).
        values: shape (m, channels).
        sigma: standard deviations of the values, shape (m, channels), or None.
        notes: what was done to the data, a sentence each.
    """

    r: np.ndarray
    values: np.ndarray
    sigma: np.ndarray | None
    notes: tuple[str, ...]


def checked(
    r: ArrayLike, values: ArrayLike, sigma: ArrayLike | None, model: Model, response: Response
) -> CurveData:
    """The data as arrays of float64.

    Raises:
        ValueError: they do not make a curve; the message says where and why.
    """
    r, values = np.asarray(r, np.float64), np.asarray(values, np.float64)
    if r.ndim != 1 or len(r) == 0 or values.shape[:1] != r.shape or values.ndim > 2:
        raise ValueError(
            f"r and values must be of shapes (m,) and (m,) or (m, channels), got {r.shape} and {values.shape}"
        )
    values = values.reshape(len(r), -1)
    _finite("r", r)
    _finite("values", values)
    steps = np.diff(r)
    if np.any(steps <= 0):
        where = int(np.argmax(steps <= 0)) + 1
        what = "stands there twice" if steps[where - 1] == 0 else f"follows {r[where - 1]:g}"
        raise ValueError(f"r must ascend without repeats, but r[{where}] = {r[where]:g} mm {what}")
    if response in ("radial", "beam") and r[0] < 0:
        raise ValueError(f"r must be a distance of at least 0 mm, got {r[0]:g}")
    if sigma is not None:
        sigma = _checked_sigma(np.asarray(sigma, np.float64), values)
    _check_signs(r, values, sigma)
    return without_singular_point(CurveData(r, values, sigma, ()), [model], response)


def without_singular_point(data: CurveData, models: Sequence[Model], response: Response) -> CurveData:
    """The points that all of the models can be fitted to, with a note on what is left out.

    Raises:
        ValueError: none is left.
    """
    if data.r[0] != 0 or response not in ("radial", "line") or not any(isinstance(m, Burley) for m in models):
        return data
    if len(data.r) == 1:
        raise ValueError("values must hold a point at r > 0, where Burley's profile is finite")
    note = "the point at r = 0 is left out: Burley's profile is infinite there"
    sigma = None if data.sigma is None else data.sigma[1:]
    return CurveData(data.r[1:], data.values[1:], sigma, (*data.notes, note))


def _finite(name: str, array: np.ndarray) -> None:
    if not np.all(np.isfinite(array)):
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"{name} must be finite, but {name}{where} is {array[tuple(where)]}")


def _checked_sigma(sigma: np.ndarray, values: np.ndarray) -> np.ndarray:
    if sigma.ndim == 1 and sigma.shape == values.shape[:1]:
        sigma = sigma[:, None]
    if sigma.ndim > 2 or (sigma.ndim == 2 and sigma.shape[0] not in (1, len(values))):
        raise ValueError(
            f"sigma must be a number or of the shape of values {values.shape}, got {sigma.shape}"
        )
    try:
        sigma = np.broadcast_to(sigma, values.shape)
    except ValueError:
        raise ValueError(f"sigma must be of the shape of values {values.shape}, got {sigma.shape}") from None
    _finite("sigma", sigma)
    if np.any(sigma <= 0):
        where = np.argwhere(sigma <= 0)[0]
        raise ValueError(
            f"sigma must be above 0, but it is {sigma[tuple(where)]:g} at point {where[0]}; "
            "leave sigma out if the noise is not known"
        )
    return sigma


def _check_signs(r: np.ndarray, values: np.ndarray, sigma: np.ndarray | None) -> None:
    if not np.all(np.any(values > 0, axis=0)):
        raise ValueError("values must rise above 0 somewhere, but a whole curve is 0 or negative")
    allowed = 0.0 if sigma is None else -FAR_BELOW * sigma
    if np.any(values < allowed):
        where = np.argwhere(values < allowed)[0]
        raise ValueError(
            f"values must not be below 0 by more than noise, but at r = {r[where[0]]:g} mm one is "
            f"{values[tuple(where)]:g}; give sigma if that is noise"
        )


def root_weights(data: CurveData, weights: Weighting | ArrayLike | None, response: Response) -> np.ndarray:
    """The root of each squared difference's weight, shape (m, channels), in standard deviations with sigma.

    Without sigma their unit is arbitrary: they are scaled so that the weighted data have norm 1.

    Raises:
        ValueError: the weights are unknown, or do not suit the data.
    """
    if weights is None:
        weights = "area" if data.sigma is None else "sigma"
    if isinstance(weights, str):
        roots = np.sqrt(_weights_named(data, weights, response))
    else:
        given = np.asarray(weights, np.float64)
        if given.shape not in (data.r.shape, data.values.shape):
            raise ValueError(f"weights must be of shape {data.r.shape}, got {given.shape}")
        if not (np.all(np.isfinite(given)) and np.all(given >= 0) and np.any(given > 0)):
            raise ValueError("weights must be finite numbers of at least 0, not all 0")
        roots = np.sqrt(np.broadcast_to(given.reshape(len(data.r), -1), data.values.shape))
    if data.sigma is not None and isinstance(weights, str) and weights == "sigma":
        return roots
    norms = np.linalg.norm(roots * data.values, axis=0)
    if np.any(norms == 0):
        raise ValueError("weights must leave values above 0 in, but all of those weigh nothing")
    return roots / norms


def _weights_named(data: CurveData, weights: str, response: Response) -> np.ndarray:
    if weights == "sigma":
        if data.sigma is None:
            raise ValueError("weights 'sigma' need the standard deviations of the values: give sigma")
        return data.sigma**-2.0
    if weights == "relative":
        if np.any(data.values <= 0):
            where = np.argwhere(data.values <= 0)[0][0]
            raise ValueError(
                f"weights 'relative' need values above 0, but at r = {data.r[where]:g} mm one is not"
            )
        return data.values**-2.0
    if weights != "area":
        raise ValueError(f"weights must be numbers or one of {', '.join(WEIGHTINGS)}, got {weights!r}")
    step = np.ones(1)
    if len(data.r) > 1:
        # The trapezoid rule.
        step = np.diff(data.r, prepend=data.r[0], append=data.r[-1])
        step = (step[1:] + step[:-1]) / 2
    cells = step if response in ("line", "edge") else step * np.abs(data.r)
    return np.broadcast_to(cells[:, None], data.values.shape)


def span(r: np.ndarray) -> tuple[float, float]:
    """The shortest and the longest distance from the light, mm."""
    distance = np.abs(r[r != 0])
    if len(distance) == 0:
        raise ValueError("r must hold a distance other than 0")
    return float(np.min(distance)), float(np.max(distance))


def channel_names(number: int, channels: Sequence[str] | None) -> tuple[str, ...]:
    """Names of the curves: none for one, r, g, b for three, numbers from 1 for others.

    Raises:
        ValueError: their number is another, or one stands there twice.
    """
    if channels is None:
        usual = {1: ("",), 3: ("r", "g", "b")}
        return usual.get(number, tuple(str(i + 1) for i in range(number)))
    if len(channels) != number or len(set(channels)) != number:
        raise ValueError(f"channels must be {number} different names, got {list(channels)}")
    return tuple(channels)
