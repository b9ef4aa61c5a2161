"""Two gateways on virtual time that lose contact, in both directions or in one."""

import struct
from dataclasses import dataclass, field

import pytest
from virtual_link import VirtualLink

from telepresence.link.flows import (
    HapticReceived,
    Level,
    packet_flow,
    tmtc_flow,
    video_flow,
    voice_flow,
)
from telepresence.link.radio import RadioPath
from telepresence.tmtc.pus.application import PusApplication
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.packets import parse_packet
from telepresence.tmtc.pus.user import CommandResult, PusUser

MS = 1_000_000
DELAY_MS = 12
BOTH = [voice_flow("voice"), video_flow("video"), packet_flow("files", Level.MAINTENANCE)]
UP, DOWN = [tmtc_flow("tc"), *BOTH], [tmtc_flow("tm"), *BOTH]


class Path(RadioPath):
    """A radio path that can be closed; frames sent then are lost."""

    shut = False

    def handle_frame(self, frame, now_ns):
        if not self.shut:
            super().handle_frame(frame, now_ns)


@dataclass
class Arrivals:
    """What arrived at one segment: (instant of arrival, instant of sending).

    packets: without maintenance, which may wait for all others after it has begun.
    """

    samples: list = field(default_factory=list)
    packets: list = field(default_factory=list)


class Session:
    """Traffic of a full session both ways, more than the uplink carries, and telecommands up."""

    def __init__(self, seed=0):
        self.up, self.down = Path(delay_ns=DELAY_MS * MS), Path(delay_ns=DELAY_MS * MS)
        self.link = VirtualLink(
            uplink_flows=UP, downlink_flows=DOWN, up=self.up, down=self.down, seed=seed
        )
        self.at_ground, self.at_space = Arrivals(), Arrivals()
        dictionary = built_in_dictionary()
        self.commands = PusUser(
            dictionary, source=1, first_count=1, timeout_ns=500 * MS, patience_ns=1500 * MS
        )
        self.executor = PusApplication(dictionary.application("camera"), now_ns=0)
        self.selected = []
        self.slot = 0

    def shut(self, *paths):
        self.up.shut, self.down.shut = self.up in paths, self.down in paths

    def run(self, slots):
        for _ in range(slots):
            self.step()

    def step(self):
        link, slot, now_ns = self.link, self.slot, self.link.now_ns
        for segment, rate in ((link.ground, 300), (link.space, 2000)):
            segment.handle_haptic(struct.pack(">Q4x", now_ns), now_ns)
            if slot % 33 == 0:
                self.put(segment, "video", slot // 33, slot * 90, rate, now_ns)
            if slot % 20 == 0:
                self.put(segment, "voice", slot // 20, slot // 20 * 960, 20, now_ns)
            if slot % 50 == 0:
                segment.handle_datagram("files", struct.pack(">Q", now_ns) + bytes(300), now_ns)
        while data := self.commands.poll_transmit(now_ns):
            link.ground.handle_datagram("tc", data, now_ns)
        for gateway, event in link.step():
            self.take(gateway, event)
        self.slot += 1

    @staticmethod
    def put(segment, name, number, timestamp, octets, now_ns):
        header = struct.pack(">BBHII", 0x80, 96, number & 0xFFFF, timestamp & 0xFFFFFFFF, 7)
        segment.handle_datagram(name, header + struct.pack(">Q", now_ns) + bytes(octets), now_ns)

    def take(self, gateway, event):
        link = self.link
        arrivals = self.at_ground if gateway is link.ground else self.at_space
        if isinstance(event, HapticReceived):
            arrivals.samples.append((event.now_ns, struct.unpack_from(">Q", event.sample)[0]))
        elif event.flow.name == "tc":
            self.executor.handle_telecommand(parse_packet(event.data), event.now_ns)
            while request := self.executor.next_event():
                self.selected.append(*request.arguments)
                self.executor.handle_result(request.token, "", event.now_ns)
            while data := self.executor.poll_transmit(event.now_ns):
                link.space.handle_datagram("tm", data, event.now_ns)
        elif event.flow.name == "tm":
            self.commands.handle_telemetry(parse_packet(event.data), event.now_ns)
        else:
            offset = 0 if event.flow.name == "files" else 12
            (put_ns,) = struct.unpack_from(">Q", event.data, offset)
            if event.flow.name != "files":
                arrivals.packets.append((event.now_ns, put_ns))

    def command(self, name):
        self.commands.call("camera", "select", [name], now_ns=self.link.now_ns)

    def answers(self):
        found = []
        while event := self.commands.next_event():
            if isinstance(event, CommandResult):
                found.append(event)
        return found

    @property
    def states(self):
        return tuple(
            gateway.supervisor.state.name for gateway in (self.link.ground, self.link.space)
        )

    def contacts(self, gateway):
        return gateway.report(self.link.now_ns).supervision.contacts


def session():
    one = Session()
    one.run(1000)
    assert one.states == ("CONNECTED", "CONNECTED")
    return one


@pytest.mark.parametrize("phase", [0, 13])
@pytest.mark.parametrize("blackout_ms", [100, 1_000, 10_000])
def test_both_ways(blackout_ms, phase):
    one = session()
    one.run(phase)
    began_ns = one.link.now_ns
    one.shut(one.up, one.down)
    one.run(DELAY_MS + 50)
    # The last frame was sent a slot before the path was closed.
    for gateway in (one.link.ground, one.link.space):
        assert not gateway.supervisor.signal
    one.run(blackout_ms - DELAY_MS - 50)
    back_ns = one.link.now_ns
    one.shut()
    for arrivals in (one.at_ground, one.at_space):
        arrivals.samples.clear()
        arrivals.packets.clear()
    one.run(300)
    for gateway, arrivals in (
        (one.link.ground, one.at_ground),
        (one.link.space, one.at_space),
    ):
        first_ns = back_ns + DELAY_MS * MS
        assert one.contacts(gateway)[-1].acquired_ns == first_ns
        assert arrivals.samples[0] == (first_ns, back_ns)
        packet_ns = arrivals.packets[0][0]
        assert packet_ns - first_ns <= 100 * MS
        for at_ns, put_ns in arrivals.packets:
            assert put_ns > began_ns
            if at_ns < first_ns + 20 * MS:
                # Little may wait, and a packet that has begun is completed.
                assert at_ns - put_ns <= (DELAY_MS + 50 + 40) * MS
    assert one.states == ("CONNECTED", "CONNECTED")


def test_a_loss_of_signal_flushes_waiting_packets():
    one = session()
    sender = one.link.ground.sender
    one.run(25)
    assert sum(sender.waiting_octets(level) for level in Level)
    one.shut(one.down)
    while one.link.ground.supervisor.signal:
        one.step()
    assert not sum(sender.waiting_octets(level) for level in Level)
    drops = [queue.drops for queue in sender.report(one.link.now_ns).queue.values()]
    assert sum(drop["signal_lost"] for drop in drops)


def test_uplink_only_telecommands_work_without_acknowledgement():
    one = session()
    one.command("left")
    one.run(100)
    assert [answer.ok for answer in one.answers()] == [True]
    one.shut(one.down)
    one.run(100)
    assert one.states == ("SEARCH", "CONFIGURE")
    samples, packets = len(one.at_space.samples), len(one.at_space.packets)
    one.command("right")
    one.run(1600)
    assert one.selected == ["left", "right"]
    (failed,) = one.answers()
    assert not failed.ok and not failed.verified
    assert failed.tries == 2
    # Everything else arrives as well, and nothing late.
    assert len(one.at_space.samples) - samples == 1600
    assert len(one.at_space.packets) - packets >= 1600 // 20
    one.run(10_000)
    assert all(at_ns - put_ns <= 200 * MS for at_ns, put_ns in one.at_space.packets[packets:])
    one.shut()
    one.run(100)
    assert one.states == ("CONNECTED", "CONNECTED")
    one.command("left")
    one.run(100)
    assert [answer.ok for answer in one.answers()] == [True]
    assert one.executor.executed == 3


def test_downlink_only_pictures_continue():
    one = session()
    one.shut(one.up)
    one.run(100)
    assert one.states == ("CONFIGURE", "SEARCH")
    packets = len(one.at_ground.packets)
    one.command("right")
    one.run(5_000)
    assert not one.selected
    assert [answer.verified for answer in one.answers()] == [False]
    assert len(one.at_ground.packets) - packets >= 0.98 * (5000 // 33 + 5000 // 20)
    one.shut()
    one.run(100)
    assert one.states == ("CONNECTED", "CONNECTED")
    # What was requested meanwhile was not kept for later.
    one.run(1000)
    assert not one.selected


@pytest.mark.parametrize("open_path", ["up", "down"])
def test_one_direction_from_the_beginning(open_path):
    one = Session()
    one.shut(one.down if open_path == "up" else one.up)
    one.command("right")
    one.run(3000)
    arrivals = one.at_space if open_path == "up" else one.at_ground
    assert arrivals.samples[0][0] <= (DELAY_MS + 30) * MS
    assert len(arrivals.packets) >= 3000 // 20
    assert one.selected == (["right"] if open_path == "up" else [])
    assert one.commands.garbage == one.executor.garbage == 0


def test_counts_and_reports_are_exact_over_blackouts():
    reports = []
    for _ in range(2):
        one = session()
        for paths in ((one.up, one.down), (), (one.up,), (), (one.down,), ()):
            one.shut(*paths)
            one.run(170)
        reports.append(
            [gateway.report(one.link.now_ns) for gateway in (one.link.ground, one.link.space)]
        )
        for gateway in (one.link.ground, one.link.space):
            octets = gateway.report(one.link.now_ns).transmit.octets
            frames = gateway.sender.frames_sent * gateway.sender.profile.frame_octets
            assert sum(octets.values()) == frames
            assert octets["supervision"]
    assert reports[0] == reports[1]
