"""Scattering within a pixel's own footprint apart from scattering beyond it.

Light that leaves where it came in, as far as a pixel can tell, needs no sample: it is the pixel's own
irradiance times the share of the profile within the footprint. Samples go beyond it, and where next to
nothing scatters that far, there need be none.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames.camera import Camera
from sssfit.frames.points import Settings
from sssfit.profiles import burley


def radius(depth: ArrayLike, camera: Camera) -> Array:
    """Radius of the disc that counts as a pixel's own.

    Args:
        depth: mm along the viewing axis, > 0, shape (...).
        camera: see `camera.Camera`.

    Returns:
        Half the diagonal of the pixel's footprint in a plane parallel to the screen, mm, shape (...).

    Source: Xie and Olano 2021, Section 4.1.

    Example:
        >>> from sssfit.frames.camera import orthographic
        >>> float(radius(500.0, orthographic(8, 4, 0.3))).__round__(5)
        0.21213
    """
    across, up = camera.pixels_per_mm(jnp.asarray(depth))
    return jnp.hypot(1 / across, 1 / up) / 2


def distant_share(depth: ArrayLike, camera: Camera, d: ArrayLike, settings: Settings) -> Array:
    """Share of the widest channel that scatters beyond a pixel's own disc.

    Args:
        depth: mm along the viewing axis, > 0, shape (...).
        camera: see `camera.Camera`.
        d: shape parameter of each channel, mm, (C,), > 0.
        settings: see `points.Settings`.

    Returns:
        In [0, 1], shape (...): 1 - cdf(radius), 0 beyond the cut-off; 1 at depth 0. In float32 off by less
        than 3e-7 / cdf(cutoff).

    Source: Xie and Olano 2021, Eq 16, gamma for Burley's profile.

    Example:
        >>> from sssfit.frames.camera import orthographic
        >>> camera = orthographic(8, 4, 0.3)
        >>> [round(float(distant_share(500.0, camera, [d], Settings())), 3) for d in (1.0, 0.01)]
        [0.901, 0.0]
    """
    within = 1.0 if settings.cutoff is None else burley.cdf(settings.cutoff, 1.0)
    # As burley.sf by a single exponential: a difference has no digits for it to keep in the tail, and a whole
    # frame of shares is computed in a quarter of the time.
    slow = jnp.exp(radius(depth, camera) / jnp.max(jnp.asarray(d, jnp.float32)) * (-1 / 3))
    beyond = slow * (jnp.square(slow) + 3) / 4
    return jnp.clip((beyond - (1 - within)) / within, 0, 1)


def counts(counts: ArrayLike, share: ArrayLike, least_share: ArrayLike) -> Array:
    """Samples that go beyond a pixel's own disc, of those that the whole profile was to have.

    Args:
        counts: samples of the whole profile, integers, shape (...).
        share: from `distant_share`, shape (...).
        least_share: the papers' epsilon_u: pixels with a smaller share get no sample, which leaves their
            irradiance as it is. The papers use 0.01 and show 0.05.

    Returns:
        int32, shape (...): counts times share, rounded up.

    Source: Xie and Olano 2021, Eq 18.

    Example:
        >>> counts(64, jnp.array([0.9, 0.5, 0.004]), 0.01).tolist()
        [58, 32, 0]
    """
    wanted = jnp.ceil(jnp.asarray(counts) * jnp.asarray(share)).astype(jnp.int32)
    return jnp.where(jnp.asarray(share) < least_share, 0, wanted)
