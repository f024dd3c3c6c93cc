"""How much memory a run takes."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


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
