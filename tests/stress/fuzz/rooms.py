"""Rooms: the kinds of inputs, each a module with `draw(rng)`, an input, and `attempt(input, folder)`, its use."""

from tests.stress.fuzz import arguments, exports, expressions, logs, poses, stores, tables, toml, urdf

ROOMS = {
    "urdf": urdf,
    "toml": toml,
    "tables": tables,
    "logs": logs,
    "expressions": expressions,
    "arguments": arguments,
    "stores": stores,
    "poses": poses,
    "exports": exports,
}
