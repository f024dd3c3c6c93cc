"""Fronts against brute force, and candidates against runs of the driver one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sssfit.estimators import policies
from sssfit.scenarios import circle, driver, light, tune
from sssfit.scenarios.measure import Target

# Each simulation is a program to compile, and many seeds.
pytestmark = pytest.mark.slow

FRAMES, FIRST, SEEDS = 16, 4, 2
WANTED = Target(0.0064, 8, 64)
KEY = jax.random.key(7)
WORLDS = {
    "static": circle.uniform(np.ones(FRAMES, np.float32)),
    # Between 8 and 64 samples in some frames only.
    "sine": circle.uniform(light.sine(FRAMES, fps=16.0, depth=0.9).astype(np.float32)),
}


# Drawing


@pytest.mark.parametrize("controller", tune.CONSTANTS)
def test_constants_are_in_their_ranges(controller):
    found = tune.draw(controller, 400, seed=1)
    assert tuple(found) == tune.CONSTANTS[controller]
    for name, values in found.items():
        low, high = tune.RANGES[name]
        assert values.shape == (400,) and ((low <= values) & (values <= high)).all()
        if name.endswith("_spp"):
            assert (values == np.round(values)).all() and len(set(values)) > 10
        else:
            # Log-uniform where a bound is a ratio.
            ratio = name in ("alpha", "target_variance")
            ends = np.log([low, high]) if ratio else np.array([low, high])
            share = ((np.log(values) if ratio else values) - ends[0]) / np.diff(ends)
            assert stats.kstest(share, "uniform").pvalue > 1e-3, name


def test_in_frame_has_no_kappa():
    assert "kappa" not in tune.draw("in_frame", 1) and "kappa" in tune.draw("as", 1)


def test_the_same_seed_draws_the_same():
    first, second, other = (tune.draw("ocv", 9, seed=seed) for seed in (3, 3, 4))
    assert all((first[name] == second[name]).all() for name in first)
    assert not any((first[name] == other[name]).all() for name in ("alpha", "kappa", "target_variance"))


def test_what_cannot_be_drawn():
    with pytest.raises(ValueError, match="controller must be one of as, ocv, ccv, in_frame, got 'fixed'"):
        tune.draw("fixed", 3)
    for candidates in (0, -2):
        with pytest.raises(ValueError, match=f"candidates must be at least 1, got {candidates}"):
            tune.draw("as", candidates)


# Evaluating


@pytest.fixture(scope="module")
def evaluated():
    """Candidates of one controller in both scenarios, simulated once."""
    found = {}

    def of(controller):
        if controller not in found:
            constants = tune.draw(controller, 3, seed=2)
            found[controller] = tune.evaluate(
                KEY, WORLDS, WANTED, controller, constants, seeds=SEEDS, first=FIRST
            )
        return found[controller]

    return of


def directly(controller, constants, world):
    """Count over the oracle's and kept error of one candidate, from the driver's records by NumPy."""
    numbers = {name: jnp.float32(value) for name, value in constants.items()}
    numbers["target_variance"] = jnp.float32(constants["target_variance"] * WANTED.variance)
    policy = policies.named(controller, **numbers)
    record = driver.run(KEY, world, policy, seeds=SEEDS, most=128)
    counts = np.asarray(record.count, float)[:, FIRST:]
    variance = np.asarray(world.sample_variance, float)[FIRST:]
    ideal = np.clip(variance / 0.0064, 8, 64)
    kept = (variance / counts)[:, (8 < variance / 0.0064) & (variance / 0.0064 < 64)]
    return counts.mean() / ideal.mean(), np.sqrt(np.quantile(kept, 0.95) / 0.0064)


@pytest.mark.parametrize("controller", ["as", "in_frame"])
def test_candidates_are_runs_of_the_driver(controller, evaluated):
    found = evaluated(controller)
    assert found.controller == controller and list(found.by_scenario) == list(WORLDS)
    for name, world in WORLDS.items():
        assert found.by_scenario[name].shape == (3, 2)
        for i in range(3):
            chosen = {constant: values[i] for constant, values in found.constants.items()}
            # Float32: a mean of 24 whole numbers, and a quantile of a few quotients.
            expected = directly(controller, chosen, world)
            assert found.by_scenario[name][i] == pytest.approx(np.array(expected), rel=2e-6)


def test_figures_are_means_over_the_scenarios(evaluated):
    found = evaluated("as")
    both = np.stack([found.by_scenario["static"], found.by_scenario["sine"]])
    assert found.samples == pytest.approx(both[..., 0].mean(axis=0), rel=1e-14)
    assert found.error == pytest.approx(both[..., 1].mean(axis=0), rel=1e-14)
    # As they were given: the target in units of the wanted one.
    assert all((found.constants[k] == v).all() for k, v in tune.draw("as", 3, seed=2).items())


@pytest.mark.parametrize("chunk", [1, 2])
def test_chunks_change_nothing(chunk, evaluated, monkeypatch):
    whole, seen = evaluated("as"), []
    monkeypatch.setattr(tune, "_CHUNK", chunk)
    progress = {"progress": lambda done, total: seen.append((done, total))}
    found = tune.evaluate(
        KEY, WORLDS, WANTED, "as", tune.draw("as", 3, seed=2), seeds=SEEDS, first=FIRST, **progress
    )
    # Programs of other shapes may round otherwise.
    assert found.samples == pytest.approx(whole.samples, rel=2e-6)
    assert found.error == pytest.approx(whole.error, rel=2e-6)
    done = [at for at, _ in seen]
    assert done == sorted(done) and done[0] == 0 and done[-1] == 6 and {total for _, total in seen} == {6}
    assert len(seen) == 2 * -(-3 // chunk) + 1


def test_an_oracle_keeps_the_wanted_error():
    """All that is free of bounds has it, up to rounding the count; the others do not count."""
    constants = {"target_variance": np.array([1.0, 4.0])}
    found = tune.evaluate(KEY, WORLDS, WANTED, "oracle", constants, seeds=1, first=FIRST)
    # At the target itself counts from 8 up are rounded by half a sample at most.
    assert (abs(found.by_scenario["static"][0] - 1) < 0.5 / 42).all()
    assert 1 - 0.5 / 8 < found.by_scenario["sine"][0, 1] < 1 + 0.5 / 8
    assert found.by_scenario["static"][1] == pytest.approx(
        [11 / 42.6936788648692, np.sqrt(42.6936788648692 / 11)]
    )


def test_bounds_everywhere_leave_no_error():
    wanted = Target(1e-4, 8, 64)
    found = tune.evaluate(
        KEY, {"circle": WORLDS["static"]}, wanted, "oracle", {"target_variance": np.ones(1)}, first=FIRST
    )
    assert found.samples == pytest.approx([1.0]) and np.isnan(found.error).all()


# The front

coordinates = st.integers(0, 6).map(float)
points = st.lists(st.tuples(coordinates, coordinates), max_size=12)


@given(points)
def test_front_by_brute_force(places):
    samples, error = (np.array([p[i] for p in places]) for i in (0, 1))
    found = tune.front(samples, error)
    assert found.dtype == np.int64 and len(set(found.tolist())) == len(found)

    def is_beaten(point):
        return any(other[0] <= point[0] and other[1] <= point[1] and other != point for other in places)

    # Equal candidates are on the front once.
    assert [places[i] for i in found] == sorted({point for point in places if not is_beaten(point)})


@given(st.lists(st.tuples(st.floats(0.1, 10), st.floats(0.1, 10)), min_size=1))
def test_front_rises_and_falls(places):
    samples, error = np.array(places).T
    found = tune.front(samples, error)
    assert (np.diff(samples[found]) > 0).all() and (np.diff(error[found]) < 0).all()
    assert samples[found[0]] == samples.min() and error[found[-1]] == error.min()


def made(samples, error):
    return tune.Candidates("as", {}, np.array(samples, float), np.array(error, float), {})


def test_candidates_without_an_error_are_not_on_the_front():
    assert tune.front([1.0, 2.0, 3.0], [np.nan, 2.0, 1.0]).tolist() == [1, 2]


def test_samples_at_the_front_itself():
    found = made([4.0, 1.0, 2.0, 3.0], [0.5, 2.0, 1.0, 1.5])
    # The last one is beaten by the third.
    assert [tune.samples_at(found, error) for error in (0.5, 1.0, 2.0)] == pytest.approx([4.0, 2.0, 1.0])


@given(st.floats(0, 1), st.floats(0.1, 5), st.floats(-3, -0.1))
def test_a_power_law_is_met_in_between(share, scale, power):
    errors = np.array([0.5, 0.8, 2.0, 3.0])
    error = float(np.exp(np.log(0.5) + share * np.log(6.0) * 0.999))
    found = made(scale * errors**power, errors)
    assert tune.samples_at(found, error) == pytest.approx(scale * error**power, rel=1e-12)


@pytest.mark.parametrize("error", [0.499, 2.001, 1e-9, 1e9])
def test_nothing_outside_the_front(error):
    assert np.isnan(tune.samples_at(made([4.0, 2.0, 1.0], [0.5, 1.0, 2.0]), error))


def test_a_front_of_one():
    found = made([3.0, 4.0], [0.7, 0.9])
    assert tune.samples_at(found, 0.7) == pytest.approx(3.0) and np.isnan(tune.samples_at(found, 0.9))


@pytest.mark.parametrize("candidates", [([], []), ([1.0], [np.nan])])
def test_no_front_at_all(candidates):
    with pytest.raises(ValueError, match="found must hold at least one candidate, got none"):
        tune.samples_at(made(*candidates), 1.0)
