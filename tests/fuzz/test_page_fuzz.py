"""Whatever pages send in whatever order: either it is done, or that page is closed.

Nothing but ProtocolError leaves the cores. Only the holder's hand moves the joystick, and it has
been let go whenever no page holds the handle. What waits for a page stays bounded.
"""

import json
import struct

import pytest
from common import repeats
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.seats.open_page import MOST_UNITS
from pipelines.seats.plan import seat_plan
from pipelines.seats.seat import Seat
from pipelines.session.access import Role
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.table import topology_of
from telepresence.haptics.device.page import PageInput
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

PLANS = [
    seat_plan(
        topology_of(BUILT_IN["spacejustin"], pages=True, joystick="page"),
        segment,
        "x",
        built_in_dictionary(),
    )
    for segment in Segment
]
#: More than all depths of a queue together, without a replay.
MOST_WAITING = 64 + 32 + 1 + 8 + 8 + 2 * 25 + 4 + 2 * 15 + 2 * MOST_UNITS
WORDS = st.sampled_from(
    [
        *("command", "chat", "call", "report", "tasks", "robot", "select", "joystick", "hand"),
        *("session", "input", "take", "give", "ask", "refuse", "on", "record", "start", "stop"),
        *("halt", "calibrate", "head", "operator_mic", "operator_camera", "", "\ud800"),
    ]
)
#: Requests that are understood, without which few pages would stay open.
KNOWN = [
    *({"do": "hand", "action": action} for action in ("take", "ask", "give", "refuse")),
    *({"do": "joystick", "event": event} for event in ("halt", "start", "calibrate")),
    *(
        {"do": "input", "name": name, "on": True}
        for name in ("operator_camera", "operator_mic", "ground_mic")
    ),
    {"do": "chat", "text": "a line"},
    {"do": "command", "application": "camera", "name": "select", "arguments": ["head"]},
]
REQUESTS = st.sampled_from([json.dumps({"request": 1} | each) for each in KNOWN]) | (
    st.fixed_dictionaries(
        {"request": st.integers(-1, 9) | st.none(), "do": WORDS},
        optional={
            **dict.fromkeys(
                ("camera", "event", "action", "name", "application", "verb", "text"), WORDS
            ),
            "arguments": st.lists(st.integers() | WORDS, max_size=5),
            "on": st.booleans() | WORDS,
        },
    ).map(json.dumps)
)
HANDS = st.builds(
    lambda dead_man, sequence, x: struct.pack("<BBHIffd", 0x82, dead_man, 0, sequence, x, 0.0, 0.0),
    *(st.booleans(), st.integers(0, 5), st.sampled_from([0.0, 0.5, 1.0, -1.5, float("nan")])),
)
OCTETS = st.binary(max_size=40) | st.builds(
    lambda kind, rest: bytes([kind]) + rest, st.integers(0x80, 0x85), st.binary(max_size=40)
)


class Pages(RuleBasedStateMachine):
    def __init__(self):
        super().__init__()
        self.now_ns = self.number = 0
        self.roles = {}
        self.media = []
        self.held = False

    @initialize(plan=st.sampled_from(PLANS))
    def begin(self, plan):
        self.seat = Seat(plan, first_command=1)

    @precondition(lambda self: len(self.roles) < 4)
    @rule(role=st.sampled_from(Role))
    def open(self, role):
        self.roles[self.seat.handle_opened(role, self.now_ns)] = role
        self.settle()

    @precondition(lambda self: len(self.media) < 3)
    @rule(role=st.sampled_from(Role))
    def open_media(self, role):
        self.media.append(self.seat.handle_media_opened(role))

    def close(self, page):
        del self.roles[page]
        self.seat.handle_closed(page, self.now_ns)
        self.settle()

    @precondition(lambda self: self.roles)
    @rule(data=st.data())
    def leave(self, data):
        self.close(data.draw(st.sampled_from(sorted(self.roles))))

    @precondition(lambda self: self.roles)
    @rule(data=st.data(), sent=st.one_of(REQUESTS, st.text(max_size=30), HANDS, OCTETS))
    def send(self, data, sent):
        page = data.draw(st.sampled_from(sorted(self.roles)))
        text = isinstance(sent, str)
        try:
            (self.seat.handle_text if text else self.seat.handle_message)(page, sent, self.now_ns)
        except ProtocolError:
            self.close(page)
        else:
            self.settle(page)

    @precondition(lambda self: self.media)
    @rule(data=st.data(), sent=st.one_of(REQUESTS, st.text(max_size=30), OCTETS))
    def send_media(self, data, sent):
        link = data.draw(st.sampled_from(self.media))
        inputs = self.seat.inputs
        try:
            (inputs.handle_text if isinstance(sent, str) else inputs.handle_message)(
                link, sent, self.now_ns
            )
        except ProtocolError:
            self.media.remove(link)
            inputs.handle_closed(link)

    @rule(key=st.booleans(), gap=st.booleans(), count=st.integers(1, 60))
    def units(self, key, gap, count):
        self.number += gap
        for _ in range(count):
            stamp = CaptureStamp(self.now_ns, self.number, "x", rtp_timestamp=self.number)
            data = b"\0\0\0\1\x65i" if key else b"\0\0\0\1\x41d"
            unit = CodedUnit(data=data, key=key, width=64, height=48, parameter_sets=b"s")
            self.seat.media.handle_unit(0, unit, stamp, self.now_ns)
            self.number += 1

    @rule(behind=st.integers(1, 9))
    def added(self, behind):
        unit = CodedUnit(data=b"key", key=True, added=True, parameter_sets=b"s")
        stamp = CaptureStamp(self.now_ns, max(0, self.number - behind), "x")
        for stream in self.seat.media.poll_asks(self.now_ns):
            self.seat.media.handle_unit(stream, unit, stamp, self.now_ns)

    @precondition(lambda self: self.roles)
    @rule(data=st.data(), most=st.integers(1, 50))
    def take(self, data, most):
        page = data.draw(st.sampled_from(sorted(self.roles)))
        for _ in range(most):
            if self.seat.poll_transmit(page) is None:
                assert not self.seat.waits(page)
                break

    @rule(by_ms=st.integers(0, 2000))
    def wait(self, by_ms):
        self.now_ns += by_ms * NS_PER_MS
        self.seat.handle_time(self.now_ns)
        self.settle()

    def settle(self, page=None):
        """page: the one that has just sent something."""
        while (event := self.seat.next_event()) is not None:
            if isinstance(event, PageInput):
                self.held = event.dead_man
                assert not self.held or self.roles.get(page) is Role.OPERATOR
                assert -1 <= event.x <= 1 and event.received_ns == self.now_ns

    @invariant()
    def let_go_without_a_holder(self):
        if Role.OPERATOR not in self.roles.values():
            assert not self.held

    @invariant()
    def bounded(self):
        for page in self.roles:
            queue = self.seat._pages[page].queue
            replay = max((len(lane._replay) for lane in queue.lanes.values()), default=0)
            assert len(queue) <= MOST_WAITING + 2 * replay


Pages.TestCase.settings = settings(max_examples=repeats(60), stateful_step_count=60, deadline=None)
TestPages = pytest.mark.rule("10")(Pages.TestCase)
