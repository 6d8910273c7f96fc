"""Options that verbs share besides those of a problem."""

import dataclasses


@dataclasses.dataclass(kw_only=True)
class CacheOption:
    """For every verb."""

    cache: bool = True
    """Keep compiled programs in the user's cache folder, and take them from there."""


@dataclasses.dataclass(kw_only=True)
class ComputeOptions(CacheOption):
    """For verbs that compute."""

    timings: bool = False
    """Tell at the end how long importing, tracing, compiling, running and drawing took."""


_OPTIONS = {  # what the library's remedies speak of, as it is written on the command line
    "damped(...)": "--damping",
    "error_clamp": "--error-clamp",
    "limits saturation()": "--limits saturation",
    "the stage with chord(2)": "the stage with --stage chord --M 2",
    "method EXP-MIDPOINT": "--method EXP-MIDPOINT",
    "(feedforward=1)": "(--feedforward 1)",
}


def as_options(sentence: str) -> str:
    """A remedy in the words of Python in those of the command line."""
    for word, option in _OPTIONS.items():
        sentence = sentence.replace(word, option)
    return sentence


NAMES = tuple(field.name for field in dataclasses.fields(ComputeOptions))
