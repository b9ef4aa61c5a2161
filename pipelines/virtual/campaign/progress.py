"""How far a campaign is, on standard error: one line, written over, or a line now and then."""

import sys
import time

#: Between two lines where they cannot be written over.
_EVERY_S = 10.0


class Progress:
    """Tells `done` of `total` things. what: their name in the plural."""

    def __init__(self, total: int, what: str) -> None:
        self._total, self._what = total, what
        self._began_s = time.monotonic()
        self._told_s = self._began_s - _EVERY_S
        self._terminal = sys.stderr.isatty()

    def told(self, done: int, note: str = "") -> None:
        """`done` are over by now. note: about the last of them."""
        now_s = time.monotonic()
        last = done == self._total
        if not (self._terminal or last or now_s - self._told_s >= _EVERY_S):
            return
        self._told_s = now_s
        left = self._left(done, now_s - self._began_s)
        line = f"{done} of {self._total} {self._what}{left}{note and '; ' + note}"
        end = "\n" if last or not self._terminal else ""
        print(f"\r\x1b[K{line}" if self._terminal else line, end=end, file=sys.stderr, flush=True)

    def _left(self, done: int, took_s: float) -> str:
        if not 0 < done < self._total:
            return f" in {took_s:.0f} s" if done else ""
        left_s = took_s / done * (self._total - done)
        return (
            f", about {left_s / 60:.0f} min left" if left_s > 90 else f", about {left_s:.0f} s left"
        )
