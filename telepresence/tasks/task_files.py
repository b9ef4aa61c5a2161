"""Loads the built-in catalogue, and users' own files of tasks. A shell."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from kontur_av.errors import ConfigError
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.reader import read_tasks

#: The schema of a file of tasks, and the tasks that are built in.
SCHEMA = Path(__file__).with_name("tasks.xsd")
BUILT_IN = Path(__file__).with_name("catalogue.xml")


@cache
def built_in_tasks() -> Catalogue:
    """The built-in catalogue."""
    return read_tasks(BUILT_IN.read_bytes())


def load_tasks(files: Sequence[Path] = ()) -> Catalogue:
    """The built-in catalogue and what `files` define; a ConfigError names file and line."""
    catalogue = built_in_tasks()
    for path in files:
        try:
            octets = path.read_bytes()
        except OSError as error:
            raise ConfigError(f"cannot read tasks {path}: {error.strerror or error}") from None
        try:
            catalogue = read_tasks(octets, catalogue)
        except ConfigError as error:
            raise ConfigError(f"tasks {path}, {error}") from None
    return catalogue
