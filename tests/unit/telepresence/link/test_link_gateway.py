"""Two gateways with a radio between them: how sender, receiver and supervision work together."""

import struct

import pytest
from virtual_link import VirtualLink

from telepresence.haptics.mediated.wall import WallMessage, pack_wall
from telepresence.link.flows import (
    HapticReceived,
    Level,
    PacketReceived,
    packet_flow,
    tmtc_flow,
    voice_flow,
)
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.radio import RadioPath, RadioProfile
from telepresence.link.radio.profile import Blackout
from telepresence.link.sender import LinkSender
from telepresence.link.supervision.message import LinkState
from telepresence.tmtc.pus.packets import Telecommand, Telemetry, pack_packet

MS = 1_000_000
UP = [packet_flow("tc", Level.TMTC)]
DOWN = [packet_flow("tm", Level.TMTC)]


def linked(delay_ns=0, blackouts=()):
    radio = RadioProfile(name="test", delay_ms=delay_ns / MS, blackouts=blackouts)
    return VirtualLink(
        uplink_flows=UP,
        downlink_flows=DOWN,
        up=radio.path("uplink", seed=1, epoch_ns=0),
        down=radio.path("downlink", seed=1, epoch_ns=0),
    )


def run(link, until_ns, sent=(), samples=()):
    """Step until `until_ns`.

    sent: (instant, side, flow, data). samples: the sides that have a sample in each slot.
    """
    sent = sorted(sent, reverse=True)
    arrived = []
    while link.now_ns < until_ns:
        while sent and sent[-1][0] <= link.now_ns:
            _, side, flow, data = sent.pop()
            getattr(link, side).handle_datagram(flow, data, link.now_ns)
        for side in samples:
            getattr(link, side).handle_haptic(bytes(range(12)), link.now_ns)
        for gateway, event in link.step():
            arrived.append(("ground" if gateway is link.ground else "space", event))
    return arrived


def test_both_ways_with_a_delay():
    link = linked(delay_ns=12_500_000)
    sent = [(100 * MS, "ground", "tc", b"select"), (100 * MS, "space", "tm", b"telemetry")]
    arrived = run(link, 150 * MS, sent)
    assert [(side, event.data, event.now_ns) for side, event in arrived] == [
        ("space", b"select", 112_500_000),
        ("ground", b"telemetry", 112_500_000),
    ]
    report = link.ground.report(link.now_ns)
    assert report.transmit.octets["tmtc"] == 6
    assert report.radio.frames_under_way == 12
    assert report.supervision.state == "connected"


def test_poll_timeout_is_when_the_next_frame_arrives():
    link = linked(delay_ns=3 * MS)
    ground = link.ground
    assert ground.poll_timeout() is None
    ground.handle_slot(MS)
    ground.handle_slot(2 * MS)
    assert ground.poll_timeout() == 4 * MS
    assert ground.poll_transmit(4 * MS - 1) is None
    assert ground.poll_transmit(4 * MS) is not None
    assert ground.poll_timeout() == 5 * MS


def test_radio_loss_is_repeatable():
    def survivors(seed):
        radio = RadioPath(loss=0.3, seed=seed)
        for k in range(200):
            radio.handle_frame(bytes([k]), 0)
        return list(iter(lambda: radio.poll_transmit(0), None))

    assert survivors(1) == survivors(1) != survivors(2)
    assert 100 < len(survivors(1)) < 180


def test_a_loss_of_signal_flushes_the_queues_and_haptics_return_at_once():
    link = linked(delay_ns=2 * MS, blackouts=(Blackout(start_s=1.0, seconds=0.3),))
    # More than can be sent before the blackout, so the queue is full when the signal is lost.
    old = [(950 * MS, "ground", "tc", b"old" + bytes(100))] * 40
    new = [(1_301 * MS, "ground", "tc", b"new")]
    arrived = run(link, 1_500 * MS, [*old, *new], samples=("ground", "space"))
    packets = [event for _, event in arrived if isinstance(event, PacketReceived)]
    assert all(event.now_ns < 1_010 * MS for event in packets if event.data.startswith(b"old"))
    assert [event.now_ns for event in packets if event.data == b"new"] == [1_303 * MS]
    for side in ("ground", "space"):
        back = [e.now_ns for s, e in arrived if s == side and isinstance(e, HapticReceived)]
        assert next(ns for ns in back if ns > 1_050 * MS) == 1_302 * MS
    drops = link.ground.report(link.now_ns).transmit.queue["tmtc"].drops
    assert drops["signal_lost"] > 20
    for gateway in (link.ground, link.space):
        assert gateway.supervisor.state is LinkState.CONNECTED


def test_a_single_working_direction_keeps_carrying():
    link = linked(blackouts=(Blackout(start_s=0.5, seconds=10, direction="downlink"),))
    sent = [(2000 * MS, "ground", "tc", b"up"), (2000 * MS, "space", "tm", b"down")]
    arrived = run(link, 2_100 * MS, sent)
    assert [(side, event.data) for side, event in arrived] == [("space", b"up")]
    assert not link.ground.supervisor.signal
    assert link.space.supervisor.signal


def test_ends_with_different_configurations_deliver_nothing_and_say_why():
    flows = {"transmit_flows": UP, "receive_flows": DOWN}
    wide = LinkProfile(name="uplink", frame_octets=32, scid=0x4B, pointer_in_vcid=True)
    other = LinkProfile(name="downlink", frame_octets=500, scid=0x4C, slot_ns=2 * MS)
    ground = Gateway(transmit=wide, receive=DOWNLINK, **flows, master=True, life=1, now_ns=0)
    space = Gateway(
        transmit=other,
        receive=wide,
        transmit_flows=DOWN,
        receive_flows=UP,
        master=False,
        life=2,
        now_ns=0,
    )
    for slot in range(500):
        now_ns = slot * MS
        ground.handle_haptic(bytes(12), now_ns)
        ground.handle_slot(now_ns)
        space.handle_slot(now_ns)
        for near, far in ((ground, space), (space, ground)):
            while (frame := near.poll_transmit(now_ns)) is not None:
                far.handle_radio(frame, now_ns)
            assert far.next_event() is None
    report = space.report(500 * MS)
    assert report.supervision.state == "refused"
    assert "downlink has 2000 kbit/s here and 4000 there" in report.supervision.why
    assert report.receive.haptic_unapproved > 400


@pytest.mark.parametrize("restart_at", [105, 505])
def test_a_peer_that_starts_late_or_restarts_understands_the_next_packet(restart_at):
    """A peer that has just started must not have to wait for the next context, a second later."""
    flow = voice_flow("voice")
    heard = []

    def gateway(life):
        return Gateway(
            transmit=UPLINK,
            transmit_flows=[flow],
            receive=DOWNLINK,
            receive_flows=[],
            master=True,
            life=life,
            now_ns=0,
        )

    def peer(life, now_ns):
        return Gateway(
            transmit=DOWNLINK,
            transmit_flows=[],
            receive=UPLINK,
            receive_flows=[flow],
            master=False,
            life=life,
            now_ns=now_ns,
        )

    ground, far = gateway(1), None
    for slot in range(900):
        now_ns = slot * MS
        if slot in (50, restart_at):
            far = peer(slot, now_ns)
        if slot % 20 == 10:
            number = slot // 20
            packet = struct.pack("!BBHII", 0x80, 97, number, 960 * number, 7) + bytes(20)
            ground.handle_datagram("voice", packet, now_ns)
        ground.handle_slot(now_ns)
        while (frame := ground.poll_transmit(now_ns)) is not None:
            if far is not None:
                far.handle_radio(frame, now_ns)
        if far is not None:
            far.handle_slot(now_ns)
            while (frame := far.poll_transmit(now_ns)) is not None:
                ground.handle_radio(frame, now_ns)
            assert ground.next_event() is None
            while (event := far.next_event()) is not None:
                heard.append(event.data[3])
    assert heard[0] in (2, 3)
    after = restart_at // 20 + 1
    # After a supervision message, no packet from the first whole one on is missing.
    assert set(range(after + 1, 45)) <= set(heard)


def test_a_reset_of_the_applications_forgets_what_the_peer_sent_before():
    """Nothing comes for long: header contexts from before are no longer reported as held."""
    radio = RadioProfile(name="test")
    link = VirtualLink(
        uplink_flows=[voice_flow("up")],
        downlink_flows=[voice_flow("down")],
        up=radio.path("uplink", seed=1, epoch_ns=0),
        down=radio.path("downlink", seed=1, epoch_ns=0),
    )
    voice = []
    for number in range(50):
        packet = struct.pack("!BBHII", 0x80, 97, number, 960 * number, 7) + bytes(20)
        voice.append((number * 20 * MS, "ground", "up", packet))
        voice.append((number * 20 * MS, "space", "down", packet))
    run(link, 1000 * MS, voice, samples=("ground", "space"))
    ends = (link.ground, link.space)
    assert all(end.receiver.context_ids()[0] for end in ends)
    reset = []
    while not reset:
        run(link, link.now_ns + 50 * MS)
        assert link.now_ns < 5000 * MS
        counts = {end: end.report(link.now_ns).supervision.counts for end in ends}
        reset = [end for end in ends if counts[end]["resets_idle"] + counts[end]["resets_broken"]]
    for end in reset:
        assert not any(end.receiver.context_ids())


def test_garbage_on_a_telecommand_port_is_not_sent():
    sender = LinkSender(UPLINK, [tmtc_flow("telemetry")])
    select = pack_packet(Telecommand(apid=0x133, count=7, service=8, subtype=1, data=b"\1static"))
    report = pack_packet(Telemetry(apid=0x133, count=16_383, service=17, subtype=2))
    wall = pack_wall(WallMessage(1, None), 16_383)
    for packet in (report, select, wall):
        assert sender.handle_packet("telemetry", packet, 0)
    garbage = [
        b"",
        bytes(20),
        b"\xff" * 20,
        *(packet[:-1] for packet in (select, wall)),
        *(packet + b"x" for packet in (select, wall)),
        b"\x38" + select[1:],  # version 1
        b"\x11" + select[1:],  # without a secondary header
        wall[:1] + b"\x02" + wall[2:],  # another APID
        *(packet[:2] + b"\x00" + packet[3:] for packet in (select, wall)),  # segmented
        select[:4] + b"\x00\xff" + select[6:] + bytes(256 - len(select) + 6),  # too long
    ]
    for count, datagram in enumerate(garbage, 1):
        assert not sender.handle_packet("telemetry", datagram, 0)
        assert sender.refused["garbage"] == count
