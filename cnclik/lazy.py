"""Packages whose names are loaded when they are first asked for: the command line answers without loading JAX."""

import importlib
import sys


def on_use(package: str, names: dict):
    """`__getattr__` and `__all__` of a package, from {module: "names in it"}; "new=old" offers a name as another."""
    places = {}
    for module, line in names.items():
        for word in line.split():
            name, _, there = word.partition("=")
            places[name] = module, there or name

    def load(name):
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, there = places[name]
        found = getattr(importlib.import_module(f"{package}.{module}"), there)
        setattr(sys.modules[package], name, found)
        return found

    return load, sorted(places)
