"""How far the clocks of both ends differ: octets of RFC 3611, and what a path allows to be told."""

import pytest
from rtp_packets import make_sender, picture

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.rtp.clock_offset import ClockOffset, answer_packet, read_receiver_time
from kontur_av.rtp.rtcp import receiver_report


def test_the_packets_have_the_octets_of_the_rfc():
    # NTP counts from 1900: 0x83AA7E80 is 1970.
    asked = ClockOffset(0xA1A2A3A4, 0).time_packet(NS_PER_S // 2)
    assert asked == bytes.fromhex("80cf0004 a1a2a3a4 04000002 83aa7e8080000000")
    assert read_receiver_time(asked, 7) == (0xA1A2A3A4, 0x7E808000, 7)
    answer = answer_packet(9, (0xA1A2A3A4, 0x7E808000, 7), 7 + NS_PER_S // 4)
    assert answer == bytes.fromhex("80cf0005 00000009 05000003 a1a2a3a4 7e808000 00004000")
    # Behind a report they are found.
    compound = receiver_report(9, None, b"name")
    assert read_receiver_time(compound + asked, 7) == (0xA1A2A3A4, 0x7E808000, 7)
    for end in range(len(compound + asked)):
        assert read_receiver_time((compound + asked)[:end], 7) is None


@pytest.mark.parametrize("ahead_ms", [0, 3, -4000])
def test_a_clock_that_is_wrong_is_found_as_far_as_the_path_allows(ahead_ms):
    rtp, offset, errors_ns = make_sender(), ClockOffset(5, 0), []
    rtp.video_packets(picture(0))
    # Ways there and back in ms: the best round trip tells most, and a lame one changes nothing.
    for second, (there, back) in enumerate([(90, 10), (3, 1), (400, 20)]):
        sent_ns = second * NS_PER_S
        came_ns = sent_ns + there * NS_PER_MS
        rtp.receiver_time = read_receiver_time(offset.time_packet(sent_ns), came_ns)
        left_ns = came_ns + 30 * NS_PER_MS
        rtp._wall_offset_ns = ahead_ms * NS_PER_MS
        report = rtp.goodbye(left_ns)
        assert rtp.receiver_time is None
        offset.handle_report(report, left_ns + back * NS_PER_MS)
        errors_ns.append(offset.error_ns)
        assert abs(offset.offset_ns - ahead_ms * NS_PER_MS) <= offset.error_ns
    assert errors_ns[0] > 10 * errors_ns[1] and errors_ns[1] == errors_ns[2] < 6 * NS_PER_MS
    # Clocks that may agree are taken as right.
    seen_ms = ahead_ms + 1 if ahead_ms else 0
    assert offset.offset_ns == pytest.approx(seen_ms * NS_PER_MS, abs=NS_PER_MS // 10)
    # Another sender has another clock.
    other = make_sender(ssrc=2)
    other.video_packets(picture(0))
    offset.handle_report(other.goodbye(NS_PER_S), NS_PER_S)
    assert (offset.offset_ns, offset.error_ns) == (0, None)
