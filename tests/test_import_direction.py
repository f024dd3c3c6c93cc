"""Imports run downhill, and solvers and plots stay where they belong. Read from the sources, nothing runs."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "sssfit"

# What each topic may import of ours besides itself and `reproduction`, the row that every topic's `published`
# yields; a topic that is not here is new and needs its line.
ALLOWED = {
    "files": set(),
    "profiles": {"files"},
    "sampling": {"profiles"},
    "estimators": {"profiles"},
    "fitting": {"files", "profiles", "sampling"},
    "frames": {"files", "profiles", "sampling", "estimators"},
    "scenarios": {"files", "profiles", "sampling", "estimators"},
    "tables": {"files", "profiles", "sampling", "fitting"},
    "trade": {"files", "profiles", "sampling", "estimators", "fitting", "frames", "scenarios", "tables"},
    "cli": {
        "files",
        "profiles",
        "sampling",
        "estimators",
        "fitting",
        "frames",
        "scenarios",
        "tables",
        "trade",
    },
}
SOLVERS = ("optimistix", "jaxopt", "scipy.optimize")
# The files that may import solvers: of what is not linear, and of what is.
ADAPTERS = ("fitting/solve.py", "fitting/non_negative.py")
# The one file that may import what draws posteriors.
SAMPLER, SAMPLING = "emcee", "fitting/posterior.py"
# What else is heavy and not always needed.
LATE = ("matplotlib", "corner", "h5py", SAMPLER)


def imports(source, package=()):
    """(module, whether it is imported when the file is) for all imports, `from a import b` as a.b."""
    found = []

    def visit(node, at_load):
        if isinstance(node, ast.Import):
            found.extend((alias.name, at_load) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            found.extend((f"{module}.{alias.name}", at_load) for alias in node.names)
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            at_load = False
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            at_load = False
        for child in ast.iter_child_nodes(node):
            visit(child, at_load)

    visit(ast.parse(source), True)
    return found


def is_within(module, library):
    return module == library or module.startswith(f"{library}.")


def files():
    return sorted(path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py"))


def imports_of(file):
    return imports((PACKAGE / file).read_text(encoding="utf-8"), ("sssfit", *Path(file).parent.parts))


def test_imports_are_found_wherever_they_stand():
    source = """
import numpy as np, jaxopt
from scipy import optimize
from sssfit import tables
from ..profiles import burley
from . import sibling
if TYPE_CHECKING:
    import optimistix
def f():
    import matplotlib.pyplot as plt
class A:
    from sssfit.files import errors
"""
    assert imports(source, ("sssfit", "fitting")) == [
        ("numpy", True),
        ("jaxopt", True),
        ("scipy.optimize", True),
        ("sssfit.tables", True),
        ("sssfit.profiles.burley", True),
        ("sssfit.fitting.sibling", True),
        ("optimistix", False),
        ("matplotlib.pyplot", False),
        ("sssfit.files.errors", True),
    ]


def test_every_topic_has_its_line():
    topics = {Path(file).parts[0] for file in files() if "/" in file}
    assert topics == set(ALLOWED)
    assert len(files()) > 40


@pytest.mark.parametrize("file", [file for file in files() if "/" in file])
def test_imports_run_downhill(file):
    topic = file.split("/")[0]
    ours = [module for module, _ in imports_of(file) if is_within(module, "sssfit")]
    above = [m for m in ours if m.split(".")[1] not in ALLOWED[topic] | {topic, "reproduction"}]
    assert not above


def test_what_every_topic_may_import_imports_none():
    assert [module for module, _ in imports_of("reproduction.py") if is_within(module, "sssfit")] == []


def test_the_package_itself_imports_no_topic_when_it_loads():
    # A topic loads when it is used; see test_import_cost.py.
    assert [module for module, at_load in imports_of("__init__.py") if at_load and "sssfit" in module] == []


def test_two_files_know_the_solvers():
    users = {
        file
        for file in files()
        for module, _ in imports_of(file)
        if any(is_within(module, s) for s in SOLVERS)
    }
    assert users == set(ADAPTERS)
    loaded = [m for file in ADAPTERS for m, at_load in imports_of(file) if at_load]
    assert [m for m in loaded if any(is_within(m, s) for s in SOLVERS)] == []


def test_one_file_knows_the_sampler():
    assert {file for file in files() for m, _ in imports_of(file) if is_within(m, SAMPLER)} == {SAMPLING}


@pytest.mark.parametrize("library", LATE)
def test_plots_and_chains_are_imported_when_they_are_used(library):
    users = [
        (file, at_load)
        for file in files()
        for module, at_load in imports_of(file)
        if is_within(module, library)
    ]
    assert users
    assert [file for file, at_load in users if at_load] == []
