"""Options, reports and tables that several verbs share."""

import contextlib
import dataclasses
import re
from pathlib import Path

from cnclik.cli import progress
from cnclik.problem.options import SWEPT
from cnclik.show.output import FigureError


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
    timings: bool = False
    """Print at the end how long importing, tracing, compiling, running and drawing took."""


@dataclasses.dataclass(kw_only=True)
class ReportOption:
    """For verbs whose result can be a page; `typed` is the command line that asked for it."""

    report: Path | None = None
    """Also write a page, FILE.html, with the answer, the numbers, the figures and the moving robot. It opens offline;
    it needs the extra `viewer`."""
    typed = ""
    undrawn = None

    @contextlib.contextmanager
    def figures_first(self):
        """Context manager for drawing a verb's figures. A failure is raised here, or after the report."""
        try:
            yield
        except FigureError as error:
            if self.report is None:
                raise
            self.undrawn = error

    def motions(self, law, *runs):
        """Runs of the loop as the report's moving robot. Args: runs: (trajectory, keywords of `motion_of`)."""
        from cnclik.problem.names import robot_name
        from cnclik.show.viewer.files import links_of
        from cnclik.show.viewer.motion import motion_of

        name, links = robot_name(self.robot, self.tip), links_of(self.robot, self.base, law.chain)
        return [motion_of(run, law, links=links, **({"name": name} | said)) for run, said in runs]

    def write_report(self, title, answer, **parts) -> None:
        """Write the page if one is asked for, and print its name; see `cnclik.show.report.Report`."""
        if self.report is None:
            return
        from cnclik.show.report import Report, write

        try:
            with progress.bar("report"):
                write(Report(title=title, answer=answer, command=self.typed, **parts), self.report)
        except FigureError as error:
            raise FigureError(f"{self.undrawn or ''} {error}") from error
        if not getattr(self, "json", False):
            print(f"Wrote {self.report}.")
        if self.undrawn:
            raise self.undrawn


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
NAMES = tuple(field.name for kind in (ComputeOptions, ReportOption) for field in dataclasses.fields(kind))
