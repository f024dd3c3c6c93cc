"""One pixel and a circle of light: the uniform square of the 2020 paper, and a beam on a scattering plane.

`uniform` draws points of the unit square and averages 4 / pi over those within the inscribed circle: the
result is 1, and a sample is 4 / pi with probability pi / 4. `beam` draws Burley's radius and a direction
around pixels at any distance from a circular beam; its exact answer is a quadrature.

Source: Xie et al. 2020, section 4.1.3; the beam is its section A.1.2's, on a plane.
"""

import functools
import math
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.sampling import inverse_cdf
from sssfit.scenarios._direction import cosine_of_half_turn

#: Irradiance within the circle that makes the mean over the unit square 1.
IRRADIANCE = 4 / math.pi
#: Variance of one sample of the uniform circle.
SAMPLE_VARIANCE = 4 / math.pi - 1
# Radii in units of d below and beyond which nothing arrives that float64 could tell.
_NEAREST, _REACH = 1e-18, 240.0


class Circle(eqx.Module):
    """A world of one circle of light; made by `uniform` or `beam`. See `driver.World` for the answers."""

    intensity: Array
    distance_in_d: Array
    radius_in_d: Array
    truth: Array
    sample_variance: Array
    control: Array
    surround: Array
    profile: Literal["uniform", "burley"] = eqx.field(static=True)

    def places(self, uniform: Array) -> Array:
        """Whether samples fall into the light; see `driver.World`."""
        if self.profile == "uniform":
            return jnp.sum(jnp.square(uniform - 0.5), axis=0) < 0.25
        r = inverse_cdf.log_poly12(uniform[0], 1.0)
        x, radius = self.distance_in_d, self.radius_in_d
        # Squared distance to the centre less squared radius, by factors: large ones would cancel.
        facing = 1 + cosine_of_half_turn(uniform[1])
        return (x - r - radius) * (x - r + radius) + 2 * x * r * facing < 0

    def values(self, places: Array, frame: Array) -> Array:
        """Values of samples; see `driver.World`."""
        return jnp.where(places, IRRADIANCE * self.intensity[frame], 0)


def uniform(intensity: ArrayLike) -> Circle:
    """The uniform circle scenario.

    Args:
        intensity: of the light in each frame, >= 0, shape (frames,); a whole number n stands for n frames
            of intensity 1.

    Returns:
        A world of one pixel, of shape (), in the intensity's dtype: truth I, sample variance
        (4 / pi - 1) I^2, control and surround 4 I / pi, the light at the circle's centre.

    Raises:
        ValueError: there is no frame, or an intensity is negative or not finite.

    Source: Xie et al. 2020, section 4.1.3.

    Example:
        >>> float(uniform(150).truth[-1])
        1.0
    """
    intensity = _frames(intensity)
    return _world(intensity, np.zeros(()), 0.5, math.pi / 4, "uniform")


def beam(intensity: ArrayLike, *, distance: ArrayLike, radius: float, d: float) -> Circle:
    """A circular beam on a plane of Burley's profile, seen at points of that plane.

    Args:
        intensity: as for `uniform`; within the beam the irradiance is 4 / pi times it.
        distance: of each pixel from the beam's centre, mm, >= 0, shape (...), the pixels' shape.
        radius: of the beam, mm, > 0.
        d: Burley's shape parameter, mm, > 0.

    Returns:
        A world of the distances' shape, albedo 1, whose lengths over d are rounded to its dtype: the truth
        is 4 I / pi times `hit_probability` P, the sample variance (4 I / pi)^2 P (1 - P), the control
        4 I / pi within the beam and 0 outside, the surround 4 I / pi everywhere.

    Raises:
        ValueError: as `uniform`; a length is out of its domain.

    Source: Xie et al. 2020, section A.1.2; sampling: its Eq 17-18.

    Example:
        >>> world = beam(1, distance=[0.0, 2.0], radius=1.0, d=0.5)
        >>> world.truth.shape, round(float(world.truth[0, 0]), 3)
        ((1, 2), 0.74)
    """
    distance, intensity = np.asarray(distance, np.float64), _frames(intensity)
    _check_lengths(distance, radius, d)
    # What is sampled, which in float32 is not quite what was given.
    x, edge = (
        (length / d).astype(intensity.dtype).astype(np.float64) for length in (distance, np.float64(radius))
    )
    return _world(intensity, x, edge, hit_probability(x, radius=float(edge), d=1.0), "burley")


def hit_probability(distance: ArrayLike, *, radius: float, d: float) -> np.ndarray:
    """Share of the light scattered to a point that comes from within a disc.

    Args:
        distance: of the point from the disc's centre, mm, >= 0, shape (...).
        radius: of the disc, mm, > 0.
        d: Burley's shape parameter, mm, > 0.

    Returns:
        Integral of Burley's profile over the disc, float64, with an error below 1e-12; pi radius^2 times
        the mean of the profile over it. At the centre it is the cdf of the radius.

    Raises:
        ValueError: a length is out of its domain.

    Source: polar coordinates around the point; arcs of circles within a disc.

    Example:
        >>> float(hit_probability(1.0, radius=1.0, d=1e-6)).__round__(4)
        0.5
    """
    distance = np.asarray(distance, np.float64)
    _check_lengths(distance, radius, d)
    return _hit_probability(distance, radius, d)


def _check_lengths(distance: np.ndarray, radius: float, d: float) -> None:
    if not (np.isfinite(distance).all() and (distance >= 0).all()):
        raise ValueError(f"distance must be at least 0 and finite, in mm, got {distance.tolist()}")
    for name, length in (("radius", radius), ("d", d)):
        if not 0 < length < math.inf:
            raise ValueError(f"{name} must be a positive length in mm, got {length}")


def _hit_probability(distance: np.ndarray, radius: float, d: float) -> np.ndarray:
    """The same of valid lengths: circles that lie within the disc, and arcs of those that cross its edge."""
    nodes, weights = _nodes()
    # Differences before the division, since large lengths would cancel after it.
    gap, total, x = (distance - radius) / d, (distance + radius) / d, distance / d
    nearest = np.abs(gap)
    low, high = np.maximum(nearest, _NEAREST), np.minimum(total, nearest + _REACH)
    ratio = np.log(np.maximum(high / low, 1))[..., None]
    # Logarithmic in the radius, for points near the edge; the sine takes the square roots out of the ends.
    r = low[..., None] * np.exp(ratio * np.square(np.sin(nodes / 2)))
    cosine = (r + (gap * total)[..., None] / r) / np.where(x > 0, 2 * x, 1)[..., None]
    arc = np.arccos(np.clip(cosine, -1, 1)) / math.pi
    density = (np.exp(-r) + np.exp(-r / 3)) / 4
    crossing = np.sum(weights * ratio / 2 * np.sin(nodes) * r * density * arc, axis=-1)
    within = -(np.expm1(-nearest) + 3 * np.expm1(-nearest / 3)) / 4
    return np.where(distance < radius, within, 0.0) + np.where(distance > 0, crossing, 0.0)


@functools.cache
def _nodes() -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.legendre.leggauss(256)
    return (nodes + 1) * math.pi / 2, weights * math.pi / 2


def _frames(intensity: ArrayLike) -> np.ndarray:
    """Intensities of the frames, from a number of frames or as given."""
    if isinstance(intensity, int | np.integer):
        intensity = np.ones(max(int(intensity), 0), np.float32)
    intensity = np.asarray(intensity)
    # Without JAX's 64-bit mode float64 is float32.
    intensity = intensity.astype(jax.dtypes.canonicalize_dtype(np.result_type(np.float32, intensity.dtype)))
    if intensity.ndim != 1 or intensity.size < 1:
        raise ValueError(f"frames must be at least 1, got an intensity of shape {intensity.shape}")
    if not (np.isfinite(intensity).all() and (intensity >= 0).all()):
        raise ValueError("intensity must be finite and at least 0 in every frame")
    return intensity


def _world(intensity, distance, radius, probability, profile) -> Circle:
    light = IRRADIANCE * intensity.reshape(-1, *(1,) * distance.ndim).astype(np.float64)
    probability, inside = np.broadcast_to(probability, distance.shape), distance < radius
    answers = (light * probability, light**2 * probability * (1 - probability), light * inside)
    if not light.max() ** 2 < float(jnp.finfo(intensity.dtype).max):
        raise ValueError(f"intensity must have squares that fit {intensity.dtype}, got {intensity.max():g}")
    shape = (intensity.size, *distance.shape)
    answers = (*answers, np.broadcast_to(light, shape))
    given = (intensity, distance, np.asarray(radius), *answers)
    return Circle(*(jnp.asarray(v, intensity.dtype) for v in given), profile=profile)
