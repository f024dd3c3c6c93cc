"""Blender's exporter: its EXR files against the library's, and a scene of flat cards against closed forms."""

import json
import os
import runpy
import subprocess
import sys
import types
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from sssfit.files.exr import read_exr
from sssfit.frames import gbuffer

SCRIPT = Path(__file__).resolve().parents[2] / "data" / "blender_gbuffer.py"


@pytest.fixture
def exporter(monkeypatch):
    """The script's functions; those used here do not call Blender."""
    if find_spec("bpy") is None:
        monkeypatch.setitem(sys.modules, "bpy", types.ModuleType("bpy"))
    return runpy.run_path(str(SCRIPT), run_name="exporter")


def test_the_licence_is_blenders():
    assert SCRIPT.read_text().startswith("# SPDX-License-Identifier: GPL-3.0-or-later\n")


# Sixteen lines are packed together; noise cannot be packed, and constants can.
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (16, 7), (33, 2), (50, 41)])
@pytest.mark.parametrize("noise", [True, False])
def test_what_the_script_writes_is_read(exporter, tmp_path, shape, noise):
    words = (
        np.random.default_rng(1).integers(0, 2**32, shape, np.uint32)
        if noise
        else np.full(shape, 7, np.uint32)
    )
    channels = {
        "id": words,
        "E.R": words.view("<f4"),
        "E.B": words.astype("<f4"),
        "depth": -words.astype("<f4"),
    }
    (tmp_path / "a.exr").write_bytes(exporter["encode"](channels))
    found, _ = read_exr(tmp_path / "a.exr")
    assert list(found) == sorted(channels)
    for name, pixels in channels.items():
        assert found[name].dtype == pixels.dtype and found[name].tobytes() == pixels.tobytes()


@pytest.mark.parametrize("parts", [1, 2])
def test_what_blender_may_write_is_read_by_the_script(exporter, tmp_path, parts):
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = np.random.default_rng(2).random((9, 4), np.float32)
    layers = [
        {"View.Depth.Z": pixels, "View.Vector.X": pixels.astype(np.float16)},
        {"View.IndexOB.X": pixels.view("u4")},
    ]
    path = tmp_path / "a.exr"
    named = [OpenEXR.Part(dict(header), dict(layer), f"part {i}") for i, layer in enumerate(layers[:parts])]
    with OpenEXR.File(named) as image:
        image.write(str(path))
    found = exporter["decode"](path.read_bytes())
    expected = {name: values for layer in layers[:parts] for name, values in layer.items()}
    assert set(found) == set(expected)
    for name, values in expected.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)


# A card of 60 by 40 floats above a large floor; both, and the camera, are turned and moved.
BUILD = """
import sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.unit_settings.scale_length = 0.001
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 64, 36, 100

def card(name, width, height, z, colour, index):
    corners = [(x * width / 2, y * height / 2, 0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    thing = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(thing)
    thing.location.z, thing.pass_index = z, index
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    surface, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    surface.inputs["Color"].default_value = (*colour, 1)
    material.node_tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    mesh.materials.append(material)
    return thing

def moved(thing, where):
    for frame, place in where.items():
        thing.location = place
        thing.keyframe_insert("location", frame=frame)

card("floor", 280, 180, -30, (0.2, 0.5, 0.7), 5)
moved(card("card", 60, 40, 20, (0.9, 0.1, 0.3), 9), {1: (0, 0, 20), 2: (2, 1, 20), 3: (4, 2, 20)})
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.data.type, camera.data.ortho_scale, camera.data.lens = sys.argv[2], 250, 50
camera.data.clip_end = 10000
camera.data.shift_x, camera.data.shift_y = 0.04, -0.02
camera.rotation_euler = (0.1, 0.05, 0.2)
moved(camera, {1: (20, -30, 330), 2: (21, -30, 331), 3: (22, -30, 332)})
scene.collection.objects.link(camera)
scene.camera = camera
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.data.angle, sun.rotation_euler = 3.0, 0.0, (0.5, 0.3, 0.0)
scene.collection.objects.link(sun)
scene.frame_set(2)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""
EXPORT = """
import sys, runpy, bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
script, sys.argv = sys.argv[2], ["blender", "--", *sys.argv[3:]]
runpy.run_path(script, run_name="__main__")
"""


@pytest.fixture(scope="module")
def blender():
    """A Python that has Blender as a module: this one, or the one that SSSFIT_BLENDER_PYTHON names."""
    python = os.environ.get("SSSFIT_BLENDER_PYTHON") or (sys.executable if find_spec("bpy") else "")
    if not python:
        pytest.skip("the module bpy is not installed, and SSSFIT_BLENDER_PYTHON names no Python that has it")
    return python


def turned(x, y, z):
    """The rotation of Blender's Euler angles: about x first, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([x, y, z]), np.sin([x, y, z])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ about_y @ about_x


@pytest.mark.slow
@pytest.mark.parametrize(("projection", "scale"), [("PERSP", 1.0), ("ORTHO", 10.0)])
def test_a_scene_of_cards(blender, tmp_path, projection, scale):
    def run(code, *arguments):
        subprocess.run(
            [blender, "-c", code, *map(str, arguments)], check=True, capture_output=True, timeout=300
        )

    run(BUILD, tmp_path / "cards.blend", projection)
    options = ["--samples", "4"] + (["--mm-per-unit", "10"] if scale == 10 else [])
    run(EXPORT, tmp_path / "cards.blend", SCRIPT, "--out", tmp_path / "out", *options)
    out = tmp_path / "out"
    assert sorted(path.name for path in out.iterdir()) == ["camera.json", "frame_0002.exr"]
    contents = json.loads((out / "camera.json").read_text())
    assert contents["ids"] == {"5": "floor", "9": "card"}
    frame = gbuffer.load(out / "frame_0002.exr", out / "camera.json", strict=True)
    to_world = np.array(contents["gbuffer"]["frame_0002.exr"]["camera"]["camera_to_world"])
    camera_axes, place = turned(0.1, 0.05, 0.2), scale * np.array([21, -30, 331.0])
    np.testing.assert_allclose(to_world[:3, :3], camera_axes, atol=1e-6)
    np.testing.assert_allclose(to_world[:3, 3], place, rtol=1e-6)

    ids = np.asarray(frame.profile_id)
    assert set(np.unique(ids)) == {0, 5, 9}
    columns, rows = np.broadcast_arrays(*frame.camera.pixel_centres())
    seen = np.asarray(frame.camera.position(columns, rows, frame.depth), np.float64)
    world = (seen @ camera_axes.T + place) / scale
    # A sample lies within 0.005 pixels of the centre, a pixel is 4 mm, and slopes are below a half.
    off = 0.005 * 4 * 0.5 + 1e-3
    for number, height in ((5, -30), (9, 20)):
        np.testing.assert_allclose(world[ids == number][:, 2], height, rtol=0, atol=off)
    # The card's edges are those of its outline in the world; where depth had jumped, height would be wrong.
    inside = (np.abs(world - [2, 1, 20]) < [30 - 0.1, 20 - 0.1, 1]).all(-1)
    outside = (np.abs(world - [2, 1, 20]) > [30 + 0.1, 20 + 0.1, 1]).any(-1)
    assert (ids[inside] == 9).all() and (ids[outside] != 9).all() and inside.sum() > 50

    surface = ids > 0
    normal = np.asarray(frame.normal)
    np.testing.assert_allclose(normal[surface], np.tile(camera_axes[2], (surface.sum(), 1)), atol=1e-5)
    colours = np.where((ids == 9)[..., None], [0.9, 0.1, 0.3], [0.2, 0.5, 0.7])
    np.testing.assert_allclose(np.asarray(frame.albedo)[surface], colours[surface], rtol=1e-5)

    light = turned(0.5, 0.3, 0.0)[:, 2]
    cast = world + light * ((20 - world[..., 2]) / light[2])[..., None] - [2, 1, 20]
    margin = np.min([30, 20] - np.abs(cast[..., :2]), axis=-1)
    shadow = (ids == 5) & (margin > 0)
    expected = np.where(shadow, 0, 3 * light[2])[..., None] * np.ones(3)
    sure = surface & ((ids == 9) | (np.abs(margin) > 0.1))
    assert (shadow & sure).sum() > 20
    np.testing.assert_allclose(np.asarray(frame.irradiance)[sure], expected[sure], rtol=1e-5, atol=1e-6)

    if projection == "ORTHO":
        assert frame.motion is None
        return
    before = world - (ids == 9)[..., None] * [2.0, 1.0, 0.0]
    column, row, _ = frame.camera.project(scale * (before - [20, -30, 330]) @ camera_axes)
    moved = np.stack([np.asarray(column) - columns, np.asarray(row) - rows], axis=-1)
    # Both ends may be 0.005 pixels from the centre, but together.
    np.testing.assert_allclose(np.asarray(frame.motion)[surface], moved[surface], rtol=0, atol=5e-4)
    assert np.abs(np.asarray(frame.motion)[surface]).max() > 0.2
