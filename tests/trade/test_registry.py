"""Every public function is an approximation that a group measures, or stands here with what it is instead."""

import ast
import dataclasses
import importlib
from pathlib import Path

import numpy as np
import pytest

from sssfit.trade import registry
from sssfit.trade.choice import CannotMeasure
from sssfit.trade.groups import convolution
from sssfit.trade.setting import procedural_setting

PACKAGE = Path(__file__).resolve().parents[2] / "sssfit"
TOPICS = ("profiles", "sampling", "estimators", "fitting", "scenarios", "frames", "tables")
# Exact to rounding or to a quadrature's digits, tested against references; or not about numbers at all.
# A module stands for those of its functions that no group measures.
EXACT = {
    "profiles.burley": "closed forms",
    "profiles.dipole": "the model's own formulas, in closed form",
    "profiles.gaussian_sum": "closed forms",
    "profiles.materials": "reads files",
    "profiles.published": "rows of a report",
    "profiles.separable": "closed forms and their quadrature, to 1e-10",
    "sampling.disk": "geometry",
    "sampling.hashes": "integers",
    "sampling.prefilter": "the level of other scales and its published forms, which no pass uses",
    "estimators.bias": "exact moments, and the enumeration of every outcome",
    "estimators.control_variate.coefficient": "a quotient; `step` has it, too",
    "estimators.control_variate.pack": "the same numbers in another order",
    "estimators.control_variate.unpack": "the same numbers in another order",
    "estimators.conventions": "the same moments and weights in other packages' terms",
    "estimators.moving.ema": "the recursion of `emv` without its variance",
    "estimators.moving.emc": "the recursion of `emv` with another product",
    "estimators.moving.emcm": "the recursion of `emv` with more products",
    "estimators.moving.ewma_covariance": "the recursion of `emv` with products one step late",
    "estimators.published": "rows of a report",
    "estimators.stability": "measures the moments' rounding",
    "fitting.falloff_sensitivity": "derivatives of an optimum, exact to rounding",
    "fitting.fit_output": "writes files",
    "fitting.fit_plot": "pictures",
    "fitting.fit_table": "writes files",
    "fitting.inverse_cdf": "optima and integrals by quadrature in float64",
    "fitting.inverse_cdf_approximation": "optimal coefficients of what the group inverse_cdfs measures",
    "fitting.measurement": "reads files",
    "fitting.measurement_image": "reads images, and averages them with their standard errors",
    "fitting.non_negative": "the optimum, to rounding",
    "fitting.profile_models": "names",
    "fitting.published": "rows of a report",
    "fitting.quadrature": "nodes, exact for polynomials",
    "fitting.responses": "integrals by quadrature, to 1e-9 but next to a line of light",
    "fitting.sensitivity": "derivatives of an optimum, exact to rounding",
    "fitting.separable_to_burley.fit": "an optimum, to 1e-7",
    "scenarios.batch_mean": "simulates, with standard errors",
    "scenarios.circle": "worlds with exact answers",
    "scenarios.driver": "simulates what the group controllers measures",
    "scenarios.light": "formulas, and reads files",
    "scenarios.line": "worlds with exact answers",
    "scenarios.measure": "statistics of simulations, with standard errors",
    "scenarios.plot": "pictures",
    "scenarios.published": "rows of a report",
    "scenarios.writing": "writes files",
    "frames.camera": "geometry, and reads files",
    "frames.compare": "sums in float64, with standard errors",
    "frames.compose": "products",
    "frames.gbuffer": "reads and writes files, in half precision where that is asked for",
    "frames.pixel_kernel": "integrals by quadrature, to 1e-13",
    "frames.procedural": "closed forms",
    "frames.reference": "reads files",
    "frames.render": "passes in a row, each of which a group measures",
    "frames.render_output": "writes files",
    "frames.scene_profiles": "reads files",
    "frames.sequence": "passes in a row, each of which a group measures",
    "frames.sequence_files": "names of files",
    "frames.sequence_ledger": "reads and writes files",
    "frames.sequence_output": "writes files",
    "frames.taa.jitter": "Halton's points",
    "frames.temporal.check_tolerance": "refuses what is out of its domain",
    "frames.temporal.off_screen": "geometry",
    "tables.collection": "which tables there are",
    "tables.curvature.evaluate": "the integral itself, to 1e-6: what its table is measured against",
    "tables.falloff.evaluate": "the fit itself: what its table is measured against",
    "tables.formats": "a table as text or chunks of bytes, and their faults",
    "tables.formats.csv": "writes and reads files of what `encoded` has rounded",
    "tables.formats.dds": "writes and reads files of what `encoded` has rounded",
    "tables.formats.encoded": "says what was rounded, and by how much",
    "tables.formats.exr": "writes and reads files of what `encoded` has rounded",
    "tables.formats.images": "the same numbers in another order",
    "tables.formats.metadata": "text and digests",
    "tables.formats.naming": "text",
    "tables.formats.npz": "writes and reads files of what `encoded` has rounded",
    "tables.formats.preview": "writes and reads files of what `encoded` has rounded",
    "tables.formats.shader": "writes and reads files of what `encoded` has rounded",
    "tables.formats.shader_constants": "text",
    "tables.formats.shader_lookup": "text",
    "tables.lookup_error": "measures tables",
    "tables.materials": "parameters as they are",
    "tables.plot": "pictures",
    "tables.published": "rows of a report",
    "tables.radius.evaluate": "the inverse cdf itself: what its table is measured against",
    "tables.reading": "reads files",
    "tables.report": "writes files",
    "tables.shadow.evaluate": "the closed form itself: what its table is measured against",
    "tables.transmittance.evaluate": "the closed form itself: what its table is measured against",
    "tables.writing": "writes files",
}
# Approximations that are not measured side by side, for there is nothing to choose, or no time to save by it.
# What is known of their error is said where they are.
ALONE = {
    "profiles.burley.scaling": "Burley's own three fits: another profile for each",
    "profiles.dipole.fresnel_diffuse_reflectance": "the model's polynomial, within 1.1e-3 of the integral",
    "estimators.count_prediction": "formulas of small deviations; docs/moving_moments.md has their error",
    "fitting.identifiability": "standard errors of a linear model; docs/fits.md has how often they cover",
    "fitting.intervals": "intervals of a linear model or of the likelihood; docs/fits.md",
    "fitting.measured": "parameters with such intervals",
    "fitting.measured_many": "parameters with such intervals",
    "fitting.model_choice": "a criterion of many points",
    "fitting.posterior": "walkers, with how far they have converged",
    "fitting.solve": "three solvers of one problem, to a tolerance; docs/fits.md has their times",
    "scenarios.tune": "a random search; what it finds is measured anew",
    "frames.exact.visible": "what others are measured against, within 1e-3 of a convolution",
    "frames.preview": "eight bits, to look at",
    "frames.scatter.whole_segments": "counts that are not each pixel's own; docs/sequences.md has their gain",
    "frames.surface": "tangent planes at no less than a least cosine, in samples and sums alike",
    "frames.temporal.disoccluded": "a test of depths, which may be wrong, at one cost",
}


def public_functions():
    for topic in TOPICS:
        for path in sorted((PACKAGE / topic).rglob("*.py")):
            if not path.name.startswith("_") or path.name == "__init__.py":
                parts = path.relative_to(PACKAGE).with_suffix("").parts
                module = ".".join(parts).removesuffix(".__init__")
                for node in ast.parse(path.read_text()).body:
                    if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                        yield module, f"{module}.{node.name}"


def measured():
    return {name for group in registry.GROUPS.values() for name in group.stands_for}


def test_every_public_function_is_measured_or_said_to_be_what_it_is():
    known = measured() | EXACT.keys() | ALONE.keys()
    assert [name for module, name in public_functions() if not {name, module} & known] == []


def test_nothing_is_said_of_functions_that_are_measured_or_are_not_there():
    told = EXACT.keys() | ALONE.keys()
    assert not EXACT.keys() & ALONE.keys()
    names = [name for names in public_functions() for name in names]
    assert told <= set(names)
    assert not told & measured()


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
    with pytest.raises(
        ValueError, match=r"--only must name groups or studies among inverse_cdfs, .*, got 'speed'"
    ):
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


def test_what_is_dark_cannot_be_measured():
    setting = procedural_setting(is_quick=True)
    black = setting.frame._replace(irradiance=0 * setting.frame.irradiance)
    dark = dataclasses.replace(setting, frame=black, exact=np.zeros((180, 320, 3)))
    for prepare in (registry.GROUPS["counts"].prepare, registry.GROUPS["split"].prepare):
        with pytest.raises(CannotMeasure, match="no pixel with a profile has light"):
            prepare(dark)
    with pytest.raises(CannotMeasure, match="no pixel with a profile has light"):
        registry.STUDIES["cost_model"].measure(dark, 3, lambda text: None)
    with pytest.raises(CannotMeasure, match="no profile of the frame has light"):
        registry.STUDIES["scene_needs"].measure(dark, 3, lambda text: None)


@pytest.mark.parametrize("name", ["counts", "sequences", "importance", "channels", "estimators", "prefilter"])
def test_what_is_the_default_stands_in_each_group_of_frames(name):
    task = registry.GROUPS[name].prepare(procedural_setting(is_quick=True))
    (default,) = (choice for choice in task.choices if choice.is_default)
    assert default.samples == 64


@pytest.mark.slow
def test_samples_are_measured_against_the_convolution(monkeypatch):
    monkeypatch.setattr(convolution, "_QUICK_SAMPLES", convolution._SAMPLES)
    fft, few, more, many = registry.GROUPS["convolution"].prepare(procedural_setting(is_quick=True)).choices
    assert fft.error().value == 0
    found = [each.error().value for each in (few, more, many)]
    # Evenly spread points: at least as the root of the number, which is four times as large each.
    assert found[0] > 1.9 * found[1] > 1.9 * 1.9 * found[2] > 0
