"""The memory that a process takes which scatters a frame."""

import argparse
import multiprocessing
import time
from typing import Any, NamedTuple

import frames_problem as problems
import interleaved
import jax
import jax.numpy as jnp
import numpy as np
from frames_problem import Scene

from sssfit.frames.camera import Camera


class Peaks(NamedTuple):
    """MB at most: imported, with the frame, after a pass; and seconds of a second pass."""

    idle: float
    loaded: float
    passed: float
    seconds: float


def report(scene: Scene, options: argparse.Namespace) -> tuple[dict[str, Peaks], str]:
    """The frame, and one of so many by so many of it, each in a new process."""
    del scene
    found: dict[str, Peaks] = {}
    lines = [
        "| Frame | imported, MB | with the frame | after the pass | of that, since imported | s a pass |"
    ]
    lines.append("|:--|--:|--:|--:|--:|--:|")
    for tiles in (1, options.tiles):
        name = f"{tiles * options.width} x {tiles * options.height}"
        peaks = found[name] = measure(options.width, options.height, tiles, options.samples)
        numbers = [peaks.idle, peaks.loaded, peaks.passed, peaks.passed - peaks.idle]
        lines.append(f"| {name} | {' | '.join(f'{n:,.0f}' for n in numbers)} | {peaks.seconds:.2f} |")
    return found, "\n".join(lines)


def measure(width: int, height: int, tiles: int, samples: int) -> Peaks:
    """In a new process, as this one has used memory for others."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_peaks, (width, height, tiles, samples))


def tiled(scene: Scene, times: int) -> Scene:
    """A larger frame: copies of one, side by side, before the same camera."""

    def repeated(values: Any) -> Any:
        shape = (times, times) + (1,) * (values.ndim - 2) if values is not None else ()
        return None if values is None else jnp.asarray(np.tile(np.asarray(values), shape))

    frame, lens = scene.frame, scene.frame.camera
    across, down = (times * size for size in (lens.width, lens.height))
    centre = times * lens.cx, times * lens.cy
    camera = Camera(lens.projection, across, down, lens.fx, lens.fy, *centre)
    used = ("irradiance", "depth", "normal", "profile_id")
    layers = {name: repeated(getattr(frame, name)) for name in used}
    return scene._replace(frame=frame._replace(albedo=None, motion=None, camera=camera, **layers))


def _peaks(width: int, height: int, tiles: int, samples: int) -> Peaks:
    jax.block_until_ready(jnp.zeros(8) + 1)
    idle = interleaved.peak()
    scene = problems.scene(width, height)
    problem = problems.problem(scene if tiles == 1 else tiled(scene, tiles), "table", "surface", samples)
    del scene
    problem = problems.on_device(problem)
    loaded = interleaved.peak()
    problems.ours(problem)
    start = time.perf_counter()
    problems.ours(problem)
    return Peaks(idle, loaded, interleaved.peak(), time.perf_counter() - start)
