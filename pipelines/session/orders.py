"""Safety orders in the session's directory: they outlive the processes that took them.

| file | written by | what |
|---|---|---|
| `stop` | whoever orders it | an emergency stop holds: who ordered it; removed to release it |
| `orders-robot`, `orders-joystick` | those processes | their newest orders, as JSON |

A process that starts goes on with them. If the directory is gone, or a file has other content, it
does not know what was ordered; then it starts halted and off.
"""

import os
from pathlib import Path
from typing import TypeVar

import msgspec

from kontur_av.topics.session_files import session_root
from pipelines.session.reception import replace_file
from telepresence.malformed import MALFORMED

T = TypeVar("T", bound=msgspec.Struct)
#: Of the words that say who stopped it.
_MOST_CHARACTERS = 120


class KeptOrders:
    """The orders of one session, for one process."""

    def __init__(self, session: str) -> None:
        self._root = session_root(session)
        self._stop = self._root / "stop"
        # As text, because loops look a hundred times a second, and a `Path` takes twice as long.
        # The second is there only if the first can be looked for.
        self._paths = os.fspath(self._stop), f"{self._root}/."

    @property
    def stopped(self) -> bool:
        """Whether an emergency stop holds; also if nothing is known of the session."""
        stop, root = self._paths
        # Unlike lstat(2), this raises nothing for the usual case, which takes half as long.
        return os.access(stop, os.F_OK) or not os.access(root, os.F_OK)

    @property
    def stopped_by(self) -> str:
        """Who ordered it, in words; "" if nobody did, or that is not known."""
        try:
            return self._stop.read_text("utf-8", errors="replace")[:_MOST_CHARACTERS]
        except OSError:
            return ""

    def stop(self, by: str) -> None:
        """Order an emergency stop. The first of several is kept."""
        if not self.stopped:
            replace_file(self._stop, by[:_MOST_CHARACTERS].encode())

    def release(self) -> None:
        self._stop.unlink(missing_ok=True)

    def recall(self, name: str, first: T, unknown: T) -> T:
        """Return the orders of process `name`.

        first: if there were none yet. unknown: if that cannot be told.
        """
        try:
            return msgspec.json.decode(self._path(name).read_bytes(), type=type(first))
        except FileNotFoundError:
            return first if self._root.is_dir() else unknown
        except (OSError, *MALFORMED):
            return unknown

    def keep(self, name: str, orders: msgspec.Struct) -> None:
        replace_file(self._path(name), msgspec.json.encode(orders))

    def _path(self, name: str) -> Path:
        return self._root / f"orders-{name}"
