"""Samples of a frame: what they are drawn from, and that their weights make up for it."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.frames import points
from sssfit.frames.points import Settings
from sssfit.sampling import inverse_cdf

D = jnp.array([1.9, 0.5, 0.2])
PLANE = Settings(distance="plane")
table: Any = eqx.filter_jit(points.table)


def cdf(r, d, cutoff=np.inf):
    return (1 - np.exp(-r / d) / 4 - 3 * np.exp(-r / d / 3) / 4) / (
        1 - np.exp(-cutoff) / 4 - 3 * np.exp(-cutoff / 3) / 4
    )


@pytest.mark.parametrize("importance", inverse_cdf.METHODS)
@pytest.mark.parametrize("channels", ["mixture", pytest.param("widest", marks=pytest.mark.slow)])
def test_weighted_samples_have_each_channels_distribution(importance, channels):
    """Independent points, so that the standard error is that of the mean."""
    settings = PLANE._replace(importance=importance, channels=channels, sequence="iid")
    drawn = table(20_000, D, settings, seed=3, frame=1)
    radius = np.asarray(drawn.radius).ravel()
    for d, weight in zip(np.asarray(D), drawn.weights, strict=True):
        weight = np.asarray(weight, float).ravel()
        for within in (0.3 * d, d, 4 * d, 15.9 * d, 17 * d):
            found = weight * (radius <= within)
            error = found.std() / np.sqrt(found.size)
            expected = cdf(min(within, 16 * float(d)), d, 16)
            # Float32 weights are off by some 1e-6 of themselves.
            assert abs(found.mean() - expected) < 4.5 * error + 1e-5, (within / d, error)


@pytest.mark.parametrize("sequence", ["r2", "sobol", "hammersley", "fibonacci"])
def test_points_of_low_discrepancy_do_it_with_a_smaller_error(sequence):
    def squared_error(name):
        settings = PLANE._replace(sequence=name)
        runs = [table(64, D, settings, seed=jnp.uint32(k), frame=0).weights for k in range(20)]
        return np.square(np.mean(runs, axis=2) - 1).mean(axis=(0, 2))

    even, independent = squared_error(sequence), squared_error("iid")
    assert np.all(even < 0.2 * independent), (even, independent)


def test_the_papers_weight_is_that_of_the_profile_itself():
    settings = PLANE._replace(importance="xie", corrected=False, channels="widest", cutoff=None)
    drawn = table(64, D, settings, seed=0, frame=0)
    widest, radius = float(D[0]), np.asarray(drawn.radius, float)
    np.testing.assert_allclose(drawn.weights[0], 1, rtol=1e-5)
    expected = points.density(radius, 0.5, None) / points.density(radius, widest, None)
    np.testing.assert_allclose(drawn.weights[1], expected, rtol=1e-4)


def test_no_radius_is_left_out_where_the_distance_is_another():
    near = np.asarray(table(4096, D, PLANE, seed=0, frame=0).radius)
    far = np.asarray(table(4096, D, Settings(), seed=0, frame=0).radius)
    assert near.max() <= 16 * 1.9 * (1 + 1e-6) < far.max()


def test_directions_are_even_and_offsets_have_the_radius():
    drawn = table(2048, D, PLANE, seed=0, frame=0)
    np.testing.assert_allclose(np.hypot(drawn.x, drawn.y), drawn.radius, rtol=1e-6)
    turn = np.arctan2(drawn.y, drawn.x) / (2 * np.pi) % 1
    share = np.histogram(turn, bins=8, range=(0, 1))[0] / turn.size
    np.testing.assert_allclose(share, 1 / 8, atol=2e-3)


def test_seeds_frames_and_versions_differ_and_the_first_samples_do_not_depend_on_the_rest():
    at = {(seed, frame): np.asarray(table(16, D, PLANE, seed=seed, frame=frame).x)
          for seed in (0, 1) for frame in (0, 1)}  # fmt: skip
    columns = np.concatenate([v.T for v in at.values()])
    assert len(np.unique(columns, axis=0)) == 4 * points.VERSIONS
    np.testing.assert_array_equal(table(64, D, PLANE, seed=0, frame=0).x[:16], at[0, 0])


@pytest.mark.parametrize("shape", [1e-6, 1e6])
def test_lengths_scale(shape):
    one, other = (table(64, d * jnp.ones(3), PLANE, seed=0, frame=0) for d in (1.0, shape))
    np.testing.assert_allclose(other.radius, shape * np.asarray(one.radius), rtol=1e-6)
    np.testing.assert_allclose(np.asarray(other.weights), np.asarray(one.weights), rtol=1e-5)


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"importance": "best"}, "importance must be one of exact, .*, got 'best'"),
        ({"plane": "tilted"}, "plane must be one of screen, tangent, got 'tilted'"),
        ({"cutoff": 0.0}, "cutoff must be above 0 or None, got 0.0"),
    ],
)
def test_unknown_settings_are_refused(wrong, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        Settings(**wrong).check()
