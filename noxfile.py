#!/usr/bin/env -S uv run --script
# /// script
# dependencies = ["nox>=2025.5"]
# ///
"""What there is to run, each in an environment of its own: `nox -l` lists it, `nox -s tests` runs it."""

import nox

nox.needs_version = ">=2025.5"
nox.options.default_venv_backend = "uv|virtualenv"
WHOLE = ("-p", "xdist.plugin", "-n", "auto", "-o", "addopts=--disable-plugin-autoload --import-mode=importlib -m slow")


@nox.session
def lint(session):
    """Style, form, types."""
    session.install("-e", ".[test]")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
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
        "-e", ".[test]", "jax==0.10.*", "jaxlib==0.10.*", "numpy==2.0.*", "optax==0.2.4", "matplotlib==3.9.*"
    )
    session.run("pytest", "-m", "not slow", *session.posargs)


@nox.session(default=False)
def slow(session):
    """Tests of minutes."""
    session.install("-e", ".[test,peers]")
    session.run("pytest", *WHOLE, *session.posargs)


@nox.session(default=False)
def stress(session):
    """Hostile inputs and faults of the system."""
    session.install("-e", ".[test]")
    session.run("python", "-m", "tests.stress.fuzz", *session.posargs)
    session.run("python", "-m", "tests.stress.faults")


@nox.session(default=False)
def docs(session):
    """The site with its examples; warnings are errors."""
    session.install(".[docs]")
    session.run("python", "-m", "sphinx", "-W", "-b", "html", "docs", "site")


@nox.session(default=False)
def bench(session):
    """Beside the peers; needs g++ and Eigen's headers."""
    session.install("-e", ".[test,bench]")
    session.run("python", "-m", "tests.bench", *session.posargs)


@nox.session(default=False)
def build(session):
    """Wheel and sdist, and the wheel by itself: it must work on jax and numpy alone."""
    session.install("build")
    session.run("python", "-m", "build", "--outdir", "dist")
    session.run("python", "-m", "pip", "install", "--force-reinstall", "--find-links", "dist", "cnclik")
    session.run("cnclik", "--version")


if __name__ == "__main__":
    nox.main()
