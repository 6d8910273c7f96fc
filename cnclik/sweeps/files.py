"""Spec files: read, changed by --set NAME=VALUE, and checked."""

from cnclik import errors
from cnclik.reading import read_toml, toml
from cnclik.sweeps.check import axes_named, parse
from cnclik.sweeps.spec import KEYS, TABLES, Spec


def read(path, changes=()) -> Spec:
    """Read a spec and validate it whole.

    Args:
      path: of the TOML file.
      changes: strings "name=value" that override it; the value is TOML.

    Raises: ArgumentError, one line, for what cannot be read, is unknown (the nearest name is suggested), is
      missing, or cannot be built into loops.
    """
    path = errors.path("SPEC", path)
    written = read_toml("SPEC", path)
    try:
        for change in changes:
            _change(written, change)
        return parse(written, path.stem, path.parent)
    except RecursionError:
        raise errors.fail("SPEC", "be nested less deeply", f"{str(path)!r} is nested too deeply to be read") from None


def _change(written, change):
    name, equals, text = map(str.strip, change.partition("="))
    if not equals or not name:
        raise errors.fail("set", "be NAME=VALUE", f"is {change!r}")
    try:
        value = toml(f"value = {text}")["value"]
    except ValueError:
        value = text  # a bare word, such as CN, or an expression
    fixed, axes = (_inner(written, room) for room in ("fixed", "axes"))
    *path, key = name.split(".")
    deep = {"fixed": 1, "axes": 1, "units": 1, "tasks": 2, "walls": 2, "cases": 2, "bundles": 3}
    deep["axes"] = 3 if path[1:2] in (["tasks"], ["walls"]) else 1
    if not path or len(path) != deep.get(path[0]):
        if name in (*KEYS, *TABLES):
            written[name] = value
            return
        varied = name in axes and isinstance(value, (list, dict))
        path, key = ["axes" if varied else "fixed"], name
    table = written
    for part in path:
        table = _inner(table, part)
    table[key] = value
    if path == ["axes"]:
        fixed.pop(key, None)
    elif path == ["fixed"] and axes.pop(key, None) and isinstance(written.get("figure"), list):
        # Drop figures over an axis that no longer exists.
        written["figure"] = [f for f in written["figure"] if not isinstance(f, dict) or key not in axes_named(f)]


def _inner(table, name) -> dict:
    inner = table.setdefault(name, {})
    if not isinstance(inner, dict):
        raise errors.fail(name, "be a table", f"is {inner!r}")
    return inner
