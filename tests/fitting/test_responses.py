"""Beams, edges and lines of light against arcs integrated by SciPy, closed forms and their limits."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special, stats
from scipy.integrate import quad

from sssfit.fitting import responses
from sssfit.fitting.profile_models import Burley, Dipole, GaussianSum, Jimenez
from sssfit.profiles import separable
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET, SKIN_VARIANCES, SKIN_WEIGHTS

pytestmark = pytest.mark.usefixtures("x64")


def burley_ring(p, cutoff=np.inf):
    """Energy per mm of radius, 2 pi r R."""
    albedo, d = p
    kept = 1 - (np.exp(-cutoff) + 3 * np.exp(-cutoff / 3)) / 4
    return lambda r: albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (4 * d) / kept * (r <= cutoff * d)


def gaussian_ring(variances, weights):
    variances, weights = np.asarray(variances), np.asarray(weights)
    return lambda r: float(np.sum(weights * r / variances * np.exp(-r * r / (2 * variances))))


def jimenez_ring(p):
    weights = SKIN_WEIGHTS[1:, 0]
    return gaussian_ring((p[0] + FALLOFF_OFFSET) ** 2 * SKIN_VARIANCES[1:], p[1] * weights / weights.sum())


def dipole_ring(p, eta=1.3):
    scattering, absorption = p
    total = scattering + absorption
    inside = -1.4399 / eta**2 + 0.7099 / eta + 0.6681 + 0.0636 * eta
    depths = np.array([1, 1 + 4 / 3 * (1 + inside) / (1 - inside)]) / total
    decay = np.sqrt(3 * absorption * total)

    def ring(r):
        distance = np.hypot(r, depths)
        each = depths * (1 + decay * distance) * np.exp(-decay * distance) / distance**3
        return float(scattering / total / 2 * r * np.sum(each))

    return ring


# Name -> (model, parameters, ring, where its light ends, light that leaves where it entered).
CASES = {
    "burley": (Burley(), (0.7, 1.3), burley_ring((0.7, 1.3)), np.inf, 0.0),
    "cutoff": (Burley(16.0), (0.7, 1.3), burley_ring((0.7, 1.3), 16.0), 16 * 1.3, 0.0),
    "gaussians": (
        GaussianSum(3),
        (0.04, 0.5, 6.0, 0.2, 0.3, 0.1),
        gaussian_ring((0.04, 0.5, 6.0), (0.2, 0.3, 0.1)),
        np.inf,
        0.0,
    ),
    "jimenez": (Jimenez(), (0.4, 0.6), jimenez_ring((0.4, 0.6)), np.inf, 0.4),
    "dipole": (Dipole(1.4), (1.1, 0.02), dipole_ring((1.1, 0.02), 1.4), np.inf, 0.0),
}
ALL = pytest.mark.parametrize("case", CASES)
# One compiled program for each model; the tests take eight distances each.
beam, edge, line, radial = (
    jax.jit(function, static_argnums=0)
    for function in (responses.beam, responses.edge, responses.line, responses.radial)
)


def energy(case):
    model, p, *_ = CASES[case]
    return float(model.energy(jnp.array(p)))


def seen(case, share, breaks):
    """The integral of the ring's energy times the share of the ring that is lit."""
    _, _, ring, end, _ = CASES[case]
    ends = sorted({0.0, *(b for b in breaks if 0 < b < end), 0.05, 0.5, 3.0, 12.0, 40.0, 150.0, end})
    ends = [e for e in ends if e <= end]
    parts = [
        quad(lambda r: ring(r) * share(r), low, high, epsabs=1e-14, epsrel=1e-11, limit=200)[0]
        for low, high in zip(ends, ends[1:], strict=False)
    ]
    return sum(parts)


def share_in_disc(r, away, radius):
    """Of a circle of radius r round a point that is `away` from the centre of a disc."""
    if r <= abs(away - radius):
        return float(away < radius)
    if r >= away + radius:
        return 0.0
    cosine = (away * away + r * r - radius * radius) / (2 * away * r)
    return np.arccos(np.clip(cosine, -1, 1)) / np.pi


@ALL
def test_beam_is_the_sum_of_arcs(case):
    model, p, _, _, stays = CASES[case]
    for radius in (0.3, 4.0):
        away = radius * np.array([0.0, 0.2, 0.9, 0.999, 1.001, 1.1, 2.0, 8.0])
        found = beam(model, jnp.array(p), away, radius)
        expected = [
            seen(case, lambda r, a=a: share_in_disc(r, a, radius), [abs(a - radius), a + radius])  # noqa: B023
            + stays * (a < radius)
            for a in away
        ]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * energy(case))


@pytest.mark.parametrize("cutoff, d", [(16.0, 0.05), (16.0, 1.0), (3.0, 0.05), (3.0, 1.0)])
@pytest.mark.usefixtures("x64")
def test_beam_of_a_profile_that_is_cut_off(cutoff, d):
    radius, share = 2.0, 1 - (np.exp(-cutoff) + 3 * np.exp(-cutoff / 3)) / 4
    away = np.array([0.0, 0.5, 1.9, 1.99999, 2.00001, 2.05, 2.0 + 0.99 * cutoff * d])

    def ring(r):
        return (np.exp(-r / d) + np.exp(-r / (3 * d))) / (4 * d) / share

    def expected(a):
        ends = {0.0, cutoff * d, *(e for e in (abs(a - radius), a + radius, d / 9, d) if e < cutoff * d)}
        parts = [
            quad(
                lambda r: ring(r) * share_in_disc(r, a, radius), *ends, epsabs=1e-14, epsrel=1e-12, limit=400
            )[0]
            for ends in pairwise(sorted(ends))
        ]
        return sum(parts)

    found = beam(Burley(cutoff), jnp.array([1.0, d]), away, radius)
    np.testing.assert_allclose(found, [expected(a) for a in away], rtol=0, atol=1e-9)


@ALL
def test_beam_keeps_its_digits_far_outside(case):
    model, p, *_ = CASES[case]
    away = np.array([1.5, 2.0, 2.5, 3.0, 4.0, 7.0, 9.0, 12.0])
    found = beam(model, jnp.array(p), away, 1.0)
    expected = [seen(case, lambda r, a=a: share_in_disc(r, a, 1.0), [a - 1, a + 1]) for a in away]
    assert expected[-1] < 4e-3 * energy(case)
    # The absolute error of the reference, about 1e-14, is no part of what is asked.
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-14)


@ALL
def test_edge_is_the_sum_of_arcs(case):
    model, p, _, _, stays = CASES[case]
    x = np.array([-12.0, -2.0, -0.4, -0.05, 0.05, 0.7, 3.0, 12.0])
    shadow = [seen(case, lambda r, x=x: np.arccos(min(x / r, 1.0)) / np.pi if r > 0 else 0.0, [x]) for x in
              np.abs(x)]  # fmt: skip
    everything = seen(case, lambda _: 1.0, []) + stays
    expected = np.where(x > 0, shadow, everything - np.array(shadow))
    found = edge(model, jnp.array(p), x)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * everything)


@ALL
def test_line_is_the_sum_of_slices(case):
    model, p, ring, end, _ = CASES[case]
    third = float(model.reach(jnp.array(p))) / 3
    x = third * np.array([-0.5, -1e-3, 1e-6, 0.01, 0.1, 0.4, 0.7, 1.0])

    def slice_at(x):
        # r = x cosh u turns 2 R dy into ring(r) / pi du, with no singularity at r = x.
        parts = np.linspace(0, np.arccosh(min(end, 900.0) / x), 9)
        return sum(
            quad(lambda u: ring(x * np.cosh(u)) / np.pi, low, high, epsabs=0, epsrel=1e-11, limit=200)[0]
            for low, high in zip(parts, parts[1:], strict=False)
            if ring(x * np.cosh(low)) > 0
        )

    expected = [slice_at(abs(x)) for x in x]
    np.testing.assert_allclose(line(model, jnp.array(p), x), expected, rtol=1e-9)


def test_burley_line_and_edge_have_closed_forms():
    x, p = np.array([-20, -0.3, -1e-4, 1e-6, 0.02, 1.0, 7.0, 40.0]), jnp.array([0.8, 1.5])
    spread, above = 0.8 * separable.line_spread(x, 1.5), 0.8 * separable.line_sf(x, 1.5)
    np.testing.assert_allclose(line(Burley(), p, x), spread, rtol=1e-9)
    np.testing.assert_allclose(edge(Burley(), p, x), above, rtol=0, atol=1e-10)


def test_gaussian_line_and_edge_have_closed_forms():
    x = np.array([-3.0, -1.0, -0.1, 0.0, 0.2, 1.0, 2.0, 4.0])
    variances, weights = np.array([0.3, 2.0, 0.01]), np.array([0.4, 0.25, 0.2])
    p = jnp.array([*variances, *weights])
    root = np.sqrt(variances)
    spread = np.sum(weights * stats.norm.pdf(x[:, None], scale=root), axis=1)
    above = np.sum(weights * special.erfc(x[:, None] / root / np.sqrt(2)) / 2, axis=1)
    # On the line itself the nodes reach down to 1e-12 of the reach.
    error = np.abs(line(GaussianSum(3), p, x) / spread - 1)
    assert np.all(error < np.where(x == 0, 1e-6, 1e-9))
    np.testing.assert_allclose(edge(GaussianSum(3), p, x), above, rtol=0, atol=1e-10)


@ALL
def test_limits(case):
    model, p, *_ = CASES[case]
    p, everything = jnp.array(p), energy(case)
    far = np.array([-1e9, -1e6, -1e3, 0.0, 1e3, 1e4, 1e6, 1e9])
    # Absorption cuts off the dipole, too.
    np.testing.assert_allclose(beam(model, p, np.zeros(8), 1e6), everything, rtol=1e-9)
    np.testing.assert_allclose(
        edge(model, p, far), everything * np.array([1, 1, 1, 0.5, 0, 0, 0, 0]), rtol=1e-12, atol=1e-12
    )
    assert np.all(np.abs(np.delete(line(model, p, far), 3)) < 1e-12)


def test_both_sides_of_an_edge_make_the_whole():
    model, p, *_ = CASES["burley"]
    x = jnp.geomspace(1e-3, 30, 8)
    both = edge(model, jnp.array(p), x) + edge(model, jnp.array(p), -x)
    np.testing.assert_allclose(both, 0.7, rtol=1e-14)


@pytest.mark.parametrize("response", responses.RESPONSES)
def test_compiled_and_batched_are_the_same(response):
    seen = responses.function(response, 1.5 if response == "beam" else None)
    model, p, r = Jimenez(), jnp.array([[0.7, 1.3], [0.2, 0.4]]), jnp.array([0.2, 1.5, 4.0])
    with jax.disable_jit():
        eager = jnp.stack([seen(model, row, r) for row in p])
    batched = jax.jit(jax.vmap(lambda row: seen(model, row, r)))(p)
    np.testing.assert_allclose(batched, eager, rtol=1e-13)


def all_of_them(model, p, shift):
    distances = jnp.array([0.0, 0.5, 1.0, 3.0]) + shift
    seen = (responses.beam(model, p, distances, 1.0), responses.edge(model, p, jnp.append(distances, -1.0)))
    return jnp.concatenate([*seen, responses.line(model, p, distances[1:])])


@pytest.mark.parametrize(
    "case", [name if name == "cutoff" else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
)
def test_slopes_are_finite_and_right(case):
    model, p, *_ = CASES[case]
    p = jnp.array(p)
    compiled = jax.jit(all_of_them, static_argnums=0)
    by_p, by_shift = jax.jit(jax.jacfwd(all_of_them, argnums=(1, 2)), static_argnums=0)(model, p, 0.0)
    backward = jax.jit(jax.grad(lambda p: jnp.sum(all_of_them(model, p, 0.0))))(p)
    assert np.all(np.isfinite(by_p)) and np.all(np.isfinite(by_shift))
    np.testing.assert_allclose(backward, jnp.sum(by_p, axis=0), rtol=1e-9)
    for i in range(len(p)):
        e = 1e-5 * p[i]
        expected = (compiled(model, p.at[i].add(e), 0.0) - compiled(model, p.at[i].add(-e), 0.0)) / (2 * e)
        np.testing.assert_allclose(by_p[:, i], expected, rtol=1e-6, atol=1e-8 / float(p[i]))


@ALL
def test_single_precision(case):
    model, p, *_ = CASES[case]
    single, r = jnp.array(p, jnp.float32), jnp.array([0.01, 0.1, 0.5, 0.999, 1.0, 1.5, 3.0, 6.0], jnp.float32)
    whole = energy(case)
    for seen, relative, absolute in (
        (radial, 2e-5, 0),
        (line, 2e-5, 0),
        (edge, 0, 2e-6 * whole),
        (lambda *given: beam(*given, jnp.ones((), given[1].dtype)), 0, 2e-6 * whole),
    ):
        found, expected = seen(model, single, r), seen(model, single.astype(float), r.astype(float))
        assert found.dtype == jnp.float32
        np.testing.assert_allclose(found, expected, rtol=relative, atol=absolute)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("square",), "response must be one of radial, line, edge, beam, got 'square'"),
        (("beam",), "beam_radius must be a length in mm above 0 for a beam, got None"),
        (("beam", 0.0), "beam_radius must be a length in mm above 0 for a beam, got 0.0"),
        (("beam", float("nan")), "above 0 for a beam, got nan"),
        (("beam", float("inf")), "above 0 for a beam, got inf"),
        (("edge", 1.0), "beam_radius belongs to the response 'beam', not to 'edge'"),
    ],
)
def test_refusals(arguments, message):
    with pytest.raises(ValueError, match=message):
        responses.function(*arguments)


def test_functions_are_made_once():
    # Compiled code is kept by a function's identity.
    assert responses.function("beam", 2.0) is responses.function("beam", 2.0)
    assert responses.function("line") is responses.line
