"""Which processor this is, what caches it has, and how much memory a run takes."""

import ctypes
import math
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sssfit.trade.cache import Level

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_CACHES = Path("/sys/devices/system/cpu/cpu0/cache")
#: The first two levels of a core where the system does not tell: those of most processors since 2010.
USUAL_CACHES = (Level(32 * 1024, 64, 8), Level(512 * 1024, 64, 8))


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


def caches(folder: Path = _CACHES) -> tuple[Level, ...]:
    """The first two levels of data caches of a core.

    Args:
        folder: in which Linux tells it.

    Returns:
        The first and the second level; `USUAL_CACHES` where the system does not tell.

    Example:
        >>> [level.line_bytes for level in caches(Path("nowhere"))]
        [64, 64]
    """
    found = {}
    try:
        for cache in folder.glob("index*"):
            names = ("level", "type", "size", "coherency_line_size", "ways_of_associativity")
            number, kind, size, line, ways = ((cache / name).read_text().strip() for name in names)
            if kind != "Instruction" and number in ("1", "2"):
                found[number] = Level(1024 * int(size.removesuffix("K")), int(line), int(ways))
    except (OSError, ValueError):
        return USUAL_CACHES
    return (found["1"], found["2"]) if len(found) == 2 else USUAL_CACHES


def peak_of(run: Callable[[], Any]) -> float:
    """The most memory in bytes that is resident during a run, beyond what is before it.

    Args:
        run: is called once.

    Returns:
        Bytes, >= 0; NaN where the system does not tell, that is, anywhere but on Linux. Where the C library
        cannot give back what it keeps for later (only glibc can), what a run uses of that is not counted.

    Example:
        >>> found = peak_of(lambda: bytearray(50_000_000))
        >>> math.isnan(found) or found > 4e7
        True
    """
    if _STATUS.exists() and hasattr(ctypes.CDLL(None), "malloc_trim"):
        ctypes.CDLL(None).malloc_trim(0)
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
