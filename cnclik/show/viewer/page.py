"""Page: motions as one page that moves and needs no server, nor a network."""

import numpy as np

from cnclik.markup import GENERATOR
from cnclik.show.viewer import need
from cnclik.show.viewer.scene import Scene

MOST_FRAMES = 240
SHORTEST, LONGEST = 3.0, 16.0  # [s] playing time of a page
SECONDS_EACH = 0.8  # [s] for each target


def as_page(motions) -> str:
    """A whole HTML page on which one or two motions play, with viser's own bar to play, stop and drag; 0.8 MB.

    Raises: ArgumentError where viser is not installed.
    """
    server = need.server(port=8600)
    try:
        scene = Scene(server)
        scene.put(motions)
        shares, pause = frames_of(motions)
        record = server.get_scene_serializer()
        for share in shares:
            scene.show(share)
            record.insert_sleep(pause)
        return record.as_html().replace("<head>", f"<head>{GENERATOR}", 1)
    finally:
        need.stop(server)


def frames_of(motions):
    """Shares of the motions' length that are shown, and for how long each [s].

    The stride is odd, so that a motion that alternates at every sample still does so on the page.
    """
    longest = max(motions, key=lambda m: len(m.t))
    steps = max(len(longest.t) - 1, 1)
    stride = -(-steps // MOST_FRAMES)
    stride += 1 - stride % 2
    shares = np.append(np.arange(0, steps, stride), steps) / steps
    return shares, seconds(motions) / len(shares)


def seconds(motions) -> float:
    """How long a page plays the motions: their time, if that is neither short nor long [s]."""
    return float(np.clip(lasting(motions), SHORTEST, LONGEST))


def lasting(motions) -> float:
    """How long the motions last at speed 1 [s]."""
    return max(SECONDS_EACH * len(m.t) if m.unit == "target" else m.t[-1] - m.t[0] for m in motions)
