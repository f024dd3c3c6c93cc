"""`frames.render`: which passes run, on which random numbers, and which exact answer is taken where."""

from contextlib import contextmanager, nullcontext

import numpy as np
import pytest

from sssfit.frames import exact, gbuffer, procedural, render, scatter
from sssfit.frames.camera import orthographic
from sssfit.frames.points import Settings

PLANE = Settings(distance="plane")
FRAME = procedural.frame(width=48, height=27)
PROFILES = {1: np.array([0.9, 0.4, 0.0]), 2: None}
IDS = np.asarray(FRAME.profile_id)


@pytest.fixture
def steps():
    names = []

    @contextmanager
    def step(name):
        names.append(name)
        yield

    step.names = names
    return step


def flat(**changes):
    depth = np.full(IDS.shape, 400, np.float32)
    return FRAME._replace(depth=depth, camera=orthographic(48, 27, 0.3), **changes)


def test_sampling_repeats_with_other_random_numbers(steps):
    made = render.by_sampling(FRAME, PROFILES, PLANE, least=8, most=8, seed=5, step=steps)
    again = list(render.replicates(FRAME, PROFILES, PLANE, made.counts, number=3, seed=5, step=steps))
    assert steps.names == ["compile final", "final", "replicate 1", "replicate 2", "replicate 3"]
    for image, seed in zip([made.image, *again], (0, 2, 3, 4), strict=True):
        expected = scatter.every_profile(FRAME, PROFILES, counts=8, settings=PLANE, seed=5 * 1024 + seed)
        np.testing.assert_array_equal(image, expected)
    assert made.pilot_samples == 0 and made.left_out == {}
    np.testing.assert_array_equal(made.counts, np.where(IDS == 1, 8, 0))
    np.testing.assert_array_equal(made.image[IDS != 1], np.asarray(FRAME.irradiance)[IDS != 1])


def test_a_profile_of_no_width_draws_nothing(steps):
    made = render.by_sampling(FRAME, {1: np.zeros(3), 2: None}, PLANE, least=8, most=8, step=steps)
    assert not made.counts.any()
    np.testing.assert_array_equal(made.image, FRAME.irradiance)


def test_sums_are_convolutions_on_flat_frames(steps):
    made = render.by_sums(flat(normal=None), PROFILES, step=steps)
    expected = exact.convolve(FRAME.irradiance, PROFILES[1], (0.3, 0.3), mask=IDS == 1)
    assert steps.names == ["id 1"] and made.left_out[1].tolist() == [0, 0, 0]
    np.testing.assert_allclose(made.image[IDS == 1], expected[IDS == 1], rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(made.image[IDS != 1], np.asarray(FRAME.irradiance)[IDS != 1])


def test_sums_over_visible_pixels_elsewhere():
    shares = []

    def step(name, share=1.0):
        shares.append((name, share))
        return nullcontext()

    made = render.by_sums(FRAME, PROFILES, radius_limit=5.0, step=step)
    assert {name for name, _ in shares} == {"id 1"} and sum(share for _, share in shares) == pytest.approx(1)
    lit, depth, facing = (np.asarray(v) for v in (FRAME.irradiance[..., :2], FRAME.depth, FRAME.normal))
    d = PROFILES[1][:2]
    expected = exact.visible(lit, depth, facing, FRAME.camera, d, mask=IDS == 1, radius_limit=5.0)
    np.testing.assert_array_equal(made.image[IDS == 1][:, :2], expected.scattered[IDS == 1])
    np.testing.assert_array_equal(made.image[..., 2], FRAME.irradiance[..., 2])
    assert made.left_out[1].tolist() == [*expected.left_out, 0]
    with pytest.raises(ValueError, match="needs the frame's normals"):
        render.by_sums(FRAME._replace(normal=None), PROFILES)


def test_the_size_of_a_file(tmp_path):
    gbuffer.write(tmp_path / "a.exr", FRAME)
    assert render.size(tmp_path / "a.exr") == (48, 27)
    assert render.size(tmp_path / "a.exr", "albedo") == (48, 27)


@pytest.mark.parametrize("seed", [-1, 2**22])
def test_seeds_out_of_range(seed):
    with pytest.raises(ValueError, match="seed must be from 0 to 4194303"):
        render.by_sampling(FRAME, PROFILES, PLANE, least=8, most=8, seed=seed)
    with pytest.raises(ValueError, match="seed must be from 0 to 4194303"):
        next(render.replicates(FRAME, PROFILES, PLANE, IDS, number=8, seed=seed))
    with pytest.raises(ValueError, match="number must be from 0 to 1022"):
        next(render.replicates(FRAME, PROFILES, PLANE, IDS, number=1023))
