"""Figures of programs that are timed in turns, and the conditions under which they ran."""

import os
import platform
import resource
import subprocess
import sys
import time
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sssfit.trade.machine import processor
from sssfit.trade.timing import PAUSE as PAUSE
from sssfit.trade.timing import measure as measure

PACKAGES = ("sssfit", "jax", "numpy", "scipy", "numba")


class Timing(NamedTuple):
    """Quartiles of the wall time of one program, in seconds."""

    lower: float
    median: float
    upper: float

    @property
    def spread(self) -> float:
        return self.upper - self.lower


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
        f"{processor()}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}; "
        f"{date.today()}, commit {_commit()}"
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


def _commit() -> str:
    command = ["git", "rev-parse", "--short", "HEAD"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()
