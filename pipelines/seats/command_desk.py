"""Telecommands of a seat's pages: each with its answer, and a log for all pages of the seat."""

from collections import deque
from typing import NamedTuple

from msgspec.structs import replace

from kontur_av.clock import NS_PER_US
from pipelines.mission.choosing import CAMERA, SELECT
from pipelines.mission.tmtc_messages import CommandUpdate, SendCommand
from pipelines.mission.tmtc_words import selection_error
from pipelines.seats.outbox import Outbox
from pipelines.seats.page_requests import CommandRequest
from pipelines.seats.texts import CommandLine, CommandsText

_MOST_LINES = 60
_MOST_OPEN = 8
_SILENT = "telecommands of this end do not answer"


class CommandAnswered(NamedTuple):
    """What became of the request of a page.

    error: "" if it was carried out. camera: the one that it has selected; else "".
    """

    page: int
    request: int
    error: str
    round_trip_ms: float
    camera: str = ""


class CommandDesk:
    """Passes telecommands on, and keeps what became of them. A core.

    After each `handle_`, send `poll_transmit`'s requests and drain `next_event`.

    unverified: telecommands since the last one that the other end verified.
    """

    def __init__(self, client: str) -> None:
        self.unverified = 0
        self._client = client
        self._number = 0
        self._lines: deque[CommandLine] = deque(maxlen=_MOST_LINES)
        self._outbox: Outbox[SendCommand] = Outbox()
        #: By number: page and request that wait for the end.
        self._open: dict[int, tuple[int, int]] = {}
        #: By number: the camera that it selects.
        self._selects: dict[int, str] = {}
        self._events: deque[CommandAnswered] = deque()

    @property
    def text(self) -> CommandsText:
        """All telecommands that are kept, the oldest first."""
        return CommandsText(commands=tuple(self._lines))

    def handle_request(self, page: int, asked: CommandRequest, who: str, now_ns: int) -> None:
        """A page asks for a telecommand that it may give. who: its person."""
        if len(self._open) >= _MOST_OPEN:
            self._answer(page, asked.request, "too many telecommands are open")
            return
        self._number += 1
        number = self._number
        command = SendCommand(
            self._client, number, asked.application, asked.verb, asked.name, asked.arguments
        )
        self._outbox.put(number, command, now_ns)
        self._open[number] = page, asked.request
        if (asked.application, asked.name) == (CAMERA, SELECT) and asked.arguments:
            self._selects[number] = str(asked.arguments[0])
        words = " ".join(
            [asked.application, asked.name or asked.verb, *(str(one) for one in asked.arguments)]
        )
        at_us = now_ns // NS_PER_US
        self._lines.append(
            CommandLine(number=number, at_us=at_us, who=who, words=words, stage="sent")
        )

    def handle_update(self, update: CommandUpdate) -> bool:
        """What became of a telecommand; False if it is of another process."""
        if update.client != self._client:
            return False
        self._outbox.handle_answer(update.id)
        self._settle(update)
        return True

    def poll_transmit(self, now_ns: int) -> SendCommand | None:
        """Return a request for this end's socket, or None."""
        while (number := self._outbox.next_event(now_ns)) is not None:
            self._settle(
                CommandUpdate(self._client, number, "", "refused", done=True, reason=_SILENT)
            )
        return self._outbox.poll_transmit(now_ns)

    def next_event(self) -> CommandAnswered | None:
        """Return the next answer for a page, or None."""
        return self._events.popleft() if self._events else None

    def _settle(self, update: CommandUpdate) -> None:
        for index, line in enumerate(self._lines):
            if line.number == update.id and not line.done:
                self._lines[index] = replace(
                    line,
                    stage=update.stage,
                    done=update.done,
                    ok=update.ok,
                    verified=update.verified,
                    reason=update.reason,
                    round_trip_ms=update.round_trip_ms,
                    tries=update.tries,
                )
        if not update.done:
            return
        if update.verified or update.ok:
            self.unverified = 0
        elif update.stage == "failed":
            self.unverified += 1
        opened = self._open.pop(update.id, None)
        if opened is not None:
            camera = self._selects.pop(update.id, "")
            error = "" if update.ok else update.reason or update.stage
            if camera and error:
                camera, error = "", selection_error(camera, update)
            self._events.append(CommandAnswered(*opened, error, update.round_trip_ms, camera))

    def _answer(self, page: int, request: int, error: str) -> None:
        self._events.append(CommandAnswered(page, request, error, 0.0))
