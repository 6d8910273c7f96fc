#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.5"]
# ///
"""What there is to run, each in an environment of its own: `nox -l` lists it, `nox -s tests` runs it."""

import pathlib

import nox

nox.needs_version = ">=2025.5"
nox.options.default_venv_backend = "uv|virtualenv"
LOOP = """import cnclik as ck
law = ck.Law(ck.ur5(), ck.position(), alpha=5.0)
print(ck.solve(law, ck.hold([0.4, 0.1, 0.4]), [0.5] * 6, Ts=0.01, N=9))"""
WHOLE = ("-p", "xdist.plugin", "-n", "auto", "-o", "addopts=--disable-plugin-autoload --import-mode=importlib -m slow")


@nox.session
def lint(session):
    """Style, form, types."""
    session.install("-e", ".[test]", "--group", "lint")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("python", ".ci/lint.py")
    session.run("mypy")


@nox.session(python=["3.11", "3.12", "3.13", "3.14"])
def tests(session):
    """The suite; arguments go to pytest."""
    session.install("-e", ".[test]")
    session.run("pytest", "-m", "not slow", *session.posargs)


@nox.session(default=False)
def lowest(session):
    """The suite with the oldest dependencies that are allowed."""
    session.install(
        "-e", ".[test]", "jax==0.10.0", "jaxlib==0.10.0", "numpy==2.0.*", "optax==0.2.4", "matplotlib==3.9.*"
    )
    session.run("pytest", "-m", "not slow", *session.posargs)


@nox.session(default=False)
def slow(session):
    """Tests of minutes."""
    session.install("-e", ".[test,peers]", "build")
    session.run("pytest", *WHOLE, *session.posargs)


@nox.session(default=False)
def stress(session):
    """Hostile inputs, random programs, faults of the system, long runs; `-- mutants` puts faults into the package."""
    mutants = session.posargs[:1] == ["mutants"]
    session.install("-e", ".[test]", *["coverage"] * mutants)
    session.run("python", "-m", "tests.stress" + ".mutants" * mutants, *session.posargs[mutants:])


@nox.session(default=False)
def docs(session):
    """The site with its examples; warnings are errors."""
    session.install(".[docs]")
    session.run("python", "-m", "sphinx", "-W", "-b", "html", "docs", "site")


@nox.session(default=False)
def bench(session):
    """Beside the peers (`nox -s bench -- engine`, see tests/bench/README.md); needs g++."""
    session.install("-e", ".[test,bench,peers]")
    name, *arguments = session.posargs or ["engine"]
    session.run("python", "-m", f"tests.bench.{name}", *arguments)


@nox.session(default=False)
def build(session):
    """Wheel and sdist, and a loop by the wheel with nothing but jax and numpy."""
    folder = session.create_tmp()
    session.install("build")
    session.run("python", "-m", "build", "--outdir", folder)
    session.install("--no-deps", *map(str, pathlib.Path(folder).glob("*.whl")))
    session.install("jax>=0.10,<0.13", "numpy>=2.0", "lazy_loader>=0.4")
    session.run("cnclik", "--version")
    session.run("python", "-I", "-c", LOOP)


if __name__ == "__main__":
    nox.main()
