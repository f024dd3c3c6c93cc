"""Samplers of Burley's profile to compare: those of sssfit, and what others use.

All take float32 variates in [0, 1) and give float32 radii for d = 1, d being an argument at run time.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from sssfit.profiles import burley
from sssfit.sampling import inverse_cdf

#: Entries of the interpolated tables, at equal steps of the radius up to the largest one.
ENTRIES = 256
#: Variates that NumPy and SciPy handle at once.
CHUNK = 2**14
#: The constant of g that an engine ships.
ENGINE_C = 2.6
D = np.float32(1)


class Sampler(NamedTuple):
    """One way to draw radii, and the importance weight that belongs to it.

    `prepare` takes variates to where the sampler wants them and returns a program without arguments that
    draws; `weight` gives profile density / drawn density, float64, from variates and radii.
    """

    name: str
    library: str
    prepare: Callable[[np.ndarray], Callable[[], Any]]
    weight: Callable[[np.ndarray, np.ndarray], np.ndarray]


def everything() -> list[Sampler]:
    """All samplers; those of Numba only where it is installed."""
    return [*_ours(), *_numpy(), *_scipy(), *_numba()]


def floor(xi: np.ndarray) -> Callable[[], Any]:
    """The cheapest sampler conceivable, d xi: what reading and writing the arrays costs."""
    return _on_jax(lambda xi, d: d * xi)(xi)


def exact_radius(xi: np.ndarray) -> np.ndarray:
    """The reference in float64, by a formula that no sampler uses: t = 2 sinh(asinh(2 u) / 3)."""
    return -3 * np.log(2 * np.sinh(np.arcsinh(2 * (1 - xi)) / 3))


def density(radius: np.ndarray) -> np.ndarray:
    """The profile's radial density in float64."""
    slow = np.exp(-radius / 3)
    return (slow**3 + slow) / 4


def cdf(radius: np.ndarray) -> np.ndarray:
    """The profile's cdf in float64."""
    return -np.expm1(-radius) / 4 - 3 * np.expm1(-radius / 3) / 4


def _on_jax(radius: Callable) -> Callable[[np.ndarray], Callable[[], Any]]:
    compiled = jax.jit(radius)

    def prepare(xi: np.ndarray) -> Callable[[], Any]:
        on_device, d = jnp.asarray(xi), jnp.asarray(D)
        return lambda: compiled(on_device, d).block_until_ready()

    return prepare


def _on_numpy(draw: Callable) -> Callable[[np.ndarray], Callable[[], np.ndarray]]:
    """A chunk at a time, so that NumPy's intermediate arrays stay in the cache."""

    def draw_chunks(xi: np.ndarray) -> np.ndarray:
        radius = np.empty_like(xi)
        for start in range(0, xi.size, CHUNK):
            chunk = slice(start, start + CHUNK)
            radius[chunk] = draw(xi[chunk], D)
        return radius

    return lambda xi: lambda: draw_chunks(xi)


def _on_numba(draw: Callable) -> Callable[[np.ndarray], Callable[[], np.ndarray]]:
    return lambda xi: lambda: draw(xi, D)


def _weight_one(xi: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """For samplers that draw the profile's own density."""
    del radius
    return np.ones(xi.shape)


def _weight_of(pdf: Callable) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The weight as a renderer computes it, in float32, from a method's own density."""
    compiled = jax.jit(lambda xi, radius, d: burley.pdf(radius, d) / pdf(xi, d))
    return lambda xi, radius: np.asarray(compiled(xi, radius, D), np.float64)


def _weight_by(slope: Callable) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The weight from the derivative of the radius in the variate, whose inverse is the drawn density."""
    return lambda xi, radius: density(radius.astype(np.float64)) * slope(xi.astype(np.float64))


def _ours() -> list[Sampler]:
    own_density = ("exact", "closed_form", "mixture")
    samplers = [
        Sampler(
            name,
            "sssfit",
            _on_jax(method.radius),
            _weight_one if name in own_density else _weight_of(method.pdf),
        )
        for name, method in inverse_cdf.METHODS.items()
    ]
    engine = Sampler(
        "xie, c = 2.6",
        "sssfit",
        _on_jax(lambda xi, d: inverse_cdf.xie(xi, d, ENGINE_C)),
        _weight_of(lambda xi, d: inverse_cdf.xie_pdf(xi, d, ENGINE_C)),
    )
    return [*samplers, engine]


def _numpy() -> list[Sampler]:
    def closed_form(xi: np.ndarray, d: np.float32) -> np.ndarray:
        u = 1 - xi
        g = np.cbrt(1 + 4 * u * (2 * u + np.sqrt(1 + 4 * u * u)))
        return 3 * d * np.log((1 + 1 / g + g) / (4 * u))

    def published(xi: np.ndarray, d: np.float32) -> np.ndarray:
        return d * ((2 - inverse_cdf.PUBLISHED_C) * xi - 2) * np.log(1 - xi)

    return [
        Sampler("NumPy closed form", "NumPy", _on_numpy(closed_form), _weight_one),
        Sampler("NumPy g", "NumPy", _on_numpy(published), _weight_of(inverse_cdf.xie_pdf)),
    ]


def _scipy() -> list[Sampler]:
    """Tables with entries at equal steps of the radius, which a search finds as fast as any others."""
    radius = np.linspace(0, exact_radius(np.array(inverse_cdf.LARGEST_VARIATE)), ENTRIES)
    xi = cdf(radius)
    xi[-1] = inverse_cdf.LARGEST_VARIATE
    slopes = np.diff(radius) / np.diff(xi)

    def linear(x: np.ndarray, d: np.float32) -> np.ndarray:
        return d * np.interp(x, xi, radius).astype(np.float32)

    def linear_slope(x: np.ndarray) -> np.ndarray:
        return slopes[np.clip(np.searchsorted(xi, x, side="right") - 1, 0, ENTRIES - 2)]

    samplers = [Sampler("NumPy interp", "NumPy", _on_numpy(linear), _weight_by(linear_slope))]
    curves = {"SciPy PCHIP": PchipInterpolator(xi, radius), "SciPy spline": CubicSpline(xi, radius)}
    for name, curve in curves.items():

        def draw(x: np.ndarray, d: np.float32, curve=curve) -> np.ndarray:
            return d * curve(x).astype(np.float32)

        samplers.append(Sampler(name, "SciPy", _on_numpy(draw), _weight_by(curve.derivative())))
    return samplers


def _numba() -> list[Sampler]:
    try:
        import numba_samplers as loops
    except ModuleNotFoundError as error:
        if error.name != "numba":
            raise
        return []

    def weight_truncated(xi: np.ndarray, radius: np.ndarray) -> np.ndarray:
        del radius
        return np.full(xi.shape, float(loops.KEPT))

    return [
        Sampler("Numba closed form", "Numba", _on_numba(loops.closed_form), _weight_one),
        Sampler("Numba g", "Numba", _on_numba(loops.published), _weight_of(inverse_cdf.xie_pdf)),
        Sampler("Numba Halley", "Numba", _on_numba(loops.halley), _weight_one),
        Sampler("Numba Newton to 16 d", "Numba", _on_numba(loops.truncated_newton), weight_truncated),
    ]
