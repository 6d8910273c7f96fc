"""`cnclik sweep SPEC.toml`: a study of many loops, from one file: a labelled dataset and its figures."""

import dataclasses
import pathlib
import time

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
    """Only check the spec, and print what it would run."""
    figures: bool = True
    """Draw the figures at the end."""
    distributed: str | None = None
    """Share the work with other processes: HOST:PORT:PROCESSES:PROCESS of process 0, of how many, and of this one (from
    0); or auto, where SLURM or MPI knows them."""


def run(args: Args) -> None:
    """Check the spec, compute the missing blocks, draw."""
    place = {"process": 0, "processes": 1, "meet": None} if args.distributed is None else _join(args.distributed)
    from cnclik.sweeps import spec as specs
    from cnclik.sweeps import store, summary

    spec = specs.read(args.spec, args.set)
    if args.figures:
        from cnclik.show import sweeps

        sweeps.check(spec)
    out = args.out or pathlib.Path(f"sweep-{spec.name}")
    grid = spec.grid()
    question = f"{spec.question}\n" * bool(spec.question)
    programs = f"{(count := len(grid.programs)):,} program{'s' * (count > 1)}"
    size = f"{grid.size:,} loops, {grid}, in {programs}"
    print(f"{question}{spec.name}: {size}; dead time {_dead_time(spec)}", flush=True)
    if args.check:
        return
    begun = time.perf_counter()
    check_free("out", out, summary.FILES, overwrite=args.overwrite)
    with progress.bar("loops", quiet=place["process"] != 0) as report:
        whole = store.run(spec, out, progress=report, fresh=args.fresh, **place)
    if not whole:
        print(f"This process is done; {store.blocks_missing(out)} blocks are with others or for a rerun.")
        return
    print(f"Done in {time.perf_counter() - begun:.1f} s: {out / store.DATA}")
    data = store.read(out)
    with output_folder(out, overwrite=args.overwrite) as folder:
        summary.write(data, folder)
    for line in (*(f"Wrote {out / file}" for file in folder.made), *summary.best(data)):
        print(line)
    if args.figures:  # last, as they can be drawn again
        draw(data, out, tables=spec.figures, overwrite=args.overwrite)


def _join(place) -> dict:
    """Join the other processes."""
    import jax

    try:
        if place == "auto":
            jax.distributed.initialize()
        else:
            host, count, number = place.rsplit(":", 2)
            jax.distributed.initialize(host, int(count), int(number))
    except (ValueError, TypeError, RuntimeError) as error:
        found = f"is {place!r}: {str(error).strip().splitlines()[0]}"
        raise errors.fail("distributed", "be auto or HOST:PORT:PROCESSES:PROCESS", found) from None

    def meet(well, last):
        import numpy as np
        from jax.experimental import multihost_utils

        well = bool(np.all(multihost_utils.process_allgather(np.array(well))))
        if last or not well:
            # No process waits for another from here on: one that fails or ends must not stop the others.
            jax.distributed.shutdown()
        return well

    return {"process": jax.process_index(), "processes": jax.process_count(), "meet": meet}


def _dead_time(spec) -> str:
    """Return the shortest and the longest dead time of the loops at the ends of all axes: "2 samples (8 ms)"."""
    loops = (spec.loop(program | spec.first(last)) for program in spec.grid().programs for last in (False, True))
    late = sorted((float(v["delay"]) * float(v["Ts"]), float(v["delay"]), float(v["Ts"])) for v in loops)
    return " to ".join(dict.fromkeys(in_samples(delay, Ts) for _, delay, Ts in (late[0], late[-1])))
