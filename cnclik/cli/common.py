"""Options and tables that several verbs share."""

import dataclasses
import re

from cnclik.problem.options import SWEPT


@dataclasses.dataclass(kw_only=True)
class CacheOption:
    """For every verb."""

    cache: bool = True
    """Keep compiled programs in the user's cache folder and reuse them."""


@dataclasses.dataclass(kw_only=True)
class ComputeOptions(CacheOption):
    """For verbs that compute."""

    overwrite: bool = False
    """Allow writing into folders, and over files, that cnclik did not make. Files that the command reads are never
    overwritten."""


def print_table(rows, header=(), *, title=None, left=1, style=lambda row: None, **look) -> None:
    """Print rows of texts as a table; the first `left` columns are aligned left; style(row) is rich's name of it."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    title = title and Text(title, style="table.title")
    shown = Table(title=title, title_justify="left", show_header=bool(header), **look)
    for i, name in enumerate(header):
        shown.add_column(Text(name), justify="left" if i < left else "right")
    for row in rows:
        shown.add_row(*map(Text, row), style=style(row))
    Console().print(shown)


_CODE = re.compile(r'\b(\w+)=(?:"([\w-]+)"|(\w+)\((.*?)\)|\((.*?)\)|(-?\d[\d.e+-]*\d|-?\d))')


def as_options(sentence: str) -> str:
    """A text of the library, with options as the command line takes them: `N=400`, `stage=chord(2)`, as in Python."""

    def option(found):
        name, text, maker, given, several, number = found.groups()
        if name not in SWEPT:
            return found[0]
        value = text or number or (several.replace(",", "") if several else maker.replace("_", "-"))
        return f"--{name.replace('_', '-')} {value}" + (f" --{_NUMBERS[name]} {given}" if given else "")

    return _CODE.sub(option, sentence)


_NUMBERS = {"inverse": "damping", "stage": "M"}  # the option of the number that Python gives to such a value
NAMES = tuple(field.name for field in dataclasses.fields(ComputeOptions))
