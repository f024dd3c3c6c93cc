"""Monte Carlo scattering: what it converges to, what it keeps, and what depends on what."""

import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.frames import _order, exact, points, scatter
from sssfit.frames.camera import orthographic, perspective
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings

H, W = 36, 50
D = [0.9, 0.4, 0.15]
CAMERA = orthographic(W, H, 0.2)
DEPTH = np.full((H, W), 300.0, np.float32)
LIGHT = np.random.default_rng(0).random((H, W, 3)).astype(np.float32)
PLANE = Settings(distance="plane")
SEEDS = 8


def run(light=LIGHT, *, settings=PLANE, counts: Any = 64, seed=0, **options):
    return np.asarray(
        scatter.scatter(light, DEPTH, CAMERA, d=D, counts=counts, settings=settings, seed=seed, **options)
    )


def replicates(**options):
    return np.stack([run(seed=seed, **options) for seed in range(SEEDS)])


def agrees(found, expected, errors=4.5):
    """Means over a frame, whose pixels share tables: the error is that between seeds."""
    means = found.mean(axis=(1, 2), dtype=float)
    error = means.std(axis=0, ddof=1) / np.sqrt(len(found))
    # 7.2 errors that eight seeds state themselves: what Student's t with 7 degrees of freedom exceeds once in
    # 5,000 times.
    return np.abs(means.mean(axis=0) - expected.mean(axis=(0, 1))) < 1.6 * errors * error + 1e-6


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"channels": "widest"},
        {"sequence": "iid"},
        pytest.param({"sequence": "sobol"}, marks=pytest.mark.slow),
        pytest.param({"sequence": "fibonacci"}, marks=pytest.mark.slow),
        {"cutoff": None},
        {"importance": "xie"},
        pytest.param({"importance": "mixture"}, marks=pytest.mark.slow),
        pytest.param({"importance": "table"}, marks=pytest.mark.slow),
        {"channels": "each"},
        {"points": "fresh"},
        pytest.param({"points": "fresh", "channels": "each", "sequence": "sobol"}, marks=pytest.mark.slow),
        pytest.param({"points": "fresh", "sequence": "hammersley"}, marks=pytest.mark.slow),
        pytest.param({"points": "fresh", "distance": "surface"}, marks=pytest.mark.slow),
        pytest.param({"distance": "surface"}, marks=pytest.mark.slow),
        {"distance": "surface", "plane": "tangent"},
    ],
    ids=str,
)
def test_flat_frames_converge_to_the_convolution(changed):
    settings = PLANE._replace(**changed)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), (H, W, 3))
    found = replicates(settings=settings, normal=normal, counts=256)
    expected = exact.convolve(LIGHT, D, (0.2, 0.2), cutoff=settings.cutoff)
    assert np.all(agrees(found, expected))
    # Pixel by pixel: two halves' errors multiplied are free of their noise.
    halves = found.reshape(2, -1, H, W, 3).mean(axis=1) - expected
    product = (halves[0] * halves[1]).reshape(-1, 3)
    assert np.all(np.abs(product.mean(axis=0)) < 5 * product.std(axis=0) / np.sqrt(len(product)) + 1e-8)


def test_the_papers_uncorrected_weight_is_biased_as_its_radii():
    """Light that grows as r^2 around a pixel: the mean square radius of g(xi | 2.5715) is 10.6099 % low."""
    camera = orthographic(257, 257, 1 / 16)
    place = (np.arange(257) - 128) / 16
    light = (place**2 + place[:, None] ** 2)[..., None].astype(np.float32)
    counts = np.zeros((257, 257), int)
    counts[128, 128] = 4096
    settings = PLANE._replace(importance="xie", channels="widest", cutoff=None)
    depth = np.full((257, 257), 300, np.float32)
    # Few enough shapes across that nothing of the profile falls beyond the frame's edge.
    d, means = 0.2, {}
    for corrected in (True, False):
        chosen = settings._replace(corrected=corrected)
        found = [
            scatter.scatter(light, depth, camera, d=[d], counts=counts, settings=chosen, seed=seed)[
                128, 128, 0
            ]
            for seed in range(SEEDS)
        ]
        means[corrected] = np.mean(found), np.std(found, ddof=1) / np.sqrt(SEEDS)
    # A pixel's square adds its own second moment, 2 / 12 of its size squared.
    expected = 14 * d**2 - 2 / 12 / 256
    for corrected, factor in ((True, 1), (False, 1 - 0.106099)):
        mean, error = means[corrected]
        assert abs(mean - factor * 14 * d**2 + 2 / 12 / 256) < 5 * error + 1e-4 * expected
    assert means[True][0] - means[False][0] > 5 * means[True][1]


def sphere(camera, radius=9.0, distance=120.0):
    """A sphere seen in perspective: depth, normals and mask."""
    across, down = (np.asarray(c) for c in camera.pixel_centres(np.float32))
    ray = np.stack(
        np.broadcast_arrays((across - camera.cx) / camera.fx, (camera.cy - down) / camera.fy, -1.0), axis=-1
    )
    centre = np.array([0, 0, -distance])
    along = ray @ centre
    root = along**2 - np.sum(ray**2, axis=-1) * (distance**2 - radius**2)
    mask = root > 0
    depth = np.where(mask, (along - np.sqrt(np.maximum(root, 0))) / np.sum(ray**2, axis=-1), 1e6)
    normal = np.where(mask[..., None], (ray * depth[..., None] - centre) / radius, 0)
    return depth.astype(np.float32), normal.astype(np.float32), mask


@pytest.mark.parametrize("plane", ["screen", "tangent"])
def test_curved_frames_converge_to_the_sum_over_what_is_seen(plane):
    camera = perspective(W, H, fx=200.0)
    depth, normal, mask = sphere(camera)
    settings = Settings(plane=plane)
    expected = exact.visible(LIGHT, depth, normal, camera, D, mask=mask).scattered
    found = np.stack(
        [
            np.asarray(
                scatter.scatter(LIGHT, depth, camera, d=D, counts=512, mask=mask, normal=normal,
                                settings=settings, seed=seed)
            )
            for seed in range(SEEDS)
        ]
    )  # fmt: skip
    assert np.array_equal(found[0][~mask], LIGHT[~mask])
    inside = np.where(mask[..., None], found, 0), np.where(mask[..., None], expected, 0)
    assert np.all(agrees(*inside))


@pytest.mark.parametrize("settings", [PLANE._replace(estimator="ratio"), Settings(estimator="ratio")])
def test_constant_light_stays_constant_for_every_mask_and_normalized_method(settings):
    mask = np.random.default_rng(1).random((H, W)) < 0.6
    found = run(np.full((H, W, 3), 0.7, np.float32), settings=settings, mask=mask, counts=17)
    np.testing.assert_allclose(found, 0.7, rtol=1e-6)


def test_constant_light_stays_constant_in_the_mean_away_from_edges():
    found = replicates(light=np.ones((H, W, 3), np.float32))[:, 15:21, 20:30]
    share = exact.convolve(np.ones((H, W, 3)), D, (0.2, 0.2))[15:21, 20:30]
    assert np.all(agrees(found, share))


def test_profiles_do_not_bleed():
    mask = np.zeros((H, W), bool)
    mask[:, : W // 2] = True
    found = run(mask=mask)
    other = run(np.where(mask[..., None], LIGHT, 1e9), mask=mask)
    np.testing.assert_array_equal(found[mask], other[mask])
    np.testing.assert_array_equal(found[~mask], LIGHT[~mask])


def test_what_is_outside_the_mask_may_be_anything():
    mask = np.ones((H, W), bool)
    mask[3:9, 4:20] = False
    rubbish = np.where(mask[..., None], LIGHT, np.nan)
    normal = np.where(mask[..., None], np.array([0, 0, 1], np.float32), np.nan)
    depth = np.where(mask, DEPTH, np.nan)
    found = scatter.scatter(
        rubbish, depth, CAMERA, d=D, counts=16, mask=mask, normal=normal, settings=Settings()
    )
    assert np.all(np.isfinite(np.asarray(found)[mask]))


def test_a_pixels_result_depends_on_its_own_count_alone():
    uneven = np.random.default_rng(2).integers(0, 65, (H, W))
    found, all_of_them = run(counts=uneven), run(counts=64)
    np.testing.assert_array_equal(found[uneven == 64], all_of_them[uneven == 64])
    np.testing.assert_array_equal(found[uneven == 0], LIGHT[uneven == 0])
    few = run(counts=np.minimum(uneven, 9), most=64)
    np.testing.assert_array_equal(few[uneven == 7], found[uneven == 7])
    np.testing.assert_array_equal(run(counts=uneven - 70, most=64), LIGHT)
    np.testing.assert_array_equal(run(counts=0), LIGHT)


@pytest.mark.slow
def test_blocks_and_lanes_change_nothing(monkeypatch):
    found = run(seed=5)
    for cores, block in ((1, 8192), (3, 512), (8, 4096)):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        monkeypatch.setattr(_order, "BLOCK", block)
        np.testing.assert_array_equal(run(seed=5), found)
        jax.clear_caches()


def test_seeds_and_frames_differ_and_repeat():
    one = run(seed=1)
    np.testing.assert_array_equal(run(seed=1), one)
    assert not np.array_equal(run(seed=2), one)
    assert not np.array_equal(run(seed=1, frame=1), one)


def test_neighbours_are_independent():
    """Errors of pixels next to each other, over seeds; in a row they use different versions of the table."""
    error = replicates(light=np.broadcast_to(LIGHT[:1, :, :1], (H, W, 3)).copy(), counts=16)
    error = error - error.mean(axis=0)
    for step in ((0, 1), (1, 0), (0, 16)):
        moved = error[:, step[0] :, step[1] :], error[:, : H - step[0], : W - step[1]]
        correlation = np.mean(moved[0] * moved[1]) / np.mean(error**2)
        # Versions are shared by one in sixteen pixels, at angles of their own.
        assert abs(correlation) < 0.1, (step, correlation)


def test_compiled_mapped_and_differentiated():
    def whole(light, seed):
        return scatter.scatter(light, DEPTH, CAMERA, d=D, counts=16, settings=PLANE, most=16, seed=seed)

    both = jax.jit(jax.vmap(whole, in_axes=(None, 0)))(jnp.asarray(LIGHT), jnp.arange(2))
    for seed in range(2):
        np.testing.assert_allclose(both[seed], run(counts=16, seed=seed), rtol=2e-6, atol=1e-7)
    # Linear in the light: the derivative in its own direction is the result.
    value, slope = jax.jvp(lambda light: whole(light, 0), (jnp.asarray(LIGHT),), (jnp.asarray(LIGHT),))
    np.testing.assert_allclose(slope, value, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("d", [1e-6, 1e6])
@pytest.mark.parametrize("settings", [PLANE, Settings()])
def test_the_ends_of_the_shape(d, settings):
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), (H, W, 3))
    found = np.asarray(
        scatter.scatter(LIGHT, DEPTH, CAMERA, d=[d] * 3, counts=16, normal=normal, settings=settings)
    )
    if d > 1:
        # Hardly anything comes back from so far.
        assert np.all(np.abs(found) < 1e-3)
    elif settings.distance == "plane":
        np.testing.assert_allclose(found, LIGHT, rtol=1e-5)
    else:
        # Far below a pixel nothing moves. One sample in 276 lies beyond the cut-off and is lost, which the
        # others' weights make up for in the mean over the sixteen versions of sixteen samples.
        beyond = 0.00362
        assert abs(np.mean(found / LIGHT) - 1) < 4.5 * np.sqrt(beyond / 256)
        assert np.all(np.isin(np.round(found / LIGHT * (1 - beyond) * 16, 2), np.arange(17)))


@pytest.mark.parametrize("shapes", [[0.0, 0.4, 0.15], [0.0, 0.0, 0.0]])
def test_a_channel_that_does_not_scatter_keeps_its_light(shapes):
    found = np.asarray(scatter.scatter(LIGHT, DEPTH, CAMERA, d=shapes, counts=16, settings=PLANE))
    assert np.all(np.isfinite(found))
    for channel, d in enumerate(shapes):
        assert np.array_equal(found[..., channel], LIGHT[..., channel]) == (d == 0)


def test_every_profile_of_a_frame():
    number = np.zeros((H, W), np.int32)
    number[:, 10:30], number[:, 30:] = 1, 2
    light, depth, ids = (jnp.asarray(v) for v in (LIGHT, DEPTH, number))
    frame = Frame(light, depth, None, None, ids, None, CAMERA)
    found = np.asarray(scatter.every_profile(frame, {1: D, 2: None}, counts=32, settings=PLANE))
    np.testing.assert_array_equal(found[:, 10:30], run(counts=32, mask=number == 1)[:, 10:30])
    np.testing.assert_array_equal(found[:, :10], LIGHT[:, :10])
    np.testing.assert_array_equal(found[:, 30:], LIGHT[:, 30:])
    with pytest.raises(
        ValueError, match="^profiles must name every id of the frame: 2 is missing, there are 1$"
    ):
        scatter.every_profile(frame, {1: D}, counts=32)


def test_what_is_refused():
    with pytest.raises(
        ValueError, match=r"^irradiance must have the shape \(H, W, C\), depth \(H, W\) and d"
    ):
        run(LIGHT[..., :2])
    with pytest.raises(ValueError, match="^normal must be given: the area that a pixel sees"):
        run(settings=Settings())
    with pytest.raises(
        ValueError, match="^sequence must be one of r2, iid, sobol, hammersley, fibonacci, got 'random'$"
    ):
        run(settings=points.Settings(sequence="random"))  # pyright: ignore[reportArgumentType]
