"""A whole run: the same bytes twice, an honest manifest, a report that needs nothing else."""

import json
import re
import shutil
import subprocess
import time

import numpy as np
import pytest

from sssfit import tables
from sssfit.files.json_text import sha256_bytes
from sssfit.profiles import materials
from sssfit.tables.collection import Sizes, jobs, skipped
from sssfit.tables.writing import FORMATS, write

SIZES = Sizes(32, 9)
CSV = b"""\
material,unit,sigma_s_reduced_r,sigma_s_reduced_g,sigma_s_reduced_b,sigma_a_r,sigma_a_g,sigma_a_b,eta
Skin1,1/mm,0.74,0.88,1.01,0.032,0.17,0.48,1.3
White,1/mm,11.6,20.4,14.9,0.0,0.1,0.1,1.3
"""


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path = tmp_path_factory.mktemp("input") / "two.csv"
    path.write_bytes(CSV)
    return path


@pytest.fixture(scope="module")
def run(source, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    return out, write(out, source, sizes=SIZES)


@pytest.fixture(scope="module")
def exact(source):
    entries = [compute() for _, compute in jobs(materials.load(source), SIZES)]
    return {entry.path: entry.table for entry in entries}


def test_two_runs_give_the_same_bytes(run, source, tmp_path):
    first, _ = run
    time.sleep(2.1)  # so that a time stamp of any kind would differ
    second = tmp_path / "elsewhere"
    write(second, source, sizes=SIZES)
    names = sorted(str(p.relative_to(first)) for p in first.rglob("*") if p.is_file())
    assert names == sorted(str(p.relative_to(second)) for p in second.rglob("*") if p.is_file())
    for name in names:
        if name != "timing.json":
            assert (first / name).read_bytes() == (second / name).read_bytes(), name


def test_no_promised_file_names_the_place_or_host(run, source):
    out, _ = run
    forbidden = [str(out.parent).encode(), str(source.parent).encode()]
    for path in out.rglob("*"):
        if path.is_file():
            assert not any(word in path.read_bytes() for word in forbidden), path


def test_manifest_lists_every_file_with_its_digest(run):
    out, manifest = run
    assert json.loads((out / "manifest.json").read_text()) == json.loads(json.dumps(manifest))
    assert manifest["inputs"] == [{"name": "two.csv", "sha256": sha256_bytes(CSV)}]
    for name, listed in manifest["files"].items():
        content = (out / name).read_bytes()
        assert listed == {"sha256": sha256_bytes(content), "bytes": len(content)}


def test_an_infinite_path_is_skipped_and_said(run):
    out, manifest = run
    assert manifest["skipped"] == [
        {
            "material": "White",
            "reason": "a channel absorbs nothing, so its diffuse mean free path is infinite",
        }
    ]
    assert not (out / "White").exists()
    values = tables.load(out / "materials.npz").values
    assert np.isinf(values[1, 1, 0]) and np.isfinite(values[1, 1, 1:]).all()


@pytest.mark.parametrize("name", FORMATS)
def test_every_table_is_read_back_within_its_stated_error(name, run, exact):
    out, manifest = run
    assert set(exact) == {table["path"] for table in manifest["tables"]}
    for table in manifest["tables"]:
        stored = table["formats"][name]
        read, wanted = tables.load(out / stored["files"][0]), exact[table["path"]]
        finite = np.isfinite(wanted.values)
        error = np.max(np.abs(read.values[finite] - wanted.values[finite]))
        assert error <= stored["quantization"]["max_abs_error"] * (1 + 1e-12)
        # The statement is of use: half a step of the numbers that are stored.
        step = {"float": 2.0**-24, "half": 2.0**-11, "8-bit": 1 / 510}[stored["dtype"]]
        assert error <= step * np.max(np.abs(wanted.values[finite])) * (1 + 1e-9)
        for axis, wanted_axis in zip(read.axes, wanted.axes, strict=True):
            assert (axis.name, axis.unit) == (wanted_axis.name, wanted_axis.unit)
            np.testing.assert_array_equal(axis.values, wanted_axis.values)


def test_report_is_self_contained(run):
    out, manifest = run
    page = (out / "report.html").read_text()
    assert page.count("<img ") == len(manifest["tables"])
    assert page.count("data:image/png;base64,") == len(manifest["tables"])
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "White" in page and "mm" in page


def test_plots_are_pictures_of_their_tables(run):
    from PIL import Image

    out, manifest = run
    for table in manifest["tables"]:
        with Image.open(out / table["plot"]) as picture:
            assert picture.size == (720, 460)
            # More than a blank sheet: the curves and letters of a plot.
            assert len(picture.convert("L").getcolors(maxcolors=256) or []) > 20


def test_lookup_error_falls_with_size(source):
    loaded = materials.load(source)

    def errors(sizes):
        return {title: compute().lookup_error for title, compute in jobs(loaded, sizes)}

    small, large = errors(Sizes(32, 21)), errors(Sizes(128, 81))
    for title, error in small.items():
        if error is not None:
            assert (large[title] or 0) < error / 2, title


def test_unknown_format(tmp_path):
    with pytest.raises(ValueError, match="formats must be some of exr, .*, got 'tiff'"):
        write(tmp_path / "out", formats=["tiff"])
    assert not (tmp_path / "out").exists()


def test_values_too_large_for_half_are_left_out_and_said(tmp_path):
    source = tmp_path / "sea.csv"
    source.write_text(
        "material,unit,albedo_r,albedo_g,albedo_b,dmfp_r,dmfp_g,dmfp_b\nSea,m,0.1,0.1,0.1,90,90,90\n"
    )
    manifest = write(tmp_path / "out", source, ["dds", "exr"], SIZES)
    (parameters,) = [t for t in manifest["tables"] if t["path"] == "materials"]
    assert "65504" in parameters["formats"]["dds"]["omitted"]
    assert (tmp_path / "out" / "materials.exr").exists()
    assert not (tmp_path / "out" / "materials.dds").exists()


def test_shipped_materials_skip_only_the_white_standard():
    assert [s["material"] for s in skipped(materials.load(materials.shipped()))] == ["Spectralon"]


@pytest.mark.skipif(shutil.which("glslangValidator") is None, reason="glslangValidator is not installed")
@pytest.mark.parametrize("suffix", ["hlsl", "glsl"])
def test_shader_text_of_all_tables_compiles_together(suffix, run, tmp_path):
    out, manifest = run
    stage = "-S frag" if suffix == "glsl" else "-V -D -S frag -e main -o all.spv"
    version = ["#version 450"] if suffix == "glsl" else []
    texts = [(out / table["formats"][suffix]["files"][0]).read_text() for table in manifest["tables"]]
    entry = {"hlsl": "float4 main() : SV_Target { return 0; }", "glsl": "void main() {}"}[suffix]
    (tmp_path / f"all.{suffix}").write_text("\n".join([*version, *texts, entry]))
    command = ["glslangValidator", *stage.split(), f"all.{suffix}"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
