"""What a frame's samples are: radii and directions from a sequence, and the weights that keep them unbiased.

`Settings` says how samples are drawn and counted. `table` draws them once for all pixels, in sixteen versions
that a pixel picks from and turns by an angle of its own.
"""

import functools
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames import pixel_kernel
from sssfit.sampling import disk, hashes, inverse_cdf, sequences

Channels = Literal["mixture", "widest"]
Estimator = Literal["unbiased", "ratio"]
Distance = Literal["surface", "plane"]
Plane = Literal["screen", "tangent"]
Sequence = Literal["r2", "iid", "sobol", "hammersley", "fibonacci"]

#: Versions of a table: neighbours in a row differ, and the lanes of a vector unit each have theirs.
VERSIONS = 16


class Settings(NamedTuple):
    """How a frame is sampled; every field is known when the program is compiled.

    Attributes:
        importance: which of `inverse_cdf.METHODS` draws the radius.
        corrected: weigh each sample by profile density / drawn density; False leaves that out, as the papers
            do, and with it their bias.
        channels: "mixture" draws each radius for one of the channels at random and uses it for all, with the
            balance heuristic's weights; "widest" draws for the channel with the largest d.
        estimator: "unbiased", where nothing lies beyond the frame or behind its surface; or "ratio", the
            papers' weighted mean of the samples that hit.
        distance: "surface" for the straight line to the surface that a sample hits; "plane" for the radius
            itself, which is right where depth is constant and costs less.
        plane: "screen" for a sampling plane parallel to the screen, "tangent" for the surface's own.
        sequence: how the points of `sampling.sequences` are spread: "r2" and "sobol" evenly from the first
            on, "hammersley" and "fibonacci" only all together, for pixels with the largest count, and "iid"
            independently.
        cutoff: radius in d beyond which the profile is zero, the rest scaled to integrate to 1; None for all.
    """

    importance: str = "log_poly12"
    corrected: bool = True
    channels: Channels = "mixture"
    estimator: Estimator = "unbiased"
    distance: Distance = "surface"
    plane: Plane = "screen"
    sequence: Sequence = "r2"
    cutoff: float | None = 16.0

    def check(self) -> None:
        """Raise ValueError where a field has a value that is not known."""
        known = {
            "importance": tuple(inverse_cdf.METHODS),
            "channels": get_args(Channels),
            "estimator": get_args(Estimator),
            "distance": get_args(Distance),
            "plane": get_args(Plane),
            "sequence": get_args(Sequence),
        }
        for name, values in known.items():
            if getattr(self, name) not in values:
                raise ValueError(f"{name} must be one of {', '.join(values)}, got {getattr(self, name)!r}")
        if self.cutoff is not None and not self.cutoff > 0:
            raise ValueError(f"cutoff must be above 0 or None, got {self.cutoff}")


class Table(NamedTuple):
    """Samples for all pixels, arrays of shape (samples, VERSIONS).

    What does not depend on the pixel is here, so that it is computed once.

    Attributes:
        x, y: offset in the sampling plane, mm.
        scale: 1 / drawn density, per unit of radius, mm: the factor of a channel's radial density at the
            distance that a sample turns out to have.
        radius: length of the offset, mm.
        weights: of each channel, where the distance is the radius.
        d: shape parameter of each channel, mm, (C,).
    """

    x: Array
    y: Array
    scale: Array
    radius: Array
    weights: list[Array]
    d: Array


def table(samples: int, d: Array, settings: Settings, *, seed: Array, frame: Array) -> Table:
    """Draw the samples of a frame.

    Args:
        samples: how many for each pixel at most, on the host; a pixel uses the first of them.
        d: shape parameter of each channel, mm, (C,), > 0.
        settings: see `Settings`.
        seed, frame: integers; other ones give independent tables.

    Returns:
        See `Table`. Over seeds every sample alone is drawn exactly from the profiles, so that means of
        weighted samples are unbiased.

    Source: Xie et al. 2020, Eq 19 and 21, with the exact weight; mixture: Veach's balance heuristic, 1997.

    Example:
        >>> drawn = table(64, jnp.array([1.0, 0.5, 0.2]), Settings(), seed=0, frame=0)
        >>> drawn.x.shape
        (64, 16)
    """
    method = inverse_cdf.METHODS[settings.importance]
    shift = hashes.pcg3d(jnp.arange(VERSIONS), frame, seed)
    # A stream apart from that of the pixels' rotations.
    shift = hashes.pcg3d(shift[0], shift[1], jnp.uint32(0x9E3779B9))[:2, None]
    variate, turn = _drawn(settings.sequence, jnp.arange(samples)[:, None], samples, shift)
    if settings.channels == "widest":
        drawn_for = jnp.broadcast_to(jnp.max(d), variate.shape)
    else:
        # The variate's first digits choose the channel, the rest its radius: still evenly spread.
        variate = variate * len(d)
        channel = jnp.minimum(variate.astype(jnp.int32), len(d) - 1)
        variate, drawn_for = variate - channel, d[channel]
    # A radius in the plane may exceed the distance of what is seen there: then none is left out.
    cutoff = settings.cutoff if settings.distance == "plane" else None
    last = _last_variate(settings.importance, cutoff)
    variate = variate * last
    radius = method.radius(variate, drawn_for)
    x, y = jnp.moveaxis(disk.offsets(radius, turn), -1, 0)
    drawn = method.pdf(variate, drawn_for) / last
    own = density(radius, drawn_for, cutoff)
    if not settings.corrected:
        drawn = own
    if settings.channels == "mixture":
        # The share of this channel among all that could have drawn the radius, times 1 / its density.
        every = sum(density(radius, shape, cutoff) for shape in d) / len(d)
        scale = own / (drawn * jnp.where(every > 0, every, 1))
    else:
        scale = 1 / drawn
    scale = jnp.where(own > 0, scale, 0)
    weights = [scale * density(radius, shape, settings.cutoff) for shape in d]
    return Table(x, y, scale, radius, weights, d)


def _drawn(sequence: Sequence, index: Array, count: int, shift: Array) -> Array:
    if sequence in ("hammersley", "fibonacci"):
        return getattr(sequences, sequence)(index, count, shift)
    return {"r2": sequences.r2, "iid": sequences.hashed, "sobol": sequences.sobol}[sequence](index, shift)


def density(r: ArrayLike, d: ArrayLike, cutoff: float | None) -> Array:
    """Radial density of the profile that ends at the cut-off, 1/mm.

    Args:
        r: distance, mm.
        d: shape parameter, mm, > 0.
        cutoff: in d; None for the whole profile.

    Source: Christensen and Burley 2015.

    Example:
        >>> float(density(jnp.array(17.0), jnp.array(1.0), 16.0))
        0.0
    """
    r, d = jnp.asarray(r), jnp.asarray(d)
    slow = jnp.exp(-r / (3 * d))
    whole = slow * (1 + jnp.square(slow)) / (4 * d)
    if cutoff is None:
        return whole
    return jnp.where(r <= cutoff * d, whole / float(pixel_kernel.cdf(np.array(cutoff))), 0)


@functools.cache
def _last_variate(importance: str, cutoff: float | None) -> float:
    """The variate whose radius is the cut-off, so that none is drawn in vain where radii increase with it."""
    # The mixture of exponentials has no order; what it draws beyond the cut-off is given no weight.
    if cutoff is None or importance == "mixture":
        return 1.0
    radius = inverse_cdf.METHODS[importance].radius
    low, high = 0.0, 1.0
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if float(radius(middle, 1.0)) < cutoff else (low, middle)
    return high
