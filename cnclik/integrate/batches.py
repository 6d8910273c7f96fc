"""Batches of NumPy's arrays of which the first arguments are the same for all lanes: as C, or by XLA in tiles."""

import jax
import numpy as np

from cnclik.cache import bounded_jit
from cnclik.engine.native import native
from cnclik.engine.plan import as_here, chosen
from cnclik.engine.program import Bound, Program
from cnclik.integrate.lanes import TILE, tiled
from cnclik.threads import cores, side_by_side

ALONE = 1024  # lanes, at most, that one thread runs
CAPACITY = 1024  # lanes of a call of XLA's program, which serves batches of all sizes


class Batches:
    """A function of one lane with one result, compiled in float64 for batches."""

    def __init__(self, fn, avals, *, single=False):
        """Args: avals: of all arguments of a lane. single: for one lane only."""
        self.avals, self.most = avals, 1 if single else CAPACITY
        as_c = native(fn)
        with jax.enable_x64(True):
            function, _ = as_c.of(*[np.zeros(a.shape, a.dtype) for a in avals])
            self.program = chosen(function, avals, batch=not single)

        def run(kept, lanes, count):
            return tiled(lambda *own: as_c(*kept, *own), min(TILE, self.most), *lanes, count=count)

        self.run = bounded_jit(run)

    def bound(self, *kept):
        """Return the function call(leaves, size) of batches, on all cores. Args: kept: the first arguments, of all.

        Its leaves are the other arguments, (size, ...), or (...) for what all lanes share.
        """
        call = self._bound(*kept)

        def threaded(leaves, size):
            if size <= ALONE or cores() == 1:
                return call(leaves, size, None)
            with side_by_side() as pool:
                return call(leaves, size, pool)

        return threaded

    def _bound(self, *kept):
        if isinstance(self.program, Program):
            call = Bound(self.program, kept)
            return lambda leaves, size, pool: call(leaves, size, pool, cores())[0]
        avals = self.avals[len(kept) :]
        with jax.enable_x64(True):
            kept = jax.device_put(kept)

        def in_tiles(leaves, size, pool):
            leaves = [np.broadcast_to(x, (size, *a.shape)).astype(a.dtype) for x, a in zip(leaves, avals, strict=True)]

            def part(first):
                some = [x[first : first + self.most] for x in leaves]
                count = len(some[0])
                some = [np.resize(x, (self.most, *x.shape[1:])) for x in some]
                return np.asarray(self.run(kept, some, np.int32(count)))[:count]

            with jax.enable_x64(True):
                every = range(0, size, self.most)
                return np.concatenate(list(map(part, every) if pool is None else pool.map(as_here(part), every)))

        return in_tiles
