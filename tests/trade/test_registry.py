"""Every public function is an approximation that a group measures, or stands here with what it is instead."""

import ast
import dataclasses
import importlib
from pathlib import Path

import pytest

from sssfit.trade import registry
from sssfit.trade.choice import CannotMeasure
from sssfit.trade.setting import procedural_setting

PACKAGE = Path(__file__).resolve().parents[2] / "sssfit"
TOPICS = ("profiles", "sampling")
# Exact to rounding, tested against references; or not about numbers at all.
EXACT = {
    "profiles.burley": "closed forms",
    "profiles.dipole": "the model's own formulas, in closed form",
    "profiles.gaussian_sum": "closed forms",
    "profiles.materials": "reads files",
    "profiles.published": "rows of a report",
    "profiles.separable": "closed forms, and kernels that carry the exact mass of each tap",
    "sampling.disk": "geometry",
    "sampling.hashes": "integers",
    "sampling.prefilter": "the level of other scales and its published forms, which no pass uses",
}


def public_functions():
    for topic in TOPICS:
        for path in sorted((PACKAGE / topic).rglob("*.py")):
            if not path.name.startswith("_"):
                module = f"{topic}.{path.stem}"
                for node in ast.parse(path.read_text()).body:
                    if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                        yield module, node.name


def test_every_public_function_is_measured_or_exact():
    measured = {name for group in registry.GROUPS.values() for name in group.stands_for}
    missing = [f"{m}.{n}" for m, n in public_functions() if f"{m}.{n}" not in measured and m not in EXACT]
    assert missing == []


def test_what_groups_stand_for_exists():
    for group in registry.GROUPS.values():
        for name in group.stands_for:
            module, _, function = name.rpartition(".")
            assert callable(getattr(importlib.import_module(f"sssfit.{module}"), function)), name


def test_groups_state_what_they_are():
    for name, group in registry.GROUPS.items():
        assert name == group.name
        assert group.title and group.unit and group.error and group.reference


def test_unknown_groups_are_refused_with_a_list():
    with pytest.raises(ValueError, match=r"--only must name groups among inverse_cdfs, .*, got 'speed'"):
        registry.chosen(["split", "speed"])


def test_a_frame_without_normals_is_no_setting_for_geometry():
    setting = procedural_setting(is_quick=True)
    flat = dataclasses.replace(setting, frame=setting.frame._replace(normal=None))
    with pytest.raises(CannotMeasure, match="the frame has no normals"):
        registry.GROUPS["estimators"].prepare(flat)


@pytest.mark.parametrize("name", ["inverse_cdfs", "radius_tables", "precision", "histories"])
def test_choices_have_names_of_their_own_and_one_default(name):
    task = registry.GROUPS[name].prepare(procedural_setting(is_quick=True))
    names = [choice.name for choice in task.choices]
    assert len(set(names)) == len(names) > 2
    assert sum(choice.is_default for choice in task.choices) == 1


@pytest.mark.parametrize("name", ["counts", "split", "sequences"])
def test_a_frame_without_profiles_cannot_be_measured(name):
    empty = dataclasses.replace(procedural_setting(is_quick=True), profiles={1: None, 2: None})
    with pytest.raises(CannotMeasure, match="the frame has no pixel with a profile"):
        registry.GROUPS[name].prepare(empty)


@pytest.mark.parametrize("name", ["counts", "sequences", "importance", "channels", "estimators", "prefilter"])
def test_what_is_the_default_stands_in_each_group_of_frames(name):
    task = registry.GROUPS[name].prepare(procedural_setting(is_quick=True))
    (default,) = (choice for choice in task.choices if choice.is_default)
    assert default.samples == 64


@pytest.mark.slow
def test_samples_are_measured_against_the_convolution():
    fft, few, more, many = registry.GROUPS["convolution"].prepare(procedural_setting(is_quick=True)).choices
    assert fft.error().value == 0
    found = [each.error().value for each in (few, more, many)]
    # Evenly spread points: at least as the root of the number, which is four times as large each.
    assert found[0] > 1.9 * found[1] > 1.9 * 1.9 * found[2] > 0
