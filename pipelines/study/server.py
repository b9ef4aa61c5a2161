"""Serves the page of a study, and moves the handle in real time. A shell."""

import asyncio
from collections.abc import Callable

import msgspec
from aiohttp import web

from kontur_av.clock import MonotonicClock
from kontur_av.errors import ProtocolError
from pipelines.seats.open_page import MessageRate
from pipelines.seats.seat_sockets import Message, SeatSocket, SeatSockets
from pipelines.session.access import VIEWER_WORDS, AccessError, AccessKind, Found, Role
from pipelines.session.messages import MOST_SEAT_OCTETS, parse_seat_message
from pipelines.session.page_sockets import PageListener
from pipelines.session.web_site import WebSite
from pipelines.study.desk import StudyDesk, parse_press
from pipelines.study.plan import TrialResult
from telepresence.haptics.device.page import PageDevice, PageInput

_TICK_S = 0.004
#: Messages of a page; a pointer moves up to 1000 times a second, as a seat permits.
_RATE_HZ, _BURST = 1200, 400
#: In the private range of close codes (RFC 6455 section 7.4.2): another page has the study.
_TAKEN_OVER = 4001


class _Page:
    """The one page that has the study. screen: the last that it was sent."""

    def __init__(self, socket: SeatSocket) -> None:
        self.socket = socket
        self.rate = MessageRate(_RATE_HZ, _BURST)
        self.wake = asyncio.Event()
        self.screen = -1


class StudyServer:
    """Call `run`. keep: called with each trial that has finished. device: the desk's handle."""

    def __init__(
        self,
        desk: StudyDesk,
        device: PageDevice,
        listener: PageListener,
        keep: Callable[[TrialResult], None],
    ) -> None:
        self._desk, self._device, self._keep = desk, device, keep
        self._now_ns = MonotonicClock().now_ns
        self._site = WebSite(listener, seat="study")
        self._sockets = SeatSockets(self._now_ns)
        self._page: _Page | None = None

    async def run(self) -> None:
        """Serve until it is cancelled."""
        async with self._site.served("pipelines.study", self._answer, self._sockets.close):
            while True:
                self._tick()
                await asyncio.sleep(_TICK_S)

    def _tick(self) -> None:
        now_ns = self._now_ns()
        self._desk.handle_time(now_ns)
        self._sockets.handle_time(now_ns)
        while (result := self._desk.next_result()) is not None:
            self._keep(result)
        if self._page is not None:
            self._page.wake.set()

    async def _answer(self, request: web.BaseRequest, found: Found) -> web.StreamResponse:
        if found.kind is not AccessKind.SEAT:
            return self._site.file(request, found)
        if found.role is Role.VIEWER:
            raise AccessError(403, VIEWER_WORDS, "role")
        socket = await self._sockets.open(request, MOST_SEAT_OCTETS)
        last, page = self._page, _Page(socket)
        self._page = page
        if last is not None:
            await last.socket.close(_TAKEN_OVER, "another page has this study")

        async def next_message() -> Message:
            while True:
                await page.wake.wait()
                page.wake.clear()
                shown, frame = self._desk.show(self._now_ns()), self._desk.frame
                if shown.screen != page.screen:
                    page.screen = shown.screen
                    return msgspec.json.encode(shown).decode()
                if frame is not None:
                    return msgspec.json.encode(frame).decode()

        def take(message: Message) -> None:
            self._take(page, message)

        try:
            await self._sockets.serve(socket, take, next_message)
        finally:
            if self._page is page:
                self._page = None
        return socket.ws

    def _take(self, page: _Page, message: Message) -> None:
        now_ns = self._now_ns()
        if not page.rate.handle_message(now_ns):
            raise ProtocolError("too many messages")
        if page is not self._page:
            return
        if isinstance(message, str):
            self._desk.handle_press(parse_press(message), now_ns)
        elif isinstance(hand := parse_seat_message(message, now_ns), PageInput):
            self._device.handle_input(hand)
