"""Write: the exported files, all at once, in a folder."""

import hashlib
import json
import os
import pathlib
import re
from collections.abc import Sequence

import numpy as np

from cnclik import errors
from cnclik.engine.graph import UnsupportedError
from cnclik.export.cost import operations
from cnclik.export.example import example, readme
from cnclik.export.lanes_source import batch_header, batch_source
from cnclik.export.reach_source import SEEDS, most_operations, reach_source, trace_reach
from cnclik.export.solve_source import solve_header, solve_source
from cnclik.export.source import Names, header, source
from cnclik.export.trace import RESULTS, WHAT, Request, trace, trace_growth, trace_loop
from cnclik.integrate.method import DEFAULT, MethodLike, evaluations_per_step, named
from cnclik.integrate.stage import Stage, picard
from cnclik.law.inverse import damped
from cnclik.law.law import Law, check_loop
from cnclik.law.reference import Reference
from cnclik.record import brief
from cnclik.robot.chain import Chain
from cnclik.task.build import pose
from cnclik.version import __version__
from cnclik.writing import output_folder

MANIFEST = "export.json"


def c(
    law: Law | Chain,
    reference: Reference | None = None,
    *,
    out: str | os.PathLike,
    what: str = "step",
    method: MethodLike = DEFAULT,
    stage: Stage | None = None,
    dtype: str = "float64",
    name: str = "clik_step",
    runtime: Sequence[str] | None = None,
    batch: bool | Sequence[str] = False,
    seeds: int | None = None,
    overwrite: bool = False,
) -> pathlib.Path:
    """Write a step of the loop as C99 into a folder: `NAME.h`, `NAME.c`, `example.c` with test vectors, a README.

    Arrays in the law's records (the gain, damping, an array of link lengths) become fields of `parameters` at run time;
    Python literals (a robot's geometry) are compiled in. `runtime` selects among the former.

    Args:
      law: the right-hand side; for "fk" and "jacobian" a `Chain` is enough.
      reference: the path, a function of time; None: position, rotation and velocity of the target are arguments.
      out: the folder; it is created if necessary.
      what: "step", "solve" (N steps in one call), "reach" (joint values for one target), "fk" or "jacobian".
      method, stage: as for `solve`.
      dtype: "float64" (double) or "float32" (float).
      name: name of the function and of the files; `clik_` is prepended unless the name begins with it.
      runtime: names of the parameters that can be set at run time; the others are compiled in. None: all.
      batch: also write `NAME_batch.c`, which runs many loops at once with vector instructions: True, or the names of
        the wanted results, such as ("q", "e"); others are not computed.
      seeds: number of start postures in the source of "reach", used after the given joint values; default: 64.
      overwrite: also write into a folder that holds files other than those of an earlier export.

    Returns: the folder's path.
    Raises: ArgumentError for arguments that do not fit, and for an operation without a C form, named in one line.
    """
    request, name = checked(law, reference, what, method, stage, dtype, name, runtime, batch)
    out = errors.path("out", out)
    names, lines = Names(name, request.dtype, what), configuration(request)
    name = names.name
    declared, loop = "", None
    if what != "reach" and seeds is not None:
        raise errors.fail("seeds", f"be left out for {what!r}", f"is {seeds!r}")
    reaching = _read(trace_reach, request, SEEDS if seeds is None else seeds) if what == "reach" else None
    program = reaching.call if reaching else _read(trace, request)
    if what == "solve":
        declared = solve_header(program, names)
        loop = solve_source(program, _read(trace_growth, request), names, request.law.chain.n, request.law.task.m)
    counted = _read(most_operations, reaching) if reaching else _read(operations, program)
    files = {
        f"{name}.h": header(program, names, lines, declared),
        f"{name}.c": source(program, names, loop, reach_source(reaching, names) if reaching else None),
        "example.c": example(request, program, names),
    }
    looped = _read(trace_loop, request, RESULTS if batch is True else _wanted(batch)) if batch else None
    if looped:
        files[f"{name}_batch.h"] = batch_header(looped, names)
        files[f"{name}_batch.c"] = batch_source(looped, names)
    files["README.md"] = readme(program, names, lines, [*files, MANIFEST, "README.md"], counted)
    about = {"files": {file: digest(text.encode()) for file, text in files.items()}}
    about |= manifest(request, program, names, looped)
    files[MANIFEST] = json.dumps({"digest": digest_of(about)} | about, indent=1) + "\n"
    with output_folder(out, overwrite=overwrite) as folder:
        for file, text in files.items():
            folder.write_text(file, text)
    return out


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def digest_of(about: dict) -> str:
    return digest(json.dumps(about, sort_keys=True).encode())


def _read(read, *args):
    """A program. Raises: ArgumentError, one line that names the operation without a C form."""
    try:
        return read(*args)
    except UnsupportedError as error:
        raise errors.fail("law", "be made of what has a C form", f"{error}") from None


def checked(law, reference, what, method, stage, dtype, name, runtime, batch=False):
    """The request and the name of an export. Raises: ArgumentError."""
    errors.one_of("what", what, WHAT)
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,59}", name):
        raise errors.fail("name", "be a C identifier of at most 60 letters such as clik_step", f"is {name!r}")
    dtype = errors.one_of("dtype", str(np.dtype(dtype)) if not isinstance(dtype, str) else dtype, _DTYPES)
    if batch and what not in ("step", "solve"):
        raise errors.fail("batch", f"be left out for {what!r}", f"is {batch!r}")
    if isinstance(law, Chain) and what in ("fk", "jacobian", "reach"):
        law = Law(law, pose(), alpha=1.0, inverse=damped(1.0))
    errors.kind("law", law, Law)
    if reference is not None:
        check_loop(law, reference)
    if what == "reach" and runtime is not None:
        raise errors.fail("runtime", "be left out for 'reach'", f"is {runtime!r}")
    runtime = None if runtime is None else tuple(runtime)
    stage = picard(5) if stage is None else stage
    return Request(law, reference, named(method), stage, np.dtype(_DTYPES[dtype]), what, runtime), name


_DTYPES = {"float64": "float64", "float32": "float32", "double": "float64", "float": "float32"}


def configuration(request: Request) -> list:
    law, lines = request.law, []
    lines.append(f"{request.what} for {brief(law.chain)}, in {request.dtype}")
    if request.what in ("fk", "jacobian"):
        return lines
    lines.append(repr(law.task).replace("Task", "task", 1))
    if request.what == "reach":
        return lines
    stage = f" by {request.stage}" if request.method.implicit else ""
    lines.append(f"method: {request.method}{stage} ({request.method.source})")
    lines.append(f"inverse: {brief(law.inverse)}")
    lines.append(f"limits: {brief(law.limits)}; null space: {brief(law.null_velocity)}")
    target = "an argument: position, rotation, velocity" if request.reference is None else brief(request.reference)
    lines.append(f"target: {target}")
    return [line.replace("−", "-").replace("…", "...").encode("ascii", "replace").decode() for line in lines]


def _wanted(names) -> tuple:
    if not isinstance(names, (tuple, list)):
        raise errors.fail("batch", "be True or names of results such as q and e", f"is {names!r}")
    for name in names:
        errors.one_of("batch", name, RESULTS)
    return tuple(names)


def manifest(request, program, names, looped=None) -> dict:
    """All that a program that calls the functions needs to know."""

    def row(f):
        value = None if f.value is None else np.asarray(f.value).tolist()
        return {"name": f.name, "shape": list(f.shape), "kind": f.kind, "value": value}

    loop = request.what in ("step", "solve")
    evaluations = int(evaluations_per_step(request.method, request.stage, request.law.chain.n)) if loop else 0
    return {
        "cnclik": __version__,
        "name": names.name,
        "what": request.what,
        "dtype": str(request.dtype),
        "method": str(request.method),
        "inputs": {group: [row(f) for f in fields] for group, fields in program.inputs.items()},
        "outputs": [row(f) for f in program.outputs["output"]],
        "evaluations": evaluations,
        "tasks": [[name, at.start, at.stop] for name, at in request.law.task.each],
        "batch": looped
        and {
            "inputs": [row(f) for group, fields in looped.inputs.items() for f in fields if group != "steps"],
            "outputs": [row(f) for f in looped.outputs["output"]],
        },
    }
