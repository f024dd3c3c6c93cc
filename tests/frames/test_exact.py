"""The limits of many samples: flat frames against brute force, curved ones against geometry."""

from contextlib import contextmanager, nullcontext

import equinox as eqx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files.exr import read_exr
from sssfit.frames import exact, gbuffer, pixel_kernel, procedural
from sssfit.frames.camera import orthographic, perspective

D = [0.9, 0.4, 0.15]


def cdf(x):
    return 1 - np.exp(-x) / 4 - 3 * np.exp(-x / 3) / 4


@pytest.fixture
def lit():
    return np.random.default_rng(0).random((14, 19, 3))


def test_flat_frames_by_summation(lit):
    found = exact.convolve(lit, D, (0.5, 0.4))
    expected = np.zeros_like(lit)
    for channel, d in enumerate(D):
        quarter = pixel_kernel.kernel((14, 19), (0.5, 0.4), d, cutoff=16.0)
        for j in range(14):
            for i in range(19):
                shares = quarter[np.abs(np.arange(14) - j)][:, np.abs(np.arange(19) - i)]
                expected[j, i, channel] = np.sum(shares * lit[..., channel])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_flips_and_transposes(lit):
    found = exact.convolve(lit, D, (0.5, 0.4))
    np.testing.assert_allclose(exact.convolve(lit[::-1], D, (0.5, 0.4)), found[::-1], atol=1e-12)
    turned = exact.convolve(lit.transpose(1, 0, 2), D, (0.4, 0.5))
    np.testing.assert_allclose(turned.transpose(1, 0, 2), found, atol=1e-12)


@given(st.floats(1e-6, 1e4), st.sampled_from([None, 1.0, 16.0]))
def test_light_is_neither_made_nor_lost_but_beyond_the_edge(d, cutoff):
    spot = np.zeros((15, 21, 1))
    spot[7, 10] = 1
    found = exact.convolve(spot, [d], (1.0, 1.0), cutoff=cutoff)
    edges = pixel_kernel.mass_in_quadrant(10.5, 7.5, d, cutoff=cutoff)
    assert found.sum() == pytest.approx(4 * float(edges), abs=1e-11)


def test_no_shape_keeps_the_light_and_masks_do_not_bleed(lit):
    np.testing.assert_allclose(exact.convolve(lit, [0.0] * 3, (1.0, 1.0)), lit, atol=1e-12)
    mask = np.zeros((14, 19), bool)
    mask[:, :9] = True
    found = exact.convolve(lit, D, (0.5, 0.4), mask=mask)
    other = exact.convolve(np.where(mask[..., None], lit, 1e6), D, (0.5, 0.4), mask=mask)
    np.testing.assert_array_equal(found, other)
    assert np.all(found[~mask] == 0)


@pytest.mark.parametrize("profile", ["skin1", "marble"])
def test_a_rendered_beam(rendered, profile):
    folder = rendered / "s1_beam"
    averaged = {"irradiance": "E_box"}
    frame = gbuffer.load(folder / "gbuffer.exr", folder / "camera.json", layers=averaged)
    layers, _ = read_exr(folder / f"exact_{profile}.exr")
    reference = np.stack([layers[f"sss.{c}"] for c in "RGB"], axis=-1)
    d = {"skin1": (1.917851, 0.479457, 0.203523), "marble": (7.929926, 5.016436, 3.408846)}[profile]
    found = exact.convolve(frame.irradiance, d, (0.125, 0.125))
    away = np.sqrt(
        np.mean(np.square(found - reference), axis=(0, 1)) / np.mean(np.square(reference), axis=(0, 1))
    )
    # The reference is at pixel centres, of a disc with a sharp edge: for the smallest d, 1.6 pixels wide,
    # its makers state 0.0028.
    assert np.all(away < 0.003), away


def plane(camera, normal, distance=300.0):
    """Depths of a plane through the axis, and its normal everywhere."""
    normal = np.asarray(normal, float) / np.linalg.norm(normal)
    across, down = camera.pixel_centres(np.float32)
    x, y = (np.asarray(across) - camera.cx) / camera.fx, (camera.cy - np.asarray(down)) / camera.fy
    if camera.projection == "perspective":
        depth = -distance * normal[2] / (normal[0] * x + normal[1] * y - normal[2])
    else:
        depth = distance + (normal[0] * x + normal[1] * y) / normal[2]
    return depth.astype(np.float32), np.broadcast_to(normal, (*depth.shape, 3)).astype(np.float32)


@pytest.mark.parametrize("size", [0.1, 0.5, 3.0])
def test_a_plane_that_faces_the_camera_is_a_flat_frame(size):
    camera = orthographic(20, 15, size)
    light = np.random.default_rng(1).random((15, 20, 3)).astype(np.float32)
    found = exact.visible(light, *plane(camera, (0, 0, 1)), camera, D, mask=np.ones((15, 20), bool))
    np.testing.assert_allclose(found.scattered, exact.convolve(light, D, (size, size)), atol=1e-3)
    assert np.all(found.left_out == 0)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_on_a_leaning_plane_all_light_comes_back(projection):
    """Uniform light on a plane stays what it is, wherever the camera stands; only the frame ends it."""
    camera = perspective(61, 61, fx=300.0) if projection == "perspective" else orthographic(61, 61, 1.0)
    surface = plane(camera, (0.5, -0.3, 0.8))
    found = exact.visible(np.ones((61, 61, 3), np.float32), *surface, camera, D, mask=np.ones((61, 61), bool))
    # The plane in the frame reaches 16 d and more around its middle.
    np.testing.assert_allclose(found.scattered[30, 30], 1, atol=2e-3)


@pytest.mark.slow
def test_on_a_sphere_the_share_is_that_of_its_chords():
    """With uniform light on all of it: cdf(2 R) / cdf(16 d) of the profile that ends at 16 d."""
    camera, radius, d = orthographic(161, 161, 0.125), 8.0, 1.0
    across, down = camera.pixel_centres(np.float32)
    x, y = np.broadcast_arrays((np.asarray(across) - 80.5) / 8, (80.5 - np.asarray(down)) / 8)
    mask = np.hypot(x, y) < radius
    z = np.sqrt(np.where(mask, radius**2 - x**2 - y**2, 0))
    normal = np.stack([x, y, z], axis=-1).astype(np.float32) / radius
    found = exact.visible(
        np.ones((161, 161, 1)), (100 - z).astype(np.float32), normal, camera, [d], mask=mask
    )
    # Seen from the pole the visible half ends at a distance of sqrt(2) R, where 1.8 % of the light is beyond.
    expected = cdf(np.sqrt(2) * radius / d) / cdf(16)
    assert found.scattered[80, 80, 0] == pytest.approx(expected, abs=3e-3)


def test_a_radius_limit_says_what_it_leaves_out():
    camera = orthographic(41, 41, 0.5)
    surface, mask = plane(camera, (0, 0, 1)), np.ones((41, 41), bool)
    one = np.ones((41, 41, 1), np.float32)
    found = exact.visible(one, *surface, camera, [0.5], mask=mask, cutoff=None, radius_limit=3.0)
    assert found.left_out == pytest.approx([1 - cdf(6.0)], rel=1e-12)
    # A limit falls between pixels: one ring of them more or less.
    around = [1 - cdf(r / 0.5) for r in (3.5, 2.5)]
    assert around[0] < 1 - found.scattered[20, 20, 0] < around[1]


def test_what_is_outside_the_mask_does_not_matter_and_an_empty_one_is_dark():
    camera = orthographic(12, 9, 0.5)
    depth, normal = plane(camera, (0, 0, 1))
    mask = np.zeros((9, 12), bool)
    mask[2:6, 3:9] = True
    light = np.where(mask[..., None], [1.0, 0.5, 2.0], np.nan).astype(np.float32)
    rubbish = np.where(mask, depth, np.nan), np.where(mask[..., None], normal, np.nan)
    found = exact.visible(light, *rubbish, camera, D, mask=mask).scattered
    crop = eqx.tree_at(lambda c: (c.cx, c.cy), camera, (camera.cx - 3, camera.cy - 2))
    inner = exact.visible(
        light[2:6, 3:9], depth[2:6, 3:9], normal[2:6, 3:9], crop, D, mask=np.ones((4, 6), bool)
    )
    np.testing.assert_allclose(found[2:6, 3:9], inner.scattered, rtol=1e-6)
    assert np.all(found[~mask] == 0)
    none = exact.visible(light, *rubbish, camera, D, mask=np.zeros((9, 12), bool))
    assert np.all(none.scattered == 0)


def test_what_is_refused(lit):
    with pytest.raises(ValueError, match=r"^irradiance must have the shape \(H, W, C\), d \(C,\) and mask"):
        exact.convolve(lit, [1.0], (1.0, 1.0))
    with pytest.raises(ValueError, match="^irradiance must be finite within the mask; leave such pixels out"):
        exact.convolve(np.full((2, 2, 1), np.nan), [1.0], (1.0, 1.0))
    with pytest.raises(ValueError, match=r"^d must be at least 0, got \[-1.0, 1.0, 1.0\]$"):
        exact.convolve(lit, [-1.0, 1.0, 1.0], (1.0, 1.0))
    camera = orthographic(19, 14, 1.0)
    with pytest.raises(ValueError, match="^d must be above 0 for a sum over pixels"):
        exact.visible(lit, *plane(camera, (0, 0, 1)), camera, [0.0, 1, 1], mask=np.ones((14, 19), bool))


def test_pieces_change_no_bit_and_share_the_work(monkeypatch):
    frame = procedural.frame(width=64, height=36)
    assert frame.normal is not None
    scene = frame.irradiance, frame.depth, frame.normal, frame.camera, [1.9, 0.5, 0.2]
    mask, shares = np.asarray(frame.profile_id) == 1, []

    @contextmanager
    def step(share):
        shares.append(share)
        yield

    whole = exact.visible(*scene, mask=mask, step=step)
    few = len(shares)
    monkeypatch.setattr(exact, "_PIECE", 1 << 18)
    shares.clear()
    pieces = exact.visible(*scene, mask=mask, step=step)
    assert len(shares) > few + 3 and sum(shares) == pytest.approx(1)
    np.testing.assert_array_equal(pieces.scattered, whole.scattered)


def test_an_interruption_between_pieces_is_raised(monkeypatch):
    frame = procedural.frame(width=64, height=36)
    monkeypatch.setattr(exact, "_PIECE", 1 << 18)
    begun = []

    def step(share):
        begun.append(share)
        if len(begun) == 4:
            raise KeyboardInterrupt
        return nullcontext()

    assert frame.normal is not None
    scene = frame.irradiance, frame.depth, frame.normal, frame.camera, [1.9, 0.5, 0.2]
    with pytest.raises(KeyboardInterrupt):
        exact.visible(*scene, mask=np.asarray(frame.profile_id) == 1, step=step)
    assert len(begun) == 4
