"""A seat: what its pages are sent, and what comes of what they send."""

from collections import deque
from collections.abc import Callable, Mapping
from itertools import count
from typing import NamedTuple

from msgspec.structs import asdict, replace

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.errors import ProtocolError
from pipelines.hand.hand_topics import DriverState, HandRequest, JoystickStatus
from pipelines.hand.knowledge import EndKnowledge
from pipelines.mission.tmtc_messages import SetValues, TmtcNews, TmtcRequest, Values
from pipelines.seats import texts
from pipelines.seats.holders import HandGate, HandleAuthority, JoystickClient, OwnInputs
from pipelines.seats.mission_client import MissionClient
from pipelines.seats.open_page import ClientQueue, Message, OpenPage, SeatMedia
from pipelines.seats.page_metrics import HOLDER
from pipelines.seats.plan import SeatPlan, Shown
from pipelines.seats.policy_guest import PERSON, PolicyGuest
from pipelines.session.access import VIEWER_WORDS, Role, place_name, refusal
from pipelines.session.mission_messages import ExperimentShown, PanelShown, RobotStatus
from pipelines.session.page_messages import Ping, pack_pong, parse_seat_message
from pipelines.session.session_metrics import Event, Figure, SessionNews, gathered
from pipelines.session.session_switch import Order
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import Known, situation
from pipelines.session.topology.topics import TRAINER
from telepresence.haptics.device import states
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.policy import PolicyMessage


class PageRequest(NamedTuple):
    """A page's request to the recorder, the trainer or the file transfer.

    Pass the answer to `Seat.handle_answered`.
    """

    page: int
    request: texts.RecordingRequest | texts.ExerciseRequest | texts.FetchRequest


class StopAsked(NamedTuple):
    """The emergency stop is to hold, or not. by: who asks."""

    stop: bool
    by: str


#: What to tell: the joystick of the hand or of a command, all of who has the handle, the launcher
#: of an order; recorder, trainer and the TM/TC end of this segment of what is asked.
SeatEvent = PageInput | DriverState | HandRequest | Order | PageRequest | StopAsked | TmtcRequest

#: Pages that are open at a time: of viewers, and of all who may act.
MOST_VIEWERS, MOST_ACTING = 12, 12
HEARTBEAT_NS = 100 * NS_PER_MS
#: How often it is told where a policy wants the robot.
_DRIVER_NS = 50 * NS_PER_MS
#: How often the telemetry of K2CP is told.
_K2CP_NS = 5 * NS_PER_S
#: As many as the launcher keeps.
_MOST_EVENTS = 200


def _untold(news: SessionNews) -> SessionNews:
    """The news for all but the trainer: who is trained does not read what is an exercise."""
    return replace(news, events=tuple(one for one in news.events if one.what != TRAINER))


class _Rule(NamedTuple):
    """Where a request is taken, and what the role of its page must permit there.

    elsewhere: the answer at the other seat.
    """

    deed: str
    at: tuple[Segment, ...] = (Segment.SPACE, Segment.GROUND)
    elsewhere: str = ""


_RULES: Mapping[type[texts.SeatRequest], _Rule] = {
    texts.JoystickRequest: _Rule(
        "joystick", (Segment.SPACE,), "the joystick is at the operator's seat"
    ),
    texts.HandleRequest: _Rule("hand", (Segment.SPACE,), "the handle is at the operator's seat"),
    texts.SessionRequest: _Rule("session"),
    texts.StopRequest: _Rule("stop"),
    texts.RecordingRequest: _Rule(
        "record", (Segment.GROUND,), "ground control records the session"
    ),
    texts.ExerciseRequest: _Rule("exercise"),
    texts.FetchRequest: _Rule("fetch", (Segment.GROUND,), "ground control fetches files"),
}


#: Of the commands' age on pages.
_AGE_STEP_MS = 50


def _coarse(age_ms: int | None) -> int | None:
    """Round an age up to 50 ms, so that pages are not told of each millisecond."""
    return None if age_ms is None else -(-age_ms // _AGE_STEP_MS) * _AGE_STEP_MS


def _allowed(status: JoystickStatus, state: states.JoystickState) -> tuple[str, ...]:
    """The requests that the joystick would take now."""
    allowed = {one.value for one in states.REQUESTS if (state, one) in states.TRANSITIONS}
    start = states.JoystickEvent.START.value
    if status.partner is not None and state is states.JoystickState.HALTED:
        # Nobody could leave a partner's robot that is silent otherwise.
        allowed.add(start)
    if status.partner and start in allowed:
        allowed.add(states.JoystickEvent.START_RUSSIAN.value)
    return tuple(sorted(allowed))


class Seat:
    """One seat and its pages. A core.

    Pages are known by numbers from `handle_opened`. What they send is passed to `handle_message`
    and `handle_text`; these raise ProtocolError where a page is to be closed. After each `handle_`
    drain `next_event`, and send to each page what `poll_transmit` returns, as far as it takes it.

    first_command: above the numbers of all commands of an earlier start of this process.
    """

    def __init__(self, plan: SeatPlan, *, first_command: int) -> None:
        self.plan = plan
        self.inputs = OwnInputs(plan)
        self._numbers = count(1)
        self._pages: dict[int, OpenPage] = {}
        self.media = SeatMedia(plan.streams, self._pages)
        self._hand = HandleAuthority()
        self._hand_over: Mapping[str, Callable[[int], str]] = {
            "take": self._hand.handle_take,
            "give": self._hand.handle_give,
            "ask": self._hand.handle_ask,
            "refuse": self._hand.handle_refuse,
        }
        self._gate = HandGate(self._hand)
        device = "" if plan.moved else plan.traits.device
        self.policy = PolicyGuest(plan.axes, self._hand, self._numbers, device=device)
        self._driver_due_ns = 0
        self._service = JoystickClient(first_command)
        self.mission = MissionClient(
            plan.segment, plan.dictionary, client=f"page.{plan.segment.value}.{first_command}"
        )
        #: The launcher's newest message, and the newest events of all its messages.
        self._session: SessionNews | None = None
        self._happened: deque[Event] = deque(maxlen=_MOST_EVENTS)
        self._joystick: texts.JoystickText | None = None
        self._knowledge = EndKnowledge(plan.traits)
        self._signal: bool | None = None
        self.camera: str | None = None
        self._due_ns = self._k2cp_ns = 0
        self._events: deque[SeatEvent] = deque()
        self._left_out = 0

    # The pages

    @property
    def watching(self) -> int:
        return len(self._pages)

    @property
    def watched(self) -> bool:
        """Whether a page is open or a policy is there."""
        return bool(self._pages or self.policy.name)

    @property
    def left_out(self) -> int:
        """Units and blocks of sound that pages were too slow for."""
        return self._left_out + sum(page.queue.units_left_out for page in self._pages.values())

    @property
    def holder(self) -> int | None:
        """Number of the page that holds the handle; ground control is told it by the launcher."""
        if self.plan.segment is Segment.GROUND:
            holder = self._figure(HOLDER)
            return holder if isinstance(holder, int) else None
        return self._hand.state.holder

    def is_full(self, role: Role) -> bool:
        """Whether no further page of this role may open. Viewers keep nobody out who may act."""
        watching = [page.role is Role.VIEWER for page in self._pages.values()]
        if role is Role.VIEWER:
            return sum(watching) >= MOST_VIEWERS
        return len(watching) - sum(watching) >= MOST_ACTING

    def handle_opened(self, role: Role, now_ns: int, *, plain: bool = False) -> int:
        """A page has come; return its number. plain: it gets no picture, sound or haptics."""
        number = next(self._numbers)
        lanes = () if plain else self.media.lanes
        name = self._free_name(role)
        page = self._pages[number] = OpenPage(
            role, number=number, queue=ClientQueue(lanes), name=name, plain=plain
        )
        may = role is Role.OPERATOR or not refusal(role, self.plan.segment, "hand")
        if may and self.plan.moved:
            self._hand.handle_joined(number, name)
        seat = replace(self.plan.text, streams=(), previews=()) if plain else self.plan.text
        now_us = now_ns // NS_PER_US
        hello = texts.HelloText(role=role, page=number, name=name, now_us=now_us, **asdict(seat))
        page.queue.put_answer(texts.pack_text(hello))
        self._publish_mission()
        for kind, text in self.mission.texts.items():
            page.queue.put_newest(kind, text)
        page.queue.put_state(self._state_text(number, now_ns))
        if self._session is not None:
            joined = replace(self._session, events=tuple(self._happened))
            if role is not Role.TRAINER:
                joined = _untold(joined)
            page.queue.put_metrics(texts.pack_text(joined))
        return number

    def _free_name(self, role: Role) -> str:
        """Return who sits at a new page: the role, with a number if there are several."""
        taken = {page.name for page in self._pages.values()}
        name = place_name(role, self.plan.segment)
        names = (name if which == 1 else f"{name} {which}" for which in count(1))
        return next(one for one in names if one not in taken)

    def handle_closed(self, number: int, now_ns: int) -> None:
        """A page is gone; its hand lets go at once."""
        self._left_out += self._pages.pop(number).queue.units_left_out
        self._hand.handle_gone(number)
        self._settle(now_ns)

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
        page.idle = message is None
        return message

    def next_event(self) -> SeatEvent | None:
        return self._events.popleft() if self._events else None

    # What pages send

    def handle_message(self, number: int, data: bytes, now_ns: int) -> None:
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
            self._events.append(hand)

    def handle_text(self, number: int, text: str, now_ns: int) -> None:
        page = self._pages[number]
        if not page.texts.handle_message(now_ns):
            raise ProtocolError("too many requests")
        request = texts.parse_seat_request(text)
        error = self._handle_request(page, request, now_ns)
        if error is not None:
            self._answer(texts.Answered(number, request.request, error))
        self._settle(now_ns)

    def _handle_request(
        self, page: OpenPage, request: texts.SeatRequest, now_ns: int
    ) -> str | None:
        """Return why a request is not carried out, or ""; None: its answer comes later."""
        if page.role is Role.VIEWER:
            return VIEWER_WORDS
        if isinstance(request, texts.CommandRequest):
            return self.mission.handle_command(page.number, page.role, request, now_ns)
        if isinstance(request, texts.ChatRequest):
            return self.mission.handle_chat(page.role, request, now_ns)
        rule, segment = _RULES[type(request)], self.plan.segment
        deed = rule.deed
        if isinstance(request, texts.StopRequest):
            deed = f"robot.{'emergency_stop' if request.action == 'stop' else 'release_stop'}"
        # Nobody but the trainer spoils a session, not even its owner.
        owner = page.role is Role.OPERATOR and deed != "exercise"
        refused = "" if owner else refusal(page.role, segment, deed)
        if refused or segment not in rule.at:
            return refused or rule.elsewhere
        number = page.number
        match request:
            case texts.JoystickRequest():
                event = states.JoystickEvent(request.event)
                self._service.handle_request(number, request.request, event)
            case texts.HandleRequest(action="policy"):
                return self.policy.handle_let(number, now_ns)
            case texts.HandleRequest() if not self.plan.moved:
                return self.policy.handle_back()
            case texts.HandleRequest():
                return self._hand_over[request.action](number)
            case texts.SessionRequest():
                if not self.plan.traits.orders:
                    return "ground control starts and stops the session"
                self._events.append(Order(request.action))
                return ""
            case texts.StopRequest():
                by = f"the {page.role.words} at the page of {segment.value}"
                self._events.append(StopAsked(request.action == "stop", by))
                if request.action == "stop" or self.plan.traits.orders:
                    return ""
                # The robot is across the radio, and answers there.
                asked = texts.CommandRequest(
                    request=request.request, application="robot", name="release_stop"
                )
                return self.mission.handle_command(number, page.role, asked, now_ns)
            case texts.RecordingRequest() | texts.ExerciseRequest() | texts.FetchRequest():
                self._events.append(PageRequest(number, request))
        return None

    # What topics and the launcher tell

    def handle_status(self, status: JoystickStatus, now_ns: int) -> None:
        state = states.JoystickState(status.state)
        axes = (
            gathered(
                texts.AxisText, axis, position=round(axis.position, 4), force=round(axis.force, 2)
            )
            for axis in status.axes
        )
        told = gathered(
            texts.JoystickText,
            status,
            state=state.words,
            allowed=_allowed(status, state),
            axes=tuple(axes),
            dead_man=status.held,
            command_age_ms=_coarse(status.command_age_ms),
        )
        self._knowledge.handle_told(status, now_ns)
        self._service.handle_status(status)
        self.policy.handle_status(status, now_ns)
        self._settle(now_ns)
        if told != self._joystick:
            self._joystick = told
            self._publish_state(now_ns)

    def handle_policy(self, message: PolicyMessage, now_ns: int) -> None:
        """A policy's program says where it wants the robot."""
        self.policy.handle_message(message, now_ns)
        self._settle(now_ns)

    def handle_signal(self, heard: bool, now_ns: int) -> None:
        """Whether this end of the link hears its peer."""
        self.mission.handle_signal(heard)
        if heard != self._signal:
            self._signal = heard
            self._publish_state(now_ns)

    def handle_news(self, news: TmtcNews, now_ns: int) -> None:
        self.mission.handle_news(news, now_ns)
        self._settle(now_ns)

    def handle_shown(self, kind: str, shown: Shown, now_ns: int = 0) -> None:
        """What a process of the mission shows; pages get it with the next heartbeat."""
        self.mission.handle_shown(kind, shown)
        if isinstance(shown, RobotStatus | PanelShown | ExperimentShown):
            self._knowledge.handle_told(shown, now_ns)

    def handle_stop(self, ordered: bool, by: str, now_ns: int) -> None:
        """Whether an emergency stop is kept on this machine, and who ordered it."""
        if (ordered, by) != self._knowledge.stop:
            self._knowledge.stop = (ordered, by)
            self._publish_state(now_ns)

    def handle_camera(self, camera: str, now_ns: int) -> None:
        if camera != self.camera:
            self.camera = camera
            self._publish_state(now_ns)

    def handle_answered(self, asked: PageRequest, error: str) -> None:
        """The answer of recorder, trainer or file transfer. error: "" if it does what was asked."""
        self._answer(texts.Answered(asked.page, asked.request.request, error))

    def handle_session(self, news: SessionNews, now_ns: int) -> None:
        """A message of the launcher; pages get it unchanged."""
        self._session = news
        self._happened.extend(news.events)
        words, others = texts.pack_text(news), texts.pack_text(_untold(news))
        for page in self._pages.values():
            page.queue.put_metrics(words if page.role is Role.TRAINER else others)
        self.mission.handle_obstacle(self._obstacle())
        selected = self._figure("processes.selector.selected")
        if self.plan.segment is Segment.SPACE and isinstance(selected, str):
            self.handle_camera(selected, now_ns)

    def _obstacle(self) -> str:
        """Why an end known here sends nothing, or refuses the other one."""
        found = []
        for end in (self.plan.segment, self.plan.segment.peer):
            head = f"gateways.{end.value}.supervision"
            if self._figure(f"{head}.state") in ("check", "refused"):
                found.append(f"{end.value}: {self._figure(f'{head}.why')}")
        return "; ".join(found)

    def _figure(self, name: str) -> Figure:
        return None if self._session is None else self._session.figures.get(name)

    # Time

    def handle_policy_time(self, now_ns: int) -> None:
        """Move the policy's hand, and tell who drives; every 10 ms while a policy is there."""
        if (moved := self.policy.poll(now_ns)) is not None:
            hand = self._gate.handle_input(*moved)
            if hand is not None:
                self._events.append(hand)
        self._settle(now_ns)
        if now_ns >= self._driver_due_ns:
            self._driver_due_ns = now_ns + _DRIVER_NS
            self._events.append(self.policy.state)

    def handle_time(self, now_ns: int) -> None:
        """Send the heartbeat if it is due."""
        self._service.handle_timeout(now_ns)
        self._settle(now_ns)
        if now_ns >= self._due_ns:
            self._publish_state(now_ns)
            self._publish_mission()
        if self.plan.segment is Segment.SPACE and now_ns >= self._k2cp_ns:
            self._k2cp_ns = now_ns + _K2CP_NS
            acts = any(page.role is not Role.VIEWER for page in self._pages.values())
            joystick = self._joystick is not None
            told: Values = {"state": "open" if acts else "no page", "joystick": joystick}
            self._events.append(SetValues("k2cp", told))

    def _publish_state(self, now_ns: int) -> None:
        self._due_ns = now_ns + HEARTBEAT_NS
        self.mission.handle_link(self._connected)
        for number, page in self._pages.items():
            page.queue.put_state(self._state_text(number, now_ns))

    @property
    def _runs(self) -> bool:
        return self._session is None or self._session.state == "running"

    @property
    def _heard(self) -> bool:
        """Whether this end of the link hears its peer."""
        if self._signal is not None:
            return self._signal
        return self._figure(f"gateways.{self.plan.segment.value}.supervision.state") == "connected"

    @property
    def _connected(self) -> bool:
        state = self._figure(f"gateways.{self.plan.segment.value}.supervision.state")
        return self._heard and state in (None, "connected") and self._runs

    def _state_text(self, number: int, now_ns: int) -> str:
        hand = self._hand.state
        known = self._known(number, now_ns)
        return texts.pack_text(
            texts.StateText(
                now_us=now_ns // NS_PER_US,
                link="connected" if known.connected else "lost",
                signal=self._heard,
                camera=self.camera,
                joystick=self._joystick,
                safety=gathered(texts.SafetyText, known, frozen=self._knowledge.frozen),
                situation=gathered(texts.SituationText, situation(known)),
                hand=texts.HandText(
                    holder=self.holder,
                    you=hand.holder == number,
                    wanted_by=hand.wanted_by,
                    who=self._hand.name(hand.holder),
                    asks=self._hand.name(hand.wanted_by),
                    policy=self.policy.state.policy,
                ),
                inputs=self.inputs.owners,
            )
        )

    def _known(self, number: int, now_ns: int) -> Known:
        """What this end knows, for a page."""
        hand = self._hand.state
        return self._knowledge.known(
            self._pages[number].role,
            now_ns,
            connected=self._connected,
            runs=self._runs,
            holder="" if hand.holder in (number, PERSON) else self._hand.name(hand.holder),
        )

    def _publish_mission(self) -> None:
        for kind, text in self.mission.poll_texts().items():
            for page in self._pages.values():
                page.queue.put_newest(kind, text)

    def _settle(self, now_ns: int) -> None:
        """Pass on what hand, joystick and mission have to say after an input."""
        self.policy.settle(now_ns)
        released = self._gate.poll_release(now_ns)
        if released is not None:
            self._events.append(released)
        if self._hand.next_event() is not None:
            self._publish_state(now_ns)
        while (answered := self._service.next_event()) is not None:
            self._answer(answered)
        if (command := self._service.poll_transmit(now_ns)) is not None:
            self._events.append(command)
        while (request := self.mission.poll_transmit(now_ns)) is not None:
            self._events.append(request)
        while (answered := self.mission.next_event()) is not None:
            self._answer(answered)
            if answered.camera:
                self.handle_camera(answered.camera, now_ns)

    def _answer(self, answered: texts.Answered) -> None:
        number, request, error, round_trip_ms, _ = answered
        if number in self._pages:
            text = texts.AnswerText(
                request=request, ok=not error, error=error, round_trip_ms=round_trip_ms
            )
            self._pages[number].queue.put_answer(texts.pack_text(text))
