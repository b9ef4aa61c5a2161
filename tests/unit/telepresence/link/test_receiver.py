"""Which stream of frames a receiver follows, what it counts, and what it delivers."""

import struct
from random import Random

import pytest

from telepresence.link.flows import Level, SupervisionReceived, packet_flow, rtcp_flow, video_flow
from telepresence.link.frame import FrameCodec
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile
from telepresence.link.receiver import LinkReceiver, UnknownFrame
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
        assert receiver.unknown == UnknownFrame(None, 40, 39 * MS)
        receiver.follow_unknown_sender(new_boot_id=True)
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
    receiver.follow_unknown_sender(new_boot_id=True)
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
        assert receiver.follow_unknown_sender(new_boot_id=False)
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
        assert not receiver.follow_unknown_sender(new_boot_id=False)
    assert (receiver.frames_received, sum(receiver.frames_dropped.values())) == (5, 3)
    assert feed(receiver, frames(5, 9_105), now_ns)
    assert (receiver.frames_received, receiver.frames_lost) == (10, 0)
    # After hours a lower count is one that has wrapped.
    now_ns += 3 * 3600 * 1000 * MS
    feed(receiver, frames(1, 9_000), now_ns)
    assert receiver.follow_unknown_sender(new_boot_id=False)
    assert (receiver.frames_received, receiver.frames_lost) == (11, 0)


def test_an_answer_is_followed_beside_a_busy_stranger():
    """The frame with the message is of neither stream, and its own is followed."""
    receiver = LinkReceiver(UPLINK, FLOWS)
    now_ns = feed(receiver, frames(20, 1000))
    now_ns = feed(receiver, frames(20, 5_000_000), now_ns)
    sender = LinkSender(UPLINK, FLOWS, first_count=9_000_000)
    assert not receiver.handle_frame(sender.poll_transmit(now_ns, b"supervision!"), now_ns)
    assert receiver.unknown == UnknownFrame(b"supervision!", 0, 0)
    receiver.follow_unknown_sender(new_boot_id=True)
    assert receiver.next_event() == SupervisionReceived(b"supervision!", now_ns)
    assert receiver.handle_frame(sender.poll_transmit(now_ns), now_ns + MS)
    assert (receiver.restarts, receiver.frames_received) == (1, 22)


def picture(number, timestamp, ssrc):
    return struct.pack(">BBHII", 0x80, 96, number, timestamp, ssrc) + b"picture"


def test_contexts_go_on_when_the_same_life_goes_on_at_another_count():
    """Headers without a timestamp are restored from the count of frames."""
    receiver, sender = LinkReceiver(UPLINK, FLOWS), LinkSender(UPLINK, FLOWS)
    sent, came = [], []
    now_ns = 0
    for slot in range(4000):
        if slot % 33 == 0:
            sent.append(picture(slot // 33, slot // 33 * 2970, 7))
            sender.handle_packet("video", sent[-1], slot * MS)
        frame = sender.poll_transmit(slot * MS)
        if 2000 <= slot < 3010:
            continue  # held back on the way, and then lost: no time passes for the receiver
        if not receiver.handle_frame(frame, now_ns):
            assert receiver.follow_unknown_sender(new_boot_id=False)
        came += [event.data for event in iter(receiver.next_event, None)]
        now_ns += MS
    assert receiver.restarts == 0 and receiver.frames_lost == 1010
    assert came == sent[:61] + sent[-len(came) + 61 :] and len(came) > 85


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
    # Nor is a stream that is followed meanwhile.
    other = LinkSender(DOWNLINK, FLOWS, first_count=5_000)
    for slot in range(3):
        other.handle_haptic(bytes(12), 0)
        other.handle_packet("tmtc", b"telecommand", 0)
        receiver.handle_frame(other.poll_transmit(0), 2 + slot)
    assert receiver.follow_unknown_sender(new_boot_id=True)
    assert receiver.next_event() is None
    assert receiver.haptic_unapproved == receiver.packets.dropped["unapproved"] == 2
    receiver.deliver = True
    other.handle_packet("tmtc", b"telecommand", 0)
    receiver.handle_frame(other.poll_transmit(0), 5)
    assert receiver.next_event().data == b"telecommand"


def test_a_loss_of_signal_drops_incomplete_packets():
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    sender.handle_packet("tmtc", bytes(100), 0)
    for slot in range(8):
        if slot == 3:
            receiver.handle_signal_lost(3)
        receiver.handle_frame(sender.poll_transmit(slot), slot)
    assert receiver.next_event() is None
    assert receiver.packets.dropped == {"incomplete": 1}


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


@pytest.mark.rule("7")
def test_invalid_frames_are_dropped_and_counted_by_their_reason():
    other = LinkProfile(name="other", frame_octets=32, scid=9, vcid=0, pointer_in_vcid=True)
    receiver, (frame,) = LinkReceiver(UPLINK, FLOWS), frames(1)
    for bad in (frame[:-1], b"", bytes([frame[0] ^ 4]) + frame[1:], *frames(1, profile=other)):
        assert not receiver.handle_frame(bad, 0)
    assert receiver.frames_dropped == {"length": 2, "fecf": 1, "scid": 1}
    assert receiver.frames_received == 0 and receiver.handle_frame(frame, 0)
