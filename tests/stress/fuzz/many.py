"""Many inputs, in processes of their own; what a process dies of is a failure too."""

import concurrent.futures
import faulthandler
import multiprocessing
import os
import pathlib
import resource
import signal
import tempfile

AT_ONCE = 50  # inputs that a process takes at a time
MOST_ADDRESSES = 16 << 30  # bytes of address space of a process: what asks for more gets a MemoryError


def begin():
    """This process is one for inputs: float64, on the processor, with few addresses; the one that began it ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ.setdefault("MPLBACKEND", "agg")
    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, resource.getrlimit(resource.RLIMIT_AS)[1]))
    import jax

    jax.config.update("jax_enable_x64", True)


def batch(name, numbers, seed):
    """The verdicts of some inputs of a room."""
    from tests.stress.fuzz import judge, rooms

    made = []
    for number in numbers:
        with tempfile.TemporaryDirectory(prefix="cnclik-fuzz-", ignore_cleanup_errors=True) as folder:
            faulthandler.dump_traceback_later(3 * judge.MOST_WAIT, exit=True)  # for what no signal gets through to
            made.append(judge.judge(rooms.ROOMS[name], number, pathlib.Path(folder), seed))
            faulthandler.cancel_dump_traceback_later()
    return made


def verdicts(counts: dict, seed: int, processes: int):
    """Lists of verdicts of so many inputs of each room, as they come; all rooms side by side."""
    work = [
        (name, range(first, min(first + AT_ONCE, count)), seed)
        for name, count in counts.items()
        for first in range(0, count, AT_ONCE)
    ]
    work.sort(key=lambda one: one[1].start / counts[one[0]])
    context = multiprocessing.get_context("spawn")
    pool = concurrent.futures.ProcessPoolExecutor(processes, context, begin)
    try:
        waiting = {pool.submit(batch, *one): one for one in work}
        for done in concurrent.futures.as_completed(waiting):
            yield done.result()
    except concurrent.futures.process.BrokenProcessPool:
        raise SystemExit(f"A process died of one of the inputs {waiting[done]}, or of those beside them.") from None
    finally:
        for process in multiprocessing.active_children():  # of an interrupt: at work, and deaf to it
            process.kill()
        pool.shutdown(cancel_futures=True)
