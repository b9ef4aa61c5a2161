"""Two gateways with a radio between them."""

import struct

from telepresence.link.flows import Level, packet_flow, tmtc_flow, voice_flow
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath
from telepresence.link.receiver import HapticReceived, PacketReceived
from telepresence.link.sender import LinkSender
from telepresence.tmtc import Housekeeping, SelectAck, SelectCamera, pack_packet

MS = 1_000_000
UP = [packet_flow("tc", Level.TMTC)]
DOWN = [packet_flow("tm", Level.TMTC)]


def segments(delay_ns):
    ground = Gateway(
        transmit=UPLINK,
        transmit_flows=UP,
        receive=DOWNLINK,
        receive_flows=DOWN,
        radio=RadioPath(delay_ns=delay_ns),
    )
    space = Gateway(
        transmit=DOWNLINK,
        transmit_flows=DOWN,
        receive=UPLINK,
        receive_flows=UP,
        radio=RadioPath(delay_ns=delay_ns),
    )
    return ground, space


def test_both_ways_with_a_delay():
    ground, space = segments(delay_ns=12_500_000)
    ground.handle_datagram("tc", b"select", 0)
    space.handle_datagram("tm", b"telemetry", 0)
    space.handle_haptic(bytes(range(12)), 0)
    arrived = []
    for now_ns in range(0, 20 * MS, 500_000):
        if now_ns % MS == 0:
            ground.handle_slot(now_ns)
            space.handle_slot(now_ns)
        for name, one, other in (("space", ground, space), ("ground", space, ground)):
            while frame := one.poll_transmit(now_ns):
                other.handle_radio(frame, now_ns)
            while event := other.next_event():
                arrived.append((name, event))
    assert [(name, event.now_ns) for name, event in arrived] == [
        ("space", 12_500_000),
        ("ground", 12_500_000),
        ("ground", 12_500_000),
    ]
    first, second, third = (event for _, event in arrived)
    assert isinstance(first, PacketReceived)
    assert first.data == b"select"
    assert second == HapticReceived(bytes(range(12)), 12_500_000)
    assert isinstance(third, PacketReceived)
    assert third.flow.name == "tm"
    report = ground.report(20 * MS)
    assert report["transmit"]["name"] == "uplink"
    assert report["transmit"]["octets"]["tmtc"] == 6
    assert report["receive"]["haptic"] == {"received": 1}
    assert report["radio"]["frames_under_way"] == 12


def test_poll_timeout_is_when_the_next_frame_arrives():
    ground, _ = segments(delay_ns=3 * MS)
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


def test_a_peer_that_begins_late_or_anew_understands_the_next_packet():
    """Contexts go out a second apart; a peer that has just come up need not wait for the next."""
    flow = voice_flow("voice")
    space = []

    def gateway():
        return Gateway(transmit=UPLINK, transmit_flows=[flow], receive=DOWNLINK, receive_flows=[])

    def peer():
        return Gateway(transmit=DOWNLINK, transmit_flows=[], receive=UPLINK, receive_flows=[flow])

    ground, far = gateway(), None
    for slot in range(900):
        now_ns = slot * MS
        if slot in (105, 505):
            far = peer()  # the second one is a restart
        if slot % 20 == 0:
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
            while (event := far.next_event()) is not None:
                space.append(event.data[3] + 256 * event.data[2])
    assert space == list(range(6, 45))


def test_garbage_on_a_telecommand_port_does_not_travel_ahead_of_the_media():
    sender = LinkSender(UPLINK, [tmtc_flow("telemetry")])
    select = pack_packet(SelectCamera("static", 7), 1)
    telemetry = Housekeeping("taskboard1", contact=True, force_n=3.0)
    for message in (telemetry, SelectAck("head", 7, ok=True), SelectCamera("s", 1)):
        assert sender.handle_packet("telemetry", pack_packet(message, 16_383), 0)
    garbage = [
        b"",
        bytes(20),
        b"\xff" * 20,
        select[:-1],
        select + b"x",
        b"\x20" + select[1:],  # version 1
        select[:1] + b"\x02" + select[2:],  # telemetry's APID in a telecommand
        select[:2] + b"\x00" + select[3:],  # segmented
        select[:5] + b"\x0d" + select[6:] + b"morethan20",
    ]
    for count, datagram in enumerate(garbage, 1):
        assert not sender.handle_packet("telemetry", datagram, 0)
        assert sender.refused["garbage"] == count
