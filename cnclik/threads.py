"""Threads: how many work side by side, an end that waits for none of them, and LAPACK among them."""

import contextlib
import os
from concurrent.futures import ThreadPoolExecutor

_LAPACK_NAMES = "cholesky eig eigh geqp3 geqrf hessenberg householder_product lu qr schur svd triangular_solve"
_LAPACK = frozenset(_LAPACK_NAMES.split())


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


def shares_threads(jaxpr) -> bool:
    """Whether a traced program calls LAPACK, which hands a batch out to XLA's threads and waits for them on one.

    Where as many such calls run side by side as there are threads, each waits for the others, for ever (jaxlib 0.10).
    """
    return any(equation.primitive.name in _LAPACK for equation in equations(jaxpr))


def equations(jaxpr):
    """Yield all equations of a traced program, those inside its calls and loops too."""
    for equation in jaxpr.eqns:
        yield equation
        for value in equation.params.values():
            for inner in value if isinstance(value, (tuple, list)) else (value,):
                inner = getattr(inner, "jaxpr", inner)
                if hasattr(inner, "eqns"):
                    yield from equations(inner)
