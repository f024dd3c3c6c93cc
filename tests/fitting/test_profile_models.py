"""The profiles that are fitted: energies that add up, integrals by SciPy, names, units, bounds, refusals."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from sssfit.fitting.profile_model import DERIVED_UNITS, Parameter
from sssfit.fitting.profile_models import Burley, Dipole, GaussianSum, Jimenez, named
from sssfit.profiles import dipole

CASES = {
    "burley": (Burley(), (0.7, 1.3)),
    "cutoff": (Burley(16.0), (0.7, 1.3)),
    "gaussians:1": (GaussianSum(1), (0.5, 0.6)),
    "gaussians:3": (GaussianSum(3), (0.04, 0.5, 6.0, 0.2, 0.3, 0.1)),
    "jimenez": (Jimenez(), (0.4, 0.6)),
    "dipole": (Dipole(1.4), (1.1, 0.02)),
}
ALL = pytest.mark.parametrize("case", CASES)


class Seen(NamedTuple):
    profile: jax.Array
    within: jax.Array
    beyond: jax.Array
    slope: jax.Array
    energy: jax.Array
    reach: jax.Array
    beyond_reach: jax.Array


@functools.partial(jax.jit, static_argnums=0)
def seen(model, p, r) -> Seen:
    """All that a model says at eight distances, in one compiled program."""
    beyond, slope = jax.jvp(lambda r: model.beyond(p, r), (r,), (jnp.ones_like(r),))
    energy, reach = model.energy(p), model.reach(p)
    left = model.beyond(p, reach)
    return Seen(model.profile(p, r), model.within(p, r), beyond, slope, energy, reach, left)


@ALL
def test_within_and_beyond_make_the_energy(case, x64):
    model, p = CASES[case]
    found = seen(model, jnp.array(p), jnp.array([0.0, 1e-9, 0.01, 1.0, 5.0, 20.0, 1e3, 1e9]))
    np.testing.assert_allclose(found.within + found.beyond, found.energy, rtol=1e-14)
    assert np.all(np.diff(found.within) >= 0) and np.all(np.diff(found.beyond) <= 0)
    stays = 0.4 if case == "jimenez" else 0.0
    assert float(found.within[0]) == pytest.approx(stays, abs=1e-15)
    assert float(found.beyond[-1]) == 0
    assert float(found.beyond_reach) <= 1e-16 * float(found.energy)


@ALL
def test_the_profile_integrates_to_the_energy(case, x64):
    model, p = CASES[case]

    def ring(r):
        return 2 * np.pi * r * float(seen(model, jnp.array(p), jnp.full(8, r)).profile[0])

    ends = [1e-12, 0.05, 0.5, 3.0, 12.0, 16 * 1.3, 40.0, 400.0, 2000.0]
    parts = [
        quad(ring, a, b, epsabs=1e-13, epsrel=1e-10, limit=200)[0]
        for a, b in zip(ends, ends[1:], strict=False)
    ]
    found = seen(model, jnp.array(p), jnp.array([0, 3.0, 0, 0, 0, 0, 0, 0]))
    assert sum(parts) == pytest.approx(float(found.beyond[0]), rel=1e-9)
    assert sum(parts[:3]) == pytest.approx(float(found.within[1] - found.within[0]), rel=1e-9)


@ALL
def test_tails_keep_their_digits(case, x64):
    model, p = CASES[case]
    # -d beyond / dr = 2 pi r R, also where beyond is small beside the energy.
    r = jnp.geomspace(0.1, 14.0, 8)
    found = seen(model, jnp.array(p), r)
    np.testing.assert_allclose(-found.slope, 2 * jnp.pi * r * found.profile, rtol=1e-10)


@ALL
def test_precision_is_that_of_the_parameters(case, x64):
    model, p = CASES[case]
    single, r = jnp.array(p, jnp.float32), jnp.geomspace(0.05, 4.0, 8, dtype=jnp.float32)
    found, expected = seen(model, single, r), seen(model, single.astype(float), r.astype(float))
    for name in ("profile", "within", "beyond", "energy", "reach"):
        assert getattr(found, name).dtype == jnp.float32
        # The energy within a dipole is a difference.
        absolute = 5e-7 * float(found.energy) if name == "within" else 0
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=2e-5, atol=absolute)


@ALL
def test_parameters_have_units_bounds_and_candidates(case):
    model, p = CASES[case]
    assert len(model.parameters) == len(p)
    shortest, longest = 0.1, 20.0
    candidates = model.candidates(shortest, longest)
    others = [parameter for parameter in model.parameters if not parameter.is_share]
    assert candidates.shape[1] == len(others) and candidates.shape[0] >= 4
    low, high = np.array([parameter.bounds(shortest, longest) for parameter in others]).T
    assert np.all(candidates > low) and np.all(candidates < high)
    for parameter in model.parameters:
        assert (
            parameter.unit
            == {"length": "mm", "area": "mm^2", "coefficient": "1/mm", "share": "1"}[parameter.kind]
        )


@ALL
def test_all_lengths_may_be_scaled(case):
    model, _ = CASES[case]
    if case == "jimenez":
        pytest.skip("its offset of 0.001 mm is a length of its own")
    powers = np.array(
        [{"length": 1, "area": 2, "coefficient": -1, "share": 0}[q.kind] for q in model.parameters]
    )
    shapes = powers[[not parameter.is_share for parameter in model.parameters]]
    np.testing.assert_allclose(
        model.candidates(0.3, 60.0), model.candidates(0.1, 20.0) * 3.0**shapes, rtol=1e-12
    )
    for parameter, power in zip(model.parameters, powers, strict=True):
        low, high = parameter.bounds(0.1, 20.0)
        assert parameter.bounds(0.3, 60.0) == pytest.approx((low * 3.0**power, high * 3.0**power), rel=1e-12)


def test_bounds_of_each_kind():
    assert Parameter("d", "length").bounds(0.1, 20.0) == pytest.approx((1e-4, 2e4))
    assert Parameter("variance_1", "area").bounds(0.1, 20.0) == pytest.approx((1e-8, 4e8))
    assert Parameter("sigma_a", "coefficient").bounds(0.1, 20.0) == pytest.approx((1 / 2e4, 1e4))
    assert Parameter("albedo", "share").bounds(0.1, 20.0) == (0.0, math.inf)


@pytest.mark.parametrize(
    "name, stem", [("weight_12", "weight"), ("sigma_a", "sigma_a"), ("d", "d"), ("falloff", "falloff")]
)
def test_stems(name, stem):
    assert Parameter(name, "share").stem == stem


def test_a_cutoff_keeps_the_albedo_and_the_shape(x64):
    p, r = jnp.array([0.6, 0.5]), jnp.array([0.1, 2.0, 7.99, 8.0, 8.01, 9.0, 10.0, 11.0])
    cut, whole = seen(Burley(16.0), p, r), seen(Burley(), p, r)
    lost = (math.exp(-16) + 3 * math.exp(-16 / 3)) / 4
    np.testing.assert_allclose(cut.profile[:4], whole.profile[:4] / (1 - lost), rtol=1e-14)
    assert np.all(cut.profile[4:] == 0) and np.all(whole.profile[4:] > 0)
    np.testing.assert_allclose(cut.within[3:], 0.6, rtol=1e-14)
    assert np.all(np.abs(cut.beyond[3:]) < 1e-16)


def test_derived(x64):
    assert float(Burley().derived(jnp.array([0.5, 2.0]))["dmfp"]) == pytest.approx(2 * (3.5 + 100 * 0.17**4))
    assert np.isnan(float(Burley().derived(jnp.array([1.2, 2.0]))["dmfp"]))
    assert float(GaussianSum(2).derived(jnp.array([1.0, 2.0, 0.3, 0.4]))["albedo"]) == pytest.approx(0.7)
    assert Jimenez().derived(jnp.array([0.4, 0.6])) == {}
    found = Dipole(1.3).derived(jnp.array([1.0, 0.02]))
    assert float(found["dmfp"]) == pytest.approx(1 / math.sqrt(3 * 0.02 * 1.02), rel=1e-14)
    assert float(found["albedo"]) == pytest.approx(float(dipole.diffuse_reflectance(1.0, 0.02, 1.3)))
    for model in (Burley(), GaussianSum(2), Dipole()):
        assert set(model.derived(jnp.ones(len(model.parameters)))) <= set(DERIVED_UNITS)


def test_names():
    for name in ("burley", "gaussians:1", "gaussians:8", "dipole", "jimenez"):
        assert named(name).name == name
    assert named("dipole", eta=1.5) == Dipole(1.5)
    assert named("burley", cutoff=16.0) == Burley(16.0)
    assert [parameter.name for parameter in named("gaussians:2").parameters] == [
        "variance_1",
        "variance_2",
        "weight_1",
        "weight_2",
    ]


@pytest.mark.parametrize(
    "name, options, message",
    [
        (
            "lambert",
            {},
            "model must be one of burley, gaussians:K, dipole, jimenez with K from 1 to 8, got 'lam",
        ),
        ("gaussians", {}, "got 'gaussians'"),
        ("gaussians:0", {}, "K from 1 to 8, got 'gaussians:0'"),
        ("gaussians:9", {}, "K from 1 to 8, got 'gaussians:9'"),
        ("gaussians:2.5", {}, "got 'gaussians:2.5'"),
        ("gaussians:-1", {}, "got 'gaussians:-1'"),
        ("burley:2", {}, "got 'burley:2'"),
        ("dipole", {"eta": 0.2}, "eta must be from 0.3 to 3.5, got 0.2"),
        ("dipole", {"eta": math.nan}, "eta must be from 0.3 to 3.5, got nan"),
        ("burley", {"cutoff": 0.0}, "cutoff must be above 0, got 0.0"),
        ("burley", {"cutoff": math.nan}, "cutoff must be above 0, got nan"),
    ],
)
def test_refusals(name, options, message):
    with pytest.raises(ValueError, match=message):
        named(name, **options)
