"""An exported function built by the system's compiler, and called with structs of NumPy."""

import ctypes
import os
import subprocess
import tempfile
from types import SimpleNamespace

import numpy as np

import cnclik as ck
from cnclik.engine.compiler import command, opened
from cnclik.export.source import Names, header, source
from cnclik.export.trace import Request, trace
from cnclik.integrate.method import DEFAULT, named
from cnclik.integrate.stage import picard

FLAGS = "-std=c99 -O3 -march=native -ffp-contract=fast -fno-math-errno -fno-trapping-math -fPIC -shared"


def arm(n):
    """A planar arm with position and velocity limits."""
    made = ck.planar_arm([1.0, 0.8, 0.6, 0.5, 0.4][:n])
    return ck.replace(made, lower=(-2.0,) * n, upper=(2.0,) * n, velocity_limit=(1.5,) * n)


def built(source):
    """The loaded library of a C file, with CFLAGS."""
    words = [*command(), *FLAGS.split(), *os.environ.get("CFLAGS", "").split()]
    subprocess.run([*words, "-o", f"{source}.so", str(source), "-lm"], check=True)
    return opened(f"{source}.so")


def native(of, reference=None, *, method=DEFAULT, stage=None, dtype="float64"):
    """A step of a law, or a chain's kinematics, as `ck.export.c` writes it, ready to be called."""
    names = Names("step", dtype)
    program = trace(Request(of, reference, named(method), stage or picard(5), names.dtype))
    texts = {".h": header(program, names, []), ".c": source(program, names)}
    with tempfile.TemporaryDirectory() as folder:
        for ending, text in texts.items():
            with open(f"{folder}/{names.name}{ending}", "w", encoding="utf-8") as file:
                file.write(text)
        library = built(f"{folder}/{names.name}.c")
    made = Native(program, library, getattr(library, names.name), names.dtype)
    made.header = texts[".h"]
    return made


class Native:
    """A function: `made = step(q, position, rotation, velocity, Ts)`; what is left out stays."""

    def __init__(self, program, library, function, dtype):
        def struct(fields):
            kinds = [(f.name, dtype if f.kind == "real" else np.int32, f.shape) for f in fields]
            record = np.zeros((), np.dtype(kinds, align=True))
            for f in fields:
                record[f.name] = 0 if f.value is None else f.value
            return record

        groups = {group: struct(fields) for group, fields in program.inputs.items() if fields}
        self.input, self.output = groups["input"], struct(program.outputs["output"])
        self.parameters = groups.get("parameters")
        self.names = self.input.dtype.names
        records = [*groups.values(), self.output]
        self.library, self.function = library, function  # the library stays open as long as it may be called
        function.restype, function.argtypes = None, [ctypes.c_void_p] * len(records)
        self.addresses = [record.ctypes.data for record in records]

    def __call__(self, *given, **named):
        for name, value in (dict(zip(self.names, given, strict=False)) | named).items():
            self.input[name] = value
        self.function(*self.addresses)
        return SimpleNamespace(**{name: self.output[name].copy() for name in self.output.dtype.names})
