"""Threads: how many work side by side, and an end that waits for none of them."""

import contextlib
import os
from concurrent.futures import ThreadPoolExecutor


def cores() -> int:
    """Cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


@contextlib.contextmanager
def side_by_side(count: int | None = None):
    """Context manager: a pool of `count` threads, by default one per core.

    Left by an exception, such as Ctrl-C, it begins nothing more and waits for nothing: a compiler can't be interrupted.
    """
    pool = ThreadPoolExecutor(cores() if count is None else count)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()
