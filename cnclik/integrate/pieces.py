"""Pieces: a long run in pieces of equal length, so that one program serves runs of any number of steps."""

import numpy as np

from cnclik.integrate.solve import solve
from cnclik.integrate.trajectory import INSTANTS, join, steps_of, truncate
from cnclik.record import replace

PIECE = 2000  # steps of a piece, at most


def piece_of(method, N: int) -> int:
    """Steps per piece of a run of N; N for a multistep method, which would lose its memory."""
    return N if method.steps > 1 else min(N, PIECE)


def in_pieces(law, reference, q0, Ts, N: int, method, stage, *, size, t0=0.0):
    """Yield runs of `size` steps each, which together are `solve`'s N steps and the rest of the last piece.

    Args: as for `solve`, with concrete values; the method makes single steps, or `size` is at least N.
    """
    part, q = None, q0
    for begun in range(0, N, size):
        if part is None or np.isfinite(q).all():
            part = solve(law, reference, q, Ts, size, method, stage, t0=t0 + begun * Ts)
        else:  # lost for good
            last = {name: np.asarray(getattr(part, name)) for name in (*INSTANTS[1:], *steps_of(part))}
            last = {name: np.broadcast_to(value[-1:], value.shape) for name, value in last.items()}
            part = replace(part, t=np.asarray(part.t) + size * Ts, **last)
        yield part
        q = part.q[-1]


def joined(parts, N: int):
    """Their first N steps as one `Trajectory`, of NumPy arrays."""
    return truncate(join(parts), N)
