"""Choices measured side by side: errors once, times in turns, so that a busy machine slows all alike."""

import functools
import gc
import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import stats

from sssfit.trade import machine, timing
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.setting import Setting

#: Called with a sentence on what is being done, before it is done.
Tell = Callable[[str], None]
# Numbers that the pace is taken with, and what it is called among a group's choices.
_PACE_NUMBERS, _PACE = 2**20, "pace of the machine"
# Of the difference of two medians that a machine shows for the same program, whatever the rounds say.
_LEAST_NOISE = 0.02
# Seconds before each timed run of a first look.
_QUICK_PAUSE = 0.01


class Found(NamedTuple):
    """What was measured of a group.

    Attributes:
        note: on what, see `Task`.
        rows: one for each choice, in their order.
        pace: median seconds of a program that is the same in every group and every run.
    """

    note: str
    rows: list["Row"]
    pace: float


@dataclass(frozen=True)
class Row:
    """What was measured of one choice.

    Attributes:
        group, choice: names.
        knobs: what was set.
        is_default: what the package does where nothing is said.
        error: in the group's unit.
        error_noise: standard error of that.
        nanoseconds: median time of a unit of work.
        time_noise: half the width of a 95 % interval of that, as a share of it; of this run, in which all
            choices of a group took turns.
        samples: drawn for a unit of work.
        bytes_moved: read and written at least for a unit of work.
        peak_bytes: memory that a run takes beyond what was there, or NaN where the system does not tell.
        compile_seconds: of the first run more than of a later one, with what no choice before it in its group
            has compiled; NaN for a first look, in which groups share what is compiled.
    """

    group: str
    choice: str
    knobs: dict[str, Any]
    is_default: bool
    error: float
    error_noise: float
    nanoseconds: float
    time_noise: float
    samples: float
    bytes_moved: float
    peak_bytes: float
    compile_seconds: float


def group(of: Group, setting: Setting, rounds: int, tell: Tell = lambda text: None) -> Found:
    """Measure all choices of a group.

    Args:
        of: the group.
        setting: on what.
        rounds: in which each choice runs once, >= 3.
        tell: is told what is done.

    Returns:
        See `Found`.

    Raises:
        CannotMeasure: the setting lacks what the group needs.
        ValueError: too few rounds.

    Example:
        >>> from sssfit.trade import setting
        >>> from sssfit.trade.choice import Choice, Error, Group, Task
        >>> one = Choice("sum", {}, run=lambda: sum(range(1000)), error=lambda: Error(0.0))
        >>> sums = Group("sums", "", "number", "", "", lambda setting: Task(1000, (one,)))
        >>> group(sums, setting.procedural_setting(True), rounds=3).rows[0].error
        0.0
    """
    if rounds < 3:
        raise ValueError(f"rounds must be at least 3, got {rounds}")
    tell(f"{of.name}: preparing")
    task = of.prepare(setting)
    firsts, peaks, errors = (_first_look if setting.is_quick else _one_by_one)(task, of.name, tell)
    tell(f"{of.name}: times, {rounds} rounds")
    programs = {choice.name: choice.run for choice in task.choices} | {_PACE: _same_everywhere()}
    times = timing.measure(programs, rounds, pause=_QUICK_PAUSE if setting.is_quick else timing.PAUSE)
    rows = [
        _row(of, task, choice, times[choice.name], first, peak, error)
        for choice, first, peak, error in zip(task.choices, firsts, peaks, errors, strict=True)
    ]
    return Found(task.note, rows, float(np.median(times[_PACE])))


def pace_noise(paces: Sequence[float]) -> float:
    """How much a machine's pace changes from one group to another, and so from one run to the next.

    Args:
        paces: of the groups of a run, seconds.

    Returns:
        Half the width of a 95 % interval of one pace's logarithm; NaN for fewer than two.

    Example:
        >>> pace_noise([1.0, 1.0, 1.0])
        0.0
    """
    if len(paces) < 2:
        return math.nan
    return float(stats.t.ppf(0.975, len(paces) - 1) * np.std(np.log(paces), ddof=1))


def _same_everywhere() -> Callable[[], Any]:
    """A program whose time tells the machine's pace."""
    numbers = jax.device_put(np.linspace(0.1, 1.0, _PACE_NUMBERS, dtype=np.float32))
    # A sum: whether the memory of a large result is new or kept from before would tell of something else.
    program = jax.jit(lambda x: jnp.sum(jnp.exp(-x) * jnp.sin(40 * x)))
    return lambda: jax.block_until_ready(program(numbers))


def side_by_side(calls: Sequence[Callable[[], Any]]) -> list[Any]:
    """Results of calls that are made on threads, one for each core: programs compile beside each other.

    Args:
        calls: what is called; at least one.

    Returns:
        Their results, in their order.

    Example:
        >>> side_by_side([lambda: 1, lambda: 2])
        [1, 2]
    """
    wide = jax.config.read("jax_enable_x64")

    def alone(call: Callable[[], Any]) -> Any:
        # A thread has a configuration of its own.
        with jax.enable_x64(wide):
            return call()

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(alone, calls))


def _one_by_one(task: Task, name: str, tell: Tell) -> tuple[list[float], list[float], list[Error]]:
    """Seconds of each choice's first run, memory of its second, and its error."""
    firsts, peaks, errors = [], [], []
    for choice in task.choices:
        tell(f"{name}: {choice.name}, its error")
        gc.collect()
        begun = time.perf_counter()
        choice.run()
        firsts.append(time.perf_counter() - begun)
        peaks.append(machine.peak_of(choice.run))
        errors.append(choice.error())
    return firsts, peaks, errors


def _first_look(task: Task, name: str, tell: Tell) -> tuple[list[float], list[float], list[Error]]:
    """The same without the first runs' seconds: of several at once nobody knows what each takes alone."""
    tell(f"{name}: errors of {len(task.choices)} choices")

    def error(choice: Choice) -> Error:
        choice.run()
        return choice.error()

    errors = side_by_side([functools.partial(error, choice) for choice in task.choices])
    gc.collect()
    return [math.nan] * len(errors), [machine.peak_of(choice.run) for choice in task.choices], errors


def _row(of: Group, task: Task, choice: Choice, times: np.ndarray, first: float, peak: float, error: Error):
    low, median, high = timing.median_and_interval(times)
    return Row(
        group=of.name,
        choice=choice.name,
        knobs=dict(choice.knobs),
        is_default=choice.is_default,
        error=float(error.value),
        error_noise=float(error.noise),
        nanoseconds=1e9 * median / task.units,
        time_noise=max((high - low) / (2 * median), _LEAST_NOISE),
        samples=float(choice.samples() if callable(choice.samples) else choice.samples),
        bytes_moved=choice.bytes_moved,
        peak_bytes=peak,
        compile_seconds=math.nan if math.isnan(first) else max(first - median, 0.0),
    )
