"""Programs kept between runs: where, whose, how many; and the second process compiles none of them."""

import os
import pathlib
import re
import stat
import subprocess
import sys

import pytest

from cnclik import cache as kept

ROOT = pathlib.Path(__file__).parents[2]
SOLVE = ["solve", "planar:1,1", "--N", "3", "--no-figures"]
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
main(sys.argv[1:])
print("{compile} programs, {hits} from the cache".format(**found))
"""


def run(folder, *argv, **more):
    """A command with `folder` as the user's cache folder: what it printed; nothing on stderr."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "JAX_PERSISTENT"))}
    environment |= {"XDG_CACHE_HOME": str(folder), "HOME": str(folder), "PYTHONPATH": str(ROOT)} | more
    done = subprocess.run(
        [sys.executable, "-c", COUNTING, *argv], env=environment, capture_output=True, text=True, cwd=folder
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def programs(said):
    """(compiled or taken from the cache, taken from the cache)."""
    return tuple(map(int, re.search(r"(\d+) programs, (\d+) from the cache", said).groups()))


@pytest.mark.skipif(sys.platform != "linux", reason="the folder of Linux")
def test_the_second_process_compiles_nothing(tmp_path):
    begun = run(tmp_path, *SOLVE)
    first, hits = programs(begun)
    (place,) = (tmp_path / "cnclik").iterdir()
    kept = {path: path.stat().st_mtime_ns for path in place.iterdir()}
    assert first >= sum(path.name.endswith("-cache") for path in kept) > 0 == hits
    assert any(path.suffix == ".so" for path in kept)
    assert stat.S_IMODE((tmp_path / "cnclik").stat().st_mode) == stat.S_IMODE(place.stat().st_mode) == 0o700
    said = run(tmp_path, *SOLVE)
    again = programs(said)
    assert [line for line in said.splitlines() if "error" in line] == [
        line for line in begun.splitlines() if "error" in line
    ]
    assert again == (first, first)
    assert kept.keys() == {*place.iterdir()}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the folder of Linux")
def test_switches_and_damage(tmp_path):
    first, _ = programs(run(tmp_path, *SOLVE))
    (place,) = (tmp_path / "cnclik").iterdir()
    # Switched off, nothing is read; and JAX's own switches have the last word.
    assert programs(run(tmp_path, *SOLVE, "--no-cache"))[1] == 0
    elsewhere = tmp_path / "elsewhere"
    assert programs(run(tmp_path, *SOLVE, JAX_COMPILATION_CACHE_DIR=str(elsewhere)))[1] < first
    assert any(elsewhere.iterdir())
    # What is damaged is compiled again, and no word of it.
    for path in place.iterdir():
        path.write_bytes(b"damaged")
    assert programs(run(tmp_path, *SOLVE))[1] == 0


@pytest.mark.skipif(sys.platform != "linux", reason="the folder of Linux")
def test_a_folder_that_is_no_good_is_no_error(tmp_path):
    """A file with its name, and a folder into which others may write."""
    file, folder = tmp_path / "file", tmp_path / "folder"
    file.mkdir()
    (file / "cnclik").write_text("")
    (folder / "cnclik").mkdir(parents=True)
    (folder / "cnclik").chmod(0o777)
    code = (
        "import os, sys, jax, cnclik as ck\n"
        "for os.environ['XDG_CACHE_HOME'] in sys.argv[1:]: print(ck.use_cache(), jax.config.jax_compilation_cache_dir)"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_COMPILATION")}
    line = [sys.executable, "-c", code, str(file), str(folder)]
    done = subprocess.run(line, env=environment | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("None None\nNone None\n", "")


def test_where_and_the_switches(tmp_path, monkeypatch):
    import jax

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if sys.platform != "darwin":
        assert kept.user_folder() == tmp_path / "cnclik"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert kept.user_folder().is_absolute()
    monkeypatch.setattr(kept.sys, "platform", "darwin")
    assert kept.user_folder().parts[-3:] == ("Library", "Caches", "cnclik")
    named = jax.config.jax_compilation_cache_dir
    least = jax.config.jax_persistent_cache_min_compile_time_secs
    try:
        assert kept.use_cache() == pathlib.Path(named)  # the environment's
        assert kept.use_cache(tmp_path / "mine").parent == tmp_path / "mine"
        assert jax.config.jax_compilation_cache_dir == str(tmp_path / "mine" / kept.machine())
        jax.config.update("jax_enable_compilation_cache", False)
        assert kept.use_cache(tmp_path / "other") is None and not (tmp_path / "other").exists()
    finally:
        jax.config.update("jax_enable_compilation_cache", True)
        jax.config.update("jax_compilation_cache_dir", named)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", least)
        jax.experimental.compilation_cache.compilation_cache.reset_cache()


def test_the_oldest_makes_room_and_nothing_else_is_touched(tmp_path):
    def write(folder, name, age):
        path = tmp_path / folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x" * 100)
        os.utime(path, (1e9 - age, 1e9 - age))

    for age, name in enumerate("abcd"):
        write(f"jaxlib-{name}", "one-cache" if age % 2 else "one.so", age)
    write("mine", "one.so", 9)
    write("jaxlib-a", "mine", 9)
    for _ in range(2):
        kept.cut(tmp_path, 250)
        assert {path.parent.name for path in tmp_path.glob("*/one*")} == {"jaxlib-a", "jaxlib-b", "mine"}
    assert (tmp_path / "jaxlib-a" / "mine").exists()
