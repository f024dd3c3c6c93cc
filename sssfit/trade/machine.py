"""Which processor this is, and how much memory a run takes."""

import math
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def processor() -> str:
    """What Linux calls the first processor; elsewhere what the platform module knows.

    Example:
        >>> len(processor()) > 0
        True
    """
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


def peak_of(run: Callable[[], Any]) -> float:
    """The most memory in bytes that is resident during a run, beyond what is before it.

    Args:
        run: is called once.

    Returns:
        Bytes, >= 0; NaN where the system does not tell, that is, anywhere but on Linux. What an allocator
        kept from before and uses again is not counted.

    Example:
        >>> found = peak_of(lambda: bytearray(50_000_000))
        >>> math.isnan(found) or found > 4e7
        True
    """
    try:
        _RESET.write_text("5")
        before = _resident("VmRSS")
    except OSError:
        run()
        return math.nan
    run()
    return max(_resident("VmHWM") - before, 0.0)


def _resident(name: str) -> float:
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith(name))
    return 1024.0 * int(line.split()[1])
