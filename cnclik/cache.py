"""Bounded caches: a process meets new numbers of steps, literals and lambdas all day, and each is a new program."""

import collections
import contextlib
import functools
import itertools
import weakref

import jax

# Programs that a cache keeps. Of `LRU` the least recently used one goes, of `bounded_jit` all of one function.
KEPT_PROGRAMS = 128
MOST_PROGRAMS = 64  # of all `bounded_jit` together, at some 6 MiB and 200 mappings of memory each
KEPT_TRACES = 16  # programs, for which JAX keeps what it traced on the way to them, some 8 MiB each


class LRU(collections.OrderedDict):
    """A dict of at most KEPT_PROGRAMS entries: what was asked for longest ago makes room."""

    def get(self, key, default=None):
        """The value of a key, which thereby becomes the newest."""
        try:
            self.move_to_end(key)
            return self[key]
        except KeyError:  # there is none, or another thread has let it go
            return default

    def made(self, key, make):
        """The value of a key; where there is none, make(key)."""
        value = self.get(key)
        if value is None:
            value = self[key] = make(key)
        return value

    def __setitem__(self, key, value):
        super().__setitem__(key, value)
        while len(self) > KEPT_PROGRAMS:
            self.popitem(last=False)

    def within(self, size):
        """Let go until all values, by size(value), have at most KEPT_PROGRAMS together; the newest stays."""
        while len(self) > 1 and sum(map(size, list(self.values()))) > KEPT_PROGRAMS:  # a list: threads come and go
            self.popitem(last=False)


def bounded_jit(fn=None, **options):
    """`jax.jit` that forgets its programs when there are too many, see `_bound`. Decorator, with jit's arguments.

    Numbers of steps, literals and lambdas are parts of a program: a process meets new ones all day.
    """
    if fn is None:
        return functools.partial(bounded_jit, **options)
    mine = _Programs()

    @functools.wraps(fn)
    def counted(*args, **kwargs):
        mine.made += 1  # those within a gradient or a batch too, of which jit's own count knows nothing
        _traced.append(None)
        return fn(*args, **kwargs)

    jitted = jax.jit(counted, **options)
    _bounded[jitted] = mine

    @functools.wraps(fn)
    def call(*args, **kwargs):
        before, mine.used = mine.made, next(_uses)
        result = jitted(*args, **kwargs)
        if mine.made != before:
            _bound(jitted)
        return result

    call._cache_size = jitted._cache_size
    return call


class _Programs:
    """How many programs a `bounded_jit` has, and when it was last used: the number of a call among all."""

    made = used = 0


_bounded = weakref.WeakKeyDictionary()  # {a function: its _Programs}
_uses = itertools.count(1)


def _bound(jitted):
    """Forget what is too much: all programs of the function used longest ago, `jitted` last; and JAX's traces."""
    every = {one: _bounded[one] for ref in _bounded.keyrefs() if (one := ref()) is not None}
    for one, its in sorted(every.items(), key=lambda item: item[1].used):
        if its.made and sum(programs.made for programs in every.values()) > MOST_PROGRAMS:
            one.clear_cache()
            its.made = 0
    if len(_traced) > KEPT_TRACES:
        _forget_traces()


_traced = []  # once for each program of all functions, since what JAX keeps of them was last forgotten


def _forget_traces():
    """Drop what JAX keeps of tracing, up to 2,048 pieces of each of many kinds. What is compiled stays, and runs.

    Not in the midst of tracing; and where this version of JAX has no way to do it, they stay until there are as many.
    """
    try:
        from jax._src import core, util

        if not core.trace_state_clean():
            return  # the next call tries again
        util.clear_all_caches()
    except (ImportError, AttributeError):
        pass
    _traced.clear()
    give_back()


def give_back():
    """Hand memory that is free back to the system: C's library on Linux keeps it, in pieces that nothing else fits."""
    import ctypes
    import gc

    gc.collect()
    with contextlib.suppress(OSError, TypeError, AttributeError):  # another system, another library
        ctypes.CDLL(None).malloc_trim(0)
