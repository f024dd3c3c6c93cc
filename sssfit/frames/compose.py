"""From scattered irradiance to what the camera sees: the surface's colour and its gloss.

Scattering itself knows no texture. The albedo enters once, after it (post-scatter texturing: all detail
stays sharp) or in two halves, sqrt(albedo) before and sqrt(albedo) after (pre- and post-scatter: detail
blurs as light that enters and leaves at different colours blurs it). On a uniform albedo both are the same.

Source: d'Eon and Luebke, "Advanced techniques for realistic real-time skin rendering", GPU Gems 3, 2007.
"""

from typing import Literal

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

Texturing = Literal["post", "pre_and_post"]


def irradiance_for(texturing: Texturing, irradiance: ArrayLike, albedo: ArrayLike) -> Array:
    """What must be scattered so that `compose` of the same texturing gives the radiance.

    Args:
        texturing: "post" or "pre_and_post".
        irradiance: E, linear, shape (H, W, 3) or (..., 3).
        albedo: of the surface, in [0, 1], same shape or one that broadcasts; unused by "post".

    Returns:
        E, or E sqrt(albedo); in the unit of E.

    Raises:
        ValueError: texturing is neither.

    Source: d'Eon and Luebke 2007.

    Example:
        >>> irradiance_for("pre_and_post", 2.0, 0.25).tolist(), irradiance_for("post", 2.0, 0.25).tolist()
        (1.0, 2.0)
    """
    dtype = jnp.result_type(float, irradiance, albedo)
    irradiance, albedo = jnp.broadcast_arrays(jnp.asarray(irradiance, dtype), jnp.asarray(albedo, dtype))
    return irradiance * _root(albedo) if _is_split(texturing) else irradiance


def compose(
    scattered: ArrayLike,
    albedo: ArrayLike,
    *,
    specular: ArrayLike | None = None,
    texturing: Texturing = "post",
) -> Array:
    """The radiance of a textured surface from its scattered irradiance.

    Args:
        scattered: what scattering made of `irradiance_for` of the same texturing, for albedo 1, linear, shape
            (H, W, 3) or (..., 3), in the unit of E. Unscattered E gives the Lambert surface.
        albedo: of the surface, in [0, 1], same shape or one that broadcasts. 0 is black, 1 leaves the
            scattered light as it is; others are not clipped, and under "pre_and_post" negative ones are NaN.
        specular: radiance added as it is, same shape; None for none.
        texturing: "post", or "pre_and_post" for the half of the albedo that comes after.

    Returns:
        scattered albedo / pi, or scattered sqrt(albedo) / pi, plus specular: radiance, in the unit of E per
        steradian.

    Raises:
        ValueError: texturing is neither.

    Source: d'Eon and Luebke 2007.

    Example:
        >>> float(compose(jnp.pi, 0.25, specular=1.0))
        1.25
        >>> float(compose(jnp.pi, 0.25, texturing="pre_and_post"))
        0.5
    """
    lights = [scattered] if specular is None else [scattered, specular]
    dtype = jnp.result_type(float, albedo, *lights)
    albedo = jnp.asarray(albedo, dtype)
    colour = _root(albedo) if _is_split(texturing) else albedo
    radiance = jnp.asarray(scattered, dtype) * colour / jnp.pi
    return radiance if specular is None else radiance + jnp.asarray(specular, dtype)


def _is_split(texturing: str) -> bool:
    if texturing not in ("post", "pre_and_post"):
        raise ValueError(f'texturing must be "post" or "pre_and_post", got {texturing!r}')
    return texturing == "pre_and_post"


def _root(albedo: Array) -> Array:
    """Square root with derivative 0 at 0, where the true one is infinite."""
    black = albedo == 0
    return jnp.where(black, 0, jnp.sqrt(jnp.where(black, 1, albedo)))
