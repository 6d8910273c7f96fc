"""One study over a labelled grid, on disk and resumable."""
