"""Rooms: the kinds of inputs, each a module with `draw(rng)`, an input, and `attempt(input, folder)`, its use."""

from tests.stress.fuzz import arguments, exports, expressions, logs, poses, stacks, stores, tables, toml, urdf

ROOMS = {
    "urdf": urdf,
    "toml": toml,
    "tables": tables,
    "logs": logs,
    "expressions": expressions,
    "arguments": arguments,
    "stacks": stacks,
    "stores": stores,
    "poses": poses,
    "exports": exports,
}
