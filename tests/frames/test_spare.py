"""Memory that passes hand on, and the order in which segments are sampled."""

import os
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.frames import _order, _spare, scatter
from sssfit.frames.camera import orthographic
from sssfit.frames.points import Distance, Settings

D = [0.5, 0.3, 0.1]


def frame(seed, height=20, width=33):
    return np.random.default_rng(seed).uniform(0.1, 1, (height, width, 3)).astype(np.float32)


def run(light, distance: Distance = "plane", **options):
    height, width = light.shape[:2]
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), light.shape)
    return scatter.scatter(
        light, np.full((height, width), 500, np.float32), orthographic(width, height, 0.2), d=D, counts=8,
        normal=normal, settings=Settings(distance=distance), **options,
    )  # fmt: skip


@pytest.fixture
def kept(monkeypatch):
    """What is kept, empty to begin with."""
    kept = {}
    monkeypatch.setattr(_spare, "_kept", kept)
    return kept


def test_a_pass_writes_over_the_scene_of_the_one_before(kept):
    one = np.asarray(run(frame(0)))
    _, scene = kept["scene"]
    address = scene.unsafe_buffer_pointer()
    again = np.asarray(run(frame(1)))
    _, after = kept["scene"]
    assert scene.is_deleted() and after.unsafe_buffer_pointer() == address
    np.testing.assert_array_equal(run(frame(0)), one)
    assert not np.array_equal(again, one)


@pytest.mark.slow
def test_at_most_one_scene_is_kept(kept):
    cases: list[tuple[np.ndarray, Distance]] = [
        (frame(0), "plane"), (frame(0, 9, 40), "plane"), (frame(0), "surface"),
    ]  # fmt: skip
    for light, distance in cases:
        found = np.asarray(run(light, distance))
        assert len(kept) == 1
        kept.clear()
        np.testing.assert_array_equal(run(light, distance), found)


@pytest.mark.parametrize("cores", [1, 2])
def test_results_that_nobody_has_waited_for_are_not_written_over(kept, monkeypatch, cores):
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    lights = [frame(seed) for seed in range(12)]
    found = [run(light) for light in lights]
    for light, result in zip(lights, found, strict=True):
        kept.clear()
        np.testing.assert_array_equal(run(light), result)


def test_a_device_that_one_caller_chose_does_not_bind_the_next(kept):
    light = jax.device_put(frame(0), jax.devices()[0])
    assert run(light).committed
    assert not run(frame(0)).committed


def test_threads_do_not_share_a_scene(kept):
    lights = [frame(seed) for seed in range(16)]
    wanted = [np.asarray(run(light)) for light in lights]
    with ThreadPoolExecutor(4) as pool:
        for found, result in zip(pool.map(run, lights * 3), wanted * 3, strict=True):
            np.testing.assert_array_equal(found, result)


def test_nothing_is_kept_within_a_program_or_beyond_the_largest(kept, monkeypatch):
    jax.jit(lambda light: run(light, most=8))(jnp.asarray(frame(0)))
    assert not kept
    monkeypatch.setattr(_spare, "_LARGEST", 100)
    run(frame(0))
    assert not kept


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 2, 3])
def test_each_segment_is_sampled_once_with_others_of_like_counts(lanes):
    rng = np.random.default_rng(lanes)
    counts = np.where(rng.random((300, 700)) < 0.5, 0, rng.integers(0, 65, (300, 700)))
    counts[:, 512:] = 0
    blocks, largest, places = (np.asarray(v) for v in _order.of_segments(jnp.asarray(counts), lanes))
    segments = np.pad(counts, ((0, 0), (0, -700 % 16))).reshape(300, -1, 16).max(axis=2).ravel()
    used = blocks[blocks < segments.size]
    np.testing.assert_array_equal(np.sort(used), np.arange(segments.size))
    np.testing.assert_array_equal(blocks.ravel()[places], np.arange(segments.size))
    np.testing.assert_array_equal(largest, np.pad(segments, (0, 1))[blocks].max(axis=1))
    lane = largest.reshape(-1, lanes)
    # A lane can stop at its first block without samples, and none has more than one block's samples more.
    assert np.all((lane[:-1] > 0) | (lane[1:] == 0))
    assert np.ptp(lane.sum(axis=0)) <= largest.max()
