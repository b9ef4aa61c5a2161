"""The ends of a picture stream: what is sent of which camera, and what damage is told."""

from dataclasses import replace

import numpy as np
import pytest
from rtp_packets import make_sender

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.codecs.h26x import encoder_of
from kontur_av.codecs.region import Focus
from kontur_av.media import VIDEO_CODECS, AccessUnit, CaptureStamp, VideoFrame
from kontur_av.rtp.sender import RtpIdentity
from pipelines.media.following import Choice
from pipelines.media.video_ends import VideoReceiveEnd, VideoSendEnd
from pipelines.session.probe import Probe
from pipelines.session.setup.setup_file import BUILT_IN
from telepresence.link.gateway import Backlog
from telepresence.link.path.following import PARTS
from telepresence.world import WorldState

SETUP = replace(BUILT_IN["spacejustin"], region="stylus")
STREAM = SETUP.uplink_video
MS = NS_PER_MS


def unit_of(stamp, *, key=True):
    return AccessUnit(b"\x00\x00\x00\x01" + (b"\x65" if key else b"\x41") + bytes(90), stamp, key)


def sender_of(setup, stream, send, **options):
    sends, identity = (send, lambda *_: None), RtpIdentity(1, 2, 3)
    return VideoSendEnd(setup, stream, identity, Probe(), sends, wall_offset_ns=0, **options)


def test_a_sender_that_follows_numbers_what_it_encodes_and_leaves_a_camera_before_it_confirms():
    sent, released = [], []
    end = sender_of(
        SETUP, STREAM, lambda *packet: sent.append(packet), follows=True, release=released.append
    )
    assert (end.camera, end.poll_encode(0), end.poll_confirmed(0)) == (None, None, None)
    assert end.handle_choice(Choice(1, "static")) and not end.handle_choice(Choice(1, "static"))
    assert end.poll_confirmed(0) == 1
    for number in (7, 8):
        end.handle_picture(number, CaptureStamp(number, number, "static"), number)
    work = end.poll_encode(20)
    # Before the robot tells where its tip is, no part of a picture is coded finer.
    assert (work.picture, work.stamp.sequence, work.region, released) == (8, 0, None, [7])
    end.handle_state(WorldState(20, 0.04, -0.02))
    assert end.handle_choice(Choice(2, "head"))
    end.handle_picture(9, CaptureStamp(30, 1, "head"), 30)
    assert end.poll_confirmed(40) is None
    end.handle_unit(unit_of(work.stamp), 40, 40)
    now_ns = 40
    while (number := end.poll_confirmed(now_ns)) is None:
        assert end.poll_encode(now_ns) is None
        due_ns = end.poll_timeout(now_ns)
        # A switch never makes it spin.
        assert due_ns >= now_ns + MS
        now_ns = due_ns
        end.handle_time(now_ns)
    assert number == 2 and sent
    while (work := end.poll_encode(now_ns)) is None:
        now_ns += MS
        end.handle_time(now_ns)
    assert (work.picture, work.stamp.sequence, work.region is None) == (9, 1, False)
    assert not end.handle_choice(Choice(3, "head", Focus(0, 0, 0.5, 0.5))) and end.focus.person
    end.handle_picture(10, CaptureStamp(now_ns, 2, "head"), now_ns)
    end.drop()
    assert released == [7, 10]


@pytest.mark.parametrize("codec", VIDEO_CODECS)
def test_a_path_that_carries_less_lowers_the_cap_from_then_on_and_holds_video_at_the_end(codec):
    stream = replace(SETUP.downlink_video, codec=codec, cap_bps=240_000, least_cap_bps=60_000)
    setup, sent, now_ns, random = replace(SETUP, region="off"), [], 0, np.random.default_rng(1)
    end = sender_of(setup, stream, lambda packet, ns: sent.append((ns, len(packet) - 12)))
    encoder = encoder_of(codec)(
        width=160, height=120, fps=30, cap_bps=stream.cap_bps, coded_size=(160, 120)
    )
    noise = random.integers(0, 256, (8, 180, 160), dtype=np.uint8)

    def most_bps(parts, seconds=3):
        """Send noise; return the largest second that ends from now on, and the pictures."""
        nonlocal now_ns
        begun_ns, pictures = now_ns, 0
        end.handle_backlog(Backlog(0, 1, True, 0, cap_parts=parts), now_ns, now_ns)
        for number in range(seconds * 1000):
            if number % 33 == 0:
                stamp = CaptureStamp(now_ns, number, "x")
                end.handle_picture(noise[number % 8], stamp, now_ns)
            end.handle_time(now_ns)
            if (work := end.poll_encode(now_ns)) is not None:
                frame = VideoFrame(work.picture, work.stamp)
                unit = encoder.encode(frame, work.coding)
                pictures += 1
                now_ns += MS
                end.handle_unit(unit, now_ns, now_ns)
            now_ns += MS
        late = [at_ns for at_ns, _ in sent if at_ns >= begun_ns]
        seconds_of = (
            sum(size for at_ns, size in sent if last_ns - NS_PER_S < at_ns <= last_ns)
            for last_ns in late
        )
        return 8 * max(seconds_of, default=0), pictures

    most, pictures = most_bps(PARTS)
    assert 0.6 * 240_000 < most <= 240_000 and pictures > 10
    most, _ = most_bps(PARTS // 2)
    # Each window is at most of the new cap, from the first packet on that leaves under it.
    assert 0.6 * 120_000 < most <= 120_000
    assert most_bps(100)[0] <= 60_000
    assert most_bps(0)[1] <= 1
    assert 0.6 * 240_000 < most_bps(PARTS)[0] <= 240_000


@pytest.mark.parametrize("undecoded", ["frames_corrupt", "frames_before_start"])
def test_a_unit_that_the_decoder_cannot_decode_asks_for_a_key_picture_with_the_next(undecoded):
    end = VideoReceiveEnd(STREAM, Probe(), ssrc=1, wall_offset_ns=0)
    sender, counts = make_sender(timestamp_offset=0), DecoderCounts()
    asked = []
    for number, units in enumerate((0, 1, 1, 1)):
        now_ns = number * NS_PER_S // 30
        unit = unit_of(CaptureStamp(now_ns, number, "x"), key=not number)
        for packet in sender.video_packets(unit).packets:
            end.handle_packet(packet, now_ns)
        if not number:
            end.handle_report(sender.poll_report(now_ns), now_ns)
        while (came := end.next_unit()) is not None:
            counts = replace(counts, frames_decoded=number + 1, **{undecoded: units})
            (stamp,) = end.handle_decoded([(came.timestamp, 640, 480, False)], counts)
            assert stamp is not None
        asked.append(end.poll_feedback(now_ns) is not None)
    assert asked == [False, False, True, False]
