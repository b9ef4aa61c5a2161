"""The process that serves a segment's browser pages."""

import asyncio
from collections.abc import Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path

from aiohttp import web

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.topics.bus import TopicBus
from pipelines.mission.supervisor import session_dictionary
from pipelines.seats.holders import Given
from pipelines.seats.page_metrics import PageMetrics
from pipelines.seats.plan import seat_plan, welcome_text
from pipelines.seats.seat import Seat
from pipelines.seats.seat_sockets import Message, SeatSockets
from pipelines.seats.seat_topics import SeatDeeds, SeatTopics
from pipelines.seats.texts import pack_text
from pipelines.seats.upkeep_watch import UpkeepWatch
from pipelines.session.access import VIEWER_WORDS, AccessError, AccessKind, Found, Role
from pipelines.session.mission_messages import TaskListed
from pipelines.session.page_messages import MOST_SEAT_OCTETS, most_media_octets
from pipelines.session.process import Context
from pipelines.session.serving_loop import ServingLoop
from pipelines.session.setup.segments import Segment
from pipelines.session.topology.topics import PAGES
from pipelines.session.web_site import WebSite
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary


def run_page(
    context: Context,
    *,
    segment: Segment,
    tasks: Sequence[TaskListed] = (),
    files: Mapping[Segment, Path] | None = None,
) -> None:
    """Serve the pages of `segment` on the socket that the launcher has bound.

    tasks: those of the session, for the panel. files: directories of the ends of this machine, for
        the pages of the ground.
    """

    async def serve() -> None:
        with context.open_bus() as bus:
            await PageServer(context, segment, bus, tasks, files or {}).run()

    asyncio.run(serve())


#: Sockets of cameras and microphones beyond these are refused.
_MOST_MEDIA = 16
#: Answers that a camera or a microphone has not read; it is closed at the next one.
_MOST_ANSWERS = 16
#: By end: the pages beside the seat of the same name; "" is where people choose one.
_OTHERS = {
    Segment.SPACE: ("", "panel", "k2cp", "trainer"),
    Segment.GROUND: ("", "top", "k2sv", "systems", "trainer"),
}
#: How often a policy's hand moves, and how often it is looked whether there is one.
_POLICY_S, _DRIVER_S = 0.01, 0.1
#: In the query of a socket: without pictures, sound and haptics.
_PLAIN = "plain"


class PageServer:
    """Serves the pages of `segment` until `context.stopping`.

    tasks, files: as of `run_page`.
    """

    def __init__(
        self,
        context: Context,
        segment: Segment,
        bus: TopicBus,
        tasks: Sequence[TaskListed],
        files: Mapping[Segment, Path],
    ) -> None:
        self._context, self._now_ns = context, context.clock.now_ns
        self._listener = context.pages[PAGES[segment]]
        self._site = WebSite(self._listener, seat=segment.value, others=_OTHERS[segment])
        dictionary = session_dictionary(built_in_dictionary(), context.topology)
        plan = seat_plan(context.topology, segment, context.session, dictionary, tasks=tasks)
        self._seat = Seat(plan, first_command=self._now_ns())
        self._serving = ServingLoop(context, self._handle_time)
        self._sockets = SeatSockets(self._now_ns)
        self._wakes: dict[int, asyncio.Event] = {}
        self._media, self._watched = 0, False
        self._topics = SeatTopics(
            self._seat, self._serving, bus, now_ns=self._now_ns, settle=self._settle
        )
        self._deeds = SeatDeeds(self._seat, context, self._serving, bus, self._settle)
        self._upkeep = UpkeepWatch(context.session, self._seat, self._serving, files, self._now_ns)

    async def run(self) -> None:
        """Serve, and close all sockets in the end."""
        self._context.on_flush(self._publish)
        self._topics.open()
        self._policy_time()
        if self._context.link is not None:
            self._serving.loop.add_reader(self._context.link.fileno(), self._metrics)
        try:
            async with self._site.served("pipelines.seats", self._answer, self._sockets.close):
                await self._serving.run()
        finally:
            self._timer.cancel()
            self._topics.close()

    def _handle_time(self, now_ns: int) -> None:
        if self._watched:
            self._topics.look(now_ns)
            self._deeds.look(now_ns)
            self._upkeep.look(now_ns)
            self._seat.handle_time(now_ns)
            self._settle()
        self._sockets.handle_time(now_ns)

    def _metrics(self) -> None:
        while (news := self._context.receive_news()) is not None:
            self._seat.handle_session(news, self._now_ns())
        self._settle()

    def _policy_time(self) -> None:
        """Move the hand of a policy every 10 ms; without one, see ten times a second who drives."""
        self._seat.handle_policy_time(self._now_ns())
        self._settle()
        period_s = _POLICY_S if self._seat.policy.name else _DRIVER_S
        self._timer = self._serving.loop.call_later(period_s, self._policy_time)

    def _watch(self) -> None:
        self._watched = self._seat.watched
        self._topics.watch(self._watched)
        # The launcher sends figures only when it knows.
        self._context.flush(self._now_ns())

    def _settle(self) -> None:
        """Do what the seat has decided, and wake the pages for which something waits."""
        if self._watched is not self._seat.watched:
            self._watch()
        self._deeds.do()
        for number, wake in self._wakes.items():
            if self._seat.waits(number):
                wake.set()
        self._topics.ask()

    # HTTP

    async def _answer(self, request: web.BaseRequest, found: Found) -> web.StreamResponse:
        if found.kind is AccessKind.SEAT:
            return await self._serve_seat(request, found.role)
        if found.kind is AccessKind.MEDIA:
            return await self._serve_media(request, found.role)
        options = self._context.topology.options
        listener, segment = self._listener, self._seat.plan.segment
        people = {Role.VIEWER.value: listener.viewer_token, **listener.people}
        ports = dict(listener.ports)
        text = welcome_text(
            found.role,
            segment,
            ports=ports,
            people=people,
            tasks=options.tasks,
            trainer=options.trainer,
        )
        return self._site.file(request, found, {"__WELCOME__": escape(pack_text(text))})

    # The socket of a page

    async def _serve_seat(self, request: web.BaseRequest, role: Role) -> web.StreamResponse:
        if self._seat.is_full(role):
            raise AccessError(503, "too many pages are open", "pages")
        page = await self._sockets.open(request, MOST_SEAT_OCTETS)
        if request.transport is None:
            return page.ws
        plain = request.query_string == _PLAIN
        number = self._seat.handle_opened(role, self._now_ns(), plain=plain)
        self._wakes[number] = asyncio.Event()
        self._settle()
        take, send = partial(self._take_seat, number), partial(self._next_message, number)
        try:
            await self._sockets.serve(page, take, send)
        finally:
            self._wakes.pop(number)
            self._seat.handle_closed(number, self._now_ns())
            self._settle()
        return page.ws

    async def _next_message(self, number: int) -> Message:
        wake = self._wakes[number]
        while (message := self._seat.poll_transmit(number)) is None:
            wake.clear()
            await wake.wait()
        return message

    def _take_seat(self, number: int, message: Message) -> None:
        if isinstance(message, bytes):
            self._seat.handle_message(number, message, self._now_ns())
        else:
            self._seat.handle_text(number, message, self._now_ns())
        if self._seat.overflowed(number):
            raise ProtocolError("answers are not read")
        self._settle()

    # The socket of a page's own camera or microphone

    async def _serve_media(self, request: web.BaseRequest, role: Role) -> web.StreamResponse:
        if role is Role.VIEWER:
            raise AccessError(403, VIEWER_WORDS, "role")
        if self._media >= _MOST_MEDIA:
            raise AccessError(503, "too many cameras and microphones are open")
        seat = self._seat
        page = await self._sockets.open(request, most_media_octets(seat.plan.sizes))
        number = seat.handle_media_opened(role)
        self._media += 1
        answers: asyncio.Queue[Message] = asyncio.Queue(_MOST_ANSWERS)
        try:
            await self._sockets.serve(page, partial(self._take_media, number, answers), answers.get)
        finally:
            self._media -= 1
            seat.inputs.handle_closed(number)
        return page.ws

    def _take_media(self, number: int, answers: "asyncio.Queue[Message]", message: Message) -> None:
        now_ns, inputs = self._now_ns(), self._seat.inputs
        result: Message | Given | None
        if isinstance(message, bytes):
            result = inputs.handle_message(number, message, now_ns)
        else:
            result = inputs.handle_text(number, message, now_ns)
        if isinstance(result, Given):
            self._deeds.publish(result)
        elif result is not None:
            if answers.full():
                raise ProtocolError("answers are not read")
            answers.put_nowait(result)

    def _publish(self) -> None:
        sockets, guest = self._sockets, self._seat.policy
        self._context.probe.publish(
            PageMetrics(
                watching=self._seat.watching,
                holder=self._seat.holder or 0,
                driver=guest.who,
                driven_ms={who: ns // NS_PER_MS for who, ns in guest.driven_ns.items()},
                drivers=tuple(guest.events),
                connections=sockets.connections,
                refused=dict(self._site.refused),
                unauthenticated_closed=self._site.closed,
                faults=self._site.faults,
                garbage=sockets.garbage,
                units_left_out=self._seat.left_out,
                copies_left_out=self._topics.copies_left_out,
                sockets_closed=sockets.closed,
            )
        )
