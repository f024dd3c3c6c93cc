"""The loop over frames: what is carried, what is learned, and what a frame draws."""

import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.estimators import control_variate, policies, sample_count
from sssfit.frames import _footprint, _guidance, _history, _learning, _pass, scatter, sequence
from sssfit.frames.camera import orthographic
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.frames.render import SEEDS

H, W = 24, 40
D = (0.6, 0.4, 0.2)
PROFILES = {1: D, 2: None}
# Distances in the plane need no normals, and points of their own have errors that are independent.
SETTINGS = Settings(distance="plane", points="fresh", sequence="iid")
TEXTURE = np.random.default_rng(0).uniform(0, 2, (H, W, 1)).astype(np.float32) * np.ones(3, np.float32)


def frame(light=None, ids=None, motion=None, depth=500.0):
    light = TEXTURE if light is None else light
    ids = np.ones((H, W), np.int32) if ids is None else ids
    depth = np.broadcast_to(np.float32(depth), (H, W))
    moved = None if motion is None else jnp.broadcast_to(jnp.asarray(motion, jnp.float32), (H, W, 2))
    camera = orthographic(W, H, 0.2)
    return Frame(jnp.asarray(light), jnp.asarray(depth), None, None, jnp.asarray(ids), moved, camera)


def config(name="as", **options):
    known = {"target_variance": 2e-4, "max_spp": 64} if name != "fixed" else {}
    kept: dict[str, Any] = {"settings": SETTINGS}
    kept |= {
        key: options.pop(key) for key in ("gamma", "history_dtype", "seed", "settings") if key in options
    }
    policy = policies.named(name, **known | options)
    return sequence.Config(policy, PROFILES, **kept)


def run(frames, chosen):
    return [(np.asarray(image), info) for _, image, info in sequence.scan(frames, chosen)]


def test_a_fixed_count_gives_the_images_of_every_profile():
    frames = [frame(), frame(light=2 * TEXTURE)]
    for number, (image, info) in enumerate(run(frames, config("fixed", spp=16, seed=3))):
        wanted = scatter.every_profile(
            frames[number], PROFILES, counts=16, settings=SETTINGS, seed=3 * SEEDS, number=number
        )
        np.testing.assert_array_equal(image, wanted)
        assert np.all(np.asarray(info.counts) == 16)


def test_images_of_one_frame_again_have_noise_of_their_own():
    (one, _), (other, _) = run([frame()] * 2, config("fixed", spp=16))
    assert not np.array_equal(one, other)
    (again, _), (with_another_seed, _) = (run([frame()], config("fixed", spp=16, seed=s))[0] for s in (0, 1))
    np.testing.assert_array_equal(again, one)
    assert not np.array_equal(with_another_seed, one)


def by_hand(values, drawn, *, target, alpha, kappa):
    """Counts of the 2021 paper's Eq 5 to 10, in double precision; None before the first."""
    mean_count = mean = variance = None
    for value, count in zip(values, drawn, strict=True):
        value, count = np.asarray(value, float), np.asarray(count, float)
        if variance is None:
            mean_count, mean, variance = count, value, np.full_like(value, target)
        else:
            mean_count = (1 - alpha) * mean_count + alpha * count
            delta = value - mean
            mean = mean + alpha * delta
            variance = (1 - alpha) * (variance + alpha * delta**2)
        correction = (variance - target) / target * mean_count * (2 / alpha - 2)
        yield np.clip(kappa * correction + variance / target * mean_count, 8, 64)


def test_counts_follow_the_papers_equations():
    found = run([frame()] * 6, config("as", alpha=0.2, kappa=0.1))
    counts = [np.asarray(info.counts) for _, info in found]
    values = [np.asarray(info.value) for _, info in found]
    assert np.all(counts[0] == 8) and np.ptp(counts[5]) > 30
    wanted = list(by_hand(values, counts, target=2e-4, alpha=0.2, kappa=0.1))
    for given, drawn in zip(wanted, counts[1:], strict=False):
        # Rounded to the nearest, and what float32 makes of the ends of the rounding.
        assert np.all(np.abs(given - drawn) <= 0.5 + 1e-3)


def test_what_is_learned_from_is_the_luminance_over_pi():
    for gamma in (1.0, 2.2):
        ((image, info),) = run([frame(light=TEXTURE * [1.0, 0.5, 0.1])], config("ocv", gamma=gamma))
        wanted = (image @ [0.2126, 0.7152, 0.0722] / np.pi) ** (1 / gamma)
        np.testing.assert_allclose(info.value, wanted, rtol=1e-5, atol=1e-7)


def test_a_history_moves_with_its_pixels():
    """Everything moves three pixels to the right each frame; what comes in at the left is new."""
    chosen, still = config("as", alpha=0.3), run([frame()] * 3, config("as", alpha=0.3))
    moving = [frame(light=np.roll(TEXTURE, 3 * k, axis=1), motion=[-3.0, 0.0]) for k in range(3)]
    state, seen = sequence.init(moving[0], chosen), []
    for each in moving:
        before = state.memory
        state, _, info = sequence.step(state, each, chosen)
        seen.append((before, state.memory, info))
    for before, after, info in seen[1:]:
        missing = np.asarray(info.missing)
        assert missing[:, :3].all() and not missing[:, 3:].any()
        assert np.all(np.asarray(info.counts)[:, :3] == 8)
        # A moving mean is alpha of the newest frame and the rest of what lay three pixels to the left.
        old, new = np.asarray(before.count.mean), np.asarray(after.count.mean)
        wanted = 0.7 * old[:, :-3] + 0.3 * np.asarray(info.value)[:, 3:]
        np.testing.assert_allclose(new[:, 3:], wanted, rtol=2e-6)
    # Where nothing has moved, nothing is missing but in the first frame.
    assert [bool(np.asarray(info.missing).any()) for _, info in still] == [True, False, False]


def test_uncovered_pixels_start_afresh():
    ids = np.ones((H, W), np.int32)
    ids[:, 20:] = 2
    first, then = frame(ids=ids), frame()
    deeper = frame(depth=600.0)
    chosen = config("as")
    (_, one), (image, two), (_, three), (_, four) = run([first, then, then, deeper], chosen)
    assert np.all(np.asarray(one.counts)[:, 20:] == 0)
    np.testing.assert_array_equal(np.asarray(two.missing), ids == 2)
    assert np.all(np.asarray(two.counts)[:, 20:] == 8)
    assert not np.asarray(three.missing).any() and np.asarray(four.missing).all()
    assert np.isfinite(image).all()


def flashing(frames=12):
    return [frame(light=np.float32(1 + np.sin(k / 2)) * TEXTURE) for k in range(frames)]


@pytest.mark.slow
def test_a_control_variate_takes_the_light_out():
    """A light on all pixels alike: adaptive sampling takes its changes for noise."""
    means = {}
    for name in ("as", "ocv", "in_frame", "oracle"):
        found = run(flashing(40), config(name, target_variance=2e-3))
        means[name] = np.mean([np.asarray(info.counts) for _, info in found[15:]])
    assert means["as"] > 1.5 * means["oracle"]
    assert means["ocv"] < 0.85 * means["as"]
    assert means["in_frame"] == pytest.approx(means["oracle"], rel=0.1)


def test_the_light_around_is_the_mean_of_one_profile():
    ids = np.ones((H, W), np.int32)
    ids[:, 12:] = 2
    light = np.where((ids == 1)[..., None], TEXTURE, 1e6).astype(np.float32)
    mask = jnp.asarray(ids == 1)
    found = np.asarray(_guidance.surround(jnp.asarray(light[..., 0]), mask))
    for rows, columns in ((slice(0, 8), slice(0, 8)), (slice(8, 16), slice(8, 12))):
        wanted = light[rows, columns, 0].mean(dtype=float)
        np.testing.assert_allclose(found[rows, columns], wanted, rtol=1e-5)
    assert np.all(found[:, 16:] == 0)


def test_nothing_is_compiled_anew():
    programs: tuple[Any, ...] = (_pass._table, _pass._scene, _pass._ordered)
    programs += (_pass._lane_alone, _pass._lane_within)
    programs += (_pass._image, _pass._image_and_variance, _history._missing, sequence._counts)
    programs += (_guidance.light_on, _guidance.measured, _learning._strips, _footprint._looked_up)
    for name in ("as", "ocv", "in_frame", "fixed"):
        list(sequence.scan(flashing()[:2], config(name)))
    before = [program._cache_size() for program in programs]
    for name in ("as", "ocv", "in_frame", "fixed"):
        counts = [np.asarray(info.counts).max() for _, info in run(flashing(), config(name, seed=5))]
        assert name == "fixed" or counts[0] == 8 < 32 < max(counts)
    assert [program._cache_size() for program in programs] == before


@pytest.mark.slow
@pytest.mark.parametrize("name", ["as", "ocv", "ccv", "unreal", "in_frame"])
def test_histories_of_half_precision(name):
    whole, half = (
        [
            np.asarray(info.counts, float).mean()
            for _, info in run([frame()] * 6, config(name, history_dtype=t))
        ]
        for t in (jnp.float32, jnp.float16)
    )
    # A moving variance of 1e-4 has 11 bits in half: counts of 64 change by less than one in the mean.
    np.testing.assert_allclose(half, whole, atol=1.0)
    state = sequence.init(frame(), config(name, history_dtype=jnp.float16))
    assert {leaf.dtype for leaf in jax.tree.leaves(state.memory)} == {jnp.dtype("float16")}


@pytest.mark.slow
def test_pixels_without_distant_light_draw_none():
    wide = Settings(points="fresh", distance="plane", split=0.5)
    found = run([frame()] * 2, config("as", settings=wide))
    assert all(np.all(np.asarray(info.counts) > 0) for _, info in found)
    narrow = sequence.Config(policies.named("as"), {1: (0.01, 0.01, 0.01)}, settings=wide)
    ((image, info),) = run([frame()], narrow)
    assert not np.asarray(info.counts).any()
    np.testing.assert_array_equal(image, TEXTURE)


def test_float64_beside_it_and_a_single_pixel():
    tiny = frame()
    names = ("irradiance", "depth", "profile_id")
    tiny = tiny._replace(**{n: getattr(tiny, n)[:1, :1] for n in names}, camera=orthographic(1, 1, 0.2))
    for each in (frame(), tiny):
        for name in ("ocv", "in_frame"):
            with jax.enable_x64(True):
                ((image, info), _) = run([each] * 2, config(name))
            assert image.dtype == np.float32 and info.value.dtype == np.float32
            assert np.isfinite(image).all() and np.asarray(info.counts).min() >= 8


@pytest.mark.parametrize("name", ["as", "ocv", "in_frame"])
def test_a_nan_is_forgotten_with_the_frame_that_has_it(name):
    broken = TEXTURE.copy()
    broken[10, 20] = np.nan
    chosen = config(name, target_variance=1.0)
    found = run([frame(), frame(light=broken), frame(), frame()], chosen)
    assert not np.isfinite(found[1][0]).all()
    for image, info in found[2:]:
        # What had a NaN in it starts afresh, with the least count.
        assert np.isfinite(image).all() and np.all(np.asarray(info.counts) == 8)
    motion = np.zeros((H, W, 2), np.float32)
    motion[3, 4] = np.nan
    lost = run([frame(), frame()._replace(motion=jnp.asarray(motion))], chosen)[1][1].missing
    np.testing.assert_array_equal(np.argwhere(np.asarray(lost)), [[3, 4]])


def test_frames_in_which_nothing_scatters():
    black = frame(light=np.zeros((H, W, 3), np.float32))
    for chosen in (config("ocv"), config("in_frame")):
        found = run([black, frame(ids=np.zeros((H, W), np.int32)), frame()], chosen)
        assert all(np.isfinite(image).all() for image, _ in found)
        assert not np.asarray(found[1][1].counts).any()
        assert np.asarray(found[2][1].missing).all()


def test_a_memory_that_is_written_over():
    frames, chosen = flashing(4), config("ocv")
    state, states, found = sequence.init(frame(), chosen), [], []
    for each in frames:
        state, image, info = sequence.step(state, each, chosen)
        states.append(state)
        found.append((image, info.counts))
    going, gone = sequence.scan(frames, chosen, keep_states=False), []
    for (new, image, info), (other, counts) in zip(going, found, strict=True):
        np.testing.assert_array_equal(image, other)
        np.testing.assert_array_equal(info.counts, counts)
        gone.append(new)
    deleted = [[leaf.is_deleted() for leaf in jax.tree.leaves(each.memory)] for each in gone]
    assert all(map(all, deleted[:-2])) and not any(map(any, deleted[-2:]))
    # What was given to be written over is gone, everything else is as it was.
    first, kept = states[0], jax.tree.map(np.asarray, states[1].memory)
    after = sequence.step(states[1], frames[2], chosen, spare=first)[0]
    assert all(leaf.is_deleted() for leaf in jax.tree.leaves(first.memory))
    for a, b in ((states[1].memory, kept), (after.memory, states[2].memory)):
        jax.tree.map(np.testing.assert_array_equal, a, b)


def test_memory_that_cannot_be_written_over_is_refused():
    chosen = config("ocv")
    one = sequence.step(sequence.init(frame(), chosen), frame(), chosen)[0]
    two = sequence.step(one, frame(), chosen)[0]
    small = frame()._replace(depth=jnp.ones((3, 4)))
    half = config("ocv", history_dtype=jnp.float16)
    for other, of in ((frame(), config("as")), (small, chosen), (frame(), half)):
        with pytest.raises(ValueError, match="^spare must be a state of the same sequence, with the same"):
            sequence.step(two, frame(), chosen, spare=sequence.init(other, of))
    with pytest.raises(ValueError, match="^spare must be another state than the one that the step begins"):
        sequence.step(two, frame(), chosen, spare=two._replace(number=0))
    three = sequence.step(two, frame(), chosen, spare=one)[0]
    with pytest.raises(ValueError, match="^spare must not have been given before: its memory is gone$"):
        sequence.step(three, frame(), chosen, spare=one)


@pytest.mark.slow
@pytest.mark.parametrize("motion", [None, [-1.0, 0.0]])
def test_sequences_within_a_transformation(motion):
    """By the target, on which the second frame's memory depends, and over several lights at once."""

    def learned(target, factor):
        policy = policies.Adaptive(
            control_variate.Config(sample_count.Controller(target, rounding="nearest"), constant=0.0)
        )
        frames = [frame(light=factor * TEXTURE, motion=motion)] * 2
        *_, (state, _, _) = sequence.scan(frames, sequence.Config(policy, PROFILES, settings=SETTINGS))
        return jnp.sum(state.memory.count.variance)

    target, step = 1e-3, 1e-5
    _, slope = jax.jvp(lambda t: learned(t, 1.0), (target,), (1.0,))
    assert float(jax.grad(lambda t: learned(t, 1.0))(target)) == pytest.approx(float(slope), rel=1e-5)
    # The variance begins with the target, and later counts are whole numbers, whose slope is 0.
    change = (learned(target + step, 1.0) - learned(target - step, 1.0)) / (2 * step)
    assert float(slope) == pytest.approx(float(change), rel=0.02)
    factors = jnp.array([0.5, 1.0], jnp.float32)
    together = jax.vmap(lambda f: learned(target, f))(factors)
    alone = [float(learned(target, float(f))) for f in factors]
    np.testing.assert_allclose(together, alone, rtol=1e-4)


def test_the_gain_of_a_lost_pixel_stays_lost():
    chosen = config("in_frame", gain_alpha=0.1)
    state = sequence.init(frame(), chosen)
    for _ in range(3):
        state, _, _ = sequence.step(state, frame(), chosen)
    broken = eqx.tree_at(
        lambda m: m.gain.temporal, state.memory, replace_fn=lambda v: v.at[9, 9].set(jnp.nan)
    )
    _, _, info = sequence.step(state._replace(memory=broken), frame(), chosen)
    counts, whole = (np.asarray(i.counts) for i in (info, sequence.step(state, frame(), chosen)[2]))
    assert counts[9, 9] == 8 < whole[9, 9] and np.isfinite(counts).all()
    # Those around share a gain without it, all others are as they were.
    changed = np.argwhere(counts != whole)
    assert np.all((changed >= 8) & (changed < 16))


def test_a_state_of_the_callers_own_is_not_written_over():
    chosen = config("as")
    state = sequence.init(frame(), chosen)
    given = sequence.step(state, frame(), chosen)[0]
    *_, (last, _, _) = sequence.scan([frame()] * 4, chosen, given, keep_states=False)
    assert last.number == 5
    every = [new for new, _, _ in sequence.scan([frame()] * 4, chosen, given)]
    assert not any(leaf.is_deleted() for each in every for leaf in jax.tree.leaves(each.memory))
    assert not any(leaf.is_deleted() for leaf in jax.tree.leaves(given.memory))


@pytest.mark.parametrize(
    ("name", "cores"),
    [("ocv", 3), *(pytest.param(n, c, marks=pytest.mark.slow) for n in ("as", "in_frame") for c in (1, 2))],
)
def test_strips_and_lanes_make_no_difference(monkeypatch, name, cores):
    """Of a height that is no multiple of a strip's, by a policy whose target differs from pixel to pixel."""
    height, generator = 37, np.random.default_rng(1)

    def layer(low=0.0):
        return jnp.asarray(generator.uniform(low, 1, (height, W)), jnp.float32)

    policy = policies.named(name, target_variance=layer(0.1))
    zero = policy.init(layer())
    memory = jax.tree.map(lambda _: layer(), zero)
    missing = layer() < 0.2
    known = policies.Known(layer(), layer(), jnp.float32(0), missing)
    counts, value = jnp.round(20 * layer()).astype(jnp.int32), layer()
    variance = layer() if name == "in_frame" else None
    deviation = 0 * value if variance is None else variance * jnp.maximum(counts - 1, 0)
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    found = _learning.after(policy, memory, known, counts, value, variance)
    wanted, _ = policy.learn(memory, known, policies.Sampled(counts, value, deviation))
    # Fused otherwise, products are rounded or not before a sum.
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6), found, wanted)


@pytest.mark.slow
def test_neighbours_share_the_gain_of_evenly_spread_points():
    """On a uniform surface all pixels have one variance, which evenly spread points lower alike."""
    light = (
        np.ones((H, W, 3), np.float32) * np.asarray(1 + 0.5 * np.sin(np.arange(W) / 2), np.float32)[:, None]
    )
    settings, options = Settings(distance="plane"), {"target_variance": 1e-4, "max_spp": 256}
    drawn, spread = {}, {}
    for gain in (None, sequence.GAIN_ALPHA):
        chosen = config("in_frame", settings=settings, gain_alpha=gain, **options)
        found = run([frame(light=light)] * 60, chosen)
        drawn[gain] = np.mean([np.asarray(info.counts) for _, info in found[30:]])
        values = np.array([np.asarray(info.value) for _, info in found[30:]])
        spread[gain] = values.var(axis=0, ddof=1).mean() / 1e-4
    (plain, learned), (much, near) = drawn.values(), spread.values()
    # Four times the samples that it takes, for a quarter of the variance.
    assert learned < 0.3 * plain and much < 0.3
    # No pixel is at the least count. The mean of 960 variances of 29 degrees of freedom is known to 1 % if
    # pixels are independent; they share sixteen versions of the points.
    assert abs(near - 1) < 0.1


def test_what_does_not_go_together_is_refused():
    with pytest.raises(ValueError, match="^gamma must be above 0, got 0$"):
        config("as", gamma=0.0)
    with pytest.raises(ValueError, match="^gamma must be 1 for a policy that knows variances of samples"):
        config("in_frame", gamma=2.2)
    with pytest.raises(ValueError, match="^oracle_spp must be at least 2, got 1$"):
        sequence.Config(policies.named("oracle"), PROFILES, oracle_spp=1)
    with pytest.raises(ValueError, match="^depth_tolerance must be at least 0, got -1$"):
        sequence.Config(policies.named("as"), PROFILES, depth_tolerance=-1)
    with pytest.raises(ValueError, match="^seed must be from 0 to 4194303, got -1$"):
        config("as", seed=-1)
    with pytest.raises(ValueError, match="^policy must not be MedianFiltered, which is for a line of pixels"):
        sequence.Config(policies.MedianFiltered(policies.named("as")), PROFILES)
    state = sequence.init(frame(), config())
    small = frame()._replace(depth=jnp.ones((3, 4)))
    with pytest.raises(ValueError, match="^frame must have the size of those before it, 40 x 24, got 4 x 3$"):
        sequence.step(state, small, config())
    with pytest.raises(ValueError, match="3 is missing"):
        sequence.step(state, frame(ids=np.full((H, W), 3, np.int32)), config())
