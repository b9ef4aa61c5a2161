"""Figures as a process reports them, for tests of their receivers."""

from pipelines.cores.probe import Series


def series(rows, stream=""):
    """A series of rows of one type."""
    told = Series(type(rows[0]), stream)
    told.extend(rows)
    return told
