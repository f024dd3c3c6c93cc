"""Sphinx configuration. Build with: sphinx-build -W --keep-going -b html docs docs/_build/html."""

import shutil
from importlib.metadata import version as _version
from pathlib import Path

_HERE = Path(__file__).resolve().parent


def _collect_notebooks() -> None:
    """Copy the notebooks into the source tree, because Sphinx reads nothing outside it."""
    target = _HERE / "notebooks"
    target.mkdir(exist_ok=True)
    sources = {path.name: path for path in (_HERE.parent / "notebooks").glob("*.md")}
    for path in target.glob("*.md"):
        if path.name not in sources:
            path.unlink()
    for name, source in sources.items():
        copy = target / name
        # An unchanged copy keeps its time, so that a second build does not run it again.
        if not copy.exists() or copy.read_bytes() != source.read_bytes():
            shutil.copyfile(source, copy)


_collect_notebooks()

project = "sssfit"
author = "The sssfit developers"
copyright = author
version = release = _version("sssfit")

extensions = ["myst_nb"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"sssfit {release}"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = True
nb_merge_streams = True
nb_output_stderr = "remove"
