"""Which processor this is."""

import platform
from pathlib import Path


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
