"""What `sssfit trade` writes: each group's measurements as they come, and the report at the end."""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax

from sssfit.files import atomic
from sssfit.files.errors import FileError
from sssfit.files.json_text import json_text, read_json
from sssfit.files.output import output_directory, versions
from sssfit.trade import machine, measure, page, picture, report
from sssfit.trade.choice import CannotMeasure, Group
from sssfit.trade.measure import Row, Tell
from sssfit.trade.registry import GROUPS, STUDIES
from sssfit.trade.report import Measured, Studied
from sssfit.trade.setting import Setting
from sssfit.trade.study import Finding, Study

_FOLDER = "measured"
#: Of the files in it; others are other conditions.
_FORMAT = 2


def conditions(setting: Setting, rounds: int) -> dict[str, Any]:
    """On what, with what and how thoroughly is measured: measurements under other conditions do not mix.

    Args:
        setting: see `Setting`.
        rounds: of the times.

    Example:
        >>> from sssfit.trade.setting import procedural_setting
        >>> conditions(procedural_setting(True), 5)["rounds"]
        5
    """
    device = jax.devices()[0]
    return {
        "format": _FORMAT,
        "processor": machine.processor(),
        "cores": os.cpu_count(),
        "device": f"{device.platform} {device.device_kind}",
        "versions": versions(("jaxlib",)),
        "quick": setting.is_quick,
        "rounds": rounds,
        **setting.describe(),
    }


class Ledger:
    """The groups that are measured, each in a file of its own once it is complete.

    Attributes:
        conditions: under which.
    """

    def __init__(self, out: Path, conditions: dict[str, Any], resume: bool):
        """Keep groups in `out`/measured; what is there is used if `resume`, else removed.

        Raises:
            FileError: the folder cannot be made.
        """
        self.conditions = conditions
        self._folder = out / _FOLDER
        atomic.make_directory(self._folder)
        # Else a run that is interrupted and gone on with would take up what an earlier one has left.
        for name in () if resume else (*GROUPS, *STUDIES):
            (self._folder / f"{name}.json").unlink(missing_ok=True)

    def measured(self, group: Group, setting: Setting, rounds: int, tell: Tell) -> Measured:
        """A group, from its file or measured now and kept.

        Raises:
            FileError: the file cannot be read or written, or is of other conditions.
        """
        path = self._folder / f"{group.name}.json"
        if path.exists():
            return self._read(path, group)
        if not setting.is_quick:
            # Else a group would not compile what one before it has.
            jax.clear_caches()
        try:
            made = measure.group(group, setting, rounds, tell)
            found = Measured(group, tuple(made.rows), note=made.note, pace=made.pace)
        except CannotMeasure as reason:
            found = Measured(group, (), str(reason))
        rows = [report.known(row) for row in found.rows]
        pace = None if math.isnan(found.pace) else found.pace
        self._keep(path, {"skipped": found.skipped, "note": found.note, "pace": pace, "rows": rows})
        return found

    def studied(self, study: Study, setting: Setting, rounds: int, tell: Tell) -> Studied:
        """A study, from its file or measured now and kept.

        Raises:
            FileError: as `measured`.
        """
        path = self._folder / f"{study.name}.json"
        if path.exists():
            content = self._content(path)
            kept = content["finding"]
            return Studied(study, kept and _finding(kept), content["skipped"])
        try:
            found = Studied(study, study.measure(setting, rounds, tell))
        except CannotMeasure as reason:
            found = Studied(study, None, str(reason))
        self._keep(path, {"skipped": found.skipped, "finding": found.finding and _kept(found.finding)})
        return found

    def _keep(self, path: Path, content: dict[str, Any]) -> None:
        atomic.write_bytes(path, json_text({"conditions": self.conditions} | content).encode())

    def _read(self, path: Path, group: Group) -> Measured:
        content = self._content(path)
        rows = tuple(Row(**_numbers(row)) for row in content["rows"])
        pace = math.nan if content["pace"] is None else content["pace"]
        return Measured(group, rows, content["skipped"], content["note"], pace)

    def _content(self, path: Path) -> dict[str, Any]:
        content = read_json(path)
        if content.get("conditions") != self.conditions:
            remedy = "use another --out, or leave --resume out"
            raise FileError(path, "", "was measured under other conditions", remedy)
        return content


def _kept(finding: Finding) -> dict[str, Any]:
    """A finding for JSON, whose objects have no order of their own: columns apart from rows."""
    rows = [list(row.values()) for row in finding.rows]
    return {"sentences": finding.sentences, "facts": finding.facts, "rows": rows} | {
        "columns": list(finding.rows[0])
    }


def _finding(kept: dict[str, Any]) -> Finding:
    rows = tuple(dict(zip(kept["columns"], row, strict=True)) for row in kept["rows"])
    return Finding(tuple(kept["sentences"]), rows, kept["facts"])


def _numbers(row: dict[str, Any]) -> dict[str, Any]:
    """A row as it was: what the machine does not tell is NaN."""
    return {name: math.nan if value is None else value for name, value in row.items()}


def write(
    out: str,
    found: Sequence[Measured],
    studied: Sequence[Studied],
    conditions: dict[str, Any],
    asked: dict[str, Any],
) -> None:
    """Write the report of a run into a directory, all of it or nothing.

    Args:
        out: the directory.
        found: its groups.
        studied: its studies.
        conditions: as `conditions` gives them.
        asked: the options, for the manifest.

    Raises:
        FileError: the directory has a fault.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write(folder, [], [], {}, {})
        ...     sorted(path.name for path in Path(folder).iterdir())
        ['manifest.json', 'report.html', 'trade.csv', 'trade.json']
    """
    pictures = {
        each.group.name: picture.front(each.group, each.rows, each.note) for each in found if not each.skipped
    }
    findings = {each.study: each.finding for each in studied if each.finding is not None}
    pictures |= {study.name: study.picture(finding) for study, finding in findings.items()}
    with output_directory(out, {"command": "trade", "options": asked}) as output:
        for name, content in pictures.items():
            output.put(f"{name}.png", content)
        output.put("trade.csv", report.as_csv(found))
        for study, finding in findings.items():
            output.put(f"{study.name}.csv", report.rows_as_csv(finding.rows))
        output.put("trade.json", json_text(report.as_json(found, studied, conditions)).encode())
        output.put("report.html", page.as_html(found, studied, pictures, conditions))
