"""What a run found, as one HTML page that needs nothing else."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from sssfit.trade.measure import Row, pace_noise
from sssfit.trade.pareto import beaten_by
from sssfit.trade.report import Measured, Studied, is_unknown, paces

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


def as_html(
    found: Sequence[Measured],
    studied: Sequence[Studied],
    pictures: Mapping[str, bytes],
    conditions: Mapping[str, Any],
) -> bytes:
    """One page with every picture and number.

    Args:
        found: the groups.
        studied: the studies.
        pictures: PNG files by the names of groups and studies that were measured.
        conditions: machine, versions and settings.

    Returns:
        UTF-8 bytes; nothing is loaded from elsewhere.

    Example:
        >>> as_html([], [], {}, {})[:15]
        b'<!DOCTYPE html>'
    """
    facts = "".join(f"<li>{escape(name)}: {escape(str(value))}</li>" for name, value in conditions.items())
    names = [each.group.name for each in found] + [each.study.name for each in studied]
    links = "".join(f'<a href="#{name}">{escape(name)}</a>' for name in names)
    body = [
        "<h1>Speed against accuracy</h1>",
        "<p>Filled marks and black rows: no other choice is cheaper and as accurate, or more accurate and as "
        "cheap, by more than the noise. Times are medians of rounds in which all choices of a group took "
        f"turns.{_pace(found)}</p><ul>{facts}</ul><nav>{links}</nav>",
        *(_section(each, pictures) for each in found),
        *(_study(each, pictures) for each in studied),
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


def _pace(found: Sequence[Measured]) -> str:
    """What to add to a time's noise beside another run's."""
    share = pace_noise(paces(found))
    if is_unknown(share):
        return ""
    return (
        f" From one group to another the same program took times that differ by {share:.0%} (95 %): so much "
        "more do times of two runs differ, in which a machine is more or less busy."
    )


def _study(each: Studied, pictures: Mapping[str, bytes]) -> str:
    study, finding = each.study, each.finding
    head = f'<h2 id="{study.name}">{escape(study.name)}</h2>\n<p>{escape(study.title)}.</p>'
    if finding is None:
        return f"{head}\n<p>Not measured: {escape(each.skipped)}.</p>"
    picture = base64.b64encode(pictures[study.name]).decode()
    words = "".join(f"<li>{escape(sentence)}</li>" for sentence in finding.sentences)
    heads = "".join(f"<th>{escape(name)}</th>" for name in finding.rows[0])
    rows = "".join(
        "<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row.values()) + "</tr>"
        for row in finding.rows
    )
    return (
        f"{head}\n<p>{escape(study.about)}.</p><ul>{words}</ul>\n"
        f'<img alt="{escape(study.title)}" src="data:image/png;base64,{picture}">\n'
        f'<div class="scroll"><table><tr>{heads}</tr>{rows}</table></div>'
    )


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else escape(str(value))


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
        "" if is_unknown(row.peak_bytes) else f"{row.peak_bytes / 1e6:.1f}",
        "" if is_unknown(row.compile_seconds) else f"{row.compile_seconds:.1f}",
        escape(beaten),
    )
    return f'<tr class="{kinds}">' + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"
