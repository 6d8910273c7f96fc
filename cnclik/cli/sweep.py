"""`cnclik sweep SPEC.toml`: a study of many loops, from one file to a labelled dataset and its figures."""

import dataclasses
import math
import pathlib
import time
from typing import Annotated, Literal

import tyro

from cnclik import errors
from cnclik.cli import progress


@dataclasses.dataclass(kw_only=True)
class Args:
    spec: Annotated[pathlib.Path, tyro.conf.Positional]
    """The spec, a TOML file (see docs/sweeps.md and sweeps/)."""
    set: Annotated[list[str], tyro.conf.UseAppendAction] = dataclasses.field(default_factory=list)
    """NAME=VALUE in place of what the spec says; may be repeated. --set alpha=5, --set axes.M=[1,5]."""
    out: pathlib.Path | None = None
    """Folder for data.zarr, figures and summary; results/NAME of the spec by default."""
    fresh: bool = False
    """Start over, even where the folder holds results."""
    check: bool = False
    """Only validate, and estimate size, memory and time from a measured first block."""
    export: Literal["nc", "csv"] | None = None
    """Also write data.nc or data.csv."""
    figures: bool = True
    """Draw the figures when done."""
    distributed: bool = False
    """One of several processes that share the work (jax.distributed): settings from SLURM, MPI or those below."""
    coordinator: str | None = None
    """HOST:PORT of process 0."""
    processes: int | None = None
    """How many processes there are."""
    process: int | None = None
    """The number of this one, from 0."""


def run(args: Args) -> None:
    """Validate, compute what is missing, draw."""
    place = _join(args)
    from cnclik.sweeps import spec as specs

    spec = specs.read(args.spec, args.set)
    out = args.out or pathlib.Path("results") / spec.name
    if args.check:
        _check(spec)
        return
    from cnclik.sweeps import store

    grid = spec.grid()
    print(f"{spec.name}: {grid.size:,} loops, {' × '.join(f'{a.name} {len(a)}' for a in grid.axes)}", flush=True)
    begun = time.perf_counter()
    with progress.bar("loops", quiet=place["process"] != 0) as report:
        whole = store.run(spec, out, fresh=args.fresh, progress=report, **place)
    if not whole:
        print(f"This process is done; {store.blocks_missing(out)} blocks are with others or for a rerun.")
        return
    print(f"Done in {time.perf_counter() - begun:.1f} s: {out / store.DATA}")
    finish(out, figures=args.figures, export=args.export)


def finish(out: pathlib.Path, *, figures=True, export=None) -> None:
    """What follows from a finished store: summary, figures, exports."""
    from cnclik.show.output import output_folder
    from cnclik.sweeps import store, summary

    data = store.read(out)
    with output_folder(out) as folder:
        made = summary.write(data, folder)
        if figures:
            from cnclik.show import sweeps

            made += sweeps.draw(data, folder)
        if export:
            made.append(summary.export(data, folder, export))
    for path in made:
        print(f"Wrote {out / path.name}")


def _join(args) -> dict:
    """Join the other processes, if any."""
    given = (args.coordinator, args.processes, args.process)
    if not args.distributed:
        if any(v is not None for v in given):
            raise errors.fail("distributed", "be set where coordinator, processes or process are", "is not")
        return {"process": 0, "processes": 1, "barrier": None}
    import jax

    try:
        jax.distributed.initialize(*given)
    except (ValueError, RuntimeError) as error:
        first = str(error).strip().splitlines()[0]
        raise errors.fail("distributed", "find coordinator, processes and process", f"does not: {first}") from None
    place = {"process": jax.process_index(), "processes": jax.process_count()}

    def barrier(last):
        from jax.experimental import multihost_utils

        multihost_utils.sync_global_devices(f"cnclik {last}")
        if last:
            # From here on nobody needs the others: one that dies or is done must not take them along.
            jax.distributed.shutdown()

    return place | {"barrier": barrier}


def _check(spec) -> None:
    """Grid size, programs, memory and time, the last two from running one block."""
    import jax
    import numpy as np

    from cnclik.sweeps import sweep

    grid = spec.grid()
    begun = time.perf_counter()
    grid, program = sweep.fit(spec.study, grid)
    compile_s = time.perf_counter() - begun
    blocks = grid.blocks()
    values = grid.lane_values(blocks[0])
    jax.block_until_ready(program.run(values))
    begun = time.perf_counter()
    jax.block_until_ready(program.run(values))
    block_s = time.perf_counter() - begun
    # Other programs cost as many times more as they take more evaluations of f.
    costs = np.array([spec.evaluations(p) for p in grid.programs])
    cores = sweep.available_cores()
    run_s = block_s * len(blocks) / len(costs) * float(np.sum(costs / costs[0])) / cores
    block_memory = program.memory * cores  # each core has a block of its own
    size = grid.size * sum(o.dtype.itemsize * math.prod(o.shape) for o in program.outputs)
    programs = len(grid.programs)
    rows = {
        "question": spec.question,
        "expectation": spec.expectation,
        "grid": " × ".join(f"{a.name} {len(a)}" for a in grid.axes) + f" = {grid.size:,} loops",
        "programs": f"{programs} (about {compile_s:.1f} s each to compile)",
        "blocks": f"{len(blocks)} of {math.prod(grid.block):,} loops",
        "memory": f"{(block_memory + 2**28) / 2**20:,.0f} MiB, {block_memory / 2**20:,.0f} of them for blocks",
        "on disk": f"{size / 2**20:,.1f} MiB before compression",
        "time": f"{_clock(compile_s * programs + run_s)} ({_clock(run_s)} without compiling), cores used: {cores}",
    }
    width = max(map(len, rows))
    for name, text in rows.items():
        print(f"{name:<{width}}  {text}")


def _clock(seconds) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
