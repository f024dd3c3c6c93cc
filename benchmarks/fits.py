"""Fits per second of `separable_to_burley.fit_many` beside loops over SciPy's solvers on the same problem.

    python benchmarks/fits.py

prints a Markdown table for each reading. docs/benchmarks.md explains it, and --page docs/benchmarks.md
puts the tables there.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import interleaved
import numpy as np
import page
from scipy.optimize import brentq, least_squares

from sssfit.fitting import separable_to_burley
from sssfit.fitting.separable_to_burley import DEFAULT_DOMAINS, READINGS, Reading
from sssfit.profiles.gaussian_sum import FALLOFF_OFFSET, SKIN_VARIANCES, SKIN_WEIGHTS

OURS = "fit_many"
#: SciPy's default for trf.
TOLERANCE = 1e-8
LOWER, UPPER = np.array([0.0, 1e-4]), np.array([1.0, np.inf])


class Problem(NamedTuple):
    """One fit in NumPy; the parameters are the albedo and d / phi."""

    rho: np.ndarray
    scale: np.ndarray
    wanted: np.ndarray

    def curve(self, d: float) -> tuple[np.ndarray, np.ndarray]:
        """Burley's weighted curve for an albedo of 1, and its derivative in d."""
        x = self.rho / d
        slow = np.exp(x / -3)
        fast = slow * slow * slow
        factor = self.scale / d
        return factor * (fast + slow), factor / d * (x * (fast + slow / 3) - fast - slow)

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        return parameters[0] * self.curve(parameters[1])[0] - self.wanted

    def jacobian(self, parameters: np.ndarray) -> np.ndarray:
        curve, change = self.curve(parameters[1])
        return np.stack([curve, parameters[0] * change], axis=1)

    def best_albedo(self, curve: np.ndarray) -> float:
        return min(max(float(curve @ self.wanted / (curve @ curve)), 0.0), 1.0)

    def slope(self, d: float) -> float:
        """Derivative in d of half the squared misfit, the albedo being the best one for each d."""
        curve, change = self.curve(d)
        albedo = self.best_albedo(curve)
        return albedo * float(change @ (albedo * curve - self.wanted))


class Result(NamedTuple):
    """Rounds of seconds per fit, and the parameters found, (n, 2): albedo, d in mm."""

    seconds: np.ndarray
    parameters: np.ndarray


def problem(falloff: float, rho: np.ndarray, weights: np.ndarray, reading: Reading) -> Problem:
    """The default objective of `separable_to_burley.fit`, written in plain NumPy."""
    phi = falloff + FALLOFF_OFFSET
    variances, energies = SKIN_VARIANCES[1:], SKIN_WEIGHTS[1:, 0]
    wanted = np.exp(rho[:, None] ** 2 / (-2 * variances)) @ (energies / (2 * np.pi * variances))
    if reading == "radial":
        wanted = wanted * rho * phi
    root = np.sqrt(weights * phi)
    # Absolute tolerances mean the same for every falloff once the data's norm is 1.
    root = root / np.linalg.norm(root * wanted)
    return Problem(rho, root / (8 * np.pi * phi), root * wanted)


def by_trf(problem: Problem, jacobian: bool) -> np.ndarray:
    """SciPy's bounded least squares in both parameters, from the start that `fit` uses."""
    start = np.array([min(problem.best_albedo(problem.curve(0.5)[0]), 0.95), 0.5])
    derivative: Any = problem.jacobian if jacobian else "2-point"
    tolerances = dict.fromkeys(("ftol", "xtol", "gtol"), TOLERANCE)
    return least_squares(problem.residuals, start, derivative, (LOWER, UPPER), x_scale="jac", **tolerances).x


def by_brentq(problem: Problem) -> np.ndarray:
    """SciPy's bracketing root finder on the slope in d alone, the reduction that fit_many uses."""
    d: Any = brentq(problem.slope, 0.01, 10.0, xtol=1e-10)
    return np.array([problem.best_albedo(problem.curve(d)[0]), d])


def solve_all(solver: Callable, falloffs: np.ndarray, reading: Reading) -> np.ndarray:
    """Fit one falloff after the other: (n, 2), albedo and d in mm."""
    rho, weights = DEFAULT_DOMAINS["difference"].nodes()
    found = [solver(problem(float(falloff), rho, weights, reading)) for falloff in falloffs]
    return np.stack(found) * np.stack([np.ones_like(falloffs), falloffs + FALLOFF_OFFSET], axis=1)


def ours(falloffs: np.ndarray, reading: Reading) -> np.ndarray:
    """The same by sssfit."""
    albedo, d, _, converged = separable_to_burley.fit_many(falloffs, reading=reading)
    if not converged.all():
        raise RuntimeError(f"{np.sum(~converged)} fits did not converge")
    return np.stack([albedo, d], axis=1)


def compare(falloffs: np.ndarray, few: np.ndarray, reading: Reading, repeats: int) -> dict[str, Result]:
    """Seconds per fit of fit_many on all falloffs and of the loops on a few, measured in turns."""
    loops = {
        "SciPy trf, analytic Jacobian": lambda problem: by_trf(problem, True),
        "SciPy trf, 2-point Jacobian": lambda problem: by_trf(problem, False),
        "SciPy brentq, albedo eliminated": by_brentq,
    }
    programs = {OURS: lambda: ours(falloffs, reading)} | {
        name: lambda loop=loop: solve_all(loop, few, reading) for name, loop in loops.items()
    }
    times = interleaved.measure(programs, repeats)
    counts = {name: len(falloffs if name == OURS else few) for name in programs}
    found = {name: program() for name, program in programs.items()} | {OURS: ours(few, reading)}
    return {name: Result(times[name] / counts[name], found[name]) for name in programs}


def table(results: dict[str, Result]) -> str:
    """Fits per second, and how many times slower than fit_many, as a Markdown table."""
    lines = [
        "| Solver | fits per second (quartiles) | fit_many is faster by (quartiles) | parameters differ by |",
        "|:--|--:|--:|--:|",
    ]
    reference = results[OURS]
    for name, result in results.items():
        rate = interleaved.quartiles(1 / result.seconds)
        ratio = interleaved.quartiles(result.seconds / reference.seconds)
        difference = np.max(np.abs(result.parameters / reference.parameters - 1))
        lines.append(
            f"| {name} | {rate.median:,.0f} ({rate.lower:,.0f} to {rate.upper:,.0f}) "
            f"| {ratio.median:.1f} ({ratio.lower:.1f} to {ratio.upper:.1f}) | {difference:.0e} |"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> dict[Reading, dict[str, Result]]:
    """Measure, print, and write the page asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--falloffs", type=int, default=4096, help="fits of a run of fit_many")
    parser.add_argument("--loop-falloffs", type=int, default=256, help="fits of a run of the loops")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each")
    parser.add_argument("--page", type=Path, help="put the tables between their marks in this page")
    options = parser.parse_args(arguments)
    falloffs, few = (np.linspace(0.01, 1, count) for count in (options.falloffs, options.loop_falloffs))
    neighbours = interleaved.Neighbours()
    everything, tables = {}, []
    for reading in READINGS:
        start = time.perf_counter()
        ours(falloffs, reading)
        first = time.perf_counter() - start
        results = everything[reading] = compare(falloffs, few, reading, options.repeats)
        later = np.median(results[OURS].seconds) * len(falloffs)
        calls = f"first call {first:.2f} s, with the compilation; later calls {later:.3f} s"
        tables.append(f"Reading `{reading}`, {len(falloffs)} fits: {calls}.\n\n{table(results)}")
    conditions = f"{interleaved.machine()}; {neighbours.describe()}. {options.repeats} rounds."
    report = "\n\n".join([conditions, *tables])
    print(report)
    if options.page:
        page.replace(options.page, "fits", report)
    return everything


if __name__ == "__main__":
    main()
