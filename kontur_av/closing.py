"""What is closed at the end of a `with`."""

from typing import Self


class Closing:
    """A context manager for a class with `close`."""

    def close(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
