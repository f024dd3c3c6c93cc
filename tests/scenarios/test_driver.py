"""Drawing and driving: the samples counted by hand, frame by frame as in one scan, whatever the chunks."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sssfit.estimators import control_variate, policies, sample_count
from sssfit.scenarios import circle, driver, line

MOST = 64
sequences = pytest.mark.parametrize("sequence", driver.SEQUENCES)
starts = pytest.mark.parametrize("start", driver.STARTS)

# Frames are whole numbers here.
draw: Any = eqx.filter_jit(driver.draw)
step: Any = eqx.filter_jit(driver.step)
eager_draw: Any = driver.draw
known: Any = driver.known


class Spy(eqx.Module):
    """A world whose samples are the points' first coordinates, times one number for each pixel and frame."""

    factor: jax.Array
    truth: jax.Array
    sample_variance: jax.Array
    control: jax.Array
    surround: jax.Array

    def places(self, uniform):
        return uniform[0]

    def values(self, places, frame):
        return places * self.factor[frame]


def spying(factor):
    factor = jnp.asarray(factor)
    return Spy(factor, factor / 2, factor**2 / 12, factor, 2 * factor)


def spy(shape=(), frames=3, dtype: Any = np.float32):
    return spying(np.ones((frames, *shape), dtype))


def flickering(dtype: Any = np.float32):
    """Five pixels of unequal light that flickers for four frames."""
    light = np.outer(1 + np.sin(np.arange(4.0)), [0.05, 0.3, 1.0, 0.7, 0.2])
    return spying(light.astype(dtype))


def ramp_world(frames=4, dtype: Any = np.float32):
    profile = line.ramp(line.centres(12, 4.0))
    intensity = 1 + np.sin(np.arange(frames))
    return line.world((intensity[:, None] * profile).astype(dtype), length=4.0, d=0.1)


# Drawing


@sequences
def test_the_mean_and_the_deviation_of_the_points(x64, sequence):
    # Every count draws the first points of one sequence, so that sums of k and k - 1 differ by one point.
    world, key = spy(dtype=np.float64), jax.random.key(1)
    drawn = [draw(key, world, 0, jnp.int32(k), most=MOST, sequence=sequence) for k in range(1, MOST + 1)]
    sums = np.array([k * float(found.mean) for k, found in enumerate(drawn, start=1)])
    points = np.diff(sums, prepend=0)
    # Multiples of 2^-24 in [0, 1).
    assert np.all((points > -1e-12) & (points < 1))
    assert points * 2**24 == pytest.approx(np.round(points * 2**24), abs=1e-5)
    assert len(np.unique(np.round(points * 2**24))) > 60
    for k, found in enumerate(drawn, start=1):
        assert int(found.count) == k
        expected = np.sum((points[:k] - points[:k].mean()) ** 2)
        assert float(found.square_deviation) == pytest.approx(expected, abs=1e-12)


@sequences
def test_each_pixel_has_its_own_count(sequence):
    # Below 1, above `most`, and what one pixel draws does not depend on the others' counts.
    world, key = spy((6,)), jax.random.key(2)
    count = jnp.array([0, 1, 2, 7, 64, 99], jnp.int32)
    found = draw(key, world, 1, count, most=MOST, sequence=sequence)
    assert found.count.tolist() == [0, 1, 2, 7, 64, 64]
    assert float(found.mean[0]) == float(found.square_deviation[0]) == float(found.square_deviation[1]) == 0
    for pixel in range(6):
        alone = draw(key, world, 1, jnp.full(6, count[pixel], jnp.int32), most=MOST, sequence=sequence)
        for mine, other in zip(found, alone, strict=True):
            assert mine[pixel] == other[pixel]
    assert len(set(found.mean.tolist())) == 5 + 1


@pytest.mark.parametrize("most", [1, 9])
def test_most_is_the_most_that_is_drawn(most):
    found = draw(jax.random.key(3), spy((3,)), 0, jnp.array([most - 1, most, 1000]), most=most)
    assert found.count.tolist() == [most - 1, most, most]
    # A larger `most` changes nothing for who does not ask for it.
    other = draw(jax.random.key(3), spy((3,)), 0, jnp.array([most - 1, most, most]), most=MOST)
    # Sums are of at most 63 numbers below 1, rounded as they are compiled.
    np.testing.assert_allclose(found.mean, other.mean, atol=1e-6)
    np.testing.assert_allclose(found.square_deviation, other.square_deviation, atol=4e-6)


class Even(Spy):
    """A world whose samples are all alike."""

    def values(self, places, frame):
        return self.factor[frame] + 0 * places


def test_samples_that_are_all_alike_have_no_deviation(dtype):
    # Whatever they are, and however far from what the world takes for the truth.
    factor = jnp.asarray([[0.0, 1e-3, 3.7, 1e4]], dtype)
    for truth in (factor, 0.9 * factor):
        world = Even(factor, truth, 0 * factor, factor, factor)
        found = draw(jax.random.key(4), world, 0, jnp.full(4, 50), most=MOST)
        eps = float(np.finfo(dtype).eps)
        assert found.mean.dtype == dtype
        assert np.asarray(found.mean) == pytest.approx(np.asarray(factor[0]), rel=4 * eps)
        # Roundings of sums of squares around the truth.
        bound = 50 * 20 * eps * np.square(np.asarray(factor - truth)[0] + eps * np.asarray(factor)[0])
        assert np.all((found.square_deviation >= 0) & (found.square_deviation <= bound))


@pytest.fixture(scope="module")
def many_draws():
    """Of 20000 keys, the means and deviations of 16 points, by sequence."""
    keys = jax.random.split(jax.random.key(5), 20_000)
    world, count = spy((2,)), jnp.full(2, 16, jnp.int32)

    @eqx.filter_jit
    def all_of(sequence):
        return jax.vmap(lambda key: eager_draw(key, world, 0, count, most=16, sequence=sequence))(keys)

    return {name: [np.asarray(v, np.float64) for v in all_of(name)[1:]] for name in driver.SEQUENCES}


@sequences
def test_means_are_unbiased_and_pixels_independent(many_draws, sequence):
    mean, _ = many_draws[sequence]
    assert np.all(np.abs(mean.mean(axis=0) - 0.5) < 4.5 * mean.std(axis=0) / np.sqrt(len(mean)))
    assert abs(np.corrcoef(mean.T)[0, 1]) < 4.5 / np.sqrt(len(mean))


def test_the_spread_of_independent_points(many_draws):
    mean, deviation = many_draws["iid"]
    number = mean.size
    # Variance 1/12; of the sample variance 1/180 / n less what n - 1 adds, of the squared mean 2 (1/192)^2.
    variance = deviation / 15
    assert abs(variance.mean() - 1 / 12) < 4.5 * variance.std() / np.sqrt(number)
    squared = (mean - 0.5) ** 2
    assert abs(squared.mean() - 1 / 192) < 4.5 * squared.std() / np.sqrt(number)


def test_r2_means_vary_less_than_independent_ones(many_draws):
    mean, _ = many_draws["r2"]
    squared = (mean - 0.5) ** 2
    assert squared.mean() + 4.5 * squared.std() / np.sqrt(squared.size) < 1 / 192


def test_frames_and_seeds_are_independent():
    record = driver.run(jax.random.key(6), spy(frames=4), policies.named("fixed", spp=8), seeds=20_000)
    frames = record.value.astype(float)
    correlation = np.corrcoef(frames.T) - np.eye(4)
    assert np.all(np.abs(correlation) < 4.5 / np.sqrt(len(frames)))
    between = np.corrcoef(frames[:-1].ravel(), frames[1:].ravel())[0, 1]
    assert abs(between) < 4.5 / np.sqrt(frames.size)
    assert len(np.unique(frames)) > 0.9 * frames.size * (1 - frames.size / 2**27)


# Frame by frame


def test_what_is_known_before_a_frame():
    world = flickering()
    found = known(world, 2, missing=jnp.array(True))
    assert np.array_equal(found.control, world.control[2])
    assert np.array_equal(found.surround, world.surround[2])
    assert np.array_equal(found.sample_variance, world.sample_variance[2])
    assert found.missing.shape == (5,) and bool(found.missing.all())


def test_steps_by_hand_are_the_run():
    world, policy, key = flickering(), policies.named("in_frame"), jax.random.key(7)
    whole = driver.run(key, world, policy, seeds=3, most=MOST)
    for seed in (0, 2):
        seed_key = jax.random.fold_in(key, seed)
        state = policy.init(jnp.zeros(5))
        for frame in range(4):
            state, record = step(seed_key, world, policy, state, jnp.int32(frame), most=MOST)
            assert np.array_equal(record.count, whole.count[seed, frame])
            # Compiled as a whole, sums round another way: a few eps of what they sum.
            for mine, other in zip(record[1:], whole[1:], strict=True):
                np.testing.assert_allclose(mine, other[seed, frame], rtol=1e-5, atol=1e-6)


def test_not_compiled_as_compiled():
    arguments = jax.random.key(8), spy((3,)), 0, jnp.array([5, 8, 20])
    compiled = draw(*arguments, most=24)
    for mine, other in zip(eager_draw(*arguments, most=24), compiled, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-5, atol=1e-6)


def test_chunks_change_nothing():
    # Each size is compiled for itself, and may round the last digit another way.
    world, policy, key = flickering(), policies.named("in_frame"), jax.random.key(9)
    whole = driver.run(key, world, policy, seeds=7)
    for chunk, sizes in ((3, [3, 3, 1]), (100, [7])):
        parts = list(driver.chunks(key, world, policy, seeds=7, chunk=chunk))
        assert [len(part.count) for part in parts] == sizes
        assert np.array_equal(whole.count, np.concatenate([part.count for part in parts]))
        for index, leaf in enumerate(whole):
            assert isinstance(leaf, np.ndarray) and leaf.shape == (7, 4, 5)
            joined = np.concatenate([part[index] for part in parts])
            np.testing.assert_allclose(leaf, joined, rtol=1e-5, atol=1e-6)


def test_a_seed_has_its_numbers_however_many_there_are():
    # Of the same chunks they are the same to the bit.
    world, policy, key = flickering(), policies.named("in_frame"), jax.random.key(9)
    few, many = (driver.run(key, world, policy, seeds=seeds, chunk=3) for seeds in (3, 8))
    for mine, other in zip(few, many, strict=True):
        assert np.array_equal(mine, other[:3])
    assert len(np.unique(many.value[:, 0, 2])) == 8
    another = driver.run(jax.random.key(11), world, policy, seeds=3)
    assert not np.any(few.value[:, :, 2] == another.value[:, :, 2])


@starts
def test_only_a_disocclusion_is_missing(start):
    # What the policy is told decides what it makes of frame 0: the paper's variance starts from its target.
    policy = policies.named("as", target_variance=0.0064)
    record = driver.run(jax.random.key(12), circle.uniform(3), policy, seeds=4, start=start)
    assert np.all(record.count[:, 0] == 8)
    first, mean = record.variance[:, 0], record.mean[:, 0]
    if start == "disocclusion":
        assert first == pytest.approx(np.full(4, 0.0064), rel=1e-6)
        assert mean == pytest.approx(record.value[:, 0], rel=1e-6)
    else:
        assert mean == pytest.approx(0.2 * record.value[:, 0], rel=1e-6)
        assert first == pytest.approx(0.8 * 0.2 * record.value[:, 0] ** 2, rel=1e-5)


def test_precision_is_the_worlds_and_the_points_are_the_same():
    found = []
    for dtype in (np.float32, np.float64):
        with jax.enable_x64(dtype == np.float64):
            world = circle.uniform(np.ones(6, dtype))
            found.append(driver.run(jax.random.key(14), world, policies.named("fixed", spp=33), seeds=50))
        assert found[-1].count.dtype == np.int32
        assert all(leaf.dtype == dtype for leaf in found[-1][1:])
    assert found[0].value == pytest.approx(found[1].value, rel=1e-5)
    assert found[0].square_deviation == pytest.approx(found[1].square_deviation, rel=1e-5, abs=1e-4)


def test_constants_mapped_over():
    # A whole trajectory for each of three controllers, with equinox's vmap, and one by one.
    alphas, kappas = jnp.array([0.1, 0.2, 0.5]), jnp.array([0.0, 0.2, 0.4])
    world, key = circle.uniform(30), jax.random.key(15)

    def found(alpha, kappa):
        controller = sample_count.Controller(0.0064, alpha, kappa)
        policy = policies.Adaptive(control_variate.Config(controller, constant=0.0))
        return driver.trajectory(key, world, policy, most=MOST)

    mapped = eqx.filter_jit(eqx.filter_vmap(found))(alphas, kappas)
    single = eqx.filter_jit(found)
    for index in range(3):
        alone = single(alphas[index], kappas[index])
        assert np.array_equal(mapped.count[index], alone.count)
        for mine, other in zip(mapped, alone, strict=True):
            np.testing.assert_allclose(mine[index], other, rtol=1e-5, atol=1e-7)
    assert len({tuple(row) for row in mapped.count.tolist()}) == 3


def test_constants_as_maps_of_the_pixels():
    # A pixel for each of three alphas in one world of three pixels.
    alphas, key, world = jnp.array([0.05, 0.1, 0.3]), jax.random.key(16), spy((3,), frames=5)

    def variance(alpha):
        policy = policies.named("in_frame", target_variance=0.0064, alpha=alpha)
        return driver.run(key, world, policy, seeds=2).variance

    together = variance(alphas)
    for index in range(3):
        alone = variance(jnp.full(3, alphas[index]))
        np.testing.assert_allclose(together[..., index], alone[..., index], rtol=1e-5)


# Gradients


@starts
def test_gradient_of_the_tracked_variance_in_the_target(x64, start):
    # Counts are whole numbers and have no gradient. The variance starts from the target at a disocclusion,
    # and that start fades by 1 - alpha a frame; a cold start has none of it.
    world, key = circle.uniform(np.ones(6)), jax.random.key(17)

    def variance(target, frame):
        controller = sample_count.Controller(target, alpha=0.2, kappa=0.2)
        policy = policies.Adaptive(control_variate.Config(controller, constant=0.0))
        return driver.trajectory(key, world, policy, most=MOST, start=start).variance[frame]

    slope = eqx.filter_jit(jax.grad(variance))
    for frame in (0, 1, 5):
        expected = 0.8**frame if start == "disocclusion" else 0.0
        assert float(slope(0.0064, jnp.int32(frame))) == pytest.approx(expected, rel=1e-12)


def test_gradient_of_the_result_in_the_light(x64):
    # A result is a mean of irradiances: it grows in proportion to them, so that Euler's theorem holds.
    world, key = ramp_world(frames=2, dtype=np.float64), jax.random.key(18)

    def value(irradiance, pixel):
        lit = eqx.tree_at(lambda w: w.irradiance, world, irradiance)
        return driver.trajectory(key, lit, policies.named("fixed", spp=16), most=16).value[1, pixel]

    slope = eqx.filter_jit(jax.value_and_grad(value))
    for pixel in (2, 5, 11):
        found, gradient = slope(world.irradiance, jnp.int32(pixel))
        assert np.all(np.asarray(gradient) >= 0) and np.all(np.asarray(gradient)[0] == 0)
        assert float(jnp.sum(gradient)) == pytest.approx(1, rel=1e-12)
        assert float(jnp.sum(gradient * world.irradiance)) == pytest.approx(float(found), rel=1e-12)


# Faults


@pytest.mark.parametrize(
    "fault, message",
    [
        ({"seeds": 0}, "seeds must be at least 1, got 0"),
        ({"seeds": -5}, "seeds must be at least 1, got -5"),
        ({"chunk": 0}, "chunk must be at least 1, got 0"),
        ({"chunk": -1}, "chunk must be at least 1, got -1"),
        ({"most": 0}, "most must be at least 1, got 0"),
        ({"start": "warm"}, "start must be one of cold, disocclusion, got 'warm'"),
        ({"sequence": "halton"}, "sequence must be one of iid, r2, got 'halton'"),
    ],
)
def test_faults(fault, message):
    options = {"seeds": 2} | fault
    with pytest.raises(ValueError, match=message):
        driver.run(jax.random.key(0), circle.uniform(2), policies.named("as"), **options)


class Unbounded(eqx.Module):
    """A policy that does not say what it may ask for."""

    def init(self, like):
        return ()

    def count(self, state, known):
        return jnp.full(known.missing.shape, 5, jnp.int32)

    def learn(self, state, known, sampled):
        return state, policies.Learned(sampled.mean, sampled.mean, sampled.mean)


def test_the_largest_count_has_to_be_known():
    message = "most must be given for a policy whose max_spp is not known on the host"
    with pytest.raises(ValueError, match=message):
        driver.largest_count(Unbounded())
    with pytest.raises(ValueError, match=message):
        driver.run(jax.random.key(0), circle.uniform(2), Unbounded(), seeds=1)
    record = driver.run(jax.random.key(0), circle.uniform(2), Unbounded(), seeds=1, most=8)
    assert np.all(record.count == 5)
    with pytest.raises(ValueError, match=message):
        jax.jit(lambda most: driver.largest_count(policies.named("as", max_spp=most)))(64)
    assert driver.largest_count(policies.named("as", max_spp=np.array([16, 128, 32]))) == 128
    assert driver.largest_count(policies.named("fixed", spp=7)) == 7
