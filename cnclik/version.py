"""The version, where any room may read it."""

__version__ = "0.4.0"
