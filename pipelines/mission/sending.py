"""Sends a telecommand to a running session, and tells what becomes of it."""

import time
from collections.abc import Iterator

from kontur_av.clock import NS_PER_S
from kontur_av.topics.bus import Reader
from pipelines.mission.tmtc_messages import (
    CommandUpdate,
    Reported,
    SendCommand,
    TmtcNews,
    unpack_news,
)
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.session.setup.segments import Segment

#: The end of a session says at once that it has the telecommand; else it is asked again.
_AGAIN_NS = NS_PER_S // 2
_TAKEN_NS = 3 * NS_PER_S
#: That end gives a telecommand up after 30 s.
_PATIENCE_NS = 45 * NS_PER_S
_LOOK_NS = NS_PER_S // 20
#: What a telecommand asked for comes with its verification; reports may come a little later.
_REPORTS = {"report": "housekeeping", "parameters": "parameters"}


class Sending:
    """Sends a request until the end has taken it, then follows what is said of it."""

    def __init__(self, session: str, origin: Segment, request: SendCommand, reader: Reader) -> None:
        self._session, self._origin = session, origin
        self._request = request
        self._reader = reader
        self._taken = False
        self._stage = ""
        #: The report that was asked for has come, or none was.
        self._reported = request.verb not in _REPORTS
        #: Its end, once it has come.
        self.done: CommandUpdate | None = None

    def news(self) -> Iterator[CommandUpdate | Reported]:
        """Yield what becomes of it, last its end; and the report that it asked for."""
        begun_ns = time.monotonic_ns()
        again_ns = end_ns = begun_ns
        while True:
            now_ns = time.monotonic_ns()
            if self.done is not None and (self._reported or now_ns >= end_ns):
                return
            if not self._taken and now_ns >= again_ns:
                again_ns = now_ns + _AGAIN_NS
                send_to_tmtc(self._session, self._origin, self._request)
            if now_ns - begun_ns > (_PATIENCE_NS if self._taken else _TAKEN_NS):
                return
            self._reader.wait(_LOOK_NS)
            while (octets := self._reader.next_octets()) is not None:
                fresh = self._take(unpack_news(octets))
                if fresh is not None:
                    yield fresh
            if self.done is not None and end_ns == begun_ns:
                end_ns = time.monotonic_ns() + _AGAIN_NS if self.done.ok else now_ns

    def _take(self, news: TmtcNews | None) -> CommandUpdate | Reported | None:
        """Return news of this telecommand that were not told yet."""
        request = self._request
        if isinstance(news, CommandUpdate):
            if (news.client, news.id) != (request.client, request.id):
                return None
            self._taken = True
            known, self._stage = self._stage, news.stage
            self.done = news if news.done else None
            return None if news.stage == known else news
        if isinstance(news, Reported) and not self._reported:
            wanted = news.kind == _REPORTS[request.verb] and news.application == request.application
            if wanted and request.name in ("", news.name):
                self._reported = True
                return news
        return None
