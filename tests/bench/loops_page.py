"""The tables and the figure of `tests.bench.loops`, from what it measured."""

import json


def text(found) -> str:
    """The JSON, a row a line."""
    lines = []
    for name, part in found.items():
        if isinstance(part, dict) and "rows" in part:
            rows = ",\n  ".join(json.dumps(row) for row in part["rows"])
            lines.append(f'{json.dumps(name)}: {{"seconds": {part["seconds"]}, "rows": [\n  {rows}]}}')
        else:
            lines.append(f"{json.dumps(name)}: {json.dumps(part)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def write(found, folder):
    pass
