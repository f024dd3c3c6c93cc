"""Quadrature nodes for the fits' integrals, in NumPy float64."""

import numpy as np


def gauss_legendre(edges: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Composite Gauss-Legendre rule.

    Args:
        edges: ascending panel edges, shape (panels + 1,).
        order: nodes per panel; polynomials of degree 2 order - 1 are exact on each.

    Returns:
        Nodes and weights, each of shape (panels * order,), nodes ascending and inside the panels.

    Example:
        >>> x, w = gauss_legendre(np.array([0.0, 1.0, 3.0]), 4)
        >>> float(np.sum(w * x**2)).__round__(12)
        9.0
    """
    points, weights = np.polynomial.legendre.leggauss(order)
    half = np.diff(edges)[:, None] / 2
    middle = (edges[1:] + edges[:-1])[:, None] / 2
    return (middle + half * points).ravel(), (half * weights).ravel()


def uniform_variate(order: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Rule for integrals over xi in (0, 1) whose integrand has a logarithm at xi = 1.

    With 1 - xi = exp(-s) such integrands are smooth in s, and the tail beyond s = 80 weighs 1e-35.

    Args:
        order: nodes per panel; 48 panels are used.

    Returns:
        The exponents s, ascending, and weights that sum to 1 in xi, each of shape (48 * order,).

    Example:
        >>> s, w = uniform_variate()
        >>> float(np.sum(w * s)).__round__(12)  # the mean of -ln(1 - xi)
        1.0
    """
    edges = np.concatenate([np.linspace(0, 8, 33), np.linspace(8, 80, 17)[1:]])
    s, weights = gauss_legendre(edges, order)
    return s, weights * np.exp(-s)
