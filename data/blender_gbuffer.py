# SPDX-License-Identifier: GPL-3.0-or-later
"""Export what sssfit reads of a Blender scene: irradiance, depth, normal, albedo, ids and motion.

    blender scene.blend --background --python blender_gbuffer.py -- --out DIR [--frames FIRST:LAST]

renders the scene's camera and view layer with Cycles, every layer at the centres of pixels, and writes
frame_XXXX.exr and camera.json, lengths in mm (a Blender unit is 1000 times the scene's unit scale, unless
--mm-per-unit says otherwise). The scene itself is not saved.

- E: direct light on a white Lambert surface, pi times its radiance: every material is replaced by white, so
  mesh lights give no light and cut-out textures cut nothing; lamps and the world light the scene.
- id: the object's pass index (Object Properties > Relations). Where no object has one, the visible ones are
  numbered from 1 by name, and camera.json says which is which.
- motion: where a point was in the frame before minus where it is, pixels, y downwards. Not for orthographic
  cameras: Cycles' vectors are wrong for those.

Written for Blender 4.2 to 5.0; it runs in the Python module `bpy` too.
"""

import argparse
import json
import math
import os
import struct
import sys
import tempfile
import zlib
from pathlib import Path

import bpy
import numpy as np

BACKGROUND_DEPTH = 1e6
# Names of the passes, the older ones first.
DEPTH, NORMAL = (("Depth", "Z"), ("Z", "V", "X")), (("Normal",), "XYZ")
ALBEDO, IRRADIANCE = (("DiffCol", "Diffuse Color"), "RGB"), (("DiffDir", "Diffuse Direct"), "RGB")
INDEX, VECTOR = (("IndexOB", "Object Index"), ("X", "V", "Z")), (("Vector",), "XYZW")
HALF, FLOAT, UINT = 1, 2, 0
TYPES = {UINT: np.dtype("<u4"), HALF: np.dtype("<f2"), FLOAT: np.dtype("<f4")}


def main(arguments):
    """Export the frames that are asked for."""
    options = parse(arguments)
    scene, layer = bpy.context.scene, bpy.context.view_layer
    if scene.camera is None:
        sys.exit("blender_gbuffer: the scene has no camera; add one and make it active")
    if scene.camera.data.type == "PANO":
        sys.exit(
            "blender_gbuffer: panoramic cameras cannot be described; use a perspective or orthographic one"
        )
    scale = options.mm_per_unit or 1000 * scene.unit_settings.scale_length
    first, last = options.frames or (scene.frame_current, scene.frame_current)
    out = Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    configure(scene, layer)
    ids = number_objects(scene)
    cameras = {}
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        name = f"frame_{frame:04}.exr"
        cameras[name] = {"index": frame, "camera": describe_camera(scene, scale)}
        replace(out / name, encode(gbuffer(scene, layer, scale, options.samples)))
    contents = {
        "scene": Path(bpy.data.filepath).stem or "untitled",
        "units": "mm",
        "world_scale": f"1 Blender unit = {scale:g} mm",
        "renderer": f"Blender Cycles {bpy.app.version_string}",
        "ids": ids,
        "background_depth_mm": BACKGROUND_DEPTH,
        "E_samples": options.samples,
        "gbuffer": cameras,
    }
    replace(out / "camera.json", json.dumps(contents, indent=1).encode())


def parse(arguments):
    """The options after the two dashes."""
    parser = argparse.ArgumentParser(prog="blender_gbuffer")
    parser.add_argument("--out", required=True, metavar="DIR")
    parser.add_argument("--frames", type=frame_range, metavar="FIRST:LAST", help="default: the current one")
    parser.add_argument("--samples", type=int, default=64, help="of the light, per pixel (default: 64)")
    parser.add_argument("--mm-per-unit", type=float, help="default: 1000 x the scene's unit scale")
    return parser.parse_args(arguments)


def frame_range(text):
    """First and last frame from FIRST:LAST or one number."""
    first, _, last = text.partition(":")
    return int(first), int(last or first)


def configure(scene, layer):
    """Take one sharp sample position per pixel, the passes, and nothing that alters numbers."""
    scene.render.engine = "CYCLES"
    scene.render.use_compositing = scene.render.use_sequencer = False
    # Cycles gives motion vectors only without blur.
    scene.render.use_motion_blur = scene.render.use_border = False
    cycles = scene.cycles
    # The box filter would ignore its width.
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    cycles.use_denoising = cycles.use_adaptive_sampling = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.film_exposure, cycles.seed = 1.0, 0
    scene.camera.data.dof.use_dof = False
    for other in scene.view_layers:
        other.use = other == layer
    for name in ("z", "normal", "diffuse_color", "object_index", "vector", "diffuse_direct"):
        setattr(layer, f"use_pass_{name}", True)
    # From Blender 5 on a format belongs to a kind of medium.
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"


def number_objects(scene):
    """Ids by what bears them, given where there are none."""
    kinds = ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD")
    objects = sorted(
        (o for o in scene.objects if o.type in kinds and not o.hide_render), key=lambda o: o.name
    )
    if not any(o.pass_index for o in objects):
        for number, o in enumerate(objects, 1):
            o.pass_index = number
    names = {}
    for o in objects:
        if o.pass_index:
            names.setdefault(str(o.pass_index), []).append(o.name)
    return {number: ", ".join(found) for number, found in names.items()}


def describe_camera(scene, scale):
    """The camera's numbers as sssfit reads them."""
    width, height = size(scene)
    render, camera = scene.render, scene.camera
    projection = camera.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(),
        x=width,
        y=height,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    fx, fy = projection[0][0] * width / 2, projection[1][1] * height / 2
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = rotation(camera), np.array(camera.matrix_world.translation) * scale
    found = {"width": width, "height": height, "camera_to_world": to_world.tolist()}
    if camera.data.type == "PERSP":
        middle = {"cx": (1 - projection[0][2]) / 2 * width, "cy": (1 + projection[1][2]) / 2 * height}
        return {"projection": "perspective", **found, **middle, "fx": fx, "fy": fy}
    if not math.isclose(fx, fy, rel_tol=1e-5):
        sys.exit("blender_gbuffer: an orthographic camera needs square pixels; set the pixel aspect to 1")
    middle = {"cx": (1 + projection[0][3]) / 2 * width, "cy": (1 - projection[1][3]) / 2 * height}
    return {"projection": "orthographic", **found, **middle, "mm_per_pixel": scale / fx}


def gbuffer(scene, layer, scale, samples):
    """Channels of a frame by their names in the file."""
    scene.cycles.samples = 1
    surfaces = render(scene)
    earlier = layer.material_override, scene.cycles.max_bounces
    layer.material_override, scene.cycles.max_bounces = white(), 0
    scene.cycles.samples = samples
    lit = render(scene)
    layer.material_override, scene.cycles.max_bounces = earlier
    depth = scale * one(surfaces, *DEPTH).astype(np.float64)
    index = np.rint(one(surfaces, *INDEX)).astype(np.uint32)
    hit = np.isfinite(depth) & (depth > 0) & (depth < 0.99 * BACKGROUND_DEPTH)
    # Blender's passes have world axes, ours those of the camera.
    normal = several(surfaces, *NORMAL) @ rotation(scene.camera)
    irradiance = math.pi * several(lit, *IRRADIANCE)
    channels = {"depth": np.where(hit, depth, BACKGROUND_DEPTH).astype("<f4"), "id": np.where(hit, index, 0)}
    layers = {"E": irradiance, "normal": normal, "albedo": several(surfaces, *ALBEDO)}
    if scene.camera.data.type == "PERSP":
        layers["motion"] = several(surfaces, *VECTOR)[..., :2] * (1, -1)
    for name, values in layers.items():
        values = np.where(hit[..., None], values, 0).astype("<f4")
        letters = "XYZ" if name in ("normal", "motion") else "RGB"
        channels.update({f"{name}.{letters[i]}": values[..., i] for i in range(values.shape[-1])})
    return channels


def white():
    """A material that reflects all light evenly."""
    material = bpy.data.materials.new("white Lambert")
    # From Blender 5 on it has nodes from the start.
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    surface = nodes.new("ShaderNodeBsdfDiffuse")
    surface.inputs["Color"].default_value = (1, 1, 1, 1)
    surface.inputs["Roughness"].default_value = 0
    output = nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
    return material


def size(scene):
    """Width and height of the image."""
    share = scene.render.resolution_percentage / 100
    return int(scene.render.resolution_x * share), int(scene.render.resolution_y * share)


def rotation(camera):
    """Camera's axes in the world as the columns of a matrix."""
    return np.array(camera.matrix_world.to_quaternion().to_matrix())


def render(scene):
    """Channels of one rendering by name."""
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "render.exr")
        bpy.ops.render.render(write_still=True)
        return decode(next(Path(folder).iterdir()).read_bytes())


def one(channels, passes, components):
    """The only component of a pass, whatever it is called."""
    for name, values in channels.items():
        if any(name.endswith(f".{p}.{c}") for p in passes for c in components):
            return values
    sys.exit(f"blender_gbuffer: Blender wrote no pass {' or '.join(passes)}, only {', '.join(channels)}")


def several(channels, passes, components):
    """The components of a pass, (height, width, number)."""
    return np.stack([one(channels, passes, (c,)) for c in components], axis=-1)


def decode(data):
    """Channels of an uncompressed EXR file of scan lines, of one part or several."""
    (version,) = struct.unpack_from("<i", data, 4)
    multipart = bool(version & 0x1000)
    at, parts = 8, []
    while True:
        attributes, at = decode_header(data, at)
        if attributes:
            parts.append(attributes)
        if not multipart or not attributes:
            break
    found = {}
    for attributes in parts:
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
        width, height = right - left + 1, bottom - top + 1
        if attributes["compression"][0] != 0:
            sys.exit("blender_gbuffer: Blender compressed what should not be")
        row = np.dtype(
            [(name, TYPES[kind], (width,)) for name, kind in decode_channels(attributes["channels"])]
        )
        offsets = struct.unpack_from(f"<{height}Q", data, at)
        at += 8 * height
        # Each line has its number and size before it, and that of its part.
        skip = 12 if multipart else 8
        lines = {
            struct.unpack_from("<i", data, o + skip - 8)[0] - top: np.frombuffer(data, row, 1, o + skip)[0]
            for o in offsets
        }
        prefix = attributes.get("name", b"").decode()
        for name in row.names:
            pixels = np.stack([lines[y][name] for y in range(height)])
            found[name if "." in name else f".{prefix}.{name}"] = pixels
    return found


def decode_header(data, at):
    """Attributes of one header by name, and where it ends."""
    attributes = {}
    while data[at] != 0:
        name, at = decode_text(data, at)
        _, at = decode_text(data, at)
        (length,) = struct.unpack_from("<i", data, at)
        attributes[name] = data[at + 4 : at + 4 + length]
        at += 4 + length
    return attributes, at + 1


def decode_text(data, at):
    """Text up to a zero, and where the next thing begins."""
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def decode_channels(data):
    """Names and types of channels in the order of the file."""
    at, found = 0, []
    while data[at] != 0:
        name, at = decode_text(data, at)
        found.append((name, struct.unpack_from("<i", data, at)[0]))
        at += 16
    return found


def encode(channels):
    """An EXR file: scan lines, ZIP compression."""
    names = sorted(channels)
    height, width = channels[names[0]].shape
    kinds = {dtype: kind for kind, dtype in TYPES.items()}
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<i4xii", kinds[channels[name].dtype], 1, 1) for name in names
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = b"".join(
        name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in (
            (b"channels", b"chlist", listed + b"\0"),
            (b"compression", b"compression", b"\3"),
            (b"dataWindow", b"box2i", window),
            (b"displayWindow", b"box2i", window),
            (b"lineOrder", b"lineOrder", b"\0"),
            (b"pixelAspectRatio", b"float", struct.pack("<f", 1)),
            (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0)),
            (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
        )
    )
    start = b"\x76\x2f\x31\x01" + struct.pack("<i", 2) + header + b"\0"
    blocks = []
    for top in range(0, height, 16):
        rows = range(top, min(top + 16, height))
        raw = b"".join(channels[name][y].tobytes() for y in rows for name in names)
        packed = compress(raw)
        blocks.append(struct.pack("<ii", top, len(packed)) + packed)
    places = len(start) + 8 * len(blocks) + np.cumsum([0, *map(len, blocks[:-1])])
    return start + places.astype("<u8").tobytes() + b"".join(blocks)


def compress(raw):
    """EXR's ZIP: even bytes, then odd ones, each as its difference from the one before."""
    data = np.frombuffer(raw, np.uint8)
    data = np.concatenate([data[::2], data[1::2]]).astype(np.int16)
    data[1:] = data[1:] - data[:-1] + 128
    packed = zlib.compress(data.astype(np.uint8).tobytes(), 6)
    # Readers take a block that is not shorter for one that is not packed.
    return packed if len(packed) < len(raw) else raw


def replace(path, data):
    """Write a file in one step."""
    beside = path.with_name(path.name + ".tmp")
    beside.write_bytes(data)
    os.replace(beside, path)


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
