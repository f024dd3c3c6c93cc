"""The report of a run: one self-contained HTML page with every plot, unit and measured error."""

import base64
from html import escape
from typing import Any

from sssfit.tables.plot import PIXELS

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; padding: 1rem; max-width: 64rem; color: #222; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
h3 { font-size: 1.05rem; margin-bottom: .3rem; }
img { max-width: 100%; height: auto; display: block; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; }
th, td { border: 1px solid #ccc; padding: .2rem .5rem; text-align: left; white-space: nowrap; }
td.n { text-align: right; font-variant-numeric: tabular-nums; }
code { overflow-wrap: anywhere; font-size: .85em; }
details { margin: .4rem 0; } summary { cursor: pointer; }
nav a { display: inline-block; margin: 0 .8rem .2rem 0; }
"""


def report_html(manifest: dict[str, Any], plots: dict[str, bytes]) -> bytes:
    """Write the page.

    Args:
        manifest: what `writing.write` puts into manifest.json.
        plots: PNG bytes by the path of each table without suffix.

    Returns:
        UTF-8 bytes. Pictures are part of the page; nothing is loaded from elsewhere.

    Example:
        >>> empty = {"inputs": [], "options": {}, "versions": {}, "skipped": [], "tables": []}
        >>> report_html(empty, {})[:15]
        b'<!DOCTYPE html>'
    """
    groups: dict[str, list[dict[str, Any]]] = {}
    for table in manifest["tables"]:
        groups.setdefault(table["path"].rpartition("/")[0], []).append(table)
    body = [_header(manifest, list(groups))]
    for folder, tables in groups.items():
        body.append(f'<h2 id="{_anchor(folder)}">{escape(folder or "For every material")}</h2>')
        body.extend(_section(table, plots[table["path"]]) for table in tables)
    page = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>sssfit tables</title>\n<style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )
    return page.encode()


def _anchor(folder: str) -> str:
    return "group-" + escape(folder.replace(" ", "-"), quote=True)


def _header(manifest: dict[str, Any], folders: list[str]) -> str:
    inputs = "".join(
        f"<li><code>{escape(i['name'])}</code>, SHA-256 <code>{i['sha256']}</code></li>"
        for i in manifest["inputs"]
    )
    options = ", ".join(f"{key} {_value(value)}" for key, value in manifest["options"].items())
    versions = ", ".join(f"{name} {version}" for name, version in manifest["versions"].items())
    skipped = "".join(
        f"<p><strong>{escape(s['material'])}</strong> has no tables of its own: {escape(s['reason'])}.</p>"
        for s in manifest["skipped"]
    )
    links = "".join(
        f'<a href="#{_anchor(folder)}">{escape(folder or "For every material")}</a>' for folder in folders
    )
    return (
        f"<h1>sssfit tables</h1>\n<p>{len(manifest['tables'])} tables. Lengths are in millimetres; values "
        "are linear. Errors are measured: of storage against the values in float64, of lookup against the "
        f"exact function halfway between entries.</p>\n<ul>{inputs}</ul>\n<p>{escape(options)}</p>\n"
        f"<p>{escape(versions)}</p>\n{skipped}\n<nav>{links}</nav>"
    )


def _section(table: dict[str, Any], plot: bytes) -> str:
    picture = base64.b64encode(plot).decode()
    name = escape(table["path"])
    axes = "; ".join(
        f"{a['name'].replace('_', ' ')} from {a['first']:.6g} to {a['last']:.6g}"
        f"{'' if a['unit'] == '1' else ' ' + a['unit']}, {a['size']} entries"
        for a in table["axes"]
    )
    lookup = table["lookup_error"]
    note = (
        "Entries are not interpolated."
        if lookup is None
        else f"Largest error of linear lookup: {lookup:.2g}."
    )
    parameters = "".join(
        f"<tr><td>{escape(key)}</td><td>{escape(_value(value))}</td></tr>"
        for key, value in table["parameters"].items()
    )
    return (
        f"<h3>{name}</h3>\n<p>{escape(table['description'])} Unit of the values: {escape(table['unit'])}. "
        f"Axes: {escape(axes)}. {note}</p>\n"
        f'<img alt="plot of {name}" width="{PIXELS[0]}" height="{PIXELS[1]}" '
        f'src="data:image/png;base64,{picture}">\n'
        f"<details><summary>Files and storage errors</summary>{_files(table)}</details>\n"
        f'<details><summary>Parameters</summary><div class="scroll"><table>{parameters}</table></div>'
        "</details>"
    )


def _files(table: dict[str, Any]) -> str:
    rows = []
    for name, stored in table["formats"].items():
        if "omitted" in stored:
            cells = f'<td colspan="4">not written: {escape(stored["omitted"])}</td>'
        else:
            error = stored["quantization"]
            cells = (
                f"<td>{'<br>'.join(f'<code>{escape(f)}</code>' for f in stored['files'])}</td>"
                f'<td>{stored["dtype"]}</td><td class="n">{_number(error["max_abs_error"])}</td>'
                f'<td class="n">{_number(error["max_rel_error"])}</td>'
            )
        rows.append(f"<tr><td>{escape(name)}</td>{cells}</tr>")
    head = "<tr><th>format</th><th>files</th><th>stored as</th><th>largest error</th><th>relative</th></tr>"
    return f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'


def _number(value: float) -> str:
    return f"{value:.2g}"


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_value(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_value(item) for item in value)
    return str(value)
