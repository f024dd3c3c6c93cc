"""What the papers print about sample counts, covariances and bias, beside ours; shown by `sssfit reproduce`.

Constants that the papers choose have no row. Where a formula is printed and no number, the "printed" number
is the formula's value, and the quantity says "(formula)"; of an equation it is the sides' difference, 0.
"""

import math
from collections.abc import Callable, Iterator

import jax
import numpy as np

from sssfit.estimators import bias, control_variate, conventions, count_prediction, moving, sample_count
from sssfit.reproduction import Row

#: Weight of the newest frame, in both papers.
_ALPHA = 0.2
#: A covariance matrix of (f, g) to evaluate formulas with.
_COVARIANCE = np.array([[2.0, 0.5], [0.5, 1.0]])


def rows() -> Iterator[Row]:
    """The rows of this topic, each computed when it is asked for.

    Returns:
        The sample count, its memory, the control's coefficient, moving covariances, the bias of pilot
        samples and the chi-square statements.

    Example:
        >>> next(rows()).verdict
        'reproduced'
    """
    yield from _counts()
    yield from _memory()
    yield from _coefficients()
    yield from _products()
    yield from _covariances()
    yield from _pilots()
    yield from _chi_square()


def _float64(function: Callable, *arguments, **options) -> np.ndarray:
    with jax.enable_x64(True):
        return np.asarray(function(*arguments, **options))


def _formula(value: float) -> str:
    """The value of a printed formula, to more digits than any misprint needs."""
    return f"{value:.5g}"


def _counts() -> Iterator[Row]:
    """Eq 7 to 15 of 2020, Eq 8 to 10 of 2021, and the targets as PSNR."""
    quantity = "samples for {}, ratio"
    for source, what, share, printed in (
        ("Xie 2021, section 1.4", "half the variance", 1 / 2, "2"),
        ("Xie 2021, section 2.1", "half the error", 1 / 4, "4"),
    ):
        ratio = _float64(sample_count.basic_estimate, 1.0, 1.0, target_variance=share, min_spp=0)
        yield Row(source, quantity.format(what), printed, float(ratio))
    span = float(_float64(conventions.alpha_from_span, 2 / _ALPHA - 1))
    yield Row("Xie et al. 2020, section 4.1.2", "alpha of k = 2 / 0.2 - 1 frames", "0.2", span)
    correction = _count(1.0, 2.0, 1.0, kappa=1.0) - _count(1.0, 2.0, 1.0, kappa=0.0)
    printed = _formula(2 / _ALPHA - 2)
    yield Row("Xie and Olano 2021, Eq 9", "k - 1 = 2 / eta - 2 at eta = 0.2 (formula)", printed, correction)
    deviation, target, mean = 0.088, 0.08, 16.0
    without = (
        0.2 * (deviation - target) / target**2 * mean * (2 / _ALPHA - 2) + (deviation / target) ** 2 * mean
    )
    yield Row(
        "Xie et al. 2020, Eq 15",
        "count for sigma = 0.088, sigma_0 = 0.08, kappa = 0.2, n = 16 (formula)",
        _formula(without),
        _count(mean, deviation**2, target**2, kappa=0.2),
        differs=True,
        reason="sigma and sigma_0 lack the squares that Xie 2021, Eq 4.10 has",
    )
    for controller, printed in ((sample_count.PAPER_2021, "40.00"), (sample_count.PAPER_2020, "30.00")):
        target = float(np.asarray(controller.target_variance))
        quantity = f"PSNR of a variance of {target}, dB"
        yield Row("Xie et al. 2020, section 6.2", quantity, printed, -10 * math.log10(target))


def _count(mean: float, variance: float, target: float, kappa: float) -> float:
    settings = {"alpha": _ALPHA, "kappa": kappa, "min_spp": 0, "max_spp": 1000}
    return float(_float64(sample_count.estimate, mean, variance, target_variance=target, **settings))


def _memory() -> Iterator[Row]:
    """How many numbers a pixel remembers, and textures of four numbers for them."""

    def textures(numbers: int) -> float:
        return float(math.ceil(numbers / 4))

    alone = len(jax.tree.leaves(sample_count.init(0.0)))
    history = control_variate.init(0.0)
    assert history.moments is not None
    whole = alone + 2 + history.moments.matrix.size
    packed = control_variate.pack(control_variate.init(0.0, packed=True)).size
    yield Row("Xie et al. 2020, abstract", "textures that the sample count adds", "1", textures(alone))
    source = "Xie and Olano 2021, section 6.2.4"
    yield Row(source, "numbers of a history", "9", float(whole))
    yield Row(source, "numbers that are needed", "7", float(packed))
    yield Row(source, "textures of a history", "3", textures(whole))
    yield Row(source, "textures that are needed", "2", textures(packed))
    saved = textures(packed) - textures(
        len(jax.tree.leaves(control_variate.init(0.0, control_variate.MAIN_PART)))
    )
    yield Row("Xie and Olano 2021, section 6.3", "textures that a constant coefficient saves", "1", saved)


def _coefficient(covariance: np.ndarray, epsilon: float = 0.0) -> float:
    return float(_float64(control_variate.coefficient, covariance, epsilon=epsilon, bound=None))


def _coefficients() -> Iterator[Row]:
    """The coefficient of one control: where it is 1, and the formulas for it."""
    yield Row(
        "Xie and Olano 2021, section 6.2.3",
        "coefficient in a hard shadow, epsilon = 1e-6",
        "1",
        _coefficient(np.zeros((2, 2)), epsilon=1e-6),
    )
    light = 1 + 0.5 * np.sin(np.arange(120) / 6)
    flat = _coefficient(_float64(moving.emcm, np.stack([light, light], axis=-1), _ALPHA)[-1])
    yield Row("Xie and Olano 2021, Eq 31", "coefficient in flat light, f = g", "1", flat)
    residuals = _float64(control_variate.residual, light, light, flat)
    variance = float(np.max(_float64(moving.emv, residuals, _ALPHA)))
    yield Row("Xie and Olano 2021, Eq 31", "its residual's variance, in 1e-12", "0", variance * 1e12)
    (of_f, covariance), (_, of_g) = _COVARIANCE.tolist()
    ours = _coefficient(_COVARIANCE)
    for source, printed, reason in (
        ("Xie 2021, above Eq 2.19", covariance / of_f, "Var G belongs below, not Var F"),
        (
            "Xie 2021, section 6.5.3",
            (1 / of_f + 1 / of_g) * covariance,
            "the inverse is of the diagonal matrix",
        ),
        ("Xie and Olano 2021, section 6.2.2", covariance / of_g, ""),
    ):
        quantity = "coefficient of f, Var f = 2, Var g = 1, Cov = 0.5 (formula)"
        yield Row(source, quantity, _formula(printed), ours, differs=bool(reason), reason=reason)
    quantity = "least variance of f - a g, Var f = 2, Var g = 1, Cov = 0.5 (formula)"
    printed = _formula((1 - covariance**2 / (of_f * of_g)) * of_f)
    yield Row("Xie 2021, Eq 2.19", quantity, printed, of_f - 2 * ours * covariance + ours**2 * of_g)


def _products() -> Iterator[Row]:
    """The residual's variance under a light T of its own: every T with every (F, G), equally likely."""
    light, f, g, a = np.array([[1.0], [3.0]]), np.array([0.0, 1.0, 5.0]), np.array([1.0, 2.0, 3.0]), 1.5
    ours = float(np.var(_float64(control_variate.residual, light * f, light * g, a)))
    residual = f - a * g
    varying, steady = float(np.var(residual)), float(np.mean(residual) ** 2)
    square, spread = float(np.mean(light) ** 2), float(np.var(light))
    right = square * varying + spread * varying + spread * steady
    twice = 2 * square * varying + spread * steady
    quantity = "Var(T (F - a G)), T of 1, 3 and F - a G of -1.5, -2, 0.5 (formula)"
    yield Row("Xie and Olano 2021, Eq 22", quantity, _formula(right), ours)
    reason = "Var T Var(F - a G) belongs where the first term stands twice, as in Eq 6.6"
    yield Row("Xie 2021, Eq B.33", quantity, _formula(twice), ours, differs=True, reason=reason)


def _covariances() -> Iterator[Row]:
    """Moving covariances of 200 correlated pairs, and covariances of batch means."""
    pairs = np.random.default_rng(0).normal(size=(200, 2)) @ np.array([[1.0, 0.8], [0.0, 0.6]])
    errors = []
    for alpha in (1e-6, 0.05, _ALPHA, 0.9):
        weights = alpha * (1 - alpha) ** np.arange(len(pairs))[::-1]
        weights[0] /= alpha
        deviations = pairs - weights @ pairs
        explicit = (weights * deviations.T) @ deviations
        errors.append(np.max(np.abs(_float64(moving.emcm, pairs, alpha)[-1] - explicit)) / np.max(explicit))
    quantity = "recursion - covariance by the weights of Eq B.18, relative, in 1e-12"
    yield Row("Xie 2021, Eq B.21", quantity, "0", float(max(errors)) * 1e12)
    listed = float(_float64(moving.ema, np.array([0.0] + 10 * [1.0]), 0.05)[-1])
    quantity = "sum of the weights of x_1 to x_10 at alpha = 0.05"
    reason = "x_0 has the rest, 0.95^10"
    yield Row("Xie 2021, section B.1.2", quantity, "1.000", listed, differs=True, reason=reason)
    ours, lagged = (
        _float64(function, pairs, _ALPHA)[-1] for function in (moving.emcm, moving.ewma_covariance)
    )
    yield Row(
        "Xie and Olano 2021, Eq 33-34",
        "EWMA / EMCM at eta = 0.2, the ratio of what a frame adds (formula)",
        _formula(1 / (1 - _ALPHA)),
        float(np.max(lagged / ours)),
        reason="of every entry, so that both have one coefficient, against section 6.2.4",
    )
    chances, xs, ys = np.array([0.5, 0.3, 0.2]), np.array([0.0, 1.0, 4.0]), np.array([1.0, 3.0, 2.0])
    counts, likely = bias._outcomes(16, chances)
    means = _covariance(likely, counts @ xs / 16, counts @ ys / 16)
    error = abs(16 * means - _covariance(chances, xs, ys))
    yield Row("Xie 2021, Eq B.27", "n Cov of two means - Cov, n = 16, in 1e-12", "0", error * 1e12)


def _covariance(chances: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> float:
    return float(chances @ ((xs - chances @ xs) * (ys - chances @ ys)))


def _pilots() -> Iterator[Row]:
    """Bias of the mean that trusts alike pilots, and the probabilities of what they show."""
    for values, chances in (((0.0, 1.0), (0.9, 0.1)), ((0.0, 1.0, 4.0), (0.5, 0.3, 0.2))):
        truth, errors = float(np.dot(values, chances)), []
        for pilot in (1, 2, 4, 8):
            counts, likely = bias._outcomes(pilot, np.array(chances))
            alike = np.max(counts, axis=1) == pilot
            enumerated = likely @ np.where(alike, counts @ np.array(values) / pilot, truth) - truth
            errors.append(abs(float(_float64(bias.pilot_bias, values, chances, pilot)) - enumerated))
        quantity = f"bias - that of all outcomes, p = {chances}, n up to 8, in 1e-12"
        yield Row("Xie 2021, Eq 2.34", quantity, "0", max(errors) * 1e12)
    biases = np.abs([_float64(bias.pilot_bias, (0.0, 1.0), (0.9, 0.1), pilot) for pilot in (1, 2, 4, 8)])
    quantity = "increases of |bias| from n = 1 to 2, 4, 8, p = (0.9, 0.1)"
    reason = "one pilot has no bias, so that the bias does not always diminish"
    rises = float(np.sum(np.diff(biases) > 0))
    yield Row("Xie 2021, below Eq 2.34", quantity, "0", rises, differs=True, reason=reason)
    counts, likely = bias._outcomes(2, np.array([0.9, 0.1]))
    ways = [math.factorial(2) / math.prod(math.factorial(n) for n in row) for row in counts.tolist()]
    yield Row(
        "Xie 2021, Eq 2.31",
        "sum of all probabilities, p = (0.9, 0.1), n = 2 (formula)",
        _formula(sum(ways) * 0.9 * 0.1),
        float(np.sum(likely)),
        differs=True,
        reason="each p_i needs the exponent n_i",
    )


def _chi_square(batches: int = 400_000, size: int = 16) -> Iterator[Row]:
    """The statements for normal samples, by drawing them."""
    samples = np.random.default_rng(1).normal(size=(batches, size))
    variances = np.var(samples, axis=1)
    bounds = count_prediction.target_variance(variances, size, confidence=0.95)
    holds = bounds > 1 / size
    quantity = f"P(Var F_N < s^2 / chi^2), beta = 0.05, N = {size} (formula)"
    reason = "s^2 has the divisor N"
    yield Row("Xie 2021, Eq 2.27", quantity, "0.9500", *_estimate(holds), reason=reason)
    yield Row(
        "Xie 2021, below Eq 2.25",
        f"expected s_N^2 / Var f, N = {size} (formula)",
        _formula((size - 1) / size**2),
        *_estimate(variances),
        differs=True,
        reason="1 / N stands before a sum, not before an expectation",
    )
    quantity = f"degrees of freedom of (k - 1) s^2 / sigma^2, k = {size}"
    reason = "k observations leave k - 1"
    yield Row(
        "Xie 2021, Eq 2.26", quantity, str(size), *_estimate(size * variances), differs=True, reason=reason
    )


def _estimate(values: np.ndarray) -> tuple[float, float]:
    """A mean and its standard error."""
    return float(np.mean(values)), float(np.std(values) / math.sqrt(len(values)))
