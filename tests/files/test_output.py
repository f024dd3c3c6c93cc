"""A directory of outputs: all of it or nothing, and a manifest that says what is there."""

import errno
import hashlib
import json
import os
from importlib.metadata import version

import pytest

from sssfit.files.errors import FileError
from sssfit.files.output import output_directory


def contents(directory):
    return {
        path.relative_to(directory).as_posix(): path.read_bytes()
        for path in directory.rglob("*")
        if path.is_file()
    }


@pytest.fixture
def earlier(tmp_path):
    """A directory with an earlier run's outputs and somebody's notes."""
    out = tmp_path / "out"
    with output_directory(out, {"options": {"run": 1}}) as output:
        output.put("summary.json", b"earlier")
        output.put("sub/table.csv", b"earlier")
    (out / "notes.txt").write_text("mine")
    return out, contents(out)


def test_the_manifest_is_true(tmp_path):
    files = {"a.txt": b"1", "empty": b"", "sub/b.bin": bytes(range(256)), "sub/c.bin": b"c"}
    with output_directory(tmp_path / "out", {"options": {"seed": 3}, "unit": "mm"}, ["pytest"]) as output:
        for path, content in files.items():
            output.put(path, content)
        output.timing["seconds"] = 1.5
    written = contents(tmp_path / "out")
    manifest = json.loads(written["manifest.json"])
    assert manifest["options"] == {"seed": 3} and manifest["unit"] == "mm"
    assert manifest["versions"]["pytest"] == version("pytest")
    assert manifest["versions"]["sssfit"] == version("sssfit")
    assert manifest["files"] == {
        path: {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
        for path, content in files.items()
    }
    assert {path: written[path] for path in files} == files


def test_timing_is_outside_the_promise(tmp_path):
    runs = []
    for seconds in (1.0, 2.0):
        out = tmp_path / str(seconds)
        with output_directory(out, {"options": {}}) as output:
            output.put("a.txt", b"1")
            output.timing["seconds"] = seconds
        runs.append(contents(out))
    assert set(runs[0]) == {"a.txt", "manifest.json", "timing.json"}
    assert set(json.loads(runs[0]["manifest.json"])["files"]) == {"a.txt"}
    assert [json.loads(run.pop("timing.json")) for run in runs] == [{"seconds": 1.0}, {"seconds": 2.0}]
    assert runs[0] == runs[1]


def test_without_times_there_is_no_such_file(tmp_path):
    with output_directory(tmp_path, {}) as output:
        output.put("a.txt", b"1")
    assert set(contents(tmp_path)) == {"a.txt", "manifest.json"}


def test_the_manifest_may_grow_in_the_block(tmp_path):
    with output_directory(tmp_path, {"tables": []}) as output:
        output.manifest["tables"].append("radius")
    assert json.loads((tmp_path / "manifest.json").read_text())["tables"] == ["radius"]


def test_putting_twice_keeps_the_last(tmp_path):
    with output_directory(tmp_path, {}) as output:
        output.put("a.txt", b"first")
        output.put("a.txt", b"second")
    entry = json.loads((tmp_path / "manifest.json").read_text())["files"]["a.txt"]
    assert (tmp_path / "a.txt").read_bytes() == b"second"
    assert entry == {"sha256": hashlib.sha256(b"second").hexdigest(), "bytes": 6}


def test_sub_directories_of_any_depth(tmp_path):
    with output_directory(tmp_path / "out", {}) as output:
        output.put("one/a", b"a")
        output.put("one/two/three/b", b"b")
    written = contents(tmp_path / "out")
    assert written["one/a"] == b"a" and written["one/two/three/b"] == b"b"
    assert set(json.loads(written["manifest.json"])["files"]) == {"one/a", "one/two/three/b"}


def test_files_of_others_and_of_earlier_runs_stay(earlier):
    out, before = earlier
    with output_directory(out, {"options": {"run": 2}}) as output:
        output.put("summary.json", b"new")
    after = contents(out)
    assert set(after) == set(before) and after["summary.json"] == b"new"
    assert after["notes.txt"] == b"mine" and after["sub/table.csv"] == b"earlier"
    assert set(json.loads(after["manifest.json"])["files"]) == {"summary.json"}


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), SystemExit(3), MemoryError()])
def test_an_exception_inside_publishes_nothing(error, earlier):
    out, before = earlier
    with pytest.raises(type(error)):
        with output_directory(out, {}) as output:
            output.put("summary.json", b"new")
            output.put("sub/other.csv", b"new")
            raise error
    assert contents(out) == before


def test_an_exception_inside_leaves_no_new_directory(tmp_path):
    with pytest.raises(KeyError):
        with output_directory(tmp_path / "a" / "b", {}) as output:
            output.put("sub/file", b"new")
            raise KeyError("x")
    assert list(tmp_path.iterdir()) == []


def test_a_manifest_that_json_cannot_hold_publishes_nothing(earlier):
    out, before = earlier
    with pytest.raises(TypeError, match="JSON cannot hold"):
        with output_directory(out, {"options": {"path": object()}}) as output:
            output.put("summary.json", b"new")
    assert contents(out) == before


def test_a_timing_that_json_cannot_hold_publishes_nothing(earlier):
    out, before = earlier
    with pytest.raises(TypeError, match="JSON cannot hold"):
        with output_directory(out, {}) as output:
            output.put("summary.json", b"new")
            output.timing["seconds"] = object()
    assert contents(out) == before


def test_a_full_disk_is_one_sentence(earlier):
    out, before = earlier
    with pytest.raises(FileError, match="the disk is full, earlier outputs are untouched"):
        with output_directory(out, {}) as output:
            output.put("summary.json", b"new")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert contents(out) == before


def test_a_file_where_the_directory_should_be(earlier):
    out, before = earlier
    with pytest.raises(FileError, match="is a file, not a directory"):
        with output_directory(out / "notes.txt", {}):
            pytest.fail("the block must not run")
    assert contents(out) == before


def test_an_unknown_package_is_noticed_before_anything_is_made(tmp_path):
    with pytest.raises(ModuleNotFoundError):
        with output_directory(tmp_path / "out", {}, ["no-such-package-anywhere"]):
            pytest.fail("the block must not run")
    assert list(tmp_path.iterdir()) == []
