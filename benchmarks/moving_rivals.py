"""Covariance matrices of many streams of pairs: sssfit beside pandas, river and a loop compiled by Numba.

All take float32 pairs, (T, S, 2), and give the matrix of every stream after each pair, (T, S, 2, 2), or after
the last one. pandas and river compute in float64. A package that is not installed is left out.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from typing import Any, NamedTuple

import interleaved
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from sssfit.estimators import moving

ALPHA = 0.2
#: Streams of one call: 1000 of their matrices stay below 32 MiB, so that a result gets memory which the
#: process has already. More is new memory at each call, which costs more than the arithmetic.
BLOCK = 2000
#: Streams that a processor of the compiled loop takes through time at once, so that they stay in its cache.
CHUNK = 500
OURS = "sssfit"


class Contender(NamedTuple):
    """A program: `prepare` takes a block of streams to where it wants them and returns what computes.

    few: too slow for all streams. last: gives the last matrices alone. threads: a call uses one processor,
    and calls on several blocks go side by side.
    """

    name: str
    prepare: Callable[[np.ndarray], Callable[[], Any]]
    few: bool = False
    last: bool = False
    threads: bool = False


class Row(NamedTuple):
    """Rounds of seconds per pair, of the same over sssfit's, and the largest difference of the matrices."""

    name: str
    streams: int
    seconds: np.ndarray
    ratio: np.ndarray
    difference: float


def contenders() -> list[Contender]:
    """sssfit, and the packages that are installed."""
    ours = [
        Contender(OURS, _on_jax(lambda zs: moving.emcm(zs, ALPHA)), threads=True),
        Contender(f"{OURS}, last only", _on_jax(_last), last=True, threads=True),
    ]
    found = []
    for rivals in (_numba, _pandas, _river):
        try:
            found += rivals()
        except ModuleNotFoundError as error:
            if error.name not in ("numba", "pandas", "river"):
                raise
    return ours + found


def compare(streams: int, few: int, steps: int, repeats: int) -> list[Row]:
    """Times of all contenders, measured in turns, and how far their matrices are from sssfit's."""
    random = np.random.default_rng(0)
    size = min(BLOCK, streams)
    shape = (steps, size, 2)
    # By way of JAX, whose arrays others can read without a copy.
    blocks = [
        np.asarray(jnp.asarray(random.standard_normal(shape, np.float32))) for _ in range(streams // size)
    ]
    few_blocks = [np.ascontiguousarray(blocks[0][:, :few])]
    everyone = contenders()
    given = {c.name: few_blocks if c.few else blocks for c in everyone}
    counts = {name: sum(block.shape[1] for block in bs) for name, bs in given.items()}
    programs = {c.name: _every_block(c, given[c.name]) for c in everyone}
    times = interleaved.measure(programs, repeats)
    seconds = {name: t / counts[name] / steps for name, t in times.items()}
    expected = np.asarray(everyone[0].prepare(few_blocks[0])())
    results = []
    for contender in everyone:
        found = np.asarray(contender.prepare(few_blocks[0])())
        difference = np.max(np.abs(found - (expected[-1] if contender.last else expected)))
        rate = seconds[contender.name]
        ratio = rate / seconds[everyone[contender.last].name]
        results.append(Row(contender.name, counts[contender.name], rate, ratio, float(difference)))
    return results


def versions(rows: Sequence[Row]) -> str:
    """A clause with the versions that `interleaved.machine` does not name."""
    names = {row.name.split(",")[0] for row in rows}
    found = [f"{name} {version(name)}" for name in ("pandas", "river") if name in names]
    return f"; {', '.join(found)}" if found else ""


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| Program | streams | ns per pair (quartiles) | times sssfit's (quartiles) | differs by |",
        "|:--|--:|--:|--:|--:|",
    ]
    for row in rows:
        time, ratio = interleaved.quartiles(1e9 * row.seconds), interleaved.quartiles(row.ratio)
        lines.append(
            f"| {row.name} | {row.streams} | {time.median:,.1f} ({time.lower:,.1f} to {time.upper:,.1f}) "
            f"| {ratio.median:,.2f} ({ratio.lower:,.2f} to {ratio.upper:,.2f}) | {row.difference:.0e} |"
        )
    return "\n".join(lines)


def _every_block(contender: Contender, blocks: Sequence[np.ndarray]) -> Callable[[], None]:
    """Results are dropped at once, so that the next ones get their memory."""
    programs = [contender.prepare(block) for block in blocks]

    def drop(program: Callable[[], Any]) -> None:
        program()

    def run() -> None:
        with ThreadPoolExecutor(os.cpu_count() if contender.threads else 1) as pool:
            for _ in pool.map(drop, programs):
                pass

    return run


def _on_jax(function: Callable[[Array], Array]) -> Callable[[np.ndarray], Callable[[], Array]]:
    compiled = jax.jit(function)

    def prepare(zs: np.ndarray) -> Callable[[], Array]:
        on_device = jnp.asarray(zs)
        return lambda: compiled(on_device).block_until_ready()

    return prepare


def _last(zs: Array) -> Array:
    """The matrices after the last pair, with nothing written on the way."""
    state = moving.init("emcm", zs[0], weights_shape=())
    state, _ = lax.scan(lambda state, z: (moving.update(state, z, alpha=ALPHA), None), state, zs)
    return moving.estimate(state)


def _pandas() -> list[Contender]:
    import pandas as pd

    def ewm(frame: pd.DataFrame):
        return frame.ewm(alpha=ALPHA, adjust=False)

    def by_stream(zs: np.ndarray) -> Callable[[], np.ndarray]:
        frames = [pd.DataFrame(zs[:, s]) for s in range(zs.shape[1])]
        shape = (len(zs), 2, 2)
        return lambda: np.stack([ewm(f).cov(bias=True).to_numpy().reshape(shape) for f in frames], axis=1)

    def by_column(zs: np.ndarray) -> Callable[[], np.ndarray]:
        x, y = (pd.DataFrame(zs[..., i]) for i in range(2))

        def covariances() -> np.ndarray:
            xx, yy = (ewm(f).var(bias=True).to_numpy() for f in (x, y))
            xy = ewm(x).cov(y, bias=True, pairwise=False).to_numpy()
            return np.stack([xx, xy, xy, yy], axis=-1).reshape(*zs.shape, 2)

        return covariances

    return [
        Contender("pandas, a stream per column", by_column, few=True),
        Contender("pandas, a frame per stream", by_stream, few=True),
    ]


def _river() -> list[Contender]:
    from river import stats

    def prepare(zs: np.ndarray) -> Callable[[], np.ndarray]:
        streams = zs.swapaxes(0, 1).tolist()

        def update() -> np.ndarray:
            found = []
            for pairs in streams:
                var_x, var_y, cov = stats.EWVar(ALPHA), stats.EWVar(ALPHA), stats.EWCov(ALPHA)
                for x, y in pairs:
                    var_x.update(x)
                    var_y.update(y)
                    cov.update(x, y)
                    xy = cov.get()
                    found.append((var_x.get(), xy, xy, var_y.get()))
            return np.array(found).reshape(len(streams), -1, 2, 2).swapaxes(0, 1)

        return update

    return [Contender("river", prepare, few=True)]


def _numba() -> list[Contender]:
    from numba import njit, prange

    one, chunk = np.float32(1), CHUNK
    alpha = np.float32(ALPHA)

    @njit(error_model="numpy")
    def advance(z, mean_x, mean_y, xx, xy, yy):
        """One pair more for every stream of a chunk."""
        for s in range(len(z)):
            x, y = z[s, 0] - mean_x[s], z[s, 1] - mean_y[s]
            mean_x[s] += alpha * x
            mean_y[s] += alpha * y
            xx[s] += alpha * ((one - alpha) * x * x - xx[s])
            xy[s] += alpha * ((one - alpha) * x * y - xy[s])
            yy[s] += alpha * ((one - alpha) * y * y - yy[s])

    @njit(error_model="numpy")
    def store(out, xx, xy, yy):
        for s in range(len(out)):
            out[s, 0, 0], out[s, 0, 1], out[s, 1, 0], out[s, 1, 1] = xx[s], xy[s], xy[s], yy[s]

    @njit(parallel=True, error_model="numpy")
    def every(zs):
        steps, streams, _ = zs.shape
        out = np.empty((steps, streams, 2, 2), np.float32)
        for c in prange((streams + chunk - 1) // chunk):
            part = slice(c * chunk, min((c + 1) * chunk, streams))
            mean_x, mean_y = zs[0, part, 0].copy(), zs[0, part, 1].copy()
            xx, xy, yy = np.zeros_like(mean_x), np.zeros_like(mean_x), np.zeros_like(mean_x)
            for t in range(steps):
                advance(zs[t, part], mean_x, mean_y, xx, xy, yy)
                store(out[t, part], xx, xy, yy)
        return out

    @njit(parallel=True, error_model="numpy")
    def last(zs):
        steps, streams, _ = zs.shape
        out = np.empty((streams, 2, 2), np.float32)
        for c in prange((streams + chunk - 1) // chunk):
            part = slice(c * chunk, min((c + 1) * chunk, streams))
            mean_x, mean_y = zs[0, part, 0].copy(), zs[0, part, 1].copy()
            xx, xy, yy = np.zeros_like(mean_x), np.zeros_like(mean_x), np.zeros_like(mean_x)
            for t in range(steps):
                advance(zs[t, part], mean_x, mean_y, xx, xy, yy)
            store(out[part], xx, xy, yy)
        return out

    return [
        Contender("Numba", lambda zs: lambda: every(zs)),
        Contender("Numba, last only", lambda zs: lambda: last(zs), last=True),
    ]
