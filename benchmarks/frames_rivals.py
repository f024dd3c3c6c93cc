"""The samples of a pass by loops over pixels: Numba, and C++ with OpenMP.

Both find the places of 64 samples of a pixel on vectors, and then add up what is found there, a pixel of the
source at a time. `frames_problem.Given` says what they are given; a program returns (n, 3), a row for each
pixel.
"""

import ctypes
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from frames_problem import CUTOFF, WITHIN, Given

from sssfit.sampling._unit_radius import LOG_POLY12

Program = Callable[[], np.ndarray]
SOURCE = Path(__file__).with_name("frames_openmp.cpp")
FLAGS = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC"]
#: Pixels that a thread of Numba takes at a time.
BLOCK = 256
F = np.float32
#: Taylor's series of 2^f, |f| <= 1/2; Cephes' of ln(1 + f) beyond f - f^2 / 2; and of disk.rotation.
EXP2 = tuple(F(math.log(2) ** k / math.factorial(k)) for k in range(7))
LOG = (3.3333331174e-1, -2.4999993993e-1, 2.0000714765e-1, -1.6668057665e-1, 1.4249322787e-1)
LOG = tuple(map(F, (*LOG, -1.2420140846e-1, 1.1676998740e-1, -1.1514610310e-1, 7.0376836292e-2)))
COSINE = tuple(F((-1) ** k * math.tau ** (2 * k) / math.factorial(2 * k)) for k in range(6))
SINE = tuple(F((-1) ** k * math.tau ** (2 * k + 1) / math.factorial(2 * k + 1)) for k in range(6))
RADIUS = tuple(map(F, LOG_POLY12[1]))


class Missing(RuntimeError):
    """A rival that cannot run here; the message is the sentence that says why."""


class _Pass(ctypes.Structure):
    _fields_ = [
        *[
            (name, ctypes.c_void_p)
            for name in "source pixels x y change weights d polynomial version shift".split()
        ],
        *[(name, ctypes.c_float) for name in ("last", "cutoff", "within")],
        *[(name, ctypes.c_int) for name in ("height", "width", "samples")],
        ("count", ctypes.c_int64),
        ("out", ctypes.c_void_p),
    ]


def compiled_openmp(folder: Path) -> Any:
    """The C++ loop as a library in a folder.

    Raises:
        Missing: there is no compiler, or it refuses.
    """
    compiler = shutil.which("g++")
    if compiler is None:
        raise Missing("The C++ loop has no row: there is no g++.")
    library = folder / "frames_openmp.so"
    done = subprocess.run([compiler, *FLAGS, "-o", str(library), str(SOURCE)], capture_output=True, text=True)
    if done.returncode:
        raise Missing(f"The C++ loop has no row: g++ says {done.stderr.strip().splitlines()[-1]}")
    return ctypes.CDLL(str(library))


def by_openmp(given: Given) -> Program:
    """The loop in C++; compiled now. Raises Missing where it cannot be."""
    with tempfile.TemporaryDirectory() as folder:
        # The library stays loaded when its file is gone.
        library = compiled_openmp(Path(folder))
    polynomial = np.array(RADIUS, F)
    x, y, change = (np.ascontiguousarray(layer) for layer in given.table)
    arrays = [given.source, given.pixels, x, y, change, given.weights, given.d, polynomial]
    arrays += [given.version, given.shift]
    out = np.empty((len(given.pixels), 3), F)
    height, width = (size - 2 for size in given.source.shape[:2])
    numbers = [given.last, CUTOFF, WITHIN, height, width, given.samples, len(given.pixels)]
    call = _Pass(*(array.ctypes.data for array in arrays), *numbers, out.ctypes.data)

    def run(keep=arrays) -> np.ndarray:
        library.frames_pass(ctypes.byref(call), int(given.is_fresh), int(given.is_surface))
        return out

    return run


def by_numba(given: Given) -> Program:
    """The loop by Numba, with its own exponential and logarithm: Numba's are calls for each number.

    Raises:
        Missing: Numba is not installed.
    """
    try:
        from numba import njit, prange
    except ModuleNotFoundError:
        raise Missing("Numba has no row: it is not installed.") from None
    compiled: Any = njit(fastmath=True, error_model="numpy")
    is_fresh, is_surface, samples = given.is_fresh, given.is_surface, given.samples
    height, width = given.source.shape[:2]
    right, bottom, row_length = F(width - 0.5), F(height - 0.5), np.int32(width)
    d, slopes = tuple(map(F, given.d)), tuple(F(-1 / (3 * v * math.log(2))) for v in given.d)
    ends = tuple(F(CUTOFF * v) for v in given.d)
    inverse = tuple(F(1 / v) for v in given.d)
    last, unit, least = F(given.last), F(2.0**-24), F(1e-12)
    none, half, one, three, four = F(0), F(0.5), F(1), F(3), F(4)
    factor, largest, ln2 = F(0.25 / WITHIN), F(1 - 2.0**-24), F(math.log(2))
    root_half, ends_used = F(math.sqrt(0.5)), not is_surface

    @compiled
    def series(x, coefficients):
        total = coefficients[-1]
        for k in range(len(coefficients) - 2, -1, -1):
            total = total * x + coefficients[k]
        return total

    @compiled
    def exp2(y):
        y = max(y, F(-126)) + F(127)
        whole = np.int32(y + half)
        power = np.int32(whole << 23).view(np.float32)
        return series(y - F(whole), EXP2) * power

    @compiled
    def log(u):
        bits = F(u).view(np.int32)
        mantissa = np.int32((bits & 0x7FFFFF) | 0x3F000000).view(np.float32)
        is_small = mantissa < root_half
        f = mantissa + mantissa - one if is_small else mantissa - one
        exponent = np.int32((bits >> 23) - (127 if is_small else 126))
        square = f * f
        return f + square * (f * series(f, LOG) - half) + F(exponent) * ln2

    @compiled
    def density(r, k, cut):
        slow = exp2(r * slopes[k])
        whole = slow * (one + slow * slow) * inverse[k]
        return none if cut and r > ends[k] else whole

    @compiled
    def draw(s0, s1, x, y, change, w):
        for k in range(samples):
            number = np.uint32(k)
            first = np.uint32(s0 + np.uint32(number * np.uint32(3242174889))) >> np.uint32(8)
            second = np.uint32(s1 + np.uint32(number * np.uint32(2447445414))) >> np.uint32(8)
            # By way of signed numbers, which processors convert side by side.
            v, turn = F(np.int32(first)) * (three * unit), F(np.int32(second)) * unit
            channel = min(np.int32(v), np.int32(2))
            own = d[0] if channel == 0 else (d[1] if channel == 1 else d[2])
            xi = min((v - F(channel)) * last, largest)
            radius = own * (-three * log(one - xi) - xi * series(xi, RADIUS))
            quarter = np.int32(four * turn + half)
            t = turn - F(0.25) * F(quarter)
            near, far = series(t * t, COSINE), t * series(t * t, SINE)
            cosine, sine = (far, near) if quarter & 1 else (near, far)
            cosine = -cosine if (quarter + 1) & 2 else cosine
            sine = -sine if quarter & 2 else sine
            x[k], y[k] = radius * cosine, radius * sine
            g0, g1 = density(radius, 0, ends_used), density(radius, 1, ends_used)
            g2 = density(radius, 2, ends_used)
            scale = three / (g0 + g1 + g2)
            change[k] = four * scale * radius
            w[0, k], w[1, k], w[2, k] = scale * g0, scale * g1, scale * g2

    @compiled
    def place(q, x, y, index, inside):
        for k in range(samples):
            column = min(max(q[4] + (x[k] * q[0] + y[k] * q[1]), none), right)
            row = min(max(q[5] + (x[k] * q[2] + y[k] * q[3]), none), bottom)
            i, j = np.int32(column), np.int32(row)
            index[k] = j * row_length + i
            if is_surface:
                inside[0, k], inside[1, k] = column - F(i) - half, row - F(j) - half

    @compiled
    def weigh(q, x, y, change, z, w):
        depth, px, py, cosine, sine = q[6], q[7], q[8], q[9], q[10]
        per_depth, scale = one / depth, q[11] * factor
        for k in range(samples):
            stretch = z[k] * per_depth
            ox, oy = x[k] * cosine - y[k] * sine, x[k] * sine + y[k] * cosine
            mx, my = ox * stretch + px * (stretch - one), oy * stretch + py * (stretch - one)
            distance = math.sqrt(mx * mx + my * my + (depth - z[k]) * (depth - z[k]))
            c = change[k] * scale / max(distance, least)
            w[0, k] = c * density(distance, 0, True)
            w[1, k] = c * density(distance, 1, True)
            w[2, k] = c * density(distance, 2, True)

    def every_pixel(source, pixels, version, shift, table, weights, out):
        flat = source.reshape(-1, source.shape[2])
        for block in prange((len(pixels) + BLOCK - 1) // BLOCK):
            own = np.empty((4, samples), np.float32)
            w, inside = np.empty((3, samples), np.float32), np.empty((2, samples), np.float32)
            index = np.empty(samples, np.int32)
            for n in range(block * BLOCK, min((block + 1) * BLOCK, len(pixels))):
                q, v = pixels[n], version[n]
                if is_fresh:
                    x, y, change = own[0], own[1], own[2]
                    draw(shift[n, 0], shift[n, 1], x, y, change, w)
                else:
                    x, y, change = table[0, v], table[1, v], table[2, v]
                place(q, x, y, index, inside)
                if is_surface:
                    z = own[3]
                    for k in range(samples):
                        at = flat[index[k]]
                        z[k] = at[3] + at[4] * inside[0, k] + at[5] * inside[1, k]
                    weigh(q, x, y, change, z, w)
                r, g, b = none, none, none
                for k in range(samples):
                    at = flat[index[k]]
                    if is_fresh or is_surface:
                        r, g, b = r + w[0, k] * at[0], g + w[1, k] * at[1], b + w[2, k] * at[2]
                    else:
                        r += weights[v, k, 0] * at[0]
                        g += weights[v, k, 1] * at[1]
                        b += weights[v, k, 2] * at[2]
                out[n, 0], out[n, 1], out[n, 2] = r / F(samples), g / F(samples), b / F(samples)

    run: Any = njit(fastmath=True, error_model="numpy", parallel=True)(every_pixel)
    out = np.empty((len(given.pixels), 3), F)

    def program() -> np.ndarray:
        run(given.source, given.pixels, given.version, given.shift, given.table, given.weights, out)
        return out

    return program
