"""Intensities over time: formulas, shipped files, interpolation, and every fault named by its place."""

import csv
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.files.errors import FileError
from sssfit.scenarios import light

rates = st.floats(1.0, 1000.0)
depths = st.floats(0, 1)

# Ten seconds at 60 frames a second.
SHIPPED_FRAMES = 600


@pytest.fixture
def written(tmp_path):
    """Write a file of intensities; rows of numbers or text."""

    def write(text, name="light.csv"):
        path = tmp_path / name
        path.write_text(text if isinstance(text, str) else "\n".join(["time,intensity", *text]))
        return path

    return write


def refusal(path, frames=1, fps=60.0):
    with pytest.raises(FileError) as caught:
        light.load(path, frames, fps=fps)
    return str(caught.value)


# Formulas


@given(fps=rates, frequency=st.floats(0, 100), depth=depths)
def test_sine(fps, frequency, depth):
    found = light.sine(50, fps=fps, frequency=frequency, depth=depth)
    expected = [1 + depth * math.sin(2 * math.pi * frequency * (i / fps)) for i in range(50)]
    # The phase, up to 5000 cycles, is rounded a few times.
    assert found == pytest.approx(
        expected, abs=depth * 4 * 2 * math.pi * frequency * 50 / fps * 2**-52 + 1e-15
    )
    assert found.dtype == np.float64 and np.all(found >= 0)


@given(fps=st.integers(1, 240), frequency=st.integers(0, 20), depth=depths)
def test_on_off_switches_on_the_frame(fps, frequency, depth):
    found = light.on_off(100, fps=fps, frequency=frequency, depth=depth)
    # In whole numbers: the half cycle of frame i is floor(2 i f / fps).
    expected = [1.0 if (2 * i * frequency // fps) % 2 == 0 else 1 - depth for i in range(100)]
    assert found.tolist() == expected


def test_lights_at_rest():
    assert light.static(4).tolist() == [1.0] * 4
    assert light.sine(5, frequency=0.0).tolist() == [1.0] * 5
    assert light.sine(5, depth=0.0).tolist() == [1.0] * 5
    assert light.on_off(5, frequency=0.0).tolist() == [1.0] * 5
    assert light.static(4).dtype == light.on_off(4).dtype == np.float64


def test_light_goes_out_and_never_below():
    # At depth 1 the sine touches 0 at three quarters of a cycle, where rounding could go below.
    found = light.sine(10_000, fps=4.0, frequency=1.0, depth=1.0)
    assert found.min() == 0.0 and found[3] == pytest.approx(0, abs=1e-15)
    assert light.on_off(60, frequency=1.0).sum() == 30


# Shipped files


@pytest.mark.parametrize("name", light.LIGHTS)
def test_shipped_files_are_ten_seconds_at_60_frames(name):
    with open(light.shipped(name), newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == ["time", "intensity"] and len(rows) == 1 + SHIPPED_FRAMES
    found = np.array(rows[1:], float)
    # Six decimals.
    assert found[:, 0] == pytest.approx(np.arange(SHIPPED_FRAMES) / 60, abs=5.1e-7)
    if name != "candle":
        assert found[:, 1] == pytest.approx(light.LIGHTS[name](SHIPPED_FRAMES), abs=5.1e-7)


@pytest.mark.parametrize("name", light.LIGHTS)
def test_loading_a_shipped_file_gives_the_function(name):
    found = light.load(light.shipped(name), SHIPPED_FRAMES)
    expected = light.LIGHTS[name](SHIPPED_FRAMES)
    # The file's times are within 5e-7 s of the frames', so that a neighbour weighs up to 60 times that.
    slope = 60 * np.abs(np.diff(np.append(expected, expected[0]), prepend=expected[-1:])).max()
    assert found == pytest.approx(expected, abs=5.1e-7 * (1 + slope))


def test_a_lamp_that_is_switched_off_is_off():
    # Loaded from its file, the shipped switch is black in as many frames as the formula has it.
    assert np.sum(light.load(light.shipped("on_off"), SHIPPED_FRAMES) == 0) == 300


def test_the_candle_has_mean_1_and_flickers():
    found = light.candle(SHIPPED_FRAMES)
    # Of 600 numbers of six decimals.
    assert found.mean() == pytest.approx(1, abs=2e-6)
    assert np.all(found > 0) and found.std() > 0.05
    assert np.array_equal(found, light.load(light.shipped("candle"), SHIPPED_FRAMES))


@pytest.mark.parametrize("name", light.LIGHTS)
def test_lights_begin_anew_after_ten_seconds(name):
    found = light.load(light.shipped(name), 2 * SHIPPED_FRAMES + 30)
    # Ten seconds to within 1e-6 of one, in which the light may change by its steepest step.
    steepest = np.abs(np.diff(found[:SHIPPED_FRAMES])).max()
    assert found[SHIPPED_FRAMES : 2 * SHIPPED_FRAMES] == pytest.approx(
        found[:SHIPPED_FRAMES], abs=60e-6 * steepest + 1e-12
    )
    assert found[-30:] == pytest.approx(found[:30], abs=120e-6 * steepest + 1e-12)


def test_unknown_lights():
    with pytest.raises(ValueError, match="light must be one of static, sine, on_off, candle, got 'moon'"):
        light.shipped("moon")


# Loading


def test_between_the_times_light_is_interpolated(written):
    path = written(["0,0", "0.5,1", "1,3"])
    # Steps of 1/2: a period of 1.5, and back to the first intensity in the last step.
    found = light.load(path, 13, fps=8.0)
    expected = [0, 0.25, 0.5, 0.75, 1, 1.5, 2, 2.5, 3, 2.25, 1.5, 0.75, 0]
    assert found.tolist() == pytest.approx(expected, abs=1e-15)
    assert found.dtype == np.float64


@given(
    intensities=st.lists(st.floats(0, 10), min_size=2, max_size=6),
    step=st.floats(0.01, 2),
    fps=st.floats(1, 100),
)
def test_any_file_by_hand(tmp_path, intensities, step, fps):
    path = tmp_path / "light.csv"
    times = [i * step for i in range(len(intensities))]
    rows = [f"{t!r},{v!r}" for t, v in zip(times, intensities, strict=True)]
    path.write_text("\n".join(["time,intensity", *rows]))
    found = light.load(path, 40, fps=fps)
    for frame, value in enumerate(found):
        place = frame / fps / step % len(intensities)
        below = int(place)
        first, second = (intensities[i % len(intensities)] for i in (below, below + 1))
        # The place has up to 40 / (fps step) cycles of rounding, 4000 at most, times the steepest slope.
        expected = first + (place - below) * (second - first)
        assert value == pytest.approx(expected, abs=1e-10)


def test_resampling_at_another_rate(written):
    # At twice the rate every other frame is that of the file.
    path = written([f"{i / 32!r},{(i * 7) % 5}" for i in range(64)])
    own, finer = light.load(path, 64, fps=32.0), light.load(path, 128, fps=64.0)
    assert own.tolist() == [(i * 7) % 5 for i in range(64)]
    assert finer[::2].tolist() == own.tolist()
    assert finer[1::2].tolist() == ((own + np.roll(own, -1)) / 2).tolist()
    assert light.load(path, 32, fps=16.0).tolist() == own[::2].tolist()


def test_a_single_row_is_light_that_stays(written):
    assert light.load(written(["0,0.7"]), 3).tolist() == [0.7] * 3


def test_other_columns_and_order(written):
    path = written("note, intensity ,time\nfirst, 2 ,0\nsecond, 4 , 1\n")
    assert light.load(path, 2, fps=2.0).tolist() == [2.0, 3.0]
    time, intensity = light.read_columns(path, "time", "intensity")
    assert time.tolist() == [0, 1] and intensity.tolist() == [2, 4]


# Faults


@pytest.mark.parametrize(
    "rows, message",
    [
        (["0.1,1"], "row 2: time begins with 0.1; begin with 0"),
        (["0,1", "0,2"], "row 3: time does not rise; sort the rows and keep one of each"),
        (["0,1", "1,2", "0.5,2"], "row 4: time does not rise; sort the rows and keep one of each"),
        (["0,1", "1,-0.5"], "row 3: intensity is -0.5; write a number of at least 0"),
        (["0,1", "1,nan"], "row 3: column 'intensity' has 'nan' where a number belongs; write a number"),
        (["0,1", "inf,1"], "row 3: column 'time' has 'inf' where a number belongs; write a number"),
        (["0,"], "row 2: column 'intensity' has '' where a number belongs; write a number"),
        (["0,bright"], "row 2: column 'intensity' has 'bright' where a number belongs; write a number"),
        (["0,1", "1"], "row 3: 1 cells for 2 columns; write one cell per column"),
        (["0,1,2"], "row 2: 3 cells for 2 columns; write one cell per column"),
        (["0,1", "", "", "1,-1"], "row 5: intensity is -1; write a number of at least 0"),
        (["", "0.5,1"], "row 3: time begins with 0.5; begin with 0"),
    ],
)
def test_faults_in_rows(written, rows, message):
    assert refusal(written(rows)) == f"light.csv, {message}"


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "light.csv: the file is empty; write a header line and one row per entry"),
        ("time,intensity\n", "light.csv: there is a header but no data row; add one row per entry"),
        ("seconds,intensity\n0,1\n", "light.csv, row 1: there is no column 'time'; name one of them 'time'"),
        ("time,lux\n0,1\n", "light.csv, row 1: there is no column 'intensity'; name one of them 'intensity'"),
        ("time,time\n0,1\n", "light.csv, row 1: column 'time' stands there twice; keep one of them"),
    ],
)
def test_faults_of_files(written, text, message):
    assert refusal(written(text)) == message


def test_a_file_that_is_not_there(tmp_path):
    path = tmp_path / "none.csv"
    assert refusal(path) == f"{path}: there is no such file; check the path"


@pytest.mark.parametrize("name", light.LIGHTS)
@pytest.mark.parametrize(
    "frames, fps, message",
    [
        (0, 60.0, "frames must be at least 1, got 0"),
        (-3, 60.0, "frames must be at least 1, got -3"),
        (3, 0.0, "fps must be above 0, got 0.0"),
        (3, -1.0, "fps must be above 0, got -1.0"),
        (3, math.nan, "fps must be above 0, got nan"),
        (3, math.inf, "fps must be above 0, got inf"),
    ],
)
def test_faults_of_frames(name, frames, fps, message):
    with pytest.raises(ValueError, match=message):
        light.LIGHTS[name](frames, fps=fps)
    with pytest.raises(ValueError, match=message):
        light.load(light.shipped(name), frames, fps=fps)


@pytest.mark.parametrize("name", ["sine", "on_off"])
@pytest.mark.parametrize(
    "fault, message",
    [
        ({"frequency": -1.0}, "frequency must be at least 0, got -1.0"),
        ({"frequency": math.inf}, "frequency must be at least 0, got inf"),
        ({"frequency": math.nan}, "frequency must be at least 0, got nan"),
        ({"depth": -0.1}, r"depth must be in \[0, 1\], got -0.1"),
        ({"depth": 1.1}, r"depth must be in \[0, 1\], got 1.1"),
        ({"depth": math.nan}, r"depth must be in \[0, 1\], got nan"),
    ],
)
def test_faults_of_waves(name, fault, message):
    with pytest.raises(ValueError, match=message):
        light.LIGHTS[name](3, **fault)
