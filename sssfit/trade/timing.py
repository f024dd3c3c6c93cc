"""Timing of rival programs so that a busy machine slows all of them alike.

Run one after the other, two programs meet different loads. Here they take turns, in an order shuffled anew
each round, and medians over the rounds are compared.
"""

import random
import time
from collections.abc import Callable, Mapping

import numpy as np
from scipy.stats import binom

#: Seconds before each timed run, in which the threads of the program before it stop waiting for more.
PAUSE = 0.05


def measure(
    programs: Mapping[str, Callable[[], object]], rounds: int, seed: int = 0, pause: float = PAUSE
) -> dict[str, np.ndarray]:
    """Wall times of programs that take turns, after one untimed run of each.

    Args:
        programs: by name. A program returns when its result is complete: one that runs asynchronously waits
            for it itself.
        rounds: how many, >= 1.
        seed: of the order.
        pause: before each run, seconds.

    Returns:
        Seconds by name, shape (rounds,). Times at the same index come from the same round, so their ratio is
        free of slow changes of the load.

    Example:
        >>> measure({"nothing": lambda: None}, 3, pause=0.0)["nothing"].shape
        (3,)
    """
    for program in programs.values():
        program()
    order = list(programs)
    shuffle = random.Random(seed).shuffle
    times = {name: np.empty(rounds) for name in order}
    for round_ in range(rounds):
        shuffle(order)
        for name in order:
            time.sleep(pause)
            begun = time.perf_counter()
            programs[name]()
            times[name][round_] = time.perf_counter() - begun
    return times


def median_and_interval(times: np.ndarray, level: float = 0.95) -> tuple[float, float, float]:
    """The median of times and an interval that holds the true one whatever their distribution.

    Args:
        times: shape (n,).
        level: the interval's chance; with fewer than six times the whole range has less.

    Returns:
        Lower end, median and upper end: order statistics.

    Source: the sign test; Conover, "Practical Nonparametric Statistics", section 3.2.

    Example:
        >>> median_and_interval(np.array([3.0, 1.0, 2.0, 5.0, 4.0, 9.0, 7.0]))
        (1.0, 4.0, 9.0)
    """
    times = np.sort(times)
    # The median lies below the (k + 1)-th time with the chance of at most k heads in n tosses.
    chances = binom.cdf(np.arange(len(times) // 2), len(times), 0.5)
    rank = max(int(np.sum(chances <= (1 - level) / 2)) - 1, 0)
    return float(times[rank]), float(np.median(times)), float(times[-1 - rank])
