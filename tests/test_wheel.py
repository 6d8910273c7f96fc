"""The sdist and the wheel that is made of it: what they hold, and that the package works from them alone."""

import pathlib
import subprocess
import sys
import tarfile
import zipfile

import pytest

ROOT = pathlib.Path(__file__).parents[1]
CODE = """import sys; sys.path.insert(0, "site"); import cnclik as ck; from cnclik.cli import main
law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=5.0)
print(ck.__file__, ck.solve(law, ck.hold([1.2, 0.9]), [0.3, 1.0], Ts=0.01, N=20).q.shape)
main(["stability", "planar:1,1", "--Ts", "0.01", "--delay", "3"])"""


@pytest.mark.slow
def test_the_package_works_from_its_wheel(tmp_path):
    pytest.importorskip("build")
    subprocess.run([sys.executable, "-m", "build", "--outdir", tmp_path, ROOT], check=True)
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as held:
        names = {name.partition("/")[2] for name in held.getnames()}
    assert {"README.md", "LICENSE", "CHANGELOG.md", "tests/conftest.py"} <= names
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {str(p.relative_to(ROOT)) for p in (ROOT / "cnclik").rglob("*.*[!c]")} <= names
    assert all(name.startswith(("cnclik/", "cnclik-")) for name in names)
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "-t", tmp_path / "site"]
    subprocess.run([*install, wheel], check=True)
    said = subprocess.check_output([sys.executable, "-I", "-c", CODE], cwd=tmp_path, text=True)
    assert said.startswith(str(tmp_path)) and "(21, 2)" in said and "recommended" in said
