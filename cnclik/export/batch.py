"""Batch: exported loops for many lanes, called with NumPy arrays on all cores."""

import ctypes

import numpy as np

from cnclik import errors
from cnclik.engine.compiler import build, opened
from cnclik.threads import cores as available
from cnclik.threads import side_by_side

PART = 2048  # lanes per call of a core


class _Column(ctypes.Structure):
    _fields_ = (("data", ctypes.c_void_p), ("stride", ctypes.c_int64))


class Batch:
    """The native function for many lanes, built at the first call."""

    def __init__(self, folder, manifest, dtype):
        name = f"{manifest['name']}_batch"
        if not manifest.get("batch"):
            raise errors.fail("batch", "be asked for when exporting, c(..., batch=True)", "is not in this folder")
        self.inputs, self.outputs, self.dtype = manifest["batch"]["inputs"], manifest["batch"]["outputs"], dtype
        library = build([folder / f"{name}.c"], folder, flags=["-O2"])  # as quick as -O3, and built in half the time
        self.library = opened(library)
        self.function = getattr(self.library, name)
        self.function.restype = None
        self.function.argtypes = (ctypes.c_int64, ctypes.c_int64, ctypes.c_int32, *[ctypes.c_void_p] * 3)

    def __call__(self, parameters, *given, N, cores=None, **named) -> dict:
        N = errors.integer("N", N, at_least=0)
        cores = available() if cores is None else errors.integer("cores", cores, at_least=1)
        columns, lanes = self._columns(self._values(parameters, given, named))
        found = {
            row["name"]: np.empty((lanes, *row["shape"]), np.int32 if row["kind"] == "int" else self.dtype)
            for row in self.outputs
        }
        numbers = [v for name, v in found.items() if name != "status"]
        into = (ctypes.c_void_p * max(len(numbers), 1))(*(v.ctypes.data for v in numbers))
        status = found["status"].ctypes.data if "status" in found else None

        def part(start):
            self.function(start, min(start + size, lanes), N, columns, into, status)

        size = lanes if cores == 1 else min(PART, -(-lanes // (16 * cores)) * 16)
        starts = range(0, lanes, size)
        if len(starts) == 1:
            part(0)
        else:
            with side_by_side(cores) as pool:
                list(pool.map(part, starts))
        return found

    def _values(self, parameters, given, named) -> dict:
        own = [row["name"] for row in self.inputs if row["name"] not in parameters]
        if len(given) > len(own):
            raise errors.fail("arguments", f"be at most {', '.join(own)}", f"are {len(given)}")
        known = {row["name"]: row["value"] for row in self.inputs} | parameters
        known |= dict(zip(own, given, strict=False))
        for name, value in named.items():
            known[errors.one_of("argument", name, [row["name"] for row in self.inputs])] = value
        for name, value in known.items():
            if value is None:
                raise errors.fail(name, "be given", "is not")
        return known

    def _columns(self, known):
        """The inputs of the C function, and the number of lanes."""
        columns, lanes, alive = (_Column * len(self.inputs))(), set(), []
        for column, row in zip(columns, self.inputs, strict=True):
            name, shape = row["name"], tuple(row["shape"])
            value = errors.array(name, known[name], shape, (None, *shape), finite=False)
            value = np.asarray(value, self.dtype, order="C")
            own = value.ndim > len(shape)
            lanes |= {len(value)} if own else set()
            column.data, column.stride = value.ctypes.data, int(np.prod(shape)) if own else 0
            alive.append(value)
        if len(lanes) != 1:
            found = ", ".join(map(str, sorted(lanes))) or "none"
            raise errors.fail("arguments", "have one leading axis of lanes of the same size", f"have {found}")
        columns.alive = alive  # keeps the memory alive as long as the pointers
        (count,) = lanes
        if not count:
            raise errors.fail("arguments", "hold at least one lane", "hold 0")
        return columns, count
