"""The circle's and the line's simulation once more: in NumPy, and as a loop compiled by Numba.

Both follow the same law as `sssfit.scenarios`, from a disocclusion on: the same controllers, and independent
samples of the same distribution. Burley's profile is a mixture of two exponential distributions, so that one
logarithm of a variate and two more random bits give an exact radius, which no inverse of the cdf does for as
little. They draw no sample that is not used, and keep two sums of a seed instead of its whole record.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

#: Samples that NumPy draws at a time at most: more do not fit into the cache, fewer make the calls dear.
CHUNK = 2**17
#: What a step of SplitMix64 adds, and its multipliers.
STEP, FIRST, SECOND = (np.uint64(v) for v in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
UNIT = np.float32(2.0**-24)
ONE, THREE, HALF, QUARTER = (np.float32(value) for value in (1, 3, 0.5, 0.25))
#: sin(pi s) / s in powers of s^2, from the sixth on downwards; what is left is below float32's rounding.
SINE = tuple(
    np.float32((-1) ** k * math.pi ** (2 * k + 1) / math.factorial(2 * k + 1)) for k in range(6, -1, -1)
)


class Scene(NamedTuple):
    """What is simulated, arrays of float32, (frames, pixels).

    irradiance: of each texel; for the circle, of the one pixel within it. light: what a controller knows of a
    frame before it. truth: the exact results. texels_per_d: Burley's shape parameter; None for the circle.
    """

    irradiance: np.ndarray
    light: np.ndarray
    truth: np.ndarray
    texels_per_d: float | None


class Outcome(NamedTuple):
    """Mean count and mean squared error of each seed over its frames and pixels, (seeds,)."""

    count: np.ndarray
    squared_error: np.ndarray


class Controller(NamedTuple):
    """Functions of numbers for Numba, of arrays for NumPy; a pixel remembers four numbers, zeros at first.

    count(light, *memory) is how many samples it draws, and learn(is_first, drawn, mean, square_deviation,
    light, *memory) its memory after that.
    """

    count: Callable
    learn: Callable


class Bounds(NamedTuple):
    """Target variance of a frame's result, and bounds of the count."""

    target: float
    least: float = 8
    most: float = 64


def adaptive(bounds: Bounds, alpha: float, kappa: float) -> Controller:
    """Adaptive sampling of the papers: moving means of count and result, and the result's variance."""
    target, least, most = bounds
    gain = kappa * (2 / alpha - 2)

    def count(light, mean_count, mean, variance, nothing):
        ratio = variance / target
        return np.rint(np.minimum(np.maximum(mean_count * (ratio + gain * (ratio - 1)), least), most))

    def learn(is_first, drawn, mean, square_deviation, light, mean_count, old_mean, variance, nothing):
        if is_first:
            return drawn, mean, target + nothing, nothing
        change = mean - old_mean
        variance = (1 - alpha) * (variance + alpha * change * change)
        return mean_count + alpha * (drawn - mean_count), old_mean + alpha * change, variance, nothing

    return Controller(count, learn)


def in_frame(bounds: Bounds, alpha: float) -> Controller:
    """`sssfit.estimators.in_frame`: fading sums of what the samples of a frame vary by themselves."""
    target, least, most = bounds

    def count(light, total, degrees, lit_degrees, uncertainty):
        # Where nothing was seen all are 0.
        safety = 1 + uncertainty / np.maximum(total * total, 1e-300)
        expected = total / np.maximum(degrees, 1) * (light * light + target)
        return np.rint(np.minimum(np.maximum(expected * safety / target, least), most))

    def learn(is_first, drawn, mean, square_deviation, light, total, degrees, lit_degrees, uncertainty):
        scale, new = light * light + target, drawn - 1
        lit = light * light / scale
        is_dark = (lit < 0.5) & (mean * mean < scale) & (square_deviation < new * scale)
        is_lamp_off = is_dark & (lit_degrees > degrees / 2)
        # 1 and 0 in place of branches, which arrays do not have; what stays dark forgets nothing.
        kept = 1 - ((lit >= 0.5) & (lit_degrees < degrees / 2))
        learned, faded = 1 - is_lamp_off, 1 - alpha * (1 - is_lamp_off)
        total, degrees, lit_degrees = kept * total, kept * degrees, kept * lit_degrees
        relative, seen = square_deviation / scale, degrees > 0
        foreseen = relative - new * total / np.maximum(degrees, 1)
        surprise = seen * foreseen + (1 - seen) * np.sqrt(2 / new) * relative
        return (
            faded * total + learned * relative,
            faded * degrees + learned * new,
            faded * lit_degrees + learned * new * lit,
            faded * faded * kept * uncertainty + learned * surprise * surprise,
        )

    return Controller(count, learn)


def by_numpy(scene: Scene, controller: Controller, bounds: Bounds, seeds: int) -> Outcome:
    """All seeds, on one core; some of them side by side, and their samples in a row without gaps."""
    together = max(1, int(CHUNK // (scene.light.shape[1] * bounds.most)))
    parts = [
        _numpy_block(scene, controller, min(together, seeds - first), np.random.SFC64([0, first]))
        for first in range(0, seeds, together)
    ]
    return Outcome(*(np.concatenate(sums) for sums in zip(*parts, strict=True)))


def _numpy_block(scene: Scene, controller: Controller, seeds: int, bits: np.random.SFC64) -> Outcome:
    frames, pixels = scene.light.shape
    random, sampled = np.random.Generator(bits), np.zeros((2, seeds))
    memory = (np.zeros((seeds, pixels)),) * 4
    centres = np.tile(np.arange(pixels, dtype=np.float32) + HALF, seeds)
    for frame in range(frames):
        light = scene.light[frame].astype(np.float64)
        count = controller.count(light, *memory)
        whole = count.ravel().astype(np.intp)
        found = _numpy_samples(random, scene, frame, centres, whole)
        # No count is 0, so that each sum begins where the one before it ends.
        starts = np.cumsum(whole) - whole
        total, squares = (
            np.add.reduceat(values, starts).astype(np.float64).reshape(seeds, pixels)
            for values in (found, found * found)
        )
        mean = total / count
        deviation = np.maximum(squares - total * mean, 0)
        memory = controller.learn(frame == 0, count, mean, deviation, light, *memory)
        sampled += count.mean(axis=1), np.square(mean - scene.truth[frame]).mean(axis=1)
    return Outcome(*(sampled / frames))


def _numpy_samples(
    random: np.random.Generator, scene: Scene, frame: int, centres: np.ndarray, count: np.ndarray
) -> np.ndarray:
    """Values of all samples, pixel after pixel."""
    words = random.integers(0, 2**64, count.sum(), dtype=np.uint64).view(np.uint32).reshape(2, -1)
    variates = (words >> 8).astype(np.float32)
    variates *= UNIT
    first, second = variates
    row = scene.irradiance[frame]
    if scene.texels_per_d is None:
        first -= HALF
        second -= HALF
        return (first * first + second * second < QUARTER) * row[0]
    # 1 and 3 times d, the second three times as often; from bits that the variate has no room for.
    offset = (words[0] & 3 != 0) * np.float32(-2 * scene.texels_per_d)
    offset -= np.float32(scene.texels_per_d)
    np.subtract(ONE, first, out=first)
    offset *= np.log(first, out=first)
    offset *= _cosine(second)
    offset += np.repeat(centres, count)
    np.floor(offset, out=offset)
    return row.take(offset.clip(0, row.size - 1, out=offset).astype(np.intp))


def _cosine(turn):
    """cos(pi turn), turn in [0, 1], for numbers and for arrays; what C and NumPy have takes longer."""
    s = HALF - turn
    square = s * s
    total = SINE[0] * square
    for coefficient in SINE[1:-1]:
        total += coefficient
        total *= square
    total += SINE[-1]
    total *= s
    return total


def by_numba(scene: Scene, controller: Controller) -> Callable[[int, bool], Outcome]:
    """A program of the number of seeds and of whether all cores take part, each with a seed of its own.

    Raises:
        ModuleNotFoundError: Numba is not installed.
    """
    from numba import njit, prange

    # Without the leave to reorder, the compiler does one sample after the other.
    options: dict = {"fastmath": True, "error_model": "numpy"}
    compiled: Any = njit(**options)
    count_of, learn, cosine = (compiled(function) for function in (*controller, _cosine))
    texels_per_d, is_circle = np.float32(scene.texels_per_d or 0), scene.texels_per_d is None
    lowest = np.uint64(2**24 - 1)

    @compiled
    def scrambled(word):
        word = (word ^ (word >> np.uint64(30))) * FIRST
        word = (word ^ (word >> np.uint64(27))) * SECOND
        return word ^ (word >> np.uint64(31))

    @compiled
    def sample(word, row, centre):
        # By way of 32 bits, which processors know how to convert side by side.
        first = np.float32(np.int32(word >> np.uint64(40))) * UNIT
        second = np.float32(np.int32((word >> np.uint64(16)) & lowest)) * UNIT
        if is_circle:
            first, second = first - HALF, second - HALF
            return row[0] if first * first + second * second < QUARTER else np.float32(0)
        slope = -texels_per_d * (ONE if word & np.uint64(3) == 0 else THREE)
        hit = int(math.floor(centre + slope * math.log(ONE - first) * cosine(second)))
        return row[min(max(hit, 0), row.size - 1)]

    @compiled
    def sums(word, count, row, centre):
        total, squares = np.float32(0), np.float32(0)
        for _ in range(count):
            value = sample(scrambled(word), row, centre)
            word += STEP
            total += value
            squares += value * value
        return total, squares

    def every_seed(irradiance, light, truth, out):
        frames, pixels = light.shape
        for seed in prange(out.shape[1]):
            memory = np.zeros((4, pixels))
            word = scrambled(np.uint64(seed + 1) * STEP)
            drawn, error = 0.0, 0.0
            for frame in range(frames):
                for pixel in range(pixels):
                    a, b, c, d = memory[:, pixel]
                    known = light[frame, pixel]
                    count = count_of(known, a, b, c, d)
                    total, squares = sums(word, int(count), irradiance[frame], np.float32(pixel) + HALF)
                    word += np.uint64(count) * STEP
                    mean = total / count
                    deviation = max(squares - total * mean, 0.0)
                    memory[:, pixel] = learn(frame == 0, count, mean, deviation, known, a, b, c, d)
                    drawn += count
                    error += (mean - truth[frame, pixel]) ** 2
            out[0, seed], out[1, seed] = drawn, error

    alone, shared = compiled(every_seed), njit(parallel=True, **options)(every_seed)

    def run(seeds: int, all_cores: bool) -> Outcome:
        out = np.empty((2, seeds))
        (shared if all_cores else alone)(scene.irradiance, scene.light, scene.truth, out)
        return Outcome(*(out / scene.light.size))

    return run
