"""Updates of what is remembered of a frame, each beside a copy that reads and writes the same bytes.

On a CPU, XLA gives every array of a result a kernel of its own, which reads all that it depends on. So an
update moves more bytes than its arguments and results have; XLA's count of them stands in the table.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import interleaved
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.estimators import control_variate, moving, sample_count
from sssfit.estimators.moving import Statistic

ALPHA = 0.2
#: Where an update writes to; see `Stepper`.
MODES = ("in turns", "in place")
#: Bytes by which counts may differ: the 1 that a copy multiplies by is read once for each array.
SCALARS = 1000


class Frame(NamedTuple):
    """One way to update what is remembered: `update(state, *inputs)` gives a new state, and more if any."""

    name: str
    history: str
    update: Callable[..., tuple]
    state: Any
    inputs: tuple[Array, ...]


class Row(NamedTuple):
    """Results of one way, in bytes per pixel and seconds.

    accessed: XLA's count of bytes, NaN where it has none, and seconds: rounds of them, by program and mode,
    such as "copy in turns".
    """

    frame: Frame
    read: float
    written: float
    accessed: dict[str, float]
    seconds: dict[str, np.ndarray]


def frames(width: int, height: int) -> list[Frame]:
    """Every update that is measured; what comes is float32, what is remembered float32 or float16."""
    pixels, random = (height, width), np.random.default_rng(0)

    def noise(*more: int) -> Array:
        return jnp.asarray(random.random((*pixels, *more), np.float32))

    def update(state: moving.State, x: Array) -> tuple:
        return (moving.update(state, x, alpha=ALPHA),)

    def update_count(history: sample_count.History, value: Array, count: Array) -> tuple:
        return (sample_count.update(history, value, count, sample_count.PAPER_2021),)

    def step(history: control_variate.History, *maps: Array) -> tuple:
        return control_variate.step(history, control_variate.Observation(*maps))

    kinds: list[tuple[Statistic, Array]] = [("ema", noise(3)), ("emv", noise(3)), ("emcm", noise(2))]
    counts = jnp.asarray(random.integers(8, 65, pixels, np.int32))
    maps = (noise(), noise(), noise())
    found = []
    for dtype in ("float32", "float16"):
        for statistic, x in kinds:
            name = f"`{statistic}`, {x.shape[-1]} channels"
            for shape, weights in (((), "one weight"), (None, "a weight each")):
                state = moving.init(statistic, x, dtype=dtype, weights_shape=shape)
                found.append(Frame(name, f"{dtype}, {weights}", update, state, (x,)))
        history = sample_count.init(maps[0], dtype=dtype)
        found.append(Frame("`sample_count`", dtype, update_count, history, (maps[0], counts)))
        packed = control_variate.init(maps[0], packed=True, dtype=dtype)
        found.append(Frame("`control_variate`", dtype, step, packed, maps))
        found.append(Frame("`control_variate`, count given", dtype, step, packed, (*maps, counts)))
    return found


def copy_of(frame: Frame) -> Frame:
    """The least that reads and writes the same bytes: each input once, times 1 or added, into some output.

    The 1 is known at run time only, so that nothing can be left out. The arrays are flat, and vectors come
    as an array for each component: XLA does a lone operation over a short last axis number by number.
    """
    more = jax.tree.leaves(jax.eval_shape(frame.update, frame.state, *frame.inputs)[1:])
    state = [array.ravel() for array in jax.tree.leaves(frame.state)]
    size = max(array.size for array in state)
    pieces = [piece for array in frame.inputs for piece in array.reshape(-1, size)]

    def copy(old: list[Array], one: Array, *new: Array) -> tuple:
        kept = [v & (one > 0) if v.dtype == bool else v * one.astype(v.dtype) for v in old]
        for i, x in enumerate(new[len(more) :]):
            kept[i] += x.astype(kept[i].dtype)
        return kept, *((x * one).astype(like.dtype) for x, like in zip(new, more, strict=False))

    return Frame("copy", frame.history, copy, state, (jnp.ones(()), *pieces))


class Stepper:
    """Calls of a compiled update one after the other, into memory that is there already.

    "in turns" writes to the arrays of the state before last, as renderers swap two textures; "in place" to
    those of the last state, which are still read from: what is needed once more, XLA then saves before.

    last: what the last call gave, the new state first. accessed: XLA's count of a call's bytes.
    """

    def __init__(self, frame: Frame, mode: str) -> None:
        self._inputs, self._in_turns = frame.inputs, mode == "in turns"
        self.last = jax.jit(frame.update)(frame.state, *frame.inputs)
        self._before = jax.tree.map(jnp.copy, self.last) if self._in_turns else ()

        def program(memory: tuple, last: tuple, *inputs: Array) -> tuple:
            return frame.update((last or memory)[0], *inputs)

        donating = jax.jit(program, donate_argnums=0, keep_unused=True)
        self._program = donating.lower(*self._states(), *frame.inputs).compile()
        costs: Any = self._program.cost_analysis() or {}
        self.accessed = float(costs.get("bytes accessed", math.nan))

    def _states(self) -> tuple:
        return (self._before, self.last) if self._in_turns else (self.last, ())

    def __call__(self) -> None:
        new = self._program(*self._states(), *self._inputs)
        self._before, self.last = self.last if self._in_turns else (), new
        jax.block_until_ready(new)


def measure(frame: Frame, repeats: int) -> Row:
    """Times of an update and of its copy in both modes.

    Raises:
        RuntimeError: XLA counts other bytes for a copy than the update's arguments and results have.
    """
    pixels = math.prod(frame.inputs[0].shape[:2])
    read = _bytes((frame.state, frame.inputs))
    written = _bytes(jax.eval_shape(frame.update, frame.state, *frame.inputs))
    copy = copy_of(frame)
    steppers = {f"copy {mode}": Stepper(copy, mode) for mode in MODES}
    for name, stepper in steppers.items():
        if abs(stepper.accessed - (read + written)) > SCALARS:
            raise RuntimeError(f"{name} accesses {stepper.accessed} bytes, not {read} + {written}")
    steppers |= {f"update {mode}": Stepper(frame, mode) for mode in MODES}
    accessed = {name: stepper.accessed / pixels for name, stepper in steppers.items()}
    return Row(frame, read / pixels, written / pixels, accessed, interleaved.measure(steppers, repeats))


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| Update | history | bytes per pixel, read + written | XLA's, in turns / in place "
        "| copy, ms | update, ms | times the copy, in turns (quartiles) | in place (quartiles) |",
        "|:--|:--|--:|--:|--:|--:|--:|--:|",
    ]
    for frame, read, written, accessed, seconds in rows:
        xla = " / ".join(f"{accessed[f'update {mode}']:.0f}" for mode in MODES)
        copy, update = (
            " / ".join(f"{np.median(seconds[f'{name} {mode}']) * 1e3:.1f}" for mode in MODES)
            for name in ("copy", "update")
        )
        ratios = []
        for mode in MODES:
            ratio = interleaved.quartiles(seconds[f"update {mode}"] / seconds[f"copy {mode}"])
            ratios.append(f"{ratio.median:.2f} ({ratio.lower:.2f} to {ratio.upper:.2f})")
        lines.append(
            f"| {frame.name} | {frame.history} | {read:.0f} + {written:.0f} | {xla} | {copy} | {update} "
            f"| {' | '.join(ratios)} |"
        )
    return "\n".join(lines)


def _bytes(tree: object) -> int:
    return sum(math.prod(leaf.shape) * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))
