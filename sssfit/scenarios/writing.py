"""Simulations written to a directory: summary.json, a picture, CSV and NPZ files, and a manifest."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from sssfit.estimators.policies import Policy
from sssfit.files.arrays import csv_bytes, npz_bytes
from sssfit.files.atomic import interrupt_deferred
from sssfit.files.json_text import json_text
from sssfit.files.output import output_directory
from sssfit.scenarios import batch_mean, driver, measure, plot
from sssfit.scenarios.driver import Record, World
from sssfit.scenarios.measure import Statistics, Target

Progress = Callable[[int, int], None]
#: Numbers of single seeds' records that an archive holds at most.
_KEPT_NUMBERS = 2_000_000


def simulate(
    world: World,
    policy: Policy,
    target: Target,
    *,
    seeds: int,
    seed: int = 0,
    start: driver.Start = "disocclusion",
    sequence: driver.Sequence = "iid",
    first: int = measure.STEADY,
    progress: Progress = lambda done, total: None,
) -> tuple[Statistics, Record]:
    """Simulate many seeds, and keep the first ones' records.

    Args:
        world, policy: as for `driver.chunks`.
        target: what is aimed at.
        seeds: as for `driver.chunks`.
        seed: of the key.
        start, sequence: as for `driver.chunks`.
        first: the first frame of the figures, as for `measure.collect`.
        progress: called with the seeds done and their total.

    Returns:
        The statistics, and the records of as many seeds as make 2,000,000 numbers, at least one.

    Raises:
        ValueError: as `driver.chunks` and `measure.collect`.

    Example:
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle
        >>> found, record = simulate(circle.uniform(60), policies.named("as"), Target(1e-4), seeds=3)
        >>> found.seeds, record.count.shape
        (3, (3, 60))
    """
    kept: list[Record] = []
    wanted = max(1, _KEPT_NUMBERS // (world.truth.size * len(Record._fields)))

    def records() -> Iterator[Record]:
        options: dict[str, Any] = {"seeds": seeds, "start": start, "sequence": sequence}
        with interrupt_deferred():
            made = driver.chunks(jax.random.key(seed), world, policy, **options)
        while True:
            # Ctrl-C inside compiled work crashes or is lost; between chunks it is safe.
            with interrupt_deferred():
                record = next(made, None)
            if record is None:
                return
            missing = wanted - sum(len(part.count) for part in kept)
            if missing > 0:
                kept.append(Record(*(leaf[:missing] for leaf in record)))
            yield record

    if not 0 <= seed < 2**32:
        raise ValueError(f"seed must be in [0, 2^32), got {seed}")
    progress(0, seeds)
    found = measure.collect(
        records(),
        world,
        target,
        first=first,
        independent=sequence == "iid",
        progress=lambda done: progress(done, seeds),
    )
    return found, jax.tree.map(lambda *leaves: np.concatenate(leaves), *kept)


def write_circle(
    out: str | Path, found: Statistics, record: Record, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Write a circle's simulation.

    Args:
        out: the directory, made if missing.
        found, record: as `simulate` returns them.
        options: what the simulation was asked for, for the summary and the manifest; with "controller".

    Returns:
        What summary.json holds.

    Raises:
        FileError: the directory has a fault.

    Example:
        >>> import tempfile
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import circle
        >>> found, record = simulate(circle.uniform(60), policies.named("as"), Target(1e-4), seeds=3)
        >>> with tempfile.TemporaryDirectory() as out:
        ...     summary = write_circle(out, found, record, {"controller": "as"})
        >>> round(summary["oracle_count"], 2)
        64.0
    """
    figures, target = measure.summarize(found), found.target
    steady = found.histogram[found.first :].sum(axis=0)
    share = steady / steady.sum()
    error = found.error_by_seed[:, found.first :].mean(axis=1)
    low, middle, high = measure.count_quantiles(steady[None], (0.05, 0.5, 0.95))[0].tolist()
    summary = {
        **options,
        "seeds": found.seeds,
        "frames": len(found.truth),
        "steady_from_frame": found.first + 1,
        "steady_mean_count": figures.mean_count,
        "steady_mean_count_se": figures.mean_count_se,
        "mean_count": float(found.count.mean()),
        "oracle_count": figures.oracle_count,
        "delivered_variance_over_target": float(error.mean() / target.variance),
        "delivered_variance_over_target_se": measure.standard_error(error) / target.variance,
        "variance_of_moving_mean_over_target": float(
            found.mean_squared_error[found.first :].mean() / target.variance
        ),
        "believed_variance_over_target": float(found.variance[found.first :].mean() / target.variance),
        "count_quantiles": {"q05": low, "q50": middle, "q95": high},
        "share_at_min": float(share[: int(target.min_spp) + 1].sum()),
        "share_at_max": float(share[int(target.max_spp) :].sum()),
        "regret": figures.regret,
        "regret_q95": figures.regret_q95,
    }
    with interrupt_deferred():
        picture = plot.circle(found, title=_title(options, figures), one=_first_pixel(record.value))
    _write(out, options, summary, _arrays(found, record), picture, {"frames": _by_frame(found)})
    return summary


def write_line(
    out: str | Path,
    found: Statistics,
    record: Record,
    options: Mapping[str, Any],
    *,
    static: Statistics,
    x: np.ndarray,
    light: np.ndarray,
    intensity: np.ndarray,
) -> dict[str, Any]:
    """Write a line's simulation.

    Args:
        out, found, record, options: as for `write_circle`.
        static: statistics of the same controller under light that stays.
        x, light, intensity: as for `plot.line`.

    Returns:
        What summary.json holds.

    Raises:
        FileError: the directory has a fault.

    Example:
        >>> import tempfile
        >>> from sssfit.estimators import policies
        >>> from sssfit.scenarios import line
        >>> x = line.centres(16, 4.0)
        >>> world = line.world(line.ramp(x)[None].repeat(60, 0), length=4.0, d=0.05)
        >>> found, record = simulate(world, policies.named("as"), Target(1e-4), seeds=2, first=0)
        >>> shown = {"static": found, "x": x, "light": line.ramp(x), "intensity": np.ones(60)}
        >>> with tempfile.TemporaryDirectory() as out:
        ...     summary = write_line(out, found, record, {"controller": "as"}, **shown)
        >>> summary["static_ratio"]
        1.0
    """
    figures = measure.summarize(found)
    summary = {
        **options,
        "seeds": found.seeds,
        "frames": len(found.truth),
        "mean_count": figures.mean_count,
        "mean_count_se": figures.mean_count_se,
        "static_mean_count": float(static.count.mean()),
        "static_ratio": float(found.count.mean() / static.count.mean()),
        "image_rmse": figures.image_rmse,
        "image_rmse_se": figures.image_rmse_se,
        "static_image_rmse": float(np.sqrt(static.squared_error.mean())),
        "oracle_count": figures.oracle_count,
        "count_over_oracle": figures.count_over_oracle,
        "delivered_over_target_where_unclamped": figures.delivered_over_target,
        "regret": figures.regret,
        "regret_q95": figures.regret_q95,
    }
    title = _title(options, figures)
    with interrupt_deferred():
        picture = plot.line(found, title=title, x=x, light=light, intensity=intensity)
    ideal = measure.oracle_count(found.sample_variance, found.target)
    texels = {
        "x_mm": x,
        "irradiance": light,
        "truth": found.truth.mean(axis=0),
        "mean_result": found.value.mean(axis=0),
        "mean_count": found.count.mean(axis=0),
        "oracle_count": ideal.mean(axis=0),
        "delivered_variance": found.delivered.mean(axis=0),
        "squared_error": found.squared_error.mean(axis=0),
        "coefficient": found.coefficient.mean(axis=0),
    }
    frames = {"intensity": intensity, **_by_frame(found)}
    tables = {"frames": {"frame": frames.pop("frame"), **frames}, "texels": texels}
    _write(out, options, summary, _arrays(found, record) | {"x_mm": x}, picture, tables)
    return summary


def write_batch_mean(
    out: str | Path, *, seeds: int, seed: int = 0, progress: Progress = lambda done, total: None
) -> dict[str, Any]:
    """Simulate Table B.1 and write it.

    Args:
        out: the directory, made if missing.
        seeds: how many, >= 2.
        seed: of the key.
        progress: called with the seeds done and their total, of both lights.

    Returns:
        What summary.json holds: "static" and "dynamic", lists of {name, mean, median, sd, ...}.

    Raises:
        FileError: the directory has a fault.
        ValueError: seeds is below 2.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as out:
        ...     summary = write_batch_mean(out, seeds=2)
        >>> summary["static"][0]["name"]
        'Res_f'
    """
    if not 0 <= seed < 2**32:
        raise ValueError(f"seed must be in [0, 2^32), got {seed}")
    with interrupt_deferred():
        key = jax.random.key(seed)
    entries, streams = {}, {}
    for light in batch_mean.LIGHTS:
        done = seeds * len(entries)
        entries[light] = batch_mean.table(
            key, light, seeds=seeds, progress=lambda n, _, done=done: progress(done + n, 2 * seeds)
        )
        with interrupt_deferred():
            streams[light] = batch_mean.simulate(jax.random.fold_in(key, 0), light)
    options = {"seeds": seeds, "seed": seed}
    summary = {**options, **{light: [row._asdict() for row in rows] for light, rows in entries.items()}}
    rows = [{"light": light, **row._asdict()} for light in entries for row in entries[light]]
    table = {name: [row[name] for row in rows] for name in rows[0]}
    frames = {"frame": np.arange(1, batch_mean.FRAMES + 1)}
    arrays = {}
    for light, stream in streams.items():
        for kind, named in stream._asdict().items():
            arrays |= {f"{light}_{kind}_{name}": np.asarray(values) for name, values in named.items()}
    with interrupt_deferred():
        picture = plot.batch_mean(entries, streams)
    _write(out, options, summary, arrays, picture, {"table": table, "frames": frames | arrays})
    return summary


def _title(options: Mapping[str, Any], figures: measure.Summary) -> str:
    named = ("controller", "kappa", "alpha", "light", "profile", "start", "sequence")
    shown = ", ".join(f"{name} {options[name]}" for name in named if options.get(name) is not None)
    counts = f"mean count {figures.mean_count:.2f}, oracle of independent samples {figures.oracle_count:.2f}"
    return f"{shown}\n{counts}, delivered variance {figures.delivered_over_target:.3f} x target"


def _first_pixel(values: Any) -> np.ndarray:
    """The first seed's and pixel's values over time."""
    return np.asarray(values[0]).reshape(values.shape[1], -1)[:, 0]


def _by_frame(found: Statistics) -> dict[str, np.ndarray]:
    low, middle, high = measure.count_quantiles(found.histogram, (0.05, 0.5, 0.95)).T
    return {
        "frame": np.arange(1, len(found.truth) + 1),
        "truth": found.truth.mean(axis=1),
        "mean_result": found.value.mean(axis=1),
        "mean_count": found.count.mean(axis=1),
        "count_q05": low,
        "count_q50": middle,
        "count_q95": high,
        "oracle_count": measure.oracle_count(found.sample_variance, found.target).mean(axis=1),
        "believed_variance": found.variance.mean(axis=1),
        "delivered_variance": found.delivered.mean(axis=1),
        "squared_error": found.squared_error.mean(axis=1),
    }


def _arrays(found: Statistics, record: Record) -> dict[str, np.ndarray]:
    """Means over all seeds, and the first seeds' records."""
    over_seeds = {k: np.asarray(v) for k, v in found._asdict().items() if isinstance(v, np.ndarray)}
    return over_seeds | {f"record_{name}": np.asarray(leaf) for name, leaf in record._asdict().items()}


def _write(out, options, summary, arrays, picture: bytes, tables: Mapping[str, Mapping[str, Any]]) -> None:
    with output_directory(out, {"options": dict(options)}) as output:
        output.put("summary.json", json_text(summary).encode())
        output.put("simulation.png", picture)
        output.put("simulation.npz", npz_bytes(arrays))
        for name, columns in tables.items():
            output.put(f"{name}.csv", csv_bytes(columns))
