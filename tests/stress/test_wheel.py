"""The sdist and the wheel that is made of it: what they hold, and that the package works from them alone."""

import pathlib
import subprocess
import sys
import tarfile
import zipfile

import pytest

ROOT = pathlib.Path(__file__).parents[2]
pytestmark = pytest.mark.slow


def ran(*command, cwd=ROOT):
    """Standard output of a command that must end well."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder of the sdist and of the wheel that is built of it, as an index gets them."""
    folder = tmp_path_factory.mktemp("dist")
    ran(sys.executable, "-m", "build", "--outdir", str(folder))
    return folder


def test_what_they_hold(built):
    with tarfile.open(next(built.glob("*.tar.gz"))) as sdist:
        names = {name.partition("/")[2] for name in sdist.getnames()}
    assert {"README.md", "LICENSE", "CHANGELOG.md", "tests/conftest.py"} <= names
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        held = set(wheel.namelist())
    package = {
        str(p.relative_to(ROOT)) for p in (ROOT / "cnclik").rglob("*") if p.is_file() and "__pycache__" not in p.parts
    }
    assert package <= held
    assert all(name.startswith(("cnclik/", "cnclik-")) for name in held)


def test_it_works_from_the_wheel(built, tmp_path):
    wheel, site = str(next(built.glob("*.whl"))), tmp_path / "site"
    ran(sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(site), wheel)
    code = (
        f"import sys; sys.path.insert(0, {str(site)!r}); import cnclik as ck; print(ck.__file__);"
        "arm = ck.planar_arm([1.0, 0.8]); law = ck.Law(arm, ck.position('xy'), alpha=5.0);"
        "print(ck.solve(law, ck.hold([1.2, 0.9]), [0.3, 1.0], Ts=0.01, N=20).q.shape);"
        "from cnclik.cli import main; main(['stability', 'planar:1,1', '--Ts', '0.01', '--delay', '3'])"
    )
    said = ran(sys.executable, "-I", "-c", code, cwd=tmp_path)
    assert said.startswith(str(site)) and "(21, 2)" in said and "recommended" in said
