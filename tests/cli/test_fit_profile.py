"""`sssfit fit profile`: what it prints and writes, from curves and from images, and its exit codes."""

import csv
import dataclasses
import json
import shlex
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest

from sssfit.cli import fit_profile
from sssfit.cli.main import main
from sssfit.files.exr import encode_exr
from sssfit.files.json_text import sha256_bytes
from sssfit.fitting import measured, profile_models, responses
from sssfit.profiles import burley, materials

ROOT = Path(__file__).resolve().parents[2]
# One shape for most tests, so that it is compiled once.
R = np.geomspace(0.2, 12, 16)
ALBEDO, D = 0.7, 1.5


def curve(r=R, noise=0.02, seed=2):
    """Values and sigma."""
    with jax.enable_x64(True):
        truth = np.asarray(burley.profile(r, D, ALBEDO))
    return truth * (1 + noise * np.random.default_rng(seed).normal(size=len(r))), noise * truth


def written(path, values, sigma=None, r=R):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["r_mm", "R", *([] if sigma is None else ["sigma"])])
        writer.writerows(zip(r, values, *([] if sigma is None else [sigma]), strict=True))
    return path


@pytest.fixture
def wax(tmp_path):
    return written(tmp_path / "wax.csv", *curve())


def contents(directory):
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


def test_everything_is_written_and_listed(wax, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["fit", "profile", str(wax), "--out", str(out)]) == 0
    printed = capsys.readouterr()
    assert printed.err == "" and "optimistix: converged: see" in printed.out
    for word in ("burley", "albedo", "dmfp", "68 %", "95 %", "mm"):
        assert word in printed.out
    files = contents(out)
    assert set(files) == {
        *("fit.json", "curve.csv", "fit.png", "table.csv", "materials.csv", "profile.hlsl", "profile.glsl"),
        "manifest.json",
    }
    manifest = json.loads(files["manifest.json"])
    assert {name: entry["sha256"] for name, entry in manifest["files"].items()} == {
        name: sha256_bytes(content) for name, content in files.items() if name != "manifest.json"
    }
    assert manifest["options"]["data"] == "wax.csv" and manifest["options"]["model"] == ["burley"]
    assert manifest["options"]["data_sha256"] == sha256_bytes(wax.read_bytes())
    found = json.loads(files["fit.json"])
    for name, truth in (("albedo", ALBEDO), ("d", D)):
        low, high = found["parameters"][name]["interval_95"]
        assert low < truth < high and high / low < 1.1
    assert "compared" not in found and "posterior" not in found
    assert b"const float wax_d_mm = 1." in files["profile.glsl"]
    assert (
        materials.parse(files["materials.csv"], "m")["wax"].albedo[0]
        == found["parameters"]["albedo"]["value"]
    )


def test_the_same_input_gives_the_same_bytes(wax, tmp_path):
    for name in ("one", "two"):
        assert main(["fit", "profile", str(wax), "--out", str(tmp_path / name), "--quiet"]) == 0
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_as_json_and_quiet(wax, tmp_path, capsys):
    arguments = ["fit", "profile", str(wax), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--json"]) == 0
    printed = capsys.readouterr().out
    assert printed == (tmp_path / "out" / "fit.json").read_text()
    assert main([*arguments, "--quiet"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["albedo", "d", "dmfp"]
    assert float(lines[1].split()[1]) == pytest.approx(
        json.loads(printed)["parameters"]["d"]["value"], rel=1e-4
    )


def test_several_models_are_compared_and_the_best_is_written(wax, tmp_path, capsys):
    out = tmp_path / "out"
    # A point that Burley's profile leaves out is left out for all.
    text = wax.read_text().splitlines()
    wax.write_text("\n".join([text[0], "0,9,1", *text[1:]]))
    assert main(["fit", "profile", str(wax), "--model", "gaussians:1", "burley", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    found = json.loads((out / "fit.json").read_text())
    assert found["model"] == "burley"
    assert [each["model"] for each in found["compared"]] == ["burley", "gaussians:1"]
    assert found["compared"][0]["aicc"] < found["compared"][1]["aicc"]
    assert found["compared"][0]["aicc"] == found["aicc"] and found["compared"][0]["parameters"] == 2
    assert "burley: AICc " in printed and "gaussians:1: AICc " in printed and "2 parameters" in printed
    # Fitted to the same points.
    assert found["dof"] == 14 and "point at r = 0" in printed


def test_notes_are_printed_and_stay(tmp_path, capsys):
    values, sigma = curve()
    wax = written(tmp_path / "bright.csv", 2 * values, 2 * sigma)
    out = tmp_path / "out"
    assert main(["fit", "profile", str(wax), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    (note,) = json.loads((out / "fit.json").read_text())["notes"]
    assert note.startswith("there is no materials.csv: albedo is 1.") and f"note: {note[:40]}" in printed
    assert not (out / "materials.csv").exists()
    assert "not defined" in printed


def test_a_fit_that_does_not_converge_says_so(wax, tmp_path, monkeypatch, capsys):
    fit = measured.fit

    def unfinished(*arguments, **options):
        found = fit(*arguments, **options)
        return dataclasses.replace(found, converged=False, status="optimistix: gave up")

    monkeypatch.setattr(measured, "fit", unfinished)
    assert main(["fit", "profile", str(wax), "--out", str(tmp_path / "out")]) == 1
    assert "optimistix: gave up" in capsys.readouterr().out
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["converged"] is False


def test_options_reach_the_fit(wax, tmp_path, monkeypatch):
    asked = {}
    fit = measured.fit

    def asking(r, values, **options):
        asked.update(options)
        return fit(r, values, sigma=options["sigma"])

    monkeypatch.setattr(measured, "fit", asking)
    arguments = ["--loss", "cauchy", "--weights", "relative", "--cutoff", "16", "--solver", "all"]
    assert main(["fit", "profile", str(wax), "--out", str(tmp_path / "out"), *arguments]) == 0
    assert {name: asked[name] for name in ("loss", "weights", "cutoff", "solver", "model")} == {
        "loss": "cauchy", "weights": "relative", "cutoff": 16.0, "solver": "all", "model": "burley",
    }  # fmt: skip
    assert asked["shared"] == [] and asked["channels"] == ("",) and "eta" not in asked


def edge_image(path, height=20, width=16):
    """An edge whose light is on the right, with noise, in a layer."""
    x = (np.arange(width) + 0.5 - width / 2) * 0.5
    with jax.enable_x64(True):
        shown = np.asarray(responses.edge(profile_models.Burley(), jax.numpy.array([ALBEDO, D]), -x))
    pixels = 3 * (shown + 0.01 * np.random.default_rng(1).normal(size=(height, width)))
    channels = {f"sss.{c}": pixels.astype(np.float32) for c in "RGB"}
    path.write_bytes(encode_exr(channels | {"Y": np.ones((height, width), np.float32)}, {}))
    return path


EDGE = ["--response", "edge", "--layer", "sss", "--pixel-mm", "0.5", "--irradiance", "3", "--flip"]


def test_an_image_is_averaged_to_what_is_fitted(tmp_path, monkeypatch):
    asked = {}
    fit = measured.fit

    def asking(r, values, **options):
        asked.update(options | {"r": r, "values": values})
        return fit(R, curve()[0], sigma=curve()[1])

    monkeypatch.setattr(measured, "fit", asking)
    image = edge_image(tmp_path / "edge.exr")
    assert main(["fit", "profile", str(image), "--out", str(tmp_path / "out"), *EDGE]) == 0
    assert asked["response"] == "edge" and asked["channels"] == ("r", "g", "b")
    np.testing.assert_allclose(asked["r"], np.arange(-3.75, 4, 0.5))
    assert np.all(np.diff(asked["values"], axis=0) < 0) and asked["values"][0, 0] < ALBEDO
    np.testing.assert_allclose(asked["sigma"], 0.01 / np.sqrt(20), rtol=0.2)


@pytest.mark.slow
def test_an_image_of_an_edge(tmp_path, capsys):
    image, out = edge_image(tmp_path / "edge.exr"), tmp_path / "out"
    assert main(["fit", "profile", str(image), "--out", str(out), *EDGE]) == 0
    found = json.loads((out / "fit.json").read_text())
    assert found["response"] == "edge" and set(found["parameters"]) >= {"albedo_r", "d_g", "dmfp_b"}
    d = found["parameters"]["d_r"]
    assert abs(d["value"] - D) < 4 * d["standard_error"] < 0.5
    assert "albedo_b" in capsys.readouterr().out


@pytest.fixture(scope="module")
def sampled(tmp_path_factory):
    pytest.importorskip("emcee")
    folder = tmp_path_factory.mktemp("posterior")
    data = written(folder / "wax.csv", *curve())
    arguments = ["fit", "profile", str(data), "--posterior", "--walkers", "8", "--out", str(folder / "out")]
    assert main([*arguments, "--steps", "200", "--quiet"]) == 1
    unfinished = contents(folder / "out")
    assert main([*arguments, "--steps", "2500", "--resume", "--quiet"]) == 0
    return folder, arguments, unfinished


def test_a_chain_that_is_too_short_is_kept_and_goes_on(sampled):
    folder, arguments, unfinished = sampled
    assert {"fit.json", "chain.h5"} <= set(unfinished) and "corner.png" not in unfinished
    assert "posterior" not in json.loads(unfinished["fit.json"])
    shutil.copytree(folder / "out", folder / "one")
    # In one go: the same bytes, but for the file of the chain.
    assert main([*arguments[:-1], str(folder / "two"), "--steps", "2500", "--quiet"]) == 0
    one, two = contents(folder / "one"), contents(folder / "two")
    assert one.pop("chain.h5")[:4] == two.pop("chain.h5")[:4] == b"\x89HDF"
    assert one == two


def test_a_posterior_is_written(sampled):
    files = contents(sampled[0] / "out")
    found = json.loads(files["fit.json"])
    drawn, fitted = found["posterior"], found["parameters"]
    assert drawn["walkers"] == 8 and drawn["steps"] == 2500 and drawn["seed"] == 0
    for name in ("albedo", "d", "dmfp"):
        low, high = drawn["parameters"][name]["interval_95"]
        assert low < fitted[name]["value"] < high
        assert drawn["parameters"][name]["standard_deviation"] == pytest.approx(
            fitted[name]["standard_error"], rel=0.3
        )
    assert files["corner.png"][1:4] == b"PNG"
    manifest = json.loads(files["manifest.json"])
    assert "corner.png" in manifest["files"] and "chain.h5" not in manifest["files"]


def test_too_few_steps_are_one_sentence(sampled, capsys):
    folder, arguments, _ = sampled
    assert main([*arguments[:-1], str(folder / "short"), "--steps", "100"]) == 1
    printed = capsys.readouterr()
    assert printed.err.startswith("sssfit: 100 steps are too few") and printed.err.count("\n") == 1
    assert printed.err.endswith("raise --steps and give --resume\n") and "albedo" in printed.out


def test_an_earlier_chain_is_not_overwritten(sampled, capsys):
    folder, arguments, _ = sampled
    before = contents(folder / "out")
    assert main([*arguments, "--steps", "2500"]) == 2
    assert "chain.h5" in capsys.readouterr().err and contents(folder / "out") == before


def test_help_shows_examples(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["fit", "profile", "--help"])
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    assert fit_profile._EXAMPLE in printed and "r_mm" in printed


def test_the_shipped_measurement_is_what_its_origin_says():
    lines = (ROOT / "data" / "profile.csv").read_text().splitlines()
    assert lines[0] == "r_mm,R_r,R_g,R_b,sigma_r,sigma_g,sigma_b" and len(lines) == 49
    first = [float(word) for word in lines[1].split(",")]
    with jax.enable_x64(True):
        truth = np.asarray(burley.profile(0.1, np.array([1.5, 1.0, 0.6]), np.array([0.7, 0.55, 0.4])))
    np.testing.assert_allclose(first[4:], 0.03 * truth, rtol=1e-4)
    np.testing.assert_allclose(first[1:4], truth, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("example", fit_profile._EXAMPLE.splitlines()[1:])
def test_the_examples_run_as_printed(example, tmp_path, monkeypatch):
    pytest.importorskip("emcee")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").symlink_to(ROOT / "data")
    program, *arguments = shlex.split(example)
    assert program == "sssfit" and main(arguments) == 0
    found = json.loads((tmp_path / arguments[-1] / "fit.json").read_text())
    for channel, truth in zip("rgb", (1.5, 1.0, 0.6), strict=True):
        d = found["parameters"][f"d_{channel}"]
        assert abs(d["value"] - truth) < 4 * d["standard_error"]


@pytest.mark.slow
def test_the_material_goes_on_to_tables(wax, tmp_path):
    assert main(["fit", "profile", str(wax), "--out", str(tmp_path / "fit"), "--quiet"]) == 0
    arguments = ["--formats", "npz", "--size", "16", "--size-2d", "5", "--quiet"]
    found = tmp_path / "fit" / "materials.csv"
    assert main(["tables", str(found), "--out", str(tmp_path / "tables"), *arguments]) == 0
    assert (tmp_path / "tables" / "wax" / "transmittance.npz").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, truth",
    [("skin1", (1.917851, 0.479457, 0.203523)), ("marble", (7.929926, 5.016436, 3.408846))],
)
def test_a_rendered_beam_gives_back_what_was_rendered(rendered, name, truth, tmp_path):
    """A path tracer's image of a beam of 10 mm, whose irradiance is 10 / pi; its profile ends at 16 d."""
    image, out = rendered / "s1_beam" / f"ref_{name}.exr", tmp_path / "out"
    light = ["--response", "beam", "--beam-radius", "10", "--irradiance", repr(10 / np.pi), "--cutoff", "16"]
    given = ["--layer", "sss", "--pixel-mm", "0.125", *light, "--quiet"]
    assert main(["fit", "profile", str(image), "--out", str(out), *given]) == 0
    found = json.loads((out / "fit.json").read_text())
    for channel, d in zip("rgb", truth, strict=True):
        one = found["parameters"][f"d_{channel}"]
        assert one["value"] == pytest.approx(d, rel=2.5e-3)
        assert abs(one["value"] - d) < 3.5 * one["standard_error"]
        assert found["parameters"][f"albedo_{channel}"]["value"] == pytest.approx(1, abs=2e-3)
    assert 0.3 < found["chi2_per_dof"] < 1.3
