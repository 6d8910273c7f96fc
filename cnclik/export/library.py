"""Load: exported C, built by the system's compiler and called from Python with NumPy arrays."""

import collections
import contextlib
import ctypes
import dataclasses
import functools
import json
import operator
import os
import tempfile
from typing import NamedTuple

import jax
import numpy as np

from cnclik import errors
from cnclik.engine.compiler import build, opened
from cnclik.export.batch import Batch
from cnclik.export.write import MANIFEST, c, digest, digest_of
from cnclik.integrate.loop import Step
from cnclik.integrate.trajectory import INSTANTS, Trajectory
from cnclik.law.law import Law
from cnclik.law.reference import Reference
from cnclik.reaching.result import ReachStatus
from cnclik.reading import read_bytes
from cnclik.robot.chain import Chain
from cnclik.robot.model import Pose


def load(folder: str | os.PathLike, **parameters) -> "Compiled":
    """Build what `export.c` wrote and return it, ready to be called.

    Args:
      folder: where it was written.
      parameters: values of its parameters that differ from the exported ones.

    Returns: `Compiled`, called with the fields of the C function's `input`, in that order or by name.
    Raises: ArgumentError where there is no compiler, or the folder holds no export.
    """
    folder = errors.path("folder", folder)
    made = Compiled(folder, _manifest(folder))
    made.set(**parameters)
    return made


def _manifest(folder) -> dict:
    """The manifest of a folder. Raises: ArgumentError if it or the source was changed."""
    text, found = read_bytes("folder", folder / MANIFEST, "a folder written by cnclik.export.c"), None
    with contextlib.suppress(ValueError, RecursionError):
        found = json.loads(text)
    if not isinstance(found, dict) or found.pop("digest", None) != digest_of(found):
        words = f"hold an {MANIFEST} as this version of cnclik.export.c wrote it (export again)"
        raise errors.fail("folder", words, f"{folder.name!r} has another")
    for file, wanted in found["files"].items():
        if file not in _TO_READ and digest(read_bytes("folder", folder / file, "a folder with its source")) != wanted:
            raise errors.fail("folder", "hold the source as it was written (export again)", f"{file} is another")
    return found


_TO_READ = ("README.md", "example.c")  # files of an export that are not compiled


def compiled(law: Law | Chain, reference: Reference | None = None, **options) -> "Compiled":
    """`c` and `load` in one: the step as a native function, in a temporary folder that exists as long as the function.

    Args: those of `c` except `out`.
    """
    temporary = tempfile.TemporaryDirectory(prefix="cnclik-export-")
    made = load(c(law, reference, out=temporary.name, **options))
    made.temporary = temporary
    return made


class Compiled:
    """A native function: `made = step(q, position, rotation, velocity, Ts)`, in a few microseconds.

    One object has one set of buffers: each thread needs its own.
    """

    temporary: tempfile.TemporaryDirectory | None = None  # its folder, see `compiled`

    def __init__(self, folder, manifest):
        self.manifest, self.folder = manifest, folder
        self.dtype = np.dtype(manifest["dtype"])
        name, what = manifest["name"], manifest["what"]
        self.library = build([folder / f"{name}.c"], folder)
        self.buffers = {group: _Buffer(fields, self.dtype) for group, fields in manifest["inputs"].items() if fields}
        self.buffers["output"] = _Buffer(manifest["outputs"], self.dtype)
        library = opened(self.library, lets_go=what == "solve")
        function = getattr(library, name)
        function.library = library  # stays open as long as it may be called
        function.restype = ctypes.c_int32 if what in ("step", "solve", "reach") else None
        addresses = [b.address for b in self.buffers.values()]
        of_loop = (ctypes.c_int32, ctypes.c_void_p) if what == "solve" else ()
        function.argtypes = (*[ctypes.c_void_p] * len(addresses), *of_loop)
        self._function = function
        self._call = {"step": _stepper, "solve": _solver}.get(what, _caller)(self, function, addresses)

    @property
    def __call__(self):
        """One call, `step(q, *given, **named)`; a property, as handing arguments on would take as long as the step.

        Args:
          q: (n,) joint values [rad, m].
          given, named: the other fields of the C function's `input`, in order or by name; omitted ones keep the
            value of the previous call, at first that of the export.
          N: steps, of "solve" alone.

        Returns: of a step `cnclik.Step`, of "solve" `cnclik.Trajectory`, of "reach" an `Answer`, of "fk" `cnclik.Pose`,
          of "jacobian" (6, n), of several tips dicts of them; with NumPy arrays in them.
        """
        return self._call

    def batch(self, q, *given, N: int, cores: int | None = None, **named) -> dict:
        """Many loops of N steps side by side, on all cores: what was exported with `batch`.

        Args:
          q: (lanes, n), or (n,) where something else has a leading axis of lanes.
          N: steps, of "solve" alone.
          given, named: the other fields of `input`, and parameters by name, each for all lanes or with a leading axis
            of lanes; omitted ones are as exported. A target moves with its velocity from time `t` on.
          cores: how many may work at once, by default all this process may use.

        Returns: {name: (lanes, ...)}: q, e and x at the end, qdot of the last step, the largest residual and
          contraction, the least singular value on the way, and all steps' status bits together.
        """
        return self._batch(self.parameters, q, *given, N=N, cores=cores, **named)

    @functools.cached_property
    def _batch(self) -> Batch:
        return Batch(self.folder, self.manifest, self.dtype)

    @property
    def _parameters(self) -> dict:
        return self.buffers["parameters"].views if "parameters" in self.buffers else {}

    @property
    def parameters(self) -> dict:
        """The parameters that may be set, and their values."""
        return {name: view.copy() for name, view in self._parameters.items()}

    def set(self, **values) -> None:
        """Set parameters: `step.set(alpha=20.0)`."""
        views = self._parameters
        for name, value in values.items():
            errors.one_of("parameter", name, list(views))
            views[name][...] = errors.array(name, value, views[name].shape)

    def __repr__(self):
        about = self.manifest
        inputs = ", ".join(row["name"] for row in about["inputs"]["input"])
        return f"Compiled {about['name']}({inputs}): {about['what']} by {about['method']}, {about['dtype']}"


class Answer(NamedTuple):
    """Joint values for one target, in the words of `cnclik.Reached`."""

    q: np.ndarray  # (n,) the answer; otherwise the nearest pose found; NaN if the target is
    status: ReachStatus  # SOLVED, OUT_OF_REACH, OUT_OF_BUDGET or NON_FINITE
    position_error: float  # [m]
    orientation_error: float  # [rad]
    evaluations: int  # number of evaluated postures


class _Buffer:
    """A C struct as NumPy arrays: its numbers together, and whole numbers if the struct has any."""

    def __init__(self, fields, dtype):
        layout = np.dtype(
            [(f["name"], np.int32 if f["kind"] == "int" else dtype, tuple(f["shape"])) for f in fields], align=True
        )
        self.record = np.zeros((), layout)
        self.views = {f["name"]: self.record[f["name"]] for f in fields}
        for f in fields:
            if f["value"] is not None:
                self.views[f["name"]][...] = f["value"]
        self.address = self.record.ctypes.data
        # The numbers at the start of the struct in one array, and the place of each field in it.
        self.places, at = {}, 0
        for f in fields:
            size = int(np.prod(f["shape"]))
            if f["kind"] != "int":
                self.places[f["name"]] = at, at + size, not f["shape"]
                at += size
        self.numbers = self.record.reshape(1).view(np.uint8)[: at * dtype.itemsize].view(dtype)


def _input(buffers):
    """Where q is written (its array and shape), and the function that writes the other arguments of a call."""
    buffer = buffers["input"]
    numbers, at = buffer.numbers, buffer.places
    # (array, place) of each field: the quickest way to write a number.
    slots = {name: (view, ...) if view.shape else (numbers, at[name][0]) for name, view in buffer.views.items()}
    q, *others = slots.values()
    intos, places = zip(*others, strict=True) if others else ((), ())
    exhaust = collections.deque(maxlen=0).extend  # a loop in C

    def write(given, named):
        if len(given) > len(intos):
            raise errors.fail("arguments", f"be at most {', '.join(slots)}", f"are {1 + len(given)}")
        exhaust(map(operator.setitem, intos, places, given))
        for name, value in named.items():
            errors.one_of("argument", name, list(slots))
            into, place = slots[name]
            into[place] = value

    return q[0], q[0].shape, write


def _joints(q, shape):
    if type(q) is np.ndarray and q.shape == shape and q.dtype.kind == "f":  # the common case, quick
        return q
    return errors.array("q", q, shape, finite=False)


class NativeStep(Step):
    """A `Step` that slices its arrays from the function's numbers when they are used."""

    def __getattr__(self, name):
        fields = self.__dict__
        if name not in fields.get("_places", ()):
            raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")
        start, end, single = fields["_places"][name]
        found = fields[name] = fields["_numbers"][start] if single else fields["_numbers"][start:end]
        return found


_NAMES = tuple(field.name for field in dataclasses.fields(Step))
jax.tree_util.register_pytree_node(
    NativeStep,
    lambda made: ([getattr(made, name) for name in _NAMES], None),
    lambda _, values: Step(**dict(zip(_NAMES, values, strict=True))),  # type: ignore[arg-type, return-value]
)


def _stepper(made, function, addresses):
    buffers = made.buffers
    into, shape, write = _input(buffers)
    numbers, places, array = buffers["output"].numbers, buffers["output"].places, np.ndarray
    new, copied = functools.partial(object.__new__, NativeStep), numbers.copy

    def step(q, *given, **named):
        into[...] = q if type(q) is array and q.shape == shape else _joints(q, shape)
        if given or named:
            write(given, named)
        status = function(*addresses)
        made = new()  # without __init__, whose checks take longer than the step
        fields = made.__dict__
        fields["_numbers"], fields["_places"], fields["status"] = copied(), places, status
        return made

    return step


def _solver(made, function, addresses):
    buffers = made.buffers
    into, shape, write = _input(buffers)
    output = buffers["output"].views
    names = ("q", "x", "e", "qdot", "residual", "contraction", "status")

    def solve(q, *given, N, **named):
        N = errors.integer("N", N, at_least=0)
        into[...] = _joints(q, shape)
        write(given, named)
        run = {name: np.empty((N + (name in INSTANTS), *output[name].shape), output[name].dtype) for name in names}
        columns = (ctypes.c_void_p * len(names))(*(run[name].ctypes.data for name in names))
        function(*addresses, N, columns)
        t0, Ts = (buffers["input"].views[name] for name in ("t", "Ts"))
        t = t0 + np.arange(N + 1).astype(made.dtype) * Ts
        evaluations, tasks = N * made.manifest["evaluations"], tuple(map(tuple, made.manifest["tasks"]))
        return Trajectory(t=t, **run, evaluations=np.asarray(evaluations), tasks=tasks)

    return solve


def _caller(made, function, addresses):
    (into, shape, write), views = _input(made.buffers), made.buffers["output"].views
    result = _RESULTS[made.manifest["what"]]

    def call(q, *given, **named):
        into[...] = _joints(q, shape)
        if given or named:
            write(given, named)
        return result(function(*addresses), views)

    return call


def _of_tips(views, make):
    """The result for one tip, or {name in C: result} for several tips."""
    each: dict = {}
    for name, view in views.items():
        tip, _, what = name.rpartition("_")
        each.setdefault(tip, {})[what] = view.copy()
    made = {tip: make(own) for tip, own in each.items()}
    return made.get("", made)


_RESULTS = {  # result of each function from its output
    "fk": lambda _, views: _of_tips(views, lambda made: Pose(**made)),
    "jacobian": lambda _, views: _of_tips(views, lambda made: made["jacobian"]),
    "reach": lambda status, views: Answer(
        **{name: view.copy()[()] for name, view in views.items()} | {"status": ReachStatus(status)}
    ),
}
