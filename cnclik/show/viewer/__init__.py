"""The viewer: one run of a robot in a browser, drawn by viser (extra `viewer`).

Modules: `shapes` (a robot's meshes, or shapes made of its chain), `scene` (what is drawn), `front` (`view`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submod_attrs={"front": ["Viewer", "view"]})
