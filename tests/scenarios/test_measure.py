"""Statistics of records against plain NumPy on the records themselves."""

from fractions import Fraction
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sssfit.estimators import policies
from sssfit.scenarios import circle, driver, measure
from sssfit.scenarios.driver import Record
from sssfit.scenarios.measure import Target


class Answers(NamedTuple):
    """As much of a world as the statistics look at."""

    truth: np.ndarray
    sample_variance: np.ndarray


def world(frames=7, pixels=(3, 2), seed=0) -> Any:
    random = np.random.default_rng(seed)
    shape = (frames, *pixels)
    return Answers(random.random(shape).astype(np.float32), (0.04 * random.random(shape)).astype(np.float32))


def records(seeds=11, frames=7, pixels=(3, 2), seed=1):
    random = np.random.default_rng(seed)
    shape = (seeds, frames, *pixels)
    counts = random.integers(0, 20, shape).astype(np.int32)
    return Record._make([counts, *(random.random(shape).astype(np.float32) for _ in Record._fields[1:])])


def parts(record, *lengths):
    ends = np.cumsum(lengths)
    return [Record(*(leaf[end - n : end] for leaf in record)) for end, n in zip(ends, lengths, strict=True)]


TARGET = Target(1e-3, 4, 16)


def collect(records, world, target=TARGET, **options):
    return measure.collect(records, world, target, **options)


def wide(values):
    return np.asarray(values, np.float64)


def close(found, expected):
    # Sums of at most some hundred numbers of one size in float64.
    return np.asarray(found) == pytest.approx(np.asarray(expected), rel=1e-13, abs=1e-15)


# Statistics


def test_every_field_against_numpy():
    lit, record, first = world(), records(), 2
    found = collect([record], lit, first=first)
    doubles = {name: wide(leaf).reshape(11, 7, 6) for name, leaf in record._asdict().items()}
    truth, variance = (wide(a).reshape(7, 6) for a in lit)
    drawn = np.maximum(doubles["count"], 1)
    assert found.seeds == 11 and found.first == first
    assert (found.truth == truth).all() and (found.sample_variance == variance).all()
    assert close(found.count_by_seed, doubles["count"].mean(axis=2))
    assert close(found.error_by_seed, ((doubles["value"] - truth) ** 2).mean(axis=2))
    assert close(found.count, doubles["count"].mean(axis=0))
    assert close(found.count_squared, (doubles["count"] ** 2).mean(axis=0))
    for name in ("value", "variance", "coefficient"):
        assert close(getattr(found, name), doubles[name].mean(axis=0))
    assert close(found.squared_error, ((doubles["value"] - truth) ** 2).mean(axis=0))
    assert close(found.mean_squared_error, ((doubles["mean"] - truth) ** 2).mean(axis=0))
    assert close(found.inverse_count, (1 / drawn).mean(axis=0))
    assert close(found.delivered, (variance / drawn).mean(axis=0))
    # Of the pixels and frames that need more than 4 and fewer than 16 samples.
    free = (4 < variance[first:] / 1e-3) & (variance[first:] / 1e-3 < 16)
    assert 0.1 < free.mean() < 0.9
    kept = [np.quantile(v[free], 0.95) for v in (variance / drawn)[:, first:]]
    assert close(found.delivered_q95, np.mean(kept)) and found.target == TARGET
    drawn = np.arange(doubles["count"].max() + 1)
    for frame, histogram in enumerate(found.histogram):
        assert histogram.tolist() == [(doubles["count"][:, frame] == n).sum() for n in drawn]


@pytest.mark.parametrize("lengths", [(1,) * 11, (4, 4, 3), (10, 1)])
def test_chunks_make_one_record(lengths):
    record = records()
    whole = collect([record], world(), first=3)
    found = collect(iter(parts(record, *lengths)), world(), first=3)
    assert found.seeds == whole.seeds and (found.histogram == whole.histogram).all()
    assert found.target == whole.target
    for name in set(whole._fields) - {"target"}:
        assert close(getattr(found, name), getattr(whole, name)), name


def test_of_samples_that_are_not_independent_only_errors_are_known():
    found = collect([records()], world(), first=2, independent=False)
    usual = collect([records()], world(), first=2)
    assert usual.independent and not found.independent
    assert (found.delivered == found.squared_error).all() and not close(usual.delivered, found.delivered)
    assert np.isnan(found.delivered_q95)
    figures, others = measure.summarize(found), measure.summarize(usual)
    assert np.isnan(figures.regret) and np.isnan(figures.regret_q95)
    assert figures[:4] == others[:4] and figures.image_rmse == others.image_rmse
    ideal = found.sample_variance[2:] / 1e-3
    expected = found.squared_error[2:][(ideal > 4) & (ideal < 16)].mean() / 1e-3
    assert figures.delivered_over_target == pytest.approx(expected, rel=1e-13)


def test_chunks_with_larger_and_larger_counts():
    made = [
        records(seeds=2, seed=i)._replace(count=np.full((2, 7, 3, 2), n)) for i, n in enumerate((3, 70, 5))
    ]
    found = collect(made, world(), first=0)
    assert found.histogram.shape == (7, 71) and (found.histogram[:, (3, 5, 70)] == 12).all()
    assert found.histogram.sum() == 6 * 7 * 6


def test_a_driver_in_chunks():
    lit, policy = circle.uniform(12), policies.named("as", target_variance=0.0064)
    record = driver.run(jax.random.key(3), lit, policy, seeds=4)
    chunks = driver.chunks(jax.random.key(3), lit, policy, seeds=4, chunk=4)
    found, whole = (collect(r, lit, Target(0.0064), first=5) for r in (chunks, [record]))
    assert (found.count_by_seed == wide(record.count)).all()
    assert all(np.array_equal(a, b) for a, b in zip(found, whole, strict=True))


def test_progress_counts_the_seeds():
    seen = []
    collect(parts(records(), 4, 4, 3), world(), first=0, progress=seen.append)
    assert seen == [4, 8, 11]


@pytest.mark.parametrize("first", [7, 8, 50, -1])
def test_too_few_frames(first):
    with pytest.raises(ValueError, match=f"frames must be more than {first} .*, got 7$"):
        collect([records()], world(), first=first)


def test_by_default_the_first_fifty_frames_are_left_out():
    with pytest.raises(ValueError, match="frames must be more than 50 for figures from frame 51 on, got 50"):
        collect([], world(frames=50))
    assert collect([records(frames=51)], world(frames=51)).first == 50


def test_no_record():
    with pytest.raises(ValueError, match="records must hold at least one seed, got none"):
        collect(iter([]), world(), first=0)


# The oracle's count


@given(st.lists(st.floats(0, 1e3), min_size=1), st.floats(1e-6, 1e3), st.integers(1, 20), st.integers(0, 90))
def test_oracle_count_by_fractions(variances, target, low, more):
    counts = measure.oracle_count(variances, Target(target, low, low + more))
    assert counts.dtype == np.float64
    exact = [min(max(Fraction(v) / Fraction(target), low), low + more) for v in variances]
    assert counts == pytest.approx(np.array([float(n) for n in exact]), rel=4e-16, abs=0)


def test_oracle_count_of_the_papers_circle():
    # (4 / pi - 1) / 0.08^2, by mpmath.
    assert measure.oracle_count(circle.SAMPLE_VARIANCE, Target(0.0064)) == pytest.approx(
        42.6936788648692, rel=1e-13
    )


# Figures


def test_summary_against_numpy():
    lit, record, first = world(), records(), 2
    found = measure.summarize(collect([record], lit, first=first))
    doubles = {name: wide(leaf)[:, first:] for name, leaf in record._asdict().items()}
    truth, variance = (wide(a)[first:] for a in lit)
    ideal = variance / 1e-3
    counts, errors = (
        doubles["count"].mean(axis=(1, 2, 3)),
        ((doubles["value"] - truth) ** 2).mean(axis=(1, 2, 3)),
    )
    inside = (ideal > 4) & (ideal < 16)
    assert 0 < inside.sum() < inside.size
    assert found.mean_count == pytest.approx(counts.mean(), rel=1e-13)
    assert found.mean_count_se == pytest.approx(stats.sem(counts), rel=1e-12)
    assert found.oracle_count == pytest.approx(np.clip(ideal, 4, 16).mean(), rel=1e-13)
    assert found.count_over_oracle == pytest.approx(counts.mean() / np.clip(ideal, 4, 16).mean(), rel=1e-13)
    delivered = (variance / np.maximum(doubles["count"], 1)).mean(axis=0)
    assert found.delivered_over_target == pytest.approx(delivered[inside].mean() / 1e-3, rel=1e-13)
    assert found.image_rmse == pytest.approx(np.sqrt(errors.mean()), rel=1e-13)
    # The error of a root is that of its square over twice the root.
    assert found.image_rmse_se == pytest.approx(stats.sem(errors) / (2 * np.sqrt(errors.mean())), rel=1e-12)


def test_summary_where_the_oracle_is_never_free():
    for target in (Target(1e-9), Target(1e9)):
        statistics = collect([records()], world(), target, first=0)
        assert np.isnan(measure.summarize(statistics).delivered_over_target)


def test_the_quantile_where_bounds_decide_everywhere():
    assert np.isnan(collect([records()], world(), Target(1e-9), first=0).delivered_q95)


def test_unclamped_is_between_the_bounds():
    low, high = TARGET.variance * TARGET.min_spp, TARGET.variance * TARGET.max_spp
    variance = [0.0, low * 0.99, low * 1.01, high * 0.99, high * 1.01]
    assert measure.is_unclamped(variance, TARGET).tolist() == [False, False, True, True, False]


def test_summary_of_one_seed_has_no_errors():
    found = measure.summarize(collect([records(seeds=1)], world(), first=0))
    assert np.isnan(found.mean_count_se) and np.isnan(found.image_rmse_se) and found.image_rmse > 0


def test_summary_of_a_perfect_result():
    lit = world()
    record = records()
    record = record._replace(value=np.broadcast_to(lit.truth, record.value.shape))
    found = measure.summarize(collect([record], lit, first=0))
    assert found.image_rmse == found.image_rmse_se == 0


def test_a_count_of_zero_counts_as_one():
    lit, record = world(), records()
    found = collect([record._replace(count=np.zeros_like(record.count))], lit, first=0)
    assert (found.inverse_count == 1).all() and (found.delivered == found.sample_variance).all()


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30))
def test_standard_error_against_scipy(values):
    expected = stats.sem(values)
    # Two-pass sums of squares; of equal values the mean itself is rounded.
    assert measure.standard_error(np.array(values)) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_standard_error_of_one():
    assert np.isnan(measure.standard_error(np.array([1.0])))


@given(
    st.lists(st.lists(st.integers(0, 40), min_size=7, max_size=7), min_size=1, max_size=4),
    st.lists(st.integers(1, 64), min_size=1, max_size=5),
)
def test_count_quantiles_against_numpy(frames, shares):
    histogram = np.array([np.bincount(counts, minlength=41) for counts in frames])
    # Sixty-fourths times seven are exact, so that no rounding decides.
    shares = np.array(shares) / 64
    found = measure.count_quantiles(histogram, shares)
    expected = [np.quantile(counts, shares, method="inverted_cdf") for counts in frames]
    assert found.tolist() == np.array(expected).tolist()


def test_count_quantiles_at_a_step():
    # 0.05 + 0.05 of a hundred are ten, however the shares are rounded.
    histogram = np.array([[0, 10, 85, 5], [5, 0, 90, 5]])
    shares = [0.05, 0.1, 0.1 + 1e-9, 0.95, 0.95 + 1e-9, 1.0]
    assert measure.count_quantiles(histogram, shares).tolist() == [[1, 1, 2, 2, 3, 3], [0, 2, 2, 2, 3, 3]]
