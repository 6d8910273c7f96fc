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


NAMES = tuple(field.name for field in dataclasses.fields(ComputeOptions))
