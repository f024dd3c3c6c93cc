"""The samples of a pass by programs on whole arrays: a plain JAX loop, PyTorch and Dr.Jit.

See frames_rivals.py for what they are given and return. The three share the arithmetic of a sample, written
once for any of them.
"""

import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from frames_problem import CUTOFF, WITHIN, Given
from frames_rivals import RADIUS, Missing, Program

from sssfit.frames.points import VERSIONS

#: What R2's points advance by, of 2^32.
STEPS = (3242174889, 2447445414)
#: Samples that PyTorch takes at once.
CHUNK = 2**17


def density(operations: Any, r: Any, d: float, cut: bool) -> Any:
    """The profile's radial density, up to a factor of all channels."""
    slow = operations.exp(r * (-1 / (3 * d)))
    whole = slow * (slow * slow + 1) * (1 / d)
    return operations.where(r <= CUTOFF * d, whole, 0.0) if cut else whole


def fresh(operations: Any, given: Given, first: Any, second: Any) -> tuple[Any, Any, Any, list[Any]]:
    """x, y, what the density of the radius changes by, and weights in the plane, from two variates."""
    d = [float(v) for v in given.d]
    where, v = operations.where, first * 3
    is_first, is_second = v < 1, v < 2
    own = where(is_first, d[0], where(is_second, d[1], d[2]))
    xi = (v - where(is_first, 0.0, where(is_second, 1.0, 2.0))) * given.last
    xi = where(xi < 1 - 2.0**-24, xi, 1 - 2.0**-24)
    radius = own * (operations.log(1 - xi) * -3 - xi * series(xi, RADIUS))
    cosine, sine = operations.rotation(second)
    densities = [density(operations, radius, shape, not given.is_surface) for shape in d]
    scale = 3 / (densities[0] + densities[1] + densities[2])
    return radius * cosine, radius * sine, scale * radius * 4, [scale * g for g in densities]


def place(operations: Any, given: Given, x: Any, y: Any, q: Any) -> tuple[Any, Any]:
    """Where samples fall in the source, in pixels; q has the columns of `Given.pixels`."""
    height, width = given.source.shape[:2]
    if given.is_fresh:
        column, row = q[4] + x * q[0], q[5] + y * q[3]
    else:
        column, row = q[4] + (x * q[0] + y * q[1]), q[5] + (x * q[2] + y * q[3])
    return operations.clip(column, 0, width - 0.5), operations.clip(row, 0, height - 0.5)


def weigh(operations: Any, given: Given, x: Any, y: Any, change: Any, z: Any, q: Any) -> list[Any]:
    """Weights by the distance of the surface at depth z."""
    if given.is_fresh:
        ox, oy = x, y
    else:
        ox, oy = x * q[9] - y * q[10], x * q[10] + y * q[9]
    stretch = z / q[6]
    mx, my, mz = ox * stretch + q[7] * (stretch - 1), oy * stretch + q[8] * (stretch - 1), q[6] - z
    distance = operations.sqrt(mx * mx + my * my + mz * mz)
    factor = change * q[11] * (0.25 / WITHIN) / operations.clip(distance, 1e-12, 1e30)
    return [factor * density(operations, distance, float(shape), True) for shape in given.d]


def series(x: Any, coefficients: tuple) -> Any:
    total = x * float(coefficients[-1]) + float(coefficients[-2])
    for coefficient in reversed(coefficients[:-2]):
        total = total * x + float(coefficient)
    return total


def by_jax(given: Given) -> Program:
    """A fori_loop over the samples, all pixels at once, as one would write it first."""

    def rotation(turn):
        return jnp.cos(math.tau * turn), jnp.sin(math.tau * turn)

    operations = SimpleNamespace(
        exp=jnp.exp, log=jnp.log, sqrt=jnp.sqrt, where=jnp.where, clip=jnp.clip, rotation=rotation
    )
    flat = jnp.asarray(given.source.reshape(-1, given.source.shape[2]))
    row_length = given.source.shape[1]
    pixels, version, shift = map(jnp.asarray, (given.pixels.T, given.version, given.shift.T))
    tables = jnp.asarray(given.table), jnp.asarray(given.weights)

    @jax.jit
    def run(flat, pixels, version, shift, tables):
        def sample(number, totals):
            if given.is_fresh:
                moved = number.astype(jnp.uint32) * jnp.array(STEPS, jnp.uint32)
                variates = ((shift + moved[:, None]) >> 8).astype(jnp.float32) * 2.0**-24
                x, y, change, weights = fresh(operations, given, *variates)
            else:
                x, y, change = (layer[version, number] for layer in tables[0])
                weights = list(tables[1][version, number].T[:3])
            column, row = place(operations, given, x, y, pixels)
            i, j = column.astype(jnp.int32), row.astype(jnp.int32)
            found = flat[j * row_length + i]
            if given.is_surface:
                z = found[:, 3] + found[:, 4] * (column - i - 0.5) + found[:, 5] * (row - j - 0.5)
                weights = weigh(operations, given, x, y, change, z, pixels)
            return [total + w * found[:, c] for c, (total, w) in enumerate(zip(totals, weights, strict=True))]

        nothing = jnp.zeros(pixels.shape[1], jnp.float32)
        totals = jax.lax.fori_loop(0, given.samples, sample, [nothing] * 3)
        return jnp.stack(totals, axis=-1) / given.samples

    return lambda: run(flat, pixels, version, shift, tables).block_until_ready()


def by_torch(given: Given) -> Program:
    """Pixels in groups of one version of the table, so that the table's rows broadcast, in chunks.

    Raises:
        Missing: PyTorch is not installed.
    """
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise Missing("PyTorch has no row: it is not installed.") from None

    def rotation(turn):
        angle = turn * math.tau
        return torch.cos(angle), torch.sin(angle)

    operations = SimpleNamespace(
        exp=torch.exp, log=torch.log, sqrt=torch.sqrt, where=torch.where, clip=torch.clip, rotation=rotation
    )
    flat = torch.from_numpy(given.source.reshape(-1, given.source.shape[2]))
    row_length, samples = given.source.shape[1], given.samples
    order = np.argsort(given.version, kind="stable")
    pixels = torch.from_numpy(np.ascontiguousarray(given.pixels[order].T))[..., None]
    shift = torch.from_numpy(given.shift[order].view(np.int32).T.copy())[..., None]
    table, weights_of = torch.from_numpy(given.table), torch.from_numpy(given.weights)
    ends = np.searchsorted(given.version[order], np.arange(VERSIONS + 1))
    at_once = max(1, CHUNK // samples)
    parts = [
        (version, slice(first, min(first + at_once, ends[version + 1])))
        for version in range(VERSIONS)
        for first in range(ends[version], ends[version + 1], at_once)
    ]
    steps = [torch.arange(samples, dtype=torch.int64).mul(step).to(torch.int32) for step in STEPS]
    out, result = torch.empty(len(order), 3), np.empty((len(order), 3), np.float32)

    def part(version: int, own: slice) -> None:
        q = pixels[:, own]
        if given.is_fresh:
            # Shifted as signed words: the bits that come in are cut off.
            words = [((s[own] + step) >> 8) & 0xFFFFFF for s, step in zip(shift, steps, strict=True)]
            variates = [word.to(torch.float32).mul_(2.0**-24) for word in words]
            x, y, change, weights = fresh(operations, given, *variates)
        else:
            x, y, change = table[:, version]
            weights = []
        column, row = place(operations, given, x, y, q)
        i, j = column.to(torch.int32), row.to(torch.int32)
        found = flat.index_select(0, torch.add(i, j, alpha=row_length).view(-1)).view(*i.shape, -1)
        if given.is_surface:
            z = found[..., 4] * (column - i - 0.5)
            z.addcmul_(found[..., 5], row - j - 0.5).add_(found[..., 3])
            weights = weigh(operations, given, x, y, change, z, q)
        if weights:
            for c, weight in enumerate(weights):
                torch.sum(weight.mul_(found[..., c]), dim=1, out=out[own, c])
        else:
            torch.sum(found.mul_(weights_of[version])[..., :3], dim=1, out=out[own])

    @torch.inference_mode()
    def program() -> np.ndarray:
        for each in parts:
            part(*each)
        result[order] = out.numpy() / np.float32(samples)
        return result

    return program


def by_drjit(given: Given) -> Program:
    """One kernel: a recorded loop, eight samples a turn, whose lookups fetch four numbers at once.

    Raises:
        Missing: Dr.Jit or LLVM is not here.
    """
    try:
        import drjit as dr  # pyright: ignore[reportMissingImports]
        from drjit.llvm import Array4f, Float, Int32, UInt32  # pyright: ignore[reportMissingImports]

        dr.eval(dr.arange(Float, 1) + 1)
    except Exception as error:
        # What it raises without LLVM is its own affair.
        raise Missing(f"Dr.Jit has no row: {str(error).splitlines()[0]}") from None

    def rotation(turn):
        sine, cosine = dr.sincos(turn * math.tau)
        return cosine, sine

    def clip(value, low, high):
        # Not by minimum and maximum, which LLVM before 17 cannot compile for x86.
        value = dr.select(value > low, value, Float(low))
        return dr.select(value < high, value, Float(high))

    def where(mask, a, b):
        return dr.select(mask, Float(a), Float(b))

    operations = SimpleNamespace(
        exp=dr.exp, log=dr.log, sqrt=dr.sqrt, where=where, clip=clip, rotation=rotation
    )
    turns = 8 if given.samples % 8 == 0 else 1
    flat, row_length = Float(given.source.ravel()), given.source.shape[1]
    per_pixel = given.source.shape[2] // 4
    pixels = [Float(np.ascontiguousarray(column)) for column in given.pixels.T]
    version = UInt32(given.version.astype(np.uint32))
    shift = [UInt32(given.shift[:, k].copy()) for k in (0, 1)]
    offsets = np.concatenate([given.table, np.zeros_like(given.table[:1])]).transpose(1, 2, 0)
    table, weights_of = Float(np.ascontiguousarray(offsets).ravel()), Float(given.weights.ravel())
    dr.eval(flat, pixels, version, shift, table, weights_of)

    def add(number: Any, totals: Sequence[Any]) -> list[Any]:
        if given.is_fresh:
            words = [s + number * UInt32(step) for s, step in zip(shift, STEPS, strict=True)]
            variates = [Float(Int32(word >> 8)) * 2.0**-24 for word in words]
            x, y, change, weights = fresh(operations, given, *variates)
        else:
            row_of_table = version * given.samples + number
            x, y, change, _ = dr.gather(Array4f, table, row_of_table)
            weights = [] if given.is_surface else list(dr.gather(Array4f, weights_of, row_of_table))[:3]
        column, row = place(operations, given, x, y, pixels)
        i, j = Int32(column), Int32(row)
        index = UInt32(j * row_length + i) * per_pixel
        found = dr.gather(Array4f, flat, index)
        if given.is_surface:
            slopes = dr.gather(Array4f, flat, index + 1)
            z = found[3] + slopes[0] * (column - Float(i) - 0.5) + slopes[1] * (row - Float(j) - 0.5)
            weights = weigh(operations, given, x, y, change, z, pixels)
        return [dr.fma(w, found[c], total) for c, (w, total) in enumerate(zip(weights, totals, strict=True))]

    def body(number: Any, *before: Any) -> Any:
        totals: Sequence[Any] = before
        for k in range(turns):
            totals = add(number + k, totals)
        return number + turns, *totals

    def program() -> np.ndarray:
        start: Any = UInt32(0), *(dr.zeros(Float, len(given.pixels)) for _ in range(3))
        done = dr.while_loop(start, lambda number, *_: number < given.samples, body, mode="symbolic")
        totals = [total * (1 / given.samples) for total in done[1:]]
        dr.eval(totals)
        dr.sync_thread()
        return np.stack([total.numpy() for total in totals], axis=1)

    return program


PROGRAMS: dict[str, Callable[[Given], Program]] = {
    "plain JAX fori_loop": by_jax,
    "PyTorch": by_torch,
    "Dr.Jit, LLVM": by_drjit,
}
