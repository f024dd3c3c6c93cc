"""Materials from CSV files: the shipped measurements, the derived figures, and every kind of bad file."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files.errors import FileError
from sssfit.profiles import materials

MEASURED = (
    "material,unit,sigma_s_reduced_r,sigma_s_reduced_g,sigma_s_reduced_b,sigma_a_r,sigma_a_g,sigma_a_b,eta"
)
ARTIST = "material,unit,albedo_r,albedo_g,albedo_b,dmfp_r,dmfp_g,dmfp_b"

# Diffuse mean free paths in mm, from the measured coefficients by mpmath, 15 digits.
DMFP = {
    "Apple": (6.96563369717165, 6.40472556450591, 1.91740678346636),
    "Chicken1": (12.1212121212121, 4.37383912516270, 2.02579041820921),
    "Chicken2": (9.83544478606943, 3.75825406468051, 2.10662522117372),
    "Cream": (15.0278272389391, 4.66516100672619, 2.54791267179587),
    "Ketchup": (5.33041330198724, 0.799131398767936, 0.554533089876428),
    "Marble": (8.51348683074304, 5.57052680690682, 3.95592783405846),
    "Potato": (14.2914603735129, 7.27334360499752, 2.21099363614816),
    "Skimmilk": (18.4427411005914, 10.4541456101872, 3.51484720130021),
    "Skin1": (3.74865184675849, 1.47300943364445, 0.784992664855604),
    "Skin2": (4.84980504936570, 1.72904109763851, 1.13007188339128),
    "Spectralon": (np.inf, np.inf, np.inf),
    "Wholemilk": (10.9011646560797, 6.57780681394454, 2.51305334349783),
}

# Entries of the widely printed table that are wrong, as printed: the blue column was computed with sigma_s'
# cut to one decimal, and green and blue of Skin2 with the absorption of Skin1.
MISPRINTED = {
    ("Chicken1", "b"): 2.23,
    ("Chicken2", "b"): 2.16,
    ("Cream", "b"): 2.57,
    ("Ketchup", "b"): 0.56,
    ("Potato", "b"): 2.31,
    ("Skin1", "b"): 0.79,
    ("Skin2", "g"): 1.11,
    ("Skin2", "b"): 0.62,
    ("Wholemilk", "b"): 2.54,
}
# Their relative deviation from the truth, in percent.
DEVIATION = (10.1, 2.5, 0.87, 0.99, 4.5, 0.64, -35.8, -45.1, 1.07)

ETA_REMEDY = "write a number from 0.3 to 3.5, such as 1.3"


@pytest.fixture(scope="module")
def shipped():
    return materials.load(materials.shipped())


@pytest.fixture
def refusal():
    """The message that refuses a file of these lines, less the name of the file."""

    def message(*lines):
        data = lines[0] if isinstance(lines[0], bytes) else "\n".join(lines).encode()
        with pytest.raises(FileError) as caught:
            materials.parse(data, "wax.csv")
        assert str(caught.value).startswith("wax.csv")
        return str(caught.value).removeprefix("wax.csv").removeprefix(", ").removeprefix(": ")

    return message


def test_shipped_dmfp(shipped):
    assert list(shipped) == list(DMFP)
    for name, paths in DMFP.items():
        # As many digits as the figures have.
        np.testing.assert_allclose(shipped[name].dmfp, paths, rtol=5e-15 * 10)


def test_the_misprinted_entries_come_out_right(shipped):
    for ((name, channel), printed), percent in zip(MISPRINTED.items(), DEVIATION, strict=True):
        right = shipped[name].dmfp["rgb".index(channel)]
        assert abs(right - printed) > 0.005 * right
        assert 100 * (printed / right - 1) == pytest.approx(percent, abs=0.05)


def test_the_misprints_are_explained():
    # (material, channel): the coefficients that give the printed figure to its digits.
    causes = {
        ("Chicken1", "b"): (0.3, 0.19),
        ("Chicken2", "b"): (0.3, 0.20),
        ("Cream", "b"): (3.1, 0.0163),
        ("Ketchup", "b"): (0.0, 1.45),
        ("Potato", "b"): (0.5, 0.12),
        ("Skin1", "b"): (1.0, 0.48),
        ("Skin2", "g"): (1.59, 0.17),
        ("Skin2", "b"): (1.7, 0.48),
        ("Wholemilk", "b"): (3.7, 0.014),
    }
    for place, (sigma_s, sigma_a) in causes.items():
        text = f"{MEASURED}\nA,1/mm,{sigma_s},1,1,{sigma_a},1,1,1.3"
        assert materials.parse(text.encode(), "a.csv")["A"].dmfp[0] == pytest.approx(
            MISPRINTED[place], abs=0.005
        )


def test_shipped_albedos(shipped):
    # mpmath: the dipole's closed form.
    assert shipped["Marble"].albedo[1] == pytest.approx(0.79093183364572596, rel=2e-15)
    assert shipped["Skin1"].albedo[0] == pytest.approx(0.43593149517457658, rel=2e-15)
    np.testing.assert_array_equal(shipped["Spectralon"].albedo, 1)
    # The published reflectances have two digits, and Chicken1's blue one is off.
    published = {
        "Apple": (0.85, 0.84, 0.53),
        "Chicken1": (0.31, 0.15, 0.10),
        "Chicken2": (0.32, 0.16, 0.10),
        "Cream": (0.98, 0.90, 0.73),
        "Ketchup": (0.16, 0.01, 0.00),
        "Marble": (0.83, 0.79, 0.75),
        "Potato": (0.77, 0.62, 0.21),
        "Skimmilk": (0.81, 0.81, 0.69),
        "Skin1": (0.44, 0.22, 0.13),
        "Skin2": (0.63, 0.44, 0.34),
        "Spectralon": (1.00, 1.00, 1.00),
        "Wholemilk": (0.91, 0.88, 0.76),
    }
    assert list(published) == list(shipped)
    for name, albedo in published.items():
        differences = np.abs(shipped[name].albedo - albedo)
        if name == "Chicken1":
            assert differences[2] == pytest.approx(0.026, abs=0.001)
            differences = differences[:2]
        assert np.all(differences < 0.0105)


def test_shipped_shapes(shipped):
    for material in shipped.values():
        scaling = 3.5 + 100 * (material.albedo - 0.33) ** 4
        np.testing.assert_allclose(material.d, material.dmfp / scaling, rtol=2e-15)


@pytest.mark.parametrize("flag", [False, True])
def test_results_are_float64_whatever_the_flag(shipped, flag):
    with jax.enable_x64(flag):
        again = materials.load(materials.shipped())
    assert (jax.config.jax_enable_x64) is False  # pyright: ignore[reportAttributeAccessIssue]
    for name, material in again.items():
        for field in ("albedo", "dmfp", "d"):
            values = getattr(material, field)
            assert isinstance(values, np.ndarray)
            assert values.dtype == np.float64 and values.shape == (3,)
            np.testing.assert_array_equal(values, getattr(shipped[name], field))


@given(
    coefficients=st.lists(st.floats(1e-4, 1e2), min_size=6, max_size=6),
    unit=st.sampled_from([("1/cm", 10), ("1/m", 1000)]),
)
def test_units_of_coefficients(coefficients, unit):
    name, factor = unit
    rows = [("In mm", "1/mm", coefficients), ("In other", name, [factor * c for c in coefficients])]
    lines = [f"{material},{unit},{','.join(map(repr, values))},1.4" for material, unit, values in rows]
    read = materials.parse("\n".join([MEASURED, *lines]).encode(), "units.csv")
    for field in ("albedo", "dmfp", "d"):
        values = [getattr(read[material], field) for material in ("In mm", "In other")]
        np.testing.assert_allclose(values[1], values[0], rtol=2e-14)


def test_the_artist_form():
    text = f"{ARTIST},note\nWax,mm,0.9,0.33,0,1,3.5,0.25,soft\nFar,cm,1,1,1,1,2,3,\nDeep,m,1,1,1,1,2,3,\n"
    read = materials.parse(text.encode(), "wax.csv")
    assert list(read) == ["Wax", "Far", "Deep"]
    assert read["Wax"].name == "Wax"
    assert read["Wax"].albedo.tolist() == [0.9, 0.33, 0]
    assert read["Wax"].dmfp.tolist() == [1, 3.5, 0.25]
    # The published example's d, then 3.5 / 3.5 and 0.25 / 4.685921.
    np.testing.assert_allclose(read["Wax"].d, [0.071143990385316563, 1, 0.053351304898225655], rtol=1e-14)
    assert read["Far"].dmfp.tolist() == [10, 20, 30]
    assert read["Deep"].dmfp.tolist() == [1000, 2000, 3000]


def test_a_path_of_zero_is_the_delta():
    read = materials.parse(f"{ARTIST}\nPaint,mm,0.5,0.5,0.5,0,0,1".encode(), "paint.csv")
    assert read["Paint"].dmfp.tolist() == [0, 0, 1]
    assert read["Paint"].d.tolist()[:2] == [0, 0]


def test_no_absorption_is_an_infinite_path(shipped):
    read = materials.parse(f"{MEASURED}\nWhite,1/mm,1,2,0,0,0,0,1.3".encode(), "white.csv")["White"]
    np.testing.assert_array_equal(read.dmfp, np.inf)
    np.testing.assert_array_equal(read.d, np.inf)
    np.testing.assert_array_equal(read.albedo, [1, 1, 0])


def test_spreadsheets_may_quote_pad_and_mark_their_text():
    text = f'\ufeff{ARTIST}\r\n\r\n"Wax", mm ,"0.5",5e-1, .5,1,1,1\r\n,,,,,,,\r\n'
    read = materials.parse(text.encode(), "wax.csv")
    assert list(read) == ["Wax"]
    assert read["Wax"].albedo.tolist() == [0.5, 0.5, 0.5]


@pytest.mark.parametrize("column", MEASURED.split(","))
def test_each_measured_column_is_needed(refusal, column):
    kept = [name for name in MEASURED.split(",") if name != column]
    wanted = MEASURED.replace(",", ", ")
    message = refusal(",".join(kept), ",".join("1" for _ in kept))
    assert message == f"row 1: column {column!r} is missing; the columns are {wanted}"


@pytest.mark.parametrize("column", ARTIST.split(","))
def test_each_artist_column_is_needed(refusal, column):
    kept = [name for name in ARTIST.split(",") if name != column]
    message = refusal(",".join(kept), ",".join("1" for _ in kept))
    assert message == f"row 1: column {column!r} is missing; the columns are {ARTIST.replace(',', ', ')}"


@pytest.mark.parametrize(
    "row, message",
    [
        ("W,1/mm,1,1,-0.5,1,1,1,1.3", "sigma_s_reduced_b is -0.5; a coefficient cannot be negative"),
        ("W,1/mm,1,1,1,-1e-9,1,1,1.3", "sigma_a_r is -1e-09; a coefficient cannot be negative"),
        ("W,mm,1,1,1,1,1,1,1.3", "the unit 'mm' is not known; use one of 1/mm, 1/cm, 1/m"),
        ("W,,1,1,1,1,1,1,1.3", "the unit '' is not known; use one of 1/mm, 1/cm, 1/m"),
        ("W,1/MM,1,1,1,1,1,1,1.3", "the unit '1/MM' is not known; use one of 1/mm, 1/cm, 1/m"),
        (
            "W,1/mm,1,1,1,1,1,1,0",
            "the refractive index eta is 0; write a number from 0.3 to 3.5, such as 1.3",
        ),
        (
            "W,1/mm,1,1,1,1,1,1,-1.3",
            "the refractive index eta is -1.3; write a number from 0.3 to 3.5, such as 1.3",
        ),
        ("W,1/mm,1,1,1,1,1,1,", "column 'eta' has '' where a number belongs; write a number"),
    ],
)
def test_bad_measured_rows(refusal, row, message):
    assert refusal(MEASURED, row) == f"row 2: {message}"


@pytest.mark.parametrize(
    "row, message",
    [
        ("W,1/mm,1,1,1,1,1,1", "the unit '1/mm' is not known; use one of mm, cm, m"),
        ("W,mm,1,1.0001,1,1,1,1", "albedo_g is 1.0001; an albedo lies in [0, 1]"),
        ("W,mm,1,1,-0.1,1,1,1", "albedo_b is -0.1; an albedo cannot be negative"),
        ("W,mm,1,1,1,-1,1,1", "dmfp_r is -1; a path length cannot be negative"),
        ("W,mm,half,1,1,1,1,1", "column 'albedo_r' has 'half' where a number belongs; write a number"),
        ("W,mm,50%,1,1,1,1,1", "column 'albedo_r' has '50%' where a number belongs; write a number"),
        ("W,mm,1,1,1,nan,1,1", "column 'dmfp_r' has 'nan' where a number belongs; write a number"),
        ("W,mm,1,1,1,1,inf,1", "column 'dmfp_g' has 'inf' where a number belongs; write a number"),
        ("W,mm,1,1,1,1,1,1e999", "column 'dmfp_b' has '1e999' where a number belongs; write a number"),
        ("W,mm,1,1,1,1_000,1,1", "column 'dmfp_r' has '1_000' where a number belongs; write a number"),
        ("W,mm,1,1,1,1,1", "7 cells for 8 columns; write one cell per column"),
        ("W,mm,0,5,1,1,1,1,1", "9 cells for 8 columns; write one cell per column"),
    ],
)
def test_bad_artist_rows(refusal, row, message):
    good = "Good,mm,1,1,1,1,1,1"
    assert refusal(ARTIST, row) == f"row 2: {message}"
    # Blank lines count as lines, so that the row is where an editor shows it.
    assert refusal(ARTIST, good, "", row, good) == f"row 4: {message}"


@pytest.mark.parametrize(
    "name",
    [
        "",
        "../secret",
        "a/b",
        "a\\b",
        ".hidden",
        "con:",
        "Wax.",
        "-wax",
        "_wax",
        "Käse",
        "wa\0x",
        "2Wax",
        "a" * 65,
    ],
)
def test_names_must_be_fit_for_a_folder(refusal, name):
    message = refusal(ARTIST, f"{name},mm,1,1,1,1,1,1")
    assert message == (
        f"row 2: the material name {name!r} cannot name a folder and a variable; use up to 64 letters "
        "a to z, digits, spaces, '_' and '-', beginning with a letter and ending with a letter or digit"
    )


@pytest.mark.parametrize("again", ["Wax 1", "wax 1", "WAX_1"])
def test_repeated_materials(refusal, again):
    message = refusal(ARTIST, "Wax 1,mm,1,1,1,1,1,1", f"{again},mm,1,1,1,1,1,1")
    assert message == f"row 3: the material {again!r} stands there twice; give each row its own name"


def test_files_that_are_no_table(refusal):
    empty = "the file is empty; write a header line and one row per entry"
    assert refusal(b"") == empty
    assert refusal("", " ", ",,") == empty
    no_rows = "there is a header but no data row; add one row per entry"
    assert refusal(MEASURED) == no_rows
    assert refusal(ARTIST, "", ",,,,,,,") == no_rows
    latin = f"{ARTIST}\nW\xe4chs,mm,1,1,1,1,1,1".encode("latin-1")
    assert refusal(latin) == "this is not UTF-8 text; save it as CSV in UTF-8"
    twice = refusal(f"{ARTIST},dmfp_b", "W,mm,1,1,1,1,1,1,1")
    assert twice == "row 1: column 'dmfp_b' stands there twice; keep one of them"


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(FileError, match=r"no\.csv: there is no such file; check the path"):
        materials.load(tmp_path / "no.csv")
    with pytest.raises(FileError, match="cannot be read .*; check the path and its permissions"):
        materials.load(tmp_path)


def test_messages_name_the_file_without_its_folder(tmp_path):
    path = tmp_path / "wax.csv"
    path.write_text(f"{ARTIST}\nW,mm,2,1,1,1,1,1\n", encoding="utf-8")
    with pytest.raises(FileError, match=r"^wax\.csv, row 2: albedo_r is 2; an albedo lies in \[0, 1\]$"):
        materials.load(path)


def test_a_text_path_will_do(shipped):
    assert list(materials.load(str(materials.shipped()))) == list(shipped)
