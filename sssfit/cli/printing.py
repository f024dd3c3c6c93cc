"""What the commands that fit share: results as JSON and as tables, and a spinner while they work."""

import argparse
import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def plain(value: Any) -> Any:
    """Dataclasses and arrays as JSON-compatible values."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return value.tolist() if hasattr(value, "tolist") else value


def print_json(value: Any) -> None:
    """Print a value as JSON."""
    from sssfit.files.json_text import json_text

    print(json_text(value), end="")


def print_table(head: list[str], rows) -> None:
    """Print rows of text under a head."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(*head, box=box.SIMPLE)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


@contextmanager
def busy(options: argparse.Namespace, text: str) -> Iterator[None]:
    """A spinner on a terminal while a fit compiles and runs, which Ctrl-C must not tear apart."""
    from sssfit.files.atomic import interrupt_deferred

    with interrupt_deferred():
        from rich.console import Console
    console = Console(stderr=True, quiet=options.quiet or options.json)
    with interrupt_deferred(), console.status(text):
        yield
