"""Pictures of simulations: their size, that every panel has ink, and that the numbers decide them."""

import functools
import io
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from sssfit.scenarios import batch_mean, measure, plot
from sssfit.scenarios.driver import Record
from sssfit.scenarios.measure import Target

# Each simulation is a program to compile.
pytestmark = pytest.mark.slow

#: Of one pixel's pictures and of a line's: inches times dots per inch.
SIZES = {"circle": (1155, 726), "line": (1595, 792), "batch_mean": (1595, 836)}
PANELS = {"circle": (2, 2), "line": (2, 3), "batch_mean": (2, 3)}


class Answers(NamedTuple):
    """As much of a world as the statistics look at."""

    truth: np.ndarray
    sample_variance: np.ndarray


def statistics(frames=12, pixels=1, seeds=5, counts=(8, 64), first=2, scale=1.0):
    random = np.random.default_rng(3)
    shape = (seeds, frames, pixels)
    drawn = random.integers(counts[0], counts[1] + 1, shape)
    rest = [scale * (0.5 + random.random(shape)) for _ in Record._fields[1:]]
    variance = scale**2 * np.linspace(0.1, 0.4, frames * pixels).reshape(frames, pixels)
    world: Any = Answers(np.full((frames, pixels), scale), variance)
    return measure.collect([Record._make([drawn, *rest])], world, Target(0.0064), first=first)


def circle(found, title="a title"):
    return plot.circle(found, title=title, one=np.linspace(0.9, 1.1, len(found.truth)))


def line(found, title="a title", intensity=None):
    frames, texels = found.truth.shape
    lit, x = np.linspace(0, 1, texels), (np.arange(texels) + 0.5) / texels
    intensity = np.linspace(0.5, 1.5, frames) if intensity is None else intensity
    return plot.line(found, title=title, x=x, light=lit, intensity=intensity)


def batch(lights=("static", "dynamic"), shift=0.0):
    random = np.random.default_rng(4)
    names = batch_mean.NAMES
    entries = [batch_mean.Entry(name, 0.2, 0.2 + shift, 0.01, 0.01, 0.1, 0.3 + shift) for name in names]
    streams = batch_mean.Residuals._make({name: random.random(100) for name in names} for _ in range(3))
    return plot.batch_mean({light: entries for light in lights}, {light: streams for light in lights})


KINDS = {
    "circle": lambda: circle(statistics()),
    "line": lambda: line(statistics(pixels=9)),
    "batch_mean": batch,
}


@functools.cache
def drawn(kind):
    return KINDS[kind]()


def pixels(png):
    with Image.open(io.BytesIO(png)) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture.convert("RGB"), int)


@pytest.mark.parametrize("kind", KINDS)
def test_size_and_ink_in_every_panel(kind):
    found = pixels(drawn(kind))
    assert found.shape == (*SIZES[kind][::-1], 3)
    rows, columns = PANELS[kind]
    for row in np.array_split(found, rows):
        for panel in np.array_split(row, columns, axis=1):
            # Curves and bands have colours; axes, grids and text have none.
            coloured = np.ptp(panel, axis=2) > 40
            assert coloured.mean() > 1e-3 and (panel.min(axis=2) > 250).mean() > 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_numbers_give_the_same_bytes(kind):
    assert KINDS[kind]() == drawn(kind)
    # Neither a date nor the version of the drawing library.
    with Image.open(io.BytesIO(drawn(kind))) as picture:
        assert not {"Software", "Creation Time", "date:create"} & set(picture.info)


def test_other_numbers_give_another_picture():
    assert (pixels(drawn("circle")) != pixels(circle(statistics(counts=(8, 20))))).any()
    assert (pixels(drawn("batch_mean")) != pixels(batch(shift=0.05))).any()


def test_the_title_is_drawn():
    # Its height is that of its line; ink only beside a shorter one.
    short, long = (
        pixels(circle(statistics(), title=title))[:25].max(axis=2) < 128 for title in ("i", "i" * 60)
    )
    assert 0 < short.sum() < long.sum() and short.any(axis=0).sum() < long.any(axis=0).sum() / 10


def test_one_light_has_one_row():
    assert pixels(batch(lights=("static",))).shape[:2] == (418, 1595)


def test_nothing_is_left_open():
    import matplotlib.pyplot

    before = matplotlib.pyplot.get_fignums()
    circle(statistics())
    assert matplotlib.pyplot.get_fignums() == before


# Where there is little to draw: no warning, since the command line would print it.


def test_the_fewest_frames_seeds_and_counts():
    pixels(circle(statistics(frames=1, seeds=1, first=0)))
    pixels(circle(statistics(frames=2, seeds=1, first=1, counts=(8, 8))))
    pixels(line(statistics(frames=2, pixels=2, seeds=1, first=0)))


def test_a_line_of_one_frame():
    pixels(line(statistics(frames=1, pixels=4, first=0)))


def test_a_line_of_one_texel():
    pixels(line(statistics(pixels=1, first=0)))


def test_a_line_whose_lamp_is_off():
    pixels(line(statistics(pixels=4, first=0), intensity=np.zeros(12)))


def test_a_line_in_the_dark():
    pixels(line(statistics(pixels=4, first=0, scale=0.0)))


def test_a_circle_in_the_dark():
    pixels(circle(statistics(scale=0.0)))
