"""The cost model against another solver, and what it is fitted to against counts made by hand."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from sssfit.frames import camera, procedural
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings
from sssfit.trade import cache, cost_model, demands, machine
from sssfit.trade.choice import CannotMeasure
from sssfit.trade.demands import Demand, Fetched
from sssfit.trade.setting import procedural_setting
from sssfit.trade.studies import cost

TRUE = cost_model.Model(
    {"passes": 1e-3, "frame_pixels": 2e-8, "pixels": 3e-8, "from_second": 5e-11, "from_memory": 2e-10},
    {"surface": 7e-9, "plane": 2e-9},
)


def some_demands(number=40, seed=0):
    """Demands in which nothing rises together."""
    random = np.random.default_rng(seed)
    passes = random.integers(1, 4, number)
    pixels = random.uniform(1e4, 1e6, number)
    drawn = pixels * random.uniform(4, 64, number)
    bytes_read = drawn * random.uniform(1, 40, number), drawn * random.uniform(0, 10, number)
    frame_pixels = passes * random.uniform(5e4, 2e6, number)
    columns = zip(passes, frame_pixels, pixels, drawn / 1.3, drawn, *bytes_read, strict=True)
    return [Demand(*map(float, column)) for column in columns], [
        ("surface", "plane")[i % 2] for i in range(number)
    ]


def flat(height=64, width=128):
    size = height, width
    return Frame(
        irradiance=jnp.ones((*size, 3)), depth=jnp.full(size, 500.0), normal=None, albedo=None,
        profile_id=jnp.ones(size, jnp.int32), motion=None, camera=camera.orthographic(width, height, 0.5),
    )  # fmt: skip


# --- the fit


def test_weights_are_found_again():
    given_demands, techniques = some_demands()
    seconds = [TRUE.seconds(demand, name) for demand, name in zip(given_demands, techniques, strict=True)]
    found = cost_model.fit(given_demands, techniques, seconds)
    assert found.weights == pytest.approx(TRUE.weights, rel=1e-6)
    assert found.techniques == pytest.approx(TRUE.techniques, rel=1e-6)


@given(st.integers(0, 1000), st.floats(0.01, 0.3))
def test_the_fit_is_the_least_relative_error_with_weights_not_negative(seed, noise):
    given_demands, techniques = some_demands(30, seed)
    random = np.random.default_rng(seed)
    seconds = [
        TRUE.seconds(demand, name) * np.exp(noise * random.normal())
        for demand, name in zip(given_demands, techniques, strict=True)
    ]
    found = cost_model.fit(given_demands, techniques, seconds)
    times = np.array([found.seconds(d, name) for d, name in zip(given_demands, techniques, strict=True)])
    # A rival: the same by SciPy's bounded least squares, an interior-point method, in columns of like size.
    columns = [[getattr(d, name) for name in cost_model.SHARED] for d in given_demands]
    of_technique = [
        [d.drawn * (name == one) for one in ("surface", "plane")]
        for d, name in zip(given_demands, techniques, strict=True)
    ]
    table = np.hstack([columns, of_technique]) / np.array(seconds)[:, None]
    rival = lsq_linear(table / table.max(axis=0), np.ones(len(seconds)), (0, np.inf), tol=1e-14)
    assert np.sum(np.square(times / seconds - 1)) <= 2 * rival.cost * (1 + 1e-6)
    assert min(*found.weights.values(), *found.techniques.values()) >= 0


def test_what_no_point_has_costs_nothing():
    found = cost_model.fit([Demand(1, 100, 10, n, n, 0, 0) for n in (10, 20, 40)], ["plane"] * 3, [1, 2, 4])
    assert found.weights["from_memory"] == 0
    with pytest.raises(KeyError):
        found.seconds(Demand(1, 100, 10, 10, 10, 0, 0), "surface")


@pytest.mark.parametrize(
    "demand, techniques, seconds, message",
    [
        ([], [], [], "must be as many and at least one, got 0, 0 and 0"),
        ([Demand(1, 1, 1, 1, 1, 0, 0)], ["plane"], [1.0, 2.0], "got 1, 1 and 2"),
        ([Demand(1, 1, 1, 1, 1, 0, 0)], ["plane"], [0.0], "seconds must be above 0, got 0.0"),
        ([Demand(1, 1, 1, 1, 1, 0, 0)], ["plane"], [np.nan], "seconds must be above 0, got nan"),
    ],
)
def test_what_cannot_be_fitted_is_refused(demand, techniques, seconds, message):
    with pytest.raises(ValueError, match=message):
        cost_model.fit(demand, techniques, seconds)


# --- demands


def test_demands_are_counted_as_by_hand():
    found = demands.of_frame(
        flat(), {1: [0.1] * 3}, np.full((64, 128), 16), Settings(), {1: Fetched(8.0, 2.0)}
    )
    assert found.passes == 1 and found.frame_pixels == found.pixels == 64 * 128
    # Two blocks of 4096 pixels, and as many lanes as are alike.
    assert found.samples == 16 * 64 * 128 and found.drawn >= found.samples
    assert (found.from_second, found.from_memory) == (8 * found.drawn, 2 * found.drawn)
    # Slopes need normals, and lie beside the depth in another word of eight bytes.
    facing = flat()._replace(normal=jnp.zeros((64, 128, 3)).at[..., 2].set(1))
    wide = demands.of_frame(
        facing, {1: [0.1] * 3}, np.full((64, 128), 16), Settings(), {1: Fetched(8.0, 2.0)}
    )
    assert (wide.from_second, wide.from_memory) == (1.5 * 8 * found.drawn, 1.5 * 2 * found.drawn)


def test_pixels_wait_for_the_one_with_the_most_samples():
    counts = np.ones((64, 128), int)
    even = demands.of_frame(flat(), {1: [0.1] * 3}, counts, Settings(), {1: Fetched(0.0, 0.0)})
    counts[::4, ::4] = 64
    uneven = demands.of_frame(flat(), {1: [0.1] * 3}, counts, Settings(), {1: Fetched(0.0, 0.0)})
    assert uneven.samples < 6 * even.samples and uneven.drawn == 64 * even.drawn


def test_passes_add_up():
    frame, d = procedural.frame(width=128, height=72), [1.0, 0.5, 0.2]
    counts, read = np.full((72, 128), 8), {1: Fetched(4.0, 1.0), 2: Fetched(6.0, 1.0)}
    both, ball, board = (
        demands.of_frame(frame, profiles, counts, Settings(distance="plane"), read)
        for profiles in ({1: d, 2: d}, {1: d, 2: None}, {1: None, 2: d})
    )
    assert both == Demand(*(one + other for one, other in zip(ball, board, strict=True)))


def test_bytes_from_beyond_caches_are_those_of_each_line_once(monkeypatch):
    large = cache.Level(2**20, 64, 16), cache.Level(2**23, 64, 16)
    monkeypatch.setattr(machine, "caches", lambda: large)
    # So narrow that each sample hits its own pixel: all is read once, for as many samples as are replayed.
    found = demands.fetched(flat(), 1, [1e-9] * 3)
    each = demands.TEXEL_BYTES / demands.REPLAYED
    assert tuple(found) == pytest.approx((each, each))
    assert demands.fetched(flat(), 7, [1e-9] * 3) == Fetched(0.0, 0.0)


def test_caches_are_those_that_the_system_tells(tmp_path):
    facts = {
        "0": ("1", "Data", "48K", "12"),
        "1": ("1", "Instruction", "32K", "8"),
        "2": ("2", "Unified", "2048K", "16"),
    }
    for index, (level, kind, size, ways) in facts.items():
        folder = tmp_path / f"index{index}"
        folder.mkdir()
        for name, text in (("level", level), ("type", kind), ("size", size), ("ways_of_associativity", ways)):
            (folder / name).write_text(f"{text}\n")
        (folder / "coherency_line_size").write_text("64\n")
    assert machine.caches(tmp_path) == (cache.Level(48 * 1024, 64, 12), cache.Level(2**21, 64, 16))
    (tmp_path / "index2" / "size").write_text("unknown\n")
    assert machine.caches(tmp_path) == machine.USUAL_CACHES


# --- the study


def synthetic_points():
    points = []
    for frame, is_fitted in (("small", True), ("wide", True), ("tall", True), ("other", False)):
        some, techniques = some_demands(12, seed=len(frame) + ord(frame[0]))
        for i, (demand, name) in enumerate(zip(some, techniques, strict=True)):
            points.append(cost.Point(frame, str(i), name, is_fitted, None, demand))
    return points, {point.name: TRUE.seconds(point.demand, point.technique) for point in points}


def test_points_that_are_unseen_do_not_move_the_fit():
    points, seconds = synthetic_points()
    found = cost._finding(points, seconds)
    assert found.facts["largest_error_unseen"] < 1e-6 and found.facts["median_error_frame_left_out"] < 1e-6
    twice = {p.name: seconds[p.name] * (1 if p.is_fitted else 2) for p in points}
    other = cost._finding(points, twice)
    assert other.facts["weights_seconds"] == found.facts["weights_seconds"]
    assert other.facts["largest_error_unseen"] == pytest.approx(0.5)
    assert other.sentences[0].startswith("on the unseen frame off by 50% in the median and 50% at most")
    assert cost.STUDY.picture(other)[1:4] == b"PNG"


def test_a_frame_without_profiles_has_no_cost():
    empty = dataclasses.replace(procedural_setting(is_quick=True), profiles={1: None, 2: None})
    with pytest.raises(CannotMeasure, match="the frame has no pixel with a profile"):
        cost.STUDY.measure(empty, 3, lambda text: None)


@pytest.mark.slow
def test_what_is_measured_tests_the_fit_on_the_setting(monkeypatch):
    monkeypatch.setattr(cost, "_QUICK_SIZES", ((96, 54), (128, 72)))
    monkeypatch.setattr(cost, "_QUICK_TECHNIQUES", ("distance in the plane",))
    setting = dataclasses.replace(
        procedural_setting(True),
        frame=procedural.frame(9, width=160, height=90),
        frame_name="mine",
        is_procedural=False,
    )
    found = cost.STUDY.measure(setting, 3, lambda text: None)
    unseen = [row for row in found.rows if row["used"] == "unseen"]
    assert {row["frame"] for row in unseen} == {"mine, 160 x 90"} and len(unseen) == 2
    assert all(row["samples"] <= row["drawn"] for row in found.rows)
    assert {row["counts"] for row in unseen} == {"adaptive, 12 wanted", "adaptive, 32 wanted"}
    assert found.facts["technique_seconds"]["distance in the plane"] > 0
