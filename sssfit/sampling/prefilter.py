"""Which level of a prefiltered image stands for a sample: the fewer samples share an area, the coarser.

A sample of density p per mm^2 out of n stands for 1 / (n p) mm^2, a texel of level l for 4^l times the area
of a pixel. `level` makes the two equal. `level_published` is what the papers print, for comparison.

Source: Colbert and Krivanek, "GPU-based importance sampling", GPU Gems 3, 2007; Krivanek and Colbert,
"Real-time shading with filtered importance sampling", 2008.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.profiles._elementwise import broadcast

#: The level of a sample that stands for everything; a lookup takes the last level that its image has.
TOP = 31.0


def level(
    areal_density: ArrayLike,
    count: ArrayLike,
    pixel_area: ArrayLike,
    *,
    bias: ArrayLike = 0.0,
    top: ArrayLike = TOP,
) -> Array:
    """The level whose texel is as large as the area that a sample stands for.

    Args:
        areal_density: density of the samples where this one lies, 1/mm^2: that of the radius over its
            circle, pdf(r) / (2 pi r). Infinite, as at r = 0: level 0.
        count: how many samples, n.
        pixel_area: area in the sampling plane that a pixel covers, mm^2.
        bias: levels added, 0 or more for a smoother and more biased result; see `bias_from_scale`.
        top: the largest level to return, finite.

    Returns:
        log2(1 / (n p A)) / 2 + bias, within [0, top]. Density 0 or count 0: top. The arguments broadcast.

    Source: Krivanek and Colbert 2008, Eq 5-6.

    Example:
        >>> float(level(1 / 64, 16, 1 / 16))
        3.0
    """
    dtype, (density, count, area, bias, top) = broadcast(areal_density, count, pixel_area, bias, top)
    share = count * density * area
    # Apart from the product, which is NaN for no samples of infinite density.
    empty = (count == 0) | (density == 0) | (area == 0) | (share == 0)
    found = bias - jnp.log2(jnp.where(empty, 1, share)) / 2
    return jnp.where(empty, top, jnp.clip(found, 0, top)).astype(dtype)


def level_published(
    pdf: ArrayLike,
    count: ArrayLike,
    largest_dmfp: ArrayLike,
    depth: ArrayLike,
    aspect_ratio: ArrayLike,
    *,
    world_unit: ArrayLike = 1.0,
    scale: ArrayLike = 1 / 16,
    top: ArrayLike = TOP,
) -> Array:
    """The level as the papers print it, whose logarithm is of a quantity with a unit.

    With p in 1/mm, as the papers draw it, the argument is in 1/mm, with p in 1/mm^2 in 1/mm^2: the result
    depends on the unit of length, and the number of texels does not enter it. Evaluated in mm at usual
    depths it is 0 almost everywhere. `level` with `bias_from_scale(scale)` is what it stands for.

    Args:
        pdf: density of the sample, as the papers' pdf.
        count: how many samples, n.
        largest_dmfp: diffuse mean free path, the largest of the three channels, mm.
        depth: of the sampled point, in the unit of `world_unit`, D.
        aspect_ratio: of the screen.
        world_unit: the papers' world unit scale, w.
        scale: the papers' factor a.
        top: the largest level to return, finite; the papers have none.

    Returns:
        max(-log2(a p n / (l^2 t)), 0) / 2 with t = (w / D)^2 aspect_ratio, at most top. Where the argument
        is 0: top. The arguments broadcast.

    Source: Xie et al. 2020, Eq 22-23; Xie, dissertation, 2021, Eq 5.12-5.13.

    Example:
        >>> float(level_published(0.25, 64, 1.0, 1.0, 1.0)), float(level_published(0.25, 1, 1.0, 1.0, 1.0))
        (0.0, 3.0)
    """
    dtype, arguments = broadcast(pdf, count, largest_dmfp, depth, aspect_ratio, world_unit, scale, top)
    pdf, count, dmfp, depth, aspect_ratio, world_unit, scale, top = arguments
    texel = jnp.square(world_unit / depth) * aspect_ratio
    argument = scale * pdf * count / (jnp.square(dmfp) * texel)
    empty = (count == 0) | (pdf == 0) | (argument == 0)
    found = -jnp.log2(jnp.where(empty, 1, argument)) / 2
    return jnp.where(empty, top, jnp.clip(found, 0, top)).astype(dtype)


def bias_from_scale(scale: ArrayLike) -> Array:
    """The bias of `level` that does what the papers' factor a does.

    Args:
        scale: the factor a of the number of samples, > 0; the papers use 1/16.

    Returns:
        log2(1 / a) / 2, levels.

    Source: Xie et al. 2020, Eq 22: a stands under the logarithm beside the number of samples.

    Example:
        >>> float(bias_from_scale(1 / 16))
        2.0
    """
    dtype, (scale,) = broadcast(scale)
    return (-jnp.log2(scale) / 2).astype(dtype)
