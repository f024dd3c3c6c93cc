"""Programs that run at once, one on each core of a CPU."""

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.core


def number() -> int:
    """How many run at once: one for each core of a CPU, a single one elsewhere."""
    return min(os.cpu_count() or 1, 8) if jax.default_backend() == "cpu" else 1


def is_traced(tree: Any) -> bool:
    """Whether this is within someone else's program, in which there are no threads."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def at_once(program: Callable[[int], Any], many: int) -> list:
    """The results of `program(lane)` for each lane."""
    if many == 1:
        return [program(0)]
    wide = jax.config.read("jax_enable_x64")

    def alone(lane):
        # A thread has a configuration of its own. It waits for its lane: else it might begin a second one,
        # and of the programs that a thread begins each waits for the one before.
        with jax.enable_x64(wide):
            return jax.block_until_ready(program(lane))

    return list(_threads().map(alone, range(many)))


@functools.cache
def _threads():
    return ThreadPoolExecutor(number(), thread_name_prefix="sssfit-lane")
