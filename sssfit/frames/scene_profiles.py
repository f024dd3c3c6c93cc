"""Which profile scatters at which id: from a scene's camera.json, from a shipped material or from numbers."""

import math
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sssfit.files.errors import FileError
from sssfit.files.json_text import read_json
from sssfit.profiles import burley, materials

#: Shape parameters d in mm, (3,), by id; None where nothing scatters and the irradiance stays as it is.
Profiles = dict[int, np.ndarray | None]


def by_id(
    camera_json_path: str | os.PathLike[str] | None,
    name: str,
    reference: str | os.PathLike[str] | None = None,
    *,
    ids: Iterable[int] = (1,),
) -> Profiles:
    """Shape parameters of a scene's profiles, by id.

    A name is looked up, whatever its case, in `profiles_by_id`: of the given reference (`references[...]` in
    the JSON file) if its id 1 bears it, else of the first reference whose id 1 bears it, else at top level;
    each id then has its own profile from there. A name that is at top level only at other ids gives its
    profile to every id that scatters. Only then come the shipped materials, and numbers as in `parse`: they
    are for every id.

    Args:
        camera_json_path: the JSON file that comes with a frame; None without one.
        name: of a profile or a material; or numbers.
        reference: file of the picture to compare with; only its name counts, not its folder.
        ids: to be given a material or numbers, besides those that the JSON file tells of.

    Returns:
        d in mm, float64, per channel; None where the JSON file has null: irradiance is kept there.

    Raises:
        FileError: no such file or a faulty one, or no such name: the message tells those that are known.
        ValueError: numbers that are not as in `parse`, or an unknown name without a JSON file.

    Source: d is used as the file has it, or is dmfp / s(albedo), Christensen and Burley 2015, Eq 8.

    Example:
        >>> by_id(None, "0.33,7", ids=(1, 2))[2]
        array([2., 2., 2.])
    """
    path = camera_json_path
    content = {} if path is None else read_json(path)
    content = content if isinstance(content, dict) else {}
    scenes = list(_mappings(content, path, None if reference is None else Path(reference).name))
    for scene in scenes:
        if _bears(scene, "1", name):
            return {int(key): None if p is None else _shape(p, path, key) for key, p in scene.items()}
    d = _of_top_level(content, name, path)
    d = _of_materials(name) if d is None else d
    if d is None and _is_numbers(name):
        d = parse(name)
    if d is None:
        held = dict.fromkeys(p["name"] for scene in scenes for p in scene.values() if _is_named(p))
        known = ", ".join([*held, *materials.load(materials.shipped())])
        remedy = f"known are {known}; or write 'albedo,dmfp' in mm"
        if path is None:
            raise ValueError(f"there is no profile {name!r}; {remedy}")
        raise FileError(path, "", f"there is no profile {name!r}", remedy)
    unlit = {int(key) for scene in scenes for key, p in scene.items() if p is None}
    every = sorted({*ids, *_ids(content, scenes)} - {0})
    return {i: None if i in unlit else d for i in every}


def parse(text: str) -> np.ndarray:
    """Shape parameters from albedo and diffuse mean free path, written as numbers with commas.

    Args:
        text: "albedo,dmfp" for all channels alike, or six numbers "albedo_r,albedo_g,albedo_b,dmfp_r,
            dmfp_g,dmfp_b"; albedo in [0, 1], dmfp in mm, 0 where nothing scatters.

    Returns:
        d in mm, (3,), float64.

    Raises:
        ValueError: not two or six numbers, or one out of its range.

    Source: Christensen and Burley 2015, Eq 8, the configuration of the diffuse mean free path.

    Example:
        >>> parse("0.33,0.33,0.33,7,3.5,1.75")
        array([2. , 1. , 0.5])
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 6):
        raise ValueError(
            "a profile in numbers must be 'albedo,dmfp' or three albedos and three dmfp in mm, "
            f"with commas between, got {text!r}"
        )
    albedo, dmfp = np.broadcast_to(np.reshape(numbers, (2, -1)), (2, 3))
    if not ((albedo >= 0) & (albedo <= 1)).all():
        raise ValueError(f"the albedo of a profile must be in [0, 1], got {text!r}")
    if not ((dmfp >= 0) & np.isfinite(dmfp)).all():
        raise ValueError(f"the dmfp of a profile must be finite and at least 0 mm, got {text!r}")
    with jax.enable_x64(True):
        return np.asarray(burley.shape_from_dmfp(dmfp, albedo))


def _mappings(content: dict, path: Any, reference: str | None) -> Iterator[dict[str, Any]]:
    """The scene's `profiles_by_id`, in the order in which they are asked."""
    references = content.get("references")
    references = references if isinstance(references, dict) else {}
    ordered = {str(n): references[n] for n in (reference, *references) if n in references}
    for where, holder in (*ordered.items(), ("", content)):
        found = holder.get("profiles_by_id") if isinstance(holder, dict) else None
        if found is None:
            continue
        if not isinstance(found, dict) or not all(key.isdecimal() for key in found):
            raise FileError(path, where, "profiles_by_id is no mapping of ids", 'write {"1": {...}}')
        yield found


def _of_top_level(content: dict, name: str, path: Any) -> np.ndarray | None:
    """d of a name that stands at the top level under another id than 1."""
    found = content.get("profiles_by_id") or {}
    return next((_shape(found[key], path, key) for key in found if _bears(found, key, name)), None)


def _of_materials(name: str) -> np.ndarray | None:
    shipped = materials.load(materials.shipped())
    return next((material.d for known, material in shipped.items() if _same(known, name)), None)


def _ids(content: dict, scenes: list[dict[str, Any]]) -> set[int]:
    """Every id that the JSON file tells of."""
    named = content.get("ids")
    keys = {*(named if isinstance(named, dict) else ()), *(key for scene in scenes for key in scene)}
    return {int(key) for key in keys if key.isdecimal()}


def _shape(profile: Any, path: Any, key: str) -> np.ndarray:
    d: Any = profile.get("d") if isinstance(profile, dict) else None
    numbers: list = d if isinstance(d, list) else []
    good = [isinstance(x, int | float) and not isinstance(x, bool) and 0 <= x < math.inf for x in numbers]
    if len(good) != 3 or not all(good):
        problem = f"the profile of id {key} has d = {d!r}"
        raise FileError(path, "", problem, "write d in mm for red, green and blue, each at least 0")
    return np.array(numbers, np.float64)


def _is_named(profile: Any) -> bool:
    return isinstance(profile, dict) and isinstance(profile.get("name"), str)


def _bears(scene: dict[str, Any], key: str, name: str) -> bool:
    profile: Any = scene.get(key)
    return _is_named(profile) and _same(profile["name"], name)


def _same(one: str, other: str) -> bool:
    return one.casefold() == other.casefold()


def _is_numbers(text: str) -> bool:
    """Whether numbers were meant: what no name of a material looks like."""
    return "," in text or text[:1] in (*"0123456789.+-",)
