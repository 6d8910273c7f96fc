"""`cnclik sweep SPEC.toml`: a study of many loops, from one file: a labelled dataset and its figures."""

import dataclasses
import pathlib
import time
from typing import Literal

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.arguments import option
from cnclik.cli.common import ComputeOptions
from cnclik.cli.plot import draw
from cnclik.quantities import in_samples
from cnclik.writing import check_free, output_folder


@dataclasses.dataclass(kw_only=True)
class Args(ComputeOptions):
    spec: pathlib.Path = option(positional=True)
    """The spec of the study, a TOML file; examples are in sweeps/, the format is explained in docs/sweeps.md."""
    set: list[str] = option(list)
    """NAME=VALUE replaces a value of the spec, as in --set alpha=5 --set axes.M=[1,5]. May be repeated."""
    out: pathlib.Path | None = None
    """Folder for data.zarr, figures and summary; default: sweep-NAME, with the name in the spec."""
    fresh: bool = False
    """Start again, even if the folder holds results."""
    check: bool = False
    """Only check the spec and estimate size, memory and time from a first block that is run."""
    export: Literal["nc", "csv"] | None = None
    """Also write data.nc or data.csv."""
    figures: bool = True
    """Draw the figures at the end."""
    distributed: bool = False
    """Share the work with other processes (jax.distributed). Settings are those of SLURM, MPI or the next options."""
    coordinator: str | None = None
    """With --distributed: HOST:PORT of process 0."""
    processes: int | None = None
    """With --distributed: number of processes."""
    process: int | None = None
    """With --distributed: number of this process, from 0."""


def run(args: Args) -> None:
    """Check the spec, compute the missing blocks, draw."""
    place = _join(args)
    from cnclik.sweeps import files, store, summary

    spec = files.read(args.spec, args.set)
    out = args.out or pathlib.Path(f"sweep-{spec.name}")
    if args.check:
        _check(spec)
        return
    grid = spec.grid()
    print(f"{spec.question}\n{spec.name}: {grid.size:,} loops, {grid}; dead time {_dead_time(spec)}", flush=True)
    begun = time.perf_counter()
    if not args.overwrite:
        check_free("out", out, [*summary.FILES, *([f"data.{args.export}"] if args.export else [])])
    own = dict(fresh=args.fresh, overwrite=args.overwrite)
    with progress.bar("loops", quiet=place["process"] != 0) as report:
        whole = store.run(spec, out, progress=report, **own, **place)
    if not whole:
        print(f"This process is done; {store.blocks_missing(out)} blocks are with others or for a rerun.")
        return
    print(f"Done in {time.perf_counter() - begun:.1f} s: {out / store.DATA}")
    finish(out, spec.figures if args.figures else None, export=args.export, overwrite=args.overwrite)


def finish(out: pathlib.Path, figures, *, export=None, overwrite=False) -> None:
    """Write summary, exports and figures of a finished store; the figures last, as they can be drawn again.

    Args:
      figures: [[figure]] tables, () for the default ones, None for no figures.
      export: "nc", "csv" or None.
      overwrite: also over files that cnclik did not write.
    """
    from cnclik.sweeps import store, summary

    data = store.read(out)
    with output_folder(out, overwrite=overwrite) as folder:
        summary.write(data, folder)
        if export:
            folder.write(f"data.{export}", lambda path: summary.export(data, path.parent, export))
    for line in (*(f"Wrote {out / file}" for file in folder.made), *summary.best(data)):
        print(line)
    if figures is not None:
        draw(data, out, tables=figures, overwrite=overwrite)


def _join(args) -> dict:
    """Join the other processes, if any."""
    given = (args.coordinator, args.processes, args.process)
    if not args.distributed:
        if any(v is not None for v in given):
            raise errors.fail("distributed", "be set where coordinator, processes or process are", "is not")
        return {"process": 0, "processes": 1, "meet": None}
    import jax

    try:
        jax.distributed.initialize(*given)
    except (ValueError, RuntimeError) as error:
        first = str(error).strip().splitlines()[0]
        raise errors.fail("distributed", "find coordinator, processes and process", f"does not: {first}") from None
    place = {"process": jax.process_index(), "processes": jax.process_count()}

    def meet(well, last):
        import numpy as np
        from jax.experimental import multihost_utils

        well = bool(np.all(multihost_utils.process_allgather(np.array(well))))
        if last or not well:
            # No process waits for another from here on: one that fails or ends must not stop the others.
            jax.distributed.shutdown()
        return well

    return place | {"meet": meet}


def _check(spec) -> None:
    """Grid size, programs, memory and time."""
    from cnclik.sweeps.sweep import estimate

    found = estimate(spec)
    axes = " × ".join(f"{name} {count}" for name, count in found.axes.items())
    mebibytes = 2.0**-20
    rows = {
        "question": spec.question,
        "expectation": spec.expectation,
        "grid": f"{axes} = {found.loops:,} loops",
        "dead time": _dead_time(spec),
        "programs": f"{found.programs} (about {found.compile_time:.1f} s each to compile)",
        "blocks": f"{found.blocks} of {found.block:,} loops",
        "memory": f"{found.memory * mebibytes:,.0f} MiB, {found.block_memory * mebibytes:,.0f} of them for blocks",
        "on disk": f"{found.disk * mebibytes:,.1f} MiB before compression",
        "time": f"{_clock(found.time)} ({_clock(found.run_time)} without compiling), cores used: {found.cores}",
    }
    width = max(map(len, rows))
    for name, text in rows.items():
        print(f"{name:<{width}}  {text}")


def _dead_time(spec) -> str:
    """The shortest and the longest dead time of the loops at the ends of all axes, such as "2 samples (8 ms)"."""
    ends = [(program, last) for program in spec.grid().programs for last in (False, True)]
    loops = [spec.values(**program, **spec.first(last)) for program, last in ends]
    late = sorted((float(v["delay"]) * float(v["Ts"]), float(v["delay"]), float(v["Ts"])) for v in loops)
    return " to ".join(dict.fromkeys(in_samples(delay, Ts) for _, delay, Ts in (late[0], late[-1])))


def _clock(seconds) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
