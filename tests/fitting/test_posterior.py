"""Posteriors against quadrature by other means than ours, against fits, and against themselves."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from sssfit.fitting import _posterior_density, measured, posterior
from sssfit.fitting.posterior import NotConverged, corner_figure, sample
from sssfit.profiles import dipole

R = np.geomspace(0.1, 15.0, 24)
# Bounds are so many standard errors: a chance of 6e-7 each, with those errors themselves estimated.
SIGMAS = 5.0


def burley(r, albedo, d):
    """Christensen and Burley's profile."""
    return albedo * (np.exp(-r / d) + np.exp(-r / (3 * d))) / (8 * np.pi * d * r)


def measured_curve(relative, seed=0, albedo=0.7, d=1.5):
    """Values with noise of this part of the truth, and its size."""
    sigma = relative * burley(R, albedo, d)
    return burley(R, albedo, d) + sigma * np.random.default_rng(seed).normal(size=len(R)), sigma


class Quadrature:
    """The posterior of albedo and d on a grid, uniform in albedo and in the logarithm of d.

    `log_likelihood` takes the profiles of all of them, shape (n, n, m).
    """

    def __init__(self, log_likelihood, albedo, d):
        nodes, weights = np.polynomial.legendre.leggauss(300)
        self.albedo = albedo[0] + (albedo[1] - albedo[0]) * (nodes + 1) / 2
        self.d = np.exp(np.log(d[0]) + np.log(d[1] / d[0]) * (nodes + 1) / 2)
        found = log_likelihood(burley(R, self.albedo[:, None, None], self.d[:, None]))
        density = np.exp(found - found.max()) * np.outer(weights, weights)
        self.density = density / density.sum()

    def marginal(self, name):
        return (self.albedo, self.density.sum(1)) if name == "albedo" else (self.d, self.density.sum(0))

    def compare(self, found):
        for name in ("albedo", "d"):
            x, p = self.marginal(name)
            mean = p @ x
            spread = np.sqrt(p @ np.square(x - mean))
            kurtosis = p @ np.power(x - mean, 4) / spread**4
            one, count = found.summary()[name], found.summary()[name].effective_samples
            assert abs(one.mean - mean) < SIGMAS * spread / np.sqrt(count)
            # The delta method, for the root of a mean of squares.
            assert abs(one.standard_deviation - spread) < SIGMAS * spread * np.sqrt(
                (kurtosis - 1) / 4 / count
            )
            middle = np.cumsum(p) - p / 2
            below = np.interp([one.median, *one.interval_68, *one.interval_95], x, middle)
            wanted = np.array([0.5, 0.16, 0.84, 0.025, 0.975])
            # A part of draws below a level is binomial.
            assert np.all(np.abs(below - wanted) < SIGMAS * np.sqrt(wanted * (1 - wanted) / count) + 1e-4)


@pytest.mark.parametrize("relative", [0.02, 0.5])
def test_known_noise_agrees_with_quadrature(relative):
    values, sigma = measured_curve(relative)
    box = {"albedo": (0.0, 1.0), "d": (0.2, 20.0)}
    # Of sharp data only a part of the box holds anything.
    near = {"albedo": (0.6, 0.8), "d": (1.2, 1.9)} if relative == 0.02 else box
    exact = Quadrature(lambda curves: -np.sum(np.square((values - curves) / sigma), axis=2) / 2, **near)
    exact.compare(sample(R, values, sigma=sigma, prior=box, steps=4000))


def test_unknown_noise_agrees_with_quadrature_over_its_size():
    values, _ = measured_curve(0.2, seed=1)
    box = {"albedo": (0.0, 1.0), "d": (0.5, 5.0)}

    def log_likelihood(curves):
        # Noise in proportion to the values, of a size whose density is one over it.
        squares = np.sum(np.square((values - curves) / values), axis=2)
        sizes = np.geomspace(0.03, 3.0, 200)
        return np.log(sum(np.exp(-squares / 2 / size**2 - len(R) * np.log(size / 0.2)) for size in sizes))

    found = sample(R, values, weights="relative", prior=box, steps=4000)
    Quadrature(log_likelihood, **box).compare(found)


def test_a_posterior_of_sharp_data_is_the_fits():
    values, sigma = measured_curve(1e-3)
    found = sample(R, values, sigma=sigma, steps=3000)
    fit = measured.fit(R, values, sigma=sigma)
    for name in ("albedo", "d", "dmfp"):
        one, estimate = found.summary()[name], fit.parameters[name]
        error, count = estimate.standard_error, one.effective_samples
        # Besides chance the curvature, of the order of the relative error itself.
        bent = 3 * error / estimate.value
        assert abs(one.mean - estimate.value) < error * (SIGMAS / np.sqrt(count) + bent)
        assert abs(one.standard_deviation / error - 1) < SIGMAS / np.sqrt(2 * count) + bent
        assert one.interval_95 == pytest.approx(estimate.interval_95, abs=error * (0.1 + bent))
    assert found.optimum["d"] == fit.parameters["d"].value and found.converged
    assert 0.2 < found.acceptance_fraction < 0.9


def test_draws_stay_in_the_prior_and_derived_ones_follow():
    values, sigma = measured_curve(0.3)
    found = sample(R, values, sigma=sigma, prior={"albedo": (0.68, 0.71), "d": (1.0, 1.4)}, steps=2500)
    draws = found.draws
    assert np.all((draws["albedo"] >= 0.68) & (draws["albedo"] <= 0.71))
    assert np.all((draws["d"] >= 1.0) & (draws["d"] <= 1.4))
    assert found.prior == {"albedo": (0.68, 0.71), "d": (1.0, 1.4)}
    through = draws["albedo"] * (np.exp(-5 / draws["d"]) + 3 * np.exp(-5 / draws["d"] / 3)) / 4
    np.testing.assert_allclose(draws["transmittance_5mm"], through, rtol=1e-12)
    scaling = 3.5 + 100 * (draws["albedo"] - 0.33) ** 4
    np.testing.assert_allclose(draws["dmfp"], scaling * draws["d"], rtol=1e-12)
    assert found.units == {"albedo": "1", "d": "mm", "dmfp": "mm", "transmittance_5mm": "1"}


def test_the_same_seed_draws_the_same():
    values, sigma = measured_curve(0.1)
    one, same, other = (sample(R, values, sigma=sigma, steps=60, seed=seed) for seed in (3, 3, 4))
    assert one.chain.tobytes() == same.chain.tobytes() and one.moves == posterior.DEFAULT_MOVES
    assert one.log_density.tobytes() == same.log_density.tobytes()
    assert one.chain.tobytes() != other.chain.tobytes()


def test_what_is_too_short_is_not_summed_up():
    values, sigma = measured_curve(0.1)
    found = sample(R, values, sigma=sigma, steps=100)
    assert not found.converged
    message = r"100 steps are too few: more than 50 autocorrelation times, 50 x .* steps at least, are needed"
    for ask in (found.summary, lambda: found.draws, lambda: found.burn_in, lambda: corner_figure(found)):
        with pytest.raises(NotConverged, match=message):
            ask()
    assert found.chain.shape == (100, 32, 2) and found.values["d"].shape == (100, 32)
    with pytest.raises(NotConverged, match="1 steps are too few"):
        sample(R, values, sigma=sigma, steps=1).summary()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weights": "area"}, "weights must be left out where sigma is given"),
        ({"prior": {"depth": (1, 2)}}, "prior must name some of albedo, d, got 'depth'"),
        ({"prior": {"d": (2, 1)}}, r"prior of 'd' must be \(low, high\) in mm, low above 0 .* got \(2, 1\)"),
        ({"prior": {"d": (0, 1)}}, "low above 0"),
        ({"prior": {"albedo": (-1, 1)}}, "low 0 or more"),
        ({"prior": {"albedo": (0, np.inf)}}, "below high"),
        ({"walkers": 7}, "walkers must be a whole number of at least 8, got 7"),
        ({"steps": 0}, "steps must be a whole number of at least 1, got 0"),
        ({"seed": -1}, "seed must be"),
        ({"moves": []}, "moves must name one at least"),
        ({"moves": [("jump", 1.0)]}, r"moves must be \(name, weight > 0\) of stretch, de"),
        ({"moves": [("de", 0.0)]}, "moves must be"),
    ],
)
def test_arguments_outside_of_their_domain(options, message):
    values, sigma = measured_curve(0.1)
    every: dict[str, Any] = {"sigma": sigma, "steps": 10} | options
    with pytest.raises(ValueError, match=message):
        sample(R, values, **every)


def log_densities(values, sigma, y, **options):
    """Of the problem that `sample` makes of the data, compiled and not."""
    caught = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(posterior, "_walk_all", lambda parts, *_: caught.extend(parts))
        patch.setattr(posterior._posterior_gather, "gathered", lambda *_: None)
        sample(R, values, sigma=sigma, **options)
    (part,) = caught
    rest = part.curves, part.lower, part.upper
    with jax.enable_x64(True):
        compiled = _posterior_density.log_densities(part.density, jnp.asarray(y), *rest)
        eager = [_posterior_density.log_density(part.density, jnp.asarray(row), *rest) for row in y]
    return np.asarray(compiled), np.array(eager)


@pytest.mark.parametrize(
    "loss, known",
    [("linear", True), ("linear", False), pytest.param("cauchy", True, marks=pytest.mark.slow)],
)
def test_compiled_densities_are_the_eager_ones(loss, known):
    values, sigma = measured_curve(0.1)
    y = np.array([[0.7, 0.4], [0.5, -0.5], [0.0, 3.0], [1.0, -9.0], [1.1, 0.4], [-0.1, 0.4], [0.5, 99.0]])
    compiled, eager = log_densities(values, sigma if known else None, y, loss=loss)
    np.testing.assert_allclose(compiled, eager, rtol=1e-12)
    assert np.all(np.isfinite(compiled[:4])) and np.all(compiled[4:] == -np.inf)


def cauchy(z, bend=2.385):
    return bend**2 / 2 * np.log1p((z / bend) ** 2)


@pytest.mark.parametrize(
    ("loss", "of"),
    [
        ("linear", lambda z: z**2 / 2),
        ("cauchy", cauchy),
    ],
)
def test_losses_are_what_they_say(loss, of):
    values, sigma = measured_curve(0.1)
    y = np.array([[0.7, 0.4], [0.3, 0.9]])
    wanted = [-np.sum(of((values - burley(R, a, np.exp(b))) / sigma)) for a, b in y]
    np.testing.assert_allclose(log_densities(values, sigma, y, loss=loss)[0], wanted, rtol=1e-10)


def test_an_outlier_hardly_moves_a_robust_posterior():
    values, sigma = measured_curve(0.05)
    clean = sample(R, values, sigma=sigma, steps=2500).summary()["d"]
    values[18] += 40 * sigma[18]
    robust = sample(R, values, sigma=sigma, loss="cauchy", steps=2500).summary()["d"]
    pulled = sample(R, values, sigma=sigma, steps=2500)
    assert abs(robust.mean - clean.mean) < clean.standard_deviation
    assert abs(pulled.summary()["d"].mean - clean.mean) > 3 * clean.standard_deviation
    assert any("the model does not fit" in note for note in pulled.notes)


def test_a_fit_beyond_the_prior_is_said():
    values = 3 * measured_curve(0.05)[0]
    found = sample(R, values, sigma=0.1 * values, steps=50)
    assert "the fitted albedo, 2.083, lies outside" in found.notes[-1] and "prior, 0 to 1" in found.notes[-1]
    assert np.all(found.values["albedo"] <= 1)
    wider = sample(R, values, sigma=0.1 * values, prior={"albedo": (0.0, 5.0)}, steps=50)
    assert not any("outside" in note for note in wider.notes)
    # An albedo above 1 has no diffuse mean free path.
    assert np.isnan(wider.autocorrelation["dmfp"]) and np.isfinite(wider.autocorrelation["d"])


@pytest.mark.slow
@pytest.mark.parametrize("albedo, d", [(0.999, 1e-2), (1e-3, 1e3), (0.999, 1e3)])
def test_extremes(albedo, d):
    r = d * np.geomspace(0.1, 10, 12)
    truth = burley(r, albedo, d)
    found = sample(r, truth, sigma=0.05 * truth, steps=3000).summary()
    for name, value in (("albedo", albedo), ("d", d)):
        low, high = found[name].interval_95
        assert low < value * 1.02 and high > value * 0.98
        assert np.isfinite(found[name].standard_deviation)
    assert 0 < found["albedo"].interval_95[0] and found["albedo"].interval_95[1] <= 1


@pytest.mark.slow
def test_as_many_points_as_parameters_and_little_noise():
    r = np.array([0.5, 4.0])
    truth = burley(r, 0.8, 1.0)
    sharp = sample(r, truth, sigma=1e-9 * truth, steps=3000).summary()
    assert sharp["d"].mean == pytest.approx(1.0, rel=1e-8)


@pytest.mark.slow
def test_another_model():
    r, planted = np.geomspace(0.1, 10, 20), (1.0, 0.02)
    with jax.enable_x64(True):
        truth = np.asarray(dipole.profile(r, *planted, 1.3))
    found = sample(r, truth, sigma=0.03 * truth + 1e-6, model="dipole", steps=8000).summary()
    for name, value in zip(("sigma_s_reduced", "sigma_a"), planted, strict=True):
        assert found[name].interval_95[0] < value < found[name].interval_95[1]


@pytest.mark.slow
@pytest.mark.parametrize("moves", [[("de", 0.8), ("de_snooker", 0.2)]])
def test_other_moves_draw_the_same(moves):
    values, sigma = measured_curve(0.02)
    found = sample(R, values, sigma=sigma, moves=moves, steps=4000)
    usual = sample(R, values, sigma=sigma, steps=4000)
    one, two = found.summary()["d"], usual.summary()["d"]
    assert found.moves == tuple(moves)
    assert abs(one.mean - two.mean) < SIGMAS * np.hypot(one.monte_carlo_error, two.monte_carlo_error)


@pytest.mark.slow
def test_ranks_of_the_truth_are_uniform():
    """Simulation-based calibration; docs/scripts/calibration.py has more of it."""
    box = {"albedo": (0.05, 0.95), "d": (0.3, 3.0)}
    sigma = 0.2 * burley(R, 0.5, np.sqrt(0.9))
    random = np.random.default_rng(5)
    ranks = []
    for seed in range(60):
        albedo, d = random.uniform(*box["albedo"]), np.exp(random.uniform(*np.log(box["d"])))
        values = burley(R, albedo, d) + sigma * random.normal(size=len(R))
        draws = sample(R, values, sigma=sigma, prior=box, moves=[("de", 1.0)], steps=800, seed=seed).draws
        chosen = np.linspace(0, draws["d"].size - 1, 99).round().astype(int)
        truths = {"albedo": albedo, "d": d, "dmfp": d * (3.5 + 100 * (albedo - 0.33) ** 4)}
        ranks.append([np.sum(draws[name][chosen] < truth) for name, truth in truths.items()])
    for column in np.array(ranks).T:
        counts = np.bincount(column // 10, minlength=10)
        assert stats.chi2.sf(np.sum(np.square(counts - 6.0)) / 6.0, 9) > 1e-3
        # Ranks are uniform on 0 to 99.
        assert abs(np.mean(column) - 49.5) < SIGMAS * np.sqrt((100**2 - 1) / 12 / 60)


def test_a_bar_is_shown_on_request(capsys):
    values, sigma = measured_curve(0.1)
    sample(R, values, sigma=sigma, steps=3, progress=True)
    shown = capsys.readouterr()
    assert "3/3" in shown.err and shown.out == ""


@pytest.mark.slow
def test_a_figure_marks_the_optimum():
    values, sigma = measured_curve(0.1)
    found = sample(R, values, sigma=sigma, steps=3000)
    figure = corner_figure(found)
    assert len(figure.axes) == 16
    assert [axes.get_xlabel() for axes in figure.axes[-4:]] == [
        "albedo",
        "d (mm)",
        "dmfp (mm)",
        "transmittance_5mm",
    ]
    marks = [np.asarray(line.get_xdata())[0] for line in figure.axes[0].lines]
    assert any(np.isclose(mark, found.optimum["albedo"]) for mark in marks)
    with pytest.raises(ValueError, match="names must be among albedo, d, dmfp"):
        corner_figure(found, ["c"])
