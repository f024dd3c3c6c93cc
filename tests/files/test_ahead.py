"""Reading ahead: order, exceptions in their place, and a thread that ends with its reader."""

import os
import signal
import threading
import time
from contextlib import closing

import pytest

from sssfit.files.ahead import read_ahead


def threads():
    return [t for t in threading.enumerate() if t.name.startswith("sssfit-ahead")]


@pytest.fixture(autouse=True)
def no_thread_is_left():
    yield
    assert not threads()


@pytest.mark.parametrize("depth", [1, 2, 9])
def test_the_order_is_kept(depth):
    assert list(read_ahead(lambda n: n * n, range(7), depth)) == [n * n for n in range(7)]
    assert list(read_ahead(len, [])) == []


def test_the_next_is_loaded_while_the_caller_works():
    begun = [threading.Event() for _ in range(5)]

    def load(n):
        begun[n].set()
        return n

    with closing(read_ahead(load, range(5), depth=2)) as ahead:
        for n in ahead:
            for following in begun[n : n + 3]:
                assert following.wait(10)
            # No more than the depth says.
            assert not any(event.is_set() for event in begun[n + 3 :])


def test_one_thread_that_is_not_the_caller_s():
    names = set(read_ahead(lambda n: threading.current_thread().name, range(4)))
    assert len(names) == 1 and names != {threading.current_thread().name}


def test_an_exception_comes_in_its_place():
    def load(n):
        return 1 // (2 - n)

    found, ahead = [], read_ahead(load, range(9), depth=3)
    with pytest.raises(ZeroDivisionError):
        for value in ahead:
            found.append(value)
    assert found == [0, 1] and list(ahead) == []


def test_stopping_early_begins_no_more():
    loaded = []
    with closing(read_ahead(lambda n: loaded.append(n), range(100))) as ahead:
        next(ahead)
    count = len(loaded)
    time.sleep(0.05)
    assert count <= 2 and len(loaded) == count


def test_an_exception_of_the_caller_s():
    with pytest.raises(KeyError), closing(read_ahead(str, range(100))) as ahead:
        for _ in ahead:
            raise KeyError


@pytest.mark.skipif(os.name != "posix", reason="signals are sent the POSIX way")
def test_ctrl_c_while_waiting():
    waiting = threading.Event()

    def load(n):
        if n == 1:
            waiting.set()
            time.sleep(0.3)
        return n

    def interrupt():
        waiting.wait(10)
        time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    other = threading.Thread(target=interrupt)
    other.start()
    found = []
    with pytest.raises(KeyboardInterrupt):
        found.extend(read_ahead(load, range(9)))
    other.join()
    assert found == [0]


def test_nothing_starts_before_it_is_asked_for():
    ahead = read_ahead(str, range(3))
    assert not threads()
    ahead.close()


def test_a_depth_of_none():
    with pytest.raises(ValueError, match="depth must be at least 1, got 0"):
        next(read_ahead(str, range(3), 0))
