"""A seat: what its pages are sent, and what comes of what they send."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import count
from types import MappingProxyType
from typing import NamedTuple

from msgspec.structs import replace

from kontur_av.clock import NS_PER_MS, NS_PER_US
from kontur_av.errors import ProtocolError
from kontur_av.media import I420, CaptureStamp, Quality
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.hand_topics import HandRequest, JoystickStatus
from pipelines.hand.haptic_trace import rows_of
from pipelines.media.unit_history import KeptUnit, UnitHistory
from pipelines.mission.tmtc_messages import TmtcNews, TmtcRequest
from pipelines.seats import texts
from pipelines.seats.client_queue import ClientQueue, Message
from pipelines.seats.figures_log import FiguresLog
from pipelines.seats.hand_gate import HandGate
from pipelines.seats.joystick_desk import JoystickDesk
from pipelines.seats.mission_desk import MissionDesk
from pipelines.seats.own_inputs import OwnInputs
from pipelines.seats.ownership import HandleOwnership
from pipelines.seats.plan import SeatPlan, Shown, Via
from pipelines.seats.rates import TokenBucket
from pipelines.session.figures import HOLDER
from pipelines.session.messages import (
    DAMAGED,
    KEY,
    REPLAYED,
    Ping,
    pack_haptic,
    pack_pong,
    pack_preview,
    pack_sound,
    pack_unit,
    parse_seat_message,
)
from pipelines.session.seat_roles import VIEWER_WORDS, Role, refusal
from pipelines.session.session_switch import Order
from pipelines.session.setup.segments import Segment
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.states import JoystickEvent, JoystickState

HEARTBEAT_NS = 100 * NS_PER_MS
_TEXT_HZ = _PING_HZ = 20
_HAND_HZ = 1200
#: By request: what the role of a page must permit.
_DEEDS: Mapping[type[texts.SeatRequest], str] = MappingProxyType(
    {
        texts.JoystickRequest: "joystick",
        texts.HandRequest: "hand",
        texts.SessionRequest: "session",
        texts.RecordRequest: "record",
    }
)


class HandMoved(NamedTuple):
    """What to tell the joystick of the hand."""

    hand: PageInput


class CommandGiven(NamedTuple):
    """A command for the joystick."""

    request: HandRequest


class SessionOrdered(NamedTuple):
    """The launcher is to stop or to start the session."""

    order: Order


class RecordingAsked(NamedTuple):
    """The recorder is to begin or to end; pass its answer to `handle_recorder`."""

    page: int
    request: int
    begin: bool


class TmtcAsked(NamedTuple):
    """The TM/TC end of this segment is to be told this."""

    request: TmtcRequest


Event = HandMoved | CommandGiven | SessionOrdered | RecordingAsked | TmtcAsked


@dataclass
class _Page:
    """plain: without pictures, sound and haptics.

    idle: it has taken all that there was, so it would take more at once.
    """

    number: int
    role: Role
    queue: ClientQueue
    plain: bool = False
    idle: bool = True
    texts: TokenBucket = field(default_factory=lambda: TokenBucket(_TEXT_HZ, _TEXT_HZ))
    pings: TokenBucket = field(default_factory=lambda: TokenBucket(_PING_HZ, _PING_HZ))
    hands: TokenBucket = field(default_factory=lambda: TokenBucket(_HAND_HZ, _HAND_HZ))


class Seat:
    """One seat and its pages. A core.

    Pages are known by numbers from `handle_opened`. What they send is passed to `handle_message`
    and `handle_text`; these raise ProtocolError where a page is to be closed. After each `handle_`
    drain `next_event`, and send to each page what `poll_transmit` returns, as far as it takes it.

    first_command: above the numbers of all commands of an earlier life of this process.
    """

    def __init__(self, plan: SeatPlan, *, first_command: int) -> None:
        self.plan = plan
        self.inputs = OwnInputs(plan)
        self._numbers = count(1)
        self._pages: dict[int, _Page] = {}
        self._histories = {
            each.index: UnitHistory(
                pictures=each.decoded_topic is not None, filmed=bool(each.filmed_topics)
            )
            for each in plan.streams
            if each.via is not Via.SOUND
        }
        self._hand = HandleOwnership()
        self._gate = HandGate(self._hand)
        self._desk = JoystickDesk(first_command)
        self.mission = MissionDesk(
            plan.segment, plan.dictionary, client=f"page.{plan.segment.value}.{first_command}"
        )
        self._figures = FiguresLog()
        self._joystick: texts.JoystickText | None = None
        self._signal: bool | None = None
        self._camera: str | None = None
        self._due_ns = 0
        self._events: deque[Event] = deque()
        self._left_out = 0

    # The pages

    @property
    def watching(self) -> int:
        """How many pages are open."""
        return len(self._pages)

    @property
    def left_out(self) -> int:
        """Units and blocks of sound that pages were too slow for."""
        return self._left_out + sum(page.queue.units_left_out for page in self._pages.values())

    @property
    def holder(self) -> int | None:
        """Number of the page that holds the handle; ground control is told it by the launcher."""
        if self.plan.segment is Segment.GROUND:
            return self._figures.number(HOLDER)
        return self._hand.state.holder

    def handle_opened(self, role: Role, now_ns: int, *, plain: bool = False) -> int:
        """A page has come; return its number. plain: it gets no picture, sound or haptics."""
        number = next(self._numbers)
        lanes = () if plain else self._histories
        page = self._pages[number] = _Page(number, role, ClientQueue(lanes), plain)
        if role is Role.OPERATOR or not refusal(role, self.plan.segment, "hand"):
            self._hand.handle_joined(number)
        seat = replace(self.plan.text, streams=(), previews=()) if plain else self.plan.text
        page.queue.put_answer(
            texts.hello(seat, role=role.value, page=number, now_us=now_ns // NS_PER_US)
        )
        self._tell_mission()
        for kind, text in self.mission.texts.items():
            page.queue.put_newest(kind, text)
        page.queue.put_state(self._state_text(number, now_ns))
        figures = self._figures.joined_text()
        if figures is not None:
            page.queue.put_figures(figures)
        self._replay(page)
        return number

    def handle_closed(self, number: int, now_ns: int) -> None:
        """A page is gone; its hand lets go at once."""
        self._left_out += self._pages.pop(number).queue.units_left_out
        self._hand.handle_gone(number)
        self._settle_hand(now_ns)

    def handle_media_opened(self, role: Role) -> int:
        """The socket of a page's own camera or microphone was opened; return its number."""
        number = next(self._numbers)
        self.inputs.handle_opened(number, role)
        return number

    def overflowed(self, number: int) -> bool:
        """Whether a page asks and does not read its answers, and is to be closed."""
        return self._pages[number].queue.overflowed

    def waits(self, number: int) -> bool:
        """Whether `poll_transmit` has something for a page."""
        return bool(self._pages[number].queue)

    def poll_transmit(self, number: int) -> Message | None:
        """Return the next message for a page, or None. Call it when the page can take one."""
        page = self._pages[number]
        message = page.queue.pop()
        if message is None:
            # It has taken all, so it can take a replay of what was left out.
            self._replay(page)
            message = page.queue.pop()
        page.idle = message is None
        return message

    def next_event(self) -> Event | None:
        """Return what is to be done, or None."""
        return self._events.popleft() if self._events else None

    # What pages send

    def handle_message(self, number: int, data: bytes, now_ns: int) -> None:
        """A page has sent octets."""
        page = self._pages[number]
        message = parse_seat_message(data, now_ns)
        if isinstance(message, Ping):
            if not page.pings.handle_message(now_ns):
                raise ProtocolError("too many pings")
            page.queue.put_pong(pack_pong(message.page_ms, now_ns // NS_PER_US))
            return
        if not page.hands.handle_message(now_ns):
            raise ProtocolError("too many positions of the hand")
        hand = self._gate.handle_input(number, message)
        if hand is not None:
            self._events.append(HandMoved(hand))

    def handle_text(self, number: int, text: str, now_ns: int) -> None:
        """A page has sent a text."""
        page = self._pages[number]
        if not page.texts.handle_message(now_ns):
            raise ProtocolError("too many requests")
        request = texts.parse_seat_request(text)
        if page.role is Role.VIEWER:
            self._answer(number, request.request, VIEWER_WORDS)
            return
        if isinstance(request, texts.CommandRequest):
            refused = self.mission.handle_command(number, page.role, request, now_ns)
            if refused is not None:
                self._answer(number, request.request, refused)
            self._settle_mission(now_ns)
            return
        if isinstance(request, texts.ChatRequest):
            error = self.mission.handle_chat(page.role, request, now_ns)
            self._answer(number, request.request, error)
            self._settle_mission(now_ns)
            return
        if page.role is not Role.OPERATOR:
            refused = refusal(page.role, self.plan.segment, _DEEDS[type(request)])
            if refused:
                self._answer(number, request.request, refused)
                return
        match request:
            case texts.JoystickRequest():
                self._handle_command(number, request, now_ns)
            case texts.HandRequest():
                error = self._handle_hand(number, request.action)
                self._answer(number, request.request, error)
                self._settle_hand(now_ns)
            case texts.SessionRequest():
                self._handle_order(number, request)
            case texts.RecordRequest():
                self._handle_record(number, request)

    def _handle_command(self, number: int, request: texts.JoystickRequest, now_ns: int) -> None:
        if self.plan.segment is not Segment.SPACE:
            self._answer(number, request.request, "the joystick is at the operator's seat")
            return
        self._desk.handle_request(number, request.request, JoystickEvent(request.event))
        self._settle_desk(now_ns)

    def _handle_hand(self, number: int, action: str) -> str:
        if self.plan.segment is not Segment.SPACE:
            return "the handle is at the operator's seat"
        handlers: dict[str, Callable[[int], str]] = {
            "take": self._hand.handle_take,
            "give": self._hand.handle_give,
            "ask": self._hand.handle_ask,
            "refuse": self._hand.handle_refuse,
        }
        return handlers[action](number)

    def _handle_order(self, number: int, request: texts.SessionRequest) -> None:
        if not self.plan.orders:
            self._answer(number, request.request, "ground control starts and stops the session")
            return
        self._events.append(SessionOrdered(Order(request.action)))
        self._answer(number, request.request, "")

    def _handle_record(self, number: int, request: texts.RecordRequest) -> None:
        if self.plan.segment is not Segment.GROUND:
            self._answer(number, request.request, "ground control records the session")
            return
        begin = request.action == "start"
        self._events.append(RecordingAsked(number, request.request, begin))

    # What topics and the launcher tell

    def handle_unit(self, stream: int, unit: CodedUnit, stamp: CaptureStamp, now_ns: int) -> None:
        """An access unit of a stream."""
        history = self._histories[stream]
        kept = history.handle_unit(unit, stamp, now_ns)
        if kept is None or not self._pages:
            return
        message = _packed(stream, kept)
        for page in self._seeing():
            lane = page.queue.lane(stream)
            if lane.open or not page.idle:
                lane.put_unit(message, key=kept.key)
            else:
                self._replay(page)

    def handle_decoded(self, stream: int, key: bytes, rtp_timestamp: int) -> bool:
        """The picture of a unit, as a key unit. False: that unit is not known."""
        taken = self._histories[stream].handle_picture(key, rtp_timestamp)
        self._replay_idle()
        return taken

    def handle_filmed(self, stream: int, key: bytes, sequence: int) -> bool:
        """What was filmed for the unit of this number, as a key unit. False: it is not known."""
        taken = self._histories[stream].handle_filmed(key, sequence)
        self._replay_idle()
        return taken

    def wanted_pictures(self) -> list[int]:
        """Streams of which the shell is to fetch a decoded picture for `handle_decoded`."""
        return [index for index in self._joined() if self._histories[index].needs_picture]

    def wanted_filmed(self) -> dict[int, str]:
        """By stream: the topic of pictures that the shell is to fetch for `handle_filmed`."""
        camera = self._camera
        if camera is None:
            return {}
        topics = {each.index: each.filmed_topics for each in self.plan.streams}
        return {
            index: topics[index][camera]
            for index in self._joined()
            if self._histories[index].needs_filmed and camera in topics[index]
        }

    def _seeing(self) -> list[_Page]:
        """Pages with pictures, sound and haptics."""
        return [page for page in self._pages.values() if not page.plain]

    def _joined(self) -> list[int]:
        """Streams with units that a page waits for."""
        return [
            index
            for index in self._histories
            if any(not page.queue.lane(index).open for page in self._seeing())
        ]

    def handle_sound(self, stream: int, samples: bytes, stamp: CaptureStamp) -> None:
        """A block of sound of a stream."""
        message = pack_sound(
            stream,
            stamp.sequence,
            stamp.capture_ns // NS_PER_US,
            samples,
            concealed=stamp.quality is Quality.CONCEALED,
        )
        for page in self._seeing():
            page.queue.put_sound(stream, message)

    def handle_haptics(self, end: int, block: bytes) -> None:
        """A block of haptic samples of an end."""
        message = pack_haptic(end, rows_of(block))
        for page in self._seeing():
            page.queue.put_haptics(end, message)

    def handle_preview(self, preview: int, picture: I420, stamp: CaptureStamp) -> None:
        """A small picture of an input."""
        message = pack_preview(preview, stamp.capture_ns // NS_PER_US, picture)
        for page in self._seeing():
            page.queue.put_preview(preview, message)

    def handle_status(self, status: JoystickStatus, now_ns: int) -> None:
        """The joystick's state."""
        told = texts.JoystickText(
            state=JoystickState(status.state).words,
            reason=status.reason,
            dead_man=status.dead_man,
            force_limit_n=status.force_limit_n,
            device=status.device,
        )
        self._desk.handle_status(status)
        self._settle_desk(now_ns)
        if told != self._joystick:
            self._joystick = told
            self._tell_state(now_ns)

    def handle_signal(self, heard: bool, now_ns: int) -> None:
        """Whether this end of the link hears its peer."""
        self.mission.handle_signal(heard)
        if heard != self._signal:
            self._signal = heard
            self._tell_state(now_ns)

    def handle_news(self, news: TmtcNews, now_ns: int) -> None:
        """What the TM/TC end of this segment has published."""
        self.mission.handle_news(news, now_ns)
        self._settle_mission(now_ns)

    def handle_shown(self, kind: str, shown: Shown) -> None:
        """What a process of the mission shows; pages get it with the next heartbeat."""
        self.mission.handle_shown(kind, shown)

    def handle_camera(self, camera: str, now_ns: int) -> None:
        """The selected camera."""
        if camera != self._camera:
            self._camera = camera
            self._tell_state(now_ns)

    def handle_recorder(self, asked: RecordingAsked, error: str) -> None:
        """The recorder's answer. error: "" if it does what was asked."""
        self._answer(asked.page, asked.request, error)

    def handle_figures(self, text: bytes, now_ns: int) -> None:
        """A message of the launcher; pages get it unchanged."""
        self._figures.handle_figures(text)
        words = text.decode()
        for page in self._pages.values():
            page.queue.put_figures(words)
        selected = self._figures.word("processes.selector.selected")
        if self.plan.segment is Segment.SPACE and selected is not None:
            self.handle_camera(selected, now_ns)

    # Time

    def poll_timeout(self) -> int | None:
        """When `handle_time` is due; None while nobody looks."""
        return self._due_ns if self._pages else None

    def handle_time(self, now_ns: int) -> None:
        """Send the heartbeat if it is due."""
        self._desk.handle_timeout(now_ns)
        self._settle_desk(now_ns)
        self._settle_mission(now_ns)
        if now_ns >= self._due_ns:
            self._tell_state(now_ns)
            self._tell_mission()

    def _tell_state(self, now_ns: int) -> None:
        self._due_ns = now_ns + HEARTBEAT_NS
        for number, page in self._pages.items():
            page.queue.put_state(self._state_text(number, now_ns))

    def _state_text(self, number: int, now_ns: int) -> str:
        hand = self._hand.state
        state = self._figures.word(f"gateways.{self.plan.segment.value}.supervision.state")
        signal = state == "connected" if self._signal is None else self._signal
        connected = signal and state in (None, "connected") and self._figures.running
        return texts.pack_text(
            texts.StateText(
                now_us=now_ns // NS_PER_US,
                link="connected" if connected else "lost",
                signal=signal,
                camera=self._camera,
                joystick=self._joystick,
                hand=texts.HandText(
                    holder=self.holder, you=hand.holder == number, wanted_by=hand.wanted_by
                ),
                inputs=self.inputs.owners,
            )
        )

    def _settle_hand(self, now_ns: int) -> None:
        """The holder may have changed: the hand before lets go, and all pages are told."""
        released = self._gate.poll_release(now_ns)
        if released is not None:
            self._events.append(HandMoved(released))
        if self._hand.next_event() is not None:
            self._tell_state(now_ns)

    def _tell_mission(self) -> None:
        """Send the pages what changed of the mission."""
        for kind, text in self.mission.poll_texts().items():
            for page in self._pages.values():
                page.queue.put_newest(kind, text)

    def _settle_mission(self, now_ns: int) -> None:
        while (request := self.mission.poll_transmit(now_ns)) is not None:
            self._events.append(TmtcAsked(request))
        while (answered := self.mission.next_event()) is not None:
            self._answer(answered.page, answered.request, answered.error, answered.round_trip_ms)
            if answered.camera:
                self.handle_camera(answered.camera, now_ns)

    def _settle_desk(self, now_ns: int) -> None:
        while (answered := self._desk.next_event()) is not None:
            self._answer(answered.page, answered.request, answered.error)
        command = self._desk.poll_transmit(now_ns)
        if command is not None:
            self._events.append(CommandGiven(command))

    def _answer(
        self, number: int, request: int, error: str, round_trip_ms: float | None = None
    ) -> None:
        page = self._pages.get(number)
        if page is not None:
            page.queue.put_answer(
                texts.pack_text(
                    texts.AnswerText(
                        request=request, ok=not error, error=error, round_trip_ms=round_trip_ms
                    )
                )
            )

    def _replay_idle(self) -> None:
        for page in self._pages.values():
            if page.idle:
                self._replay(page)

    def _replay(self, page: _Page) -> None:
        """Open the closed lanes of a page with what a decoder needs to begin now."""
        for stream in list(page.queue.closed_lanes()):
            units = self._histories[stream].replay()
            if units is not None:
                page.queue.lane(stream).put_replay(
                    [
                        *(_packed(stream, unit, REPLAYED) for unit in units[:-1]),
                        _packed(stream, units[-1]),
                    ]
                )


def _packed(stream: int, unit: KeptUnit, more_flags: int = 0) -> bytes:
    flags = KEY * unit.key | DAMAGED * unit.damaged | more_flags
    return pack_unit(stream, flags, unit.sequence, unit.capture_us, unit.data)
