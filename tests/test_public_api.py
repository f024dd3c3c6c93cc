"""The public interface as the sources state it: documented, with examples and origins, in short files."""

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "sssfit"
# The command line's interface is its --help, which its own tests read.
LIBRARY = (
    *("files", "profiles", "sampling", "estimators", "fitting", "frames", "scenarios", "tables", "trade"),
    "reproduction.py",
)
# Modules whose functions compute published or derived formulas.
FORMULAS = (
    *(f"profiles/{name}.py" for name in ("burley", "dipole", "gaussian_sum", "separable")),
    *(f"sampling/{name}.py" for name in ("disk", "hashes", "inverse_cdf", "prefilter", "sequences")),
    *(
        f"frames/{name}.py"
        for name in (
            "adaptive",
            "compose",
            "exact",
            "pixel_kernel",
            "points",
            "scatter",
            "surface",
            "taa",
            "temporal",
        )
    ),
    *(
        f"estimators/{name}.py"
        for name in (
            "bias",
            "control_variate",
            "conventions",
            "count_prediction",
            "in_frame",
            "moving",
            "sample_count",
        )
    ),
    *(f"scenarios/{name}.py" for name in ("batch_mean", "circle", "light", "line")),
    *(
        f"tables/{name}.py"
        for name in ("curvature", "falloff", "kernel", "radius", "shadow", "transmittance")
    ),
)


# Private files whose names are public in another one.
REEXPORTED = ("estimators/_state.py", "fitting/_posterior_result.py")


def is_public(file):
    return file.as_posix() in REEXPORTED or not any(
        part.startswith("_") and part != "__init__.py" for part in file.parts
    )


FILES = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))
PUBLIC = [file for file in FILES if is_public(file) and file.parts[0] in LIBRARY]


def definitions(file, kind):
    tree = ast.parse((PACKAGE / file).read_text(encoding="utf-8"))
    return [node for node in tree.body if isinstance(node, kind) and not node.name.startswith("_")]


FUNCTIONS = {
    f"{file.as_posix()}:{node.name}": node for file in PUBLIC for node in definitions(file, ast.FunctionDef)
}
CLASSES = {
    f"{file.as_posix()}:{node.name}": node for file in PUBLIC for node in definitions(file, ast.ClassDef)
}


def section(docstring, title):
    """The indented text under a title, "" without one."""
    found = re.search(rf"^{title}:(.*?)(?=^\S|\Z)", docstring, re.MULTILINE | re.DOTALL)
    return found.group(1) if found else ""


def documented(docstring):
    """The names at the start of the entries under Args; an entry may name several."""
    entries = re.findall(r"^ {4}(\w+(?:, \w+)*)(?: \(.*?\))?:", section(docstring, "Args"), re.MULTILINE)
    return [name for entry in entries for name in entry.split(", ")]


def test_the_docstrings_are_read_as_meant():
    text = ast.get_docstring(FUNCTIONS["profiles/burley.py:profile"], clean=True)
    assert documented(text) == ["r", "d", "albedo"]
    assert section(text, "Source").strip() == "Xie 2021, Eq 2.43."
    assert section(text, "Nothing") == ""
    assert len(FUNCTIONS) > 60 and len(PUBLIC) > 25


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_documented_with_an_example(name):
    node = FUNCTIONS[name]
    text = ast.get_docstring(node, clean=True)
    assert text
    summary = text.splitlines()[0]
    assert summary.endswith((".", ":")) and len(summary) < 110
    assert ">>>" in section(text, "Example")
    arguments = node.args
    rest = [arguments.kwarg] if arguments.kwarg else []
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, *rest]
    assert documented(text) == [a.arg for a in every]
    assert node.returns is not None
    assert [a.arg for a in every if a.annotation is None] == []


@pytest.mark.parametrize("name", CLASSES)
def test_classes_are_documented(name):
    assert ast.get_docstring(CLASSES[name])
    for method in CLASSES[name].body:
        if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
            assert ast.get_docstring(method)


def computes(name):
    """Whether a function is one of the formulas: an array or a table comes out."""
    returns = FUNCTIONS[name].returns
    kind = ast.unparse(returns) if returns else ""
    return name.split(":")[0] in FORMULAS and kind in ("Array", "np.ndarray", "Table")


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if computes(name)])
def test_formulas_name_their_source(name):
    assert section(ast.get_docstring(FUNCTIONS[name], clean=True) or "", "Source").strip()


@pytest.mark.parametrize("file", FORMULAS)
def test_the_modules_with_formulas_exist(file):
    assert any(name.startswith(f"{file}:") and computes(name) for name in FUNCTIONS)


@pytest.mark.parametrize("file", FILES, ids=str)
def test_modules_are_documented_and_of_readable_length(file):
    text = (PACKAGE / file).read_text(encoding="utf-8")
    assert ast.get_docstring(ast.parse(text))
    assert len(text.splitlines()) <= 400


def test_the_topics_hold_what_they_name():
    import sssfit
    from sssfit import profiles, sampling

    assert sssfit.profiles is profiles and sssfit.sampling is sampling
    topics = {"estimators", "files", "fitting", "frames", "profiles", "sampling", "scenarios", "tables"}
    assert topics <= set(dir(sssfit))
    with pytest.raises(AttributeError, match="module 'sssfit' has no attribute 'nothing'"):
        sssfit.nothing  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]
    for name in ("burley", "dipole", "gaussian_sum", "materials", "separable"):
        assert getattr(profiles, name).__name__ == f"sssfit.profiles.{name}"
    assert sampling.inverse_cdf.__name__ == "sssfit.sampling.inverse_cdf"
    assert re.fullmatch(r"\d+\.\d+\.\d+.*", sssfit.__version__)
