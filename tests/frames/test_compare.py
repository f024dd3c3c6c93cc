"""Measures of an image against a noisy reference: worlds whose errors are known."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sssfit.frames.compare import LEAST_REPLICATES, compare

SHAPE = (60, 80)


@pytest.fixture
def mask():
    found = np.random.default_rng(1).random(SHAPE) < 0.6
    found[0, 0] = False
    return found


def truth(seed=2):
    return np.random.default_rng(seed).uniform(0.5, 2, (*SHAPE, 3))


def reference(exact, noise, generator):
    """Mean and half difference of two independent halves, each with the given noise."""
    a, b = (exact + noise * generator.normal(size=exact.shape) for _ in range(2))
    return (a + b) / 2, (a - b) / 2


def test_measures_by_their_formulas(mask):
    # In Python's own numbers, pixel by pixel, summed without rounding.
    generator = np.random.default_rng(3)
    sss, diff = reference(truth(), 0.2, generator)
    image = truth() * 1.1 + 0.3 * generator.normal(size=sss.shape)
    found = compare(image, sss, diff, mask)
    pixels = [
        (f.tolist(), s.tolist(), d.tolist())
        for f, s, d in zip(image[mask], sss[mask], diff[mask], strict=True)
    ]
    count = len(pixels)

    def mean(terms):
        return math.fsum(terms) / count

    products = [[(f[c] - s[c] - d[c]) * (f[c] - s[c] + d[c]) for c in range(3)] for f, s, d in pixels]
    channels = [mean(p[c] for p in products) for c in range(3)]
    mse = sum(channels) / 3
    spread = mean((sum(p) / 3 - mse) ** 2 for p in products)
    peak = max(max(s) for _, s, _ in pixels)
    assert found.pixels == count and found.psnr_peak == peak
    assert found.mse == pytest.approx(mse, rel=1e-12)
    assert found.mse_se == pytest.approx(math.sqrt(spread / (count - 1)), rel=1e-12)
    assert found.psnr == pytest.approx(10 * math.log10(peak**2 / mse), rel=1e-12)
    for c in range(3):
        power = mean((s[c] + d[c]) * (s[c] - d[c]) for _, s, d in pixels)
        assert found.relative_l2[c] == pytest.approx(math.sqrt(channels[c] / power), rel=1e-12)
        assert found.bias[c] == pytest.approx(mean(f[c] - s[c] for f, s, _ in pixels), rel=1e-12)
        raw = mean((f[c] - s[c]) ** 2 for f, s, _ in pixels)
        assert found.raw_relative_l2[c] == pytest.approx(
            math.sqrt(raw / mean(s[c] ** 2 for _, s, _ in pixels)), rel=1e-12
        )
    assert found.raw_psnr == pytest.approx(10 * math.log10(peak**2 / found.raw_mse), rel=1e-12)
    assert found.bias_se is None


def test_the_noise_of_the_reference_averages_out(mask):
    # Squared error 0.01 under a reference whose own is 0.02: free of it within 4 standard errors, over runs.
    generator = np.random.default_rng(4)
    exact, runs = truth(), []
    image = exact + 0.1
    for _ in range(40):
        runs.append(compare(image, *reference(exact, 0.2, generator), mask))
    free = np.array([run.mse for run in runs])
    assert abs(free.mean() - 0.01) < 4 * free.std(ddof=1) / np.sqrt(40)
    # The stated error is the spread of the runs: a deviation from 40 has a relative error of 0.11.
    stated = np.mean([run.mse_se for run in runs])
    assert free.std(ddof=1) / stated == pytest.approx(1, abs=4 * 0.12)
    assert not any(run.mse_below_error for run in runs)
    assert np.mean([run.raw_mse for run in runs]) == pytest.approx(0.01 + 0.02, rel=0.02)
    power = np.mean(exact[mask] ** 2, axis=0)
    assert np.mean([run.relative_l2 for run in runs], axis=0) == pytest.approx(0.1 / np.sqrt(power), rel=0.03)
    assert np.mean([run.psnr for run in runs]) < np.mean([run.raw_psnr for run in runs]) + 20


def test_what_the_reference_cannot_tell_is_flagged(mask):
    # A perfect image: mse is 0 within its error, and below 1 error in 5 of 6 runs.
    generator = np.random.default_rng(5)
    runs = [compare(truth(), *reference(truth(), 0.2, generator), mask) for _ in range(60)]
    flagged = np.mean([run.mse_below_error for run in runs])
    assert 0.84 - 4 * 0.048 < flagged < 1
    below = [run for run in runs if run.mse < 0]
    assert len(below) > 10
    for run in below:
        assert run.mse_below_error and run.psnr == math.inf and math.isfinite(run.raw_psnr)
    for run in runs:
        for value, is_below in zip(run.relative_l2, run.relative_l2_below_error, strict=True):
            assert value > 0 or is_below


def test_an_equal_image_is_not_flagged(mask):
    found = compare(truth(), truth(), np.zeros((*SHAPE, 3)), mask)
    assert found.mse == found.mse_se == 0 and found.psnr == math.inf and not found.mse_below_error
    assert found.relative_l2 == (0, 0, 0) and found.relative_l2_below_error == (False,) * 3


def test_the_error_of_the_bias_is_its_spread(mask):
    # Image noise that pixels share, so that no sum over pixels could tell; and a noisy reference.
    generator = np.random.default_rng(6)
    exact = truth()

    def image():
        common = generator.normal(size=3) * [0.01, 0.02, 0.001]
        return exact + 0.1 + common + 0.3 * generator.normal(size=exact.shape)

    found, stated = [], []
    for _ in range(60):
        sss, diff = reference(exact, 0.5, generator)
        run = compare(image(), sss, diff, mask, replicates=(image() for _ in range(10)))
        found.append(run.bias)
        stated.append(run.bias_se)
    spread = np.std(found, axis=0, ddof=1)
    # Relative error of a deviation from n: 1 / sqrt(2 (n - 1)).
    ratio = spread / np.sqrt(np.mean(np.square(stated), axis=0))
    assert np.all(np.abs(ratio - 1) < 4 * (1 / np.sqrt(118) + 1 / np.sqrt(2 * 9 * 60)))
    assert np.all(np.abs(np.mean(found, axis=0) - 0.1) < 4 * spread / np.sqrt(60))
    # Each part has been seen: without the common noise, and without the reference's.
    count = mask.sum()
    assert np.mean(np.square(stated), axis=0)[1] > (3 * 0.3) ** 2 / count
    assert np.mean(np.square(stated), axis=0)[2] > 0.9 * (0.3**2 + 0.5**2 / 2) / count


def test_replicates_may_be_an_array(mask):
    generator = np.random.default_rng(7)
    runs = truth() + generator.normal(size=(LEAST_REPLICATES, *SHAPE, 3))
    arguments = (runs[0], truth(), np.zeros((*SHAPE, 3)), mask)
    whole = compare(*arguments, replicates=runs)
    assert whole == compare(*arguments, replicates=list(runs))
    assert whole.bias_se == pytest.approx(runs[:, mask].mean(axis=1).std(axis=0, ddof=1), rel=1e-12)
    same = compare(*arguments, replicates=np.repeat(runs[:1], 8, axis=0))
    assert same.bias_se == pytest.approx([0, 0, 0], abs=1e-15)


@given(scale=st.floats(1e-15, 1e15))
def test_measures_follow_the_unit(scale):
    generator = np.random.default_rng(8)
    sss, diff = reference(truth(), 0.1, generator)
    image, everywhere = sss + 0.2, np.ones(SHAPE, bool)
    plain, scaled = (
        compare(image, sss, diff, everywhere),
        compare(scale * image, scale * sss, scale * diff, everywhere),
    )
    assert scaled.mse == pytest.approx(scale**2 * plain.mse, rel=1e-9)
    assert scaled.psnr == pytest.approx(plain.psnr, rel=1e-9)
    assert scaled.relative_l2 == pytest.approx(plain.relative_l2, rel=1e-9)
    assert scaled.bias == pytest.approx(tuple(scale * b for b in plain.bias), rel=1e-9)


def test_what_lies_outside_the_mask_does_not_matter(mask):
    sss, diff = reference(truth(), 0.1, np.random.default_rng(9))
    expected = compare(sss + 0.2, sss, diff, mask, replicates=[sss + k for k in range(8)])
    image, spoiled, half = (np.where(mask[..., None], x, np.nan) for x in (sss + 0.2, sss, diff))
    runs = [np.where(mask[..., None], sss + k, np.inf) for k in range(8)]
    assert compare(image, spoiled, half, mask, replicates=runs) == expected


def test_single_precision_is_summed_in_double():
    # 1e8 + 1 has no place in float32's sums.
    image = np.full((1000, 1000, 3), 1.0, np.float32)
    image[::2] = 1 + 2.0**-20
    found = compare(image, np.ones_like(image), np.zeros_like(image), np.ones((1000, 1000), bool))
    assert found.bias == (2.0**-21,) * 3 and found.mse == 2.0**-41


def test_dark_references():
    zeros, everywhere = np.zeros((4, 4, 3)), np.ones((4, 4), bool)
    dark = compare(zeros + 0.1, zeros, zeros, everywhere)
    assert dark.psnr == -math.inf and all(math.isnan(x) for x in dark.relative_l2 + dark.raw_relative_l2)
    assert dark.bias == pytest.approx((0.1,) * 3)
    same = compare(zeros, zeros, zeros, everywhere)
    assert same.psnr == math.inf and all(math.isnan(x) for x in same.relative_l2)


def test_a_single_pixel_has_no_error():
    one = np.ones((1, 1, 3))
    found = compare(one * 1.5, one, 0 * one, np.ones((1, 1), bool))
    assert found.mse == 0.25 and found.mse_se == math.inf and found.mse_below_error


def test_the_record_holds_plain_numbers(mask):
    found = compare(truth(), truth(3), np.zeros((*SHAPE, 3)), mask, replicates=[truth(k) for k in range(8)])
    for value in dataclasses.astuple(found):
        for number in value if isinstance(value, tuple) else (value,):
            assert type(number) in (int, float, bool)


def refused(message, **changed):
    arguments = {
        "image": np.ones((4, 5, 3)),
        "sss": np.ones((4, 5, 3)),
        "diff": np.zeros((4, 5, 3)),
        "mask": np.ones((4, 5), bool),
    } | changed
    with pytest.raises(ValueError) as caught:
        compare(**arguments)
    assert str(caught.value) == message


def test_what_does_not_fit_is_refused_in_one_sentence():
    refused("image must have shape (4, 5, 3) as the mask has, got (5, 4, 3)", image=np.ones((5, 4, 3)))
    refused("diff must have shape (4, 5, 3) as the mask has, got (4, 5, 4)", diff=np.ones((4, 5, 4)))
    refused("mask must be boolean of shape (H, W), got float64 of (4, 5)", mask=np.ones((4, 5)))
    refused("mask must be boolean of shape (H, W), got bool of (20,)", mask=np.ones(20, bool))
    refused("mask must hold at least one pixel, got none", mask=np.zeros((4, 5), bool))
    broken = np.ones((4, 5, 3))
    broken[2, 1, 0] = np.nan
    broken[3, 0] = np.inf
    refused(
        "sss must be finite in the mask, got 2 pixels that are not, the first at column 1, row 2", sss=broken
    )
    refused("replicates must be at least 8 images, got 7", replicates=np.ones((7, 4, 5, 3)))
    refused("replicates must be at least 8 images, got 0", replicates=[])
    refused(
        "replicate 8 must be finite in the mask, got 2 pixels that are not, the first at column 1, row 2",
        replicates=[np.ones((4, 5, 3))] * 8 + [broken],
    )
