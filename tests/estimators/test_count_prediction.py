"""Predicted counts, targets and times against quantiles in print, simulated pixels and plain recursions."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, chi2

from sssfit.estimators import count_prediction, sample_count
from sssfit.estimators.sample_count import PAPER_2020, PAPER_2021, UNREAL, Controller, History

# Long streams of simulated pixels.
pytestmark = pytest.mark.slow

frames_to_forget = jax.jit(count_prediction.frames_to_forget)
frames_to_converge = jax.jit(count_prediction.frames_to_converge)
neutral_count = jax.jit(count_prediction.neutral_count)

# Of the chi-square distribution, by mpmath: degrees of freedom and the quantiles of 0.05, 0.5, 0.95.
QUANTILES = {
    7: (2.1673499093, 6.34581119552, 14.0671404493),
    15: (7.26094392767, 14.338859511, 24.9957901397),
    63: (45.7413768417, 62.3346020723, 82.5287265415),
}


# The target


@pytest.mark.parametrize("freedom", QUANTILES)
def test_targets_from_quantiles_in_print(freedom):
    for tail, quantile in zip((0.05, 0.5, 0.95), QUANTILES[freedom], strict=True):
        found = count_prediction.target_variance(0.3, freedom + 1, confidence=1 - tail)
        # Twelve digits in print.
        assert float(found) == pytest.approx(0.3 / quantile, rel=1e-10)
    default = count_prediction.target_variance(0.3, freedom + 1)
    assert float(default) == pytest.approx(0.3 / QUANTILES[freedom][0], rel=1e-10)


@given(variance=st.floats(0, 1e6), max_spp=st.integers(2, 4096), confidence=st.floats(1e-6, 1 - 1e-6))
def test_targets_from_quantiles_of_scipy(variance, max_spp, confidence):
    found = count_prediction.target_variance(variance, max_spp, confidence=confidence)
    # The upper tail's quantile, by SciPy's own inverse of the regularized gamma function.
    assert float(found) == pytest.approx(variance / chi2.isf(confidence, max_spp - 1), rel=1e-9)


def test_targets_of_maps():
    found = count_prediction.target_variance(np.ones((2, 1)), np.array([8, 16, 64]))
    assert isinstance(found, np.ndarray) and found.dtype == np.float64
    expected = 1 / np.array([QUANTILES[n][0] for n in (7, 15, 63)])
    np.testing.assert_allclose(found, np.broadcast_to(expected, (2, 3)), rtol=1e-10)


@pytest.mark.parametrize("confidence", [0.05, 0.5, 0.95])
def test_a_target_is_kept_with_its_confidence_by_normal_samples(confidence):
    runs, n = 200_000, 16
    samples = np.random.default_rng(11).normal(3.0, 0.7, (runs, n))
    target = count_prediction.target_variance(samples.var(axis=1), n, confidence=confidence)
    kept = np.mean(0.7**2 / n <= target)
    assert abs(kept - confidence) < 4 * np.sqrt(confidence * (1 - confidence) / runs)
    # With the divisor n - 1 the confidence would be another one.
    other = count_prediction.target_variance(samples.var(axis=1, ddof=1), n, confidence=confidence)
    assert np.mean(0.7**2 / n <= other) - confidence > 10 * np.sqrt(0.25 / runs)


def test_two_valued_samples_keep_no_target():
    # The circle: 16 points, each inside with pi / 4. All outcomes, with their probabilities.
    inside, hits = np.pi / 4, np.arange(17)
    variances = hits / 16 * (1 - hits / 16)
    chances, of_mean = binom.pmf(hits, 16, inside), inside * (1 - inside) / 16
    target = count_prediction.target_variance(variances, 16, confidence=0.95)
    assert 0.85 < chances[of_mean <= target].sum() < 0.9
    # Nor does the other tail: 16 points vary too little for its quantile, whatever comes.
    target = count_prediction.target_variance(variances, 16, confidence=0.05)
    assert not np.any(of_mean <= target)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ((1.0, 1), "max_spp must be at least 2, got 1; one sample has no variance"),
        ((1.0, np.array([8, 1])), "max_spp must be at least 2"),
        ((1.0, 8, 0.0), r"confidence must be in \(0, 1\), got 0.0"),
        ((1.0, 8, 1.0), r"confidence must be in \(0, 1\), got 1.0"),
    ],
)
def test_a_target_needs_samples_and_a_confidence(arguments, message):
    options = {"confidence": arguments[2]} if len(arguments) > 2 else {}
    with pytest.raises(ValueError, match=message):
        count_prediction.target_variance(*arguments[:2], **options)


# The neutral count


def test_neutral_counts_of_the_circle(dtype):
    variance, target = dtype.type(4 / np.pi - 1), dtype.type(0.08**2)
    # (2 - 2 alpha) / (2 - alpha) (4 / pi - 1) / 0.0064 in long double.
    found = neutral_count(variance, target_variance=target, alpha=dtype.type(0.2))
    assert found.dtype == dtype
    assert float(found) == pytest.approx(37.9499367687726, rel=8 * float(np.finfo(dtype).eps))
    for alpha, expected in ((0.02, 42.26), (0.05, 41.60), (0.1, 40.45), (0.4, 32.02)):
        found = neutral_count(variance, target_variance=target, alpha=dtype.type(alpha))
        assert float(found) == pytest.approx(expected, abs=5e-3)
    assert float(neutral_count(variance, target_variance=target, alpha=dtype.type(1))) == 0


@given(alpha=st.floats(0.01, 0.9))
def test_at_the_neutral_count_the_expected_variance_is_the_target(x64, alpha):
    # Expectation of Eq 6 by iteration: E (x - mu)^2 = V + Var(mu).
    frame = 0.3 / float(neutral_count(0.3, target_variance=2e-3, alpha=alpha))
    variance = of_mean = 0.0
    for _ in range(int(40 / alpha)):
        variance = (1 - alpha) * (variance + alpha * (frame + of_mean))
        of_mean = (1 - alpha) ** 2 * of_mean + alpha**2 * frame
    assert variance == pytest.approx(2e-3, rel=1e-11)


# The steady state

PIXELS = 10_000
VARIANCE = 0.04
FREE = {"min_spp": 1e-3, "max_spp": 1e9}


def count_of(history, controller):
    constants = {name: getattr(controller, name) for name in ("target_variance", "alpha", "kappa")}
    return sample_count.estimate(history.mean_count, history.variance, **constants, **FREE)


def simulate(controller, history, key, first, frames, heavy_tails):
    """Frames of normal noise of variance V / n, without bounds and rounding.

    With heavy tails half of the frames are exact and half have twice the variance: a kurtosis of 6.
    """

    def step(frame, history):
        count = count_of(history, controller)
        noise_key, choice_key = jax.random.split(jax.random.fold_in(key, frame))
        noise = jax.random.normal(noise_key, (PIXELS,), jnp.float32).astype(jnp.float64)
        if heavy_tails:
            noise = noise * jnp.sqrt(2.0) * jax.random.bernoulli(choice_key, 0.5, (PIXELS,))
        return sample_count.update(history, 1 + jnp.sqrt(VARIANCE / count) * noise, count, controller)

    history = jax.lax.fori_loop(first, first + frames, step, history)
    return history, count_of(history, controller)


run = jax.jit(simulate, static_argnames="heavy_tails")


class Measured:
    """Mean and deviation of counts with their standard errors, the latter's from the sample kurtosis."""

    def __init__(self, counts):
        self.mean, self.deviation = counts.mean(), counts.std()
        kurtosis = np.mean((counts - self.mean) ** 4) / self.deviation**4
        self.mean_error = self.deviation / np.sqrt(counts.size)
        self.deviation_error = self.deviation * np.sqrt((kurtosis - 1) / 4 / counts.size)


def measure(alpha, kappa, seed, snapshots=1, heavy_tails=False, excess_kurtosis=0.0):
    """The prediction, and the counts of pixels that start there, 10 / alpha frames apart."""
    controller = Controller(1e-3, alpha=alpha, kappa=kappa)
    predicted = count_prediction.steady_state(controller, VARIANCE, excess_kurtosis=excess_kurtosis)
    history = History(*(jnp.full(PIXELS, float(v)) for v in (predicted.mean, 1.0, 1e-3)))
    frames = round(10 / alpha)
    counts = []
    for i in range(snapshots):
        history, count = run(
            controller, history, jax.random.key(seed), i * frames, frames, heavy_tails=heavy_tails
        )
        counts.append(np.asarray(count))
    return predicted, Measured(np.concatenate(counts))


CALM = [(0.002, 0.0), (0.005, 0.0), (0.01, 0.0), (0.005, 0.005), (0.01, 0.01)]


@pytest.mark.parametrize("index", range(len(CALM)))
def test_simulated_pixels_settle_at_the_prediction(x64, index):
    predicted, found = measure(*CALM[index], seed=2020 + index)
    assert abs(found.mean - float(predicted.mean)) < 3 * found.mean_error
    assert abs(found.deviation - float(predicted.deviation)) < 3 * found.deviation_error


@pytest.mark.parametrize("alpha, kappa", [(0.01, 0.01), (0.005, 0.01), (0.02, 0.0), (0.03, 0.0)])
def test_the_prediction_is_as_near_as_documented(x64, alpha, kappa):
    predicted, found = measure(alpha, kappa, seed=7, snapshots=2)
    assert predicted.deviation / predicted.mean < 0.2
    mean, deviation = float(predicted.mean), float(predicted.deviation)
    assert abs(found.mean - mean) < 0.005 * mean + 3 * found.mean_error
    assert abs(found.deviation - deviation) < 0.02 * deviation + 3 * found.deviation_error


def test_heavy_tails_spread_the_counts(x64):
    # A frame of 39.9 samples has a kurtosis of 6 with 3 * 39.9 in excess for one sample.
    neutral = float(neutral_count(VARIANCE, target_variance=1e-3, alpha=0.005))
    predicted, found = measure(0.005, 0.0, seed=5, heavy_tails=True, excess_kurtosis=3 * neutral)
    # The squared deviations vary by 6 - 1 in place of 3 - 1.
    normal = count_prediction.steady_state(Controller(1e-3, alpha=0.005, kappa=0.0), VARIANCE)
    assert float(predicted.deviation) > 1.5 * float(normal.deviation)
    mean, deviation = float(predicted.mean), float(predicted.deviation)
    assert abs(found.mean - mean) < 0.005 * mean + 3 * found.mean_error
    assert abs(found.deviation - deviation) < 0.02 * deviation + 3 * found.deviation_error


@pytest.mark.parametrize("kappa", [0.0, 0.01, 0.2, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("alpha", [0.01, 0.2])
def test_small_deviations_fade_by_the_response(x64, alpha, kappa):
    controller = Controller(1e-3, alpha=alpha, kappa=kappa)
    predicted = count_prediction.steady_state(controller, VARIANCE)
    start = float(predicted.neutral)
    history = History(*(jnp.asarray(v) for v in (start, 0.0, 1e-3 * (1 + 1e-7))))
    # Without noise: each squared deviation is its expectation, 2 / (2 - alpha) V / n around the long-run
    # mean, which stays at 0.
    deviations = []
    for _ in range(5):
        count = float(count_of(history, controller))
        deviations.append(count / start - 1)
        deviation = np.sqrt(2 / (2 - alpha) * VARIANCE / count)
        history = sample_count.update(history, deviation, count, controller)
        history = History(history.mean_count, jnp.zeros(()), history.variance)
    assert deviations[0] == pytest.approx(1e-7 * (1 + kappa * (2 / alpha - 2)), rel=1e-6)
    expected = (1 - alpha) * (1 - 2 * kappa)
    assert float(predicted.response) == pytest.approx(expected, abs=1e-15)
    # Deviations are below 2e-5, and so is their second order relative to the first.
    for before, after in zip(deviations, deviations[1:], strict=False):
        assert after == pytest.approx(expected * before, abs=1e-3 * abs(deviations[0]))
    if kappa > 0.5:
        assert deviations[0] > 0 > deviations[1]


@pytest.mark.parametrize("controller", [PAPER_2020, PAPER_2021, Controller(1e-3, alpha=0.2, kappa=0.0)])
def test_the_papers_deviations_are_too_large_to_predict(x64, controller):
    predicted = count_prediction.steady_state(controller, 0.04 * controller.target_variance / 1e-3)
    assert predicted.deviation > predicted.mean / 3


def test_no_steady_state_without_a_mean_count():
    with pytest.raises(ValueError, match="steady_state needs the metric 'accumulated', got 'variance_ratio'"):
        count_prediction.steady_state(UNREAL, 0.04)


def test_steady_states_of_maps_and_traced_controllers(dtype):
    alphas = np.array([0.002, 0.01], dtype)

    def predict(alpha):
        return count_prediction.steady_state(Controller(dtype.type(1e-3), alpha=alpha, kappa=0.0), VARIANCE)

    mapped = jax.jit(jax.vmap(predict))(alphas)
    whole = jax.jit(predict)(alphas)
    for i, alpha in enumerate(alphas):
        single = predict(alpha)
        for one, many, part in zip(single, mapped, whole, strict=True):
            assert many.dtype == part.dtype == dtype
            # 1 - response^2 magnifies roundings by 1 / (2 alpha), 250 at most.
            error = 500 * float(np.finfo(dtype).eps)
            assert float(many[i]) == pytest.approx(float(one), rel=error)
            assert float(part[i]) == pytest.approx(float(one), rel=error)


# Times


@given(alpha=st.floats(0.002, 0.99), share=st.floats(1e-6, 0.999))
def test_frames_to_forget_by_powers(x64, alpha, share):
    found = int(frames_to_forget(alpha, share))
    with mpmath.workdps(40):
        kept = 1 - mpmath.mpf(alpha)
        assert found >= 1
        assert kept**found <= share
        assert found == 1 or kept ** (found - 1) > share


@given(alpha=st.floats(0.002, 0.99), share=st.floats(1e-6, 0.999))
def test_frames_to_forget_in_single_precision(alpha, share):
    alpha, share = np.float32(alpha), np.float32(share)
    found = float(frames_to_forget(alpha, share))
    exact = float(np.log(np.longdouble(share)) / np.log1p(-np.longdouble(alpha)))
    # Two logarithms within 2 eps and a division: only so near a whole number it may be the other one.
    slack = 5 * 2.0**-23 * exact
    assert max(np.ceil(exact - slack), 1) <= found <= max(np.ceil(exact + slack), 1)
    assert found == np.ceil(found)


def test_frames_to_forget_at_the_very_share(dtype):
    # A half of the past is left after each frame, so 2^-n after n.
    frames = np.arange(1, 61)
    found = frames_to_forget(dtype.type(0.5), (2.0**-frames).astype(dtype))
    np.testing.assert_array_equal(found, frames)


def test_frames_to_forget_at_the_ends(dtype):
    alpha = np.array([1, 1, 0.5], dtype)
    share = np.array([1e-6, 0.9, 0.9], dtype)
    np.testing.assert_array_equal(frames_to_forget(alpha, share), 1)


def expected_variances(variance, mean, alpha, frames):
    """Expectation of Eq 5 and 6 from zeros, frame by frame."""
    of_variance = first = second = 0.0
    rows = []
    for _ in range(frames):
        deviation = variance + mean**2 - 2 * mean * first + second
        of_variance = (1 - alpha) * (of_variance + alpha * deviation)
        second = (
            (1 - alpha) ** 2 * second
            + 2 * alpha * (1 - alpha) * mean * first
            + alpha**2 * (variance + mean**2)
        )
        first = (1 - alpha) * first + alpha * mean
        rows.append(of_variance)
    return np.array(rows)


@given(
    share=st.floats(0, 0.99),
    mean=st.floats(3, 100),
    alpha=st.floats(0.02, 0.8),
    target=st.floats(1e-6, 1e3),
)
def test_frames_to_converge_by_recursion(x64, share, mean, alpha, target):
    allowed = target * (2 - alpha) / (2 - 2 * alpha)
    variance, mean = share * allowed, mean * np.sqrt(target)
    found = float(frames_to_converge(variance, mean, target_variance=target, alpha=alpha))
    # At 99 % of what is allowed the weight of the zeros must fall to 1e-2 / mean^2 of the target, or 1e-6.
    rows = expected_variances(variance, mean, alpha, frames=int(16 / alpha))
    above = np.flatnonzero(rows > target)
    last = above[-1] + 1 if len(above) else 0
    # Rounding decides where the expectation is within 1e-9 of the target.
    if np.abs(rows / target - 1).min() > 1e-9:
        assert found == last + 1
    assert found < len(rows)


@given(excess=st.floats(1e-6, 10), mean=st.floats(0, 100), alpha=st.floats(0.02, 0.9))
def test_too_much_variance_never_converges(x64, excess, mean, alpha):
    allowed = (2 - alpha) / (2 - 2 * alpha)
    assert np.isinf(frames_to_converge(allowed * (1 + excess), mean, target_variance=1.0, alpha=alpha))


def test_a_cold_start_on_the_circle(dtype):
    # 64 samples a frame, as the controller draws from the third frame on: 26.95 frames in 20000 runs.
    frame = (4 / np.pi - 1) / 64
    constants = {"target_variance": dtype.type(0.08**2), "alpha": dtype.type(0.2)}
    found = frames_to_converge(dtype.type(frame), dtype.type(1), **constants)
    assert found.dtype == dtype
    rows = expected_variances(frame, 1.0, 0.2, 100)
    assert rows[25] > 0.08**2 >= rows[26]
    assert float(found) == 27


@pytest.mark.parametrize("alpha", [0.1, 0.2, 0.3, 0.5])
def test_variance_at_the_limit_takes_very_long(x64, alpha):
    # Just what alpha allows: it is reached from above, by 100 (1 - alpha)^n of the target, if at all.
    allowed = (2 - alpha) / (2 - 2 * alpha)
    frames = round(20 / alpha)
    assert expected_variances(allowed, 10.0, alpha, frames)[-1] > 1
    # Compiled and not, which differ in rounding.
    for function in (count_prediction.frames_to_converge, frames_to_converge):
        assert float(function(allowed, 10.0, target_variance=1.0, alpha=alpha)) > frames


@pytest.mark.parametrize("variance, mean", [(0.5, 0.0), (0.5, 0.5), (0.01, 1.9), (0.0, 1.9)])
def test_variance_that_never_was_above_the_target_takes_one_frame(x64, variance, mean):
    assert np.all(expected_variances(variance, mean, 0.2, 100) < 1)
    assert float(frames_to_converge(variance, mean, target_variance=1.0, alpha=0.2)) == 1
