"""A loop in plain names: one vocabulary and one builder."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "build": ["problem_from"],
        "file": ["problem_of"],
        "names": ["load", "start_from"],
    },
)
