"""One end of the link on virtual time: the radio of both ways here, and a trainer's exercise."""

import socket

import pytest

from pipelines.link.gateway_end import GatewayEnd
from pipelines.session.datagrams import Outlet
from pipelines.session.probe import Probe
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.training import Exercises
from pipelines.table import topology_of
from telepresence.link.flows import HapticReceived
from telepresence.link.supervision.message import LinkState

MS = 1_000_000
TABLE = topology_of(BUILT_IN["spacejustin"])


def make_end(segment, *, radio_both_ways=False):
    numbers = {"boot_id": 1, "seed": 1, "epoch_ns": 0, "now_ns": 0, "first_ns": 0}
    numbers |= {"secret": 1 + (segment is Segment.SPACE), "radio_both_ways": radio_both_ways}
    return GatewayEnd(TABLE, segment, Probe(), **numbers)


class Link:
    """Both ends in step. samples: for each end, the instants (ms) at which samples reached it."""

    def __init__(self, *, radio_both_ways):
        self.ground = make_end(Segment.GROUND, radio_both_ways=radio_both_ways)
        self.space = make_end(Segment.SPACE)
        self.samples = {self.ground: [], self.space: []}

    def run(self, first_ms, last_ms):
        pairs = ((self.ground, self.space), (self.space, self.ground))
        for slot in range(first_ms, last_ms):
            now_ns = slot * MS
            for end, peer in pairs:
                end.slots.handle_slot([bytes(12)], now_ns)
                while (frame := end.poll_transmit(now_ns)) is not None:
                    peer.handle_frame(frame, now_ns)
            for end, _ in pairs:
                end.handle_time(now_ns)
                while (event := end.next_event()) is not None:
                    if isinstance(event, HapticReceived):
                        self.samples[end].append(slot)


@pytest.mark.parametrize("radio_both_ways", [False, True])
def test_an_exercise_takes_the_signal_of_every_radio_that_is_here(radio_both_ways):
    link = Link(radio_both_ways=radio_both_ways)
    link.run(0, 500)
    link.ground.handle_exercises(Exercises(los_ns=900 * MS), 500 * MS)
    link.run(500, 1500)
    lost = range(520, 900)
    from_ground, from_space = (
        [slot for slot in link.samples[end] if slot in lost] for end in (link.space, link.ground)
    )
    assert from_ground == []
    # Without the radio of the way in, the other end's frames still come.
    assert (from_space == []) is radio_both_ways
    assert any(slot > 1000 for slot in link.samples[link.space])
    assert any(slot > 1000 for slot in link.samples[link.ground])


def heard(end):
    """The number of frames that came, unknown senders' included."""
    report = end.gateway.receiver.report()
    return report.frames_received + sum(report.frames_dropped.values())


def test_with_a_radio_on_the_way_in_an_end_wakes_up_and_a_refused_datagram_leaves_a_reason():
    here, plain = make_end(Segment.GROUND, radio_both_ways=True), make_end(Segment.GROUND)
    peer = make_end(Segment.SPACE)
    peer.slots.handle_slot([bytes(12)], 0)
    now_ns = peer.gateway.poll_timeout()
    frame = peer.poll_transmit(now_ns)
    for end in (here, plain):
        end.slots.handle_slot((), 0)
        end.handle_frame(frame, now_ns)
    delay_ns = BUILT_IN["spacejustin"].radio_profile.longest_delay_ns
    assert (heard(plain), heard(here)) == (1, 0)
    assert here.handle_time(now_ns + round(delay_ns)) and not plain.handle_time(now_ns)
    assert heard(here) == 1
    assert here.publish(now_ns).transmit.frames == 1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.connect(("127.0.0.1", 9))
        out = Outlet(udp)
        udp.shutdown(socket.SHUT_RDWR)
        out.send(bytes(32))
        assert (out.failed, out.why) == (1, "Broken pipe")


def test_an_end_whose_frames_do_not_leave_delivers_nothing_until_they_do():
    link = Link(radio_both_ways=False)
    link.run(0, 500)
    supervisor = link.space.gateway.supervisor
    assert supervisor.state is LinkState.CONNECTED
    for ms in (100, 200, 300):
        made = link.space.slots.schedule.cycles
        link.run(400 + ms, 500 + ms)
        link.space.handle_refused(ms, "No buffer space available", (500 + ms) * MS)
        assert link.space.slots.schedule.cycles == made + 100
    assert supervisor.state is LinkState.CHECK
    assert "No buffer space available" in supervisor.why
    heard = len(link.samples[link.space])
    link.run(800, 900)
    assert len(link.samples[link.space]) == heard
    assert link.ground.gateway.supervisor.state is LinkState.CONFIGURE
    link.space.handle_refused(300, "No buffer space available", 900 * MS)
    link.run(900, 1200)
    assert supervisor.state is LinkState.CONNECTED
    assert len(link.samples[link.space]) > heard + 200
