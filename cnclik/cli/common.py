"""Options, reports and tables that several verbs share."""

import contextlib
import dataclasses
import re
from pathlib import Path

from cnclik.cli import progress
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


_OPTIONS = {  # words of the library's remedies, and the options for them
    r"\bdamped\((.*?)\) in place of \w+\(\)": r"--inverse damped --damping \1",
    r"\bdamped\((.*?)\)": r"--damping \1",
    r"an error_clamp of \((.*?), (.*?)\)": r"--error-clamp \1 \2",
    r"limits velocity_scaling\(\)": "--limits velocity-scaling",
    r"the stage with chord\(2\)": "the stage with --stage chord --M 2",
    "method EXP-MIDPOINT": "--method EXP-MIDPOINT",
    r"\(feedforward=1\)": "(--feedforward 1)",
    r"pseudoinverse\(\)": "--inverse pseudoinverse",
    r"N = (\d+) steps": r"--N \1",
    r"period = (\S+) s": r"--period \1",
    r"limits (saturation|bounded)\(\)": r"--limits \1",
    "feedback commanded": "--feedback commanded",
}


def as_options(sentence: str) -> str:
    """A remedy of the library with the options of the command line."""
    for word, option in _OPTIONS.items():
        sentence = re.sub(word, option, sentence)
    return sentence


NAMES = tuple(field.name for kind in (ComputeOptions, ReportOption) for field in dataclasses.fields(kind))
