"""Inverse cdf samplers of Burley's profile as compiled loops over all cores, in float32.

Constants are float32 too: a Python number would turn the arithmetic into float64.
"""

import math

import numpy as np
from numba import njit, prange

ONE, TWO, THREE, FOUR, SIX = (np.float32(value) for value in (1, 2, 3, 4, 6))
HALF, THIRD = np.float32(0.5), np.float32(1 / 3)
PUBLISHED_SLOPE = np.float32(2 - 2.5715)

TRUNCATION = np.float32(16)
KEPT = np.float32(1 - math.exp(-16) / 4 - 3 * math.exp(-16 / 3) / 4)
START_SCALE, START_SPLIT, FAR_START = (np.float32(value) for value in (2.4, 0.9, 15))
TOLERANCE, MAX_STEPS = np.float32(1e-6), 10

compiled = njit(fastmath=True, error_model="numpy")


def _loop(sample):
    """The array version of a function of one variate, shared out over the cores."""

    @njit(parallel=True, fastmath=True, error_model="numpy")
    def draw(xi, d):
        radius = np.empty_like(xi)
        for i in prange(xi.size):
            radius[i] = d * sample(xi[i])
        return radius

    return draw


@compiled
def _closed_form(xi):
    u = ONE - xi
    g = np.cbrt(ONE + FOUR * u * (TWO * u + math.sqrt(ONE + FOUR * u * u)))
    return THREE * math.log((ONE + ONE / g + g) / (FOUR * u))


@compiled
def _published(xi):
    return (PUBLISHED_SLOPE * xi - TWO) * math.log(ONE - xi)


@compiled
def _halley(xi):
    """Two steps on t^3 + 3 t = 4 (1 - xi), t = exp(-x / 3), or on 1 - t where xi is small."""
    if xi < HALF:
        v = xi * (TWO + xi) * THIRD
        for _ in range(2):
            residual = v * (v * (v - THREE) + SIX) - FOUR * xi
            slope = THREE * (v * (v - TWO) + TWO)
            v -= residual * slope / (slope * slope - THREE * residual * (v - ONE))
        return -THREE * math.log1p(-v)
    u = ONE - xi
    t = u * (FOUR - u) * THIRD
    for _ in range(2):
        residual = t * (t * t + THREE) - FOUR * u
        slope = t * t + ONE
        t -= residual * slope / (THREE * slope * slope - t * residual)
    return -THREE * math.log(t)


@compiled
def _truncated_newton(xi):
    """Newton steps on the cdf in the radius, as path tracers do it: truncated at 16 d and renormalized."""
    xi = xi * KEPT
    x = math.exp(START_SCALE * xi * xi) - ONE if xi <= START_SPLIT else FAR_START
    for _ in range(MAX_STEPS):
        slow = math.exp(-x * THIRD)
        fast = slow * slow * slow
        residual = ONE - fast / FOUR - THREE * slow / FOUR - xi
        if abs(residual) < TOLERANCE:
            break
        x = max(x - FOUR * residual / (fast + slow), np.float32(0))
    return x


closed_form, published, halley, truncated_newton = (
    _loop(sample) for sample in (_closed_form, _published, _halley, _truncated_newton)
)
