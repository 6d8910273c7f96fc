"""Docstrings of this project are plain text with "Args:", "Returns:" and "Raises:"; here they become what Sphinx reads.

Marks that mean something to reStructuredText alone (|x|, *, names that end in _) are escaped, "Returns: text" becomes a
field, and a record whose fields are explained by comments beside them gets these as a list.
"""

import ast
import inspect
import re
import textwrap

HEAD = re.compile(r"^(\w+(?: and raises|\.csv)?): (\S.*)$")
FIELDS = ("Args", "Returns", "Raises", "Attributes")
WITH_TYPE = ("property", "attribute", "data")  # Napoleon reads "type: text" there
_WHOLE = {}  # docstrings of properties as they were before Napoleon
COMMENTED = re.compile(r"^ +(?P<names>\w+)(?:: [^#=]+?)?(?: = [^#]+?)?  # (?P<said>.+)$")

ARRAY_LIKE = re.compile(r"_Buffer \| .*?_NestedSequence\[complex \| bytes \| str\]")  # what numpy.typing's consists of


def escaped(line: str) -> str:
    """A line whose marks are only letters, apart from what stands in `backticks`; `Name`s is no mark for Sphinx."""
    line = re.sub(r"(`[^`]+`)(?=\w)", r"\1\\ ", line) if line.count("`") % 2 == 0 else line
    parts = re.split(r"(``.+?``|`[^`]*`)", line)
    return "".join(
        part if i % 2 else re.sub(r"([|*])", r"\\\1", re.sub(r"(\w)_(?!\w)", r"\1\\_", part))
        for i, part in enumerate(parts)
    )


def fields(cls) -> list:
    """(name, comment) of the fields of a class that a comment on their line explains."""
    try:
        source = textwrap.dedent(inspect.getsource(cls))
    except (OSError, TypeError):
        return []
    rows, lines = ast.parse(source).body[0].body, source.splitlines()
    found = []
    for row in rows:
        if isinstance(row, ast.AnnAssign | ast.Assign):
            made = COMMENTED.match(lines[row.lineno - 1])
            if made:
                found.append((made["names"], made["said"]))
    return found


def one_each(obj, lines) -> list:
    """Lines in which each argument begins one, also of several that share a line: "x: a point. y: another."."""
    try:
        known = "|".join(map(re.escape, inspect.signature(obj).parameters))
    except (TypeError, ValueError):
        known = ""
    if not known:
        return lines
    entry = re.compile(rf"(?:^|(?<=[.;\])]) )((?:{known})(?:, (?:{known}))*: )")
    made, inside, deeper = [], False, ""
    for line in lines:
        if (head := re.match("(Args|Attributes):(?: (.*))?$", line)) and (not head[2] or entry.match(head[2])):
            made.append(f"{head[1]}:")
            inside, deeper, line = True, "  " * bool(head[2]), f"  {head[2] or ''}"
        elif line and not line.startswith(" "):
            inside = False
        if not inside:
            made.append(line)
            continue
        first, *others = entry.sub(r"\n\1", line.strip()).split("\n")
        whole = made[-1].endswith(":") and line.startswith("  ")
        made += [f"{'' if whole else deeper}{line[: len(line) - len(line.lstrip())]}{first}"] * bool(first)
        made += [f"  {other}" for other in others]
    return made


def plain(app, what, name, obj, options, lines):
    """Text to reStructuredText, in place."""
    lines[:] = one_each(obj, lines)
    made, field = [], False
    for line, after in zip(lines, [*lines[1:], ""], strict=False):
        head = HEAD.match(line)
        if head and (head[1] in FIELDS or field or after.startswith("  ")):
            if made and made[-1] and not field:
                made.append("")
            made.append(f":{head[1]}: {escaped(head[2])}")
            field = True
            continue
        if field and line and not line.startswith(" "):
            made.append("")
        field = field and line.startswith(" ")
        made.append(escaped(line))
    if inspect.isclass(obj) and not any(re.match(r":?(Args|Attributes):", line) for line in made):
        said = [f"  {key}: {escaped(about)}" for key, about in fields(obj)]
        made += ["", "Attributes:", *said, ""] if said else []
    lines[:] = made
    if what in WITH_TYPE:
        _WHOLE[name] = list(made)


def short(app, what, name, obj, options, lines):
    """Types by their last names: Array, not jax.jaxlib._jax.Array; those of cnclik remain links."""
    for i, line in enumerate(lines):
        if line.strip().startswith(":type:"):
            line = re.sub(r"\b(cnclik\.)?(?:\w+\.)+(\w+)", lambda m: f"~{m[0]}" if m[1] else m[2], line)
            lines[i] = ARRAY_LIKE.sub("ArrayLike", line)


def whole(app, what, name, obj, options, lines):
    """Napoleon takes what stands before a property's first colon for its type, in sentences, too: here it is undone."""
    if what in WITH_TYPE:
        lines[:] = _WHOLE.pop(name, lines)


def known(app, what, name, obj, skip, options):
    """The fields of a named tuple stand in its description already; how Python makes errors and flags says nothing."""
    inherited = type(obj).__name__ in ("wrapper_descriptor", "builtin_function_or_method")
    flag = name == "__new__" and getattr(obj, "__module__", "") == "enum"
    if type(obj).__name__ == "_tuplegetter" or (name in ("__init__", "__new__") and inherited) or flag:
        return True
    return None


def values(app, what, name, obj, options, signature, returned):
    """`Ts=0.1` in place of `Ts=USUAL`: the values of constants that are defaults; a method by its name."""
    constants = vars(inspect.getmodule(obj) or inspect)

    def value(found):
        constant = constants.get(found[1])
        plain = constant if isinstance(constant, int | float | str) else getattr(constant, "name", None)
        return f"={plain!r}" if plain is not None else found[0]

    return re.sub(r"=([A-Z][A-Z_]+)(?=[,)])", value, signature or "") or signature, returned


def setup(app):
    app.connect("autodoc-process-signature", values)
    app.connect("autodoc-skip-member", known)
    app.connect("autodoc-process-docstring", plain, priority=100)
    app.connect("autodoc-process-docstring", short, priority=800)
    app.connect("autodoc-process-docstring", whole, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
