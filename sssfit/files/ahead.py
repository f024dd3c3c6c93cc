"""Reading ahead: the next items are loaded by a thread while the caller works on this one."""

from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")
Loaded = TypeVar("Loaded")


def read_ahead(
    load: Callable[[Item], Loaded], items: Iterable[Item], depth: int = 1
) -> Generator[Loaded, None, None]:
    """What a function makes of each item, made in one thread before it is asked for.

    The thread starts with the first item that is asked for. It ends with the last one, after an exception,
    or when the caller stops early and closes the generator, as `contextlib.closing` does: no more is begun
    then, and what is being loaded is waited for.

    Args:
        load: is called with one item after the other, in their order.
        items: are taken from where they come in the caller's thread, up to `depth` early.
        depth: how many items are loaded beyond the one that the caller has, at least 1.

    Yields:
        The results, in the items' order.

    Raises:
        ValueError: the depth is below 1.
        Exception: whatever `load` raises, in the place of its item's result, after all results before it.

    Example:
        >>> list(read_ahead(len, ["a", "bcd"]))
        [1, 3]
    """
    if depth < 1:
        raise ValueError(f"depth must be at least 1, got {depth}")
    left = iter(items)
    begun: deque[Future[Loaded]] = deque()
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sssfit-ahead")
    try:
        begun.extend(pool.submit(load, item) for item in islice(left, depth))
        while begun:
            begun.extend(pool.submit(load, item) for item in islice(left, 1))
            yield begun.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
