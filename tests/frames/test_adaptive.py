"""Counts from a pilot: the arithmetic, the averages over neighbours, and what both deliver."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sssfit.frames import adaptive, procedural, scatter

VARIANCES = arrays(np.float64, (5, 7), elements=st.floats(0, 1e6, width=32))
IDS = arrays(np.int32, (5, 7), elements=st.integers(0, 2))


@given(VARIANCES, st.floats(1e-6, 1e6), st.integers(1, 50), st.integers(0, 100))
def test_counts_are_the_fewest_within_their_bounds(variance, target, least, more):
    found = adaptive.counts(variance, target, least, least + more)
    assert found.dtype == np.int32 and found.min() >= least and found.max() <= least + more
    # So many are enough, and one fewer is not, wherever the bounds leave a choice; to the last bit.
    assert (variance <= found * target * (1 + 1e-12))[found < least + more].all()
    assert (variance > (found - 1) * target * (1 - 1e-12))[found > least].all()


@given(VARIANCES, IDS, st.sampled_from([1, 3, 5, 99]))
def test_neighbours_of_the_same_profile_are_averaged(variance, ids, width):
    found, half = adaptive.smoothed(variance, ids, width), width // 2
    expected = np.zeros(ids.shape)
    for row, column in np.argwhere(ids > 0):
        near = np.s_[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        expected[row, column] = variance[near][ids[near] == ids[row, column]].mean()
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * variance.max())
    assert found.min() >= 0


@pytest.mark.parametrize("target", [0.0, -1.0, np.nan, np.inf])
def test_targets_out_of_range(target):
    with pytest.raises(ValueError, match="target_variance must be a number above 0"):
        adaptive.counts([1.0], target, 1, 2)


@pytest.mark.parametrize("bounds", [(0, 4), (5, 4)])
def test_bounds_out_of_range(bounds):
    with pytest.raises(ValueError, match="least and most must be 1 <= least <= most"):
        adaptive.counts([1.0], 1.0, *bounds)


@pytest.mark.parametrize("width", [0, 2, -1])
def test_widths_out_of_range(width):
    with pytest.raises(ValueError, match="width must be odd and at least 1"):
        adaptive.smoothed(np.ones((2, 2)), np.ones((2, 2), int), width)


@pytest.mark.slow
def test_averaging_delivers_the_target_better():
    """The reason for the averages: the share of pixels that get twice the variance wanted of them."""
    frame, target = procedural.frame(width=320, height=180), 2e-3
    profiles = {1: [1.918, 0.479, 0.204], 2: [7.93, 5.016, 3.409]}
    ids = np.asarray(frame.profile_id)
    # The true variance of a sample, from a hundred times as many as the pilot has.
    many = [scatter.variance_of_samples(frame, profiles, counts=256, seed=9000 + k) for k in range(4)]
    truth = np.mean(many, axis=0, dtype=float)
    between = (truth > 8 * target) & (truth < 64 * target)
    assert between.sum() > 10000
    pilot = scatter.variance_of_samples(frame, profiles, counts=8, seed=1)
    counts = [adaptive.counts(adaptive.smoothed(pilot, ids, width), target, 8, 64) for width in (1, 5)]
    delivered = [truth[between] / c[between] / target for c in counts]
    twice = [(d > 2).mean() for d in delivered]
    # Alone, 8 samples leave a fifth of the pixels with twice the variance; averaged, not one in a hundred.
    assert twice[0] > 0.1 and twice[1] < 0.01
    assert counts[1][ids > 0].mean() < 1.05 * counts[0][ids > 0].mean()
    assert 0.85 < delivered[1].mean() < 1.05
