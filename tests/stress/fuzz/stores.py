"""Damaged stores: a small finished sweep with files flipped, cut, emptied, gone, swapped, or not a sweep's at all.

A reader refuses it or gives the very numbers; a run that goes on ends with the very bytes, or refuses it.
"""

import functools
import pathlib
import shutil
import tempfile
from unittest import mock

import numpy as np
import xarray

from cnclik.errors import ArgumentError
from cnclik.sweeps import program, spec, store
from tests.specs import reaching
from tests.stress.fuzz.nasty import any_of, chance, damaged

TEXT = reaching(["final_error", "ok", "max_error"], N=3, more="lanes = 4", method='["EE", "HEUN"]',
                alpha="[1.0, 2.0, 5.0]", q0="{ samples = 2 }").replace('q0 = [0, "-pi/2"]\n', "")  # fmt: skip
DAMAGES = ("flip", "flip", "flip", "cut", "empty", "gone", "swap", "noise", "folder", "longer", "link")


@functools.cache
def _place():
    """A folder that is there until the process ends."""
    return tempfile.TemporaryDirectory(prefix="cnclik-fuzz-", ignore_cleanup_errors=True)


@functools.cache
def whole():
    """(the spec, the folder of its finished run, its data, its first program's outputs)."""
    folder = pathlib.Path(_place().name)
    (folder / "a.toml").write_text(TEXT, encoding="utf-8")
    read, folder = spec.read(folder / "a.toml"), folder / "whole"
    assert store.run(read, folder)
    _, first = program.fit(read.study, read.grid())
    return read, folder, store.read(folder).load(), first


def parts(folder):
    return sorted(p.relative_to(folder).as_posix() for p in (folder / store.DATA).rglob("*") if p.is_file())


def draw(rng):
    """[(file's place among all, what happens to it, another's place, seed of the noise)]."""
    count = 1 if chance(rng, 0.6) else int(rng.integers(2, 6))
    return [(rng.random(), any_of(rng, DAMAGES), rng.random(), int(rng.integers(1 << 30))) for _ in range(count)]


def _damage(folder, place, kind, other, seed):
    names = parts(folder)
    one = folder / names[int(place * len(names))]
    two = folder / names[int(other * len(names))]
    data, rng = one.read_bytes(), np.random.default_rng(seed)
    match kind:
        case "flip" if data:
            k = int(rng.integers(len(data)))
            one.write_bytes(data[:k] + bytes([data[k] ^ (1 << int(rng.integers(8)))]) + data[k + 1 :])
        case "cut":
            one.write_bytes(data[: int(rng.integers(len(data) + 1))])
        case "empty":
            one.write_bytes(b"")
        case "gone":
            one.unlink()
        case "swap":
            one.write_bytes(two.read_bytes())
            two.write_bytes(data)
        case "noise":
            one.write_bytes(damaged(rng, data))
        case "folder":
            one.unlink()
            one.mkdir()
        case "longer":
            one.write_bytes(data + rng.bytes(20))
        case "link":
            one.unlink()
            one.symlink_to("/dev/null" if seed % 2 else folder / "nowhere")


def attempt(made, folder) -> None:
    """What a reader gets, and what a run that goes on makes of it."""
    read, origin, data, first = whole()
    shutil.copytree(origin / store.DATA, folder / store.DATA)
    for one in made:
        _damage(folder, *one)
    refused = []
    with _expected(refused):
        _vouched_for(folder, data)
    with _expected(refused):
        assert 0 <= store.blocks_missing(folder) <= 8
    with _expected(refused), _without_computing(data, first):
        assert store.run(read, folder)
        _same(store.read(folder).load(), data)
        assert store.blocks_missing(folder) == 0
    if refused:
        raise max(refused, key=lambda error: len(str(error)))


class _expected:  # noqa: N801
    """Context manager that keeps what was refused."""

    def __init__(self, refused):
        self.refused = refused

    def __enter__(self):
        return self

    def __exit__(self, kind, error, _):
        if refused := isinstance(error, ArgumentError):
            self.refused.append(error)
        return refused


def _without_computing(data, first):
    """Blocks are taken from the undisturbed run; all else of a run is as it is."""

    def run_blocks(study, of, blocks, first=None):
        for block in blocks:
            yield block, {o.name: data[o.name].values[block.region] for o in outputs}

    outputs = first.outputs
    return mock.patch.multiple(program, run_blocks=run_blocks, fit=lambda study, of: (of, first))


def _vouched_for(folder, wanted):
    """Of every block that is done a reader gets the very numbers."""
    found = store.read(folder).load()
    for block in store.Store(folder, name="folder", mode="r").missing():
        for name in wanted.data_vars:
            found[name].values[block.region] = wanted[name].values[block.region]
    _same(found, wanted)


def _same(found, wanted):
    xarray.testing.assert_identical(found.assign_attrs(commit=""), wanted.assign_attrs(commit=""))
    for name in wanted.variables:
        if wanted[name].dtype.kind != "O":
            assert found[name].values.tobytes() == wanted[name].values.tobytes(), name
