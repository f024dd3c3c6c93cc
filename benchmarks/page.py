"""Results in docs/benchmarks.md: each script replaces what stands between its own two marks."""

import re
from pathlib import Path


def replace(page: Path, name: str, text: str) -> None:
    """Put text between <!-- begin NAME --> and <!-- end NAME -->.

    Raises:
        ValueError: the page has no such marks.
    """
    before = page.read_text()
    pattern = rf"(<!-- begin {name} -->\n).*?(<!-- end {name} -->)"
    after, count = re.subn(
        pattern, lambda marks: f"{marks[1]}\n{text}\n\n{marks[2]}", before, flags=re.DOTALL
    )
    if count != 1:
        raise ValueError(f"{page} has {count} places for {name}, not 1")
    page.write_text(after)
