"""A user's device whose calls must return: none of them holds up a check for ever."""

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Thread
from time import monotonic, sleep
from types import FrameType
from typing import Any

from kontur_av.returned import PartError, fault_of
from pipelines.session.command_process import handled
from telepresence.haptics.specs import load_robot

#: A call that opens a device or gives it power may take longer.
_MOST_S = 5.0
_OPENING_S = 30.0
_OPENING = ("configure", "power_on")
#: These are tried also after a call that did not return.
_ENDING = ("deactivate", "power_off", "close")
#: A call that not even a signal ends has this much longer.
_DEAF_S = 3.0


class _Overdue(BaseException):
    """Raised within the call; a driver that catches every Exception does not catch this."""


class TimedCalls:
    """`device` with a time for each call. A longer one raises PartError, which names it."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._name, self._due_s = "", 0.0
        self._overdue = ""

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._device, name)
        if not callable(found):
            return found
        call = self._timed(name, found)
        setattr(self, name, call)
        return call

    def _timed(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        most_s = _OPENING_S if name in _OPENING else _MOST_S

        def call(*arguments: Any) -> Any:
            if self._overdue and name not in _ENDING:
                raise PartError(self._overdue)
            self._name, self._due_s = name, monotonic() + most_s
            signal.setitimer(signal.ITIMER_REAL, most_s, 1.0)
            try:
                return method(*arguments)
            except _Overdue:
                self._overdue = f"{name}() has not returned for {most_s:g} s"
                raise PartError(self._overdue) from None
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                self._due_s = 0.0

        return call

    def watch(self) -> None:
        """End the program if a call returns not even at the signal; for a thread of its own."""
        while True:
            sleep(0.5)
            due_s = self._due_s
            if due_s and monotonic() > due_s + _DEAF_S:
                print(f"kontur-av: {self._name}() does not return: fix it", file=sys.stderr)
                os._exit(1)


@contextmanager
def timed(device: Any) -> Iterator[Any]:
    """Yield `device` with timed calls. Only in the main thread."""

    def overdue(_number: int, _frame: FrameType | None) -> None:
        raise _Overdue

    calls = TimedCalls(device)
    Thread(target=calls.watch, daemon=True).start()
    with handled(overdue, (signal.SIGALRM,)):
        yield calls


def take_power(spec: str, axes: Sequence[str] = ()) -> None:
    """Take a robot's power by a driver that is built anew. PartError if it may still have some."""
    device = load_robot(spec, axes)
    anew = ("configure", "deactivate", "power_off")
    wrong = []
    with timed(device) as calls:
        for name in ("emergency_off",) if hasattr(device, "emergency_off") else anew:
            try:
                getattr(calls, name)()
            except Exception as error:
                # One that does not brake may still lose its power.
                wrong += [fault_of(f"{name}()", error)] * (name != "deactivate")
    if wrong:
        raise PartError("; ".join(wrong))
