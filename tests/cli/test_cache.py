"""Programs kept between runs: where, whose, how many; and the second process compiles none of them."""

import os
import pathlib
import re
import stat
import subprocess
import sys

import jax
import pytest

from cnclik import cache as kept

ROOT = pathlib.Path(__file__).parents[2]
linux = pytest.mark.skipif(sys.platform != "linux", reason="the folder of Linux")
COUNTING = """
import sys, jax
found = {"compile": 0, "hits": 0}

def span(event, begun, ended, **_):
    found["compile"] += "backend_compile" in event

def happened(event, **_):
    found["hits"] += event == "/jax/compilation_cache/cache_hits"

jax.monitoring.register_event_time_span_listener(span)
jax.monitoring.register_event_listener(happened)
from cnclik.cli import main
main("solve planar:1,1 --N 3 --method EE --no-figures".split())
jax.jit(jax.numpy.sin)(1.0)
print("{compile} programs, {hits} from the cache".format(**found))
"""


def programs(folder, **more):
    """(compiled or taken from the cache, taken from the cache) by a command with `folder` as the user's cache folder;
    and what it printed of the error. Nothing is on stderr."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "JAX_PERSISTENT"))}
    environment |= {"XDG_CACHE_HOME": str(folder), "HOME": str(folder), "PYTHONPATH": str(ROOT)} | more
    done = subprocess.run([sys.executable, "-c", COUNTING], env=environment, capture_output=True, text=True, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    numbers = re.search(r"(\d+) programs, (\d+) from the cache", done.stdout)
    return [*map(int, numbers.groups()), re.findall(".* error .*", done.stdout)]


@linux
def test_the_second_process_compiles_nothing(tmp_path):
    first, hits, error = programs(tmp_path)
    (place,) = (tmp_path / "cnclik").iterdir()
    before = {*place.iterdir()}
    assert first >= sum(path.name.endswith("-cache") for path in before) > 0 == hits
    assert any(path.suffix == ".so" for path in before)
    assert stat.S_IMODE((tmp_path / "cnclik").stat().st_mode) == stat.S_IMODE(place.stat().st_mode) == 0o700
    assert programs(tmp_path) == [first, first, error] and before == {*place.iterdir()}


@pytest.mark.slow
@linux
def test_switches_and_damage(tmp_path):
    """Switched off, nothing is read; JAX's own switches have the last word; what is damaged is compiled again."""
    first = programs(tmp_path)[0]
    (place,) = (tmp_path / "cnclik").iterdir()
    assert programs(tmp_path, JAX_ENABLE_COMPILATION_CACHE="0")[1] == 0
    assert programs(tmp_path, JAX_COMPILATION_CACHE_DIR=str(tmp_path / "elsewhere"))[1] < first
    assert any((tmp_path / "elsewhere").iterdir())
    for path in place.iterdir():
        path.write_bytes(b"damaged")
    assert programs(tmp_path)[1] == 0


@pytest.fixture
def named():
    """The folder that the environment names; JAX's switches are as before in the end."""
    names = ("enable_compilation_cache", "compilation_cache_dir", "persistent_cache_min_compile_time_secs")
    before = {f"jax_{name}": getattr(jax.config, f"jax_{name}") for name in names}
    yield pathlib.Path(before["jax_compilation_cache_dir"])
    for name, value in before.items():
        jax.config.update(name, value)
    jax.experimental.compilation_cache.compilation_cache.reset_cache()


@linux
def test_a_folder_that_is_no_good_is_no_error(tmp_path, monkeypatch, capfd, named):
    """A file with its name, and a folder into which others may write."""
    jax.config.update("jax_compilation_cache_dir", None)
    (tmp_path / "file").mkdir()
    (tmp_path / "file" / "cnclik").write_text("")
    (tmp_path / "folder" / "cnclik").mkdir(parents=True)
    (tmp_path / "folder" / "cnclik").chmod(0o777)
    for name in ("file", "folder"):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / name))
        assert kept.use_cache() is jax.config.jax_compilation_cache_dir is None
    assert capfd.readouterr() == ("", "")


def test_where_and_the_switches(tmp_path, monkeypatch, named):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if sys.platform != "darwin":
        assert kept.user_folder() == tmp_path / "cnclik"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(kept.sys, "platform", "darwin")
    assert kept.user_folder().parts[-3:] == ("Library", "Caches", "cnclik")
    assert kept.use_cache() == named
    assert kept.use_cache(tmp_path / "mine").parent == tmp_path / "mine"
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "mine" / kept.machine())
    jax.config.update("jax_enable_compilation_cache", False)
    assert kept.use_cache(tmp_path / "other") is None and not (tmp_path / "other").exists()


def test_the_oldest_makes_room_and_nothing_else_is_touched(tmp_path):
    files = [(f"jaxlib-{name}", "one-cache" if age % 2 else "one.so", age) for age, name in enumerate("abcd")]
    for folder, name, age in (*files, ("mine", "one.so", 9), ("jaxlib-a", "mine", 9)):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_bytes(b"x" * 100)
        os.utime(tmp_path / folder / name, (1e9 - age, 1e9 - age))
    for _ in range(2):
        kept.cut(tmp_path, 250)
        assert {path.parent.name for path in tmp_path.glob("*/one*")} == {"jaxlib-a", "jaxlib-b", "mine"}
    assert (tmp_path / "jaxlib-a" / "mine").exists()
