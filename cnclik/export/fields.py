"""Fields: arguments and results of an exported function, and names of the arrays in a tree of records."""

import dataclasses
import functools
import re

import jax
import numpy as np

from cnclik import errors
from cnclik.engine.routine import INT, REAL, Field
from cnclik.law.walls import Wall
from cnclik.record import is_literal

_OWN = "own_"  # prefix of fields in a user's records, whose names may be C keywords


def leaves(tree, path=()):
    """Yield (path, array) of every array in a tree of records, in JAX's order."""
    if dataclasses.is_dataclass(tree):
        ours = type(tree).__module__.startswith("cnclik.")
        for field in dataclasses.fields(tree):
            word = field.name if ours else _OWN + re.sub(r"[^A-Za-z0-9]", "_", field.name)
            yield from leaves(getattr(tree, field.name), (*path, word))
    elif isinstance(tree, tuple) and tree and all(isinstance(one, Wall) for one in tree):
        for wall, word in zip(tree, identifiers([f"wall_{wall.name}" for wall in tree]), strict=True):
            for own, value in leaves(wall):
                alone = own[:3] == ("task", "parts", "0") and len(wall.task.parts) == 1
                yield (*path, word, *own[3 * alone :]), value
    elif isinstance(tree, (tuple, list)):
        for i, item in enumerate(tree):
            yield from leaves(item, (*path, str(i)))
    elif tree is not None and not is_literal(tree):
        yield path, tree


def names(paths) -> list:
    """Return a short name for each path: as many of its last words as distinguish it, those of a wall with its name."""
    found = []
    for path in paths:
        least = len(path) - path.index("walls") - 1 if "walls" in path else 1
        for count in range(least, len(path) + 1):
            short = path[-count:]
            if not short[0].isdigit() and sum(p[-count:] == short for p in paths) == 1:
                break
        name = "_".join(short)
        found.append(f"{name}_{len(found)}" if name in found else name)
    return found


def identifiers(names, kind="task") -> list:
    """Return names as C identifiers; a name that starts with a digit gets its kind as a prefix."""
    words = [re.sub(r"[^A-Za-z0-9_]", "_", name) for name in names]
    for i, word in enumerate(words):
        words[i] = word if word[:1].isalpha() else f"{kind}_{word}"
        while words[i] in words[:i]:  # names that are equal in C
            words[i] += f"_{i}"
    return words


_ABOUT = {
    "alpha": "gain of the error [1/s]",
    "damping": "lambda of the damped inverse [unit of J]",
    "threshold": "below which it is damped",
    "M": "passes of an implicit stage, at most as many as were exported",
    "near_singular": "least singular value below which NEAR_SINGULAR is set",
    "feedforward": "factor of the desired velocity",
    "error_clamp": "largest error that the gain sees [m, rad]",
    "rate": "[1/s]",
    "rest": "joint values to draw towards [rad, m]",
    "weights": "of the task coordinates",
    "bodies": "of each body s (c, 1), with its share s of the mass and its centre c in its frame [m]",
    "ends": "ends of a wall's shape, in its link's frame [m]",
    "radius": "[m]",
    "curve": "of the target's path [m, s]",
    "walls": "of a wall, which keeps normal . x above offset [m, rad]",
}


def parameters(tree):
    """Return the fields of the arrays in a tree, and the function that replaces the arrays."""
    flat, treedef = jax.tree.flatten(tree)
    if not all(map(errors.concrete, flat)):
        raise errors.fail("law", "hold numbers to be exported", "is traced by JAX")
    found = list(leaves(tree))
    if len(found) != len(flat):
        raise errors.fail("law", "be made of cnclik's own records", "holds other trees of arrays")
    fields = []
    for (path, value), name in zip(found, names([p for p, _ in found]), strict=True):
        value = np.asarray(value)
        kind = REAL if value.dtype.kind == "f" else INT
        about = next((_ABOUT[word] for word in reversed(path) if word in _ABOUT), "")
        fields.append(Field(name, value.shape, kind, about, value))
    return fields, functools.partial(jax.tree.unflatten, treedef)
