"""Files that have their names only once all of them are whole. A shell."""

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from kontur_av.errors import ConfigError
from pipelines.recording.recording_file import check_new

_UNFINISHED = ".unfinished"


class Outputs:
    """The files of an export, as a context.

    Within it, write to `unfinished(path)`. At its end each file gets its name; after an exception
    none does, and nothing is left. An OSError within becomes a ConfigError.
    """

    def __init__(self, *, overwrite: bool) -> None:
        self._overwrite = overwrite
        self._paths: list[Path] = []
        self._made: list[Path] = []

    def check(self, paths: Iterable[Path], inputs: Iterable[Path]) -> None:
        """Raise ConfigError if one of the paths exists and may not be replaced, or is an input."""
        read = [*inputs]
        for path in paths:
            for source in read:
                if path.exists() and path.samefile(source):
                    raise ConfigError(f"{path} is the recording itself: give another name")
            check_new(path, overwrite=self._overwrite)

    def make_directory(self, path: Path) -> None:
        """Make a directory for files, if it is missing; ConfigError if that is not possible."""
        if path.exists() and not path.is_dir():
            raise ConfigError(f"{path} is no directory: give the name of one")
        try:
            path.mkdir()
            self._made.append(path)
        except FileExistsError:
            pass
        except OSError as error:
            raise ConfigError(f"{path} cannot be made: {error.strerror}") from None

    def unfinished(self, path: Path) -> Path:
        """Return the name under which to write a file; ConfigError if that is not possible."""
        unfinished = path.with_name(path.name + _UNFINISHED)
        try:
            unfinished.open("wb").close()
        except OSError as error:
            raise ConfigError(f"{path} cannot be written: {error.strerror}") from None
        self._paths.append(path)
        return unfinished

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                for path in self._paths:
                    _sync(path.with_name(path.name + _UNFINISHED))
                for path in self._paths:
                    path.with_name(path.name + _UNFINISHED).replace(path)
                self._made.clear()
        except OSError as failed:
            error = failed
        finally:
            for path in self._paths:
                with suppress(OSError):
                    path.with_name(path.name + _UNFINISHED).unlink(missing_ok=True)
            for directory in self._made:
                with suppress(OSError):
                    directory.rmdir()
        if isinstance(error, OSError):
            raise ConfigError(f"the export cannot be written: {error.strerror}") from None


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
