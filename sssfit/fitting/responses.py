"""What lights of simple shapes show of a radial profile: a point, a line, an edge or a beam.

All of them follow from the areal profile and the energy within or beyond a radius, by integrals along one
line with fixed nodes, so that any profile can be fitted to a photograph of any of these lights.
"""

import functools
from collections.abc import Callable
from itertools import pairwise
from typing import Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.fitting.profile_model import Model

Response = Literal["radial", "line", "edge", "beam"]
RESPONSES: tuple[Response, ...] = get_args(Response)

#: Units of the values of each response, for light of unit power, power per length, or irradiance.
UNITS: dict[Response, str] = {"radial": "1/mm^2", "line": "1/mm", "edge": "1", "beam": "1"}

_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(96)
# Nearer to a line of light than this share of a profile's reach no node could resolve the distance.
_NEAREST = 1e-12


def radial(model: Model, p: Array, r: ArrayLike) -> Array:
    """The profile itself: what a pencil of light of unit power shows at distance r.

    Args:
        model: see `profile_models`.
        p: values of its parameters, shape (n,).
        r: distances, mm, > 0, shape (m,).

    Returns:
        1/mm^2, shape (m,).

    Source: Xie 2021, section 2.3.

    Example:
        >>> from sssfit.fitting.profile_models import Burley
        >>> float(radial(Burley(), jnp.array([1.0, 1.0]), 1.0)).__round__(6)
        0.043147
    """
    return model.profile(p, r)


def line(model: Model, p: Array, x: ArrayLike) -> Array:
    """The line spread: what a line of light of unit power per mm shows at distance x.

    Args:
        model: see `profile_models`.
        p: values of its parameters, shape (n,).
        x: distance from the line, mm, of either sign, shape (m,). At 0 what a distance of 1e-12 of the
            profile's reach would show.

    Returns:
        1/mm, shape (m,); its integral over x is the profile's energy. Relative error in float64 below
        1e-9 from 1e-6 to a third of the profile's reach, beyond which little is left, and 1e-6 nearer.

    Source: the integral of R(sqrt(x^2 + y^2)) over y = x sinh u; Xie 2021, Eq 2.60.

    Example:
        >>> from sssfit.fitting.profile_models import Burley
        >>> float(line(Burley(), jnp.array([1.0, 1.0]), 1.0)).__round__(6)
        0.135091
    """
    x, u, weights = _along_line(model, p, x)
    r = x * jnp.cosh(u)
    return jnp.sum(weights * 2 * r * model.profile(p, r), axis=-1)


def edge(model: Model, p: Array, x: ArrayLike) -> Array:
    """What unit irradiance on one side of a straight edge shows at distance x into the shadow.

    Args:
        model: see `profile_models`.
        p: values of its parameters, shape (n,).
        x: signed distance, mm: above 0 in the shadow, below in the light, shape (m,).

    Returns:
        Radiant exitance over irradiance, shape (m,): half of the energy at 0, all of it deep in the light.
        Absolute error below 1e-10 of it in float64.

    Source: an integral of the line spread, by parts: the energy beyond x cosh u over pi cosh u.

    Example:
        >>> from sssfit.fitting.profile_models import Burley
        >>> float(edge(Burley(), jnp.array([0.8, 1.0]), 0.0)).__round__(6)
        0.4
    """
    signed = jnp.asarray(x)
    x, u, weights = _along_line(model, p, signed)
    shadow = jnp.sum(weights * model.beyond(p, x * jnp.cosh(u)) / jnp.cosh(u), axis=-1) / jnp.pi
    everything = model.energy(p)
    half = jnp.where(signed == 0, everything / 2, everything - shadow)
    return jnp.where(signed > 0, shadow, half)


def beam(model: Model, p: Array, r: ArrayLike, radius: ArrayLike) -> Array:
    """What unit irradiance within a circle shows at distance r from its centre.

    Args:
        model: see `profile_models`.
        p: values of its parameters, shape (n,).
        r: distances from the centre, mm, >= 0, shape (m,).
        radius: of the circle, mm, > 0, shape ().

    Returns:
        Radiant exitance over irradiance, shape (m,). Absolute error below 1e-9 of the energy in float64.

    Source: the average over directions from the point to the rim, by Green's theorem.

    Example:
        >>> from sssfit.fitting.profile_models import Burley
        >>> from sssfit.profiles import burley
        >>> middle = beam(Burley(), jnp.array([1.0, 1.0]), 0.0, 2.0)
        >>> abs(float(middle - burley.cdf(2.0, 1.0))) < 1e-6
        True
    """
    r = jnp.asarray(r)[..., None]
    nodes, node_weights = _nodes(p, r, radius)
    larger = jnp.maximum(r, radius)
    # The angle from the nearest point of the rim, stretched where the rim passes close by.
    near = jnp.abs(r - radius) / larger + 1e-7
    ends = [jnp.zeros_like(near), jnp.arcsinh(jnp.pi / near)]
    if model.is_cut_off:
        # Gauss' rule needs smooth parts: the angle is split where the rim is as far as the profile reaches.
        ends.insert(1, jnp.arcsinh(_angle_at(model.reach(p), r, radius) / near))
    u = jnp.concatenate([low + (high - low) * (nodes + 1) / 2 for low, high in pairwise(ends)], axis=-1)
    steps = [node_weights * (high - low) / 2 for low, high in pairwise(ends)]
    angle = near * jnp.sinh(u)
    weights = jnp.concatenate(steps, axis=-1) * near * jnp.cosh(u)
    versine = 2 * jnp.square(jnp.sin(angle / 2))
    square = jnp.square(r - radius) + 2 * r * radius * versine
    towards = radius * (radius - r + r * versine) / square
    distance = jnp.sqrt(square)
    # Inside, the energy within the rim; outside, less what is left beyond it, which keeps its digits.
    inside = jnp.sum(weights * towards * model.within(p, distance), axis=-1)
    outside = -jnp.sum(weights * towards * model.beyond(p, distance), axis=-1)
    return jnp.where(r[..., 0] <= radius, inside, outside) / jnp.pi


def _angle_at(distance: Array, r: Array, radius: ArrayLike) -> Array:
    """The angle of the rim's point at a distance; 0 if all are beyond it, pi if none is.

    No derivative goes through it: what is integrated is the same on both sides.
    """
    nearest = jnp.square(r - radius)
    between = (jnp.square(distance) - nearest) / jnp.maximum(4 * r * radius, jnp.finfo(nearest.dtype).tiny)
    return jax.lax.stop_gradient(2 * jnp.arcsin(jnp.sqrt(jnp.clip(between, 0, 1))))


def function(response: Response, radius: float | None = None) -> Callable[[Model, Array, Array], Array]:
    """A response by its name, as a function of a model, its parameters and the distances.

    Args:
        response: one of `RESPONSES`.
        radius: of a beam, mm, > 0; none for the others.

    Returns:
        The same function for the same arguments.

    Raises:
        ValueError: an unknown response, a beam without a radius, or a radius without a beam.

    Example:
        >>> function("radial") is radial
        True
    """
    if response not in RESPONSES:
        raise ValueError(f"response must be one of {', '.join(RESPONSES)}, got {response!r}")
    if response == "beam":
        if radius is None or not 0 < radius < np.inf:
            raise ValueError(f"beam_radius must be a length in mm above 0 for a beam, got {radius}")
        return _beam_of(float(radius))
    if radius is not None:
        raise ValueError(f"beam_radius belongs to the response 'beam', not to {response!r}")
    return {"radial": radial, "line": line, "edge": edge}[response]


@functools.cache
def _beam_of(radius: float):
    return functools.partial(_beam_with, radius=radius)


def _beam_with(model, p, r, *, radius):
    return beam(model, p, r, radius)


def _along_line(model: Model, p: Array, x: ArrayLike) -> tuple[Array, Array, Array]:
    """Distances from the line (m, 1), and nodes and weights (m, nodes) of u up to the profile's reach."""
    nodes, node_weights = _nodes(p, x)
    reach = model.reach(p)
    x = jnp.maximum(jnp.abs(jnp.asarray(x))[..., None], _NEAREST * reach)
    # Beyond its reach a profile is nothing; the nodes then only have to stay somewhere.
    end = jnp.arccosh(jnp.maximum(reach / x, 1.001))
    return x, end * (nodes + 1) / 2, node_weights * end / 2


def _nodes(*inputs: ArrayLike) -> tuple[Array, Array]:
    """The nodes in [-1, 1] and their weights, in the precision of what they are used with."""
    dtype = jnp.result_type(*inputs, 1.0)
    return jnp.asarray(_NODES, dtype), jnp.asarray(_NODE_WEIGHTS, dtype)
