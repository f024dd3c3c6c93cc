"""Names of profiles: the scene's own come first, then shipped materials and numbers."""

import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files.errors import FileError
from sssfit.frames import scene_profiles
from sssfit.profiles import materials


def named(name, *d):
    return {"name": name, "A": [0.5] * 3, "l": [9.0] * 3, "d": list(d)}


WAX, INK, SNOW = named("wax", 1, 2, 3), named("ink", 4, 5, 6), named("snow", 7, 8, 9)
SCENE = {
    "ids": {"1": "one", "2": "two", "3": "ground"},
    "profiles_by_id": {"1": SNOW, "2": INK, "3": None},
    "references": {
        "ref_wax.exr": {"profiles_by_id": {"1": WAX, "2": INK, "3": None}},
        "ref_ink.exr": {"profiles_by_id": {"1": INK, "2": WAX, "3": None}},
        "other_wax.exr": {"profiles_by_id": {"1": named("wax", 10, 20, 30), "3": None}},
        "without.exr": {"samples_per_pixel": 3},
    },
}


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(SCENE))
    return path


def plain(found):
    return {number: None if d is None else d.tolist() for number, d in found.items()}


@pytest.mark.parametrize(
    ("name", "reference", "expected"),
    [
        # The first reference whose id 1 bears the name.
        ("wax", None, {1: [1, 2, 3], 2: [4, 5, 6], 3: None}),
        ("Wax", None, {1: [1, 2, 3], 2: [4, 5, 6], 3: None}),
        ("ink", None, {1: [4, 5, 6], 2: [1, 2, 3], 3: None}),
        # The given one, if its id 1 does.
        ("wax", "other_wax.exr", {1: [10, 20, 30], 3: None}),
        ("wax", "elsewhere/other_wax.exr", {1: [10, 20, 30], 3: None}),
        ("ink", "ref_wax.exr", {1: [4, 5, 6], 2: [1, 2, 3], 3: None}),
        ("wax", "without.exr", {1: [1, 2, 3], 2: [4, 5, 6], 3: None}),
        ("wax", "unknown.exr", {1: [1, 2, 3], 2: [4, 5, 6], 3: None}),
        # No reference's id 1: the top level.
        ("snow", "ref_wax.exr", {1: [7, 8, 9], 2: [4, 5, 6], 3: None}),
        # Numbers and materials are for all that scatters.
        ("0.33,7", None, {1: [2, 2, 2], 2: [2, 2, 2], 3: None}),
    ],
)
def test_where_a_name_is_looked_up(scene, name, reference, expected):
    found = scene_profiles.by_id(scene, name, reference)
    assert plain(found) == expected
    assert all(d is None or (d.dtype == np.float64 and d.shape == (3,)) for d in found.values())


def test_a_name_of_the_top_level_at_another_id(scene):
    content = {name: SCENE[name] for name in ("ids", "profiles_by_id")}
    scene.write_text(json.dumps(content))
    assert plain(scene_profiles.by_id(scene, "ink")) == {1: [4, 5, 6], 2: [4, 5, 6], 3: None}


def test_shipped_materials_come_last(scene):
    marble = materials.load(materials.shipped())["Marble"].d.tolist()
    assert plain(scene_profiles.by_id(scene, "marble")) == {1: marble, 2: marble, 3: None}
    assert plain(scene_profiles.by_id(scene, "marble", ids=(7, 0))) == {
        1: marble,
        2: marble,
        3: None,
        7: marble,
    }
    assert plain(scene_profiles.by_id(None, "Marble")) == {1: marble}
    assert plain(scene_profiles.by_id(None, "marble", ids=[4, 5])) == {4: marble, 5: marble}
    scene.write_text(
        json.dumps({"references": {"a.exr": {"profiles_by_id": {"1": named("Marble", 1, 1, 1)}}}})
    )
    assert plain(scene_profiles.by_id(scene, "marble")) == {1: [1, 1, 1]}


def test_a_file_that_tells_of_no_profile(scene):
    scene.write_text('{"width": 3, "height": 2, "fx": 1}')
    assert list(scene_profiles.by_id(scene, "Apple", ids=(2, 1))) == [1, 2]


COLOURS = st.tuples(*[st.floats(0, 1)] * 3)
LENGTHS = st.tuples(*[st.just(0.0) | st.floats(1e-9, 1e3)] * 3)


@given(COLOURS, LENGTHS)
def test_numbers_are_albedo_and_dmfp(albedo, dmfp):
    found = scene_profiles.parse(",".join(map(str, (*albedo, *dmfp))))
    expected = [path / (3.5 + 100 * (a - 0.33) ** 4) for a, path in zip(albedo, dmfp, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    grey = scene_profiles.parse(f" {albedo[0]} , {dmfp[0]} ")
    np.testing.assert_array_equal(grey, [found[0]] * 3)


SHAPE = (
    "a profile in numbers must be 'albedo,dmfp' or three albedos and three dmfp in mm, "
    "with commas between, got"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0.5,2,3", f"{SHAPE} '0.5,2,3'"),
        ("0.5", f"{SHAPE} '0.5'"),
        ("0.5,,3", f"{SHAPE} '0.5,,3'"),
        ("0.1,0.2,0.3,1,2,x", f"{SHAPE} '0.1,0.2,0.3,1,2,x'"),
        ("1.1,2", "the albedo of a profile must be in [0, 1], got '1.1,2'"),
        ("nan,2", "the albedo of a profile must be in [0, 1], got 'nan,2'"),
        ("0.5,-1", "the dmfp of a profile must be finite and at least 0 mm, got '0.5,-1'"),
        ("0.5,inf", "the dmfp of a profile must be finite and at least 0 mm, got '0.5,inf'"),
        ("0.5,nan", "the dmfp of a profile must be finite and at least 0 mm, got '0.5,nan'"),
    ],
)
def test_numbers_that_are_none(scene, text, message):
    for path in (scene, None):
        with pytest.raises(ValueError, match=re.escape(message)):
            scene_profiles.by_id(path, text)


def test_unknown_names_list_the_known(scene):
    shipped = ", ".join(materials.load(materials.shipped()))
    message = f"there is no profile 'jade'; known are wax, ink, snow, {shipped}; or write 'albedo,dmfp' in mm"
    with pytest.raises(FileError) as caught:
        scene_profiles.by_id(scene, "jade")
    assert str(caught.value) == f"{scene}: {message}"
    with pytest.raises(ValueError, match=f"there is no profile 'jade'; known are {shipped}; or write"):
        scene_profiles.by_id(None, "jade")


@pytest.mark.parametrize("d", [None, 3, [1, 2], [1, 2, -3], [1, 2, "x"], [1, 2, True], [1, 2, 3, 4]])
def test_profiles_without_d(scene, d):
    scene.write_text(json.dumps({"profiles_by_id": {"1": {"name": "wax", "d": d}}}))
    remedy = "write d in mm for red, green and blue, each at least 0"
    with pytest.raises(FileError) as caught:
        scene_profiles.by_id(scene, "wax")
    assert str(caught.value) == f"{scene}: the profile of id 1 has d = {d!r}; {remedy}"


@pytest.mark.parametrize("found", [[], {"one": WAX}, 3])
def test_mappings_that_are_none(scene, found):
    scene.write_text(json.dumps({"references": {"a.exr": {"profiles_by_id": found}}}))
    with pytest.raises(FileError) as caught:
        scene_profiles.by_id(scene, "wax")
    assert str(caught.value) == f'{scene}, a.exr: profiles_by_id is no mapping of ids; write {{"1": {{...}}}}'


@pytest.mark.parametrize("content", ["[]", "3", "{}"])
def test_other_json(scene, content):
    scene.write_text(content)
    with pytest.raises(FileError, match="there is no profile 'wax'"):
        scene_profiles.by_id(scene, "wax")


# As the scenes' description prints them, to 1e-5 mm.
SKIN1, MARBLE = [1.91785, 0.47946, 0.20352], [7.92993, 5.01644, 3.40885]


@pytest.mark.parametrize(
    ("folder", "name", "reference", "expected"),
    [
        ("s1_beam", "skin1", None, {1: SKIN1}),
        ("s1_beam", "marble", "exact_marble.exr", {1: MARBLE}),
        ("s2_head", "skin1", "exact_skin1.exr", {1: SKIN1, 2: MARBLE, 3: None}),
        ("s2_head", "marble", None, {1: MARBLE, 2: SKIN1, 3: None}),
        ("s3_skull", "marble", None, {1: MARBLE, 3: None}),
        ("s4_patch", "skin1", None, {1: SKIN1}),
        ("s5_flash", "skin1", "exact_skin1_12.exr", {1: SKIN1}),
    ],
)
def test_profiles_of_rendered_scenes(rendered, folder, name, reference, expected):
    found = scene_profiles.by_id(rendered / folder / "camera.json", name, reference)
    assert set(found) == set(expected)
    for number, d in expected.items():
        if d is None:
            assert found[number] is None
        else:
            np.testing.assert_allclose(np.asarray(found[number]), d, rtol=0, atol=6e-6)
