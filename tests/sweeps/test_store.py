"""Stores: what is done survives faults and full disks, to the last bit; `tests.stress faults` kills sweeps."""

import dataclasses
import errno
import json
import os
import shutil
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest
import xarray
import zarr

from cnclik.errors import ArgumentError
from cnclik.sweeps import run_spec, store
from cnclik.sweeps.spec import read
from tests.specs import reaching

TEXT = reaching(
    metrics=["final_error", "ok", "max_error"],
    more="lanes = 7",
    method=["EE", "HEUN"],
    alpha="{ linspace = [1, 20, 12] }",
    Ts="{ linspace = [0.01, 0.1, 7] }",
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """The spec as a file."""
    file = tmp_path_factory.mktemp("spec") / "survive.toml"
    file.write_text(TEXT)
    return file


@pytest.fixture(scope="module")
def undisturbed(path, tmp_path_factory):
    """The folder of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    assert store.run(read(path), folder)
    return folder


def assert_same(folder, other):
    """Bit for bit: values, types, labels, attributes."""
    a, b = (store.read(f).load() for f in (folder, other))
    xarray.testing.assert_identical(a, b)
    for name in a.variables:
        if a[name].dtype.kind != "O":
            assert a[name].values.tobytes() == b[name].values.tobytes(), name


def test_a_store_is_the_sweep_in_memory(path, undisturbed):
    with jax.enable_x64(False):  # the default in Python makes no difference
        wanted = run_spec(path)
    found = store.read(undisturbed).load()
    assert list(found.dims) == ["method", "alpha", "Ts"]
    assert json.loads(found.config) == json.loads(wanted.config)
    wanted["method"] = wanted["method"].astype(object)
    xarray.testing.assert_identical(found.assign_attrs(config=""), wanted.assign_attrs(config=""))
    for name in ("final_error", "ok", "max_error"):
        assert found[name].attrs["units"] in ("m", "1") and found[name].attrs["long_name"]
    with xarray.open_zarr(undisturbed / "data.zarr", chunks=None) as plain:
        assert plain.question == "Does it end well?" and plain.alpha.units == "1/s"
    assert list(found.method.values) == ["EE", "HEUN"]
    assert found.limit.dims == ("method",) and (found.limit == 2.0).all()


@pytest.fixture
def copy(undisturbed, tmp_path):
    """A copy of the whole store, to be damaged."""
    shutil.copytree(undisturbed, tmp_path / "copy")
    return tmp_path / "copy"


def test_damaged_blocks_are_found_and_done_again(path, undisturbed, copy):
    chunks = sorted(p for p in (copy / "data.zarr/final_error/c").rglob("*") if p.is_file())
    chunks[0].write_bytes(b"")  # as a power cut leaves it
    chunks[1].write_bytes(chunks[1].read_bytes()[:-9] + bytes(9))
    chunks[2].unlink()
    packed = bytearray(chunks[3].read_bytes())
    packed[6] ^= 128  # of the size that the chunk has when it is unpacked
    chunks[3].write_bytes(packed)
    assert len(store.Store(copy).missing()) == 4
    with pytest.raises((RuntimeError, ValueError)):
        store.read(copy).final_error.load()  # a reader gets no damaged block
    seen = []
    assert store.run(read(path), copy, progress=lambda done, total: seen.append(done))
    assert len(seen) == 1 + 4
    assert_same(copy, undisturbed)


def test_damaged_coordinates_are_refused(path, copy):
    chunk = copy / "data.zarr/alpha/c/0"
    for damaged in (chunk.read_bytes()[:-9] + bytes(9), None):
        chunk.unlink() if damaged is None else chunk.write_bytes(damaged)
        with pytest.raises(ArgumentError, match="hold whole coordinates"):
            store.run(read(path), copy)


def test_a_changed_spec_is_refused(path, undisturbed, copy):
    with pytest.raises(ArgumentError, match=r"must hold results of this very spec .* but differs in fixed: "):
        store.run(read(path, ["target=[0, 1]"]), copy)
    turned = read(path)  # the same table, whose axes have another order: blocks would go to other places
    turned = dataclasses.replace(turned, written=dict(reversed(turned.written.items())))
    with pytest.raises(ArgumentError, match="differs in axes: "):
        store.run(dataclasses.replace(turned, axes=turned.axes[::-1]), copy)
    store.run(read(path, ["question=Other words, same numbers?"]), copy)
    assert_same(copy, undisturbed)


def test_what_is_no_sweeps_stays(path, tmp_path):
    zarr.open_group(tmp_path / "zarr/data.zarr", mode="w").attrs["config"] = "{}"  # of some other program
    (tmp_path / "other/data.zarr").mkdir(parents=True)
    for name in ("zarr", "other"):
        (tmp_path / name / "data.zarr" / "mine").write_text("precious")
        with pytest.raises(ArgumentError, match=r"hold a sweep.s data\.zarr or none"):
            store.run(read(path), tmp_path / name)
        assert (tmp_path / name / "data.zarr" / "mine").read_text() == "precious"


@pytest.mark.parametrize("damage", ["cut", "nested"])
def test_descriptions_that_cannot_be_read_are_refused(path, copy, damage):
    described = copy / "data.zarr/zarr.json"
    described.write_text({"cut": described.read_text()[:-40], "nested": "[" * 99999}[damage])
    for use in (store.read, store.Store, lambda folder: store.run(read(path), folder)):
        with pytest.raises(ArgumentError, match=r"hold a sweep.s data\.zarr or none"):
            use(copy)


def test_a_process_that_cannot_begin_tells_the_others(path, tmp_path, monkeypatch):
    said = []

    def meet(processes, well, last):
        said.append((processes, well, last))
        return False

    monkeypatch.setattr(store, "_meet", meet)
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    (tmp_path / "file").write_text("")
    for process, folder, words in ((0, "file", "can be written"), (1, "other", "another one failed, and reports why")):
        monkeypatch.setattr(jax, "process_index", lambda process=process: process)
        with pytest.raises(ArgumentError, match=words):
            store.run(read(path), tmp_path / folder)
    assert said == [(2, False, False), (2, True, False)]


def test_a_run_that_a_full_disk_and_a_stop_ended_goes_on_and_ends_bit_identical(
    path, undisturbed, tmp_path, monkeypatch
):
    write, calls, seen = store.Store.write, [], []

    def full(self, block, piece):
        calls.append(block)
        if len(calls) > 4:
            self.arrays["final_error"][block.region] = piece["final_error"]  # half a block
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(self, block, piece)

    with monkeypatch.context() as patched:
        patched.setattr(store.Store, "write", full)
        with pytest.raises(ArgumentError, match=r"No space left on device after 4 of 24 blocks; they are kept"):
            store.run(read(path), tmp_path)
    assert np.isnan(store.read(tmp_path).final_error).any() and len(store.Store(tmp_path).missing()) == 20

    def stop(done, total):
        if done >= 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.run(read(path), tmp_path, progress=stop)
    with jax.enable_x64(False):  # the default in Python makes no difference
        assert store.run(read(path), tmp_path, progress=lambda done, total: seen.append(total))
    assert seen[0] < 168 - 28  # what was done was not done again
    assert_same(tmp_path, undisturbed)


def test_two_processes_make_one_store(path, undisturbed, tmp_path):
    with socket.socket() as s:
        s.bind(("localhost", 0))
        place = f"localhost:{s.getsockname()[1]}:2"
    line = [sys.executable, "-m", "cnclik", "sweep", path, "--out", tmp_path, "--no-figures", "--distributed"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "JAX_ENABLE_X64": "1"}
    heard = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True, "env": environment}
    done = [subprocess.Popen([*line, f"{place}:{i}"], **heard) for i in range(2)]
    said = [process.communicate(timeout=400)[0] for process in done]
    assert not any(process.returncode for process in done), said
    assert_same(tmp_path, undisturbed)
