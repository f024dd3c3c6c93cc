"""From frame to frame: count, sample, learn; for one pixel or a line of them, one seed or thousands.

A *world* knows its samples' values and its exact answers (`circle`, `line`); a *policy* decides how many
samples are drawn and learns from them (`estimators.policies`). `step` does one frame. `run` does all frames
of many seeds by one compiled scan, `chunks` a part of the seeds at a time so that memory stays bounded.
"""

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, Protocol, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.estimators.policies import Known, Policy, Sampled
from sssfit.sampling import sequences

Start = Literal["cold", "disocclusion"]
STARTS: tuple[Start, ...] = get_args(Start)
Sequence = Literal["iid", "r2"]
SEQUENCES: tuple[Sequence, ...] = get_args(Sequence)

#: Samples drawn at a time: enough to keep a core's vector units busy for a single pixel.
_BLOCK = 8
#: Numbers in the records of one chunk of seeds; 16 MB in float32, seconds of work.
_CHUNK_NUMBERS = 4_000_000


class World(Protocol):
    """What a scenario offers. Arrays of answers have the shape (frames, *pixels).

    Attributes:
        truth: the exact result of each pixel and frame.
        sample_variance: variance of one independent sample.
        control: the light on the pixel itself, known before a sample is drawn.
        surround: the mean light around it, as a coarser level of the lighting has it, also known.
    """

    truth: Array
    sample_variance: Array
    control: Array
    surround: Array

    def places(self, uniform: Array) -> Array:
        """Where the samples fall, (n, *pixels), at the points (2, n, *pixels) of the unit square."""
        ...

    def values(self, places: Array, frame: Array) -> Array:
        """Values of samples there, of the places' shape."""
        ...


class Record(NamedTuple):
    """One frame, or with more leading axes many: (seeds, frames, *pixels) as `run` returns it.

    Attributes:
        count: samples drawn.
        value: the frame's result, their mean.
        square_deviation: sum of the samples' squared deviations from it.
        mean, variance, coefficient: as in `Learned`.
    """

    count: Array
    value: Array
    square_deviation: Array
    mean: Array
    variance: Array
    coefficient: Array


def draw(
    key: Array, world: World, frame: Array, count: Array, *, most: int, sequence: Sequence = "iid"
) -> Sampled:
    """Sample every pixel of a frame.

    Args:
        key: of this frame and seed.
        world: what is sampled.
        frame: its number, from 0.
        count: samples of each pixel, of the pixels' shape; above `most` it is `most`.
        most: the largest count, on the host; what is drawn beyond a pixel's own count is thrown away.
        sequence: "iid" points, or "r2": the R2 sequence from a random start in every pixel and frame, which
            leaves each frame unbiased and independent of the others.

    Returns:
        `Sampled`; mean and deviation are 0 where the count is 0.

    Example:
        >>> from sssfit.scenarios import circle
        >>> drawn = draw(jax.random.key(0), circle.uniform(1), 0, jnp.int32(64), most=64)
        >>> int(drawn.count), 0.5 < float(drawn.mean) < 1.5
        (64, True)
    """
    count = jnp.minimum(count, most)
    dtype, shape = world.truth.dtype, count.shape
    shift = jax.random.bits(key, (2, 1, *shape), jnp.uint32)
    points = {"iid": sequences.hashed, "r2": sequences.r2}[sequence]
    in_block = jnp.arange(_BLOCK).reshape(-1, *(1,) * len(shape))
    # Sums of squares are taken around a number of the samples' size, so that they do not cancel.
    reference = jax.lax.stop_gradient(world.truth[frame])

    def place(block):
        return world.places(points(in_block + block * _BLOCK, shift).astype(dtype))

    def add(block, carried):
        places, total, squares = carried
        found = world.values(places, frame) - reference
        found = jnp.where(in_block + block * _BLOCK < count, found, 0)
        total, squares = total + jnp.sum(found, axis=0), squares + jnp.sum(jnp.square(found), axis=0)
        # The next samples' places are found one step ahead: fused with a lookup, their logarithms and
        # cosines would be compiled one number at a time.
        return place(block + 1), total, squares

    zero = jnp.zeros(shape, dtype)
    blocks = -(-most // _BLOCK)
    _, total, squares = jax.lax.fori_loop(0, blocks, add, (place(0), zero, zero))
    number = jnp.maximum(count, 1).astype(dtype)
    mean = total / number
    deviation = jnp.maximum(squares - total * mean, 0)
    return Sampled(count, jnp.where(count > 0, reference + mean, 0), deviation)


def known(world: World, frame: Array, *, missing: Array) -> Known:
    """What is known of a frame before it is sampled.

    Args:
        world: what is sampled.
        frame: its number, from 0.
        missing: whether the pixels have no history.

    Returns:
        `Known`, of the pixels' shape.

    Example:
        >>> from sssfit.scenarios import circle
        >>> round(float(known(circle.uniform(1), 0, missing=jnp.array(True)).control), 4)
        1.2732
    """
    at = (world.control[frame], world.surround[frame], world.sample_variance[frame])
    return Known(*at, missing=jnp.broadcast_to(missing, at[0].shape))


def step(
    key: Array,
    world: World,
    policy: Policy,
    state: Any,
    frame: Array,
    *,
    most: int,
    start: Start = "disocclusion",
    sequence: Sequence = "iid",
) -> tuple[Any, Record]:
    """One frame: decide the counts, sample, learn.

    Args:
        key: of the seed; the frame's own is derived from it and the frame's number.
        world: what is sampled.
        policy: how many samples, and what is learned from them.
        state: the policy's memory.
        frame: number of the frame, from 0.
        most: the largest count, on the host.
        start: "disocclusion" tells the policy that frame 0 has no history, "cold" gives it zeros for one.
        sequence: as for `draw`.

    Returns:
        The memory after the frame, and a `Record` of the pixels' shape.

    Example:
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle
        >>> world, policy = circle.uniform(2), policies.named("fixed", spp=16)
        >>> state, record = step(jax.random.key(0), world, policy, (), 0, most=16)
        >>> int(record.count)
        16
    """
    before = known(world, frame, missing=(frame == 0) & (start == "disocclusion"))
    count = policy.count(state, before)
    key = jax.random.fold_in(key, frame)
    sampled = draw(key, world, frame, count, most=most, sequence=sequence)
    state, learned = policy.learn(state, before, sampled)
    return state, Record(*sampled, *learned)


def trajectory(
    key: Array,
    world: World,
    policy: Policy,
    *,
    most: int,
    start: Start = "disocclusion",
    sequence: Sequence = "iid",
) -> Record:
    """All frames of a world for one seed, to be compiled and mapped over by its caller.

    Args:
        key: of the seed.
        world: what is sampled, for as many frames as it has.
        policy: how many samples, and what is learned from them.
        most: the largest count, on the host.
        start, sequence: as for `step`.

    Returns:
        `Record` of shape (frames, *pixels).

    Example:
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle
        >>> world, policy = circle.uniform(20), policies.named("as")
        >>> jax.jit(lambda key: trajectory(key, world, policy, most=64))(jax.random.key(0)).count.shape
        (20,)
    """

    def following(state, frame):
        return step(key, world, policy, state, frame, most=most, start=start, sequence=sequence)

    state = policy.init(jnp.zeros_like(world.truth[0]))
    return jax.lax.scan(following, state, jnp.arange(world.truth.shape[0]))[1]


def chunks(
    key: Array,
    world: World,
    policy: Policy,
    *,
    seeds: int,
    most: int | None = None,
    start: Start = "disocclusion",
    sequence: Sequence = "iid",
    chunk: int | None = None,
) -> Iterator[Record]:
    """All frames of a world for many seeds, some seeds at a time: what is kept of them is the caller's.

    Args:
        key: of the whole run. A seed's numbers depend on it and the seed's number, not on the chunks,
            whose size decides rounding alone.
        world: what is sampled, for as many frames as it has.
        policy: how many samples, and what is learned from them.
        seeds: how many independent repetitions, >= 1.
        most: the largest count that the policy can ask for; by default its `max_spp`.
        start, sequence: as for `step`.
        chunk: seeds at a time at most; by default as many as fit into some 16 MB.

    Yields:
        `Record` of NumPy arrays (chunk, frames, *pixels), the last one with the seeds that are left.

    Raises:
        ValueError: seeds, chunk or most is out of its domain, start or sequence is unknown.

    Example:
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle
        >>> parts = chunks(jax.random.key(0), circle.uniform(20), policies.named("as"), seeds=5, chunk=3)
        >>> [len(part.count) for part in parts]
        [3, 2]
    """
    if start not in STARTS:
        raise ValueError(f"start must be one of {', '.join(STARTS)}, got {start!r}")
    if sequence not in SEQUENCES:
        raise ValueError(f"sequence must be one of {', '.join(SEQUENCES)}, got {sequence!r}")
    if seeds < 1:
        raise ValueError(f"seeds must be at least 1, got {seeds}")
    most = largest_count(policy) if most is None else most
    size = world.truth.size * len(Record._fields)
    if most < 1:
        raise ValueError(f"most must be at least 1, got {most}")
    chunk = max(1, _CHUNK_NUMBERS // size) if chunk is None else chunk
    if chunk < 1:
        raise ValueError(f"chunk must be at least 1, got {chunk}")
    # Chunks of nearly one size, so that the last is not drawn for nothing.
    chunk = -(-seeds // -(-seeds // chunk))
    for first in range(0, seeds, chunk):
        # The last chunk is as long as the others, so that it needs no program of its own.
        numbers = jnp.arange(first, first + chunk)
        found = _run_seeds(key, world, policy, numbers, most, start, sequence)
        yield _on_host(found, seeds - first)


def largest_count(policy: Policy) -> int:
    """The largest count that a policy can ask for.

    Args:
        policy: with a `max_spp` that is known on the host.

    Raises:
        ValueError: it has none.

    Example:
        >>> from sssfit.estimators import policies
        >>> largest_count(policies.named("as", max_spp=128))
        128
    """
    try:
        return int(np.max(policy.max_spp))  # pyright: ignore[reportAttributeAccessIssue]
    except (AttributeError, jax.errors.ConcretizationTypeError):
        raise ValueError("most must be given for a policy whose max_spp is not known on the host") from None


def run(key: Array, world: World, policy: Policy, *, seeds: int, **options: Any) -> Record:
    """All frames of a world for many seeds, as one record.

    Args:
        key, world, policy, seeds, options: as for `chunks`.

    Returns:
        `Record` of NumPy arrays (seeds, frames, *pixels).

    Raises:
        ValueError: as `chunks`.

    Example:
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle
        >>> record = run(jax.random.key(0), circle.uniform(20), policies.named("as"), seeds=3)
        >>> record.count.shape
        (3, 20)
    """
    parts = list(chunks(key, world, policy, seeds=seeds, **options))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def _on_host(record: Record, seeds: int) -> Record:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:seeds], record)


@eqx.filter_jit
def _run_seeds(key, world, policy, numbers, most, start, sequence):
    def one(number):
        seed_key = jax.random.fold_in(key, number)
        return trajectory(seed_key, world, policy, most=most, start=start, sequence=sequence)

    return jax.vmap(one)(numbers)
