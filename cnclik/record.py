"""Records: the one kind of data in cnclik.

A record is a frozen, keyword-only dataclass that JAX sees as a pytree. One rule decides what is compiled
in and what is a parameter: **a number written as a Python float or int is literal, an array is a leaf**.
Literals (also strings, None and functions) belong to the tree's structure: they reach the compiled
program as constants, and geometry that is zero costs nothing. Arrays are differentiated, vmapped, swept.

Annotations give their shapes in jaxtyping's notation, `Float[Array, "m n"]`, for readers and type checkers.

JAX loads when a record first meets it: methods, drives and gains are records that need NumPy alone.
"""

import dataclasses
import functools
import importlib
import operator
import sys
from typing import TYPE_CHECKING, Any, TypeVar, dataclass_transform
from typing import Annotated as Bool
from typing import Annotated as Float
from typing import Annotated as Int

import numpy as np
from numpy.typing import ArrayLike as ArrayLike  # JAX's has no lists of numbers

from cnclik import errors

if TYPE_CHECKING:
    import jax
    from jax import Array as Array
else:
    Array = Any

    class _Lazy:
        """JAX, imported at its first use here."""

        def __getattr__(self, name):
            globals()["jax"] = importlib.import_module("jax")
            return getattr(jax, name)

    jax = _Lazy()

__all__ = ["Array", "ArrayLike", "Bool", "Float", "Int"]  # what is passed on
AnyArray = Array | np.ndarray  # JAX's or NumPy's
Number = float | np.floating | np.integer | Float[AnyArray, ""]  # compiled in as a float, a parameter as an array
T = TypeVar("T")


def is_literal(value) -> bool:
    """True for what is compiled in: exactly a Python number, a string, None, or a plain function."""
    written = type(value) in (float, int, bool, type(None)) or isinstance(value, str)
    return written or (callable(value) and not dataclasses.is_dataclass(value))


_is_none = functools.partial(operator.is_, None)  # without a frame of its own
HOLE = object()  # marks, among the literals, the place of an array


def partition(tree):
    """Split any tree into its arrays (a list) and its literals (hashable)."""
    leaves, treedef = jax.tree.flatten(tree, is_leaf=_is_none)
    values = tuple([v if is_literal(v) else HOLE for v in leaves])
    return [v for v, literal in zip(leaves, values, strict=True) if literal is HOLE], (treedef, values)


def combine(arrays, literals):
    """Inverse of `partition`."""
    arrays, (treedef, values) = iter(arrays), literals
    return jax.tree.unflatten(treedef, [next(arrays) if v is HOLE else v for v in values])


_waiting: list = []  # registrations of classes that were made before JAX was loaded


def with_jax(register) -> None:
    """Call register(jax) now, or, if JAX is not loaded, when a room of the package that needs it is."""
    _waiting.append(register)
    if "jax" in sys.modules:
        register_waiting()


def register_waiting() -> None:
    """Register the classes that were made before JAX was loaded."""
    while _waiting:
        _waiting.pop()(importlib.import_module("jax"))


@dataclass_transform(kw_only_default=True, frozen_default=True)
def record(cls: Any = None, *, kw_only: bool = True) -> Any:
    """Class decorator: frozen keyword-only dataclass, registered as a pytree by the rule above; equal by content."""
    if cls is None:
        return lambda cls: record(cls, kw_only=kw_only)
    checked = getattr(cls, "__post_init__", lambda self: None)

    def frozen(self):
        checked(self)
        if _waiting and "jax" in sys.modules:
            register_waiting()
        for name, value in self.__dict__.items():
            if type(value) is np.ndarray and value.flags.writeable:
                object.__setattr__(self, name, _own(value))  # the caller may write to theirs

    cls.__post_init__ = frozen
    if cls.__repr__ is object.__repr__:
        cls.__repr__ = _in_short
    cls = dataclasses.dataclass(frozen=True, kw_only=kw_only, eq=False, repr=False)(cls)
    names, init = tuple(f.name for f in dataclasses.fields(cls)), cls.__init__

    @functools.wraps(init)
    def helpful(self, *args, **given):
        if unknown := next((name for name in given if name not in names), None):
            near = errors.nearest(unknown, names) or f" (it has {', '.join(names)})"
            raise errors.ArgumentError(f"{cls.__name__} has no argument `{unknown}`{near}.")
        init(self, *args, **given)

    def flatten(self):
        # A record never changes, so it is taken apart once for each precision; repeated jit calls find the answer here.
        key = "_flat" if jax.config.jax_enable_x64 else "_flat32"
        found = self.__dict__.get(key)
        if found is None:
            found = partition(tuple(map(self.__dict__.__getitem__, names)))
            if key == "_flat32":  # arrays of its own: JAX remembers by identity what it made of a constant, as float32
                found = [_own(v) if type(v) is np.ndarray else v for v in found[0]], found[1]
            object.__setattr__(self, key, found)
        return found

    def unflatten(literals, arrays):
        self = object.__new__(cls)  # no __init__: leaves may be tracers, None, or any object
        self.__dict__.update(zip(names, combine(arrays, literals), strict=True))
        return self

    def set_state(self, state):
        self.__dict__.update({n: _own(v) if type(v) is np.ndarray else v for n, v in state.items()})

    cls.__init__, cls.__getstate__, cls.__setstate__ = helpful, fields_of, set_state  # type: ignore[assignment]
    cls.__eq__, cls.__hash__ = _equal, _hashed  # type: ignore[assignment]
    with_jax(lambda jax: jax.tree_util.register_pytree_node(cls, flatten, unflatten))
    return cls


def _equal(self, other):
    """Whether two records of one kind have the same literals, and arrays of the same values, shapes and dtypes."""
    if type(self) is not type(other):
        return NotImplemented
    if self is other:
        return True
    (own, treedef), (others, other_treedef) = jax.tree.flatten(self), jax.tree.flatten(other)
    return treedef == other_treedef and all(map(_same, own, others))


def _same(a, b) -> bool:
    if a is b or not (errors.concrete(a) and errors.concrete(b)):
        return a is b
    a, b = np.asarray(a), np.asarray(b)
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")


def _hashed(self):
    """Of the literals and the arrays' shapes: the arrays may be on another device."""
    leaves, treedef = jax.tree.flatten(self)
    return memoized(self, "_hash", lambda _: hash((treedef, *map(np.shape, leaves))))


def _own(array):
    """A copy that nobody writes to."""
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def in_words(value) -> str:
    """A number, vector or matrix as text, on one line; of floats five significant digits."""
    shown: Any = {"float_kind": lambda v: f"{v:.5g}"}
    return np.array2string(np.asarray(value), separator=", ", max_line_width=10**6, formatter=shown).replace("\n", "")


def brief(value) -> str:
    """A value in a few words: small arrays by their numbers, large ones and traced ones by dtype and shape."""
    if hasattr(value, "dtype"):
        known = errors.concrete(value) and not isinstance(value, jax.ShapeDtypeStruct)
        if known and value.size <= 9 and value.dtype.kind in "biuf":
            return in_words(value)
        return f"{value.dtype}[{', '.join(map(str, value.shape))}]"
    if isinstance(value, (tuple, list)):
        shown = [brief(v) for v in value[:3]] + ([f"… {len(value)} in all"] if len(value) > 3 else [])
        return f"({', '.join(shown)})"
    return getattr(value, "__name__", None) or repr(value)


def _in_short(self) -> str:
    given = ", ".join(f"{f.name}={brief(getattr(self, f.name))}" for f in dataclasses.fields(self) if f.repr)
    return f"{type(self).__name__.strip('_')}({given})"


def xp_for(*values):
    """NumPy, which compiles nothing, where all arrays of these trees are known; else JAX's."""
    return np if "jax" not in sys.modules or all(map(errors.concrete, jax.tree.leaves(values))) else jax.numpy


def leaf(value):
    """A parameter: a Python number becomes a float64 array, so that another value needs no new compilation."""
    return np.asarray(value, float) if type(value) in (int, float) else value


def replace(rec: T, **changes: Any) -> T:
    """Return a copy of the record with some fields changed: `replace(law, alpha=2.0)`."""
    return dataclasses.replace(rec, **changes)  # type: ignore[type-var]


def cast(tree, dtype):
    """The tree with every floating leaf in one dtype, so that a loop's types can't drift."""

    def one(leaf):
        leaf = jax.numpy.asarray(leaf)
        return leaf.astype(dtype) if jax.numpy.issubdtype(leaf.dtype, np.floating) else leaf

    return jax.tree.map(one, tree)


def fields_of(rec) -> dict:
    """The fields of a record by name, without what is remembered beside them, which `vars` has too."""
    return {f.name: getattr(rec, f.name) for f in dataclasses.fields(rec)}


def memoized(rec, name, make):
    """make(rec), made once for a record of numbers: a record never changes."""
    made = rec.__dict__.get(name)
    if made is None:
        made = make(rec)
        if not any(isinstance(v, jax.core.Tracer) for v in jax.tree.leaves(rec)):
            object.__setattr__(rec, name, made)
    return made


def _is_record(value) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def _remade(rec, value):
    """A record whose fields are value(name), without its checks, which are for what the user gives."""
    made = object.__new__(type(rec))
    for f in dataclasses.fields(rec):
        object.__setattr__(made, f.name, value(f.name))
    return made


def mapped(tree, kind, fn):
    """The tree of records and tuples with fn(r) in the place of every record r of a kind."""
    if isinstance(tree, kind):
        return fn(tree)
    if type(tree) is tuple:
        return tuple(mapped(v, kind, fn) for v in tree)
    return _remade(tree, lambda name: mapped(getattr(tree, name), kind, fn)) if _is_record(tree) else tree


def stack(records):
    """Records of one build as one whose arrays have a leading lane axis, for `jax.vmap` and `lanes`.

    Literals in which all records agree stay literal; numbers in which they differ become arrays, so that
    robots of one shape share a compiled program.
    """
    records = list(records)
    first = records[0]
    if _is_record(first):
        return _remade(first, lambda name: stack([getattr(r, name) for r in records]))
    if isinstance(first, tuple):
        return tuple(stack(items) for items in zip(*records, strict=True))
    if is_literal(first) and all(type(r) is type(first) and r == first for r in records):
        return first
    traced = any(isinstance(r, jax.core.Tracer) for r in records)
    return jax.numpy.stack(records) if traced else np.stack(records)  # NumPy compiles nothing
