"""What the receiver counts: losses, restarts, late frames, invalid frames."""

import struct
from binascii import crc_hqx
from random import Random

import pytest

from telepresence.link.flows import (
    Level,
    PacketReceived,
    SupervisionReceived,
    packet_flow,
    rtcp_flow,
    video_flow,
)
from telepresence.link.frame import FrameCodec
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.queues import DropPolicy, QueueLimits
from telepresence.link.receiver import LinkReceiver, StrangerFrame
from telepresence.link.sender import LinkSender

MS = 1_000_000
FLOWS = [packet_flow("tmtc", Level.TMTC), video_flow("video"), rtcp_flow("rtcp")]


def frames(count, first_count=0, profile=UPLINK):
    sender = LinkSender(profile, FLOWS, first_count=first_count)
    return [sender.poll_transmit(k * MS) for k in range(count)]


def feed(receiver, many, now_ns=0):
    for frame in many:
        receiver.handle_frame(frame, now_ns)
        now_ns += MS
    return now_ns


def test_gaps_are_counted_across_the_wrap():
    receiver = LinkReceiver(UPLINK, FLOWS)
    sent = frames(20, first_count=0xFFFFFA)
    feed(receiver, sent[:4] + sent[9:])
    assert receiver.frames_lost == 5
    assert receiver.frames_received == 15
    assert receiver.restarts == 0


def test_another_stream_is_followed_only_when_told():
    """However many of its frames come in a row, from whatever count on."""
    starts = ((1_000_000, 0), (5_000, 4_000), (1_000_000, 999_970), (7_000_000, 9_000_000))
    for former, first in starts:
        receiver = LinkReceiver(UPLINK, FLOWS)
        now_ns = feed(receiver, frames(20, former))
        others = frames(52, first)[2:]
        now_ns = feed(receiver, others[:40], now_ns)
        assert (receiver.frames_received, sum(receiver.frames_dropped.values())) == (20, 40)
        assert receiver.stranger == StrangerFrame(None, 40, 39 * MS)
        receiver.follow_stranger(new_life=True)
        # They were frames of the peer, though what they carried was dropped.
        assert (receiver.frames_received, receiver.restarts) == (60, 1)
        feed(receiver, others[40:], now_ns)
        assert (receiver.frames_received, receiver.restarts, receiver.frames_lost) == (70, 1, 0)
        assert receiver.frames_dropped == {}


def test_the_frame_with_which_a_stream_is_followed_is_taken():
    receiver, sender = LinkReceiver(UPLINK, FLOWS), LinkSender(UPLINK, FLOWS, first_count=77)
    receiver.cautious = True
    for slot in range(3):
        sender.handle_haptic(bytes([slot] * 12), 0)
        sender.handle_packet("tmtc", bytes([slot]), 0)
        assert not receiver.handle_frame(sender.poll_transmit(slot * MS), slot * MS)
        assert receiver.next_event() is None
    assert receiver.haptic_unapproved == receiver.packets.dropped["unapproved"] == 3
    receiver.follow_stranger(new_life=True)
    assert [event[0] for event in receiver.events if not hasattr(event, "data")] == [b"\2" * 12]
    assert [event.data for event in receiver.events if hasattr(event, "data")] == [b"\2"]
    # Each frame, sample and packet is counted once.
    assert (receiver.frames_received, receiver.frames_dropped) == (3, {})
    assert receiver.haptic_unapproved == receiver.packets.dropped["unapproved"] == 2
    assert (receiver.haptic_received, receiver.packets.received[0]) == (1, 1)
    assert receiver.restarts == 0


@pytest.mark.parametrize(
    ("silence_ms", "ahead", "belongs"),
    [
        (1, 2, True),
        (1, 20, True),  # 20 ms before its time, as after a shorter delay
        (1, 23, False),
        (1, 1000, False),
        (1000, 1020, True),
        (1000, 1040, False),
        (300, 2, True),  # late: slots were left out, or this end was held up
        (10_000, 10_000, True),
        (10_000, 10_090, True),
        (10_000, 10_110, False),
        (10_000, 6_500, True),  # a second and a quarter of the silence behind, and not a slot more
        (10_000, 6_499, False),
        (10_000, 1, True),  # exactly the next count always belongs
        (59_000, 59_000, True),
        (61_000, 61_000, False),  # too long ago
        (61_000, 1, True),
        (10_000, 1 << 23, False),
        (1, 0, False),  # repeated
        (1, -31, False),
        (1, -500_000, False),
    ],
)
def test_a_frame_belongs_to_the_stream_if_its_count_fits_the_time(silence_ms, ahead, belongs):
    receiver, codec = LinkReceiver(UPLINK, FLOWS), FrameCodec(UPLINK)
    # The clock has run for long when the first frame comes.
    now_ns = feed(receiver, frames(200, 8_000_000 - 199), 10**15) - MS
    frame = codec.pack(8_000_000 + ahead, None, 30, bytes(24))
    assert receiver.handle_frame(frame, now_ns + silence_ms * MS) == belongs
    assert receiver.frames_received == 200 + belongs
    reason = "late" if -31 <= ahead <= 0 else "stray"
    assert receiver.frames_dropped == ({} if belongs else {reason: 1})
    # Whatever it was, the stream goes on.
    assert receiver.handle_frame(
        codec.pack(8_000_000 + max(ahead, 0) + 1, None, 30, bytes(24)),
        now_ns + (silence_ms + 1) * MS,
    ) == (belongs or ahead <= 0)


def test_the_time_of_a_stream_is_that_of_its_earliest_frames():
    """After it was held up, this end reads what waited, and then what comes at present."""
    receiver = LinkReceiver(UPLINK, FLOWS)
    sent = frames(1500, 50)
    now_ns = feed(receiver, sent[:1000]) + 400 * MS
    for frame in sent[1000:1150]:
        assert receiver.handle_frame(frame, now_ns)
    # The rest was lost on the way.
    assert receiver.handle_frame(sent[1400], now_ns + MS)
    assert (receiver.frames_lost, receiver.frames_dropped) == (250, {})


def test_the_same_life_goes_on_at_another_count():
    """Contexts and the count of 24 bits go on; the frames between are lost."""
    for former, first, lost in ((100, 9_100, 8_995), (0xFFFFF0, 0x1000, 0x1010 - 5)):
        receiver = LinkReceiver(UPLINK, FLOWS)
        now_ns = feed(receiver, frames(5, former))
        feed(receiver, frames(1, first), now_ns)
        assert receiver.follow_stranger(new_life=False)
        feed(receiver, frames(5, first)[1:], now_ns + MS)
        assert (receiver.frames_received, receiver.restarts) == (10, 0)
        assert receiver.frames_lost == lost


def test_a_flood_of_stray_frames_costs_no_more_than_one():
    """Each may begin a stream of its own; only one of them is kept beside the peer's."""
    receiver, codec, random = LinkReceiver(UPLINK, FLOWS), FrameCodec(UPLINK), Random(1)
    now_ns = feed(receiver, frames(20, 100))
    for k in range(3000):
        receiver.handle_frame(codec.pack(random.getrandbits(24), None, 30, bytes(24)), now_ns + k)
    assert receiver.frames_dropped == {"stray": 3000}
    feed(receiver, frames(5, 120), now_ns)
    assert (receiver.frames_received, receiver.frames_lost) == (25, 0)


def test_late_copies_of_the_same_life_are_not_followed():
    receiver = LinkReceiver(UPLINK, FLOWS)
    now_ns = feed(receiver, frames(5, 9_100))
    for first in (9_104, 9_000, 0):
        feed(receiver, frames(1, first), now_ns)
        assert not receiver.follow_stranger(new_life=False)
    assert (receiver.frames_received, sum(receiver.frames_dropped.values())) == (5, 3)
    assert feed(receiver, frames(5, 9_105), now_ns)
    assert (receiver.frames_received, receiver.frames_lost) == (10, 0)
    # After hours a lower count is one that has wrapped.
    now_ns += 3 * 3600 * 1000 * MS
    feed(receiver, frames(1, 9_000), now_ns)
    assert receiver.follow_stranger(new_life=False)
    assert (receiver.frames_received, receiver.frames_lost) == (11, 0)


def test_an_answer_is_followed_beside_a_busy_stranger():
    """The frame with the message is of neither stream, and its own is followed."""
    receiver = LinkReceiver(UPLINK, FLOWS)
    now_ns = feed(receiver, frames(20, 1000))
    now_ns = feed(receiver, frames(20, 5_000_000), now_ns)
    sender = LinkSender(UPLINK, FLOWS, first_count=9_000_000)
    assert not receiver.handle_frame(sender.poll_transmit(now_ns, b"supervision!"), now_ns)
    assert receiver.stranger == StrangerFrame(b"supervision!", 0, 0)
    receiver.follow_stranger(new_life=True)
    assert receiver.next_event() == SupervisionReceived(b"supervision!", now_ns)
    assert receiver.handle_frame(sender.poll_transmit(now_ns), now_ns + MS)
    assert (receiver.restarts, receiver.frames_received) == (1, 22)


def test_a_single_implausible_count_is_a_bit_error():
    receiver = LinkReceiver(UPLINK, FLOWS)
    sent = frames(10, 100)
    for wild in (5_000_000, 99 - 40, 1):
        sent[4] = FrameCodec(UPLINK).pack(wild, None, 0, bytes(24))
        receiver = LinkReceiver(UPLINK, FLOWS)
        feed(receiver, sent)
        assert receiver.frames_dropped == {"stray": 1}
        assert (receiver.restarts, receiver.frames_lost) == (0, 1)


def test_contexts_of_a_former_life_are_not_used():
    """The new peer assumes that its contexts are held, but the frames with them are lost."""
    receiver = LinkReceiver(UPLINK, FLOWS)
    now_ns = 0
    for life in range(2):
        sender = LinkSender(UPLINK, FLOWS)
        sender.handle_peer(heard=True)
        for slot in range(2000):
            if slot % 33 == 0:
                header = struct.pack(">BBHII", 0x80, 96, slot // 33, slot // 33 * 3000, life)
                sender.handle_packet("video", header + b"picture", slot * MS)
            frame = sender.poll_transmit(slot * MS)
            if life and slot < 1000:
                sender.handle_acknowledgements([1])
            elif not receiver.handle_frame(frame, now_ns):
                receiver.follow_stranger(new_life=True)
            now_ns += MS
        if not life:
            assert receiver.context_ids()[0] > 0
            assert receiver.packets.received[1] == 61
        while event := receiver.next_event():
            assert event.data[8:12] == bytes([0, 0, 0, life])
    assert receiver.restarts == 1
    assert receiver.packets.dropped["no_context"] > 0


def test_contexts_go_on_when_the_same_life_goes_on_at_another_count():
    """Headers without a timestamp are restored from the count of frames."""
    receiver, sender = LinkReceiver(UPLINK, FLOWS), LinkSender(UPLINK, FLOWS)
    sender.handle_peer(heard=True)
    sent, came = [], []
    now_ns = 0
    for slot in range(4000):
        if slot % 33 == 0:
            number = slot // 33
            header = struct.pack(">BBHII", 0x80, 96, number, number * 2970, 7)
            sent.append(header + b"picture")
            sender.handle_packet("video", sent[-1], slot * MS)
        frame = sender.poll_transmit(slot * MS)
        if 2000 <= slot < 3010:
            continue  # held back on the way, and then lost: no time passes for the receiver
        if not receiver.handle_frame(frame, now_ns):
            assert receiver.follow_stranger(new_life=False)
        sender.handle_acknowledgements(receiver.context_ids())
        came += [event.data for event in iter(receiver.next_event, None)]
        now_ns += MS
    assert receiver.restarts == 0 and receiver.frames_lost == 1010
    assert came == sent[:61] + sent[-len(came) + 61 :] and len(came) > 85


def test_without_approval_a_followed_stream_is_not_delivered_either():
    receiver, sender = LinkReceiver(UPLINK, FLOWS), LinkSender(UPLINK, FLOWS, first_count=5_000)
    receiver.deliver = False
    now_ns = feed(receiver, frames(20))
    for slot in range(3):
        sender.handle_haptic(bytes(12), now_ns)
        sender.handle_packet("tmtc", b"telecommand", now_ns)
        receiver.handle_frame(sender.poll_transmit(now_ns), now_ns + slot * MS)
    assert receiver.follow_stranger(new_life=True)
    assert receiver.next_event() is None
    assert receiver.haptic_unapproved == receiver.packets.dropped["unapproved"] == 1


def test_without_approval_only_supervision_is_delivered():
    sender, receiver = LinkSender(DOWNLINK, FLOWS), LinkReceiver(DOWNLINK, FLOWS)
    receiver.deliver = False
    sender.handle_haptic(bytes(12), 0)
    sender.handle_packet("tmtc", b"telecommand", 0)
    assert receiver.handle_frame(sender.poll_transmit(0), 0)
    assert receiver.handle_frame(sender.poll_transmit(0, b"supervision!"), 1)
    assert receiver.next_event() == SupervisionReceived(b"supervision!", 1)
    assert receiver.next_event() is None
    assert (receiver.report().haptic_received, receiver.report().haptic_unapproved) == (0, 1)
    assert receiver.packets.dropped == {"unapproved": 1}
    receiver.deliver = True
    sender.handle_packet("tmtc", b"telecommand", 0)
    receiver.handle_frame(sender.poll_transmit(0), 2)
    assert receiver.next_event().data == b"telecommand"


def test_a_loss_of_signal_drops_incomplete_packets():
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    sender.handle_packet("tmtc", bytes(100), 0)
    for slot in range(3):
        receiver.handle_frame(sender.poll_transmit(slot), slot)
    receiver.handle_signal_lost(3)
    for slot in range(3, 8):
        receiver.handle_frame(sender.poll_transmit(slot), slot)
    assert receiver.next_event() is None
    assert receiver.packets.dropped == {"incomplete": 1}


def test_flushed_packets_are_never_sent_and_counted_by_level():
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    for name, data in (("rtcp", b"\x80\xc8" + bytes(60)), ("tmtc", b"t" * 60), ("tmtc", b"u" * 9)):
        sender.handle_packet(name, data, 0)
        receiver.handle_frame(sender.poll_transmit(0), 0)
    sender.flush(0)
    sender.handle_packet("tmtc", b"after", 0)
    for _ in range(9):
        receiver.handle_frame(sender.poll_transmit(0), 0)
    assert [event.data for event in iter(receiver.next_event, None)] == [b"after"]
    queues = sender.report(0).queue
    assert queues["tmtc"].drops["signal_lost"] == 2
    assert queues["video"].drops["signal_lost"] == 1


def test_patience_ends_waiting_and_interrupted_packets():
    """A packet ages until its last octet is sent, also while others interrupt it."""
    endless = QueueLimits(
        depth_octets=8_192, max_age_ns=10_000 * MS, policy=DropPolicy.REJECT_NEWEST
    )
    for patience_ns, reason, age in ((None, "expired", 700), (50 * MS, "signal_lost", 60)):
        sender = LinkSender(UPLINK, FLOWS, limits={Level.TMTC: endless})
        receiver = LinkReceiver(UPLINK, FLOWS)
        sender.set_patience(patience_ns)
        sender.handle_packet("rtcp", b"\x80\xc8" + bytes(98), 0)
        for slot in range(age):
            if slot % 2:
                sender.handle_packet("tmtc", bytes(60), slot * MS)
            receiver.handle_frame(sender.poll_transmit(slot * MS), slot * MS)
        for slot in range(age, age + 3000):
            receiver.handle_frame(sender.poll_transmit(slot * MS), slot * MS)
        assert sender.report(0).queue["video"].drops[reason] == 1
        assert receiver.packets.received[2] == 0


def test_repeated_and_late_frames_are_dropped():
    receiver = LinkReceiver(UPLINK, FLOWS)
    sent = frames(10, 100)
    feed(receiver, [*sent[:5], sent[4], sent[6], sent[5], *sent[7:]])
    assert receiver.frames_dropped == {"late": 2}
    assert (receiver.frames_received, receiver.frames_lost, receiver.restarts) == (9, 1, 0)
    receiver = LinkReceiver(UPLINK, FLOWS)
    feed(receiver, [*sent[:3], sent[6], *sent[3:6], *sent[7:]])
    assert receiver.frames_dropped == {"late": 3}
    assert (receiver.frames_received, receiver.restarts) == (7, 0)


def test_an_endless_packet_is_dropped_at_the_size_limit():
    receiver, codec = LinkReceiver(UPLINK, FLOWS), FrameCodec(UPLINK)
    receiver.handle_frame(codec.pack(0, None, 0, b"\x08" + bytes(23)), 0)
    for count in range(1, 100):
        receiver.handle_frame(codec.pack(count, None, 31, bytes(24)), count * MS)
    assert receiver.packets.dropped == {"oversize": 1}
    assert receiver.handle_frame(codec.pack(100, None, 30, bytes(24)), 100 * MS)
    assert receiver.next_event() is None


@pytest.mark.parametrize(
    ("reason", "mutate"),
    [
        ("length", lambda frame: frame[:-1]),
        ("length", lambda frame: b""),
        ("fecf", lambda frame: frame[:9] + bytes([frame[9] ^ 4]) + frame[10:]),
        ("version", lambda frame: resealed(b"\x12" + frame[1:-2])),
        ("vcid", lambda frame: resealed(frame[:1] + bytes([frame[1] ^ 0x20]) + frame[2:-2])),
        ("scid", lambda frame: frames(1, profile=OTHER_CRAFT)[0]),
        ("signaling", lambda frame: resealed(frame[:5] + bytes([frame[5] | 0x80]) + frame[6:-2])),
    ],
)
def test_invalid_frames_are_dropped(reason, mutate):
    receiver = LinkReceiver(UPLINK, FLOWS)
    receiver.handle_frame(mutate(frames(1)[0]), 0)
    assert receiver.frames_dropped == {reason: 1}
    assert receiver.frames_received == 0


OTHER_CRAFT = LinkProfile(name="other", frame_octets=32, scid=9, vcid=0, pointer_in_vcid=True)


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
@pytest.mark.parametrize("sampled", [False, True])
def test_every_bit_that_must_be_zero_is_checked(profile, sampled):
    sender = LinkSender(profile, FLOWS)
    if sampled:
        sender.handle_haptic(bytes(12), 0)
    body = sender.poll_transmit(0)[:-2]
    receiver = LinkReceiver(profile, FLOWS)
    # Replay flag, the SCID's two highest bits, the frame count cycle; not the usage flag.
    for bit in (0x80, 0x20, 0x10, 0x08, 0x04, 0x02, 0x01):
        changed = body[:5] + bytes([body[5] ^ bit]) + body[6:]
        assert not receiver.handle_frame(resealed(changed), 0)
    assert receiver.frames_dropped == {"signaling": 7}
    # The five spare bits of the M_PDU header.
    at = 18 if sampled else 6
    for bit in (0x80, 0x40, 0x20, 0x10, 0x08) if profile.mpdu_octets else ():
        changed = body[:at] + bytes([body[at] ^ bit]) + body[at + 1 :]
        assert not receiver.handle_frame(resealed(changed), 0)
    assert receiver.frames_dropped.get("mpdu", 0) == (5 if profile.mpdu_octets else 0)
    assert receiver.frames_received == 0


def resealed(body):
    return body + crc_hqx(body, 0xFFFF).to_bytes(2, "big")


def test_undefined_tags_are_counted():
    receiver = LinkReceiver(UPLINK, FLOWS)
    codec = FrameCodec(UPLINK)
    # An undefined control code; a flow that is not in the table; pieces that end beyond the zone,
    # with a short length and a long one; a length, and its second octet, beyond the zone; a
    # reserved kind.
    zones = ["03", "0b", "8817", "888100", "01" * 23 + "88", "01" * 22 + "8880", "9802abcd"]
    for count, zone in enumerate(zones):
        zone = bytes.fromhex(zone).ljust(24, b"\0")
        assert receiver.handle_frame(codec.pack(count, None, 0, zone), 0)
    # Pointers that are neither a position nor a code.
    for pointer in (25, 26, 27):
        assert receiver.handle_frame(codec.pack(pointer - 18, None, pointer, bytes(24)), 0)
    assert receiver.packets.dropped["malformed"] == len(zones) + 3
    assert receiver.next_event() is None
    assert receiver.frames_received == len(zones) + 3


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
def test_every_length_from_every_position(profile):
    """A packet of each length, begun at each position in the zone, arrives unchanged."""
    zone = profile.largest_zone_octets
    positions = range(zone) if zone < 25 else (0, 1, zone - 5, zone - 4, zone - 3, zone - 2)
    lengths = [*range(40), *range(zone - 12, zone + 4), 127, 128, 2 * zone]
    for before in positions:
        for length in lengths:
            sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
            packets = [bytes([7]) * before, bytes(range(256)) * 8, b"last"]
            packets[1] = packets[1][:length]
            for packet in packets:
                assert sender.handle_packet("tmtc", packet, 0)
            for slot in range(6 + (before + length) // (zone - 2)):
                receiver.handle_frame(sender.poll_transmit(slot), slot)
            out = []
            while event := receiver.next_event():
                assert isinstance(event, PacketReceived)
                out.append(event.data)
            assert out == packets, (before, length)
            assert sum(sender.octets().values()) == sender.frames_sent * profile.frame_octets


def test_garbage_from_a_local_port_takes_no_capacity():
    sender = LinkSender(UPLINK, FLOWS)
    assert not sender.handle_packet("video", b"no RTP at all", 0)
    assert not sender.handle_packet("rtcp", b"\x80\x60" + bytes(20), 0)
    assert not sender.handle_packet("tmtc", bytes(3000), 0)
    assert not sender.handle_haptic(bytes(13), 0)
    assert sender.refused == {"garbage": 2, "oversize": 1, "haptic_length": 1}
    assert sender.handle_packet("rtcp", b"\x80\xc8" + bytes(26), 0)
