"""Frame after frame: sample counts from what was learned, an image, and what is learned from it.

What a policy remembers of a pixel is carried to where the pixel's point is now, and forgotten where that
point could not be seen before. It says how many samples the pixel draws. From the noisy image the policy then
learns for the next frame. What becomes of the images, such as a temporal accumulation, is not part of the
loop and does not feed back into it.

What is learned from is the Rec. 709 luminance of the image / pi. The control is the light on the pixel
itself, in the same unit, times the share of it that scatters beyond the pixel.

Source: Xie et al. 2020, section 3.3; Xie and Olano 2021, Algorithms 1-3; Xie 2021, section 4.4.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike, DTypeLike

from sssfit.estimators import policies
from sssfit.estimators.policies import Known, Policy
from sssfit.frames import _guidance, _history, _learning, scatter, temporal
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.frames.render import LARGEST_SEED, SEEDS

_IMAGE, _ORACLE = 0, 1
#: What is not known of a frame, on the host: to put it onto a device takes a tenth of a millisecond.
_NONE: Any = np.float32(0)
#: Weight of the newest frame in the gain of `policies.InFrame`, for points of low discrepancy. It is larger
#: than a pixel's alone, since the gain is that of 8 by 8 pixels.
GAIN_ALPHA = 0.1


class Config(eqx.Module):
    """What a sequence is rendered with.

    Attributes:
        policy: who decides the counts, such as `policies.named` makes it. It is told the spread of a frame's
            samples only if it is `policies.InFrame`, the exact variance only if it is `policies.Oracle`; and
            of the light that on the pixel itself, or only that around it if its `light` is "surround".
        profiles: shape parameter of each channel, mm, by profile id; None where nothing scatters.
        settings: see `points.Settings`.
        gamma: the luminance is raised to 1 / gamma before anything is learned from it, and the control, too;
            1 keeps it linear, 2.2 is the papers'. The policy's target is in the same measure.
        depth_tolerance: see `temporal.disoccluded`.
        history_dtype: what the policy's memory is kept in, float32 or float16.
        seed: from 0 to `render.LARGEST_SEED`; other ones give independent images.
        oracle_spp: samples from which the variance is taken that `policies.Oracle` is told, >= 2.
    """

    policy: Policy
    profiles: Mapping[int, Any]
    settings: Settings = eqx.field(default=Settings(), static=True)
    gamma: float = eqx.field(default=1.0, static=True)
    depth_tolerance: ArrayLike = 0.02
    history_dtype: DTypeLike = eqx.field(default=jnp.float32, static=True)
    seed: int = eqx.field(default=0, static=True)
    oracle_spp: int = eqx.field(default=256, static=True)

    def __check_init__(self):
        """Refuse what does not go together."""
        self.settings.check()
        temporal.check_tolerance(self.depth_tolerance)
        if isinstance(self.policy, policies.MedianFiltered):
            raise ValueError("policy must not be MedianFiltered, which is for a line of pixels; give its own")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise ValueError(f"seed must be from 0 to {LARGEST_SEED}, got {self.seed}")
        if not self.gamma > 0:
            raise ValueError(f"gamma must be above 0, got {self.gamma:g}")
        if self.gamma != 1 and isinstance(self.policy, policies.InFrame | policies.Oracle):
            raise ValueError(
                f"gamma must be 1 for a policy that knows variances of samples, got {self.gamma:g}"
            )
        if self.oracle_spp < 2:
            raise ValueError(f"oracle_spp must be at least 2, got {self.oracle_spp}")


class State(NamedTuple):
    """What is carried from frame to frame.

    Attributes:
        number: how many frames there were.
        memory: the policy's, a tree of (H, W).
        depth, profile_id: of the frame before, (H, W).
    """

    number: int
    memory: Any
    depth: Array
    profile_id: Array


class Info(NamedTuple):
    """What is known of a frame beside its image, arrays of (H, W).

    Attributes:
        counts: samples drawn, int32; 0 where nothing scatters.
        missing: where the pixel had no history.
        value: what was learned from it.
    """

    counts: Array
    missing: Array
    value: Array


def luminance(image: ArrayLike) -> Array:
    """Rec. 709 luminance of a linear image.

    Args:
        image: (..., 3).

    Returns:
        (...), in the image's unit.

    Source: ITU-R BT.709-6, item 3.2.

    Example:
        >>> float(luminance(jnp.ones(3))).__round__(6)
        1.0
    """
    return _guidance.luminance(jnp.asarray(image))


def init(frame: Frame, config: Config) -> State:
    """Before the first frame: nothing is known of any pixel.

    Args:
        frame: any of the sequence, for its size.
        config: see `Config`.

    Returns:
        A state of number 0 in which every pixel is missing.

    Source: Xie et al. 2020, section 4.1.3, the cold start.

    Example:
        >>> from sssfit.frames import procedural
        >>> frame = procedural.frame(width=64, height=36)
        >>> config = Config(policies.named("as"), {1: (1.0, 0.5, 0.3), 2: None})
        >>> init(frame, config).number
        0
    """
    shape = jnp.shape(frame.depth)
    memory = config.policy.init(jnp.zeros(shape, config.history_dtype))
    # Arrays of their own, which can be written over.
    memory = jax.tree.map(jnp.copy, memory)
    # No pixel has this id: all are new.
    return State(0, memory, jnp.ones(shape, jnp.float32), jnp.full(shape, -1, jnp.int32))


def step(
    state: State, frame: Frame, config: Config, *, spare: State | None = None
) -> tuple[State, Array, Info]:
    """One frame. It runs from the host, where the profiles' ids are looked at, and not under `jax.jit`.

    Args:
        state: from `init`, or after the frame before, of the same size.
        frame: see `gbuffer.Frame`; without motion, everything is taken to be where it was.
        config: the same in all frames of a sequence, up to its numbers.
        spare: a state of the same sequence that nobody needs any more, such as the one before `state`. Its
            memory is written over, which takes less time than to ask for new: it cannot be used afterwards.

    Returns:
        The state after it; the image, (H, W, 3), as `scatter.every_profile` gives it; and an `Info`. Nothing
        is compiled anew from frame to frame.

    Raises:
        ValueError: the frame has another size than the state, `spare` is not fit to be written over, or as
            `scatter.every_profile`.

    Source: as this module.

    Example:
        >>> from sssfit.frames import procedural
        >>> frame = procedural.frame(width=64, height=36)
        >>> config = Config(policies.named("as"), {1: (1.0, 0.5, 0.3), 2: None})
        >>> state, image, info = step(init(frame, config), frame, config)
        >>> int(info.counts.max()), bool(info.missing.all())
        (8, True)
    """
    if jnp.shape(frame.depth) != jnp.shape(state.depth):
        (height, width), (rows, columns) = jnp.shape(frame.depth), jnp.shape(state.depth)
        raise ValueError(
            f"frame must have the size of those before it, {columns} x {rows}, got {width} x {height}"
        )
    if spare is not None:
        _history.check_spare(spare.memory, state.memory)
    seeds = SEEDS * config.seed
    options: dict[str, Any] = {"settings": config.settings, "number": state.number}
    exact = _NONE
    if isinstance(config.policy, policies.Oracle):
        spp = config.oracle_spp
        exact = scatter.image_and_variance(
            frame, config.profiles, counts=spp, seed=seeds + _ORACLE, **options
        )[1]
    seen = state.depth, state.profile_id
    memory, missing, is_kept = _history.looked_up(state.memory, seen, frame, config.depth_tolerance)
    # The programs have no use for these two, and are the same for all of them.
    shared = dataclasses.replace(config, seed=0, oracle_spp=2)
    known = _known(frame, exact, missing, shared)
    counts = _counts(memory, frame, known, shared)
    options |= {"counts": counts, "most": _largest(config.policy), "seed": seeds + _IMAGE}
    if isinstance(config.policy, policies.InFrame):
        image, variance = scatter.image_and_variance(frame, config.profiles, **options)
    else:
        image, variance = scatter.every_profile(frame, config.profiles, **options), None
    value = _guidance.measured(image, config.gamma)
    unused = None if spare is None else spare.memory
    new = _learning.after(config.policy, memory, known, counts, value, variance, unused)
    if is_kept:
        _history.give_back(memory)
    following = State(state.number + 1, new, frame.depth, frame.profile_id)
    return following, image, Info(counts, missing, value)


def scan(
    frames: Iterable[Frame], config: Config, state: State | None = None, *, keep_states: bool = True
) -> Iterator[tuple[State, Array, Info]]:
    """All frames of a sequence, one at a time.

    Args:
        frames: of one size; made when they are wanted.
        config: see `Config`.
        state: after an earlier part of the sequence; None to begin. It is never written over.
        keep_states: False writes each state over the second one before it, which saves time: only the last
            two can be used.

    Yields:
        What `step` returns.

    Raises:
        ValueError: as `step`.

    Source: as this module.

    Example:
        >>> from sssfit.frames import procedural
        >>> frames = (procedural.frame(index=k, width=64, height=36) for k in range(3))
        >>> config = Config(policies.named("as"), {1: (1.0, 0.5, 0.3), 2: None})
        >>> [state.number for state, image, info in scan(frames, config)]
        [1, 2, 3]
    """
    before, given = None, state
    for frame in frames:
        now = init(frame, config) if state is None else state
        state, image, info = step(now, frame, config, spare=before)
        before = None if keep_states or now is given else now
        yield state, image, info


def _known(frame: Frame, exact: Any, missing: Array, config: Config) -> Known:
    """What the policy is told of a frame before it is sampled."""
    found, light = _NONE, _guidance.light_of(config.policy)
    if light is not None:
        # From a program of its own: each sum over what is around would compute it again.
        lit = _guidance.measured(frame.irradiance, config.gamma)
        found = _guidance.light_on(frame, lit, config, light)
    control, around = (_NONE, found) if light == "surround" else (found, _NONE)
    return Known(control, around, exact, missing)


@jax.jit
def _counts(memory: Any, frame: Frame, known: Known, config: Config) -> Array:
    """How many samples the pixels draw."""
    sampled = _guidance.sampled(frame, config)
    memory = _guidance.pooled(memory, sampled & ~known.missing)
    return jnp.where(sampled, config.policy.count(memory, known), 0)


def _largest(policy: Any) -> int:
    """The largest count that a policy can ask for, on the host."""
    return int(np.max(policy.max_spp))
