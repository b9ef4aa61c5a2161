"""When a display draws a stream's picture, and when the mark on a stale one."""

from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.streams.staleness import Staleness

#: How often the age on a stale picture is drawn anew.
REDRAW_NS = 100 * NS_PER_MS


class Drawing(NamedTuple):
    """Draw the newest picture of `stream`; stale_ns: its age for the mark, None for no mark."""

    stream: str
    stale_ns: int | None


class Screen:
    """Draws each picture when it comes, and a stale one again and again with its age. A core.

    Call `handle_picture` when `staleness` knows the picture, and `handle_time` at `poll_timeout`.
    Then draw what `next_event` returns.
    """

    def __init__(self, stream: str, staleness: Staleness) -> None:
        self._stream = stream
        self._staleness = staleness
        self._capture_ns = 0
        self._drawn_ns: int | None = None
        self._drawing: Drawing | None = None

    def handle_picture(self, capture_ns: int, now_ns: int) -> None:
        """A picture that was captured at `capture_ns` is shown from `now_ns` on."""
        self._capture_ns = capture_ns
        self._draw(now_ns)

    def poll_timeout(self) -> int | None:
        """Return when the mark is due next; None while there is no picture."""
        stale_from_ns = self._staleness.stale_from_ns()
        if stale_from_ns is None or self._drawn_ns is None:
            return None
        return max(stale_from_ns, self._drawn_ns + REDRAW_NS)

    def handle_time(self, now_ns: int) -> None:
        """Draw the mark if it is due."""
        due_ns = self.poll_timeout()
        if due_ns is not None and now_ns >= due_ns:
            self._draw(now_ns)

    def next_event(self) -> Drawing | None:
        """Return what to draw now, or None."""
        drawing, self._drawing = self._drawing, None
        return drawing

    def _draw(self, now_ns: int) -> None:
        self._drawn_ns = now_ns
        stale_from_ns = self._staleness.stale_from_ns()
        stale = stale_from_ns is not None and now_ns >= stale_from_ns
        self._drawing = Drawing(self._stream, now_ns - self._capture_ns if stale else None)
