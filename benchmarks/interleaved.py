"""Timing of rival programs so that a busy machine slows all of them alike.

Run one after the other, two programs meet different loads. Here they take turns, in an order shuffled anew
each round, and medians and quartiles over the rounds are compared.
"""

import os
import platform
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

import numpy as np

#: Seconds before each timed run, in which the threads of the program before it stop waiting for more.
PAUSE = 0.05
PACKAGES = ("sssfit", "jax", "numpy", "scipy", "numba")


class Timing(NamedTuple):
    """Quartiles of the wall time of one program, in seconds."""

    lower: float
    median: float
    upper: float

    @property
    def spread(self) -> float:
        return self.upper - self.lower


def measure(
    programs: Mapping[str, Callable[[], object]], repeats: int, seed: int = 0, pause: float = PAUSE
) -> dict[str, np.ndarray]:
    """Wall times in seconds of each program, shape (repeats,), after one untimed run of each.

    Each run comes after a pause in seconds. A program returns when its result is complete: one that runs
    asynchronously waits for it itself. Times at the same index come from the same round, so their ratio is
    free of slow changes of the load.
    """
    for program in programs.values():
        program()
    order = list(programs)
    shuffle = random.Random(seed).shuffle
    times = {name: np.empty(repeats) for name in order}
    for round_ in range(repeats):
        shuffle(order)
        for name in order:
            time.sleep(pause)
            start = time.perf_counter()
            programs[name]()
            times[name][round_] = time.perf_counter() - start
    return times


def quartiles(times: np.ndarray) -> Timing:
    """The three quartiles of measured times."""
    return Timing(*(float(q) for q in np.percentile(times, (25, 50, 75))))


class Neighbours:
    """How much of the processors other programs use, from when it is made."""

    def __init__(self) -> None:
        self._start = self._counters()

    def describe(self) -> str:
        """A clause on it; on Linux alone, where the system counts what all programs use."""
        if self._start is None or (now := self._counters()) is None:
            return "use of the processors by others unknown"
        everyone, available, own = (after - before for after, before in zip(now, self._start, strict=True))
        share = max(0.0, everyone - own) / max(available, 1e-9)
        return f"others used {share:.0%} of the processors"

    @staticmethod
    def _counters() -> tuple[float, float, float] | None:
        """Processor seconds since the start: used by all, available, used by this process."""
        try:
            line = Path("/proc/stat").read_text().splitlines()[0]
        except OSError:
            return None
        ticks = os.sysconf("SC_CLK_TCK")
        user, nice, system, idle, waiting, *interrupts = (int(n) / ticks for n in line.split()[1:9])
        used = user + nice + system + sum(interrupts)
        return used, used + idle + waiting, time.process_time()


def peak() -> float:
    """The most memory in MB that this process has had so far."""
    status = Path("/proc/self/status")
    if status.exists():
        # What getrusage tells on Linux begins with that of the parent.
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / 1e3
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def machine() -> str:
    """One line: processor, cores, versions, date and commit."""
    versions = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return (
        f"{_processor()}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}; "
        f"{date.today()}, commit {_commit()}"
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


def _processor() -> str:
    """What Linux calls the first processor; elsewhere what the platform module knows."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        text = ""
    facts: dict[str, str] = {}
    for line in text.splitlines():
        key, _, value = line.partition(":")
        facts.setdefault(key.strip(), value.strip())
    name = facts.get("model name") or platform.processor() or platform.machine()
    return name + (" with AVX-512" if "avx512f" in facts.get("flags", "").split() else "")


def _commit() -> str:
    command = ["git", "rev-parse", "--short", "HEAD"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()
