"""What a least-squares fit determines: singular values, and standard errors of the parameters.

The residual of these fits is a misfit between two curves, not noise: its values at neighbouring points
say the same thing over and over. It is therefore counted as as many independent observations as it has
lobes of one sign, so that the intervals do not shrink when the grid is refined.
"""

from dataclasses import dataclass

import numpy as np

# A direction of the parameters is determined when moving along it by a factor e moves the fitted
# curve by more than this share of its norm.
_DETERMINED_ABOVE = 1e-6

_NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Identifiability:
    """What the data say about the logarithms of the parameters.

    Attributes:
        singular_values: of the Jacobian in the parameters' logarithms over the norm of the data,
            descending, shape (n,).
        condition_number: largest over smallest; inf when the smallest is negligible.
        covariance: of the logarithms, shape (n, n), inf in directions that are not determined.
        standard_error: relative standard error of each parameter, shape (n,).
        determined: whether the data determine each parameter at all, shape (n,).

    Example:
        >>> line = np.linspace(0.5, 1.5, 9)
        >>> analyse(line[:, None], 1e-3 * np.sin(9 * line), 1.0).determined.tolist()
        [True]
    """

    singular_values: np.ndarray
    condition_number: float
    covariance: np.ndarray
    standard_error: np.ndarray
    determined: np.ndarray

    @property
    def factor(self) -> np.ndarray:
        """The 95 % interval of a parameter p is [p / factor, p * factor], shape (n,)."""
        return interval_factor(np.diag(self.covariance))


def interval_factor(variance: np.ndarray | float) -> np.ndarray:
    """exp(1.96 sqrt(variance)): the 95 % interval of a length or an albedo, given ln's variance.

    Args:
        variance: of the logarithm, >= 0.

    Example:
        >>> float(interval_factor(0.0))
        1.0
    """
    return np.exp(_NORMAL_95 * np.sqrt(variance))


def analyse(jacobian: np.ndarray, residuals: np.ndarray, norm: float) -> Identifiability:
    """Standard errors of a fit from its Jacobian and residuals at the optimum.

    With L lobes the covariance is |residuals|^2 / L (J' J)^-1: the usual one for L observations, each
    standing for its share of the points.

    Args:
        jacobian: derivative of the weighted residuals in the logarithms of the parameters, (m, n).
        residuals: weighted residuals in the order of the abscissa, shape (m,).
        norm: norm of the weighted data, > 0, the scale of the singular values.

    Returns:
        An `Identifiability`.

    Example:
        >>> flat = np.stack([np.ones(9), np.zeros(9)], axis=1)
        >>> analyse(flat, 1e-3 * np.sin(np.arange(9.0)), 3.0).determined.tolist()
        [True, False]
    """
    _, singular_values, right = np.linalg.svd(jacobian / norm, full_matrices=False)
    known = singular_values > _DETERMINED_ABOVE
    lobes = 1 + int(np.sum(np.diff(np.sign(residuals)) != 0))
    variance = float(np.sum(np.square(residuals / norm))) / lobes
    scaled = right[known] / singular_values[known, None]
    # Any part of a parameter in an undetermined direction leaves it undetermined.
    determined = np.all(np.abs(right[~known]) < 1e-3, axis=0)
    covariance = np.where(np.outer(determined, determined), variance * scaled.T @ scaled, np.inf)
    return Identifiability(
        singular_values=singular_values,
        condition_number=float(singular_values[0] / singular_values[-1]) if known.all() else np.inf,
        covariance=covariance,
        standard_error=np.sqrt(np.diag(covariance)),
        determined=determined,
    )
