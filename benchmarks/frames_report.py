"""Reports on a scene in parts, each with the conditions that it was measured under."""

import argparse
from collections.abc import Callable, Mapping
from typing import Any

import interleaved
import page
from frames_problem import Scene

#: What measures a scene: what it found, and a report of it.
Part = Callable[[Scene, argparse.Namespace], tuple[Any, str]]


def measure(
    parts: Mapping[str, Part], scene: Scene, options: argparse.Namespace, name: str
) -> dict[str, Any]:
    """Measure the parts asked for, print them with their conditions, and put them on the page asked for.

    Returns what each part found. Their places on the page are called by `name` and their own.
    """
    results = {}
    for part in options.parts:
        neighbours = interleaved.Neighbours()
        results[part], text = parts[part](scene, options)
        rounds = "" if part == "memory" else f" {options.repeats} rounds."
        conditions = f"{interleaved.machine()}; {neighbours.describe()}.{rounds}"
        report = f"{conditions} On {scene.name}.\n\n{text}"
        print(report, flush=True)
        if options.page:
            page.replace(options.page, f"{name} {part}", report)
    return results
