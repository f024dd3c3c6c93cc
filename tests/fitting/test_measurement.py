"""Curves from files that people have: what is read, and what each refusal says."""

import numpy as np
import pytest

from sssfit.files.errors import FileError
from sssfit.files.exr import encode_exr
from sssfit.fitting import measurement, measurement_image
from sssfit.fitting.measurement import load, parse
from sssfit.fitting.measurement_image import load_image

COLUMNS = (
    "the columns are r_mm, R or R_r, R_g, R_b, and sigma or sigma_r, sigma_g, sigma_b if the noise is known"
)


def test_one_curve_without_noise():
    found = parse(b"\xef\xbb\xbf R , r_mm\n0.2,0.5\n\n0.05,1\n", "wax.csv")
    assert found.r.tolist() == [0.5, 1] and found.values.tolist() == [[0.2], [0.05]]
    assert found.sigma is None and found.channels == ("",) and found.notes == ()


def test_three_curves_with_one_sigma_and_with_three():
    one = parse(b"r_mm,R_r,R_g,R_b,sigma\n1,3,2,1,0.1\n2,2,1,0,0.2\n", "wax.csv")
    assert one.channels == ("r", "g", "b") and one.sigma is not None
    assert one.sigma.tolist() == [[0.1] * 3, [0.2] * 3]
    each = parse(b"r_mm,R_r,R_g,R_b,sigma_b,sigma_g,sigma_r\n1,3,2,1,0.1,0.2,0.3\n", "wax.csv")
    assert each.sigma is not None and each.sigma.tolist() == [[0.3, 0.2, 0.1]]


def test_a_file_is_read_and_named_without_its_folder(tmp_path):
    path = tmp_path / "wax.csv"
    path.write_text("r_mm,R\n1,x\n")
    with pytest.raises(FileError, match=r"^wax.csv, row 2: column 'R' has 'x' where a number belongs"):
        load(path)


def test_negative_values_within_the_noise_are_data():
    assert parse(b"r_mm,R,sigma\n1,3,0.1\n2,-0.4,0.1\n", "a.csv").values[1, 0] == -0.4


def test_distances_of_lines_and_edges_have_a_sign():
    data = b"r_mm,R\n-1,0.9\n0,0.5\n1,0.1\n"
    for response in ("line", "edge"):
        assert parse(data, "a.csv", response=response).r.tolist() == [-1, 0, 1]


BAD = {
    "no unit": ("r,R\n1,1", "row 1: column 'r' is a distance without a unit; name it 'r_mm' and write mill"),
    "cm": ("r_cm,R\n1,1", "row 1: column 'r_cm' is a distance in another unit than mm; name it 'r_mm'"),
    "um": ("distance_um,R\n1,1", "row 1: column 'distance_um' is a distance in another unit than mm"),
    "no distance": ("t,R\n1,1", f"row 1: there is no column 'r_mm'; {COLUMNS}"),
    "semicolons": ("r_mm;R\n1;1", "row 1: there is no column 'r_mm'; put commas between columns"),
    "no R": ("r_mm,value\n1,1", f"row 1: there is no column 'R'; {COLUMNS}"),
    "no green": ("r_mm,R_r,R_b\n1,1,1", f"row 1: there is no column 'R_g'; {COLUMNS}"),
    "unknown": ("r_mm,R,weight\n1,1,1", f"row 1: column 'weight' is not known beside 'R'; {COLUMNS}"),
    "both": ("r_mm,R,R_r,R_g,R_b\n1,1,1,1,1", "row 1: column 'R' is not known beside 'R_r'"),
    "sigma of red": (
        "r_mm,R,sigma_r\n1,1,1",
        "row 1: column 'sigma_r' does not go with 'R'; call what goes with it 'sigma'",
    ),
    "two sigmas": (
        "r_mm,R_r,R_g,R_b,sigma_r,sigma_g\n1,1,1,1,1,1",
        "row 1: column 'sigma_g' does not go with 'R_r'; call what goes with it 'sigma', or 'sigma_r'",
    ),
    "twice": ("r_mm,R,R\n1,1,1", "row 1: column 'R' stands there twice; keep one of them"),
    "unsorted": ("r_mm,R\n1,1\n3,1\n2,1", "row 4: r_mm 2 follows 3; sort the rows by their distance"),
    "repeated": ("r_mm,R\n1,1\n1,1", "row 3: r_mm 1 stands there twice; keep one row for each distance"),
    "negative r": ("r_mm,R\n-1,1\n1,1", "row 2: r_mm is -1; a distance from a point is at least 0"),
    "text": ("r_mm,R\n1,one", "row 2: column 'R' has 'one' where a number belongs; write a number"),
    "nan": ("r_mm,R\n1,1\n2,nan", "row 3: column 'R' has 'nan' where a number belongs; write a number"),
    "inf": ("r_mm,R\ninf,1", "row 2: column 'r_mm' has 'inf' where a number belongs; write a number"),
    "sigma 0": ("r_mm,R,sigma\n1,1,0", "row 2: sigma is 0; write a standard deviation above 0, or leave"),
    "sigma below 0": ("r_mm,R,sigma\n1,1,1\n2,1,-1", "row 3: sigma is -1; write a standard deviation"),
    "all zero": ("r_mm,R_r,R_g,R_b\n1,1,0,1", "column 'R_g': no value is above 0; write what was measured"),
    "all negative": ("r_mm,R\n1,-1\n2,-1", "column 'R': no value is above 0; write what was measured"),
    "negative": ("r_mm,R\n1,1\n2,-0.1", "row 3: R is -0.1, below 0; give its sigma if that is noise"),
    "too negative": ("r_mm,R,sigma\n1,1,0.1\n2,-1,0.1", "row 3: R is -1, below 0 by more than noise;"),
    "short row": ("r_mm,R\n1", "row 2: 1 cells for 2 columns; write one cell per column"),
    "empty": ("", "the file is empty; write a header line"),
    "header": ("r_mm,R", "there is a header but no data row; add one row per entry"),
}


@pytest.mark.parametrize("text, message", BAD.values(), ids=list(BAD))
def test_each_fault_is_named_by_its_place(text, message):
    with pytest.raises(FileError) as caught:
        parse(text.encode(), "wax.csv")
    told = str(caught.value)
    assert told.removeprefix("wax.csv").lstrip(":, ").startswith(message) and "\n" not in told


def test_a_beam_has_no_distance_below_0_and_an_edge_its_light_there():
    with pytest.raises(FileError, match="row 2: r_mm is -1; a distance from a beam's centre is at least 0"):
        parse(b"r_mm,R\n-1,1\n1,1\n", "a.csv", response="beam")
    with pytest.raises(FileError, match="larger at distances above 0.*; change the signs of all distances"):
        parse(b"r_mm,R\n-1,0.1\n1,0.9\n", "a.csv", response="edge")


def image(tmp_path, channels, name="image.exr"):
    path = tmp_path / name
    path.write_bytes(encode_exr(channels, {}))
    return path


def distances(height, width, center):
    y, x = np.mgrid[:height, :width] + 0.5
    return np.hypot(x - center[0], y - center[1])


def test_rings_have_the_means_and_the_noise_that_is_there(tmp_path):
    random, r = np.random.default_rng(3), distances(90, 120, (50, 40))
    # Skewed noise, as renderers make it.
    shown = np.exp(-r / 20) * random.gamma(4, 1 / 4, size=r.shape)
    found = load_image(
        image(tmp_path, {"Y": (5 * shown).astype(np.float32)}),
        pixel_mm=0.25, response="radial", center=(50, 40), irradiance=5,
    )  # fmt: skip
    assert found.channels == ("",) and found.sigma is not None
    assert 400 < len(found.r) <= measurement_image.MOST_RINGS and np.all(np.diff(found.r) > 0)
    assert found.r[0] < 0.25 * 3 and found.r[-1] <= 0.25 * r.max()
    z = (found.values - np.exp(-found.r / 5)[:, None]) / found.sigma
    assert abs(z.mean()) < 0.1 and z.std() == pytest.approx(1, abs=0.1)
    # Weights from the scatter must not pull the mean down.
    truth = np.exp(-found.r / 5)[:, None]
    weights = np.square(truth / found.sigma)
    ratio = np.sum(weights * found.values / truth) / np.sum(weights)
    assert ratio == pytest.approx(1, abs=4 * 0.5 / np.sqrt(r.size))


def test_equal_pixels_know_rounding_alone(tmp_path):
    for dtype, digits in ((np.float16, 11), (np.float32, 24)):
        found = load_image(image(tmp_path, {"Y": np.ones((32, 32), dtype)}), pixel_mm=1, response="radial")
        assert found.sigma is not None
        assert np.all(found.sigma > 2.0**-digits / 2) and np.all(found.sigma <= 0.1)


def test_darkness_has_the_noise_of_the_least_light(tmp_path):
    shown = np.where(distances(64, 64, (32, 32)) < 12, 2, 0).astype(np.float32)
    found = load_image(image(tmp_path, {"Y": shown}), pixel_mm=1, response="beam")
    assert found.sigma is not None
    dark = found.r > 20
    assert not found.values[dark].any() and np.all(found.sigma[dark] > 0.01)


def test_pixels_that_are_no_numbers_are_left_out(tmp_path):
    shown = np.ones((32, 32), np.float32)
    shown[3, :5], shown[20, 7] = np.nan, np.inf
    found = load_image(image(tmp_path, {"Y": shown}), pixel_mm=1, response="radial")
    assert np.all(found.values == 1)
    assert found.notes == ("6 pixels that are NaN or infinite are left out",)
    with pytest.raises(FileError, match="no pixel holds finite numbers; render it again"):
        load_image(image(tmp_path, {"Y": np.full((8, 8), np.nan, np.float32)}), pixel_mm=1, response="radial")


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("flip", [False, True])
def test_lines_and_edges_along_both_axes(tmp_path, axis, flip):
    along = (np.arange(40) + 0.5 - 10) * 0.5
    lit = (along < 0) != flip
    noise = np.random.default_rng(5).normal(scale=0.01, size=(30, 40))
    shown = np.where(lit, 1.0, 0.2) + noise
    shown[:, 3] = np.nan
    pixels = (shown if axis == "x" else shown.T).astype(np.float32)
    path = image(tmp_path, {f"light.{c}": pixels * k for c, k in zip("RGB", (1, 2, 3), strict=True)})
    given = {"pixel_mm": 0.5, "axis": axis, "center": (10, 10), "response": "edge"}
    found = load_image(path, **given, flip=flip)
    assert found.channels == ("r", "g", "b") and found.sigma is not None
    expected = np.sort(np.delete(along, 3) * (-1 if flip else 1))
    np.testing.assert_allclose(found.r, expected)
    np.testing.assert_allclose(found.values[:, 1], np.where(found.r < 0, 2, 0.4), atol=0.02)
    np.testing.assert_allclose(found.sigma[:, 0], 0.01 / np.sqrt(30), rtol=0.3)
    with pytest.raises(
        FileError, match=r"brighter side of the edge lies above 0; turn it by flip \(--flip\)"
    ):
        load_image(path, **given, flip=not flip)


def test_few_rows_do_not_know_their_noise(tmp_path):
    path = image(tmp_path, {"Y": np.ones((15, 8), np.float32)})
    assert load_image(path, pixel_mm=1, response="line").sigma is None


def test_layers_are_found(tmp_path):
    one, two = np.ones((32, 32), np.float32), np.full((32, 32), 2, np.float32)
    colours = (
        {c: one for c in "RGB"} | {f"sss.{c}": two for c in "RGB"} | {"A": one, "id": one.astype(np.uint32)}
    )
    path, given = image(tmp_path, colours), {"pixel_mm": 1, "response": "radial"}
    assert load_image(path, **given).values[0].tolist() == [1, 1, 1]
    assert load_image(path, **given, layer="sss").values[0].tolist() == [2, 2, 2]
    assert load_image(path, **given, layer="sss.R").values[0].tolist() == [2]
    with pytest.raises(
        FileError, match="there is no layer 'diff'; name one of its layers by .*: R, G, B, sss"
    ):
        load_image(path, **given, layer="diff")
    with pytest.raises(FileError, match="layer id: holds whole numbers; give a layer of light"):
        load_image(path, **given, layer="id")
    both = image(tmp_path, {f"{layer}.{c}": one for layer in ("sss", "diff") for c in "RGB"}, "both.exr")
    with pytest.raises(FileError, match="it is not clear which layer is meant; .*: diff, sss"):
        load_image(both, **given)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"pixel_mm": 0}, "pixel_mm must be above 0, got 0"),
        ({"pixel_mm": np.inf}, "pixel_mm must be above 0, got inf"),
        ({"irradiance": -1}, "irradiance must be above 0, got -1"),
        ({"axis": "z"}, "axis must be x or y, got 'z'"),
        ({"center": (1, np.nan)}, r"center must be two finite numbers of pixels, got \(1, nan\)"),
    ],
)
def test_numbers_out_of_their_domain(tmp_path, change, message):
    path = image(tmp_path, {"Y": np.ones((32, 32), np.float32)})
    with pytest.raises(ValueError, match=f"^{message}$"):
        load_image(path, **({"pixel_mm": 1, "response": "line"} | change))


def test_images_without_light_or_size(tmp_path):
    with pytest.raises(FileError, match="a channel is nowhere above 0; give an image of the light"):
        load_image(image(tmp_path, {"Y": np.zeros((8, 8), np.float32)}), pixel_mm=1, response="radial")
    with pytest.raises(FileError, match="too few pixels are left to see a profile in; give a larger image"):
        load_image(image(tmp_path, {"Y": np.ones((4, 4), np.float32)}), pixel_mm=1, response="radial")
    (tmp_path / "no.exr").write_text("r_mm,R\n")
    with pytest.raises(FileError, match="no.exr: is not an EXR image"):
        load_image(tmp_path / "no.exr", pixel_mm=1, response="radial")


def test_only_an_edge_can_be_turned():
    rising = measurement.Measurement(np.array([-1.0, 1.0]), np.array([[0.1], [0.9]]), None, ("",))
    assert measurement.is_turned(rising, "edge") and not measurement.is_turned(rising, "line")
    assert not measurement.is_turned(rising._replace(r=np.array([1.0, 2.0])), "edge")
