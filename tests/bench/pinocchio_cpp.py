"""C++ peers compiled against the headers in the wheels `pin` and `cmeel-eigen`, and called through ctypes."""

import ctypes
import hashlib
import pathlib
import subprocess

import numpy as np

HERE = pathlib.Path(__file__).parent
SOURCE = HERE / "pinocchio_clik.cpp"
BUILD = HERE.parents[1] / "build" / "bench"
FLAGS = [
    *("-O3", "-march=native", "-std=c++17", "-DNDEBUG", "-shared", "-fPIC"),
    *("-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS"),
]


def compiled(source=SOURCE) -> pathlib.Path:
    """The shared library; compiled (about a minute and a half) unless this source was compiled before."""
    import pinocchio

    prefix = next(p for p in pathlib.Path(pinocchio.__file__).parents if p.name == "cmeel.prefix")
    command = ["g++", *FLAGS, *(f"-isystem{prefix / 'include' / at}" for at in ("", "eigen3"))]
    key = hashlib.sha256(source.read_bytes() + " ".join([*command, pinocchio.__version__]).encode()).hexdigest()[:16]
    library = BUILD / f"{source.stem}-{key}.so"
    if not library.exists():
        BUILD.mkdir(parents=True, exist_ok=True)
        part = library.with_suffix(".part")
        done = subprocess.run([*command, str(source), "-o", str(part)], capture_output=True, text=True)
        if done.returncode != 0:  # else only warnings, a great many, about the headers
            raise SystemExit(done.stderr)
        part.rename(library)
    return library


class PinocchioCpp:
    """The Panda's loop in C++: `run(...)` has the arguments and results of the other peers' runs."""

    def __init__(self, origins, tip, dtype):
        """origins (7, 4, 4): each joint's fixed offset, which then turns about its z; tip (4, 4)."""
        library = ctypes.CDLL(str(compiled()))
        name = f"clik_{np.dtype(dtype).name}"
        self._scalar, real, pointer = np.dtype(dtype), ctypes.c_double, ctypes.c_void_p
        new, self._delete, self._run = (getattr(library, f"{name}_{verb}") for verb in ("new", "delete", "run"))
        new.restype, new.argtypes = pointer, [pointer, pointer]
        self._delete.restype, self._delete.argtypes = None, [pointer]
        self._run.restype = None
        self._run.argtypes = [pointer, real, real, real, ctypes.c_int, ctypes.c_int, ctypes.c_int64, *[pointer] * 5]
        origins, tip = (np.ascontiguousarray(a, np.float64) for a in (origins, tip))
        self._solver = new(origins.ctypes.data, tip.ctypes.data)

    def __del__(self):
        if getattr(self, "_solver", None):
            self._delete(self._solver)

    def run(self, q0, position, rotation, *, alpha, damping, Ts, N, M):
        """(q, ‖e‖) at the end of N steps; M None is explicit Euler, else the paper's CN with M passes."""
        q0, position, rotation = (np.ascontiguousarray(a, self._scalar) for a in (q0, position, rotation))
        batch = len(q0)
        q, e = np.empty_like(q0), np.empty(batch, self._scalar)
        passes = -1 if M is None else M
        arrays = (a.ctypes.data for a in (q0, position, rotation, q, e))
        self._run(self._solver, alpha, damping, Ts, N, passes, batch, *arrays)
        return q, e
