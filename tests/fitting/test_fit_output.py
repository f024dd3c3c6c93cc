"""What a fit leaves: JSON without infinities, a table with its errors, a material, constants, a picture."""

import csv
import io
import json
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from sssfit.files.json_text import json_text
from sssfit.fitting import fit_output, fit_plot, fit_table, measured, profile_models
from sssfit.fitting.intervals import Estimate
from sssfit.profiles import burley, materials
from sssfit.tables.formats import shader_constants
from sssfit.tables.formats.shader_dialects import GLSL, HLSL

# One shape for all, so that it is compiled once.
R = np.geomspace(0.2, 12, 16)
NOISE = 1 + 0.02 * np.random.default_rng(2).normal(size=(16, 3))


def curve(albedo, d):
    with jax.enable_x64(True):
        return np.asarray(burley.profile(R[:, None], np.asarray(d, float), np.asarray(albedo, float)))


@pytest.fixture(scope="module")
def three():
    truth = curve([0.7, 0.5, 0.3], [1.5, 1.0, 0.6])
    return measured.fit(R, truth * NOISE, sigma=0.02 * truth)


@pytest.fixture(scope="module")
def one():
    truth = curve([0.6], [1.2])
    return measured.fit(R, truth * NOISE[:, :1], sigma=0.02 * truth)


def rows(data):
    return [{name: float(x) for name, x in row.items()} for row in csv.DictReader(io.StringIO(data.decode()))]


def test_the_summary_holds_all_numbers(three):
    found = json.loads(json_text(fit_output.summary(three)))
    assert set(found) == {
        *("model", "response", "parameters", "correlation", "converged", "chi2_per_dof", "dof", "aicc"),
        *("disagreement", "status", "notes"),
    }
    assert found["model"] == "burley" and found["converged"] is True and found["dof"] == 42
    assert found["correlation"]["names"] == ["albedo_r", "d_r", "albedo_g", "d_g", "albedo_b", "d_b"]
    assert np.shape(found["correlation"]["matrix"]) == (6, 6)
    d, dmfp = found["parameters"]["d_g"], found["parameters"]["dmfp_g"]
    assert d["unit"] == dmfp["unit"] == "mm" and d["determined"] is True
    assert d["derived"] is False and dmfp["derived"] is True
    assert d["interval_95"][0] < d["interval_68"][0] < d["value"] < d["interval_68"][1]
    assert d["value"] == pytest.approx(1, rel=0.05)


def test_what_is_infinite_or_undefined_is_null(one):
    open_ended = Estimate(1.0, np.inf, (0.1, np.inf), (0.0, np.inf), "mm", False)
    fit = replace(one, chi2=np.nan, parameters=one.parameters | {"d": open_ended})
    text = json_text(fit_output.summary(fit))
    found = json.loads(text)
    assert found["chi2_per_dof"] is None and '"inf"' not in text and '"nan"' not in text
    assert found["parameters"]["d"]["interval_95"] == [0.0, None]
    assert found["parameters"]["d"]["standard_error"] is None


def test_the_curve_holds_data_fit_and_what_is_left(three):
    found = rows(fit_output.curve_csv(three))
    assert len(found) == 16
    for i, channel in enumerate("rgb"):
        row = found[3]
        assert row[f"data_{channel}"] == three.values[3, i] and row[f"band_{channel}"] == three.band[3, i]
        assert row[f"residual_{channel}"] == row[f"data_{channel}"] - row[f"fitted_{channel}"]


def test_the_material_is_one_that_tables_take(three, one):
    data, reason = fit_output.materials_csv(three, "2 wax (warm)")
    assert data is not None and reason == ""
    (material,) = materials.parse(data, "materials.csv").values()
    assert material.name == "material_2_wax_warm"
    np.testing.assert_allclose(material.d, [three.parameters[f"d_{c}"].value for c in "rgb"], rtol=1e-12)
    data, _ = fit_output.materials_csv(one, "wax")
    assert data is not None
    grey = materials.parse(data, "materials.csv")["wax"]
    assert len(set(grey.albedo)) == len(set(grey.dmfp)) == 1


@pytest.mark.parametrize("name", ["", "-", "ß", "a" * 80, "wax.", "8", "x_-y"])
def test_any_name_becomes_a_materials(three, name):
    data, _ = fit_output.materials_csv(three, name)
    assert data is not None and len(materials.parse(data, "materials.csv")) == 1


def test_no_material_is_written_of_what_is_none(one):
    bright = Estimate(1.25, 0.1, (1.1, 1.4), (1.0, 1.5), "1", True)
    vague = Estimate(3.0, 9.0, (1.0, 9.0), (0.0, np.inf), "mm", False)
    changes: tuple[tuple[dict[str, Any], str], ...] = (
        ({"parameters": one.parameters | {"albedo": bright}}, "albedo is 1.25, above 1"),
        ({"parameters": one.parameters | {"dmfp": vague}}, "dmfp is not determined"),
        ({"model": "dipole"}, "dipole has no albedo and dmfp of Burley's"),
        ({"channels": ("1", "2")}, "a material has 1 or 3 channels, not 2"),
    )
    for change, words in changes:
        data, reason = fit_output.materials_csv(replace(one, **change), "wax")
        assert data is None and reason == f"there is no materials.csv: {words}"


def test_the_table_is_the_profile_and_its_errors_are_propagated(three):
    found = rows(fit_table.table_csv(three, profile_models.Burley()))
    assert len(found) == 128
    covariance = three.covariance[2:4, 2:4]
    albedo, d = three.parameters["albedo_g"].value, three.parameters["d_g"].value
    with jax.enable_x64(True):
        for row in found[::25]:
            r = row["r_mm"]
            for name, error, function in (
                ("R_g_per_mm_2", "R_g_se_per_mm_2", lambda a, d, r=r: burley.profile(r, d, a)),
                ("cdf_g", "cdf_g_se", lambda a, d, r=r: burley.cdf(r, d)),
                (
                    "transmittance_g",
                    "transmittance_g_se",
                    lambda a, d, r=r: burley.transmittance(jnp.asarray(r), d, a),
                ),
            ):
                assert row[name] == pytest.approx(float(function(albedo, d)), rel=1e-9)
                # By differences, in the albedo and the logarithm of d.
                step = 1e-6
                slope = np.array(
                    [
                        float(function(albedo + step, d) - function(albedo - step, d)) / (2 * step),
                        float(function(albedo, d * (1 + step)) - function(albedo, d * (1 - step)))
                        / (2 * step),
                    ]
                )
                assert row[error] == pytest.approx(float(np.sqrt(slope @ covariance @ slope)), rel=1e-4)
    # Where it begins and ends.
    assert min(found[0][f"cdf_{c}"] for c in "rgb") < 2e-3
    assert all(found[-1][f"cdf_{c}"] > 0.9998 for c in "rgb")


def test_what_the_data_do_not_say_has_no_error_in_the_table(one):
    covariance = np.diag([np.inf, 1e-4])
    fit = replace(one, covariance=covariance)
    row = rows(fit_table.table_csv(fit, profile_models.Burley()))[20]
    assert row["R_se_per_mm_2"] == np.inf and np.isfinite(row["cdf_se"])


def test_shared_parameters_stand_for_every_channel(three):
    names = ("albedo_r", "d", "albedo_g", "albedo_b")
    shared = {name: three.parameters["d_r" if name == "d" else name] for name in names}
    shared |= {f"dmfp_{c}": three.parameters[f"dmfp_{c}"] for c in "rgb"}
    covariance = np.diag([0.0, 1e-4, 0.0, 0.0])
    fit = replace(three, parameters=shared, names=names, covariance=covariance)
    for row in rows(fit_table.table_csv(fit, profile_models.Burley()))[::20]:
        assert row["cdf_r"] == pytest.approx(row["cdf_b"], rel=1e-9)
        assert row["R_r_per_mm_2"] / row["R_b_per_mm_2"] == pytest.approx(
            shared["albedo_r"].value / shared["albedo_b"].value
        )
        assert row["R_r_se_per_mm_2"] / row["R_r_per_mm_2"] == pytest.approx(
            row["R_g_se_per_mm_2"] / row["R_g_per_mm_2"]
        )
    constants = fit_output.constants(fit, profile_models.Burley())
    assert np.ptp(constants["d_mm"]) == 0 and constants["dmfp_mm"].shape == (1, 3)
    assert fit_output.materials_csv(fit, "wax")[0] is not None


def test_constants_of_a_sum_are_arrays(one):
    names = [f"{what}_{i}" for what in ("variance", "weight") for i in (1, 2)]
    both = {
        name: Estimate(i + 1.0, 0.1, (0, 1), (0, 1), "mm^2" if i < 2 else "1", True)
        for i, name in enumerate(names)
    }
    both["albedo"] = Estimate(7.0, 0.1, (0, 1), (0, 1), "1", True)
    fit = replace(one, model="gaussians:2", parameters=both)
    constants = fit_output.constants(fit, profile_models.GaussianSum(2))
    assert {k: v.tolist() for k, v in constants.items()} == {
        "variance_mm_2": [[1], [2]],
        "weight": [[3], [4]],
        "albedo": [[7]],
    }
    text = shader_constants.encode_constants("wax 2", constants, HLSL, ["from wax.csv"]).decode()
    assert text == (
        "// from wax.csv\n#ifndef SSSFIT_PROFILE_wax_2\n#define SSSFIT_PROFILE_wax_2\n\n"
        "static const float wax_2_variance_mm_2[2] = {\n    1.0,\n    2.0\n};\n"
        "static const float wax_2_weight[2] = {\n    3.0,\n    4.0\n};\n"
        "static const float wax_2_albedo = 7.0;\n\n#endif // SSSFIT_PROFILE_wax_2\n"
    )


def test_constants_that_are_no_numbers_are_bits():
    for dialect, line in (
        (GLSL, "float x_dmfp_mm = uintBitsToFloat(0x7fc00000u);"),
        (HLSL, "static const float x_dmfp_mm = asfloat(0x7fc00000u);"),
    ):
        assert (
            line
            in shader_constants.encode_constants("x", {"dmfp_mm": np.array([[np.nan]])}, dialect).decode()
        )


def test_the_picture_is_one_and_always_the_same(three, one):
    for fit in (three, one):
        data = fit_plot.plot(fit, title="wax")
        assert data == fit_plot.plot(fit, title="wax")
        pixels = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
        assert pixels.shape[0] > 400 and 0.01 < np.mean(pixels < 128) < 0.5


def test_pictures_of_lines_have_straight_axes_and_of_many_points_no_bars(one):
    many = np.linspace(-5, 5, 300)
    wide: dict[str, Any] = {name: np.ones((300, 1)) for name in ("values", "fitted", "sigma", "band")}
    fit = replace(one, **wide, r=many, response="line", chi2=np.nan)
    assert fit_plot.plot(fit)[1:4] == b"PNG"
