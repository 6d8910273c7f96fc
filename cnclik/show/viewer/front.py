"""Front: the door: what to show, live or played, in a browser or as a page."""

import pathlib

from cnclik import errors
from cnclik.integrate.trajectory import Trajectory
from cnclik.markup import escaped
from cnclik.problem.build import Problem, problem_from
from cnclik.show.viewer import need, play
from cnclik.show.viewer.files import is_result, read_motions, robot_of
from cnclik.show.viewer.live import Live
from cnclik.show.viewer.motion import Motion, motion_of
from cnclik.show.viewer.page import as_page
from cnclik.show.viewer.scene import Scene
from cnclik.writing import checked_file, output_folder

MOST = 2  # motions beside each other


class Viewer:
    """A scene that a browser shows at `url` until `stop()`."""

    def __init__(self, motions=(), live=None, *, host="localhost", port=8080):
        self.server = need.server(host, port)
        self.live, self.url = live, f"http://{host}:{self.server.get_port()}"
        scene = Scene(self.server, panel=True)
        motions = live.motions() if live else list(motions)
        scene.put(motions)
        self.player = play.Player(self.server, scene)
        if live:
            live.put_on(self.server, self.player)
        else:
            notes = [f"<p><b>{escaped(m.name)}</b>: {escaped(m.note)}</p>" for m in motions if m.note]
            if notes:
                self.server.gui.add_html(f"<div style='padding:0 1em'>{''.join(notes)}</div>")
            if any(m.error and len(m.t) > 1 for m in motions):
                play.add_error_chart(self.server.gui, motions)
            self.player.put(motions)
        self.player.start()

    def stop(self) -> None:
        """End the server."""
        self.player.end()
        if self.live:
            self.live.end()
        need.stop(self.server)

    def __repr__(self):
        return f"Viewer({self.url})"


def view(what, law=None, *, beside=None, host="localhost", port=8080, html=None):
    """A robot in a browser: `ck.show.view("panda")` with sliders, `ck.show.view(run, law)` a run that plays.

    Args:
      what: a robot (chain, name or URDF file) or a `Problem`, shown live with sliders for alpha, Ts, method and delay;
        or a `Trajectory` with its law, a `Motion`, or a file or folder of `solve` or `reach`, played.
      law: of a `Trajectory`. beside: another run of the same kinds, shown beside it.
      host, port: where to listen; on the next free port.
      html: a file to write instead: one page that moves and needs no network.

    Returns: a `Viewer` with `url` and `stop()`, or the file's path.
    Raises: ArgumentError where viser is missing, or for what can't be shown.
    """
    need.require_viser()
    motions, live = _shown(what, law)
    if beside is not None:
        motions, live = [*(live.motions() if live else motions), *_shown(beside, law)[0]][:MOST], None
    if html is None:
        return Viewer(motions, live, host=host, port=port)
    return write_page(live.motions() if live else motions, html)


def write_page(motions, file) -> pathlib.Path:
    """Write motions as one page. Raises: ArgumentError where it can't be written."""
    file = checked_file("html", file, ".html")
    with output_folder(file.parent, name="html") as folder:
        folder.write_text(file.name, as_page(motions))
    return file


def _shown(what, law):
    """(motions, live) of one of the things that `view` takes."""
    if isinstance(what, Motion):
        return [what], None
    if isinstance(what, Trajectory):
        if law is None:
            raise errors.fail("law", "be given with a Trajectory", "is not")
        return [motion_of(what, law, name=f"{law.chain.n} joints")], None
    if isinstance(what, (str, pathlib.Path)) and is_result(what):
        return read_motions(what), None
    if isinstance(what, Problem):
        return [], Live(what)
    links = robot_of(what)[2]
    return [], Live(problem_from(what), links=links)
