"""Temporal antialiasing: the average over frames that a viewer sees, its history kept within bounds.

This is the global accumulation of a renderer, apart from the local history that guides sample counts
(`estimators.sample_count`): it has its own weight and its own lookup, and what it does to colours feeds back
into no count.

A step looks up the history where each pixel's point was, pulls it towards the new image's surroundings where
it is unlike them, and mixes the new image in with weight alpha. Colours are linear light. Karis weighs
colours by 1 / (1 + luminance), which keeps bright pixels from flickering and darkens their mean; that is left
out, since means of linear light are what is measured here. So is the reconstruction filter over the new
image's pixels: a pixel is the mean over the jittered places in its square.

Clamping has a price of its own. Where the image is noisy the box is, too, and what is pulled towards it is
biased: light of rare bright samples gets lost (Xie 2021, section 4.5). "none" has no such bias, and ghosts.

Source: Karis, "High-quality temporal supersampling", SIGGRAPH course, 2014; Salvi, "An excursion in temporal
supersampling", GDC 2016; Yang, Liu and Salvi, "A survey of temporal antialiasing techniques", 2020; Xie,
dissertation, 2021, sections 4.3 and 4.5.
"""

from functools import reduce
from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from sssfit.estimators import _recursion
from sssfit.frames import temporal

Clamping = Literal["none", "neighbourhood", "variance"]
CLAMPINGS: tuple[Clamping, ...] = get_args(Clamping)
Lookup = Literal["nearest", "bilinear", "catmull_rom"]
LOOKUPS: tuple[Lookup, ...] = get_args(Lookup)

_LONGEST = 2**16
# How far beyond the box a history may be, in roundings of the brightest light around: without this a channel
# that is the same everywhere would reject a history for its last digit.
_SLACK = 8


class Config(eqx.Module):
    """The constants of an accumulation; alpha and deviations are open to `vmap` and `grad`.

    Attributes:
        alpha: weight of the newest frame, in (0, 1], a number or a map (H, W). At 0.1 the average is as good
            as a mean over 19 frames.
        clamping: "neighbourhood", the smallest and largest value of the 3 x 3 pixels in each channel (Karis);
            "variance", their mean with `deviations` standard deviations to both sides (Salvi); "none".
        deviations: half width of the box of "variance", >= 0, a number or a map (H, W). Salvi's is 1; 0.75
            to 1.25 are in use, less ghosting against less noise.
        lookup: of the history: "catmull_rom", "bilinear" or "nearest", as in `temporal`.

    Raises:
        ValueError: a constant known to be out of its domain; traced ones pass.

    Example:
        >>> Config(alpha=0.05, clamping="variance").lookup
        'catmull_rom'
    """

    alpha: ArrayLike = 0.1
    clamping: Clamping = eqx.field(default="neighbourhood", static=True)
    deviations: ArrayLike = 1.0
    lookup: Lookup = eqx.field(default="catmull_rom", static=True)

    def __check_init__(self):
        """Refuse constants that are known to be out of their domain; traced ones pass."""
        _recursion.check_alpha(self.alpha)
        if self.clamping not in CLAMPINGS:
            raise ValueError(f"clamping must be one of {', '.join(CLAMPINGS)}, got {self.clamping!r}")
        if self.lookup not in LOOKUPS:
            raise ValueError(f"lookup must be one of {', '.join(LOOKUPS)}, got {self.lookup!r}")
        known = isinstance(self.deviations, int | float | np.ndarray | np.generic)
        if known and not np.all(np.asarray(self.deviations) >= 0):
            raise ValueError(f"deviations must be at least 0, got {self.deviations}")


#: Karis' box, the usual weight of 0.1, and the lookup that blurs least.
DEFAULT = Config()


def jitter(index: ArrayLike, length: int = 8) -> Array:
    """Where in its pixel a frame is sampled: Halton's points from the first on, over and over.

    A camera sees the image jittered by (x, y) when its principal point is moved the other way:
    `dataclasses.replace(camera, cx=camera.cx - x, cy=camera.cy - y)`. Motion stays that without jitter. The
    mean over a whole round is near 0 and not 0: (-0.055, 0) pixels for 8.

    Args:
        index: number of the frame, integer, taken modulo the length, shape (...).
        length: frames in a round, 1 to 65536.

    Returns:
        (x, y) from the pixel's centre, in pixels, y down, shape (2, ...), float32: Halton(2, 3) of index
        modulo length plus 1, minus 0.5; inside (-0.5, 0.5), within 6e-8.

    Raises:
        ValueError: the length is out of its range, or the index no integer.

    Source: Halton, "On the efficiency of certain quasi-random sequences of points in evaluating
    multi-dimensional integrals", 1960; for jitter: Karis 2014.

    Example:
        >>> [[round(float(v), 4) for v in jitter(frame)] for frame in (0, 1, 8)]
        [[0.0, -0.1667], [-0.25, 0.1667], [0.0, -0.1667]]
    """
    if not 1 <= length <= _LONGEST:
        raise ValueError(f"length must be in 1 to {_LONGEST}, got {length}")
    # Python's integers have no end, those of JAX have.
    index = jnp.asarray(index % length if isinstance(index, int) else index)
    if not jnp.issubdtype(index.dtype, jnp.integer):
        raise ValueError(f"index must be an integer, got {index.dtype}")
    if index.dtype.itemsize < 4:
        index = index.astype(jnp.int32)
    # Point 0 would be the pixel's corner.
    number = (index % length).astype(jnp.int32) + 1
    return jnp.stack([_centred_radical_inverse(number, base, length) for base in (2, 3)])


def accumulate(
    history: ArrayLike,
    image: ArrayLike,
    *,
    motion: ArrayLike | None = None,
    missing: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    previous_mask: ArrayLike | None = None,
    config: Config = DEFAULT,
) -> Array:
    """The average over frames after a new one.

    Clamping moves a history that lies outside the box of its pixel's 3 x 3 neighbours towards their mean,
    along the straight line, until it is inside (Karis' clipping). Each channel for itself would change the
    hue; and the mean, unlike the middle of the box, is a colour that is there, so that no light turns
    negative. The box is one in Y, Co and Cg, whose axes follow luminance, of Rec. 709 colours.

    Args:
        history: what this returned for the frame before, (H, W, C); anything with `missing=True` at first.
        image: the new frame, linear, (H, W, C), in the history's unit; C = 3 (Rec. 709) under clamping.
        motion: (H, W, 2), pixels, as in `temporal`; None where nothing moved.
        missing: where the history is not this pixel's, such as `temporal.disoccluded`: boolean, (H, W) or
            what broadcasts. Histories off screen or not finite are missing anyway.
        mask: which pixels of the image count, boolean, (H, W): the others are nobody's neighbours, and
            pass through. All by default. What is not finite in the image is nobody's neighbour either.
        previous_mask: which pixels of the history count in its lookup, (H, W), such as the frame before's
            mask; all by default.
        config: the constants.

    Returns:
        Shape (H, W, C), in the history's dtype, computed in float32 at least: the image where the history is
        missing, alpha is 1 or the mask leaves out; else history + alpha (image - history) with the history
        clamped. What does not fit the dtype stays at its largest number.

    Raises:
        ValueError: shapes that do not fit.

    Source: Karis 2014; Xie 2021, Eq 4.1; box of "variance": Salvi 2016.

    Example:
        >>> image, history = jnp.full((2, 2, 3), 1.0), jnp.full((2, 2, 3), 3.0)
        >>> float(accumulate(history, image, config=Config(alpha=0.25, clamping="none"))[0, 0, 0])
        2.5
        >>> float(accumulate(history, image, config=Config(alpha=0.25))[0, 0, 0]).__round__(5)
        1.0
    """
    history, image = jnp.asarray(history), jnp.asarray(image)
    _check_shapes(history, image, missing, mask, config)
    kept = jnp.result_type(float, history)
    wide = _recursion.computing_dtype(jnp.result_type(kept, image))
    inside = jnp.ones(image.shape[:2], bool) if mask is None else jnp.asarray(mask, bool)
    old = _looked_up(history, motion, previous_mask, config.lookup).astype(wide)
    fresh = ~inside | ~jnp.isfinite(old).all(axis=-1)
    if missing is not None:
        fresh = fresh | jnp.asarray(missing, bool)
    if motion is not None:
        fresh = fresh | temporal.off_screen(motion)
    # Chosen before anything is computed from it, so that no derivative comes from what is missing.
    old = jnp.where(fresh[..., None], 0, old)
    new = image.astype(wide)
    if config.clamping != "none":
        rounding = max(float(jnp.finfo(dtype).eps) for dtype in (kept, jnp.result_type(float, image)))
        old = _clamped(old, new, inside, _SLACK * rounding, config)
    alpha = jnp.where(fresh, 1, jnp.asarray(config.alpha, wide))[..., None]
    average, _ = _recursion.mean_step(old, new - old, new, alpha)
    return _recursion.within(average, kept).astype(kept)


def _check_shapes(
    history: Array, image: Array, missing: ArrayLike | None, mask: ArrayLike | None, config: Config
) -> None:
    if image.ndim != 3 or 0 in image.shape:
        raise ValueError(f"image must have shape (H, W, C) and at least one pixel, got {image.shape}")
    if history.shape != image.shape:
        raise ValueError(f"history must have the image's shape {image.shape}, got {history.shape}")
    if config.clamping != "none" and image.shape[2] != 3:
        raise ValueError(
            f"image must have 3 channels for clamping {config.clamping!r}, got shape {image.shape}; "
            "others go with 'none'"
        )
    size = image.shape[:2]
    if mask is not None and jnp.shape(mask) != size:
        raise ValueError(f"mask must have the image's shape {size}, got {jnp.shape(mask)}")
    if missing is not None:
        _recursion.check_fits("missing", jnp.shape(missing), size, "one for each pixel")
    for name, value in (("alpha", config.alpha), ("deviations", config.deviations)):
        _recursion.check_fits(name, jnp.shape(value), size, "one for each pixel")


def _looked_up(history: Array, motion: ArrayLike | None, mask: ArrayLike | None, lookup: Lookup) -> Array:
    if lookup == "nearest":
        return temporal.nearest(history, motion)
    found = temporal.bilinear if lookup == "bilinear" else temporal.catmull_rom
    return found(history, motion, mask=mask)


def _clamped(old: Array, image: Array, inside: Array, slack: float, config: Config) -> Array:
    """The history where it is in its pixel's box; else where the way from there to the mean enters it.

    All is seen from the pixel's own colour: what surroundings share costs no digits, and alike ones are
    exactly alike.
    """
    counted = inside & jnp.isfinite(image).all(axis=-1)
    image = jnp.where(counted[..., None], image, 0)
    around = [(jnp.zeros_like(image), jnp.ones_like(counted)[..., None])]
    around += [
        (jnp.where(there, colour - image, 0), there)
        for colour, there in zip(_neighbours(image), _neighbours(counted[..., None]), strict=True)
    ]
    number = reduce(jnp.add, (there.astype(image.dtype) for _, there in around))
    mean = reduce(jnp.add, (colour for colour, _ in around)) / number
    offset = old - image - mean
    below, above = _box([(_ycocg(colour - mean), there) for colour, there in around], number, config)
    brightest = reduce(jnp.maximum, (jnp.abs(colour) for colour in (image, *_neighbours(image))))
    along = _ycocg(offset)
    room = jnp.where(along < 0, below, above) + slack * brightest.max(axis=-1, keepdims=True)
    far = jnp.abs(along) > room
    # Along the straight line all channels go the same share of the way.
    share = jnp.where(far, room / jnp.where(far, jnp.abs(along), 1), 1).min(axis=-1, keepdims=True)
    return jnp.where(share < 1, image + (mean + share * offset), old)


def _box(around: list[tuple[Array, Array]], number: Array, config: Config) -> tuple[Array, Array]:
    """How far the box reaches to both sides of the mean, (H, W, 3) each; colours are seen from the mean."""
    low = reduce(jnp.minimum, (jnp.where(there, colour, jnp.inf) for colour, there in around))
    high = reduce(jnp.maximum, (jnp.where(there, colour, -jnp.inf) for colour, there in around))
    if config.clamping == "neighbourhood":
        return jnp.maximum(-low, 0), jnp.maximum(high, 0)
    # In units of the largest, whose square neither overflows nor is lost.
    largest = jnp.maximum(-low, high)
    varied = largest > 0
    unit = jnp.where(varied, largest, 1)
    squares = reduce(jnp.add, (jnp.where(there, jnp.square(colour / unit), 0) for colour, there in around))
    deviation = unit * jnp.sqrt(jnp.where(varied, squares / number, 1))
    scale = jnp.asarray(config.deviations, deviation.dtype)
    reach = jnp.where(varied, jnp.broadcast_to(scale, varied.shape[:2])[..., None] * deviation, 0)
    return reach, reach


def _neighbours(values: Array) -> list[Array]:
    """The values at the eight pixels around each, (H, W, C) each; 0 or False beyond the frame."""
    height, width = values.shape[:2]
    padded = jnp.pad(values, ((1, 1), (1, 1), (0, 0)))
    return [padded[j : j + height, i : i + width] for j in range(3) for i in range(3) if (j, i) != (1, 1)]


def _ycocg(colour: Array) -> Array:
    """Y, Co and Cg of linear RGB."""
    red, green, blue = (colour[..., i] for i in range(3))
    ends = (red + blue) / 2
    return jnp.stack([(ends + green) / 2, (red - blue) / 2, (green - ends) / 2], axis=-1)


def _centred_radical_inverse(number: Array, base: int, largest: int) -> Array:
    """The digits of a number up to `largest` in reverse behind the point, minus 0.5."""
    reversed_digits, unit = jnp.zeros_like(number), 1
    while unit <= largest:
        reversed_digits = reversed_digits * base + number % base
        number, unit = number // base, unit * base
    # Whole numbers that float32 holds, but for the quotient: nothing is lost to the subtraction.
    return (2 * reversed_digits - unit).astype(jnp.float32) / jnp.float32(2 * unit)
