"""What no way of sampling may change: constant light, a mirrored frame, a profile's neighbours."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.frames import scatter
from sssfit.frames.camera import Camera, orthographic
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.sampling import inverse_cdf

H, W = 36, 50
D = [0.9, 0.4, 0.15]
RANDOM = np.random.default_rng(7)
LIGHT = RANDOM.random((H, W, 3)).astype(np.float32)
ROW, COLUMN = np.indices((H, W)).astype(np.float32)
PERSPECTIVE = Camera("perspective", W, H, fx=900.0, fy=900.0, cx=W / 2, cy=H / 2)
SLOW = pytest.mark.slow

# --- constant light

RATIO = Settings(estimator="ratio")
NORMALIZED = [
    RATIO._replace(plane="tangent"),
    *(
        pytest.param(RATIO._replace(**changed), marks=SLOW)
        for changed in (
            {},
            {"points": "fresh", "split": 0.0},
            {"distance": "plane", "channels": "each"},
            {"points": "fresh"},
            {"points": "fresh", "plane": "tangent", "sequence": "sobol"},
            {"points": "fresh", "plane": "tangent", "split": 0.01},
            {"channels": "widest"},
            {"channels": "each", "plane": "tangent"},
            {"distance": "plane", "points": "fresh"},
            {"distance": "plane", "channels": "widest", "cutoff": None},
            {"distance": "plane", "prefilter": 0.25},
            {"plane": "tangent", "prefilter": 0.25},
            {"corrected": False, "importance": "xie"},
            *({"importance": name} for name in inverse_cdf.METHODS if name != RATIO.importance),
            *({"sequence": name} for name in ("iid", "hammersley", "fibonacci")),
        )
    ),
]
MASKS = {
    "all": np.ones((H, W), bool),
    "holes": RANDOM.random((H, W)) < 0.6,
    "stripe": abs(ROW - COLUMN / 2) < 4,
    "pixel": (ROW == 5) & (COLUMN == 9),
}


def bumpy():
    """Depth and normals of waves seen in perspective, turned away by up to 50 degrees."""
    depth = 300 + 0.8 * np.sin(COLUMN / 4) * np.cos(ROW / 5)
    tilt = np.stack([0.8 * np.sin(COLUMN / 3), 0.8 * np.cos(ROW / 4), np.ones((H, W))], axis=-1)
    normal = tilt / np.linalg.norm(tilt, axis=-1, keepdims=True)
    return depth.astype(np.float32), normal.astype(np.float32)


@pytest.mark.parametrize("settings", NORMALIZED, ids=str)
def test_constant_light_stays_constant_for_every_normalized_method_and_mask(settings):
    depth, normal = bumpy()
    for name, mask in MASKS.items():
        light = np.where(mask[..., None], np.array([0.7, 3.1, 1e-3], np.float32), np.nan).astype(np.float32)
        found = scatter.scatter(
            light, depth, PERSPECTIVE, d=D, counts=19, mask=mask, normal=normal, settings=settings
        )
        # Sums of 19 products, and a quotient, in float32.
        np.testing.assert_allclose(np.asarray(found)[mask], light[mask], rtol=4e-6, err_msg=name)


PLANE = Settings(distance="plane")


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        # The weights of the others are tested alone, as samples of a table.
        *(PLANE._replace(importance=name) for name in ("exact", "mixture", "xie", "log_poly12")),
        *(PLANE._replace(channels=name) for name in ("widest", "each")),
        *(PLANE._replace(sequence=name) for name in ("iid", "sobol", "hammersley", "fibonacci")),
        PLANE._replace(points="fresh"),
        PLANE._replace(points="fresh", split=0.0),
        Settings(),
        Settings(plane="tangent"),
        Settings(points="fresh", plane="tangent"),
    ],
    ids=str,
)
def test_constant_light_stays_constant_in_the_mean_for_unbiased_methods(settings):
    """The middle pixel of a frame as wide as the profile: nothing is lost beyond the edges."""
    size, pitch, seeds = 65, 0.45, 64
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), (size, size, 3))
    counts = np.zeros((size, size), int)
    middle = size // 2
    counts[middle, middle] = 64
    found = [
        np.asarray(
            scatter.scatter(
                np.ones((size, size, 3)), np.full((size, size), 300.0), orthographic(size, size, pitch),
                d=D, counts=counts, most=64, normal=normal, settings=settings, seed=seed,
            )
        )[middle, middle]
        for seed in range(seeds)
    ]  # fmt: skip
    values = np.asarray(found, float)
    error = values.std(axis=0, ddof=1) / np.sqrt(seeds)
    # 4 errors; 1e-5 for float32, where all samples of a pixel weigh alike and nothing varies.
    assert np.all(abs(values.mean(axis=0) - 1) < 4 * error + 1e-5), (values.mean(axis=0) - 1) / error


# --- flips and transposes

SEEDS = 48
TURNS = {
    "left and right": (lambda v: v[:, ::-1], lambda n: n * np.array([-1, 1, 1], np.float32)),
    "up and down": (lambda v: v[::-1], lambda n: n * np.array([1, -1, 1], np.float32)),
    # Rows go down and y goes up: transposing swaps x and -y.
    "transposed": (
        lambda v: v.swapaxes(0, 1),
        lambda n: n[..., [1, 0, 2]] * np.array([-1, -1, 1], np.float32),
    ),
}


def as_it_is(value):
    return value


@functools.cache
def images(turn, of_normal, settings, first):
    depth, normal = bumpy()
    height, width = turn(depth).shape
    camera = Camera("perspective", width, height, fx=900.0, fy=900.0, cx=width / 2, cy=height / 2)
    return np.stack(
        [
            np.asarray(
                scatter.scatter(
                    turn(LIGHT), turn(depth), camera, d=D, counts=64, mask=turn(MASKS["holes"]),
                    normal=of_normal(turn(normal)), settings=settings, seed=first + seed,
                ),
                float,
            )
            for seed in range(SEEDS)
        ]
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", TURNS)
@pytest.mark.parametrize(
    "settings",
    [Settings(points="fresh"), Settings(), Settings(points="fresh", plane="tangent", estimator="ratio")],
    ids=str,
)
def test_a_turned_frame_has_a_turned_result(name, settings):
    turn, of_normal = TURNS[name]
    here = images(as_it_is, as_it_is, settings, 0)
    there = np.stack([turn(image) for image in images(turn, of_normal, settings, 1000)])
    mask = MASKS["holes"]
    apart = (there.mean(axis=0) - here.mean(axis=0))[mask]
    error = np.sqrt((here.var(axis=0, ddof=1) + there.var(axis=0, ddof=1))[mask] / SEEDS)
    score = apart / np.maximum(error, 1e-9)
    # Independent errors of variance 1 if the two agree; Student's with 94 degrees of freedom has 1.02.
    assert abs(np.square(score).mean() - 1.02) < 0.15
    # No side of the frame is off as a whole, seed by seed: pixels share tables.
    for half in (ROW < H / 2, ROW >= H / 2, COLUMN < W / 2, COLUMN >= W / 2):
        sums = [v[:, half & mask].mean(axis=1) for v in (here, there)]
        wide = np.sqrt(sum(v.var(axis=0, ddof=1) for v in sums) / SEEDS)
        assert np.all(abs(sums[0].mean(axis=0) - sums[1].mean(axis=0)) < 4.5 * wide)


@pytest.mark.slow
def test_a_turn_that_is_not_undone_shows():
    """That the test above can fail: the same frame, not turned back."""
    fresh = Settings(points="fresh")
    here, there = (images(as_it_is, as_it_is, fresh, first)[:16] for first in (0, 1000))
    there = there[:, ::-1]
    mask = MASKS["holes"] & MASKS["holes"][::-1]
    apart = (there.mean(axis=0) - here.mean(axis=0))[mask]
    error = np.sqrt((here.var(axis=0, ddof=1) + there.var(axis=0, ddof=1))[mask] / 16)
    assert np.square(apart / error).mean() > 10


# --- two profiles

BLEEDING = [
    Settings(),
    *(
        pytest.param(s, marks=SLOW)
        for s in (
            Settings(distance="plane", estimator="ratio"),
            Settings(estimator="ratio"),
            Settings(plane="tangent"),
            Settings(points="fresh", split=0.0),
            Settings(distance="plane", prefilter=1 / 16),
            Settings(estimator="ratio", prefilter=1 / 16),
        )
    ),
]


@pytest.mark.parametrize("settings", BLEEDING, ids=str)
def test_a_profile_knows_nothing_of_the_light_shape_and_place_of_another(settings):
    depth, normal = bumpy()
    first = MASKS["holes"]
    ids = jnp.asarray(np.where(first, 1, 2), jnp.int32)
    there = ~first

    def found(light, depth, normal, other: Any):
        light, depth, normal = (jnp.asarray(v, jnp.float32) for v in (light, depth, normal))
        frame = Frame(light, depth, normal, None, ids, None, PERSPECTIVE)
        return np.asarray(scatter.every_profile(frame, {1: D, 2: other}, counts=24, settings=settings))

    here = found(LIGHT, depth, normal, [0.3, 0.3, 2.0])
    changed = found(
        np.where(there[..., None], 1e9, LIGHT), np.where(there, depth + 1, depth),
        np.where(there[..., None], normal[..., [1, 0, 2]], normal), [3.0, 0.1, 0.1],
    )  # fmt: skip
    np.testing.assert_array_equal(here[first], changed[first])
    assert not np.allclose(here[there], changed[there])
    kept = found(LIGHT, depth, normal, None)
    np.testing.assert_array_equal(kept[there], LIGHT[there])
    np.testing.assert_array_equal(kept[first], here[first])


def test_a_dark_profile_beside_a_bright_one_stays_dark():
    depth, normal = bumpy()
    first = MASKS["stripe"]
    light = np.where(first[..., None], 0, 5).astype(np.float32) * np.ones(3, np.float32)
    ids = jnp.asarray(np.where(first, 1, 2), jnp.int32)
    frame = Frame(jnp.asarray(light), jnp.asarray(depth), jnp.asarray(normal), None, ids, None, PERSPECTIVE)
    found = np.asarray(scatter.every_profile(frame, {1: D, 2: D}, counts=64))
    assert not found[first].any() and found[~first].min() >= 0 and found[~first].max() > 1
