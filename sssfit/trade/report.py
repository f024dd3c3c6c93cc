"""What a run found, as CSV, JSON and one HTML page that needs nothing else."""

import base64
import dataclasses
import io
import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from sssfit.trade.choice import Group
from sssfit.trade.measure import Row
from sssfit.trade.pareto import beaten_by

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; padding: 1rem; max-width: 70rem; color: #222; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
img { max-width: 100%; height: auto; display: block; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; }
th, td { border: 1px solid #ccc; padding: .2rem .5rem; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
tr.beaten { color: #777; } tr.default td:first-child { font-weight: bold; }
nav a { display: inline-block; margin: 0 .8rem .2rem 0; }
"""
_HEADS = (
    *("choice", "error", "&plusmn;", "ns", "&plusmn; %", "samples", "bytes moved"),
    *("memory, MB", "compiled in, s", "beaten by"),
)


@dataclasses.dataclass(frozen=True)
class Measured:
    """A group and what was measured of it.

    Attributes:
        group: which.
        rows: its choices; none where it could not be measured.
        skipped: why not, or "".
        note: on what, such as the frame.
    """

    group: Group
    rows: tuple[Row, ...]
    skipped: str = ""
    note: str = ""


def as_csv(found: Sequence[Measured]) -> bytes:
    """A line for each choice, numbers in full.

    Args:
        found: the groups.

    Returns:
        UTF-8 text with a header; what is not known is empty.

    Example:
        >>> as_csv([]).split(b",")[:2]
        [b'group', b'choice']
    """
    import csv

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = [field.name for field in dataclasses.fields(Row) if field.name != "knobs"]
    writer.writerow([*names, "beaten_by"])
    for each in found:
        for row in each.rows:
            values = [getattr(row, name) for name in names]
            beaten = beaten_by(row, each.rows, each.group)
            writer.writerow(["" if _is_unknown(value) else value for value in values] + [beaten])
    return stream.getvalue().encode()


def as_json(found: Sequence[Measured], conditions: Mapping[str, Any]) -> dict[str, Any]:
    """All of it as values that JSON knows.

    Args:
        found: the groups.
        conditions: machine, versions and settings.

    Returns:
        conditions; groups by name, each with title, unit, error, reference, cost, why its default is beside
        the front if it is allowed to be, and choices or the reason why there are none.

    Example:
        >>> as_json([], {"rounds": 5})
        {'conditions': {'rounds': 5}, 'groups': {}}
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
    return {"conditions": dict(conditions), "groups": groups}


def known(row: Row) -> dict[str, Any]:
    """A row as values that JSON knows: None where the machine does not tell.

    Args:
        row: a choice.

    Example:
        >>> known(Row("split", "all", {}, True, 0.1, 0.0, 9.0, 0.02, 64.0, 0.0, math.nan, 0.0))["peak_bytes"]
    """
    return {name: None if _is_unknown(value) else value for name, value in dataclasses.asdict(row).items()}


def as_html(found: Sequence[Measured], pictures: Mapping[str, bytes], conditions: Mapping[str, Any]) -> bytes:
    """One page with every picture and number.

    Args:
        found: the groups.
        pictures: PNG files by the names of groups that were measured.
        conditions: machine, versions and settings.

    Returns:
        UTF-8 bytes; nothing is loaded from elsewhere.

    Example:
        >>> as_html([], {}, {})[:15]
        b'<!DOCTYPE html>'
    """
    facts = "".join(f"<li>{escape(name)}: {escape(str(value))}</li>" for name, value in conditions.items())
    links = "".join(f'<a href="#{each.group.name}">{escape(each.group.name)}</a>' for each in found)
    body = [
        "<h1>Speed against accuracy</h1>",
        "<p>Filled marks and black rows: no other choice is cheaper and as accurate, or more accurate and as "
        "cheap, by more than the noise. Times are medians of rounds in which all choices of a group took "
        f"turns.</p><ul>{facts}</ul><nav>{links}</nav>",
        *(_section(each, pictures) for each in found),
    ]
    page = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>sssfit trade</title>\n<style>{_STYLE}</style></head>\n<body>\n"
    )
    return (page + "\n".join(body) + "\n</body></html>\n").encode()


def _section(each: Measured, pictures: Mapping[str, bytes]) -> str:
    group = each.group
    head = f'<h2 id="{group.name}">{escape(group.name)}</h2>\n<p>{escape(group.title)}.</p>'
    if each.skipped:
        return f"{head}\n<p>Not measured: {escape(each.skipped)}.</p>"
    picture = base64.b64encode(pictures[group.name]).decode()
    rows = "".join(_line(row, each) for row in each.rows)
    heads = "".join(f"<th>{head}</th>" for head in _HEADS)
    note = f"<p>{escape(group.beside_the_front)}</p>" if group.beside_the_front else ""
    return (
        f"{head}\n<p>On {escape(each.note)}. Error: {escape(group.error)}, against "
        f"{escape(group.reference)}. Costs are those of one {escape(group.unit)}.</p>{note}\n"
        f'<img alt="cost against error, {escape(group.name)}" src="data:image/png;base64,{picture}">\n'
        f'<div class="scroll"><table><tr>{heads}</tr>{rows}</table></div>'
    )


def _line(row: Row, each: Measured) -> str:
    beaten = beaten_by(row, each.rows, each.group)
    kinds = " ".join(["beaten"] * bool(beaten) + ["default"] * row.is_default)
    cells = (
        escape(row.choice) + (" (default)" if row.is_default else ""),
        f"{row.error:.3g}",
        f"{row.error_noise:.1g}" if row.error_noise else "",
        f"{row.nanoseconds:.3g}",
        f"{100 * row.time_noise:.0f}",
        f"{row.samples:.4g}" if row.samples else "",
        f"{row.bytes_moved:.4g}" if row.bytes_moved else "",
        "" if _is_unknown(row.peak_bytes) else f"{row.peak_bytes / 1e6:.1f}",
        f"{row.compile_seconds:.1f}",
        escape(beaten),
    )
    return f'<tr class="{kinds}">' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _is_unknown(value: Any) -> bool:
    return isinstance(value, float) and math.isnan(value)
