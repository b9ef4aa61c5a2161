"""What a seat's process reads and does: its topics, recorder, launcher and the TM/TC end."""

import asyncio
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kontur_av.errors import ConfigError, ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.topics.bus import Lease, TopicBus
from pipelines.hand.hand_topics import (
    DRIVER_TOPIC,
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    JOYSTICK_STATE_TOPIC,
    POLICY_TOPIC,
    DriverState,
    HandRequest,
)
from pipelines.media.following import SELECTED_TOPIC
from pipelines.media.key_picture_maker import H264Copy
from pipelines.mission.tmtc_messages import TMTC_TOPICS
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.seats.holders import Given
from pipelines.seats.plan import Shown
from pipelines.seats.seat import PageRequest, Seat, StopAsked
from pipelines.seats.texts import FetchRequest, RecordingRequest, Via
from pipelines.seats.upkeep_watch import fetch
from pipelines.session.kept_files import KeptOrders
from pipelines.session.process import Context
from pipelines.session.recording_requests import (
    RECORDER_S,
    RECORDER_SOCKET,
    RecordAnswer,
    RecordingOptions,
    RecordRequest,
    StartRecording,
    StopRecording,
)
from pipelines.session.requests import ask_async
from pipelines.session.serving_loop import Feed, ServingLoop
from pipelines.session.session_switch import Order
from pipelines.session.setup.segments import Segment
from pipelines.session.topic import AnyTopic
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.training import TRAINER_SOCKET, TrainerAnswer, TrainerRequest
from telepresence.haptics.device.page import PageInput

#: Unread samples of a topic that are kept; of one with units, which refer to those before.
_DEPTH, _UNITS = 8, 32
#: HEVC units of a stream that wait for their copy, two seconds of 30 Hz. Newer ones are left out,
#: and copies come again with the next key picture or wave.
_MOST_COPYING = 60


#: As many news of telecommands and telemetry as their topic keeps.
_NEWS = 32


class _Fed(NamedTuple):
    """A topic that is read whenever there is something new.

    always: also while no page is open, for those who join.
    """

    topic: str
    handle: Callable[[Lease], None]
    depth: int = _DEPTH
    always: bool = False


#: A topic that changes too often to wake for it; its newest sample is read at each look.
_Looked = tuple[AnyTopic, Callable[[Any, int], None]]


class SeatTopics:
    """Reads the topics of a seat.

    While nobody looks, only the units of pictures and what telecommands and telemetry bring are
    read: what is said in the chat while no page is open must not be missed.

    settle: called when the seat was told something that came by itself.
    """

    def __init__(
        self,
        seat: Seat,
        serving: ServingLoop,
        bus: TopicBus,
        *,
        now_ns: Callable[[], int],
        settle: Callable[[], None],
    ) -> None:
        self._seat, self._now_ns, self._settle = seat, now_ns, settle
        self._serving, self._watched = serving, False
        #: By stream of HEVC: its copy for browsers, made in a thread, and units on their way there.
        self._copies: dict[int, H264Copy] = {}
        self._copying: Counter[int] = Counter()
        #: Streams whose next copy is to be a key picture.
        self._keys: set[int] = set()
        #: HEVC units of which no copy was made, because copying was behind.
        self.copies_left_out = 0
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="copies")
        fed = list(self._fed())
        feeds = [
            Feed(serving.loop, bus, one.topic, partial(self._take, one), depth=one.depth)
            for one in fed
        ]
        self._feeds = {one.topic: feed for feed, one in zip(feeds, fed, strict=True)}
        self._always = [feed for feed, one in zip(feeds, fed, strict=True) if one.always]
        self._live = [feed for feed, one in zip(feeds, fed, strict=True) if not one.always]
        self._looked: list[tuple[TopicReader[Any], Callable[[Any, int], None]]] = [
            (TopicReader(bus, topic, opened=False), handle) for topic, handle in self._states()
        ]

    def _fed(self) -> Iterator[_Fed]:
        plan = self._seat.plan
        yield _Fed(TMTC_TOPICS[plan.segment], self._news, _NEWS, always=True)
        for each in plan.streams:
            if each.via is Via.SOUND:
                yield _Fed(each.topic, partial(self._sound, each.index))
            else:
                yield _Fed(each.topic, partial(self._unit, each.index), _UNITS, always=True)
        for end, topic in plan.traces.items():
            yield _Fed(topic, partial(self._haptics, end))
        for preview, topic in plan.previews.items():
            yield _Fed(topic, partial(self._preview, preview), 1)
        if plan.segment is Segment.SPACE:
            yield _Fed(JOYSTICK_STATE_TOPIC, self._status)
            yield _Fed(POLICY_TOPIC, self._policy, always=True)

    def _states(self) -> Iterator[_Looked]:
        plan, seat = self._seat.plan, self._seat
        yield (
            plan.backlog_topic,
            lambda backlog, now_ns: seat.handle_signal(backlog.peer_heard, now_ns),
        )
        for kind, topic in plan.shown.items():
            yield topic, partial(self._shown, kind)
        if plan.segment is Segment.GROUND:
            yield (
                SELECTED_TOPIC,
                lambda choice, now_ns: seat.handle_camera(choice.camera, now_ns),
            )

    def open(self) -> None:
        for feed in self._always:
            feed.open()

    def watch(self, watching: bool) -> None:
        """Open what pages are shown with the first of them, and close it with the last."""
        self._watched = watching
        read: list[Feed | TopicReader[Any]] = [*self._live, *(state for state, _ in self._looked)]
        for feed in read:
            if watching:
                feed.open()
            else:
                feed.close()

    def look(self, now_ns: int) -> None:
        """Read what changes too often to wake for it."""
        for state, handle in self._looked:
            if (told := state.latest()) is not None:
                handle(told, now_ns)

    def ask(self) -> None:
        """Ask for the key pictures with which pages are to begin."""
        for stream in self._seat.media.poll_asks(self._now_ns()):
            if stream in self._copies:
                self._keys.add(stream)
            else:
                self._feeds[self._seat.plan.streams[stream].topic].rejoin()

    def close(self) -> None:
        for feed in self._feeds.values():
            feed.close()
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _take(self, one: _Fed, lease: Lease) -> None:
        one.handle(lease)
        self._settle()

    def _unit(self, stream: int, lease: Lease) -> None:
        unit = CodedUnit.unpack(lease.octets())
        if unit.codec == "h264":
            self._show(stream, unit, lease.stamp)
            return
        # The thread decodes every unit; while it is behind, it codes none.
        behind = self._copying[stream] >= _DEPTH
        self.copies_left_out += behind
        if self._copying[stream] >= _MOST_COPYING:
            return
        if stream not in self._copies:
            self._copies[stream] = H264Copy()
        self._copying[stream] += 1
        wanted, key = self._watched and not behind, stream in self._keys
        if wanted:
            self._keys.discard(stream)
        made = self._thread.submit(self._copies[stream].copy, unit, wanted=wanted, key=key)
        self._serving.begin(self._copied(stream, made, lease.stamp))

    async def _copied(
        self, stream: int, made: Future[CodedUnit | None], stamp: CaptureStamp
    ) -> None:
        unit = await asyncio.wrap_future(made)
        self._copying[stream] -= 1
        if unit is not None:
            self._show(stream, unit, stamp)
            self._settle()

    def _show(self, stream: int, unit: CodedUnit, stamp: CaptureStamp) -> None:
        self._seat.media.handle_unit(stream, unit, stamp, self._now_ns())

    def _sound(self, stream: int, lease: Lease) -> None:
        self._seat.media.handle_sound(stream, lease.octets(), lease.stamp)

    def _haptics(self, end: int, lease: Lease) -> None:
        self._seat.media.handle_haptics(end, lease.octets())

    def _preview(self, preview: int, lease: Lease) -> None:
        self._seat.media.handle_preview(preview, lease.video().data, lease.stamp)

    def _news(self, lease: Lease) -> None:
        news = TMTC_TOPICS[self._seat.plan.segment].unpack(lease.octets())
        self._seat.handle_news(news, self._now_ns())

    def _status(self, lease: Lease) -> None:
        status = JOYSTICK_STATE_TOPIC.unpack(lease.octets())
        self._seat.handle_status(status, self._now_ns())

    def _policy(self, lease: Lease) -> None:
        # What cannot be read is as if it was not said: its program falls silent.
        with suppress(ProtocolError):
            message = POLICY_TOPIC.unpack(lease.octets())
            self._seat.handle_policy(message, self._now_ns())

    def _shown(self, kind: str, shown: Shown, now_ns: int) -> None:
        self._seat.handle_shown(kind, shown, now_ns)


class SeatDeeds:
    """What a seat's process does to others. settle: called when the seat was told an answer."""

    def __init__(
        self,
        seat: Seat,
        context: Context,
        serving: ServingLoop,
        bus: TopicBus,
        settle: Callable[[], None],
    ) -> None:
        self._seat, self._context, self._serving, self._settle = seat, context, serving, settle
        self._now_ns = context.clock.now_ns
        self._orders = KeptOrders(context.session)
        self._hand = self._commands = self._drivers = None
        if seat.plan.segment is Segment.SPACE:
            self._hand = TopicWriter(bus, HAND_INPUT_TOPIC)
            self._commands = TopicWriter(bus, HAND_REQUEST_TOPIC)
            self._drivers = TopicWriter(bus, DRIVER_TOPIC)
        self._own = {
            each.index: bus.writer(
                each.topic,
                max_octets=each.size[0] * each.size[1] * 3 // 2 if each.size else 2 * 960,
            )
            for each in seat.plan.inputs
        }

    def do(self) -> None:
        while (event := self._seat.next_event()) is not None:
            match event:
                case PageInput():
                    if self._hand is not None:
                        self._hand.publish(event, event.received_ns)
                case DriverState():
                    if self._drivers is not None:
                        self._drivers.publish_read(event, self._now_ns())
                case HandRequest():
                    if self._commands is not None:
                        self._commands.publish(event, self._now_ns())
                case Order():
                    self._context.order(event, self._now_ns())
                case StopAsked():
                    # One that cannot be kept is not shown as a stop.
                    with suppress(OSError):
                        if event.stop:
                            self._orders.stop(event.by)
                        else:
                            self._orders.release(event.by)
                case PageRequest():
                    self._serving.begin(self._ask(event))
                case _:
                    # One that is not taken now is repeated.
                    send_to_tmtc(self._context.session, self._seat.plan.segment, event)

    def look(self, now_ns: int) -> None:
        """See whether an emergency stop is kept here."""
        self._seat.handle_stop(self._orders.stopped, self._orders.stopped_by, now_ns)

    def publish(self, given: Given) -> None:
        """Publish what a page's own camera or microphone gives."""
        writer, size = self._own[given.input.index], given.input.size
        if size is None:
            writer.publish_octets(bytes(given.data), given.stamp)
            return
        loan = writer.loan_picture(*size)
        loan.payload[:] = np.frombuffer(given.data, np.uint8)
        loan.publish(given.stamp)

    async def _ask(self, asked: PageRequest) -> None:
        session, request = self._context.session, asked.request
        error = ""
        try:
            if isinstance(request, FetchRequest):
                await fetch(session, self._seat.plan.segment, request.inbox)
            elif isinstance(request, RecordingRequest):
                await ask_recorder(session, begin=request.action == "start")
            else:
                options = TrainerRequest(
                    exercise=request.exercise, seconds=request.seconds, camera=request.camera
                )
                await ask_async(session, TRAINER_SOCKET, options, TrainerAnswer)
        except (ConfigError, OSError) as refused:
            error = str(refused)
        self._seat.handle_answered(asked, error)
        self._settle()


async def ask_recorder(session: str, *, begin: bool) -> None:
    """Begin or end the recording of `session`; errors as of `ask_async`.

    The file is in the directory in which the session was started. It is called after the session
    and the time, in UTC.
    """
    request: RecordRequest = StopRecording()
    if begin:
        instant = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
        path = Path.cwd() / f"{session}-{instant}.mcap"
        options = RecordingOptions(file=os.fspath(path), command="the page of ground control")
        request = StartRecording(options=options)
    await ask_async(session, RECORDER_SOCKET, request, RecordAnswer, timeout_s=RECORDER_S)
