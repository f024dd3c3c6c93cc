"""Intervals of fitted parameters: from the Jacobian, and along the likelihood where that is no guide.

The covariance is that of the solved-for numbers `z`: logarithms of lengths and shares as they are. An
interval of a length is therefore a factor, and an interval of a share a difference.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import stats

LEVELS = (0.68, 0.95)

# Below this chance under the stated noise a misfit is taken to be the model's.
_MISFIT_CHANCE = 1e-3
# A direction in which a factor of e costs less than this many standard deviations is not determined.
_DETERMINED_ABOVE = 2.0
# What a likelihood is searched to: a factor, or a change of a share in its unit; more for large ones.
_FARTHEST = 12.0
_STEPS = 60
# Singular values below this share of the largest are rounding.
_NO_INFORMATION = 1e-10


@dataclass(frozen=True)
class Estimate:
    """A number with its uncertainty.

    Attributes:
        value: in its unit; NaN where it is not defined.
        standard_error: in its unit, inf if the data say nothing.
        interval_68: low and high; inf or 0 where it does not close.
        interval_95: the same.
        unit: "mm", "mm^2", "1/mm", or "1".
        determined: whether the data determine it to within a factor of two or so at all.

    Example:
        >>> Estimate(1.0, 0.1, (0.9, 1.1), (0.8, 1.2), "mm", True).unit
        'mm'
    """

    value: float
    standard_error: float
    interval_68: tuple[float, float]
    interval_95: tuple[float, float]
    unit: str
    determined: bool


def half_width(level: float, dof: float) -> float:
    """Half the width of a central interval, in standard errors.

    Args:
        level: the interval's chance to hold the truth, in (0, 1).
        dof: degrees of freedom of the noise's estimate; inf if the noise is known.

    Example:
        >>> round(half_width(0.95, math.inf), 3)
        1.96
    """
    law = stats.norm if math.isinf(dof) else stats.t(max(dof, 1))
    return float(law.ppf((1 + level) / 2))


def around(
    value: float, error: float, is_logarithmic: bool, widths: tuple[float, ...]
) -> tuple[tuple[float, float], ...]:
    """The intervals of a value whose logarithm, or which itself, has a standard error.

    Args:
        value: of the parameter.
        error: of its logarithm, or of itself.
        is_logarithmic: which of the two. A value that is no logarithm is a share, cut at 0.
        widths: in standard errors.

    Example:
        >>> [(round(a, 3), round(b, 3)) for a, b in around(1.0, 0.1, False, (1.0, 2.0))]
        [(0.9, 1.1), (0.8, 1.2)]
    """
    if not is_logarithmic:
        return tuple((max(float(value - w * error), 0.0), float(value + w * error)) for w in widths)
    with np.errstate(over="ignore"):
        factors = [float(np.exp(np.float64(w * error))) for w in widths]
    return tuple((float(value / factor), float(value * factor)) for factor in factors)


def misfit(residuals: np.ndarray, dof: int, is_noise_known: bool) -> tuple[float, str]:
    """By how much the variance has to grow because the model does not fit, and why.

    Noise changes its sign from point to point. A misfit does not: its swings are then what is counted, as
    its values at neighbouring points say the same thing again.

    Args:
        residuals: in standard deviations of the noise, in the order of the distance, shape (m, channels).
        dof: degrees of freedom.
        is_noise_known: whether the noise was given; else it was estimated from these residuals.

    Returns:
        A factor of at least 1, and a sentence, empty if the model fits.

    Example:
        >>> misfit(np.array([[1.0], [-1.0], [0.5], [-0.7]]), 2, True)
        (1.0, '')
    """
    used = [column[column != 0] for column in residuals.T]
    count = sum(map(len, used))
    swings = sum(1 + int(np.sum(np.diff(np.sign(column)) != 0)) for column in used)
    # Under noise the swings of n points are binomial: half of the n - 1 neighbours differ in sign.
    changes, neighbours = swings - len(used), count - len(used)
    too_few = neighbours > 0 and bool(stats.binom.cdf(changes, neighbours, 0.5) < _MISFIT_CHANCE)
    chi2 = float(np.sum(np.square(residuals)))
    too_large = is_noise_known and dof > 0 and stats.chi2.sf(chi2, dof) < _MISFIT_CHANCE
    if not (too_few or too_large):
        return 1.0, ""
    # Swings that are small beside a known noise take nothing from what the data say.
    size = chi2 / dof if is_noise_known and dof > 0 else 1.0
    factor = size * max(1.0, count / (2 * swings)) if too_few else size
    if factor <= 1:
        return 1.0, ""
    words = [f"chi2 per degree of freedom is {chi2 / dof:.3g}"] if too_large else []
    words += [f"the residuals of {count} points change their sign only {changes} times"] * too_few
    return factor, (
        f"the model does not fit within the noise ({' and '.join(words)}); "
        f"the intervals are {math.sqrt(factor):.3g} times as wide for it"
    )


def directions(jacobian: np.ndarray, names: list[str], values: np.ndarray) -> list[str]:
    """What the data cannot tell apart, in words.

    Args:
        jacobian: of the residuals in standard deviations, in the parameters' logarithms, shape (m, n).
        names: of the parameters, length n.
        values: of the parameters, shape (n,): what is 0 has no logarithm and is left out.

    Returns:
        A sentence for each singular direction that is not determined, the worst first.

    Example:
        >>> directions(np.array([[9.0, -9.0], [9.0, -9.0]]), ["a", "b"], np.ones(2))
        ['the data cannot tell a and b raised together from nothing: a factor of 2.72 costs ...']
    """
    used = np.flatnonzero((values > 0) & np.all(np.isfinite(jacobian), axis=0))
    if len(used) == 0:
        return []
    _, strengths, right = np.linalg.svd(jacobian[:, used], full_matrices=True)
    strengths = np.concatenate([strengths, np.zeros(len(used) - len(strengths))])
    found = []
    for strength, direction in sorted(zip(strengths, right, strict=True), key=lambda pair: pair[0]):
        if strength >= _DETERMINED_ABOVE:
            break
        main = np.argsort(-np.abs(direction))
        main = [int(i) for i in main if abs(direction[i]) > 0.3 * abs(direction[main[0]])]
        sign = np.sign(direction[main[0]])
        raised = " and ".join(names[used[i]] for i in main if sign * direction[i] > 0)
        lowered = " and ".join(names[used[i]] for i in main if sign * direction[i] < 0)
        words = f"{raised} raised" + (f" with {lowered} lowered" if lowered else "")
        words += " together" if len(main) > 1 and not lowered else ""
        cost = f"a factor of 2.72 costs {strength:.2g} standard deviations"
        found.append(f"the data cannot tell {words} from nothing: {cost}")
    return found


def covariance(design: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Covariance of least-squares estimates under noise of given sizes, inf where the data say nothing.

    Args:
        design: derivatives of the weighted model, shape (m, n).
        noise: standard deviations of the weighted data, shape (m,).

    Returns:
        Shape (n, n): (D' D)^-1 D' N^2 D (D' D)^-1, with inf on the diagonal, and 0 beside it, for a parameter
        of which a part lies in a direction without information.

    Example:
        >>> covariance(np.array([[2.0, 0.0], [0.0, 0.0]]), np.ones(2)).tolist()
        [[0.25, 0.0], [0.0, inf]]
    """
    # Of fewer points than parameters some directions would have no singular value.
    missing = max(design.shape[1] - len(design), 0)
    design, noise = np.pad(design, ((0, missing), (0, 0))), np.pad(noise, (0, missing))
    size = np.linalg.norm(design, axis=0)
    scale = np.where(size > 0, size, 1.0)
    left, strengths, right = np.linalg.svd(design / scale, full_matrices=False)
    known = strengths > _NO_INFORMATION * np.max(strengths, initial=0.0)
    inverse = (right[known].T / strengths[known]) @ left[:, known].T
    scaled = inverse * noise / scale[:, None]
    result = scaled @ scaled.T
    lost = np.any(np.abs(right[~known]) > 1e-3, axis=0) | (size == 0)
    result[lost, :] = result[:, lost] = 0.0
    result[lost, lost] = np.inf
    return result


def correlation(covariance: np.ndarray) -> np.ndarray:
    """Correlations of a covariance; 0 beside what the data say nothing about.

    Args:
        covariance: shape (n, n).

    Example:
        >>> correlation(np.array([[4.0, 1.0], [1.0, 1.0]])).tolist()
        [[1.0, 0.5], [0.5, 1.0]]
    """
    errors = np.sqrt(np.diag(covariance))
    usable = np.isfinite(errors) & (errors > 0)
    scale = np.where(usable, errors, 1.0)
    result = np.where(np.outer(usable, usable), covariance / np.outer(scale, scale), 0.0)
    result[np.diag_indices_from(result)] = 1.0
    return np.clip(result, -1, 1)


def along_likelihood(
    cost: Callable[[float], float],
    best: float,
    step: float,
    widths: tuple[float, ...],
    lower: float,
    upper: float,
) -> tuple[tuple[float, float], ...]:
    """Intervals of one solved-for number from the profile likelihood: all others are fitted anew.

    Args:
        cost: half of chi2 over the noise's variance with this number held, minimized over the others.
        best: the number at the optimum.
        step: the first step away from it, > 0.
        widths: where chi2 has risen by their squares the intervals end.
        lower: bound of the number; where the likelihood does not fall before it, the interval ends there.
        upper: the same above.

    Returns:
        Intervals for each width; an end that is not reached is the bound.

    Example:
        >>> intervals = along_likelihood(lambda z: z**2 / 2, 0.0, 0.3, (1.0, 2.0), -9.0, 9.0)
        >>> [(round(a, 3), round(b, 3)) for a, b in intervals]
        [(-1.0, 1.0), (-2.0, 2.0)]
    """
    least = cost(best)

    def end(sign: float, bound: float, width: float) -> float:
        target = least + width**2 / 2
        inner, outer = best, best + sign * step
        for _ in range(_STEPS):
            outer = min(outer, bound) if sign > 0 else max(outer, bound)
            if cost(outer) > target:
                break
            if outer == bound or abs(outer - best) > _FARTHEST * max(1.0, abs(best)):
                return bound
            inner, outer = outer, best + 2 * (outer - best)
        for _ in range(_STEPS):
            middle = (inner + outer) / 2
            inner, outer = (middle, outer) if cost(middle) <= target else (inner, middle)
            if abs(outer - inner) < 1e-4 * abs(outer - best):
                break
        return (inner + outer) / 2

    return tuple((end(-1, lower, width), end(1, upper, width)) for width in widths)
