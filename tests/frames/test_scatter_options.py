"""Options of a pass that change what it converges to, and what a few samples tell of their variance."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from sssfit.frames import procedural, scatter, split
from sssfit.frames.camera import orthographic, perspective
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings

SIZE, PITCH = 65, 0.25
D = [0.9, 0.4, 0.15]
CAMERA = orthographic(SIZE, SIZE, PITCH)
DEPTH = np.full((SIZE, SIZE), 300.0, np.float32)
# Smooth enough that a pixel is like its neighbours, uneven enough that a filter shows.
ROW, COLUMN = np.indices((SIZE, SIZE))
LIGHT = np.stack([1 + np.sin(COLUMN / k) * np.cos(ROW / (k + 1)) for k in (1, 2, 3)], axis=-1).astype(
    np.float32
)
FRESH = Settings(distance="plane", points="fresh")
MIDDLE = SIZE // 2
RADIUS = PITCH / np.sqrt(2)


def cdf(r, d):
    return 1 - np.exp(-r / d) / 4 - 3 * np.exp(-r / d / 3) / 4


def by_quadrature(d, channel, lookup, beyond=0.0, cutoff=16.0, light=LIGHT):
    """Mean of the light around the middle pixel over the profile beyond a radius: radii at even quantiles."""
    whole, start = cdf(cutoff, 1), cdf(beyond, d)
    quantiles = start + (whole - start) * (np.arange(4000) + 0.5) / 4000
    grid = np.linspace(beyond, cutoff * d, 2_000_001)
    radii = np.interp(quantiles, cdf(grid, d), grid)
    turns = 2 * np.pi * (np.arange(360) + 0.5) / 360
    column = MIDDLE + radii[:, None] * np.cos(turns) / PITCH
    row = MIDDLE + radii[:, None] * np.sin(turns) / PITCH
    return (whole - start) / whole * lookup(light[..., channel], row, column).mean()


def nearest(light, row, column):
    return ndimage.map_coordinates(light, [np.rint(row), np.rint(column)], order=0, cval=0)


def bilinear(light, row, column):
    return ndimage.map_coordinates(light, [row, column], order=1, cval=0)


def middles(settings, counts=64, seeds=48, light=LIGHT):
    """The middle pixel over seeds, (seeds, 3), computed alone."""
    only = np.zeros((SIZE, SIZE), np.int32)
    only[MIDDLE, MIDDLE] = counts
    runs = [
        scatter.scatter(light, DEPTH, CAMERA, d=D, counts=only, settings=settings, most=counts, seed=seed)
        for seed in range(seeds)
    ]
    return np.array([np.asarray(run)[MIDDLE, MIDDLE] for run in runs], float)


def agree(found, expected):
    """4.5 standard errors of 48 seeds, and the quadrature's own 2e-3."""
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    return np.all(np.abs(found.mean(axis=0) - expected) < 4.5 * error + 2e-3)


@pytest.mark.parametrize("changed", [{}, {"importance": "xie"}, {"channels": "each"}], ids=str)
@pytest.mark.parametrize("cutoff", [16.0, None])
def test_the_split_takes_the_pixels_own_light_within_its_disc_and_samples_beyond(changed, cutoff):
    settings = FRESH._replace(split=0.0, cutoff=cutoff, **changed)
    reach = 16.0 if cutoff else 45.0
    expected = [
        LIGHT[MIDDLE, MIDDLE, c] * cdf(RADIUS, d) / cdf(reach, 1)
        + by_quadrature(d, c, nearest, RADIUS, reach)
        for c, d in enumerate(D)
    ]
    assert agree(middles(settings), np.array(expected))


@pytest.mark.slow
@pytest.mark.parametrize("importance", ["exact", "mixture", "table", "log_linear"])
def test_the_split_is_unbiased_for_every_way_to_draw_a_radius(importance):
    expected = [
        LIGHT[MIDDLE, MIDDLE, c] * cdf(RADIUS, d) / cdf(16, 1) + by_quadrature(d, c, nearest, RADIUS)
        for c, d in enumerate(D)
    ]
    assert agree(middles(FRESH._replace(split=0.0, importance=importance)), np.array(expected))


def test_the_split_spares_samples_where_light_does_not_leave_the_pixel():
    found = middles(FRESH._replace(split=0.98), seeds=2)
    np.testing.assert_array_equal(found, np.broadcast_to(LIGHT[MIDDLE, MIDDLE], (2, 3)))
    share = float(split.distant_share(300.0, CAMERA, np.array(D), FRESH))
    assert share == pytest.approx(1 - cdf(RADIUS, 0.9) / cdf(16, 1), abs=1e-6)
    assert np.asarray(split.counts(64, jnp.array([share, 0.004]), 0.01)).tolist() == [
        int(np.ceil(64 * share)),
        0,
    ]


def test_a_profile_that_ends_within_the_disc_keeps_the_light():
    tiny = scatter.scatter(LIGHT, DEPTH, CAMERA, d=[1e-3] * 3, counts=16, settings=FRESH._replace(split=0.0))
    np.testing.assert_allclose(tiny, LIGHT, rtol=1e-6)


@pytest.mark.parametrize("estimator", ["unbiased", "ratio"])
def test_constant_light_stays_constant_under_the_split(estimator):
    light = np.ones((SIZE, SIZE, 3), np.float32)
    found = middles(FRESH._replace(split=0.0, estimator=estimator), light=light)
    if estimator == "ratio":
        np.testing.assert_allclose(found, 1, rtol=2e-6)
    else:
        # What scatters from beyond the frame is missing.
        around = [by_quadrature(d, c, nearest, RADIUS, light=light) for c, d in enumerate(D)]
        assert agree(found, [cdf(RADIUS, d) / cdf(16, 1) + a for d, a in zip(D, around, strict=True)])


def test_the_split_lessens_the_variance_at_equal_samples():
    whole, parted = (middles(FRESH._replace(split=s, sequence="iid")).var(axis=0) for s in (None, 0.0))
    # The narrowest profile has two thirds of its light within the pixel.
    assert parted[2] < 0.8 * whole[2]


def test_a_prefilter_at_the_finest_level_blends_the_nearest_pixels():
    # With a scale of 1e12 every level is 0: the light is interpolated, not filtered.
    found = middles(FRESH._replace(prefilter=1e12))
    assert agree(found, np.array([by_quadrature(d, c, bilinear) for c, d in enumerate(D)]))


def test_a_prefilter_lessens_the_variance_and_smooths_the_more_the_smaller_its_scale():
    noise = np.random.default_rng(3).random((SIZE, SIZE, 3)).astype(np.float32)
    ratio = FRESH._replace(sequence="iid", estimator="ratio")
    settings = [ratio._replace(prefilter=a) for a in (1e12, 1.0, 1 / 16)]
    variances = np.array([middles(s, counts=16, light=noise).var(axis=0).mean() for s in settings])
    # Each is known to a tenth of itself.
    assert variances[1] < 0.7 * variances[0] and variances[2] < 0.7 * variances[1], variances


@pytest.mark.parametrize(
    "settings",
    [
        Settings(distance="plane", prefilter=1 / 16, estimator="ratio"),
        Settings(distance="surface", prefilter=1 / 16, estimator="ratio"),
        Settings(distance="plane", channels="each", estimator="ratio"),
    ],
    ids=str,
)
def test_constant_light_stays_constant_beside_a_mask(settings):
    mask = np.random.default_rng(5).random((SIZE, SIZE)) < 0.6
    light = np.where(mask[..., None], np.ones(3), np.nan).astype(np.float32)
    found = scatter.scatter(light, DEPTH, CAMERA, d=D, counts=48, mask=mask, settings=settings)
    np.testing.assert_allclose(np.asarray(found)[mask], 1, rtol=4e-6)


def frame_of(camera):
    rows, columns = DEPTH.shape
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), (rows, columns, 3))
    ids = np.ones((rows, columns), np.int32)
    return Frame(LIGHT, DEPTH, normal, None, ids, None, camera)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("settings", "counts"),
    [
        (FRESH._replace(sequence="iid"), 1),
        pytest.param(Settings(sequence="iid"), 1, marks=pytest.mark.slow),
        # The ratio of few samples is not linear in them.
        (FRESH._replace(sequence="iid", estimator="ratio"), 64),
        pytest.param(
            FRESH._replace(sequence="iid", estimator="ratio", split=0.0), 64, marks=pytest.mark.slow
        ),
    ],
    ids=str,
)
def test_the_variance_of_samples_is_that_between_seeds(settings, counts):
    frame: Any = frame_of(perspective(SIZE, SIZE, fx=1200.0))
    images = [
        scatter.every_profile(frame, {1: D}, counts=counts, settings=settings, seed=seed)
        for seed in range(200)
    ]
    luminance = np.stack([np.asarray(i, float) @ [0.2126, 0.7152, 0.0722] / np.pi for i in images])
    between = counts * luminance.var(axis=0, ddof=1)
    found = np.asarray(
        scatter.variance_of_samples(frame, {1: D}, counts=4096, settings=settings, seed=999), float
    )
    ratio = found.mean() / between.mean()
    # 4225 pixels' variances of 200 seeds, and of 4096 samples: each mean is known to about .3 %.
    assert ratio == pytest.approx(1, abs=0.02)
    assert np.corrcoef(found.ravel(), between.ravel())[0, 1] > 0.5


def test_whole_segments_take_the_largest_count_within_sixteen_pixels():
    counts = np.random.default_rng(1).integers(0, 65, (5, 50))
    mask = np.random.default_rng(2).random((5, 50)) < 0.7
    expected = np.zeros_like(counts)
    for row, column in np.argwhere(mask & (counts > 0)):
        first = column // 16 * 16
        within = slice(first, first + 16)
        expected[row, column] = max(counts[row, within][mask[row, within]])
    np.testing.assert_array_equal(scatter.whole_segments(counts, mask), expected)
    np.testing.assert_array_equal(
        scatter.whole_segments(counts), scatter.whole_segments(counts, np.ones_like(mask))
    )


def test_a_variance_needs_two_samples_and_something_that_scatters():
    frame: Any = frame_of(CAMERA)
    for counts in (0, 1):
        assert not np.any(scatter.variance_of_samples(frame, {1: D}, counts=counts, settings=FRESH))
    assert not np.any(scatter.variance_of_samples(frame, {1: None}, counts=16, settings=FRESH))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"split": 0.01}, "split needs points of each pixel's own"),
        ({"split": 2.0, "points": "fresh"}, "split must be a share"),
        ({"prefilter": 0.0}, "prefilter must be above 0"),
        ({"points": "stale"}, "points must be one of table, fresh"),
    ],
)
def test_settings_that_do_not_fit_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        scatter.scatter(LIGHT, DEPTH, CAMERA, d=D, counts=1, settings=Settings(distance="plane", **wrong))


def test_float64_beside_it_changes_nothing():
    """The threads of the lanes have the caller's configuration."""
    settings = Settings(distance="plane")
    few = np.full((SIZE, SIZE), 4)
    found = scatter.scatter(LIGHT, DEPTH, CAMERA, d=D, counts=few, settings=settings)
    with jax.enable_x64(True):
        wide = scatter.scatter(LIGHT, DEPTH, CAMERA, d=D, counts=few, settings=settings)
    assert wide.dtype == np.float32
    np.testing.assert_array_equal(wide, found)


@pytest.mark.parametrize(
    "settings",
    [
        Settings(),
        Settings(plane="tangent", estimator="ratio", points="fresh"),
        pytest.param(Settings(plane="tangent"), marks=pytest.mark.slow),
        pytest.param(Settings(points="fresh", split=0.01), marks=pytest.mark.slow),
        pytest.param(Settings(prefilter=1.0), marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_float64_beside_it_changes_no_surface(settings):
    scene, profiles = procedural.frame(width=64, height=36), {1: (1.0, 0.5, 0.3), 2: None}
    found = scatter.image_and_variance(scene, profiles, counts=16, settings=settings)
    with jax.enable_x64(True):
        wide = scatter.image_and_variance(scene, profiles, counts=16, settings=settings)
    # Places are then rounded at other steps: three times by half a unit of 2^(6 - 24) pixels on either side
    # of an edge, in two directions, for 16 samples: so many pixels may have a sample beyond one.
    least, share = 2.0**-18, 2 * 3 * 2.0**-18 * 16
    if settings.plane == "tangent":
        # A sample's depth, with a unit of 2^(9 - 24) mm, is rounded, too, and its weight goes with distance:
        # it changes by more where that is below 0.01 mm, of which the profile's density has so many.
        least, share = 3 * 2.0**-16 / 0.01 / 16, 16 * 0.01 * np.mean(0.5 / np.array(profiles[1]))
    for one, other in zip(found, wide, strict=True):
        assert other.dtype == np.float32
        off = np.abs(np.asarray(one) - np.asarray(other)) / np.abs(np.asarray(one)).max()
        assert np.mean(off > least) <= share
