"""Kernels of blurs along rows and columns, from what the package makes of a profile."""

from typing import NamedTuple

import jax
import numpy as np
from scipy.special import ndtr

from sssfit.fitting import gaussian_sum, separable_to_burley
from sssfit.profiles import burley
from sssfit.tables import kernel
from sssfit.tables.table import Table

#: Of a Gaussian, and how many standard deviations the last one is away.
GAUSSIAN_TAPS = 13
_DEVIATIONS = 3.0
# Between which distances Gaussians are fitted, in d; and the solver that compiles fastest.
_NEAREST, _FARTHEST, _SOLVER = 1e-2, 16.0, "scipy"


class Kernels(NamedTuple):
    """Kernels of three channels, whose results are added up.

    Attributes:
        shares: of each kernel in the result, (k,).
        offsets: of the taps, mm, (k, n, 3).
        weights: of the taps, (k, n, 3).
    """

    shares: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray


def shared(d: np.ndarray, taps: int, reach: float | None = None) -> Kernels:
    """Burley's, with taps that all channels share; the reach is in mm."""
    return _of_table(kernel.burley_kernel_table(d, taps, reach))


def apart(d: np.ndarray, taps: int) -> Kernels:
    """Burley's, with taps for each channel that suit it."""
    each = [shared(np.full(3, one), taps) for one in d]
    offsets, weights = (np.stack([k[part][..., 0] for k in each], axis=-1) for part in (1, 2))
    return Kernels(np.ones(1), offsets, weights)


def falloff(d: np.ndarray, taps: int) -> Kernels:
    """The published one, as wide as the one to which Burley's profile of the widest channel is fitted."""
    _, (fitted,), *_ = separable_to_burley.fit_many(np.ones(1))
    return _of_table(kernel.falloff_kernel_table(d / np.max(d), np.ones(3), taps), np.max(d) / fitted)


def gaussians(d: np.ndarray, number: int, fitted_to: str) -> Kernels:
    """A sum of Gaussians fitted to the "profile" or its "radial density", scaled to an energy of 1."""
    if fitted_to == "profile":
        fit = gaussian_sum.fit_profile(
            lambda r: burley.profile(r, 1.0), number, _NEAREST, _FARTHEST, solver=_SOLVER
        )
    else:
        # The density is the profile times the distance, and weighs what is far as much as light does.
        r = np.geomspace(_NEAREST, _FARTHEST, 256)
        with jax.enable_x64(True):
            values = np.asarray(burley.profile(r, 1.0))
        fit = gaussian_sum.fit(r, values, number, weights=np.gradient(r) * r**2, solver=_SOLVER)
    places = np.linspace(-_DEVIATIONS, _DEVIATIONS, GAUSSIAN_TAPS)
    edges = np.concatenate([[-np.inf], (places[1:] + places[:-1]) / 2, [np.inf]])
    offsets = np.sqrt(fit.variances)[:, None, None] * places[:, None] * d
    weights = np.broadcast_to(np.diff(ndtr(edges))[:, None], offsets.shape)
    return Kernels(fit.weights / fit.weights.sum(), offsets, weights)


def _of_table(table: Table, stretch: float = 1.0) -> Kernels:
    offsets = np.repeat(stretch * table.axes[0].values[:, None], 3, axis=1)
    return Kernels(np.ones(1), offsets[None], table.values[None])
