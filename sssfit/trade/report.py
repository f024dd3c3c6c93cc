"""What a run found, as CSV and JSON."""

import csv
import dataclasses
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

from sssfit.trade.choice import Group
from sssfit.trade.measure import Row, pace_noise
from sssfit.trade.pareto import beaten_by
from sssfit.trade.study import Finding, Study


@dataclasses.dataclass(frozen=True)
class Measured:
    """A group and what was measured of it.

    Attributes:
        group: which.
        rows: its choices; none where it could not be measured.
        skipped: why not, or "".
        note: on what, such as the frame.
        pace: see `measure.Found`; NaN where it was not measured.
    """

    group: Group
    rows: tuple[Row, ...]
    skipped: str = ""
    note: str = ""
    pace: float = math.nan


@dataclasses.dataclass(frozen=True)
class Studied:
    """A study and what it found.

    Attributes:
        study: which.
        finding: None where it could not be measured.
        skipped: why not, or "".
    """

    study: Study
    finding: Finding | None
    skipped: str = ""


def as_csv(found: Sequence[Measured]) -> bytes:
    """A line for each choice, numbers in full.

    Args:
        found: the groups.

    Returns:
        UTF-8 text with a header; what is not known is empty. The last column is the noise of a time beside
        that of another run, in which the machine has another pace.

    Example:
        >>> as_csv([]).split(b",")[:2]
        [b'group', b'choice']
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = [field.name for field in dataclasses.fields(Row) if field.name != "knobs"]
    pace = pace_noise(paces(found))
    writer.writerow([*names, "beaten_by", "time_noise_between_runs"])
    for each in found:
        for row in each.rows:
            values = [getattr(row, name) for name in names]
            values += [beaten_by(row, each.rows, each.group), math.hypot(row.time_noise, pace)]
            writer.writerow(["" if is_unknown(value) else value for value in values])
    return stream.getvalue().encode()


def rows_as_csv(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """A study's table, numbers in full.

    Args:
        rows: with the same columns, at least one.

    Returns:
        UTF-8 text with a header; what is not known is empty.

    Example:
        >>> rows_as_csv([{"frame": "head", "ms": 2.5}])
        b'frame,ms\\nhead,2.5\\n'
    """
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue().encode()


def paces(found: Sequence[Measured]) -> list[float]:
    """The machine's pace in each group that was measured, seconds.

    Args:
        found: the groups.

    Example:
        >>> paces([])
        []
    """
    return [each.pace for each in found if not is_unknown(each.pace)]


def as_json(
    found: Sequence[Measured], studied: Sequence[Studied], conditions: Mapping[str, Any]
) -> dict[str, Any]:
    """All of it as values that JSON knows.

    Args:
        found: the groups.
        studied: the studies.
        conditions: machine, versions and settings.

    Returns:
        conditions; how much the machine's pace differs from group to group, see `measure.pace_noise`, None
        for fewer than two; studies by name, each with its question, sentences, rows and facts or the reason
        why there are none; groups by name, each with title, unit, error, reference, cost, why its default
        is beside the front if it is allowed to be, and choices or the reason why there are none.

    Example:
        >>> as_json([], [], {"rounds": 5})
        {'conditions': {'rounds': 5}, 'pace_noise': None, 'groups': {}, 'studies': {}}
    """
    groups: dict[str, Any] = {}
    for each in found:
        facts = {name: getattr(each.group, name) for name in ("title", "unit", "error", "reference", "cost")}
        choices = []
        for row in each.rows:
            choices.append(known(row) | {"beaten_by": beaten_by(row, each.rows, each.group)})
        groups[each.group.name] = facts | {
            "beside_the_front": each.group.beside_the_front,
            "skipped": each.skipped,
            "note": each.note,
            "choices": choices,
        }
    noise = pace_noise(paces(found))
    return {
        "conditions": dict(conditions),
        "pace_noise": None if is_unknown(noise) else noise,
        "groups": groups,
        "studies": {each.study.name: _study(each) for each in studied},
    }


def _study(each: Studied) -> dict[str, Any]:
    facts = {"title": each.study.title, "about": each.study.about, "skipped": each.skipped}
    return facts | (dataclasses.asdict(each.finding) if each.finding is not None else {})


def known(row: Row) -> dict[str, Any]:
    """A row as values that JSON knows: None where the machine does not tell.

    Args:
        row: a choice.

    Example:
        >>> known(Row("split", "all", {}, True, 0.1, 0.0, 9.0, 0.02, 64.0, 0.0, math.nan, 0.0))["peak_bytes"]
    """
    return {name: None if is_unknown(value) else value for name, value in dataclasses.asdict(row).items()}


def is_unknown(value: Any) -> bool:
    """Whether a value is NaN.

    Args:
        value: of any kind.

    Example:
        >>> is_unknown(math.nan), is_unknown("fast")
        (True, False)
    """
    return isinstance(value, float) and math.isnan(value)
