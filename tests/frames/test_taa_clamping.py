"""Clamped histories: boxes by loops in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from taa_cases import SIZE, accumulate, each_box, images, masks

from sssfit.frames import taa

# Rows are Y, Co and Cg.
YCOCG = np.array([[0.25, 0.5, 0.25], [0.5, 0, -0.5], [-0.25, 0.5, -0.25]])


def box(image, row, column, clamping, mask=None, deviations=1.0):
    """Mean colour, and lower and upper corner in Y, Co and Cg, of the pixels around one, in float64."""
    height, width = image.shape[:2]
    around = [
        image[j, i].astype(np.float64)
        for j in range(max(row - 1, 0), min(row + 2, height))
        for i in range(max(column - 1, 0), min(column + 2, width))
        if mask is None or mask[j, i]
    ]
    colours = np.array(around) @ YCOCG.T
    mean = np.mean(around, axis=0)
    if clamping == "neighbourhood":
        return mean, colours.min(axis=0), colours.max(axis=0)
    reach = deviations * colours.std(axis=0)
    return mean, YCOCG @ mean - reach, YCOCG @ mean + reach


def clipped(old, mean, low, high):
    """Where the way from a colour to the mean enters the box, by bisection."""

    def is_inside(share):
        colour = YCOCG @ (mean + share * (old - mean))
        return np.all((colour >= low) & (colour <= high))

    if is_inside(1.0):
        return old
    least, most = 0.0, 1.0
    for _ in range(60):
        middle = (least + most) / 2
        least, most = (middle, most) if is_inside(middle) else (least, middle)
    return mean + least * (old - mean)


@each_box
@pytest.mark.parametrize("masked", [False, True])
def test_the_history_is_pulled_into_the_box(clamping, masked, dtype):
    image, history = images(dtype=dtype), images(2, dtype) ** 2
    mask = masks() if masked else np.ones(SIZE, bool)
    deviations = 1.25 if masked else 0.5
    config = taa.Config(alpha=0.25, clamping=clamping, deviations=deviations)
    found = np.asarray(accumulate(history, image, mask=mask, config=config))
    pulled = 0
    for row, column in np.ndindex(SIZE):
        new = image[row, column].astype(np.float64)
        if not mask[row, column]:
            np.testing.assert_array_equal(found[row, column], image[row, column])
            continue
        old = history[row, column].astype(np.float64)
        corners = box(image, row, column, clamping, mask, deviations)
        inside = clipped(old, *corners)
        pulled += not np.array_equal(inside, old)
        # The box is wider by 8 eps of the brightest, which moves a point on a slanted way by as much over
        # its steepness; ways here are steeper than 1 / 8. Rounding adds as much as a few colours have.
        close = 80 * float(np.finfo(dtype).eps * max(image.max(), old.max()))
        assert found[row, column] == pytest.approx(inside + 0.25 * (new - inside), abs=close)
    assert 5 < pulled <= SIZE[0] * SIZE[1]


@each_box
@given(seed=st.integers(0, 1000), scale=st.sampled_from([1e-30, 1.0, 1e30]), far=st.sampled_from([1.0, 1e4]))
def test_what_is_kept_of_the_history_is_inside_the_box(clamping, seed, scale, far):
    image = (scale * images(seed)).astype(np.float32)
    history = (far * scale * images(seed + 1)).astype(np.float32)
    found = np.asarray(
        accumulate(history, image, config=taa.Config(alpha=0.5, clamping=clamping)), np.float64
    )
    kept = 2 * found - image
    # Half of the sum is exact but for its rounding and that of the clamped history, twice.
    close = 16 * 2.0**-23 * image.max()
    for row, column in np.ndindex(SIZE):
        _, low, high = box(image, row, column, clamping)
        colour = YCOCG @ kept[row, column]
        assert np.all(colour >= low - close) and np.all(colour <= high + close)
    # Towards the mean of colours there are: no light turns negative.
    assert np.all(kept >= -close)


@each_box
def test_a_history_inside_the_box_is_left_alone(clamping, dtype):
    image = images(dtype=dtype)
    unclamped = taa.Config(clamping="none")
    config = taa.Config(clamping=clamping, deviations=1.0)
    # The mean of the neighbours is inside, and the mean with a little of the pixel itself.
    mean = np.array([[box(image, row, column, clamping)[0] for column in range(7)] for row in range(5)])
    for history in (mean.astype(dtype), (0.9 * mean + 0.1 * image).astype(dtype)):
        expected = accumulate(history, image, config=unclamped)
        np.testing.assert_array_equal(accumulate(history, image, config=config), expected)


@pytest.mark.slow
@each_box
@pytest.mark.parametrize(
    "kept, new", [("float16", "float32"), ("float32", "float16"), ("float32", "float32")]
)
def test_a_last_digit_rejects_no_history(clamping, kept, new):
    # Light of one hue: Co and Cg follow Y, but for roundings.
    strength = np.random.default_rng(6).uniform(0.5, 2, (*SIZE, 1))
    image = (strength * [0.9, 0.3, 0.9]).astype(new)
    digit = float(max(np.finfo(kept).eps, np.finfo(new).eps))
    history = image.astype(np.float32) * np.array([1, 1, 1 + 2 * digit], np.float32)
    config, unclamped = taa.Config(clamping=clamping, deviations=3.0), taa.Config(clamping="none")
    history = history.astype(kept)
    found, expected = (accumulate(history, image, config=c) for c in (config, unclamped))
    assert found.dtype == kept and not np.array_equal(history, image)
    np.testing.assert_array_equal(found, expected)


@each_box
def test_a_flat_image_takes_its_history_with_it(clamping):
    # Nothing varies: whatever was there is a ghost.
    image, ghost = np.full((*SIZE, 3), [0.3, 0.2, 0.1], np.float32), images(2)
    found = accumulate(ghost, image, config=taa.Config(clamping=clamping))
    assert np.asarray(found) == pytest.approx(image, abs=12 * 2.0**-23)
    for scale in (0.0, 1e-38, 1e38):
        dark = np.full((*SIZE, 3), scale, np.float32)
        found = np.asarray(accumulate(dark / 2, dark, config=taa.Config(clamping=clamping)))
        assert found == pytest.approx(dark, rel=12 * 2.0**-23)


@pytest.mark.slow
@each_box
def test_clamping_takes_the_light_of_rare_bright_samples(clamping):
    # One sample in 50 is 50 times as bright: mean 1. The average without clamping has it, to five standard
    # errors; the one with clamping has lost most.
    generator = np.random.default_rng(9)
    frames = 50.0 * (generator.random((200, 24, 24, 1)) < 0.02) * np.ones(3)

    def mean(config):
        def step(history, frame):
            history = taa.accumulate(history, frame, config=config)
            return history, history

        first = jnp.ones((24, 24, 3), jnp.float32)
        return float(
            jax.jit(lambda x: jax.lax.scan(step, first, x)[1])(frames.astype(np.float32))[100:].mean()
        )

    error = float(np.sqrt(50.0 - 1) / np.sqrt(100 * 24 * 24))
    assert abs(mean(taa.Config(clamping="none")) - 1) < 5 * error + 0.9**100
    assert mean(taa.Config(clamping=clamping)) < 0.9
