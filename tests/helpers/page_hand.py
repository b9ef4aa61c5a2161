"""A hand that moves the robot of a session as the page of the operator's seat does, by topics."""

from itertools import count

from running_session import eventually

from kontur_av.clock import MonotonicClock
from kontur_av.media import CaptureStamp
from pipelines.hand.hand_topics import (
    HAND_INPUT_TOPIC,
    HAND_REQUEST_TOPIC,
    INPUT_OCTETS,
    JOYSTICK_STATE_TOPIC,
    REQUEST_OCTETS,
    HandRequest,
)
from pipelines.hand.haptic_trace import ROBOT_TRACE_TOPIC, rows_of
from pipelines.session.mission_messages import ROBOT_TOPIC
from telepresence.haptics.device.page import PageInput


class PageHand:
    """What the process of the operator's page reads and writes."""

    def __init__(self, bus):
        self.clock = MonotonicClock()
        self.numbers = count(1)
        self.hand = bus.writer(HAND_INPUT_TOPIC, max_octets=INPUT_OCTETS, wake=False)
        self.requests = bus.writer(HAND_REQUEST_TOPIC, max_octets=REQUEST_OCTETS, wake=False)
        self.readers = {
            topic: bus.reader(topic, depth=8)
            for topic in (ROBOT_TOPIC, ROBOT_TRACE_TOPIC, JOYSTICK_STATE_TOPIC)
        }

    def stamp(self, now_ns):
        return CaptureStamp(now_ns, 0, "page")

    def point(self, x, y, *, dead_man=True):
        now_ns = self.clock.now_ns()
        hand = PageInput(dead_man, x, y, 0, next(self.numbers), now_ns)
        self.hand.publish_octets(HAND_INPUT_TOPIC.pack(hand), self.stamp(now_ns))

    def ask(self, event):
        number = next(self.numbers)
        request = HandRequest(number, event)
        self.requests.publish_octets(
            HAND_REQUEST_TOPIC.pack(request), self.stamp(self.clock.now_ns())
        )
        return eventually(lambda: self.answer(number), f"the answer to {event.value}")

    def answer(self, number):
        status = self.status()
        return status if status is not None and status.answered == number else None

    def status(self):
        data = self.newest(JOYSTICK_STATE_TOPIC)
        return None if data is None else JOYSTICK_STATE_TOPIC.unpack(data)

    def is_in(self, state):
        status = self.status()
        return status is not None and status.state == state

    def robot(self):
        return ROBOT_TOPIC.unpack(
            eventually(lambda: self.newest(ROBOT_TOPIC), "a state of the robot")
        )

    def newest(self, topic):
        lease = self.readers[topic].latest()
        if lease is None:
            return None
        with lease:
            return lease.octets()

    def rows(self):
        return rows_of(eventually(lambda: self.newest(ROBOT_TRACE_TOPIC), "a block of the trace"))
