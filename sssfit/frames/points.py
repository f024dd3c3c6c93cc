"""What a frame's samples are: radii and directions from a sequence, and the weights that keep them unbiased.

`Settings` says how samples are drawn and counted. `aimed` draws them for any pixels and `weighed` weighs
them; `table` makes sixteen versions for all pixels to pick from, each pixel turning them by its own angle.
"""

import functools
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.frames import pixel_kernel
from sssfit.frames._desk import Keep
from sssfit.profiles import burley
from sssfit.sampling import disk, hashes, inverse_cdf, sequences

Channels = Literal["mixture", "widest", "each"]
Estimator = Literal["unbiased", "ratio"]
Distance = Literal["surface", "plane"]
Plane = Literal["screen", "tangent"]
Points = Literal["table", "fresh"]
Sequence = Literal["r2", "iid", "sobol", "hammersley", "fibonacci"]

#: Versions of a table: neighbours in a row differ, and the lanes of a vector unit each have theirs.
VERSIONS = 16
#: Approximate inverse cdfs draw a radius up to a tenth smaller than the exact one; what they draw within the
#: inner radius of `Inner` gets no weight.
_MARGIN = 0.9


class Settings(NamedTuple):
    """How a frame is sampled; every field is known when the program is compiled.

    Attributes:
        importance: which of `inverse_cdf.METHODS` draws the radius.
        corrected: weigh each sample by profile density / drawn density; False leaves that out, as the papers
            do, and with it their bias.
        channels: "mixture" draws each radius for one of the channels at random and uses it for all, with the
            balance heuristic's weights; "widest" draws for the channel with the largest d; "each" draws for
            the channels in turn and uses a sample for its own channel alone.
        estimator: "unbiased", where nothing lies beyond the frame or behind its surface; or "ratio", the
            papers' weighted mean of the samples that hit; a pixel none of whose samples hits keeps its light.
        distance: "surface" for the straight line to the surface that a sample hits; "plane" for the radius
            itself, which is right where depth is constant and costs less.
        plane: "screen" for a sampling plane parallel to the screen, "tangent" for the surface's own.
        points: "table" for a table that all pixels share, in versions turned by an angle of each pixel;
            "fresh" for radii and angles of each pixel's own.
        sequence: how the points of `sampling.sequences` are spread: "r2" and "sobol" evenly from the first
            on, "hammersley" and "fibonacci" only all together, for pixels with the largest count, and "iid"
            independently.
        cutoff: radius in d beyond which the profile is zero, the rest scaled to integrate to 1; None for all.
        split: what scatters within a pixel's own footprint is taken from its irradiance, and samples go
            beyond; where less than this share of the widest channel goes beyond, none is drawn. Needs fresh
            points. On a screen plane surfaces that lean away lose light, for the share is that of a disc that
            faces the screen: up to a sixth in a profile as narrow as a pixel, less the wider it is. None: all
            is sampled.
        prefilter: the papers' factor a, > 0, of the number of samples that the level of a prefiltered copy of
            the irradiance is chosen for: the smaller, the smoother and the more biased; 0.0625 in the papers,
            1 for texels as large as the area that a sample stands for. None: the irradiance itself.
    """

    importance: str = "log_poly12"
    corrected: bool = True
    channels: Channels = "mixture"
    estimator: Estimator = "unbiased"
    distance: Distance = "surface"
    plane: Plane = "screen"
    points: Points = "table"
    sequence: Sequence = "r2"
    cutoff: float | None = 16.0
    split: float | None = None
    prefilter: float | None = None

    def check(self) -> None:
        """Raise ValueError where a field has a value that is not known."""
        known = {
            "importance": tuple(inverse_cdf.METHODS),
            "channels": get_args(Channels),
            "estimator": get_args(Estimator),
            "distance": get_args(Distance),
            "plane": get_args(Plane),
            "points": get_args(Points),
            "sequence": get_args(Sequence),
        }
        for name, values in known.items():
            if getattr(self, name) not in values:
                raise ValueError(f"{name} must be one of {', '.join(values)}, got {getattr(self, name)!r}")
        if self.cutoff is not None and not self.cutoff > 0:
            raise ValueError(f"cutoff must be above 0 or None, got {self.cutoff}")
        if self.split is not None and not 0 <= self.split <= 1:
            raise ValueError(f"split must be a share within [0, 1] or None, got {self.split}")
        if self.split is not None and self.points != "fresh":
            raise ValueError("split needs points of each pixel's own: set points to 'fresh'")
        if self.prefilter is not None and not self.prefilter > 0:
            raise ValueError(f"prefilter must be above 0 or None, got {self.prefilter}")

    def once_drawn(self) -> "Settings":
        """The same but for what no longer matters when a table is there: equal ones share their programs."""
        if self.points == "fresh":
            return self
        how = ("importance", "corrected", "channels", "sequence")
        return self._replace(**{name: self._field_defaults[name] for name in how})


class Aim(NamedTuple):
    """Where samples lie around a pixel, arrays of any one shape.

    Attributes:
        x, y: offset in the sampling plane, mm.
        radius: length of the offset, mm.
        density: with which the radius was drawn for its channel, 1/mm.
        channel: for which the radius was drawn.
    """

    x: Array
    y: Array
    radius: Array
    density: Array
    channel: Array


class Samples(NamedTuple):
    """Samples around a pixel, arrays of any one shape.

    Attributes:
        x, y: offset in the sampling plane, mm.
        spacing: 1 / drawn density, per unit of radius, mm: the factor of a channel's radial density at the
            distance that a sample turns out to have.
        radius: length of the offset, mm.
        channel: the only one that uses the sample, with a factor of the number of channels; None where all
            do.
        weights: of each channel, where the distance is the radius; none for other settings.
    """

    x: Array
    y: Array
    spacing: Array
    radius: Array
    channel: Array | None
    weights: tuple[Array, ...]

    def of_channel(self, number: int, weight: Array, channels: int) -> Array:
        """A sample's weight in one of the channels, 0 where the sample is another channel's."""
        if self.channel is None:
            return weight
        return jnp.where(self.channel == number, weight * channels, 0)


class Inner(NamedTuple):
    """A disc around each pixel in which nothing is drawn.

    Attributes:
        radius: mm.
        share: of each channel's density that it holds.
        drawn_from: the variate of each channel below which none is used.
    """

    radius: Array
    share: tuple[Array, ...]
    drawn_from: tuple[Array, ...]


def inner(radius: ArrayLike, d: Array, settings: Settings) -> Inner:
    """The disc of a radius, for `aimed`.

    Args:
        radius: mm, >= 0.
        d: shape parameter of each channel, mm, (C,), > 0.
        settings: see `Settings`.

    Source: Xie and Olano 2021, Eq 15; the margin is for inverse cdfs that are not exact.

    Example:
        >>> float(inner(1.0, jnp.array([1.0]), Settings(cutoff=None)).share[0]).__round__(5)
        0.37063
    """
    radius = jnp.asarray(radius)
    share = tuple(jnp.minimum(burley.cdf(radius, shape) / _within(settings.cutoff), 1) for shape in d)
    # The mixture of exponentials is not ordered by its variate: all of it is drawn.
    ordered = settings.importance != "mixture"
    start = tuple(burley.cdf(_MARGIN * radius * ordered, shape) for shape in d)
    return Inner(radius, share, start)


def table(
    samples: int, d: Array, settings: Settings, *, count: ArrayLike | None = None, seed: Array, frame: Array
) -> Samples:
    """Draw the samples of a frame, for all pixels.

    Args:
        samples: how many for each pixel at most, on the host; a pixel uses the first of them.
        d: shape parameter of each channel, mm, (C,), > 0.
        settings: see `Settings`.
        count: the largest count of a pixel, for sequences that need it; by default `samples`.
        seed, frame: integers; other ones give independent tables.

    Returns:
        See `Samples`, of shape (samples, VERSIONS). Over seeds every sample alone is drawn exactly from the
        profiles, so that means of weighted samples are unbiased.

    Source: as `aimed` and `weighed`.

    Example:
        >>> found = table(64, jnp.array([1.0, 0.5, 0.2]), Settings(), seed=0, frame=0)
        >>> found.x.shape
        (64, 16)
    """
    count = samples if count is None else count
    start = hashes.pcg3d(jnp.arange(VERSIONS), frame, seed)
    # A stream apart from that of the pixels' rotations.
    start = hashes.pcg3d(start[0], start[1], jnp.uint32(0x9E3779B9))[:, None]
    aim = aimed(jnp.arange(samples)[:, None], start, d, settings, count=count)
    return weighed(aim, d, settings)


def aimed(
    index: ArrayLike,
    start: Array,
    d: Array,
    settings: Settings,
    *,
    count: ArrayLike,
    beyond: Inner | None = None,
    keep: Keep = lambda value: value,
) -> Aim:
    """Draw samples, without their weights.

    Args:
        index: number of the sample, integer, shape (...).
        start: where a pixel's sequence starts, three words of uniformly random bits, uint32, (3, ...).
        d: shape parameter of each channel, mm, (C,), > 0.
        settings: see `Settings`.
        count: the largest count of a pixel, for sequences that need it.
        beyond: a disc in which none is drawn.
        keep: what is applied to results that are used more than once.

    Returns:
        See `Aim`.

    Source: Xie et al. 2020, Eq 19 and 21; Xie and Olano 2021, Eq 15.

    Example:
        >>> start = jnp.arange(3, dtype=jnp.uint32)[:, None]
        >>> aimed(jnp.arange(8), start, jnp.array([1.0]), Settings(), count=8).radius.shape
        (8,)
    """
    method = inverse_cdf.METHODS[settings.importance]
    channels = len(d)
    index = jnp.asarray(index)
    if settings.channels == "each":
        channel = (index + (start[2] % channels).astype(jnp.int32)) % channels
        index, count = index // channels, -(-jnp.asarray(count) // channels)
    variate, turn = _points(settings.sequence, index, count, start[:2])
    if settings.channels == "widest":
        channel = jnp.broadcast_to(jnp.argmax(d), variate.shape)
    elif settings.channels == "mixture":
        # The variate's first digits choose the channel, the rest its radius: still evenly spread.
        channel = jnp.minimum((variate * channels).astype(jnp.int32), channels - 1)
        variate = variate * channels - channel
    drawn_for = _of(channel, list(d))
    first = _of(channel, list(beyond.drawn_from)) if beyond else 0.0
    span = _span(settings, first)
    variate = first + variate * span
    radius = keep(method.radius(variate, drawn_for))
    cosine, sine = disk.rotation(turn)
    return Aim(radius * cosine, radius * sine, radius, method.pdf(variate, drawn_for) / span, channel)


def weighed(
    aim: Aim,
    d: Array,
    settings: Settings,
    beyond: Inner | None = None,
    keep: Keep = lambda value: value,
) -> Samples:
    """The weights of what was drawn.

    Args:
        aim: from `aimed`, with the same other arguments.
        d: shape parameter of each channel, mm, (C,), > 0.
        settings: see `Settings`.
        beyond: the disc in which none is drawn; what remains is weighted as it is, and its weights average
            to 1 - share.
        keep: what is applied to results that are used more than once.

    Returns:
        See `Samples`.

    Source: Xie et al. 2020, Eq 19 and 21, with the exact weight; Xie and Olano 2021, Eq 15; mixture: Veach's
    balance heuristic, 1997.

    Example:
        >>> aim = Aim(jnp.array(1.0), jnp.array(0.0), jnp.array(1.0), jnp.array(0.5), jnp.array(0))
        >>> float(weighed(aim, jnp.array([1.0]), Settings(importance="log_linear")).spacing).__round__(5)
        2.0
    """
    channels = len(d)
    cutoff = _drawn_cutoff(settings)
    every = [keep(density(aim.radius, shape, cutoff)) for shape in d]
    own = _of(aim.channel, every)
    starts = list(beyond.drawn_from) if beyond else [0.0] * channels
    spans = [_span(settings, start) for start in starts]
    # The channel's density over what was drawn of it, and over the share of its variates.
    if not settings.corrected:
        over_drawn = (1 - _of(aim.channel, starts)) / _of(aim.channel, spans)
    elif inverse_cdf.METHODS[settings.importance].draws_profile:
        over_drawn = 1 / _within(cutoff)
    else:
        over_drawn = own / (_of(aim.channel, spans) * aim.density)
    if settings.channels == "mixture":
        # The share of this channel among all that could have drawn the radius, times 1 / its density.
        among = sum(one / span for one, span in zip(every, spans, strict=True)) / channels
        spacing = over_drawn / jnp.where(among > 0, among, 1)
    else:
        spacing = over_drawn * _of(aim.channel, spans) / jnp.where(own > 0, own, 1)
    used = own > 0
    if beyond is not None:
        used = used & (aim.radius >= beyond.radius)
    spacing = keep(jnp.where(used, spacing, 0))
    only = aim.channel if settings.channels == "each" else None
    found = Samples(aim.x, aim.y, spacing, aim.radius, only, ())
    weights = every if settings.distance == "plane" else []
    return found._replace(
        weights=tuple(found.of_channel(c, spacing * one, channels) for c, one in enumerate(weights))
    )


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
    # What does not depend on r is divided once for all; without the barrier XLA squares by a second exp.
    slow = jax.lax.optimization_barrier(jnp.exp(r * (-1 / (3 * d))))
    whole = slow * (1 + jnp.square(slow)) * (1 / (4 * d))
    if cutoff is None:
        return whole
    return jnp.where(r <= cutoff * d, whole * (1 / _within(cutoff)), 0)


def _within(cutoff: float | None) -> float:
    """The share of the whole profile within the cut-off."""
    return 1.0 if cutoff is None else float(pixel_kernel.cdf(np.array(cutoff)))


def _drawn_cutoff(settings: Settings) -> float | None:
    # A radius in the plane may exceed the distance of what is seen there: then none is left out.
    return settings.cutoff if settings.distance == "plane" else None


def _span(settings: Settings, first: ArrayLike) -> Array:
    """How many of the variates are used, from the first on."""
    # The profile may end within the disc: nothing is drawn then, and no division is by 0.
    return jnp.maximum(_last_variate(settings.importance, _drawn_cutoff(settings)) - first, 2.0**-24)


def _points(sequence: Sequence, index: Array, count: ArrayLike, shift: Array) -> Array:
    if sequence in ("hammersley", "fibonacci"):
        return getattr(sequences, sequence)(index, count, shift)
    return {"r2": sequences.r2, "iid": sequences.hashed, "sobol": sequences.sobol}[sequence](index, shift)


def _of(channel: Array, values: list[Any]) -> Array:
    """The value of each sample's channel, without a lookup."""
    found = values[0]
    for number, value in enumerate(values[1:], 1):
        found = jnp.where(channel == number, value, found)
    return jnp.asarray(found)


@functools.cache
def _last_variate(importance: str, cutoff: float | None) -> float:
    """The variate whose radius is the cut-off, so that none is drawn in vain where radii increase with it."""
    # The mixture of exponentials has no order; what it draws beyond the cut-off is given no weight.
    if cutoff is None or importance == "mixture":
        return 1.0
    # One program in place of one for each operation.
    radius = jax.jit(inverse_cdf.METHODS[importance].radius)
    low, high = 0.0, 1.0
    with jax.enable_x64(True), jax.ensure_compile_time_eval():
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if float(radius(middle, 1.0)) < cutoff else (low, middle)
    return high
