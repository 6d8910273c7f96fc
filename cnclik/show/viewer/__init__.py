"""The viewer: robots, runs and loops in a browser, drawn by viser (extra `viewer`).

Modules: `body` (a robot's shapes from its chain), `meshes` (from its URDF file), `motion` (what is shown), `files`
(motions of files), `scene`, `page` (a moving scene as one page), `play` and `live` (what a browser shows), `look` (a
loop run anew), `swept` (loops of a sweep), `front` (the front door), `need` (whether viser is there).
"""

from cnclik.lazy import on_use

__getattr__, __all__ = on_use(
    __name__,
    {
        "files": "read_motions",
        "motion": "Motion motion_of",
        "page": "as_page",
        "front": "view",
    },
)
