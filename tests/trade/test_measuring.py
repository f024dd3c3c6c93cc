"""Choices side by side: timing in turns, fronts, what is written, and what an interruption leaves."""

import csv
import dataclasses
import io
import itertools
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files.errors import FileError
from sssfit.trade import machine, measure, page, picture, report, setting, timing, writing
from sssfit.trade.choice import CannotMeasure, Choice, Cost, Error, Group, Task
from sssfit.trade.measure import Row
from sssfit.trade.pareto import beaten_by
from sssfit.trade.report import Measured, Studied
from sssfit.trade.setting import procedural_setting
from sssfit.trade.study import Finding, Study

SETTING = procedural_setting(is_quick=True)


def row(name, nanoseconds=1.0, error=1.0, time_noise=0.02, error_noise=0.0, **more):
    rest = {"samples": 0.0, "bytes_moved": 8.0, "peak_bytes": math.nan, "compile_seconds": 0.5}
    return Row("sums", name, {"n": 1}, False, error, error_noise, nanoseconds, time_noise, **(rest | more))


def choice(name, work=100, error=0.5):
    return Choice(name, {"work": work}, run=lambda: sum(range(work)), error=lambda: Error(error, 0.01))


def group(*choices, cost: Cost = "time"):
    def prepare(setting):
        if not choices:
            raise CannotMeasure("the frame has no normals")
        return Task(10, choices)

    return Group("sums", "Ways to add", "number", "error", "a sum", prepare, cost=cost)


# --- timing


def test_programs_take_turns_after_one_run_each():
    calls = []
    programs = {name: lambda name=name: calls.append(name) for name in "abc"}
    times = timing.measure(programs, rounds=4, pause=0.0)
    assert calls[:3] == ["a", "b", "c"]
    rounds = ["".join(calls[start : start + 3]) for start in range(0, 15, 3)]
    assert all(sorted(each) == ["a", "b", "c"] for each in rounds) and len(set(rounds)) > 2
    assert {name: values.shape for name, values in times.items()} == dict.fromkeys("abc", (4,))


@pytest.mark.parametrize("rounds, least", [(6, 0.96), (9, 0.95), (25, 0.95)])
def test_intervals_of_medians_hold_the_median_of_any_distribution(rounds, least):
    trials = 4000
    times = np.exp(np.random.default_rng(1).normal(size=(trials, rounds)))
    ends = [timing.median_and_interval(one) for one in times]
    held = np.mean([low <= 1 <= high for low, _, high in ends])
    # Four standard errors of that share.
    assert held > least - 4 * math.sqrt(least * (1 - least) / trials)
    assert np.mean([middle for _, middle, _ in ends]) == pytest.approx(1, abs=0.2)


def test_few_times_have_their_range():
    assert timing.median_and_interval(np.array([3.0, 1.0, 2.0])) == (1.0, 2.0, 3.0)


def test_memory_is_that_of_the_run():
    found = machine.peak_of(lambda: bytearray(80_000_000))
    assert math.isnan(found) or 7e7 < found < 2e8


# --- measuring


@pytest.mark.parametrize("is_quick", [True, False])
def test_a_group_is_measured_choice_by_choice(is_quick):
    told, on = [], dataclasses.replace(SETTING, is_quick=is_quick)
    rows = measure.group(group(choice("few"), choice("many", 10_000)), on, 3, told.append).rows
    assert [each.choice for each in rows] == ["few", "many"]
    assert rows[1].nanoseconds > 5 * rows[0].nanoseconds > 0
    assert rows[0].error == 0.5 and rows[0].error_noise == 0.01 and rows[0].knobs == {"work": 100}
    assert all(math.isnan(each.compile_seconds) == is_quick for each in rows)
    assert told[0] == "sums: preparing" and told[-1] == "sums: times, 3 rounds"
    assert ("sums: many, its error" in told) == (not is_quick)


def test_too_few_rounds_are_refused():
    with pytest.raises(ValueError, match="rounds must be at least 3, got 2"):
        measure.group(group(choice("one")), SETTING, 2)


def test_calls_on_threads_have_the_callers_precision():
    with jax.enable_x64(True):
        found = measure.side_by_side([lambda: jnp.ones(1, float).dtype] * 2)
    assert found == [np.float64] * 2 and measure.side_by_side([lambda: jnp.ones(1, float).dtype]) == [
        np.float32
    ]


# --- fronts

numbers = st.floats(0.1, 10)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=12))
def test_the_front_is_never_empty_and_beats_the_rest(pairs):
    rows = [row(str(i), *pair, time_noise=0.0) for i, pair in enumerate(pairs)]
    beaten = {each.choice: beaten_by(each, rows, group()) for each in rows}
    assert "" in beaten.values()
    for each in rows:
        better = next((other for other in rows if other.choice == beaten[each.choice]), None)
        if better is not None:
            assert better.nanoseconds <= each.nanoseconds and better.error <= 1.1 * each.error


@given(st.lists(st.tuples(numbers, numbers), min_size=2, max_size=6), st.floats(0.5, 2.0))
def test_fronts_do_not_depend_on_units(pairs, unit):
    rows = [row(str(i), *pair) for i, pair in enumerate(pairs)]
    scaled = [row(str(i), unit * t, unit * e) for i, (t, e) in enumerate(pairs)]
    for one, other in zip(rows, scaled, strict=True):
        assert (beaten_by(one, rows, group()) == "") == (beaten_by(other, scaled, group()) == "")


def test_noise_alone_beats_nothing():
    rows = [row("a", 1.0, 1.0, error_noise=0.2), row("b", 1.01, 1.3, error_noise=0.2)]
    assert [beaten_by(each, rows, group()) for each in rows] == ["", ""]


def test_samples_can_be_what_is_paid():
    rows = [row("a", 1.0, 1.0, samples=64.0), row("b", 9.0, 1.0, samples=16.0)]
    assert [beaten_by(each, rows, group(cost="samples")) for each in rows] == ["b", ""]
    assert [beaten_by(each, rows, group()) for each in rows] == ["", "a"]


# --- reports

FINDING = Finding(("it costs 2.5 ms",), ({"ms": 2.5, "frame": "a & b"},), {"seconds": 0.0025})

FOUND = [
    Measured(group(), (row("a", 2.0, 3.0), row("b", 1.0, 1.0))),
    Measured(
        Group("split", "Split", "pixel", "e", "r", lambda setting: Task(1, ())),
        (),
        "the frame has no normals",
    ),
]


def study(finding: Finding | None = FINDING, name="sums_cost"):
    def answer(setting, rounds, tell):
        if finding is None:
            raise CannotMeasure("the frame has no normals")
        tell("measuring")
        return finding

    return Study(name, "What sums cost", "By adding", answer, lambda finding: b"PNG")


STUDIED = [Studied(study(), FINDING), Studied(study(None, "needs"), None, "the frame has no normals")]


def test_tables_hold_every_number():
    lines = list(csv.DictReader(io.StringIO(report.as_csv(FOUND).decode())))
    assert [line["choice"] for line in lines] == ["a", "b"]
    assert float(lines[0]["error"]) == 3.0 and lines[0]["peak_bytes"] == "" and lines[0]["beaten_by"] == "b"
    found = report.as_json(FOUND, STUDIED, {"rounds": 5})
    assert found["groups"]["sums"]["choices"][0]["peak_bytes"] is None
    assert found["groups"]["split"]["skipped"] == "the frame has no normals"
    assert found["studies"]["sums_cost"]["rows"] == ({"frame": "a & b", "ms": 2.5},)
    assert found["studies"]["needs"]["skipped"] == "the frame has no normals"
    json.dumps(found, allow_nan=False)
    assert report.rows_as_csv(FINDING.rows) == b"ms,frame\n2.5,a & b\n"


def test_a_page_needs_nothing_else():
    pictures = {"sums": picture.front(FOUND[0].group, FOUND[0].rows), "sums_cost": b"PNG"}
    text = page.as_html(FOUND, STUDIED, pictures, {"processor": "one & two"}).decode()
    assert 'src="data:image/png;base64,' in text and "http" not in text.replace("http-equiv", "")
    assert text.count("Not measured: the frame has no normals.") == 2 and "one &amp; two" in text
    assert "<td>2.5</td><td>a &amp; b</td>" in text and "<li>it costs 2.5 ms</li>" in text
    assert "From one group to another" not in text
    paced = [dataclasses.replace(FOUND[0], pace=pace) for pace in (1.0, 1.1)]
    assert "From one group to another" in page.as_html(paced, [], pictures, {}).decode()


def test_the_pace_is_how_much_groups_differ():
    random = np.random.default_rng(0)
    paces = np.exp(0.1 * random.normal(size=(2000, 6)))
    found = np.array([measure.pace_noise(some) for some in paces])
    # What is as random as the paces, from a mean that is known: four standard errors.
    after = np.exp(0.1 * random.normal(size=2000))
    held = np.mean(np.abs(np.log(after)) < found)
    assert abs(held - 0.95) < 4 * math.sqrt(0.95 * 0.05 / 2000)
    assert math.isnan(measure.pace_noise([1.0]))


def test_memory_that_an_allocator_keeps_is_counted_again():
    # 16 MB in pieces that the C library keeps for later once they are given back.
    found = [machine.peak_of(lambda: [np.ones(10_000) for _ in range(200)]) for _ in range(4)]
    assert math.isnan(found[0]) or min(found) > 1.55e7


# --- what is kept


def test_what_is_measured_is_kept_and_gone_on_with(tmp_path):
    conditions = writing.conditions(SETTING, 3)
    ledger = writing.Ledger(tmp_path, conditions, resume=False)
    first = ledger.measured(group(choice("one")), SETTING, 3, lambda text: None)
    skipped = Group("split", "", "pixel", "", "", group().prepare)
    assert ledger.measured(skipped, SETTING, 3, lambda text: None).skipped == "the frame has no normals"
    again = writing.Ledger(tmp_path, conditions, resume=True)

    def fail(setting):
        raise AssertionError("it is there")

    kept = again.measured(Group("sums", "", "number", "", "", fail), SETTING, 3, lambda text: None)
    assert kept.rows[0].nanoseconds == first.rows[0].nanoseconds and kept.rows[0].knobs == {"work": 100}


def test_studies_are_kept_and_gone_on_with(tmp_path):
    conditions = writing.conditions(SETTING, 3)
    ledger = writing.Ledger(tmp_path, conditions, resume=False)
    found = ledger.studied(study(), SETTING, 3, lambda text: None)
    skipped = ledger.studied(study(None, "needs"), SETTING, 3, lambda text: None)
    assert (found.finding, skipped.finding, skipped.skipped) == (FINDING, None, "the frame has no normals")
    again = writing.Ledger(tmp_path, conditions, resume=True)

    def fail(*arguments):
        raise AssertionError("it is there")

    kept = dataclasses.replace(study(), measure=fail)
    assert report.as_json([], [again.studied(kept, SETTING, 3, fail)], {}) == report.as_json([], [found], {})
    assert page.as_html([], [again.studied(kept, SETTING, 3, fail)], {"sums_cost": b""}, {}) == page.as_html(
        [], [found], {"sums_cost": b""}, {}
    )
    none = dataclasses.replace(study(None, "needs"), measure=fail)
    assert again.studied(none, SETTING, 3, fail).skipped == "the frame has no normals"


def test_a_new_run_takes_up_nothing_of_an_earlier_one(tmp_path):
    conditions = writing.conditions(SETTING, 3)
    kept = tmp_path / "measured" / "split.json"
    split = Group("split", "", "number", "", "", group(choice("one")).prepare)
    writing.Ledger(tmp_path, conditions, resume=False).measured(split, SETTING, 3, lambda text: None)
    assert kept.exists()
    writing.Ledger(tmp_path, conditions, resume=True)
    assert kept.exists()
    writing.Ledger(tmp_path, conditions, resume=False)
    assert not kept.exists()


def test_other_frames_and_profiles_are_other_conditions():
    wider = dataclasses.replace(SETTING, profiles={1: 2 * setting.skin(), 2: None})
    brighter = dataclasses.replace(
        SETTING, frame=SETTING.frame._replace(irradiance=2 * SETTING.frame.irradiance)
    )
    found = [writing.conditions(one, 3) for one in (SETTING, wider, brighter)]
    assert found[0] == writing.conditions(procedural_setting(is_quick=True), 3)
    assert all(a != b for a, b in itertools.combinations(found, 2))


def test_other_conditions_are_refused(tmp_path):
    ledger = writing.Ledger(tmp_path, {"rounds": 3}, resume=False)
    ledger.measured(group(choice("one")), SETTING, 3, lambda text: None)
    with pytest.raises(FileError, match="was measured under other conditions"):
        other = writing.Ledger(tmp_path, {"rounds": 4}, resume=True)
        other.measured(group(choice("one")), SETTING, 4, lambda text: None)
