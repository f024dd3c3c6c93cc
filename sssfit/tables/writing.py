"""Writing a collection of tables: every format, a plot each, a report and a manifest, all or nothing."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from sssfit.files.atomic import interrupt_deferred
from sssfit.files.json_text import sha256_bytes
from sssfit.files.output import Output, output_directory
from sssfit.files.reading import read_bytes
from sssfit.profiles import materials
from sssfit.tables.collection import Entry, Sizes, jobs, skipped
from sssfit.tables.formats import ENCODERS, STORED_AS, encode_table
from sssfit.tables.formats.encoded import store
from sssfit.tables.plot import plot
from sssfit.tables.report import report_html

FORMATS = tuple(ENCODERS)
_PACKAGES = ("optimistix", "OpenEXR", "pillow")

Progress = Callable[[str, int, int], None]


def write(
    out: str | Path,
    materials_file: str | Path | None = None,
    formats: Sequence[str] = FORMATS,
    sizes: Sizes | None = None,
    progress: Progress = lambda title, done, total: None,
) -> dict[str, Any]:
    """Compute and write all tables of a file of materials.

    Everything appears in `out` at the end, together: one folder per material, the universal tables beside
    them, a plot per table, report.html, manifest.json, and timing.json. On a failure or Ctrl-C nothing of
    it appears and what was there stays. The same input and options give the same bytes on the same kind of
    machine with the same library versions, apart from timing.json. Files of an earlier run that this one
    does not write stay too; the manifest lists only what this run wrote.

    Args:
        out: output directory, made if missing.
        materials_file: CSV file, see `profiles.materials.load`; by default the shipped measurements.
        formats: some of `FORMATS`.
        sizes: entries per table.
        progress: called before each table with its title, how many are done, and how many there are.

    Returns:
        The manifest.

    Raises:
        FileError: the input or the directory has a fault.
        ValueError: a format is unknown.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as out:
        ...     manifest = write(out, formats=["npz"], sizes=Sizes(16, 4))
        >>> manifest["tables"][0]["path"]
        'radius'
    """
    unknown = [name for name in formats if name not in ENCODERS]
    if unknown:
        raise ValueError(f"formats must be some of {', '.join(FORMATS)}, got {unknown[0]!r}")
    sizes = sizes or Sizes()
    source = Path(materials_file) if materials_file is not None else materials.shipped()
    data = read_bytes(source)
    loaded = materials.parse(data, source.name)
    work = list(jobs(loaded, sizes))
    described: dict[str, Any] = {
        "inputs": [{"name": source.name, "sha256": sha256_bytes(data)}],
        "options": {"formats": list(formats), "size": sizes.line, "size_2d": sizes.image},
        "computed_in": "float64",
        "length_unit": "mm",
        "skipped": skipped(loaded),
        "tables": [],
    }
    plots: dict[str, bytes] = {}
    with output_directory(out, described, _PACKAGES) as output:
        manifest, seconds = output.manifest, output.timing.setdefault("seconds", {})
        for done, (title, compute) in enumerate(work):
            progress(title, done, len(work))
            start = time.perf_counter()
            with interrupt_deferred():
                entry = compute()
                plots[entry.path] = plot(entry.table)
            manifest["tables"].append(_write_entry(output, entry, formats, plots[entry.path]))
            seconds[title] = time.perf_counter() - start
        progress("report", len(work), len(work))
        output.put("report.html", report_html(manifest, plots))
    return manifest


def _write_entry(output: Output, entry: Entry, formats: Sequence[str], picture: bytes) -> dict[str, Any]:
    """Write one table in every format; what the manifest says of it."""
    path, table = entry.path, entry.table
    output.put(f"{path}.plot.png", picture)
    stored: dict[str, Any] = {}
    errors: dict[str, dict[str, float]] = {}
    for name in formats:
        try:
            files = encode_table(table, name)
        except ValueError as error:
            # Half floats end at 65504: a path of 70 m has no place there, but has one in the others.
            stored[name] = {"omitted": str(error)}
            continue
        for suffix, content in files.items():
            output.put(path + suffix, content)
        dtype = STORED_AS[name]
        if dtype not in errors:
            errors[dtype] = store(table, dtype).metadata["quantization"]
        names = [path + suffix for suffix in files]
        stored[name] = {"files": names, "dtype": dtype, "quantization": errors[dtype]}
    return {
        "path": path,
        "name": table.name,
        "description": table.description,
        "unit": table.unit,
        "axes": [
            {"name": a.name, "unit": a.unit, "size": len(a.values)}
            | {"first": float(a.values[0]), "last": float(a.values[-1])}
            for a in table.axes
        ],
        "channels": list(table.channels),
        "parameters": table.parameters,
        "lookup_error": entry.lookup_error,
        "plot": f"{path}.plot.png",
        "formats": stored,
    }
