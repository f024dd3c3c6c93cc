"""Coefficients of one-logarithm approximations of the inverse CDF of Burley's profile.

The CDF of Burley's profile at the radius ``x`` (in units of the scattering distance ``d``) is
``xi = 1 - exp(-x) / 4 - 3 exp(-x / 3) / 4``. With ``u = 1 - xi`` and ``t = exp(-x / 3)`` it is
the cubic ``t (t^2 + 3) = 4 u``, hence exactly::

    x = -3 ln(u) - 3 ln(4 / (3 + t^2))

The logarithm of ``u`` carries the whole singularity at ``xi = 1``. The other term, here called
the correction, stays between 0 and 3 ln(4/3) and is analytic in ``xi`` on [0, 1], so a short
polynomial replaces it::

    x ~ -a ln(1 - xi) - xi (q[0] + q[1] xi + q[2] xi^2 + ...)

Every member of the family has this form; more coefficients buy more accuracy for one
multiply-add each.
"""

from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev


class LogPolynomial(NamedTuple):
    """The approximation ``x = -log_factor ln(1 - xi) - xi (q[0] + q[1] xi + ...)``.

    Attributes:
        log_factor: the factor ``a`` of the logarithm, in units of ``d`` (3 has the exact tail).
        coefficients: ``q``, in units of ``d``, lowest power first.

    Example:
        >>> approximation = LogPolynomial(3.0, np.array([1.0, -0.1]))
        >>> len(approximation.coefficients)
        2
    """

    log_factor: float
    coefficients: np.ndarray


def fit_log_linear() -> LogPolynomial:
    """Fit ``x = -a ln(1 - xi) - q xi`` by least squares in the radius.

    The form costs what ``-ln(1 - xi) (2 + (c - 2) xi)`` of Xie et al. costs: one logarithm and
    the same additions and multiplications. The objective is the mean squared radius error of a
    uniform ``xi``, which weighs the tail as sampling does. ``a`` comes out above 3: the sampled
    tail is slightly heavier than the profile's, so importance weights stay bounded.

    Returns:
        ``a`` and ``q``, in units of ``d``.

    Accuracy:
        Against the exact inverse, with c = 2.5715 in parentheses: largest CDF error 2.28e-3
        (9.87e-3), root mean square radius error 0.0144 d (0.244 d), importance weight at most
        1.016 (unbounded).

    Source:
        The form of Xie et al. 2020, Eq. 21, with the logarithm added instead of multiplied.

    Example:
        >>> log_factor, coefficients = fit_log_linear()
        >>> print(f"{log_factor:.6f} {coefficients[0]:.6f}")
        3.056263 1.110967
    """
    # Gauss-Legendre nodes in s, where 1 - xi = s^3: the integrand is singular at xi = 1, but
    # the quadrature weight dxi/ds = 3 s^2 tames it in s.
    nodes, node_weights = np.polynomial.legendre.leggauss(100)
    s = (1.0 + nodes) / 2.0
    xi = 1.0 - s**3
    root_weight = np.sqrt(node_weights * s**2)
    basis = root_weight[:, None] * np.stack([-np.log1p(-xi), -xi], axis=1)
    solution, *_ = np.linalg.lstsq(basis, root_weight * _exact_radius(xi), rcond=None)
    return LogPolynomial(float(solution[0]), solution[1:])


def fit_log_polynomial(num_coefficients: int) -> LogPolynomial:
    """Fit ``x = -3 ln(1 - xi) - xi (q[0] + q[1] xi + ...)``, minimax in the relative error of x.

    Args:
        num_coefficients: number of coefficients in ``q``, from 1 to 14. The numbers 4, 8 and 12
            pay best: the error drops steeply there and stalls in between.

    Returns:
        The factor 3 and ``q``, in units of ``d``. The factor is exact, so the radius error stays
        bounded as ``xi`` goes to 1.

    Raises:
        ValueError: if ``num_coefficients`` is out of range.

    Accuracy:
        Largest relative error of ``x`` over 0 < ``xi`` < 1: 4.6e-4 with 4 coefficients, 1.3e-6
        with 8 and 2.4e-8 with 12, in float64. With 12 the rounding of a float32
        evaluation dominates: 4e-7 at most, if ``ln(1 - xi)`` is taken as accurately as by log1p.

    Source:
        The polynomial is found by the exchange algorithm of Remez.

    Example:
        >>> print(fit_log_polynomial(4).coefficients.round(3))
        [ 1.001  0.13   0.178 -0.44 ]
    """
    if not 1 <= num_coefficients <= 14:
        raise ValueError(f"num_coefficients must be from 1 to 14, got {num_coefficients}")
    # Both ends are left out: at 0 the correction over xi is 0 / 0, at 1 the radius is infinite.
    xi = (0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 20_001)))[1:-1]
    # Chebyshev polynomials on [0, 1] keep the linear systems well conditioned.
    basis = chebyshev.chebvander(2.0 * xi - 1.0, num_coefficients - 1)
    coefficients = _minimax(basis, _correction(xi) / xi, xi / _exact_radius(xi))
    series = chebyshev.Chebyshev(coefficients, domain=[0.0, 1.0])
    return LogPolynomial(3.0, series.convert(kind=np.polynomial.Polynomial).coef)


def _correction(xi: np.ndarray) -> np.ndarray:
    """Return ``3 ln(4 / (3 + t^2))`` with full relative precision, also for tiny ``xi``.

    ``t = 2 sinh(asinh(2 u) / 3)`` solves the cubic, and is 1 at ``u = 1``. Its complement
    ``v = 1 - t`` has to come without cancellation: ``delta = asinh(2) - asinh(2 u)`` is written
    with ``xi`` as a factor, and ``v``, a difference of two sinh, as a product.
    """
    u = 1.0 - xi
    delta = np.arcsinh(2.0 * xi * (1.0 + u) / (np.sqrt(1.0 + 4.0 * u**2) + np.sqrt(5.0) * u))
    v = 4.0 * np.cosh(np.arcsinh(0.5) - delta / 6.0) * np.sinh(delta / 6.0)
    # 4 / (3 + t^2) - 1 = (1 - t^2) / (3 + t^2), and 1 - t^2 = v (2 - v).
    return 3.0 * np.log1p(v * (2.0 - v) / (3.0 + (1.0 - v) ** 2))


def _exact_radius(xi: np.ndarray) -> np.ndarray:
    """Return the exact inverse CDF in units of ``d``."""
    return -3.0 * np.log1p(-xi) - _correction(xi)


def _minimax(basis: np.ndarray, target: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the coefficients that minimise the largest ``|weight (basis @ c - target)|``.

    Remez exchange on a grid (the rows, in order): the best error alternates in sign, with equal
    size, at one point more than there are coefficients. Each round solves for the coefficients
    that do so at trial points, then moves those points to the extrema of the error.
    """
    num_points = basis.shape[1] + 1
    signs = (-1.0) ** np.arange(num_points)
    # Rows are Chebyshev points; every k-th of them is a good first guess of the extrema.
    points = np.linspace(0, len(target) - 1, num_points).round().astype(int)
    for _ in range(50):
        system = np.column_stack([basis[points], signs / weight[points]])
        *coefficients, level = np.linalg.solve(system, target[points])
        error = weight * (basis @ np.array(coefficients) - target)
        if np.abs(error).max() <= (1.0 + 1e-6) * abs(level):
            return np.array(coefficients)
        points = _alternating_extrema(error, num_points)
    raise RuntimeError("the exchange did not settle in 50 rounds")


def _alternating_extrema(error: np.ndarray, num_points: int) -> np.ndarray:
    """Return where ``error`` is extreme, with alternating signs, at ``num_points`` points."""
    sign_changes = np.flatnonzero(np.diff(np.signbit(error))) + 1
    runs = np.split(np.arange(len(error)), sign_changes)
    extrema = [run[np.abs(error[run]).argmax()] for run in runs]
    while len(extrema) > num_points:
        # Only an end can go: dropping an inner one would break the alternation.
        extrema.pop(0 if abs(error[extrema[0]]) < abs(error[extrema[-1]]) else -1)
    return np.array(extrema)
