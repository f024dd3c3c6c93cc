"""The line: its kernel by quadratures of the profile itself, its answers by sampling, profiles and files."""

import functools
import math

import equinox as eqx
import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import dblquad, quad
from scipy.special import k0

from sssfit.files.errors import FileError
from sssfit.scenarios import line

sample = eqx.filter_jit(lambda world, uniform, frame: world.values(world.places(uniform), frame))

kernels = pytest.mark.parametrize("kernel", line.KERNELS)


# As many texels in most tests: each number of them is compiled for itself.
TEXELS = 12


def line_spread(x, d):
    """Burley's profile integrated along the stripes of light, dissertation Eq 2.65."""
    return (k0(x / d) + k0(x / (3 * d))) / (4 * math.pi * d)


def radial(x, d):
    """Half of the radial density to either side."""
    return (math.exp(-x / d) + math.exp(-x / (3 * d))) / (8 * d)


@functools.cache
def by_quadrature(density, d):
    """Masses of all texels, of unit width, from a density of the distance that may be infinite at 0."""

    def between(low, high):
        if low < 0 < high:
            return between(0, -low) + between(0, high)
        low, high = sorted((abs(low), abs(high)))
        # Nothing that counts comes from beyond 120 d.
        high = min(high, max(low, 120 * d))
        value, error, *_ = quad(density, low, high, (d,), epsabs=1e-13, epsrel=1e-12, limit=400)
        assert error < 2e-11
        return value

    masses = np.empty((TEXELS, TEXELS))
    for pixel in range(TEXELS):
        edges = np.concatenate([[-np.inf], np.arange(1, TEXELS), [np.inf]]) - pixel - 0.5
        masses[pixel] = [between(low, high) for low, high in zip(edges, edges[1:], strict=False)]
    return masses


@pytest.mark.parametrize("d", [0.3, 1.6])
@pytest.mark.parametrize("kernel, density", [("line", line_spread), ("radial", radial)])
def test_masses_are_integrals_of_the_kernel(kernel, density, d):
    assert line.texel_masses(TEXELS, d, kernel) == pytest.approx(by_quadrature(density, d), abs=3e-11)


def test_masses_of_the_areal_profile():
    # Over the plane's stripe itself, without any formula for the line spread.
    d = 0.7

    def areal(y, x):
        r = math.hypot(x, y)
        return (math.exp(-r / d) + math.exp(-r / (3 * d))) / (8 * math.pi * d * r)

    masses = line.texel_masses(TEXELS, d)
    for apart in (1, 3):
        found, error, *_ = dblquad(areal, apart - 0.5, apart + 0.5, 0, 60 * d, epsabs=1e-10)
        assert abs(masses[4, 4 + apart] - 2 * found) < 1e-9 + 2 * error
    # The stripe that holds the singularity, around it in polar coordinates.
    nodes, weights = np.polynomial.legendre.leggauss(60)
    angle = (nodes + 1) * math.pi / 4
    edge = 0.5 / np.cos(angle) / d
    within = -(np.expm1(-edge) + 3 * np.expm1(-edge / 3)) / 4
    assert masses[4, 4] == pytest.approx(np.sum(weights * within) / 2, abs=1e-7)


@kernels
@pytest.mark.parametrize("texels", [1, 2, TEXELS])
@pytest.mark.parametrize("texels_per_d", [1e-3, 0.05, 0.8, 6.4, 40.0, 1e4])
def test_masses_are_shares(kernel, texels, texels_per_d):
    masses = line.texel_masses(texels, texels_per_d, kernel)
    assert masses.shape == (texels, texels) and masses.dtype == np.float64
    assert np.all(masses >= -1e-11)
    assert masses.sum(axis=1) == pytest.approx(np.ones(texels), abs=texels * 1e-15 + 1e-15)
    # The same from either end; and inside, only how far apart two texels are counts, to the bit.
    assert np.array_equal(masses, masses[::-1, ::-1])
    inner = masses[:, 1:-1]
    for apart in range(1, texels - 2):
        assert len(np.unique(np.diagonal(inner, apart))) == 1
    inside = masses[1:-1, 1:-1]
    assert np.array_equal(inside, inside.T)


@kernels
def test_masses_at_the_ends_of_scale(kernel):
    # No scattering at all, and so much that each end takes half.
    assert line.texel_masses(TEXELS, 1e-4, kernel) == pytest.approx(np.eye(TEXELS), abs=1e-11)
    spread = line.texel_masses(TEXELS, 1e7, kernel)
    assert spread[:, [0, -1]] == pytest.approx(np.full((TEXELS, 2), 0.5), abs=1e-5)


# The world's answers


@pytest.fixture(scope="module")
def irradiance():
    generator = np.random.default_rng(11)
    return generator.lognormal(size=(3, TEXELS)) * np.array([[1.0], [0.0], [3.0]])


@kernels
def test_answers_by_brute_force(irradiance, reference, kernel):
    # Quantiles by Newton's method on the cdf, and NumPy's own random numbers.
    length, d, number = 3.0, 0.4, 200_000
    world = line.world(irradiance, length=length, d=d, kernel=kernel)
    generator = np.random.default_rng(12)
    radius = d * reference.ppf(generator.random(number)).astype(float)
    offset = radius * (
        np.cos(2 * math.pi * generator.random(number))
        if kernel == "line"
        else generator.choice([-1, 1], number)
    )
    for pixel, x in enumerate(line.centres(TEXELS, length)):
        texel = np.clip(np.floor((x + offset) * TEXELS / length), 0, TEXELS - 1).astype(int)
        for frame in range(3):
            values = irradiance[frame, texel]
            mean, variance = values.mean(), values.var()
            fourth = np.mean((values - mean) ** 4)
            assert abs(mean - float(world.truth[frame, pixel])) <= 4.5 * math.sqrt(variance / number) + 1e-6
            error = math.sqrt(max(fourth - variance**2, 0) / number)
            assert abs(variance - float(world.sample_variance[frame, pixel])) <= 4.5 * error + 1e-5


@kernels
def test_samples_have_the_answers(irradiance, dtype, kernel):
    number = 100_000
    world = line.world(irradiance.astype(dtype), length=3.0, d=0.4, kernel=kernel)
    uniform = jax.random.uniform(jax.random.key(5), (2, number, TEXELS), dtype)
    for frame in (0, 2):
        values = sample(world, uniform, frame)
        assert values.dtype == dtype and values.shape == (number, TEXELS)
        values = np.asarray(values, np.float64)
        truth, variance = (np.asarray(v, float)[frame] for v in (world.truth, world.sample_variance))
        assert np.all(np.abs(values.mean(axis=0) - truth) < 4.5 * np.sqrt(variance / number))
        fourth = np.mean((values - truth) ** 4, axis=0)
        error = np.sqrt((fourth - variance**2) / number)
        assert np.all(np.abs(values.var(axis=0) - variance) < 4.5 * error + 20 * variance / number)


def test_answers_are_those_of_the_masses(irradiance, dtype):
    given_light = irradiance.astype(dtype)
    world = line.world(given_light, length=3.0, d=0.4)
    masses = by_quadrature(line_spread, 1.6)
    light = given_light.astype(float)
    truth = light @ masses.T
    rounding = float(np.finfo(dtype).eps)
    largest = light.max()
    for name in ("irradiance", "truth", "sample_variance", "control", "surround"):
        assert getattr(world, name).dtype == dtype and getattr(world, name).shape == (3, TEXELS)
    assert np.asarray(world.truth, float) == pytest.approx(truth, rel=rounding, abs=1e-10 * largest)
    # Second moments about the truth: no difference of squares.
    variance = np.einsum("pt,fpt->fp", masses, np.square(light[:, None, :] - truth[:, :, None]))
    found = np.asarray(world.sample_variance, float)
    assert found == pytest.approx(variance, rel=rounding, abs=1e-9 * largest**2)
    assert np.array_equal(world.control, given_light)


def test_light_that_is_the_same_everywhere(dtype):
    world = line.world(np.array([[0.7] * TEXELS, [0.0] * TEXELS], dtype), length=2.0, d=0.1)
    rounding = float(np.finfo(dtype).eps)
    for answer in (world.truth, world.surround, world.control):
        assert np.asarray(answer)[0] == pytest.approx(np.full(TEXELS, dtype.type(0.7)), rel=2 * rounding)
        assert np.all(np.asarray(answer)[1] == 0)
    # 0.49 less 0.49, of float64.
    assert np.asarray(world.sample_variance) == pytest.approx(np.zeros((2, TEXELS)), abs=1e-14)
    assert np.all(np.asarray(world.sample_variance) >= 0)


@kernels
def test_a_linear_ramp_is_its_own_truth(x64, kernel):
    # 80 d from the ends the kernel is even.
    texels, length, d, slope = 1001, 20.0, 0.1, 0.05
    x = line.centres(texels, length)
    world = line.world(slope * x[None], length=length, d=d, kernel=kernel)
    middle = slice(400, 601)
    assert np.asarray(world.truth)[0, middle] == pytest.approx(slope * x[middle], abs=1e-11)
    # The variance is that of the offset, E[(r cos)^2] = 7 d^2 or E[r^2] = 14 d^2, which texels round by half
    # of their width at most: by Cauchy and Schwarz the bound.
    expected, width = (7 if kernel == "line" else 14) * d**2, length / texels
    bound = slope**2 * (width * math.sqrt(expected) + width**2 / 4)
    found = np.asarray(world.sample_variance)[0, middle]
    assert np.all(np.abs(found - slope**2 * expected) < bound)


@pytest.mark.parametrize("d, reach", [(0.001, 1), (0.1, 1), (0.26, 3), (1.0, 10)])
def test_control_and_surround(d, reach):
    # Over 10 d to both sides, a texel at least; beyond the ends the light stays.
    light = np.random.default_rng(3).random((2, TEXELS)).astype(np.float32)
    world = line.world(light, length=float(TEXELS), d=d)
    assert np.array_equal(world.control, light)
    seen = np.clip(np.arange(TEXELS)[:, None] + np.arange(-reach, reach + 1), 0, TEXELS - 1)
    assert np.asarray(world.surround) == pytest.approx(light[:, seen].mean(axis=-1), rel=1e-6)


def test_one_texel_and_scale():
    world = line.world(np.array([[2.0], [3.0]]), length=1.0, d=0.1)
    assert np.asarray(world.truth).tolist() == [[2.0], [3.0]] and np.all(
        np.asarray(world.sample_variance) == 0
    )
    # Only d over length counts.
    light = np.random.default_rng(0).random((1, TEXELS))
    first, second = (line.world(light, length=f * 2.0, d=f * 0.1).truth for f in (1.0, 8.0))
    assert np.array_equal(first, second)


# Profiles


def test_positions():
    assert line.centres(1, 3.0).tolist() == [1.5]
    assert line.centres(5, 1.0) == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9], rel=1e-15)


@given(x=st.floats(-5, 5), low=st.floats(-2, 2), width=st.floats(0.01, 3), amplitude=st.floats(0, 4))
def test_profiles_by_hand(x, low, width, amplitude):
    high = low + width
    assert float(line.step(x, edge=low, amplitude=amplitude)) == (amplitude if x >= low else 0)
    assert float(line.pulse(x, start=low, end=high, amplitude=amplitude)) == (
        amplitude if low <= x < high else 0
    )
    rise = 0 if x <= low else 1 if x >= high else (x - low) / (high - low)
    assert float(line.ramp(x, start=low, end=high, amplitude=amplitude)) == pytest.approx(
        amplitude * rise, rel=1e-12, abs=1e-15
    )


@pytest.mark.parametrize("name", line.PROFILES)
def test_profiles_have_the_shape_of_the_positions(name):
    found = line.PROFILES[name](np.linspace(0, 4, 6).reshape(2, 3))
    assert found.shape == (2, 3) and found.dtype == np.float64
    assert found.max() == 0.5


# Files


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "profile.csv"
        path.write_text(text)
        return path

    return write


def test_a_profile_from_a_file(written):
    path = written("irradiance,x,note\n0,-1,left\n2,1,\n1,5,right\n")
    found = line.load(path, np.array([[-9.0, -1.0, 0.0], [2.0, 5.0, 9.0]]))
    assert found.tolist() == [[0.0, 0.0, 1.0], [1.75, 1.0, 1.0]]
    assert found.dtype == np.float64
    assert line.load(written("x,irradiance\n2,0.3\n"), np.array([0.0, 5.0])).tolist() == [0.3, 0.3]


@pytest.mark.parametrize(
    "text, message",
    [
        ("x,irradiance\n0,1\n1\n", "row 3: 1 cells for 2 columns; write one cell per column"),
        ("x,irradiance\n0,1\n1,2,3\n", "row 3: 3 cells for 2 columns; write one cell per column"),
        (
            "x,irradiance\n0,nan\n",
            "row 2: column 'irradiance' has 'nan' where a number belongs; write a number",
        ),
        ("x,irradiance\n,1\n", "row 2: column 'x' has '' where a number belongs; write a number"),
        ("x,light\n0,1\n", "row 1: there is no column 'irradiance'; name one of them 'irradiance'"),
        ("y,irradiance\n0,1\n", "row 1: there is no column 'x'; name one of them 'x'"),
        ("x,irradiance\n0,1\n2,1\n1,1\n", "row 4: x does not rise; sort the rows and keep one of each"),
        ("x,irradiance\n0,1\n0,2\n", "row 3: x does not rise; sort the rows and keep one of each"),
        ("x,irradiance\n0,1\n1,-2\n", "row 3: irradiance is -2; write a number of at least 0"),
    ],
)
def test_faults_of_files(written, text, message):
    with pytest.raises(FileError) as caught:
        line.load(written(text), 0.0)
    assert str(caught.value) == f"profile.csv, {message}"


# Faults


@pytest.mark.parametrize(
    "fault, message",
    [
        ({"irradiance": np.ones(4)}, r"irradiance must have shape \(frames, texels\), got \(4,\)"),
        ({"irradiance": np.ones((2, 0))}, r"irradiance must have shape \(frames, texels\), got \(2, 0\)"),
        ({"irradiance": np.ones((0, 2))}, r"irradiance must have shape \(frames, texels\), got \(0, 2\)"),
        ({"irradiance": [[1.0, math.nan]]}, "irradiance must be finite and at least 0 everywhere"),
        ({"irradiance": [[1.0, -1.0]]}, "irradiance must be finite and at least 0 everywhere"),
        ({"irradiance": [[math.inf]]}, "irradiance must be finite and at least 0 everywhere"),
        ({"length": 0.0}, "length must be a positive length in mm, got 0.0"),
        ({"length": math.inf}, "length must be a positive length in mm, got inf"),
        ({"d": -1.0}, "d must be a positive length in mm, got -1.0"),
        ({"d": math.nan}, "d must be a positive length in mm, got nan"),
        ({"kernel": "areal"}, "kernel must be one of line, radial, got 'areal'"),
    ],
)
def test_faults_of_worlds(fault, message):
    arguments = {"irradiance": np.ones((1, 4)), "length": 1.0, "d": 0.1} | fault
    with pytest.raises(ValueError, match=message):
        line.world(arguments.pop("irradiance"), **arguments)


def test_light_whose_squares_do_not_fit():
    with pytest.raises(ValueError, match="irradiance must have squares that fit float32, got 1e"):
        line.world(np.array([[0.0, 1e25]], np.float32), length=1.0, d=0.1)
