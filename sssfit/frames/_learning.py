"""What a policy remembers after a frame, computed a few rows at a time.

A memory is up to nine arrays, and each of the new ones depends on most of the old. XLA computes one array
after the other and reads all of a frame again for each. A strip of a few rows fits into a cache: it is read
from memory once.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from sssfit.estimators.policies import Known, Policy, Sampled
from sssfit.frames import _lanes

#: Rows of a strip on a CPU; 16 of 1920 pixels of twenty arrays are 2.5 MB.
_ROWS = 16


def after(
    policy: Policy,
    memory: Any,
    known: Known,
    counts: Array,
    value: Array,
    variance: Array | None,
    spare: Any = None,
) -> Any:
    """The memory after a frame.

    Args:
        policy: who learns.
        memory: before the frame, a tree of (H, W), where the pixels' points were.
        known, counts, value: see `policies`, (H, W) or numbers.
        variance: of one sample, (H, W); None where nobody needs it.
        spare: a tree as the memory, used up; it becomes the result. By default that is new.
    """
    old, structure = jax.tree.flatten(memory)
    if not old:
        return memory
    given = policy, memory, known, counts, value, variance
    if _lanes.is_traced(given):
        return _learned(given)
    kept = [jnp.zeros_like(leaf) for leaf in old] if spare is None else jax.tree.leaves(spare)
    rows = min(_ROWS, len(value)) if jax.default_backend() == "cpu" else len(value)
    many = min(_lanes.number(), len(old))
    # Each lane has arrays of its own, for no two programs can write to one array.
    mine = [tuple(range(lane, len(old), many)) for lane in range(many)]

    def lane(number):
        return _strips([kept[leaf] for leaf in mine[number]], given, mine[number], rows)

    new = dict(zip(sum(mine, ()), sum(_lanes.at_once(lane, many), []), strict=True))
    return jax.tree.unflatten(structure, [new[leaf] for leaf in range(len(old))])


@functools.partial(
    jax.jit, static_argnames=("which", "rows"), donate_argnames="kept",
    compiler_options={"xla_cpu_prefer_vector_width": 512},
)  # fmt: skip
def _strips(kept: list[Array], given: Any, which: tuple[int, ...], rows: int) -> list[Array]:
    """Some of the memory's arrays, strip by strip."""
    height, width = given[4].shape

    def strip(number, new):
        # The last one may overlap the one before it.
        first = jnp.minimum(number * rows, height - rows)

        def cut(leaf):
            is_map = jnp.shape(leaf)[:2] in ((height, width), (height, 1))
            return jax.lax.dynamic_slice_in_dim(leaf, first, rows) if is_map else leaf

        learned = jax.tree.leaves(_learned(jax.tree.map(cut, given)))
        return [
            jax.lax.dynamic_update_slice_in_dim(array, learned[leaf], first, axis=0)
            for array, leaf in zip(new, which, strict=True)
        ]

    return jax.lax.fori_loop(jnp.int32(0), jnp.int32(-(-height // rows)), strip, kept)


def _learned(given: Any) -> Any:
    policy, memory, known, counts, value, variance = given
    deviation = jnp.zeros_like(value) if variance is None else variance * jnp.maximum(counts - 1, 0)
    return policy.learn(memory, known, Sampled(counts, value, deviation))[0]
