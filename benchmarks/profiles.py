"""Fits per second of `measured_many.fit` beside loops over SciPy and jaxopt, and the time of a posterior.

    python benchmarks/profiles.py

prints Markdown tables. docs/benchmarks.md explains them, and --page docs/benchmarks.md puts them there.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import interleaved
import jax
import jax.numpy as jnp
import numpy as np
import page
from scipy.optimize import least_squares

from sssfit.fitting import measured, measured_many, posterior

OURS = "measured_many"
POINTS, SEED = 48, 20261129
R = np.geomspace(0.1, 20, POINTS)


class Curves(NamedTuple):
    """Noisy curves of Burley's profile, each of shape (number, POINTS)."""

    values: np.ndarray
    sigma: np.ndarray


class Result(NamedTuple):
    """Rounds of seconds per fit, and the parameters found, (n, 2): albedo, d in mm."""

    seconds: np.ndarray
    parameters: np.ndarray


def profile(r: np.ndarray, albedo, d) -> np.ndarray:
    slow = np.exp(r / (-3 * d))
    return albedo * (slow + slow * slow * slow) / (8 * np.pi * d * r)


def curves(number: int) -> Curves:
    """Albedos from 0.1 to 0.9, shapes from 0.3 to 3 mm, noise of 0.5 to 10 %."""
    random = np.random.default_rng(SEED)
    albedo = random.uniform(0.1, 0.9, (number, 1))
    d, noise = (10 ** random.uniform(*ends, (number, 1)) for ends in ((-0.5, 0.5), (-2.3, -1)))
    clean = profile(R, albedo, d)
    return Curves(clean * (1 + noise * random.normal(size=clean.shape)), noise * clean)


def start(values: np.ndarray) -> np.ndarray:
    """Albedo and d from the curve's energy and mean distance: what one would write by hand."""
    density = 2 * np.pi * R * np.maximum(values, 0)
    energy = np.trapezoid(density, R)
    return np.array([energy, np.trapezoid(R * density, R) / energy / 2.5])


def by_scipy(given: Curves, jacobian: bool) -> np.ndarray:
    """SciPy's Levenberg-Marquardt (MINPACK), one curve after the other."""
    found = []
    for values, sigma in zip(*given, strict=True):

        def residuals(p, values=values, sigma=sigma):
            return (profile(R, *p) - values) / sigma

        def slopes(p, sigma=sigma):
            x = R / p[1]
            slow = np.exp(x / -3)
            fast = slow * slow * slow
            factor = 1 / (8 * np.pi * p[1] * R) / sigma
            change = p[0] * factor / p[1] * (x * (fast + slow / 3) - fast - slow)
            return np.stack([factor * (fast + slow), change], axis=1)

        derivative: Any = slopes if jacobian else "2-point"
        found.append(least_squares(residuals, start(values), derivative, method="lm").x)
    return np.array(found)


def jaxopt_program() -> Callable[[Curves], np.ndarray]:
    """jaxopt's Levenberg-Marquardt under vmap, in the logarithms of both parameters."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt

    def residuals(z, values, sigma):
        slow = jnp.exp(R / (-3 * jnp.exp(z[1])))
        return (jnp.exp(z[0] - z[1]) * (slow + slow**3) / (8 * jnp.pi * R) - values) / sigma

    solver = jaxopt.LevenbergMarquardt(residuals, maxiter=50, tol=1e-6)
    run = jax.jit(jax.vmap(lambda z, values, sigma: solver.run(z, values, sigma).params))

    def program(given: Curves) -> np.ndarray:
        with jax.enable_x64(True):
            starts = np.log([start(values) for values in given.values])
            return np.exp(np.asarray(run(starts, *given)))

    return program


def ours(given: Curves) -> np.ndarray:
    found = measured_many.fit(R, given.values, sigma=given.sigma)
    if not found.converged.all():
        raise RuntimeError(f"{np.sum(~found.converged)} fits did not converge")
    return found.parameters


def compare(number: int, few: int, repeats: int) -> tuple[dict[str, Result], float]:
    """Seconds per fit, ours and jaxopt's of all curves and SciPy's of a few; seconds of our first call."""
    given = curves(number)
    some = Curves(given.values[:few], given.sigma[:few])
    by_jaxopt = jaxopt_program()
    begun = time.perf_counter()
    ours(given)
    first = time.perf_counter() - begun
    programs: dict[str, Callable[[], np.ndarray]] = {
        OURS: lambda: ours(given),
        "jaxopt LevenbergMarquardt, vmap": lambda: by_jaxopt(given),
        "SciPy lm, analytic Jacobian": lambda: by_scipy(some, True),
        "SciPy lm, 2-point Jacobian": lambda: by_scipy(some, False),
    }
    times = interleaved.measure(programs, repeats)
    found = {name: program() for name, program in programs.items()}
    return {name: Result(times[name] / len(found[name]), found[name]) for name in programs}, first


def table(results: dict[str, Result]) -> str:
    """Fits per second, and how many times slower than ours, as a Markdown table."""
    lines = [
        "| solver | fits per second (quartiles) | ours is faster by (quartiles) | parameters differ by |",
        "|:--|--:|--:|--:|",
    ]
    reference = results[OURS]
    for name, result in results.items():
        rate = interleaved.quartiles(1 / result.seconds)
        ratio = interleaved.quartiles(result.seconds / reference.seconds)
        apart = np.abs(result.parameters / reference.parameters[: len(result.parameters)] - 1).max(axis=1)
        lines.append(
            f"| {name} | {rate.median:,.0f} ({rate.lower:,.0f} to {rate.upper:,.0f}) "
            f"| {ratio.median:.1f} ({ratio.lower:.1f} to {ratio.upper:.1f}) "
            f"| {np.median(apart):.0e}, largest {apart.max():.0e} |"
        )
    return "\n".join(lines)


def posterior_seconds(walkers: int, steps: int) -> tuple[float, float]:
    """Seconds of a posterior's first chain, with the compilation, and of a second one."""
    given = curves(1)
    seconds = []
    for seed in range(2):
        begun = time.perf_counter()
        posterior.sample(R, given.values[0], sigma=given.sigma[0], walkers=walkers, steps=steps, seed=seed)
        seconds.append(time.perf_counter() - begun)
    return seconds[0], seconds[1]


def one_fit_seconds() -> tuple[float, float]:
    """Seconds of the first `measured.fit`, with the compilation, and of a second one."""
    given = curves(2)
    seconds = []
    for values, sigma in zip(*given, strict=True):
        begun = time.perf_counter()
        measured.fit(R, values, sigma=sigma)
        seconds.append(time.perf_counter() - begun)
    return seconds[0], seconds[1]


def main(arguments: Sequence[str] | None = None) -> dict[str, Result]:
    """Measure, print, and write the page asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--number", type=int, default=10_000, help="curves of the batch")
    parser.add_argument("--few", type=int, default=200, help="curves of the loops")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--walkers", type=int, default=32)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--page", type=Path, help="write the tables into this page")
    options = parser.parse_args(arguments)
    neighbours = interleaved.Neighbours()
    single, again = one_fit_seconds()
    results, first = compare(options.number, options.few, options.repeats)
    chain, next_chain = posterior_seconds(options.walkers, options.steps)
    later = options.number * interleaved.quartiles(results[OURS].seconds).median
    lines = [
        f"{interleaved.machine()}; {neighbours.describe()}. {options.repeats} rounds.",
        "",
        f"{options.number} curves of {POINTS} points: first call {first:.2f} s, with the compilation; "
        f"later calls {later:.3f} s. One `measured.fit`: {single:.1f} s at first, then {1e3 * again:.0f} ms.",
        "",
        table(results),
        "",
        f"A posterior of {options.walkers} walkers and {options.steps} steps: {chain:.1f} s, with the "
        f"compilation, then {next_chain:.1f} s.",
    ]
    text = "\n".join(lines)
    print(text)
    if options.page:
        page.replace(options.page, "profiles", text)
    return results


if __name__ == "__main__":
    main()
