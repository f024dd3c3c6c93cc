"""What is read: the same texels as the frame's passes look up, each warp's in its turn, each line once."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.frames import procedural, scatter
from sssfit.frames.camera import orthographic
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.trade import addresses, cache
from sssfit.trade.texture import Texture
from sssfit.trade.warps import Schedule

H, W = 20, 30
CAMERA = orthographic(W, H, 0.5)
IDS = np.ones((H, W), np.int32)
IDS[:, 25:], IDS[:3] = 2, 0
RNG = np.random.default_rng(0)
LIGHT = RNG.random((H, W, 1)).astype(np.float32)
COUNTS = RNG.integers(0, 5, (H, W))
SKIN = {1: [1.9], 2: None}
ROWS = Texture(H, W, tile=(1, 1))
#: Weights that are all the same: the image is the mean of what is looked up.
EQUAL = Settings(distance="plane", corrected=False, cutoff=None)
#: Every pixel is a warp of its own unit, and every texel a line: the reads say which pixel read what.
APART = Schedule(units=H * W, resident=1, warp=(1, 1), block=1, order="rows", line_bytes=8)


def normals(height=H, width=W):
    normal = np.stack([*RNG.normal(0, 0.2, (2, height, width)), np.ones((height, width))], axis=-1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


FRAME = Frame(
    jnp.asarray(LIGHT), jnp.full((H, W), 300.0), jnp.asarray(normals(), jnp.float32), None, jnp.asarray(IDS),
    None, CAMERA,
)  # fmt: skip


def together(reads):
    chunks = list(reads)
    return (
        np.concatenate([chunk.addresses for chunk in chunks] or [np.zeros(0, int)]),
        np.concatenate([chunk.units for chunk in chunks] or [np.zeros(0, int)]),
    )


def read_by(profiles: Any = SKIN, *, settings=EQUAL, **options: Any):
    return together(addresses.of_samples(FRAME, profiles, settings=settings, texture=ROWS, **options))


# --- samples


@pytest.mark.parametrize(
    "settings",
    [
        EQUAL,
        pytest.param(
            EQUAL._replace(points="fresh", plane="tangent", sequence="hammersley"), marks=pytest.mark.slow
        ),
    ],
)
def test_reads_are_the_lookups_of_the_pass(settings):
    image = scatter.every_profile(FRAME, SKIN, counts=COUNTS, settings=settings, seed=3, number=5)
    where, unit = read_by(counts=COUNTS, settings=settings, seed=3, number=5, schedule=APART)
    # With equal weights the image is the mean of the profile's light at what is read, dark beyond the frame.
    pixels = np.flatnonzero((COUNTS > 0) & (IDS == 1))
    found = np.where(IDS == 1, LIGHT[..., 0], 0).ravel()[where // 8]
    light = np.bincount(unit, found, len(pixels)) / COUNTS.ravel()[pixels]
    np.testing.assert_allclose(light, np.asarray(image).ravel()[pixels], rtol=2e-5)


def test_reads_in_a_level_are_those_of_the_image_halved():
    fine, coarse = (read_by(counts=4, level=level, schedule=APART) for level in (0, 2))
    row, column = np.divmod(fine[0] // 8, W)
    assert (coarse[0] == np.asarray(ROWS.address(2, row // 4, column // 4))).all()
    assert (coarse[1] == fine[1]).all()


def test_bilinear_reads_are_the_four_texels_around():
    # One sample, and four where there is no profile: the table of the other tests, and its program.
    counts = np.where(IDS == 0, 4, 1)
    nearest, unit = read_by(counts=counts, schedule=APART)
    four, units = read_by(counts=counts, filtering="bilinear", schedule=APART)
    assert len(nearest) * 3 < len(four) <= len(nearest) * 4
    for one, of in zip(nearest, unit, strict=True):
        row, column = np.divmod(four[units == of] // 8, W)
        assert one in four[units == of] and np.ptp(row) <= 1 and np.ptp(column) <= 1


def test_prefiltered_reads_are_four_texels_in_each_of_two_levels():
    where, unit = read_by(counts=1, settings=EQUAL._replace(prefilter=40.0), schedule=APART)
    level = np.searchsorted(ROWS.starts, where, side="right") - 1
    finest = [level[unit == pixel].min() for pixel in np.unique(unit)]
    for pixel, fine in zip(np.unique(unit), finest, strict=True):
        coarse = min(fine + 1, len(ROWS.sizes) - 1)
        assert set(level[unit == pixel]) == {fine, coarse}
        for one in {fine, coarse}:
            inside = where[(unit == pixel) & (level == one)] - ROWS.starts[one]
            row, column = np.divmod(inside // 8, ROWS.sizes[one][1])
            assert np.ptp(row) <= 1 and np.ptp(column) <= 1
    # A single sample is coarse far from its pixel and fine near it.
    assert len(set(finest)) >= 4


def test_a_warp_goes_on_until_its_last_thread_is_done():
    # One line for everything, and every sample within its own pixel: each request is one read.
    found, _ = read_by({1: [0.01]}, counts=COUNTS, schedule=Schedule(warp=(4, 8), line_bytes=2**30))
    counts = np.where(IDS == 1, COUNTS, 0)
    padded = np.pad(counts, ((0, 0), (0, 2))).reshape(5, 4, 4, 8)
    assert len(found) == padded.max(axis=(1, 3)).sum()


def test_only_pixels_with_a_profile_and_a_count_read():
    _, unit = read_by(counts=4, schedule=APART)
    assert unit.max() < (IDS == 1).sum()
    assert len(read_by(counts=0)[0]) == 0
    assert len(read_by({1: None, 2: None}, counts=4)[0]) == 0


def test_every_profile_has_its_pass():
    skins = ({1: [1.9], 2: [0.4]}, SKIN, {1: None, 2: [0.4]})
    both, first, second = (read_by(skin, counts=4, schedule=APART) for skin in skins)
    assert (both[0] == np.concatenate([first[0], second[0]])).all()
    assert len(second[0]) > 0


def test_other_seeds_and_frames_read_elsewhere():
    whole = read_by(counts=4, schedule=APART)[0].tolist()
    assert read_by(counts=4, schedule=APART)[0].tolist() == whole
    assert read_by(counts=4, schedule=APART, seed=1)[0].tolist() != whole
    assert read_by(counts=4, schedule=APART, number=1)[0].tolist() != whole


def test_adaptive_counts_and_coarse_levels_read_less():
    scene = procedural.frame(width=96, height=54)
    on_ball = np.asarray(scene.profile_id) == 1
    # Whole warps of many or few samples: what is saved is saved in turns too.
    many = np.repeat(np.repeat(RNG.random((14, 12)) < 0.15, 4, axis=0), 8, axis=1)[:54]
    adaptive = np.where(many, 40, 4)
    saved = 40 * on_ball.sum() / adaptive[on_ball].sum()
    levels = [cache.Level(8192, 128, 8, units=2), cache.Level(2**17, 128, 16)]
    found, lines, skin = {}, {}, {1: [1.9], 2: None}
    for name, counts, level in (("fixed", 40, 0), ("adaptive", adaptive, 0), ("coarse", 40, 2)):
        reads = list(
            addresses.of_samples(
                scene, skin, counts=counts, settings=EQUAL, level=level, schedule=Schedule(units=2)
            )
        )
        found[name] = cache.simulate_chunks(reads, levels)
        lines[name] = len(np.unique(together(reads)[0]))
    fixed = found["fixed"][0]
    assert 0.85 * saved < fixed.reads / found["adaptive"][0].reads < 1.15 * saved
    assert found["adaptive"][0].misses < fixed.misses
    assert found["coarse"][0].reads < 0.7 * fixed.reads and found["coarse"][0].misses < 0.3 * fixed.misses
    # The last cache holds the whole texture: every line comes from memory once.
    assert [found[name][1].misses for name in found] == list(lines.values())


@pytest.mark.parametrize(
    "options, message",
    [
        ({"texture": Texture(H, W + 1)}, "texture must have the frame's size 20 x 30, got 20 x 31"),
        ({"level": 6}, "level must be from 0 to 5 or None, got 6"),
        ({"level": -1}, "level must be from 0 to 5"),
        ({"filtering": "cubic"}, "filtering must be one of nearest, bilinear, got 'cubic'"),
        ({"settings": Settings(points="grid")}, "points must be one of"),  # type: ignore
    ],
)
def test_what_cannot_be_read_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        addresses.of_samples(FRAME, SKIN, counts=1, **options)


def test_a_tangent_plane_needs_normals():
    bare = FRAME._replace(normal=None)
    with pytest.raises(ValueError, match="normal must be given"):
        together(addresses.of_samples(bare, SKIN, counts=1, settings=EQUAL._replace(plane="tangent")))


# --- transforms


def test_a_transform_reads_every_texel_twice():
    texture = Texture(24, 40, tile=(1, 1))
    found, _ = together(addresses.of_transform(texture, schedule=Schedule(line_bytes=8)))
    rows, columns = found[: 24 * 40], found[24 * 40 :]
    assert sorted(rows.tolist()) == sorted(columns.tolist()) == list(range(0, 24 * 40 * 8, 8))


@pytest.mark.parametrize("columns, reads", [(1, 64 * 64), (16, 4 * 64), (32, 4 * 64)])
def test_columns_side_by_side_read_a_line_once(columns, reads):
    # 64 x 64 texels of 8 bytes in rows: 4 lines in each row.
    found, _ = together(addresses.of_transform(Texture(64, 64, tile=(1, 1)), columns=columns))
    assert len(found) == 4 * 64 + reads


def test_rows_are_read_before_columns_by_their_units():
    schedule = Schedule(units=4, resident=1, block=1, line_bytes=8)
    where, unit = together(addresses.of_transform(Texture(4, 32, tile=(1, 1)), schedule=schedule))
    assert (where[: 4 * 32] // (32 * 8) == unit[: 4 * 32]).all()
    assert (where[4 * 32 :] // 8 % 32 % 4 == unit[4 * 32 :]).all()


def test_columns_that_do_not_divide_a_warp_are_refused():
    with pytest.raises(ValueError, match="columns must divide the warp's threads, 32, got 5"):
        addresses.of_transform(Texture(8, 8), columns=5)
