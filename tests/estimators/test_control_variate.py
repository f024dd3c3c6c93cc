"""Coefficients by hand, `step` against the papers' algorithms in NumPy, and dynamic light against theory."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.estimators import control_variate, moving, sample_count
from sssfit.estimators.control_variate import MAIN_PART, NONE, ONLINE, Config, Observation
from sssfit.estimators.sample_count import PAPER_2021, Controller

step = jax.jit(control_variate.step)
upper_bound = jax.jit(control_variate.upper_bound)
coefficient = jax.jit(control_variate.coefficient)
next_count = jax.jit(sample_count.next_count)
update = jax.jit(sample_count.update)


def leaves_equal(found, expected):
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


# Bound and coefficient


def test_upper_bound(dtype):
    table = [
        # f, g and a_0 + f / g with a_0 = 1.
        (1, 2, 1.5),
        (0, 2, 1),
        (3, 2, 2.5),
        (0, 0, np.inf),
        (1, 0, np.inf),
        (1, -2, np.inf),
        (-3, 2, 0),
        (-1, 2, 0.5),
        (np.nan, 2, np.nan),
        (1, np.nan, np.nan),
        (np.nan, 0, np.inf),
        (np.inf, 2, np.inf),
        (1, np.inf, 1),
    ]
    value, control, expected = (np.array(column, dtype) for column in zip(*table, strict=True))
    found = upper_bound(value, control)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, expected)
    more = upper_bound(value, control, bound_offset=dtype.type(3))
    np.testing.assert_array_equal(more[:3], expected[:3] + 2)
    # At the bound the residual is -a_0 g.
    left = control_variate.residual(value[:3], control[:3], found[:3])
    np.testing.assert_array_equal(left, -control[:3])


def test_bounds_that_overflow(dtype):
    big, small = np.finfo(dtype).max, np.finfo(dtype).tiny
    assert float(upper_bound(big, small)) == np.inf


def matrix(covariance, variance, dtype):
    """Of (f, g); the first row and column count for nothing but the covariance."""
    return jnp.asarray(np.array([[np.nan, np.nan], [covariance, variance]], dtype))


@pytest.mark.parametrize(
    "covariance, variance, epsilon, bound, expected",
    [
        (0.5, 1.0, 0.0, None, 0.5),
        (0.5, 1.0, 0.5, None, 2 / 3),
        (3.0, 1.0, 0.0, None, 3.0),
        (3.0, 1.0, 0.0, 2.0, 2.0),
        (-3.0, 1.0, 0.0, 2.0, 0.0),
        (-3.0, 1.0, 0.0, None, -3.0),
        (-3.0, 1.0, 0.0, (-2.0, 1.5), -2.0),
        (3.0, 1.0, 0.0, (-2.0, 1.5), 1.5),
        # Nothing varies: epsilon / epsilon, and its limit.
        (0.0, 0.0, 1e-6, None, 1.0),
        (0.0, 0.0, 0.3, 2.0, 1.0),
        (0.0, 0.0, 0.0, None, 1.0),
        (0.0, 0.0, 0.0, 0.5, 0.5),
        (0.0, 1.0, 0.0, None, 0.0),
        # A variance that has underflowed beside a covariance that has not.
        (1.0, 0.0, 0.0, None, 1.0),
        (1.0, 0.0, 0.0, 0.5, 0.5),
        (0.5, np.inf, 1e-6, None, 0.0),
        (0.5, np.inf, 0.0, 2.0, 0.0),
        (np.nan, 1.0, 0.0, 2.0, np.nan),
        (1.0, np.nan, 0.0, 2.0, np.nan),
        (np.nan, np.nan, 1e-6, None, np.nan),
        (1.0, 2.0, 0.0, np.nan, np.nan),
        (1.0, 2.0, 0.0, np.inf, 0.5),
    ],
)
def test_coefficient(dtype, covariance, variance, epsilon, bound, expected):
    found = coefficient(matrix(covariance, variance, dtype), epsilon=epsilon, bound=bound)
    assert found.dtype == dtype
    assert float(found) == pytest.approx(expected, rel=2 * float(np.finfo(dtype).eps), abs=0, nan_ok=True)


def test_the_largest_covariance_beside_an_infinite_variance(dtype):
    # As `moving.emcm` keeps them.
    found = coefficient(matrix(np.finfo(dtype).max, np.inf, dtype), epsilon=1e-6, bound=None)
    assert float(found) == 0


def test_coefficients_of_maps(dtype):
    covariance = jnp.ones((4, 3, 2, 2), dtype)
    bound = np.array([0.5, 1, 2], dtype)
    found = coefficient(covariance, epsilon=0.0, bound=bound)
    np.testing.assert_array_equal(found, np.broadcast_to([0.5, 1, 1], (4, 3)))


@pytest.mark.parametrize("shape", [(), (2,), (3, 3), (2, 2, 3)])
def test_a_coefficient_needs_a_matrix_of_two(shape):
    with pytest.raises(ValueError, match=r"covariance must have \(2, 2\) for its last axes, got shape \("):
        control_variate.coefficient(jnp.zeros(shape), epsilon=0.0, bound=None)


both = jax.jit(
    lambda zs, alpha: [
        control_variate.coefficient(statistic(zs, alpha), epsilon=0.0, bound=None)
        for statistic in (moving.emcm, moving.ewma_covariance)
    ]
)


@given(seed=st.integers(0, 2**32 - 1), alpha=st.floats(1e-3, 0.9), correlation=st.floats(-0.99, 0.99))
def test_the_coefficient_is_the_same_by_both_covariances(x64, seed, alpha, correlation):
    zs = np.random.default_rng(seed).normal(size=(30, 4, 2)) + 2
    zs[..., 0] += correlation * zs[..., 1]
    by_emcm, by_ewma = both(zs, alpha)
    # Recursions with positive weights: 30 steps of a few roundings, relative to sqrt(Sxx / Syy), < 100 here
    # from the third frame on.
    np.testing.assert_allclose(by_ewma[3:], by_emcm[3:], rtol=1e-10, atol=1e-11)
    # One frame tells nothing.
    np.testing.assert_array_equal(by_emcm[0], 1)
    np.testing.assert_array_equal(by_ewma[0], 1)


# The algorithms in NumPy, pixel by pixel


class Pixel:
    """Algorithms 1 to 3 of the 2021 paper, with nine numbers and no thought of speed."""

    def __init__(self, target, eta, kappa, eta_cv, epsilon, threshold, low, high):
        self.constants = target, eta, kappa, eta_cv, epsilon, threshold, low, high
        self.mean_count = self.mean = self.variance = 0.0
        self.sigma, self.zeta = np.zeros((2, 2)), np.zeros(2)

    def count(self, share):
        target, eta, kappa, _, _, threshold, low, high = self.constants
        if share < threshold:
            return 0
        expected = self.variance / target * self.mean_count
        correction = (self.variance - target) / target * self.mean_count * (2 / eta - 2)
        # Halves to the even number.
        return round(min(max(kappa * correction + expected, low), high))

    def frame(self, f, g, integral, count, missing=False, valid=True):
        """The coefficient and the residual of a frame, learned from where it may be."""
        target, eta, _, eta_cv, epsilon, *_ = self.constants
        if missing:
            coefficient = 1.0
        else:
            coefficient = (self.sigma[1, 0] + epsilon) / (self.sigma[1, 1] + epsilon)
        if g > 0:
            coefficient = min(coefficient, (f + g) / g)
        coefficient = max(coefficient, 0.0)
        residual = f - coefficient * integral
        if not valid or count == 0:
            return coefficient, residual
        z = np.array([f, g])
        if missing:
            self.mean_count, self.mean, self.variance = count, residual, target
            self.sigma, self.zeta = np.zeros((2, 2)), z
        else:
            self.variance = (1 - eta) * self.variance + eta * (1 - eta) * (residual - self.mean) ** 2
            self.mean = (1 - eta) * self.mean + eta * residual
            self.mean_count = (1 - eta) * self.mean_count + eta * count
            delta = z - self.zeta
            self.sigma = (1 - eta_cv) * self.sigma + eta_cv * (1 - eta_cv) * np.outer(delta, delta)
            self.zeta = (1 - eta_cv) * self.zeta + eta_cv * z
        return coefficient, residual

    def numbers(self):
        return [self.mean_count, self.mean, self.variance, *self.zeta, self.sigma[0, 1], self.sigma[1, 1]]


FRAMES, PIXELS = 48, 6
CONTROLLER = Controller(2e-3, alpha=0.15, kappa=0.1, min_spp=4, max_spp=100, distant_threshold=0.01)
CONFIG = Config(CONTROLLER, alpha=0.07, epsilon=1e-5)
REFERENCE = dict(target=2e-3, eta=0.15, kappa=0.1, eta_cv=0.07, epsilon=1e-5, threshold=0.01, low=4, high=100)


def streams(seed):
    """Values, controls, integrals, missing and valid of all frames; the control 0 now and then."""
    generator = np.random.default_rng(seed)
    shape = (FRAMES, PIXELS)
    light = 1 + 0.5 * np.sin(0.3 * np.arange(FRAMES))[:, None] * generator.uniform(size=PIXELS)
    control = light * generator.uniform(0.2, 1, PIXELS) * (generator.uniform(size=shape) > 0.1)
    value = light * generator.uniform(0.2, 1, PIXELS) * generator.lognormal(0, 0.05, shape)
    integral = control * generator.lognormal(0, 0.02, shape)
    missing = (generator.uniform(size=shape) < 0.03) | (np.arange(FRAMES)[:, None] == 0)
    valid = generator.uniform(size=shape) > 0.15
    value = np.where(valid, value, np.where(generator.uniform(size=shape) < 0.5, np.nan, 7.0))
    return value, control, integral, missing, valid


# The last pixel has too little distant light for any sample.
SHARE = np.array([1, 0.5, 0.01, 0.2, 1, 0.0099])


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("asked", [False, True])
def test_step_is_the_algorithms_in_numpy(x64, asked, packed):
    columns = streams(5)
    state = control_variate.init(jnp.zeros(PIXELS), CONFIG, packed=packed)
    pixels = [Pixel(**REFERENCE) for _ in range(PIXELS)]
    counts = np.array([pixel.count(share) for pixel, share in zip(pixels, SHARE, strict=True)])
    seen = set()
    for frame, (value, control, integral, missing, valid) in enumerate(zip(*columns, strict=True)):
        # None stands for the count that the history asks for: the least where there is none.
        if asked:
            counts = np.where(missing & (counts > 0), CONTROLLER.min_spp, counts)
        count = None if asked else jnp.asarray(counts)
        state, info = step(state, Observation(value, control, integral, count, SHARE, missing, valid), CONFIG)
        for i, pixel in enumerate(pixels):
            found = pixel.frame(value[i], control[i], integral[i], counts[i], missing[i], valid[i])
            learning = valid[i] and counts[i] > 0
            counts[i] = pixel.count(SHARE[i])
            assert int(info.count[i]) == counts[i]
            if not np.isnan(value[i]):
                assert float(info.coefficient[i]) == pytest.approx(found[0], rel=1e-11, abs=1e-13)
                assert float(info.residual[i]) == pytest.approx(found[1], rel=1e-11, abs=1e-13)
            np.testing.assert_allclose(
                control_variate.pack(state)[i], pixel.numbers(), rtol=1e-11, atol=1e-15
            )
            if not packed:
                np.testing.assert_allclose(state.moments.matrix[i], pixel.sigma, rtol=1e-11, atol=1e-15)
            if learning:
                seen.add("clamped" if counts[i] in (4, 100) else "free")
        assert frame == 0 or not np.any(np.asarray(control_variate.pack(state))[5])
    # The streams reach all that they are to test.
    assert seen == {"clamped", "free"}
    assert (~columns[4]).any() and columns[3][1:].any()


def observations(seed, dtype):
    value, control, integral, missing, valid = streams(seed)
    value, control, integral = (v.astype(dtype) for v in (value, control, integral))
    share = np.broadcast_to(SHARE, value.shape)
    return Observation(value, control, integral, None, share, missing, valid)


def at(frames, t):
    return jax.tree.map(lambda part: part[t], frames)


@jax.jit
def run(state, frames, config):
    return jax.lax.scan(lambda s, frame: control_variate.step(s, frame, config), state, frames)


def test_the_packed_history_does_the_same(dtype):
    frames = observations(6, dtype)
    full, info = run(control_variate.init(jnp.zeros(PIXELS, dtype), CONFIG), frames, CONFIG)
    packed, packed_info = run(
        control_variate.init(jnp.zeros(PIXELS, dtype), CONFIG, packed=True), frames, CONFIG
    )
    leaves_equal(packed_info, info)
    numbers = control_variate.pack(packed)
    assert numbers.shape == (PIXELS, 7) and numbers.dtype == dtype
    leaves_equal(numbers, control_variate.pack(full))
    # Through textures and back.
    unpacked = control_variate.unpack(numbers)
    assert jax.tree.structure(unpacked) == jax.tree.structure(packed)
    leaves_equal(unpacked, packed)
    leaves_equal(control_variate.pack(unpacked), numbers)
    last = at(frames, -1)
    leaves_equal(step(unpacked, last, CONFIG), step(packed, last, CONFIG))


def test_numbers_of_a_history(dtype):
    for packed, numbers in ((False, 8), (True, 7)):
        state = control_variate.init(jnp.zeros((2, 3), dtype), packed=packed)
        # The matrix's two equal entries are kept once.
        assert [part.shape for part in jax.tree.leaves(state)] == [(2, 3)] * numbers
        assert all(part.dtype == dtype and not part.any() for part in jax.tree.leaves(state))
    full = control_variate.init(jnp.zeros((2, 3), dtype)).moments
    assert full is not None and full.matrix.shape == (2, 3, 2, 2)
    for config in (MAIN_PART, NONE):
        assert len(jax.tree.leaves(control_variate.init(0.0, config))) == 3
    half = control_variate.init(0, dtype=jnp.float16)
    assert all(part.dtype == jnp.float16 for part in jax.tree.leaves(half))


def test_scan_is_the_loop_and_vmap_the_map(dtype):
    frames = observations(7, dtype)
    state = start = control_variate.init(jnp.zeros(PIXELS, dtype), CONFIG)
    scanned, infos = run(start, frames, CONFIG)
    for t in range(FRAMES):
        frame = at(frames, t)
        state, info = step(state, frame, CONFIG)
        np.testing.assert_array_equal(info.count, infos.count[t])
    error = 1e3 * float(np.finfo(dtype).eps)
    for one, other in zip(jax.tree.leaves(scanned), jax.tree.leaves(state), strict=True):
        np.testing.assert_allclose(one, other, rtol=error, atol=error * 1e-2)
    eager, _ = control_variate.step(start, at(frames, 0), CONFIG)
    compiled, _ = step(start, at(frames, 0), CONFIG)
    for one, other in zip(jax.tree.leaves(eager), jax.tree.leaves(compiled), strict=True):
        np.testing.assert_allclose(one, other, rtol=4 * float(np.finfo(dtype).eps))
    over_pixels = jax.vmap(lambda s, f: run(s, f, CONFIG), in_axes=(0, 1), out_axes=(0, 1))
    mapped, mapped_infos = over_pixels(start, frames)
    np.testing.assert_array_equal(mapped_infos.count, infos.count)
    for one, other in zip(jax.tree.leaves(scanned), jax.tree.leaves(mapped), strict=True):
        np.testing.assert_allclose(one, other, rtol=error, atol=error * 1e-2)


def test_configurations_are_mapped_over(dtype):
    frames = observations(8, dtype)
    start = control_variate.init(jnp.zeros(PIXELS, dtype), CONFIG)
    alphas = np.array([0.02, 0.3], dtype)
    frame = at(frames, 1)
    swept = jax.jit(jax.vmap(lambda alpha: control_variate.step(start, frame, Config(CONTROLLER, alpha))))(
        alphas
    )
    for i, alpha in enumerate(alphas):
        single = step(start, frame, Config(CONTROLLER, alpha))
        for one, other in zip(jax.tree.leaves(swept), jax.tree.leaves(single), strict=True):
            np.testing.assert_allclose(one[i], other, rtol=8 * float(np.finfo(dtype).eps))


def test_a_nan_that_is_kept_out_does_not_reach_the_gradient(dtype):
    frame = Observation(
        np.array([1, np.nan], dtype),
        np.array([1, np.nan], dtype),
        np.ones(2, dtype),
        8,
        valid=np.array([True, False]),
    )

    def total(alpha, epsilon, offset):
        config = Config(CONTROLLER, alpha, epsilon, offset)
        state, _ = control_variate.step(control_variate.init(jnp.zeros(2, dtype)), frame, config)
        return sum(jnp.sum(part) for part in jax.tree.leaves(state))

    slopes = jax.jit(jax.grad(total, (0, 1, 2)))(*(dtype.type(v) for v in (0.05, 1e-6, 1.0)))
    assert np.all(np.isfinite(slopes))
    # Means a (f + g), products a (1 - a) (f^2 + f g + g^2), all of them 1.
    assert float(slopes[0]) == pytest.approx(2 + 3 * 0.9, rel=20 * float(np.finfo(dtype).eps))


# Single frames


def test_a_pixel_without_a_history_starts_from_its_frame(dtype):
    start = control_variate.init(jnp.zeros((), dtype))
    stale = jax.tree.map(lambda part: part + 3, start)
    lost = jax.tree.map(lambda part: part * np.nan, start)
    frame = Observation(dtype.type(0.4), dtype.type(0.5), dtype.type(0.25), 17, missing=True)
    for state in (start, stale, lost):
        state, info = step(state, frame)
        assert float(info.coefficient) == 1
        assert float(info.residual) == pytest.approx(0.15, abs=float(np.finfo(dtype).eps))
        # At the target the next count is the same.
        assert int(info.count) == 17
        assert [dtype.type(v) for v in control_variate.pack(state)] == [
            17,
            info.residual,
            dtype.type(1e-4),
            dtype.type(0.4),
            dtype.type(0.5),
            0,
            0,
        ]
        assert float(state.moments.value_variance) == 0


def test_a_pixel_without_a_history_asks_nothing_of_what_stood_there(dtype):
    start = control_variate.init(jnp.zeros((), dtype))
    frame = Observation(dtype.type(0.4), dtype.type(0.5), dtype.type(0.5), missing=True)
    expected = step(start, frame)
    assert float(expected[0].count.mean_count) == 8
    leaves_equal(step(jax.tree.map(lambda part: part * np.nan, start), frame), expected)


@pytest.mark.parametrize("config", [ONLINE, MAIN_PART, NONE])
@pytest.mark.parametrize("value", [1.0, np.nan, np.inf])
def test_nothing_is_learned_from_an_invalid_or_unsampled_frame(dtype, config, value):
    filled = control_variate.init(jnp.zeros((), dtype), config)
    filled = jax.tree.map(lambda part: part + 0.1, filled)
    seen = dtype.type(value)
    # One signature, compiled once.
    empty = jax.tree.map(jnp.zeros_like, filled)
    for count, missing, valid in ((8, False, False), (8, True, False), (0, False, True), (0, True, True)):
        frame = Observation(
            seen, seen, seen, np.int32(count), dtype.type(1), np.bool_(missing), np.bool_(valid)
        )
        # Of another surface's history nothing stays.
        leaves_equal(step(filled, frame, config)[0], empty if missing else filled)
    frame = Observation(seen, seen, seen, distant_share=np.nextafter(dtype.type(0.01), dtype.type(0)))
    state, info = step(filled, frame, config)
    leaves_equal(state, filled)
    assert int(info.count) == 0


def test_the_history_asks_for_the_count_announced_before(x64):
    # Distant light that comes and goes: what is drawn is what the last frame announced.
    share = (np.arange(FRAMES) % 4 < 2).astype(float)
    generator = np.random.default_rng(0)
    asking = announced = control_variate.init(0.0, CONFIG)
    count = np.int32(4)
    for t in range(FRAMES):
        value = generator.lognormal(0, 0.1)
        following = share[(t + 1) % FRAMES]
        asking, _ = step(asking, Observation(value, 1.0, 1.0, None, share[t]), CONFIG)
        frame = Observation(value, 1.0, 1.0, count, share[t], next_distant_share=following)
        announced, info = step(announced, frame, CONFIG)
        count = info.count
        leaves_equal(asking, announced)


@pytest.mark.parametrize("stored", [jnp.float16, jnp.bfloat16])
def test_a_control_that_stays_has_no_variance_in_half_formats(stored):
    # 0.4 is no half number: what storing its mean rounds off must not pass for a change of the light.
    state = control_variate.init(0.0, dtype=stored)
    generator = np.random.default_rng(0)
    for t in range(60):
        value = np.float32(1 + 0.15 * generator.standard_normal())
        frame = Observation(value, np.float32(0.4), np.float32(0.4), 20, missing=t == 0)
        state, info = step(state, frame, ONLINE)
        assert float(info.coefficient) == 1
    assert state.moments is not None
    assert float(state.moments.covariance) == float(state.moments.control_variance) == 0


@pytest.mark.parametrize("bad", ["value", "control"])
def test_a_bad_frame_costs_one(dtype, bad):
    good = Observation(dtype.type(0.4), dtype.type(0.5), dtype.type(0.5), 8)
    state, _ = step(control_variate.init(jnp.zeros((), dtype)), good, ONLINE)
    broken = Observation(**{**dict(value=0.4, control=0.5, control_integral=0.5, count=8), bad: np.nan})
    state, _ = step(state, broken, ONLINE)
    state, info = step(state, good, ONLINE)
    # The coefficient of a pixel without a history, and a residual that is finite again.
    assert float(info.coefficient) == 1 and np.isfinite(float(info.residual))
    assert np.all(np.isfinite(control_variate.pack(state)))


def test_a_shape_that_does_not_fit_is_refused():
    state = control_variate.init(jnp.zeros(4))
    for name in ("value", "control", "control_integral"):
        given = {**dict(value=1.0, control=1.0, control_integral=1.0), name: np.ones(3)}
        with pytest.raises(ValueError, match=rf"{name} must broadcast to the shape \(4,\), got \(3,\)"):
            control_variate.step(state, Observation(**given))


def test_the_residual_takes_the_integral_and_the_covariance_the_sample(dtype):
    state = control_variate.init(jnp.zeros((), dtype))
    state, _ = step(state, Observation(dtype.type(1), dtype.type(2), dtype.type(0.5), 8, missing=True))
    state, info = step(state, Observation(dtype.type(3), dtype.type(6), dtype.type(0.25), 8))
    assert float(info.residual) == 3 - 0.25
    covariance = 0.05 * 0.95 * 2 * 4
    assert float(state.moments.covariance) == pytest.approx(covariance, rel=8 * float(np.finfo(dtype).eps))


@pytest.mark.parametrize("constant", [0.0, 0.4, 1.0])
def test_a_constant_coefficient_is_the_sample_count_of_the_residual(dtype, constant):
    config = Config(PAPER_2021, constant=constant)
    state = control_variate.init(jnp.zeros(PIXELS, dtype), config)
    history = sample_count.init(jnp.zeros(PIXELS, dtype))
    frames = observations(9, dtype)
    for t in range(6):
        frame = at(frames, t)
        count = next_count(history, PAPER_2021, distant_share=SHARE)
        left = frame.value - dtype.type(constant) * frame.control_integral
        history = update(history, left, count, PAPER_2021, missing=frame.missing, valid=frame.valid)
        state, info = step(state, frame, config)
        assert state.moments is None
        error = 8 * float(np.finfo(dtype).eps)
        np.testing.assert_allclose(info.residual, left, rtol=error, atol=error)
        np.testing.assert_array_equal(info.coefficient, np.full(PIXELS, constant, dtype))
        for one, other in zip(jax.tree.leaves(state.count), jax.tree.leaves(history), strict=True):
            np.testing.assert_allclose(one, other, rtol=error * 4, atol=error)


@pytest.mark.parametrize("packed", [False, True])
def test_a_half_precision_history(packed):
    value, control, integral = streams(10)[:3]
    # A control that the format has: others are rounded to it first, see the next test.
    columns = value, control.astype(np.float16).astype(float), integral
    state = control_variate.init(jnp.zeros(PIXELS), CONFIG, packed=packed, dtype=jnp.float16)
    structure = jax.tree.map(lambda part: (part.shape, part.dtype), state)
    for frame, (value, control, integral) in enumerate(zip(*columns, strict=True)):
        value = np.nan_to_num(value, nan=0.5)
        before = np.asarray(control_variate.pack(state), float)
        rounded = [v.astype(np.float32) for v in (value, control, integral)]
        observed = Observation(rounded[0], rounded[1], rounded[2], 16, missing=frame == 0)
        state, info = step(state, observed, CONFIG)
        assert jax.tree.map(lambda part: (part.shape, part.dtype), state) == structure
        assert info.residual.dtype == info.coefficient.dtype == jnp.float32
        for i in range(PIXELS):
            pixel = Pixel(**REFERENCE)
            pixel.mean_count, pixel.mean, pixel.variance = before[i, :3]
            pixel.zeta = before[i, 3:5]
            pixel.sigma = np.array([[0, before[i, 5]], [before[i, 5], before[i, 6]]])
            coefficient, _ = pixel.frame(value[i], control[i], integral[i], 16, missing=frame == 0)
            # The step itself is computed in float32.
            assert float(info.coefficient[i]) == pytest.approx(coefficient, rel=2e-6, abs=2e-6)
            expected = np.array(pixel.numbers())
            # Half a unit of 2^-10, or of 2^-24 below the normals, beside the step's own error.
            error = 2.0**-11 * np.abs(expected) + 2.0**-25 + 2e-6
            assert np.all(np.abs(np.asarray(control_variate.pack(state)[i], float) - expected) <= error)


# Light that changes


def stream(value, control, integral):
    """Frames of 16 samples, the first without a history."""
    frames = len(value)
    count, share, valid = np.full(frames, 16), np.ones(frames), np.ones(frames, bool)
    return Observation(value, control, integral, count, share, np.arange(frames) == 0, valid)


@jax.jit
def traced(state, frames, config):
    """The last state, and the residual's moving variance after each frame."""

    def one(state, frame):
        state, _ = control_variate.step(state, frame, config)
        return state, state.count.variance

    return jax.lax.scan(one, state, frames)


def test_a_proportional_control_takes_all_of_the_variance(x64):
    control = np.random.default_rng(3).uniform(0.5, 1.5, (400, 5))
    config = Config(PAPER_2021, epsilon=0.0)
    frames = stream(1.7 * control, control, control)
    state, info = run(control_variate.init(jnp.zeros(5), config), frames, config)
    # Two frames make the ratio; roundings of the deltas and of 400 steps.
    np.testing.assert_allclose(info.coefficient[2:], 1.7, rtol=1e-12)
    np.testing.assert_allclose(info.residual[2:], 0, atol=1e-12)
    # What the first frame left, 0.8^398, and the target with it.
    assert np.all(state.count.variance < 1e-24)
    np.testing.assert_array_equal(info.count[-1], 8)


def sine_run(config, noise):
    """Residual variances of 400 pixels over whole periods of 40 frames, each with noise of its own on f."""
    light = 1 + AMPLITUDE * np.sin(2 * np.pi * np.arange(600) / 40)[:, None]
    value = 0.6 * light + noise * np.random.default_rng(4).normal(size=(600, 400))
    control = np.broadcast_to(0.5 * light, value.shape)
    start = control_variate.init(jnp.zeros(400), config)
    _, variances = traced(start, stream(value, control, control), config)
    return np.asarray(variances)[200:].mean(axis=0)


AMPLITUDE = 0.5


def sine_variance(share, noise, alpha=0.2):
    """Mean moving variance of share * light + white noise: what the moving mean does not follow."""
    turn = 2 * np.pi / 40
    followed = alpha**2 / (1 - 2 * (1 - alpha) * np.cos(turn) + (1 - alpha) ** 2)
    of_light = (share * AMPLITUDE) ** 2 / 2 * (1 - followed)
    return of_light + noise**2 * (2 - 2 * alpha) / (2 - alpha)


# A coefficient c leaves 0.6 - 0.5 c of the light.
@pytest.mark.parametrize("constant, left", [(0.0, 0.6), (1.0, 0.1), (1.2, 0.0)])
def test_fixed_coefficients_leave_the_variance_of_theory(x64, constant, left):
    config = Config(PAPER_2021, constant=constant)
    found = sine_run(config, 0.02)
    error = found.std(ddof=1) / np.sqrt(found.size)
    assert abs(found.mean() - sine_variance(left, 0.02)) < 4 * error
    # Without noise to the digits.
    exact = sine_run(config, 0.0)[0]
    assert exact == pytest.approx(sine_variance(left, 0.0), rel=1e-10, abs=1e-20)


def test_the_online_coefficient_leaves_the_noise_alone(x64):
    floor, without = sine_variance(0.0, 0.02), sine_variance(0.6, 0.02)
    found = sine_run(ONLINE, 0.02)
    error = found.std(ddof=1) / np.sqrt(found.size)
    # The coefficient is a regression on a sine with weights worth 2 / 0.05 - 1 = 39 frames. Its error's
    # share of the residual's variance is g^2 / (39 Var(g)), on average (1 / 0.125 + 1) / 39.
    assert floor - 4 * error < found.mean() < floor * (1 + 9 / 39) + 4 * error
    assert without > 20 * found.mean()


# f = h / (1 + y) and g = h (1 - y) of a uniform y: appendix B.3 of the dissertation.

VAR_F, COVARIANCE, VAR_G = 0.019546986081798575, 0.039720770839917964, 1 / 12
STATIC, DYNAMIC = 0.47664925007901557, 1.3862943611198906
SPP, RUNS, TIMES = 16, 4000, 100
LIGHTS = {"static": np.ones(TIMES), "dynamic": 1 + 3 * np.sin(np.arange(TIMES) / 10)}


def test_the_example_in_print_by_quadrature():
    with mpmath.workdps(25):

        def mean(function) -> mpmath.mpf:
            return mpmath.mpf(mpmath.quad(function, [0, 1]))

        f, g = (lambda y: 1 / (1 + y)), (lambda y: 1 - y)
        of_f, of_g = mean(f), mean(g)
        var_f = mean(lambda y: f(y) ** 2) - of_f * of_f
        var_g = mean(lambda y: g(y) ** 2) - of_g * of_g
        covariance = mean(lambda y: f(y) * g(y)) - of_f * of_g
        for found, printed in (
            (var_f, VAR_F),
            (var_g, VAR_G),
            (covariance, COVARIANCE),
            (covariance / var_g, STATIC),
            (of_f / of_g, DYNAMIC),
            (var_f - covariance * covariance / var_g, 6.1411044839124834e-4),
        ):
            assert float(found) == pytest.approx(printed, rel=1e-15)


@pytest.fixture(scope="module")
def batches():
    """Means of 16 samples of f and g for a light of 1, (TIMES, RUNS)."""
    y = np.random.default_rng(17).uniform(size=(TIMES, RUNS, SPP))
    return (1 / (1 + y)).mean(axis=-1), (1 - y).mean(axis=-1)


def example(batches, light, config, *, constant_in_frame):
    """The last state, and the root of the residual's moving variance in all frames."""
    value, control = (light[:, None] * part for part in batches)
    integral = np.broadcast_to(0.5 * light[:, None], control.shape)
    frames = stream(value, integral if constant_in_frame else control, integral)
    state, variances = traced(control_variate.init(jnp.zeros(RUNS), config), frames, config)
    return state, np.sqrt(variances)


def unbounded(controller=PAPER_2021):
    return Config(controller, epsilon=0.0, bound_offset=np.inf)


def test_a_control_constant_within_a_frame_finds_the_dynamic_optimum(x64, batches):
    state, _ = example(batches, LIGHTS["dynamic"], unbounded(), constant_in_frame=True)
    found = np.asarray(control_variate.coefficient(state.moments.matrix, epsilon=0.0, bound=None))
    # A weighted regression on h / 2 of values whose expectation is ln 2 h: its slope has no bias.
    assert abs(found.mean() - 2 * np.log(2)) < 4 * found.std(ddof=1) / np.sqrt(RUNS)


@pytest.mark.parametrize("light", LIGHTS)
def test_a_sampled_control_finds_the_optimum_of_its_samples(x64, batches, light):
    state, _ = example(batches, LIGHTS[light], unbounded(), constant_in_frame=False)
    # Expected weighted moments with explicit weights, the first frame's 0.95^99.
    age = np.arange(TIMES)[::-1]
    weights = 0.05 * 0.95**age
    weights[0] = 0.95 ** age[0]
    h = LIGHTS[light]
    of_light = weights @ h**2 - (weights @ h) ** 2
    of_samples = (weights * (1 - weights)) @ h**2 / SPP
    covariance = np.log(2) / 2 * of_light + COVARIANCE * of_samples
    variance = 0.25 * of_light + VAR_G * of_samples
    # The ratio of the runs' means: their spread around the line through it is its error.
    x, y = (np.asarray(part) for part in (state.moments.control_variance, state.moments.covariance))
    ratio = covariance / variance
    error = (y - ratio * x).std(ddof=1) / np.sqrt(RUNS) / x.mean()
    assert abs(y.mean() / x.mean() - ratio) < 4 * error
    if light == "static":
        assert ratio == pytest.approx(STATIC, rel=1e-12)
    else:
        assert STATIC < ratio < DYNAMIC


# Means of 4000 runs in NumPy, and their deviation, without a control.
UNCONTROLLED = {"static": (0.03211, 0.00257), "dynamic": (0.57616, 0.00503)}


@pytest.mark.parametrize("light", LIGHTS)
def test_residuals_of_the_example_without_a_control(x64, batches, light):
    # A first variance of zero, as in those runs; frames 25 to 100.
    controller = Controller(1e-4, variance_when_missing="zero")
    config = Config(controller, constant=0.0)
    _, roots = example(batches, LIGHTS[light], config, constant_in_frame=True)
    of_runs = roots[24:].mean(axis=0)
    mean, deviation = UNCONTROLLED[light]
    assert abs(of_runs.mean() - mean) < 4 * np.hypot(deviation, of_runs.std(ddof=1)) / np.sqrt(RUNS) + 5e-6


def test_the_online_residual_of_the_static_example(x64, batches):
    # The covariance of g as sampled, the residual of G: a median of 0.0327 in 4000 runs in NumPy.
    config = unbounded(Controller(1e-4, variance_when_missing="zero"))
    _, roots = example(batches, LIGHTS["static"], config, constant_in_frame=False)
    of_runs = np.sort(roots[24:].mean(axis=0))
    # The median's standard error from the order statistics sqrt(RUNS) / 2 away.
    half = round(np.sqrt(RUNS) / 2)
    error = (of_runs[RUNS // 2 + half] - of_runs[RUNS // 2 - half]) / 2
    assert abs(np.median(of_runs) - 0.0327) < 4 * np.sqrt(2) * error + 5e-5


# Errors


def test_a_history_that_fits_not_is_refused():
    with pytest.raises(ValueError, match="config estimates the coefficient, but the state keeps no moments"):
        control_variate.step(control_variate.init(0.0, NONE), Observation(1.0, 1.0, 1.0, 8), ONLINE)
    with pytest.raises(ValueError, match="a history with a constant coefficient has three numbers"):
        control_variate.pack(control_variate.init(0.0, NONE))
    for shape in ((), (6,), (7, 2)):
        with pytest.raises(ValueError, match=r"must have 7 numbers on its last axis, got shape \("):
            control_variate.unpack(jnp.zeros(shape))
    moments = control_variate.init(0.0, packed=True).moments
    assert moments is not None
    with pytest.raises(ValueError, match="a packed history keeps no full matrix"):
        moments.matrix  # noqa: B018


@pytest.mark.parametrize(
    "changes, message",
    [
        (dict(alpha=0.0), r"alpha must be in \(0, 1\], got 0"),
        (dict(alpha=1.1), r"alpha must be in \(0, 1\], got 1.1"),
        (dict(epsilon=-1e-6), "epsilon must be at least 0, got -1e-06"),
        (dict(epsilon=np.nan), "epsilon must be at least 0, got nan"),
        (dict(bound_offset=-1), "bound_offset must be at least 0, got -1"),
    ],
)
def test_constants_outside_their_domain_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Config(PAPER_2021, **changes)


def test_the_configurations_are_the_published_constants():
    # Section 7 of the 2021 paper; the weight of the covariance is that of its supplement.
    for config, constant in ((ONLINE, None), (MAIN_PART, 1), (NONE, 0)):
        assert config.controller == PAPER_2021
        assert (config.alpha, config.epsilon, config.bound_offset) == (0.05, 1e-6, 1)
        assert config.constant == constant
