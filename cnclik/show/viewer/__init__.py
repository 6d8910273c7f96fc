"""The viewer: robots, runs and loops in a browser, drawn by viser (extra `viewer`).

Modules: `body` (a robot's shapes from its chain), `meshes` (from its URDF file), `motion` (what is shown), `files`
(motions of files), `scene`, `page` (a moving scene as one page), `play` and `live` (what a browser shows), `look` (a
loop run anew), `advised` (with advised gains), `swept` (loops of a sweep), `front` (the front door), `need` (whether
viser is there).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={"files": ["read_motions"], "motion": ["Motion", "motion_of"], "page": ["as_page"], "front": ["view"]},
)
