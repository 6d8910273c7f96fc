"""`cnclik sweep SPEC.toml`: a study of many loops, from one file: a labelled dataset and its figures."""

import pathlib
from typing import Literal

from cnclik import errors
from cnclik.cli import progress
from cnclik.cli.common import prepare
from cnclik.writing import check_free, output_folder


def run(
    spec: str,
    *,
    set: tuple[str, ...] = (),
    out: str | None = None,
    check: bool = False,
    figures: bool = True,
    format: Literal["png", "pdf", "svg"] = "png",
    distributed: str | None = None,
    overwrite: bool = False,
) -> None:
    """Check the spec, compute the missing blocks, draw.

    Args:
      spec: the spec of the study, a TOML file; examples are in sweeps/, the format is explained in docs/sweeps.md.
      set: NAME=VALUE replaces a value of the spec, as in --set alpha=5 --set axes.M=[1,5]. It may be repeated.
      out: folder for data.zarr, figures and summary; default: sweep-NAME, with the name in the spec.
      check: only check the spec, and print what it would run.
      figures: draw the figures at the end.
      format: file format of the figures.
      distributed: share the work with other processes: HOST:PORT:PROCESSES:PROCESS of process 0, of how many, and of
        this one (from 0); or auto, where SLURM or MPI knows them.
    """
    if distributed is not None:
        _join(distributed)
    prepare()
    import jax

    from cnclik.sweeps import spec as specs
    from cnclik.sweeps import store, summary

    study = specs.read(spec, set)
    if figures:
        from cnclik.show import output, sweeps

        sweeps.check(study)
    folder = pathlib.Path(out or f"sweep-{study.name}")
    grid = study.grid()
    programs = f"{(count := len(grid.programs)):,} program{'s' * (count > 1)}"
    print(f"{study.question}\n" * bool(study.question), end="")
    print(f"{study.name}: {grid.size:,} loops, {grid}, in {programs}", flush=True)
    if check:
        return
    check_free("out", folder, summary.FILES, overwrite=overwrite)
    with progress.bar("loops", quiet=jax.process_index() != 0) as report:
        done = store.run(study, folder, progress=report)
    if not done:
        print(f"This process is done; {len(store.Store(folder).missing())} blocks are with others or for a rerun.")
        return
    data = store.read(folder)
    with output_folder(folder, overwrite=overwrite) as whole:
        summary.write(data, whole)
    print(*(f"Wrote {folder / file}" for file in (store.DATA, *summary.FILES)), *summary.best(data), sep="\n")
    if figures:  # last, as the same command draws them again
        about, each = {"Description": data.attrs.get("spec", "")}, sweeps.drawings(data, study.figures)
        made = {f"{name}.{format}": (make, {"Title": name} | about) for name, make in each.items()}
        again = f"cnclik sweep {spec} --out {folder}"
        for file in output.draw(made, folder, again=again, overwrite=overwrite):
            print(f"Wrote {folder / file}")


def _join(place) -> None:
    """Join the other processes."""
    import jax

    try:
        host, count, number = (None, None, None) if place == "auto" else place.rsplit(":", 2)
        jax.distributed.initialize(host, count and int(count), number and int(number))
    except (ValueError, TypeError, RuntimeError) as error:
        found = f"is {place!r}: {str(error).strip().splitlines()[0]}"
        raise errors.fail("distributed", "be auto or HOST:PORT:PROCESSES:PROCESS", found) from None
