"""Groups whose errors follow from how their approximations are made."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from sssfit.frames import exact
from sssfit.tables import falloff, shadow
from sssfit.tables.collection import Sizes
from sssfit.tables.table import Axis, Table
from sssfit.trade import registry
from sssfit.trade.groups import (
    _blur,
    _board,
    _kernels,
    _lookup,
    _waves,
    falloff_tables,
    lookup_tables,
    recursions,
    separable,
)
from sssfit.trade.setting import procedural_setting, skin


@pytest.fixture(scope="module")
def choices():
    """Choices of groups by their names; each group is prepared once."""
    made = {}

    def of(name):
        if name not in made:
            task = registry.GROUPS[name].prepare(procedural_setting(is_quick=True))
            made[name] = {choice.name: choice for choice in task.choices}
            assert len(made[name]) == len(task.choices)
        return made[name]

    return of


SLOW = [
    pytest.param(f"{name}_tables", marks=pytest.mark.slow)
    for name in ("transmittance", "curvature", "shadow")
]


@pytest.mark.parametrize("name", ["recursions", "reprojection", *SLOW])
def test_one_of_several_choices_is_the_default(name, choices):
    made = choices(name).values()
    assert len(made) > 1 and sum(choice.is_default for choice in made) == 1
    assert all(choice.bytes_moved > 0 for choice in made)


def test_tables_have_the_sizes_that_are_written_where_nothing_is_said():
    for sizes in (lookup_tables._SIZES, lookup_tables._QUICK_SIZES):
        assert Sizes().line in sizes[1] and Sizes().image in sizes[2]


def waves(x):
    return np.stack([np.sin(5 * x), 2 * np.cos(3 * x)], axis=-1)


def table_of_waves(size):
    x = np.linspace(0.0, 1.0, size)
    return Table("waves", "Two of them.", (Axis("x", "1", x),), ("A", "B"), waves(x), "1")


def root_mean_square(values, largest=(1.0, 2.0)):
    return float(np.sqrt(np.mean(np.square(values / np.array(largest)))))


@pytest.fixture(scope="module")
def of_waves():
    at = _lookup.places(waves, [(0.0, 1.0)], [4096], is_quick=True)
    made = _lookup.choices(table_of_waves, (17, 33, 65, 1025), at, default=65)
    return {choice.name: choice.error().value for choice in made}


@pytest.mark.parametrize("size", [17, 33, 65])
def test_linear_lookup_errs_as_curvature_says(size, of_waves):
    # t (1 - t) h^2 f'' / 2 between entries, and the mean of t^2 (1 - t)^2 is 1/30.
    x = np.linspace(0.0, 1.0, 4001)
    bent = root_mean_square(waves(x) * np.array([25.0, 9.0]))
    assert of_waves[f"{size}, float"] == pytest.approx(bent / 2 / 30**0.5 / (size - 1) ** 2, rel=0.02)


def test_stored_formats_err_as_their_rounding_does(of_waves):
    # Linear lookup averages two roundings: of the mean square (1 - t)^2 + t^2 remains, 2/3 on average.
    values = table_of_waves(1025).values
    rounding = root_mean_square(values.astype(np.float16) - values)
    assert of_waves["1025, half"] == pytest.approx((2 / 3) ** 0.5 * rounding, rel=0.03)
    assert of_waves["1025, half"] < float(jnp.finfo(jnp.float16).eps) / 2
    step = np.ptp(values) / 255
    assert of_waves["1025, 8-bit"] == pytest.approx(
        root_mean_square(np.full(2, step)) * (2 / 36) ** 0.5, rel=0.05
    )


def test_bilinear_lookup_is_that_of_scipy():
    d, size, numbers = skin(), 21, (16, 64)
    table = shadow.shadow(d, size, size)
    ends = [(float(axis.values[0]), float(axis.values[-1])) for axis in table.axes]
    asked = []

    def evaluate(inverse_widths, values):
        asked.extend((inverse_widths, values))
        return shadow.evaluate(inverse_widths, values, d)

    at = _lookup.places(evaluate, ends, numbers, is_quick=True)
    found = next(_lookup.choices(lambda size: table, [size], at, default=size)).error().value
    grid = np.stack(np.meshgrid(*asked, indexing="ij"), axis=-1)
    wanted = shadow.evaluate(asked[0], asked[1], d)
    off = RegularGridInterpolator([axis.values for axis in table.axes], table.values)(grid) - wanted
    assert found == pytest.approx(root_mean_square(off, np.max(wanted, axis=(0, 1))), rel=1e-4)


def test_what_stands_in_for_the_table_of_falloffs_is_exact_where_its_law_is():
    law = {"albedo_factor": 0.8686, "albedo_power": 2, "d_factor": 0.894}

    def evaluate(x):
        albedo, d = 0.8686 * (x + 0.001) ** 2, 0.894 * (x + 0.001)
        return np.stack([albedo, d, d * (3.5 + 100 * (albedo - 0.33) ** 4)], axis=-1)

    x = np.arange(1, 65) / 64
    fitted = [[falloff.polynomial(x, column, n) for n in (1, 2, 9)] for column in evaluate(x).T]
    parameters = {"law": law, "polynomials": dict(zip(falloff.CHANNELS, fitted, strict=True))}
    table = Table(
        "falloff", "Of a law.", (Axis("falloff", "1", x),), falloff.CHANNELS, evaluate(x), "", parameters
    )
    at = _lookup.places(evaluate, [(1 / 64, 1.0)], [1024], is_quick=True)
    line, parabola, nine, of_law = (c.error().value for c in falloff_tables._formulas(table, at))
    # Ten roundings of float32 in units of the largest value.
    assert max(nine, of_law) < 10 * 2.0**-24
    assert 0.1 > line > parabola > 1e4 * nine


def test_lookups_between_pixels_err_as_their_spectra_say(choices):
    # Of each wave a lookup keeps a share of its own, times the wave moved: all but the clamp are linear.
    motions, cycles = _waves.motions(16), np.array(_waves._WAVES)
    fraction, whole = motions % 1, np.floor(motions)

    def kept(weights, first):
        share = 1.0
        for axis in (0, 1):
            f, t = cycles[:, axis], fraction[:, axis, None]
            found = sum(w * np.exp(2j * np.pi * f * (first + k)) for k, w in enumerate(weights(t)))
            share = share * np.prod(found / np.exp(2j * np.pi * f * t), axis=0)
        return share

    spectra = {
        "nearest": np.exp(2j * np.pi * cycles @ (whole + (fraction >= 0.5) - motions).sum(axis=0)),
        "bilinear": kept(lambda t: (1 - t, t), 0),
        "catmull_rom, not clamped": kept(
            lambda t: (-t * (1 - t) ** 2 / 2, 1 - 2.5 * t**2 + 1.5 * t**3, t * (1 + 4 * t - 3 * t**2) / 2,
                       -(t**2) * (1 - t) / 2), -1,
        ),
    }  # fmt: skip
    for name, share in spectra.items():
        wanted = np.sqrt(np.sum(np.abs(share - 1) ** 2) / 50 / (1 + len(cycles) / 50))
        assert choices("reprojection")[name].error().value == pytest.approx(wanted, rel=0.05), name


def test_the_clamp_costs_less_than_a_cubic_gains(choices):
    found = {name: choice.error().value for name, choice in choices("reprojection").items()}
    cubic, clamped = found["catmull_rom, not clamped"], found["catmull_rom"]
    assert cubic < clamped < found["bilinear"] < found["nearest"]


def test_the_reference_of_recursions_is_the_recursion():
    series = np.random.default_rng(1).normal(1.0, 0.1, 400).astype(np.float32)
    mean, variance, wanted = float(series[0]), 0.0, [0.0]
    for x in series[1:].tolist():
        delta = x - mean
        mean += recursions._ALPHA * delta
        variance = (1 - recursions._ALPHA) * (variance + recursions._ALPHA * delta**2)
        wanted.append(variance)
    np.testing.assert_allclose(recursions._reference(series).astype(float), wanted, rtol=1e-10)


def test_compensation_takes_most_of_the_rounding_away(choices):
    plain, compensated = (choices("recursions")[name].error().value for name in ("scan", "scan, compensated"))
    eps = float(jnp.finfo(jnp.float32).eps)
    # The bound of `moving.emv`, and the rounding of what is returned.
    assert 3 * compensated < plain < 4.5 / recursions._ALPHA * eps
    assert compensated < eps


@pytest.mark.slow
def test_in_parallel_the_same_comes_out_to_rounding():
    series = np.random.default_rng(0).normal(1.0, 0.1, 2**12).astype(np.float32)
    exact_variance = recursions._reference(series)
    one, other = (
        recursions._choice(way, way, False, series, exact_variance).error().value
        for way in ("associative", "scan")
    )
    # As `moving.ema` says of both, for 2^12 values.
    assert one < 16 * other


def test_blurs_are_products_of_matrices():
    random = np.random.default_rng(2)
    size, pixel = 12, 0.5
    image = random.random((size, size, 3)).astype(np.float32)
    shape = (2, 5, 3)
    kernels = _kernels.Kernels(np.array([0.3, 0.7]), random.uniform(-4, 4, shape), random.random(shape))
    wanted = np.zeros(image.shape)
    for share, offsets, weights in zip(*kernels, strict=True):
        for channel in range(3):
            # Each row reads the two pixels around a tap, and nothing beyond the edge.
            place = np.arange(size)[:, None, None] + offsets[:, channel, None] / pixel - np.arange(size)
            rows = np.einsum("p,ipj->ij", weights[:, channel], np.maximum(1 - np.abs(place), 0))
            wanted[..., channel] += share * rows @ image[..., channel] @ rows.T
    found = np.asarray(_blur.blurred(jnp.asarray(image), kernels, pixel))
    np.testing.assert_allclose(found, wanted, rtol=1e-5)


@pytest.mark.slow
def test_more_taps_blur_more_nearly_as_the_profile_does():
    image = np.zeros((64, 64, 3), np.float32)
    image[:, 32:] = 1
    wanted = exact.convolve(image, skin(), (0.5, 0.5))
    off = [
        np.asarray(_blur.blurred(jnp.asarray(image), _kernels.shared(skin(), taps), 0.5)) - wanted
        for taps in (5, 9, 25)
    ]
    few, some, many = (np.sqrt(np.mean(np.square(one[16:-16]))) for one in off)
    assert few > 1.5 * some > 1.5 * 1.5 * many > 0


@pytest.mark.slow
def test_gaussians_of_the_radial_density_blur_more_nearly_than_those_of_the_profile(choices):
    found = {name: choice.error().value for name, choice in choices("separable").items()}
    assert found["4 Gaussians, radial density"] < found["25 taps"] < found["9 taps"]
    flat, _ = _board.flat(is_quick=True)
    of_profile = separable._choice(flat, "", {}, _kernels.gaussians(skin(), 4, "profile"))
    assert found["4 Gaussians, radial density"] < 0.5 * of_profile.error().value


@pytest.mark.slow
def test_a_bounded_history_leaves_no_ghosts(choices):
    found = {name: choice.error().value for name, choice in choices("accumulation").items()}
    # Where nothing bounds it, the light that a shadow has taken away fades by 0.9 a frame.
    assert found["none, catmull_rom"] > 2 * found["neighbourhood, catmull_rom"] > 0
