"""Temporal antialiasing: laws of averages, what has no history, masks, transforms and gradients."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from taa_cases import SIZE, accumulate, each_box, each_clamping, images, masks, motions

from sssfit.frames import taa, temporal


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
