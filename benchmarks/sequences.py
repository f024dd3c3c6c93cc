"""Speed and memory of sequences: a step beside its pass, reading beside computing, few frames beside many.

    python benchmarks/sequences.py

prints a Markdown report for each part. docs/benchmarks.md explains them, and --page docs/benchmarks.md puts
them there.
"""

import argparse
import functools
import multiprocessing
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import frames_problem as problems
import frames_report
import interleaved
import jax
import jax.numpy as jnp
import numpy as np
from frames_problem import Scene
from jax import Array

from sssfit.estimators import policies
from sssfit.estimators.policies import InFrame
from sssfit.files.ahead import read_ahead
from sssfit.frames import _learning, gbuffer, scatter, sequence
from sssfit.frames.gbuffer import Frame

PARTS = ("steps", "reading", "memory")
NAMES = ("as", "ccv", "ocv", "in_frame")
#: The variances asked for; means are then about 9 and 15 samples.
TARGETS = (1e-2, 2.5e-3)
#: A motion that every lookup follows to the pixel itself, so that all cases draw the same samples.
MOTION = (0.3, -0.4)
WARM = 12


class Case(NamedTuple):
    """A policy on a frame, warm: what a step takes, and what its pass and its learning do."""

    mean_count: float
    moved: int
    programs: dict[str, Callable[[], object]]


def steps_report(scene: Scene, options: argparse.Namespace) -> tuple[dict[Any, np.ndarray], str]:
    """Each policy's step over its pass, standing still and moving, for each target."""
    names = ("frame", "policy", "mean count", "pass, ms", "step, ms", "step / pass", "learning, ms")
    names += ("GB/s of its bytes", "learning / a copy of as many bytes")
    lines = [f"| {' | '.join(names)} |"]
    lines.append("|:--|:--|--:|--:|--:|--:|--:|--:|--:|")
    found = {}
    for target in options.targets:
        for is_moving in (False, True):
            for name in NAMES:
                of = case(scene, name, target, is_moving)
                times = interleaved.measure(of.programs, options.repeats)
                ratio = interleaved.quartiles(times["step"] / times["pass"])
                learning = interleaved.quartiles(times["learning"]).median
                over = interleaved.quartiles(times["learning"] / times["copy"])
                found[target, is_moving, name] = times["step"] / times["pass"]
                cells = ["moves" if is_moving else "still", f"`{name}`", f"{of.mean_count:.1f}"]
                cells += [f"{1e3 * np.median(times[part]):.1f}" for part in ("pass", "step")]
                cells.append(f"{ratio.median:.2f} ({ratio.lower:.2f} to {ratio.upper:.2f})")
                cells += [f"{1e3 * learning:.1f}", f"{1e-9 * of.moved / learning:.0f}", f"{over.median:.2f}"]
                lines.append(f"| {' | '.join(cells)} |")
    return found, "\n".join(lines)


def case(scene: Scene, name: str, target: float, is_moving: bool) -> Case:
    """A policy after so many frames, and its programs; a step goes on from the one before."""
    frame, profiles = whole(scene, is_moving)
    gain_alpha = sequence.GAIN_ALPHA if name == "in_frame" else None
    policy = policies.named(name, target_variance=target, gain_alpha=gain_alpha)
    config = sequence.Config(policy, profiles)
    *_, (state, _, _) = sequence.scan([frame] * WARM, config)
    after, _, info = sequence.step(state, frame, config)
    # Each step begins with the same state, so that all draw what the pass does.
    unused = [after]

    def step() -> Array:
        new, image, info = sequence.step(state, frame, config, spare=unused[0])
        unused[0] = new
        jax.block_until_ready((new.memory, image))
        return info.counts

    of_pass = scatter.image_and_variance if isinstance(policy, InFrame) else scatter.every_profile
    options = {"counts": info.counts, "most": int(np.max(policy.max_spp)), "number": WARM}
    learning, moved = learning_of(config, frame, state, info)
    programs: dict[str, Callable[[], object]] = {
        "step": step,
        "pass": lambda: jax.block_until_ready(of_pass(frame, profiles, **options)),
        "learning": learning,
        "copy": copy_of(moved),
    }
    mask = np.isin(np.asarray(frame.profile_id), scene.ids[:1])
    return Case(float(np.asarray(info.counts)[mask].mean()), moved, programs)


def whole(scene: Scene, is_moving: bool) -> tuple[Frame, dict[int, Any]]:
    """The frame on the device, with the first of its profiles."""
    frame = scene.frame
    shape = (*frame.depth.shape, 2)
    motion = jnp.broadcast_to(jnp.asarray(MOTION, jnp.float32), shape) if is_moving else None
    frame = jax.tree.map(jnp.asarray, frame._replace(albedo=None, motion=motion))
    ids = [int(n) for n in np.unique(np.asarray(frame.profile_id)) if n]
    d = tuple(float(v) for v in scene.d)
    return frame, {number: d if number in scene.ids[:1] else None for number in ids}


def learning_of(config, frame: Frame, state, info) -> tuple[Callable[[], object], int]:
    """What is learned after a frame, alone, and how many bytes it has to read and to write."""
    known = sequence._known(frame, jnp.float32(0), info.missing, config)
    variance = jnp.full(info.value.shape, 0.5, jnp.float32) if isinstance(config.policy, InFrame) else None
    kept = [jax.tree.map(jnp.copy, state.memory)]

    def learning():
        given = state.memory, known, info.counts, info.value, variance
        kept[0] = jax.block_until_ready(_learning.after(config.policy, *given, kept[0]))

    memory = sum(leaf.nbytes for leaf in jax.tree.leaves(state.memory))
    read = jax.tree.leaves((known, info.counts, info.value, variance))
    return learning, 2 * memory + sum(array.nbytes for array in read)


def copy_of(moved: int) -> Callable[[], object]:
    """A program that reads and writes so many bytes in all, and does nothing else."""
    array = jnp.ones(moved // 8, jnp.float32)
    kept = [array + 0]

    @functools.partial(jax.jit, donate_argnums=0, keep_unused=True)
    def copied(spare, array):
        return array * jnp.float32(1.5)

    def copy():
        kept[0] = copied(kept[0], array).block_until_ready()

    return copy


def reading_report(scene: Scene, options: argparse.Namespace) -> tuple[np.ndarray, str]:
    """Frames of EXR files: reading them, computing with them, and both."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.exr"
        frame, profiles = whole(scene, False)
        path.write_bytes(gbuffer.encode(frame))
        load = functools.partial(gbuffer.load, path, camera=scene.frame.camera)
        frames = [frame] * options.frames
        config = sequence.Config(policies.named("as", target_variance=options.targets[0]), profiles)

        def run(given: Iterator[Frame]) -> None:
            for state, image, _ in sequence.scan(given, config, keep_states=False):
                jax.block_until_ready((state.memory, image))

        def both():
            with closing(read_ahead(lambda _: load(), range(options.frames))) as ahead:
                run(ahead)

        programs: dict[str, Callable[[], object]] = {
            "reading": lambda: [load() for _ in range(options.frames)],
            "computing": lambda: run(iter(frames)),
            "both": both,
        }
        times = interleaved.measure(programs, options.repeats)
    ratio = times["both"] / np.maximum(times["reading"], times["computing"])
    quartiles = interleaved.quartiles(ratio)
    each = [f"{1e3 * np.median(times[part]) / options.frames:.0f}" for part in programs]
    lines = ["| reading, ms a frame | computing | both | both / the longer of the two |", "|--:|--:|--:|--:|"]
    lines.append(
        f"| {' | '.join(each)} | {quartiles.median:.2f} ({quartiles.lower:.2f} to {quartiles.upper:.2f}) |"
    )
    return ratio, "\n".join(lines)


def memory_report(scene: Scene, options: argparse.Namespace) -> tuple[dict[int, float], str]:
    """The most memory of a new process, after few frames and after many."""
    del scene
    found: dict[int, float] = {}
    for frames in (options.frames // 2, 4 * options.frames, 12 * options.frames):
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            found[frames] = pool.apply(_peak, (options.width, options.height, frames))
    lines = ["| frames | most memory, MB |", "|--:|--:|"]
    lines += [f"| {frames} | {most:,.0f} |" for frames, most in found.items()]
    return found, "\n".join(lines)


def _peak(width: int, height: int, frames: int) -> float:
    scene = problems.scene(width, height)
    frame, profiles = whole(scene, True)
    config = sequence.Config(policies.named("ocv", target_variance=TARGETS[0]), profiles)
    # Each frame has arrays of its own, as frames that are read have.
    new = (jax.tree.map(jnp.copy, frame) for _ in range(frames))
    for _, image, _ in sequence.scan(new, config, keep_states=False):
        image.block_until_ready()
    return interleaved.peak()


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Measure, print, and write the page asked for: what each part found, by its name."""
    options = _parser().parse_args(arguments)
    scene = problems.scene(options.width, options.height)
    parts: dict[str, frames_report.Part] = {
        "steps": steps_report,
        "reading": reading_report,
        "memory": memory_report,
    }
    return frames_report.measure(parts, scene, options, "sequences")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="only these")
    parser.add_argument("--targets", nargs="+", type=float, default=TARGETS, help="variances asked for")
    parser.add_argument("--repeats", type=int, default=9, help="timed runs of each program")
    parser.add_argument("--frames", type=int, default=12, help="of a sequence that is read")
    parser.add_argument("--width", type=int, default=1920, help="of the frame; the head has 1920 x 1080")
    parser.add_argument("--height", type=int, default=1080, help="of the frame")
    parser.add_argument("--page", type=Path, help="put the tables between their marks in this page")
    return parser


if __name__ == "__main__":
    main()
