"""Packages whose names are loaded when they are first asked for: the command line answers without loading JAX."""

import importlib
import sys
import types


class _Room(types.ModuleType):
    """A package of which a name stays what it offers, where a module of its own is called alike."""

    def __setattr__(self, name, value):
        if not (isinstance(value, types.ModuleType) and name in self.__dict__["_alike"]):
            super().__setattr__(name, value)


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

    room = sys.modules[package]
    room._alike = {name for name, (module, _) in places.items() if module == name}
    room.__class__ = _Room
    return load, sorted(places)
