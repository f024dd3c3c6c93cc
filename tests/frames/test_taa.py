"""Temporal antialiasing: SciPy's Halton points, boxes by loops in float64, and laws of averages."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import qmc

from sssfit.frames import procedural, taa, temporal

compiled = eqx.filter_jit(taa.accumulate)

SIZE = (5, 7)
CLAMPED = ("neighbourhood", "variance")
each_clamping = pytest.mark.parametrize("clamping", taa.CLAMPINGS)
each_box = pytest.mark.parametrize("clamping", CLAMPED)
# Rows are Y, Co and Cg.
YCOCG = np.array([[0.25, 0.5, 0.25], [0.5, 0, -0.5], [-0.25, 0.5, -0.25]])


def accumulate(history, image, *, config=taa.DEFAULT, **options):
    """`taa.accumulate`, compiled once for all constants of one kind."""
    config, options = jax.tree.map(jnp.asarray, (config, options))
    return compiled(history, image, config=config, **options)


def images(seed=1, dtype="float32", size=SIZE):
    return np.random.default_rng(seed).lognormal(size=(*size, 3)).astype(dtype)


def masks(seed=3, size=SIZE, share=0.7):
    return np.random.default_rng(seed).random(size) < share


def motions(seed=4, size=SIZE):
    return np.random.default_rng(seed).uniform(-2, 2, (*size, 2)).astype(np.float32)


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


@pytest.mark.parametrize("length", [1, 8, 13, 4096])
def test_jitter_is_halton_s_without_its_first_point(length):
    expected = qmc.Halton(d=2, scramble=False).random(length + 1)[1:] - 0.5
    index = np.arange(length)
    found = jax.jit(taa.jitter, static_argnums=1)(index, length)
    assert found.dtype == jnp.float32 and found.shape == (2, length)
    assert np.asarray(found).T == pytest.approx(expected, abs=2.0**-24)
    assert np.all(np.abs(found) < 0.5)
    # Each frame has its own place, and the next round is the same.
    assert len(np.unique(np.asarray(found).T, axis=0)) == length
    eager = taa.jitter(index, length)
    assert np.asarray(eager) == pytest.approx(np.asarray(found), abs=2.0**-25)
    np.testing.assert_array_equal(taa.jitter(index + 3 * length, length), eager)
    np.testing.assert_array_equal(taa.jitter(index - length, length), eager)


def test_jitter_of_any_integer():
    assert taa.jitter(0).shape == (2,) and taa.jitter(np.zeros((3, 4), int)).shape == (2, 3, 4)
    for index in (10**30 + 3, np.uint8(203), np.int64(11), jnp.uint32(2**32 - 5), jnp.int32(3)):
        length = 8
        np.testing.assert_array_equal(taa.jitter(index, length), taa.jitter(int(index) % 8))
    # 300 is no number of a byte.
    np.testing.assert_array_equal(taa.jitter(np.uint8(203), 300), taa.jitter(203, 300))
    traced = jax.jit(lambda k: jax.lax.fori_loop(0, k, lambda i, s: s + taa.jitter(i), jnp.zeros(2)))(8)
    # The mean that the docstring tells.
    assert (np.asarray(traced) / 8).tolist() == pytest.approx([-0.0547, 0], abs=1e-4)


def test_a_jittered_camera_sees_the_place_in_the_pixel():
    camera = procedural.frame(width=8, height=6).camera
    for index in range(8):
        x, y = (float(v) for v in taa.jitter(index))
        jittered = dataclasses.replace(camera, cx=camera.cx - x, cy=camera.cy - y)
        seen = jittered.position(3.5, 2.5, 400.0)
        assert np.asarray(seen) == pytest.approx(
            np.asarray(camera.position(3.5 + x, 2.5 + y, 400.0)), rel=1e-5
        )


def test_without_clamping_it_is_the_moving_average(dtype):
    generator = np.random.default_rng(5)
    frames = generator.lognormal(size=(40, *SIZE, 2)).astype(dtype)
    alphas = generator.uniform(0.02, 1, SIZE).astype(dtype)
    for alpha in (0.1, 0.75, alphas):
        config = taa.Config(alpha=alpha, clamping="none")
        found, expected = frames[0], frames[0].astype(np.float64)
        weight = np.asarray(alpha, np.float64)
        weight = weight[..., None] if weight.ndim else weight
        for k, frame in enumerate(frames[1:]):
            found = accumulate(found, frame, missing=False, config=config)
            expected = expected + weight * (frame - expected)
            assert found.dtype == dtype
            # 2.5 roundings a frame, each forgotten as the frame is.
            close = 2.5 * min(k + 1, 1 / np.min(weight)) * np.finfo(dtype).eps * frames.max()
            assert np.asarray(found) == pytest.approx(expected, abs=float(close))


@pytest.mark.parametrize(
    "clamping, lookup",
    [
        ("none", "nearest"),
        ("neighbourhood", "bilinear"),
        pytest.param("variance", "catmull_rom", marks=pytest.mark.slow),
    ],
)
def test_the_image_itself_comes_where_there_is_no_history(clamping, lookup, dtype):
    image, motion = images(dtype=dtype), motions()
    config, newest = (taa.Config(alpha=alpha, clamping=clamping, lookup=lookup) for alpha in (0.1, 1.0))
    everywhere, nowhere = np.ones(SIZE, bool), np.zeros(SIZE, bool)
    off, good = np.full_like(motion, 1e30), images(2, dtype)
    unknown, infinite = (np.full_like(image, value) for value in (np.nan, np.inf))
    for history, moved, missing, constants in (
        *((old, motion, everywhere, config) for old in (good, unknown, infinite)),
        *((old, motion, nowhere, newest) for old in (good, unknown, infinite)),
        # What is off screen or not finite is no history.
        (good, off, nowhere, config),
        (unknown, motion, nowhere, config),
        (infinite, motion, nowhere, config),
    ):
        found = accumulate(history, image, motion=moved, missing=missing, config=constants)
        np.testing.assert_array_equal(found, image)
    assert not np.array_equal(accumulate(good, image, motion=motion, missing=nowhere, config=config), image)


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
def test_nothing_bleeds_from_outside_the_mask(clamping):
    image, history, mask, motion = images(), images(2), masks(), motions() / 4
    before = masks(8)
    config = taa.Config(clamping=clamping, lookup="bilinear")
    expected = np.asarray(
        accumulate(history, image, motion=motion, mask=mask, previous_mask=before, config=config)
    )
    known = temporal.bilinear(before[..., None].astype(np.float32), motion)[..., 0] > 0
    for outside in (np.nan, np.inf, 1e30):
        found = accumulate(
            np.where(before[..., None], history, np.float32(outside)),
            np.where(mask[..., None], image, np.float32(outside)),
            motion=motion,
            mask=mask,
            previous_mask=before,
            config=config,
        )
        np.testing.assert_array_equal(np.asarray(found)[mask & known], expected[mask & known])
        np.testing.assert_array_equal(
            np.asarray(found)[~mask], np.full((np.sum(~mask), 3), outside, np.float32)
        )
    assert (mask & known).sum() > 15


@each_clamping
def test_a_bad_pixel_is_gone_with_the_next_frame(clamping):
    config = taa.Config(clamping=clamping)
    spoiled = images()
    spoiled[2, 3, 1] = np.nan
    history = np.asarray(accumulate(images(2), spoiled, config=config))
    # What is NaN stays alone, and is no neighbour.
    assert (
        np.isnan(history[2, 3]).any()
        and np.isfinite(np.delete(history.reshape(-1, 3), 2 * 7 + 3, axis=0)).all()
    )
    found = np.asarray(accumulate(history, images(3), config=config))
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[2, 3], images(3)[2, 3])
    # For the others it is as if it were masked out.
    mask = np.ones(SIZE, bool)
    mask[2, 3] = False
    without = np.asarray(accumulate(images(2), images(), mask=mask, config=config))
    np.testing.assert_array_equal(history[mask], without[mask])


@each_clamping
def test_empty_masks_and_single_pixels(clamping):
    config = taa.Config(clamping=clamping)
    image, history = images(), images(2)
    np.testing.assert_array_equal(accumulate(history, image, mask=np.zeros(SIZE, bool), config=config), image)
    one, before = images(size=(1, 1)), images(2, size=(1, 1))
    for motion in (None, np.zeros((1, 1, 2)), np.full((1, 1, 2), np.nan), np.full((1, 1, 2), 1e6)):
        found = np.asarray(accumulate(before, one, motion=motion, config=config))
        if motion is not None and not np.all(motion == 0):
            np.testing.assert_array_equal(found, one)
        elif clamping == "none":
            assert found == pytest.approx(before + 0.1 * (one - before), rel=4 * 2.0**-23)
        else:
            # Alone, a pixel is its own neighbourhood.
            assert found == pytest.approx(one, abs=16 * 2.0**-23 * float(one.max()))


@pytest.mark.slow
@pytest.mark.parametrize("lookup", taa.LOOKUPS)
def test_the_history_is_looked_up_along_the_motion(lookup):
    image, history, motion = images(), images(2), motions()
    config = taa.Config(clamping="none", lookup=lookup)
    old = getattr(temporal, lookup)(history, motion)
    missing = np.asarray(temporal.off_screen(motion))
    expected = np.where(missing[..., None], image, old + np.float32(0.1) * (image - old))
    found = accumulate(history, image, motion=motion, config=config)
    assert np.asarray(found) == pytest.approx(expected, abs=4 * 2.0**-23 * float(history.max()))
    np.testing.assert_array_equal(np.asarray(found)[missing], image[missing])


def test_half_precision_histories_stay_so():
    config = taa.Config(clamping="none", lookup="nearest")
    history, image = np.full((1, 1, 3), 6e4, np.float16), np.full((1, 1, 3), 1e6, np.float32)
    found = accumulate(history, image, config=config)
    # 65504 is their largest number.
    assert found.dtype == jnp.float16 and found.tolist() == [[[65504] * 3]]
    history = images(2, "float16")
    found = np.asarray(accumulate(history, images(), config=config), np.float64)
    exact = history + 0.1 * (images().astype(np.float64) - history)
    assert found == pytest.approx(exact, rel=2.0**-11 * 1.01)


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


@pytest.mark.slow
@each_clamping
def test_transforms(clamping):
    stack = jnp.stack([images(1), images(2)]), jnp.stack([images(3), images(4)])
    motion, missing = jnp.stack([motions(5), motions(6)]), jnp.stack([~masks(7), ~masks(8)])
    config = taa.Config(clamping=clamping)

    def step(history, image, motion, missing, alpha):
        varied = eqx.tree_at(lambda c: c.alpha, config, alpha)
        return taa.accumulate(history, image, motion=motion, missing=missing, config=varied)

    alphas = jnp.array([0.1, 0.7])
    mapped = jax.jit(jax.vmap(step))(*stack, motion, missing, alphas)
    for k in range(2):
        arguments = stack[0][k], stack[1][k], motion[k], missing[k], alphas[k]
        for function in (jax.jit(step), step):
            assert np.asarray(mapped[k]) == pytest.approx(
                np.asarray(function(*arguments)), rel=1e-5, abs=1e-5
            )


@pytest.mark.slow
@each_clamping
def test_gradients_are_finite_and_those_of_differences(clamping, x64):
    image, history = images(dtype="float64"), images(2, "float64")
    # Alike neighbours have no spread, and what is missing is NaN or infinite.
    image[:3, :3] = image[0, 0]
    missing, weights = ~masks(), np.random.default_rng(11).normal(size=image.shape)
    history[missing] = np.array([np.nan, np.inf])[np.arange(missing.sum()) % 2, None]

    @jax.jit
    def found(history, image, alpha, deviations):
        config = taa.Config(alpha=alpha, clamping=clamping, deviations=deviations)
        return (weights * taa.accumulate(history, image, missing=missing, config=config)).sum()

    arguments = [jnp.asarray(history), jnp.asarray(image), jnp.asarray(0.3), jnp.asarray(0.8)]
    gradients = jax.jit(jax.grad(found, argnums=(0, 1, 2, 3)))(*arguments)
    assert all(np.isfinite(gradient).all() for gradient in gradients)
    assert np.all(np.asarray(gradients[0])[missing] == 0)
    generator, size = np.random.default_rng(12), 1e-6
    # The alike ones are left alike: the box's corners have kinks there.
    smooth = np.ones(image.shape)
    smooth[:4, :4] = 0
    for k, gradient in enumerate(gradients):
        way = smooth * generator.normal(size=image.shape) if k < 2 else 1.0
        up, down = ([*arguments[:k], arguments[k] + s * way, *arguments[k + 1 :]] for s in (size, -size))
        slope = float(found(*up) - found(*down)) / (2 * size)
        assert float((gradient * way).sum()) == pytest.approx(slope, rel=1e-5, abs=1e-7)


def test_what_does_not_fit_is_refused():
    image, history = images(), images(2)
    refused = {
        r"history must have the image's shape \(5, 7, 3\), got \(5, 6, 3\)": lambda: taa.accumulate(
            history[:, 1:], image
        ),
        r"image must have shape \(H, W, C\) and at least one pixel, got \(5, 7\)": lambda: taa.accumulate(
            history[..., 0], image[..., 0]
        ),
        r"image must have 3 channels for clamping 'neighbourhood', got shape \(5, 7, 2\); .*": lambda: (
            taa.accumulate(history[..., :2], image[..., :2])
        ),
        r"mask must have the image's shape \(5, 7\), got \(4, 7\)": lambda: taa.accumulate(
            history, image, mask=masks()[1:]
        ),
        r"missing must broadcast to the shape \(5, 7\), got \(5, 7, 3\); .*": lambda: taa.accumulate(
            history, image, missing=image > 0
        ),
        r"alpha must broadcast to the shape \(5, 7\), got \(3,\); .*": lambda: taa.accumulate(
            history, image, config=taa.Config(alpha=np.full(3, 0.1))
        ),
        r"motion must have shape \(5, 7, 2\), got \(5, 7, 3\)": lambda: taa.accumulate(
            history, image, motion=image
        ),
        r"alpha must be in \(0, 1\], got 0; .*": lambda: taa.Config(alpha=0.0),
        r"alpha must be in \(0, 1\], got 1.5; .*": lambda: taa.Config(alpha=1.5),
        "deviations must be at least 0, got -1.0": lambda: taa.Config(deviations=-1.0),
        "deviations must be at least 0, got nan": lambda: taa.Config(deviations=np.nan),
        "clamping must be one of none, neighbourhood, variance, got 'box'": lambda: taa.Config(
            clamping="box"  # pyright: ignore[reportArgumentType]
        ),
        "lookup must be one of nearest, bilinear, catmull_rom, got 'cubic'": lambda: taa.Config(
            lookup="cubic"  # pyright: ignore[reportArgumentType]
        ),
        "length must be in 1 to 65536, got 0": lambda: taa.jitter(0, 0),
        "index must be an integer, got float32": lambda: taa.jitter(1.5),
    }
    for message, call in refused.items():
        with pytest.raises(ValueError, match=f"^{message}$"):
            call()
