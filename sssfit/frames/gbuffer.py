"""Frames as renderers write them: irradiance and what is seen at each pixel, from EXR files and back."""

import math
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from sssfit.files.atomic import write_bytes
from sssfit.files.errors import FileError
from sssfit.files.exr import encode_exr
from sssfit.frames import _layers
from sssfit.frames import camera as cameras
from sssfit.frames.camera import Camera

#: Depth of pixels that show nothing, mm.
BACKGROUND_DEPTH = 1e6

#: Our names of the layers, and the names they have in files unless told otherwise.
LAYERS = {
    "irradiance": "E",
    "depth": "depth",
    "normal": "normal",
    "albedo": "albedo",
    "profile_id": "id",
    "motion": "motion",
}
_KINDS = {
    "irradiance": _layers.COLOUR,
    "depth": _layers.NUMBER,
    "normal": _layers.VECTOR,
    "albedo": _layers.COLOUR,
    "profile_id": _layers.NUMBER,
    "motion": _layers.PAIR,
}
_WORDS = {"profile_id": "profile id"}
_COMPONENTS = {"irradiance": "RGB", "normal": "XYZ", "albedo": "RGB", "motion": "XY"}
# Largest finite half.
_HALF_MAX = 65504.0


class Frame(NamedTuple):
    """What a renderer knows of each pixel; row 0 is the upper one.

    Attributes:
        irradiance: linear, (H, W, 3), float32.
        depth: along the viewing axis, mm, (H, W), float32.
        normal: in camera space, (H, W, 3), float32, or None.
        albedo: (H, W, 3), float32, or None.
        profile_id: which profile scatters there, 0 for the background, (H, W), int32.
        motion: where the point was in the frame before, minus where it is, pixels, the second component
            down, (H, W, 2), float32, or None.
        camera: that saw it.
    """

    irradiance: Array
    depth: Array
    normal: Array | None
    albedo: Array | None
    profile_id: Array
    motion: Array | None
    camera: Camera


def load(
    path: str | os.PathLike[str],
    camera: Camera | str | os.PathLike[str],
    *,
    layers: Mapping[str, str | None] | None = None,
    world_scale: float = 1.0,
    background_depth: float = BACKGROUND_DEPTH,
    strict: bool = False,
    tell: Callable[[str], None] | None = None,
) -> Frame:
    """Read a frame from an EXR file, or from several of one size.

    Irradiance and depth must be there; normal, albedo and motion are None where the file has none, unless
    they are asked for. A file without ids has id 1 wherever its depth is nearer than the background, and 0
    elsewhere.

    A pixel is bad where its irradiance is NaN, infinite or negative; or where it has a profile and its depth
    is NaN, infinite or not above 0, or its normal, albedo or motion is not finite. Bad pixels are masked out,
    with a warning: irradiance and id become 0, and the depth that of the background.

    Args:
        path: the EXR file.
        camera: that saw it, or the path of a camera.json that has it under the file's name.
        layers: for those of our names (irradiance, depth, normal, albedo, profile_id, motion) that are
            called otherwise: a layer or channel of the file, or of one beside it as "other.exr:layer"; None
            for a layer not to be read. By default `LAYERS`.
        world_scale: mm per unit of the file's depth.
        background_depth: pixels this deep show nothing, mm (0.99 of it is deep enough).
        strict: refuse bad pixels instead.
        tell: gets the sentence about bad pixels, where a warning will not do, such as in a thread.

    Returns:
        The frame, free of NaN and infinities.

    Raises:
        FileError: a file is missing, truncated or no EXR image; it lacks a channel or has another size than
            the camera; ids are not whole numbers; pixels are bad and `strict` is set; no pixel has a profile.
        ValueError: a name in `layers` is not one of ours, or a number is out of its range.

    Example:
        >>> import tempfile
        >>> from sssfit.frames import procedural
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     frame = procedural.frame(width=64, height=36)
        ...     write(Path(folder) / "frame.exr", frame)
        ...     load(Path(folder) / "frame.exr", frame.camera).irradiance.shape
        (36, 64, 3)
    """
    asked = dict(layers or {})
    _check_options(asked, world_scale, background_depth)
    files, path = _layers.Layers(path), Path(path)
    found: dict[str, np.ndarray | None] = {}
    for ours, name in (LAYERS | asked).items():
        needed = ours in ("irradiance", "depth") or ours in asked
        word = _WORDS.get(ours, ours)
        found[ours] = None if name is None else files.find(name, _KINDS[ours], word, needed=needed)
    irradiance, depth = found["irradiance"], found["depth"]
    assert irradiance is not None and depth is not None
    height, width = irradiance.shape[:2]
    if not isinstance(camera, Camera):
        camera = cameras.load(camera, path, size=(width, height))
    for ours, pixels in found.items():
        if pixels is not None and pixels.shape[:2] != (camera.height, camera.width):
            file, _ = files.place((LAYERS | asked)[ours] or "")
            shape = f"{pixels.shape[1]} x {pixels.shape[0]} pixels"
            problem = f"the {_WORDS.get(ours, ours)} has {shape}, the camera {camera.width} x {camera.height}"
            raise FileError(file, "", problem, "give images of one size, and their camera")
    depth = depth[..., 0].astype(np.float32) * np.float32(world_scale)
    ids = found["profile_id"]
    if ids is None:
        # NaN is not background: it is a bad pixel of the surface.
        profile_id = (~(depth >= 0.99 * background_depth)).astype(np.int32)
    else:
        profile_id = _whole(ids[..., 0], path)
    rest = {n: None if p is None else p.astype(np.float32) for n, p in found.items() if n in _COMPONENTS}
    return _mended(rest, depth, profile_id, camera, path, background_depth, strict, tell)


def encode(frame: Frame, *, half: bool = False, attributes: Mapping[str, str] | None = None) -> bytes:
    """The bytes of an EXR file with a frame's layers under the names that `load` expects.

    Args:
        frame: what to write; its camera is not part of the file.
        half: irradiance, normal, albedo and motion as half numbers; depth is always float, and the id a
            whole number of 32 bits.
        attributes: text for the header, by name.

    Returns:
        The content of the file; the same frame gives the same bytes.

    Raises:
        ValueError: a number is too large for half, or an id is negative.

    Example:
        >>> from sssfit.frames import procedural
        >>> encode(procedural.frame(width=16, height=9))[:4]
        b'v/1\\x01'
    """
    channels: dict[str, np.ndarray] = {LAYERS["depth"]: np.asarray(frame.depth, np.float32)}
    ids = np.asarray(frame.profile_id)
    if ids.min() < 0:
        raise ValueError(f"profile_id must not be negative, got {ids.min()}")
    channels[LAYERS["profile_id"]] = ids.astype(np.uint32)
    for ours, components in _COMPONENTS.items():
        values = getattr(frame, ours)
        if values is None:
            continue
        values = np.asarray(values, np.float32)
        if half:
            # Half holds infinity, too.
            largest = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
            if largest > _HALF_MAX:
                raise ValueError(f"{ours} has {largest:g}, half numbers end at {_HALF_MAX:g}: write float")
            values = values.astype(np.float16)
        channels |= {f"{LAYERS[ours]}.{c}": values[..., i] for i, c in enumerate(components)}
    return encode_exr(channels, dict(attributes or {}))


def write(path: str | os.PathLike[str], frame: Frame, *, half: bool = False) -> None:
    """Write a frame as an EXR file that `load` reads.

    Args:
        path: of the file; its directory must exist.
        frame: what to write; its camera is not part of the file.
        half: as in `encode`.

    Raises:
        FileError: the file cannot be written; an earlier one is untouched.
        ValueError: as in `encode`.

    Example:
        >>> import tempfile
        >>> from sssfit.frames import procedural
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write(Path(folder) / "frame.exr", procedural.frame(width=16, height=9), half=True)
        ...     [path.name for path in Path(folder).iterdir()]
        ['frame.exr']
    """
    write_bytes(path, encode(frame, half=half))


def _check_options(layers: dict[str, str | None], world_scale: float, background_depth: float) -> None:
    for name, value in layers.items():
        if name not in LAYERS:
            raise ValueError(f"layers must name {', '.join(LAYERS)}, got {name!r}")
        if value is None and name in ("irradiance", "depth"):
            raise ValueError(f"layers cannot leave out {name}")
    for name, value in (("world_scale", world_scale), ("background_depth", background_depth)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be a number above 0, got {value:g}")


def _whole(ids: np.ndarray, file: Path) -> np.ndarray:
    """Ids as int32; some renderers write them as float."""
    # Written so that NaN is refused too.
    bad = ~((ids >= 0) & (ids < 2**31) & (ids == np.floor(ids)))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        problem = f"{bad.sum()} profile ids are no whole numbers from 0 to 2147483647"
        where = f"the first is {ids[row, column]:g} at column {column}, row {row}"
        raise FileError(file, "", f"{problem} ({where})", "write one id per object, without anti-aliasing")
    return ids.astype(np.int32)


def _mended(
    layers: dict[str, np.ndarray | None],
    depth: np.ndarray,
    profile_id: np.ndarray,
    camera: Camera,
    file: Path,
    background_depth: float,
    strict: bool,
    tell: Callable[[str], None] | None,
) -> Frame:
    """A frame of these layers, with bad pixels masked out or refused."""
    irradiance, surface = layers.pop("irradiance"), profile_id > 0
    assert irradiance is not None
    faults: dict[str, Any] = {
        "a depth that is NaN, infinite or not above 0": surface & ~((depth > 0) & np.isfinite(depth))
    }
    if not _is_finite(irradiance) or irradiance.min() < 0:
        wrong = ~((irradiance >= 0) & np.isfinite(irradiance)).all(-1)
        faults = {"a NaN, infinite or negative irradiance": wrong} | faults
    rest = {name: values for name, values in layers.items() if values is not None}
    broken = [name for name, values in rest.items() if not _is_finite(values)]
    for name in broken:
        faults[f"a NaN or infinite {name}"] = surface & ~np.isfinite(rest[name]).all(-1)
    told = [_told(mask, fault) for fault, mask in faults.items() if mask.any()]
    if told and strict:
        raise FileError(file, "", ", ".join(told), "mend the file, or have them masked out without strict")
    if told:
        sentence = f"{file}: {', '.join(told)}; they are masked out"
        if tell is None:
            warnings.warn(sentence, stacklevel=3)
        else:
            tell(sentence)
        bad = np.any(list(faults.values()), axis=0)
        irradiance, profile_id = np.where(bad[..., None], 0, irradiance), np.where(bad, 0, profile_id)
        depth = np.where(bad, background_depth, depth)
    if not profile_id.any():
        problem = "no pixel has a profile, all ids are 0" if not told else "no good pixel has a profile"
        raise FileError(file, "", problem, "give what shall scatter an id of 1 or more")
    # Renderers leave all sorts of numbers where there is no surface.
    nothing = (profile_id == 0) & ~((depth > 0) & (depth < background_depth))
    depth = np.where(nothing, background_depth, depth)
    for name in broken:
        rest[name] = np.where(np.isfinite(rest[name]), rest[name], 0)
    return Frame(
        irradiance=jnp.asarray(irradiance, jnp.float32),
        depth=jnp.asarray(depth, jnp.float32),
        profile_id=jnp.asarray(profile_id, jnp.int32),
        camera=camera,
        **(dict.fromkeys(layers) | {name: jnp.asarray(values) for name, values in rest.items()}),
    )


def _is_finite(values: np.ndarray) -> bool:
    """Whether all numbers are; of a good frame two of them tell it sooner than a mask does."""
    return bool(np.isfinite(values.min()) and np.isfinite(values.max()))


def _told(mask: np.ndarray, fault: str) -> str:
    row, column = np.argwhere(mask)[0]
    number = int(mask.sum())
    have = "pixel has" if number == 1 else "pixels have"
    return f"{number} {have} {fault} (the first at column {column}, row {row})"
