"""Write: the exported files, all at once, in a folder."""

import os
import pathlib
import re

from cnclik import errors
from cnclik.engine.graph import UnsupportedError
from cnclik.export.example import example, readme
from cnclik.export.source import Names, header, source
from cnclik.export.trace import Request, trace
from cnclik.integrate.method import DEFAULT, MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import Law, check_loop
from cnclik.law.paths import Reference
from cnclik.record import brief
from cnclik.robot.chain import Chain
from cnclik.writing import output_folder

_DTYPES = {"float64": "float64", "float32": "float32", "double": "float64", "float": "float32"}


def c(
    law: Law | Chain,
    reference: Reference | None = None,
    *,
    out: str | os.PathLike,
    method: MethodLike = DEFAULT,
    stage: Stage | None = None,
    dtype: str = "float64",
    name: str | None = None,
    overwrite: bool = False,
) -> pathlib.Path:
    """Write a step of the loop as C99 into a folder: `NAME.h`, `NAME.c`, `example.c` with test vectors, a README.

    Arrays in the law's records (the gain, damping, an array of link lengths) become fields of `parameters` at run time;
    Python literals (a robot's geometry) are compiled in.

    Args:
      law: the right-hand side. A `Chain` instead is exported as its kinematics: pose and Jacobian of each tip.
      reference: the path, a function of time; None: position, rotation and velocity of the target are arguments.
      out: the folder; it is created if necessary.
      method, stage: as for `solve`.
      dtype: "float64" (double) or "float32" (float).
      name: name of the function and of the files; `clik_` is prepended unless the name begins with it. Default:
        clik_step, or clik_kinematics.
      overwrite: also write into a folder that holds files other than those of an earlier export.

    Returns: the folder's path.
    Raises: ArgumentError for arguments that do not fit, and for an operation without a C form, named in one line.
    """
    if not isinstance(law, Chain):
        errors.kind("law", law, Law)
        if reference is not None:
            check_loop(law, reference)
    elif reference is not None:
        raise errors.fail("reference", "be left out for a robot, whose kinematics have no target", "is given")
    if stage is not None and (isinstance(stage, type) or not hasattr(stage, "tolerance")):
        raise errors.fail("stage", "be a stage such as picard(5)", f"is {stage!r}")
    name = ("kinematics" if isinstance(law, Chain) else "step") if name is None else name
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,59}", name):
        raise errors.fail("name", "be a C identifier of at most 60 letters such as clik_step", f"is {name!r}")
    dtype = errors.one_of("dtype", dtype, _DTYPES)
    names, out = Names(name, _DTYPES[dtype]), errors.path("out", out)
    request = Request(law, reference, named(method), picard(5) if stage is None else stage, names.dtype)
    try:
        program = trace(request)
        text = source(program, names)
    except UnsupportedError as error:
        raise errors.fail("law", "be made of what has a C form", f"{error}") from None
    lines = configuration(request)
    files = {
        f"{names.name}.h": header(program, names, lines),
        f"{names.name}.c": text,
        "example.c": example(request, program, names),
        "README.md": readme(program, names, lines),
    }
    with output_folder(out, overwrite=overwrite) as folder:
        for file, text in files.items():
            folder.write_text(file, text)
    return out


def configuration(request: Request) -> list:
    """Return the configuration in words, line by line."""
    if isinstance(request.of, Chain):
        return [f"kinematics of {brief(request.of)}, in {request.dtype}"]
    law = request.of
    stage = f" by {request.stage}" if request.method.implicit else ""
    target = "an argument: position, rotation, velocity" if request.reference is None else brief(request.reference)
    lines = [
        f"step for {brief(law.chain)}, in {request.dtype}",
        repr(law.task).replace("Task", "task", 1),
        f"method: {request.method}{stage} ({request.method.source})",
        f"inverse: {brief(law.inverse)}",
        f"limits: {brief(law.limits)}; null space: {brief(law.null_velocity)}",
        f"target: {target}",
    ]
    ascii_of = str.maketrans({"−": "-", "…": "...", "²": "^2", "³": "^3", "⁴": "^4"})
    return [line.translate(ascii_of).encode("ascii", "replace").decode() for line in lines]
