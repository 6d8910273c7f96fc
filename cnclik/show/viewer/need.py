"""Need: viser, where the viewer is asked for; nothing else needs it."""

import contextlib
import importlib.util
import io

from cnclik import errors

INSTALL = "pip install 'cnclik[viewer]'"


def has_viser() -> bool:
    """Whether viser can be imported."""
    return importlib.util.find_spec("viser") is not None


def require_viser():
    """The module viser. Raises: ArgumentError with the command that installs it."""
    try:
        import viser
    except ImportError:
        raise errors.ArgumentError(f"The viewer needs the package viser, which is not installed: {INSTALL}") from None
    return viser


def server(host="localhost", port=8080):
    """A viser server, without its words on the terminal; on the next port that is free.

    Raises: ArgumentError where it can't listen there.
    """
    viser = require_viser()
    errors.integer("port", port, at_least=1, at_most=65_000)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            made = viser.ViserServer(host=host, port=port, label="cnclik", verbose=False)
    except (OSError, RuntimeError) as error:
        raise errors.fail("host", "be one that this machine can listen on", f"is {host!r}: {error}") from None
    made.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    return made


def stop(server) -> None:
    """End a server, without its words on the terminal."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()
