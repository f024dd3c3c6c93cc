"""What the moving moments do at the extremes: for each a bound that rounding implies, and what is measured.

`eps` is the spacing of the dtype's numbers just above 1. One step of the mean rounds its sum by at most
eps |m| / 2 and its increment by 1.5 alpha eps |x - m|. The recursion forgets errors as it forgets samples, so
that after T steps the mean is off by at most N = min(T, 1 / alpha) such errors, together d. The variance S
takes d in as 2 sqrt(S) d + d^2, and one step of its own rounds by at most 4.5 eps S. Where samples are random
and increments larger than a rounding, errors are independent with mean 0; 4 sqrt(N) of the largest is then
some ten standard deviations of their sum.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from sssfit.estimators import _reference, control_variate, moving

ALPHAS = (1e-6, 1e-3, 0.2, 1.0)
DTYPES = ("float16", "float32", "float64")
#: Samples of a stream, and of the long one.
SHORT, LONG = 1000, 10_000_000


class Row(NamedTuple):
    """One line of the table.

    Attributes:
        case: what is put in.
        quantity: what is measured.
        dtype: what the moments are stored in.
        bound: what rounding implies; 0 where it must be exact.
        measured: the largest found; a NaN fails.
    """

    case: str
    quantity: str
    dtype: str
    bound: float
    measured: float

    @property
    def holds(self) -> bool:
        """Whether the measured value keeps to the bound."""
        return bool(self.measured <= self.bound)


def table(cases: list[str] | None = None, *, long: int = LONG) -> Iterator[Row]:
    """The rows of all cases, one after the other as they are measured.

    Args:
        cases: names from `CASES`; all by default.
        long: samples of the long streams.

    Returns:
        An iterator of `Row`; the whole takes half a minute with the default length.

    Raises:
        ValueError: a case is unknown.

    Example:
        >>> all(row.holds for row in table(["constant input"]))
        True
    """
    unknown = [case for case in cases or [] if case not in CASES]
    if unknown:
        raise ValueError(f"cases must be some of {', '.join(CASES)}, got {', '.join(unknown)}")

    def rows() -> Iterator[Row]:
        for case in CASES if cases is None else cases:
            for dtype in DTYPES:
                with jax.enable_x64(True):
                    yield from CASES[case](jnp.dtype(dtype), long)

    return rows()


def _run(xs: np.ndarray, alpha: float, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance after each sample by the scan, in extended precision."""
    means = moving.scan("ema", jnp.asarray(xs), _alpha(xs, alpha), **options)[1]
    variances = moving.scan("emv", jnp.asarray(xs), _alpha(xs, alpha), **options)[1]
    return np.asarray(means).astype(np.longdouble), np.asarray(variances).astype(np.longdouble)


def _alpha(xs: np.ndarray, alpha: float) -> Any:
    """The weight as the recursion has it: in the dtype that it computes in."""
    return np.float64(alpha) if xs.dtype == np.float64 else np.float32(alpha)


def _bounds(xs: np.ndarray, alpha: float, mean: np.ndarray, variance: np.ndarray) -> tuple[float, float]:
    """Bounds of the errors of mean and variance; see the module's first lines."""
    info = jnp.finfo(xs.dtype)
    eps = float(info.eps)
    steps = min(len(xs), 1 / alpha)
    if alpha * np.sqrt(np.max(variance)) > eps * np.max(np.abs(mean)) and len(np.unique(xs)) > 2:
        steps = min(steps, 4 * np.sqrt(steps))
    # Below this, numbers are lost: float32 and float64 flush to 0, float16 has fixed steps.
    floor = float(info.smallest_subnormal if xs.dtype == np.float16 else info.tiny)
    wide = xs.astype(np.longdouble)
    deviation = np.max(np.abs(wide - np.concatenate([mean[:1], mean[:-1]])))
    of_mean = steps * (eps * (np.max(np.abs(mean)) / 2 + 1.5 * alpha * deviation) + floor)
    largest = np.max(variance)
    of_variance = 2 * np.sqrt(largest) * of_mean + of_mean**2 + steps * (4.5 * eps * largest + floor)
    return float(of_mean), float(of_variance)


def _rows(case: str, xs: np.ndarray, found, true, bounds) -> list[Row]:
    return [
        Row(case, f"error of the {name}", xs.dtype.name, bound, float(np.max(np.abs(a - b))))
        for name, a, b, bound in zip(("mean", "variance"), found, true, bounds, strict=True)
    ]


def _compared(case: str, xs: np.ndarray, alpha: float) -> list[Row]:
    """Errors over a short stream against explicit weights."""
    weight = float(_alpha(xs, alpha))
    true = _reference.explicit(xs, weight)
    return _rows(case, xs, _run(xs, alpha), true, _bounds(xs, weight, *true))


def _noise(dtype, scale: float = 1.0, offset: float = 0.0) -> np.ndarray:
    """Normal samples, as exact as the dtype has them."""
    return (offset + scale * np.random.default_rng(0).normal(size=SHORT)).astype(dtype)


def _weights(dtype, long: int) -> list[Row]:
    return [row for a in ALPHAS for row in _compared(f"alpha {a:g}", _noise(dtype), a)]


def _offsets(dtype, long: int) -> list[Row]:
    offsets = (1e3,) if dtype == jnp.float16 else (1e3, 1e6)
    return [row for o in offsets for row in _compared(f"mean {o:g} deviations", _noise(dtype, offset=o), 0.2)]


def _magnitudes(dtype, long: int) -> list[Row]:
    """Values whose square underflows, overflows, or (float64) does neither."""
    rows = []
    for scale in (1e-3, 1e3) if dtype == jnp.float16 else (1e-30, 1e30):
        xs = _noise(dtype, scale)
        case, weight = f"values of {scale:g}", float(_alpha(xs, 0.2))
        found, true = _run(xs, 0.2), _reference.explicit(xs, weight)
        of_mean, of_variance = _bounds(xs, weight, *true)
        rows += _rows(case, xs, found, true, (of_mean, of_variance))[:1]
        # Once it has overflowed it stays infinite, which is as documented and no number to compare.
        overflowed = np.logical_or.accumulate(true[1] > float(jnp.finfo(dtype).max))
        both = np.where(overflowed, np.isinf(found[1]), np.abs(found[1] - true[1]) <= of_variance)
        rows.append(Row(case, "variances wrong (inf beyond the range)", dtype.name, 0, np.sum(~both)))
        vectors = jnp.stack([jnp.asarray(xs), -jnp.asarray(xs[::-1])], axis=-1)
        matrices = moving.emcm(vectors, _alpha(xs, 0.2))
        rows.append(Row(case, "NaN in the matrix", dtype.name, 0, float(jnp.sum(jnp.isnan(matrices)))))
    return rows


def _constants(dtype, long: int) -> list[Row]:
    rng = np.random.default_rng(2)
    reach = 3 if dtype == jnp.float16 else 30
    values = rng.choice([-1, 1], 10_000) * 10 ** rng.uniform(-reach, reach, 10_000)
    xs = np.tile(np.concatenate([values, [0.0, 1 / 3]]).astype(dtype), (50, 1))
    found = [np.max(np.abs(_run(xs, alpha)[1])) for alpha in ALPHAS]
    return [Row("constant input", "largest variance", dtype.name, 0.0, float(max(found)))]


def _alternating(dtype, long: int) -> list[Row]:
    xs = np.where(np.arange(SHORT) % 2, 1, -1).astype(dtype)
    rows = [row for alpha in (1e-3, 0.2) for row in _compared(f"alternating, alpha {alpha:g}", xs, alpha)]
    least = min(float(np.min(_run(xs, alpha)[1])) for alpha in ALPHAS)
    return [*rows, Row("alternating", "least variance below 0", dtype.name, 0.0, max(0.0, -least))]


def _signs(dtype, long: int) -> list[Row]:
    """Negative radiance is a number like any other."""
    xs = _noise(dtype)
    mean, variance = _run(xs, 0.2)
    negated, same = _run(-xs, 0.2)
    differing = float(np.sum(mean != -negated) + np.sum(variance != same))
    return [Row("negative radiance", "differences from the mirrored stream", dtype.name, 0.0, differing)]


def _long(dtype, long: int) -> list[Row]:
    """Drift over many updates, against filters in float64."""
    if dtype == jnp.float64:
        return []  # The reference is no better.
    xs = np.random.default_rng(1).normal(loc=1.0, size=long).astype(dtype)
    ends = np.arange(1, _BLOCKS + 1) * (long // _BLOCKS) - 1
    rows = []
    for alpha, compensated in ((0.2, False), (1e-3, False), (1e-6, False), (1e-6, True)):
        weight = float(_alpha(xs, alpha))
        true = _reference.filtered(xs, weight)
        if compensated:
            bounds = _compensated_bounds(xs, weight, *true)
        else:
            bounds = _bounds(xs, weight, *true)
        name = f"{long:,} updates, alpha {alpha:g}" + (", compensated" if compensated else "")
        found = _block_ends(xs, weight, compensated)
        rows += _rows(name, xs, found, [part[ends] for part in true], bounds)
    return rows


_BLOCKS = 100


def _block_ends(xs: np.ndarray, alpha: float, compensated: bool) -> list[np.ndarray]:
    """Mean and variance at the end of each block, high and low parts together."""
    blocks = jnp.asarray(xs).reshape(_BLOCKS, -1)
    state = moving.init("emv", blocks[0, 0], compensated=compensated)

    def update(state, x):
        return moving.update(state, x, alpha=alpha), None

    def block(state, part):
        state = lax.scan(update, state, part)[0]
        low = state.low or ((0.0,), (0.0,), 0.0)
        return state, (state.mean[0], low[0][0], state.products[0], low[1][0])

    parts = jax.jit(lambda state: lax.scan(block, state, blocks)[1])(state)
    mean, mean_low, variance, variance_low = (np.asarray(part).astype(np.longdouble) for part in parts)
    return [mean + mean_low, variance + variance_low]


def _compensated_bounds(
    xs: np.ndarray, alpha: float, mean: np.ndarray, variance: np.ndarray
) -> tuple[float, float]:
    """A pair of numbers rounds as one of twice the digits; float32's increments round as before."""
    deviation, largest = np.max(np.abs(xs - mean)), np.max(variance)
    eps = float(jnp.finfo(jnp.float32).eps)
    # Two half formats hold 22 bits, and their sums round to that; two of float32 hold more than enough.
    pair = 2.0**-21 if xs.dtype == np.float16 else eps**2
    steps = min(len(xs), 1 / alpha)
    of_mean = steps * pair * np.max(np.abs(mean)) / 2 + 2 * eps * deviation
    of_variance = 2 * np.sqrt(largest) * of_mean + of_mean**2 + (steps * pair / 2 + 8 * eps) * largest
    return float(of_mean), float(of_variance)


def _collinear(dtype, long: int) -> list[Row]:
    """Vectors that are nearly one line: the least eigenvalue, and the correlation."""
    x = _noise(dtype)
    zs = np.stack([x, (x * 0.7).astype(dtype), (x * 1.3).astype(dtype)], axis=-1)
    alpha, eps = 0.05, float(jnp.finfo(dtype).eps)
    matrices = moving.emcm(jnp.asarray(zs), _alpha(zs, alpha))
    wide = np.asarray(matrices).astype(np.float64)
    trace = np.trace(wide, axis1=1, axis2=2)
    least = np.min(np.linalg.eigvalsh(wide)[:, 0] / np.maximum.accumulate(np.maximum(trace, 1e-30)))
    bounded = np.asarray(moving.emcm(jnp.asarray(zs), _alpha(zs, alpha), bounded=True)).astype(np.longdouble)
    excess = np.max(bounded[:, 0, 1] ** 2 - bounded[:, 0, 0] * bounded[:, 1, 1])
    # Each entry rounds by 4.5 eps of its diagonal entries a step, and a matrix by its size times that.
    implied = 3 * (4.5 / alpha) * eps
    return [
        Row(
            "nearly collinear",
            "least eigenvalue below 0 / trace",
            dtype.name,
            implied,
            max(0.0, -least),
        ),
        Row("nearly collinear", "Sxy^2 - Sxx Syy, bounded", dtype.name, 0.0, float(max(excess, 0))),
    ]


def _arrivals(dtype, long: int) -> list[Row]:
    """A NaN and an infinity, kept out by `valid`, or let in."""
    xs = _noise(dtype)[:40].copy()
    xs[10], xs[20] = np.nan, np.inf
    state = moving.init("emv", jnp.zeros((), dtype))
    state = moving.update(state, 1.5, alpha=0.2)
    kept = [moving.update(state, bad, alpha=0.2, valid=False) for bad in (np.nan, np.inf)]
    before = [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(state)]
    changed = sum(
        np.asarray(leaf).tobytes() != old
        for other in kept
        for leaf, old in zip(jax.tree.leaves(other), before, strict=True)
    )
    mean, variance = _run(xs[11:], 0.2)
    finite = np.isfinite(mean[:9]) & np.isfinite(variance[:9])
    infinite = np.isinf(mean[9]) and np.isinf(variance[9]) and np.all(np.isnan(mean[10:]))
    nan_mean, nan_variance = _run(xs[:20], 0.2)
    stays = np.all(np.isnan(nan_mean[10:]) & np.isnan(nan_variance[10:]))
    fresh = moving.update(moving.update(state, np.nan, alpha=0.2), 2.0, alpha=1.0)
    healed = float(moving.mean(fresh)) == 2.0 and float(moving.estimate(fresh)) == 0.0
    wrong = [not finite.all(), not infinite, not stays, not healed]
    return [
        Row("NaN or inf, valid=False", "arrays changed", dtype.name, 0.0, float(changed)),
        Row("NaN or inf let in", "departures from the documentation", dtype.name, 0.0, float(sum(wrong))),
    ]


def _steps(dtype, long: int) -> list[Row]:
    """Where the mean stops when the input steps up, and that a compensated one does not."""
    rows = []
    for stored in (dtype, jnp.dtype(jnp.bfloat16)) if dtype == jnp.float16 else (dtype,):
        for start, end, alpha in ((0, 1, 0.2), (0, 1, 0.05), (0, 1, 0.005), (1, 1.05, 1e-6)):
            xs = np.full(20_000, end, np.float64 if dtype == jnp.float64 else np.float32)
            xs[0] = start
            case = f"step {start} to {end}, alpha {alpha:g}"
            state, _ = moving.scan("ema", jnp.asarray(xs), _alpha(xs, alpha), dtype=stored)
            # Half the spacing of the mean's numbers stops a sum; below 1 they are eps / 2 apart.
            spacing = float(jnp.finfo(stored).eps) / (2 if end == 1 else 1)
            change = float(xs[-1]) - start
            following = change * np.exp((len(xs) - 1) * np.log1p(-float(_alpha(xs, alpha))))
            implied = min(change, following + spacing / 2 / alpha)
            gap = float(xs[-1]) - float(state.mean[0])
            rows.append(Row(case, "gap left", stored.name, float(implied), gap))
            # Every increment that counted was at least half a spacing, and the last one stopped within it.
            least = min(change, (1 - alpha) * spacing / 2 / alpha) - spacing
            rows.append(Row(case, "gap less than predicted", stored.name, 0.0, max(0.0, least - gap)))
    xs = np.where(np.arange(20_000) == 0, 1, 1.05).astype(np.float64 if dtype == jnp.float64 else np.float32)
    weight = float(_alpha(xs, 1e-6))
    state, _ = moving.scan("ema", jnp.asarray(xs), weight, compensated=True, dtype=dtype)
    assert state.low is not None
    found = float(state.mean[0]) + float(state.low[0][0])
    exact = 1 + (float(xs[-1]) - 1) * -np.expm1((len(xs) - 1) * np.log1p(-weight))
    wide = float(jnp.finfo(jnp.float32 if dtype == jnp.float16 else dtype).eps)
    # A pair of half numbers sums as float32 does; a pair of wider ones rounds the increments alone.
    implied = len(xs) * 2.0**-22 if dtype == jnp.float16 else 2 * wide * 0.05
    case = "step 1 to 1.05, alpha 1e-06, compensated"
    return [*rows, Row(case, "error of the mean", dtype.name, implied, float(abs(found - exact)))]


def _coefficients(dtype, long: int) -> list[Row]:
    """Shadows, negative radiance and overflow in the control variate's coefficient."""
    largest = float(jnp.finfo(dtype).max)
    zero, bound = (
        jnp.zeros((2, 2), dtype),
        control_variate.upper_bound(jnp.ones((), dtype), jnp.zeros((), dtype)),
    )
    shadow = control_variate.coefficient(zero, epsilon=1e-3, bound=bound)
    vanishing = control_variate.coefficient(zero, epsilon=0.0, bound=bound)
    overflowed = jnp.array([[np.inf, largest], [largest, np.inf]], dtype)
    faded = control_variate.coefficient(overflowed, epsilon=1e-3, bound=1.0)
    negative = control_variate.upper_bound(jnp.array(-3.0, dtype), jnp.array(1.0, dtype))
    found = [float(v) for v in (shadow, vanishing, faded, negative)]
    wrong = sum(a != b for a, b in zip(found, (1.0, 1.0, 0.0, 0.0), strict=True))
    case = "G = 0, Var G = 0 or inf, f < 0"
    return [Row(case, "departures from the documentation", dtype.name, 0.0, float(wrong))]


#: Each case by name: a function of the stored dtype and the long streams' length.
CASES: dict[str, Callable[[Any, int], list[Row]]] = {
    "weights": _weights,
    "offsets": _offsets,
    "magnitudes": _magnitudes,
    "constant input": _constants,
    "alternating input": _alternating,
    "negative radiance": _signs,
    "long streams": _long,
    "nearly collinear": _collinear,
    "NaN and inf": _arrivals,
    "stagnation": _steps,
    "coefficient": _coefficients,
}
