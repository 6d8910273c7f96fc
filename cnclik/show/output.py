"""Drawing figures: a figure that fails never costs the data."""

import contextlib
import functools
import importlib
import threading

from cnclik import errors
from cnclik.writing import Refused, output_folder


class FigureError(RuntimeError):
    """Figures that could not be drawn, after all else was written; the message is one line fit for a terminal."""


def load_ahead(*modules) -> None:
    """Load modules in a thread of its own, such as what will draw, while the compiler is at work."""

    def load():
        with contextlib.suppress(Exception):  # the code that needs the module reports why it cannot be loaded
            for name in modules:
                importlib.import_module(name)

    threading.Thread(target=load, daemon=True).start()


def drawn_by(module, name, *args, **options):
    """A function without arguments that draws with a module of `cnclik.show`. The module is loaded at the call."""
    return lambda: getattr(importlib.import_module(f"cnclik.show.{module}"), name)(*args, **options)


def draw(figures, path, *, again="", progress=None, overwrite=False) -> list:
    """Draw figures in the project's style and save them in a folder. Call it after the data are written.

    Args:
      figures: {file name: (function of no arguments that returns a Figure, its description in the file)}.
      again: the command that draws them again from the data, if there is one.
      progress: called as progress(done, total, note).

    Raises: FigureError at the end, naming the figures that could not be drawn; the others are there. ArgumentError
      where the folder doesn't take one: those before it are there.
    """
    failed: dict = {}
    with output_folder(path, overwrite=overwrite) as folder:
        for done, (file, (make, about)) in enumerate(figures.items()):
            if progress is not None:
                progress(done, len(figures), f"drawing {file}")
            try:
                from cnclik.show import style  # here, where a broken installation of matplotlib costs no data

                with style.style():
                    folder.write(file, functools.partial(style.save, make(), about=about))
            except Refused:
                raise
            except Exception as error:  # noqa: BLE001 - some mistakes, as in a title's formula, appear only on saving
                failed[file] = error
    if failed:
        what = ", ".join(f"{file} ({errors.in_a_line(error)})" for file, error in failed.items())
        message = f"Not drawn: {what}; the data are kept in {path}{f', `{again}` draws again' if again else ''}."
        raise FigureError(message) from next(iter(failed.values()))
    return list(figures)
