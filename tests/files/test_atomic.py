"""Files appear whole or not at all, and trouble leaves earlier files alone."""

import errno
import os
import signal
import threading

import pytest

from sssfit.files import atomic
from sssfit.files.atomic import staged_directory, write_bytes
from sssfit.files.errors import FileError


def fail_with(number):
    """Make a stand-in for a system call that fails."""

    def failing(*args, **kwargs):
        raise OSError(number, os.strerror(number))

    return failing


def names_below(directory):
    return sorted(path.relative_to(directory).as_posix() for path in directory.rglob("*"))


@pytest.fixture
def earlier(tmp_path):
    """An output directory with one earlier output."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "table.npz").write_bytes(b"earlier")
    return out


def assert_untouched(out):
    assert names_below(out) == ["table.npz"]
    assert (out / "table.npz").read_bytes() == b"earlier"


@pytest.mark.parametrize("data", [b"", b"new", bytes(range(256)) * 1000])
def test_write_bytes_replaces_a_file(earlier, data):
    write_bytes(earlier / "table.npz", data)
    assert (earlier / "table.npz").read_bytes() == data
    assert names_below(earlier) == ["table.npz"]


def test_written_file_follows_the_umask(tmp_path):
    umask = os.umask(0o027)
    try:
        write_bytes(tmp_path / "file", b"")
    finally:
        os.umask(umask)
    assert (tmp_path / "file").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize(
    "number, message",
    [
        (errno.ENOSPC, "the disk is full, an earlier file is untouched; free space and run again"),
        (errno.EACCES, "cannot be written (permission denied), an earlier file is untouched"),
    ],
)
def test_write_bytes_failure_leaves_nothing_behind(earlier, monkeypatch, call, number, message):
    monkeypatch.setattr(atomic.os, call, fail_with(number))
    with pytest.raises(FileError) as caught:
        write_bytes(earlier / "table.npz", b"new")
    assert str(caught.value).startswith(f"{earlier / 'table.npz'}: {message}")
    assert_untouched(earlier)


def test_write_bytes_when_the_write_itself_finds_the_disk_full(earlier, monkeypatch):
    class FullDisk:
        """A stream that was opened, and cannot take the data."""

        def __init__(self, path, mode):
            os.close(os.open(path, os.O_CREAT | os.O_EXCL))

        def __enter__(self):
            return self

        def __exit__(self, *error):
            return None

        write = staticmethod(fail_with(errno.ENOSPC))

    monkeypatch.setattr(atomic, "open", FullDisk, raising=False)
    with pytest.raises(FileError, match="the disk is full"):
        write_bytes(earlier / "table.npz", b"new")
    assert_untouched(earlier)


def test_write_bytes_interrupted(earlier, monkeypatch):
    def interrupt(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(atomic.os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(earlier / "table.npz", b"new")
    assert_untouched(earlier)


def test_write_bytes_refuses_paths_that_cannot_be_files(earlier):
    with pytest.raises(FileError, match=r"no such file or directory.*create the directory"):
        write_bytes(earlier / "missing" / "file", b"")
    with pytest.raises(FileError, match=r"not a directory.*; choose a path whose parents are"):
        write_bytes(earlier / "table.npz" / "file", b"")
    (earlier / "directory").mkdir()
    with pytest.raises(FileError, match=r"is a directory.*; move the directory away"):
        write_bytes(earlier / "directory", b"")
    assert names_below(earlier) == ["directory", "table.npz"]


def test_staged_files_are_published_in_sub_directories_too(earlier):
    with staged_directory(earlier) as staging:
        assert staging.parent == earlier and staging.name.startswith(".sssfit-staging-")
        (staging / "sub" / "deep").mkdir(parents=True)
        (staging / "sub" / "deep" / "a.csv").write_text("a")
        (staging / "table.npz").write_bytes(b"new")
        assert (earlier / "table.npz").read_bytes() == b"earlier"
    assert names_below(earlier) == ["sub", "sub/deep", "sub/deep/a.csv", "table.npz"]
    assert (earlier / "table.npz").read_bytes() == b"new"


def test_missing_parents_are_created(tmp_path):
    with staged_directory(tmp_path / "a" / "b") as staging:
        (staging / "file").write_text("")
    assert names_below(tmp_path) == ["a", "a/b", "a/b/file"]


def test_manifest_is_published_last(tmp_path, monkeypatch):
    published = []
    replace = os.replace

    def recorded(source, target):
        published.append(target.name)
        replace(source, target)

    monkeypatch.setattr(atomic.os, "replace", recorded)
    with staged_directory(tmp_path) as staging:
        for name in ("z.npz", "manifest.json", "a.npz"):
            (staging / name).write_text("")
    assert published == ["a.npz", "z.npz", "manifest.json"]


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), SystemExit(1)])
def test_exception_in_the_block_publishes_nothing(earlier, error):
    with pytest.raises(type(error)):
        with staged_directory(earlier) as staging:
            (staging / "table.npz").write_bytes(b"new")
            raise error
    assert_untouched(earlier)


def test_exception_removes_the_directories_that_were_created(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        with staged_directory(tmp_path / "a" / "b") as staging:
            (staging / "file").write_text("")
            raise KeyboardInterrupt
    assert names_below(tmp_path) == []


def test_a_directory_that_holds_something_is_not_removed(tmp_path):
    with pytest.raises(ValueError):
        with staged_directory(tmp_path / "a" / "b"):
            (tmp_path / "a" / "note").write_text("")
            raise ValueError
    assert names_below(tmp_path) == ["a", "a/note"]


def test_full_disk_in_the_block(earlier):
    with pytest.raises(FileError) as caught:
        with staged_directory(earlier) as staging:
            (staging / "table.npz").write_bytes(b"new")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert str(caught.value) == (
        f"{earlier}: the disk is full, earlier outputs are untouched; free space and run again"
    )
    assert_untouched(earlier)


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_full_disk_while_publishing(earlier, monkeypatch, call):
    monkeypatch.setattr(atomic.os, call, fail_with(errno.ENOSPC))
    with pytest.raises(FileError, match="the disk is full, earlier outputs are untouched"):
        with staged_directory(earlier) as staging:
            (staging / "table.npz").write_bytes(b"new")
    assert_untouched(earlier)


def test_failure_after_some_files_says_how_many(earlier, monkeypatch):
    replace = os.replace

    def failing_at_table(source, target):
        if target.name == "table.npz":
            raise OSError(errno.EACCES, "Permission denied")
        replace(source, target)

    monkeypatch.setattr(atomic.os, "replace", failing_at_table)
    with pytest.raises(FileError, match="1 of 3 files had been replaced"):
        with staged_directory(earlier) as staging:
            for name in ("a.npz", "table.npz", "manifest.json"):
                (staging / name).write_bytes(b"new")
    assert names_below(earlier) == ["a.npz", "table.npz"]


def test_target_that_is_a_directory_stops_all_publishing(earlier):
    (earlier / "z").mkdir()
    with pytest.raises(FileError, match="z: is a directory where a file shall be written"):
        with staged_directory(earlier) as staging:
            (staging / "table.npz").write_bytes(b"new")
            (staging / "z").write_bytes(b"new")
    assert names_below(earlier) == ["table.npz", "z"]
    assert (earlier / "table.npz").read_bytes() == b"earlier"


def test_target_directory_that_is_a_file_stops_all_publishing(earlier):
    with pytest.raises(FileError, match="table.npz: is a file, not a directory"):
        with staged_directory(earlier) as staging:
            (staging / "a" / "b").mkdir(parents=True)
            (staging / "a" / "b" / "file").write_bytes(b"new")
            (staging / "table.npz").mkdir()
            (staging / "table.npz" / "file").write_bytes(b"new")
    assert_untouched(earlier)


def test_unwritable_target_directory_stops_all_publishing(earlier, monkeypatch):
    # Simulated, because the superuser may write everywhere.
    monkeypatch.setattr(atomic.os, "access", lambda path, mode: path.name != "sub")
    with pytest.raises(FileError, match="sub: the directory is not writable, earlier outputs"):
        with staged_directory(earlier) as staging:
            (staging / "sub").mkdir()
            (staging / "sub" / "file").write_bytes(b"new")
            (staging / "table.npz").write_bytes(b"new")
    assert_untouched(earlier)


def test_output_directory_that_is_a_file(earlier):
    with pytest.raises(FileError) as caught:
        with staged_directory(earlier / "table.npz"):
            pytest.fail("the block must not run")
    assert str(caught.value) == (
        f"{earlier / 'table.npz'}: is a file, not a directory; move it away or choose another directory"
    )
    assert_untouched(earlier)


@pytest.mark.parametrize("call", ["mkdtemp", "mkdir"])
def test_output_directory_that_cannot_be_written(tmp_path, monkeypatch, call):
    # Simulated, because the superuser may write everywhere.
    owner = atomic.tempfile if call == "mkdtemp" else atomic.Path
    monkeypatch.setattr(owner, call, fail_with(errno.EACCES))
    with pytest.raises(FileError, match=r"cannot be written \(permission denied\).*; change the"):
        with staged_directory(tmp_path / "out"):
            pytest.fail("the block must not run")
    assert names_below(tmp_path) == []


def test_interrupt_waits_until_everything_is_published(earlier, monkeypatch):
    replace = os.replace

    def interrupted(source, target):
        signal.raise_signal(signal.SIGINT)
        replace(source, target)

    monkeypatch.setattr(atomic.os, "replace", interrupted)
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        with staged_directory(earlier) as staging:
            for name in ("table.npz", "manifest.json"):
                (staging / name).write_bytes(b"new")
    assert names_below(earlier) == ["manifest.json", "table.npz"]
    assert (earlier / "table.npz").read_bytes() == b"new"
    assert signal.getsignal(signal.SIGINT) is handler


def test_staging_works_outside_the_main_thread(tmp_path):
    def publish():
        with staged_directory(tmp_path) as staging:
            (staging / "file").write_text("")

    thread = threading.Thread(target=publish)
    thread.start()
    thread.join()
    assert names_below(tmp_path) == ["file"]
