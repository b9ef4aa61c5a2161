"""Picture loss indications: on the wire, and when they are sent and answered."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.rtp.feedback import (
    PictureLossListener,
    PictureLossReporter,
    ReceptionReporter,
    rate_message,
    told_rate,
)
from kontur_av.rtp.wire import (
    RTCP_PSFB_PLI,
    RtcpPsfbPacket,
    RtcpReceiverInfo,
    RtcpRrPacket,
    parse_rtcp,
    receiver_report,
)

MS = 1_000_000
S = 1000 * MS


def report(receiver, packets_lost, *, ssrc=7):
    return bytes(RtcpRrPacket(receiver, [RtcpReceiverInfo(ssrc, 0, packets_lost, 9, 0, 0, 0)]))


def test_reports_of_a_receiver_without_indications_ask_for_pictures():
    listener = PictureLossListener(ssrc=7)
    answered = []
    for at_s, lost in ((1, 0), (2, 0), (4, 3), (5, 6), (7, 6), (9, 6)):
        listener.handle_feedback(report(1, lost), at_s * S)
        if listener.take(at_s * S):
            answered.append(at_s)
    # It joined; it lost; it lost again too soon to be answered before the next report.
    assert answered == [1, 4, 7]
    listener.handle_feedback(report(1, 99, ssrc=8), 20 * S)
    assert not listener.take(20 * S)
    assert listener.heard_ns == 20 * S


def test_of_many_receivers_the_one_that_was_new_first_is_forgotten():
    listener = PictureLossListener(ssrc=7)

    def answers(receiver, at_s):
        listener.handle_feedback(report(receiver, 0), at_s * S)
        return listener.take(at_s * S)

    assert all(answers(receiver, 3 * receiver) for receiver in range(17))
    assert not any(answers(receiver, 60 + 3 * receiver) for receiver in range(1, 17))
    assert answers(0, 200)


def test_reports_of_a_receiver_with_indications_ask_for_nothing():
    listener = PictureLossListener(ssrc=7)
    reporter = PictureLossReporter(ssrc=1)
    reporter.handle_picture(damaged=True, media_ssrc=7, now_ns=0)
    listener.handle_feedback(reporter.poll_transmit(0), 0)
    assert listener.take(0)
    for at_s in range(3, 30):
        listener.handle_feedback(report(1, at_s), at_s * S)
        assert not listener.take(at_s * S)


def test_an_indication_has_the_twelve_octets_of_the_rfc():
    reporter = PictureLossReporter(ssrc=0x01020304)
    reporter.handle_picture(damaged=True, media_ssrc=0xA1B2C3D4, now_ns=5)
    # Version 2, no padding, FMT 1; PT 206; length 2; sender; media source (RFC 4585 clause 6.1).
    assert reporter.poll_transmit(5) == bytes.fromhex("81ce0002 01020304 a1b2c3d4")


def test_it_is_repeated_until_the_picture_is_whole():
    reporter = PictureLossReporter(ssrc=1)
    asked = []
    for k in range(40):
        now_ns = k * 33 * MS
        reporter.handle_picture(damaged=3 <= k < 20, media_ssrc=2, now_ns=now_ns)
        if reporter.poll_transmit(now_ns):
            asked.append(k)
    assert asked == [3, 11, 19]
    assert reporter.sent == 3
    assert reporter.poll_timeout() is None


def test_the_sender_answers_once_and_only_for_its_own_stream():
    listener = PictureLossListener(ssrc=7)

    def indication(media_ssrc):
        reporter = PictureLossReporter(ssrc=1)
        reporter.handle_picture(damaged=True, media_ssrc=media_ssrc, now_ns=0)
        return reporter.poll_transmit(0)

    assert not listener.take(0)
    listener.handle_feedback(indication(8), 0)
    assert not listener.take(0)
    listener.handle_feedback(indication(7), 0)
    listener.handle_feedback(indication(7), 0)
    assert listener.take(10 * MS)
    assert not listener.take(10 * MS)
    # The same loss, reported again before the answer had arrived.
    listener.handle_feedback(indication(7), 50 * MS)
    assert not listener.take(50 * MS)
    listener.handle_feedback(indication(7), 300 * MS)
    assert listener.take(300 * MS)
    assert listener.received == 4


@given(st.binary(max_size=64))
def test_garbage_is_counted_and_never_raised(datagram):
    listener = PictureLossListener(ssrc=7)
    listener.handle_feedback(datagram, 0)
    assert listener.garbage + listener.received <= 1


@pytest.mark.parametrize(
    ("rate_bps", "coded"), [(100_000, "0186a0"), (262_143, "03ffff"), (1_000_000, "0bd090")]
)
def test_a_receiver_tells_the_rate_of_its_streams(rate_bps, coded):
    """draft-alvestrand-rmcat-remb-03: an exponent of 6 bits, a mantissa of 18."""
    octets = rate_message(rate_bps, ssrc=1, media_ssrcs=[7, 8])
    assert octets == bytes.fromhex(
        f"8fce0006 00000001 00000000 52454d42 02{coded} 00000007 00000008"
    )
    (packet,) = parse_rtcp(octets)
    assert told_rate(packet) == (rate_bps, [7, 8])
    assert told_rate(RtcpPsfbPacket(RTCP_PSFB_PLI, 1, 7)) is None
    for cut in (b"REMB", b"REMB\x02\x01\x86\xa0\0\0\0\7"):
        assert told_rate(RtcpPsfbPacket(15, 1, 0, cut)) is None


def test_a_report_is_due_with_the_senders_first_and_has_these_octets():
    reporter = ReceptionReporter(ssrc=0xAB, interval_ns=S)
    assert not reporter.is_due(0) and reporter.poll_timeout() is None
    reporter.handle_sender_report(5 * S)
    assert reporter.poll_timeout() == 5 * S
    assert not reporter.is_due(5 * S - 1) and reporter.is_due(5 * S)
    block = RtcpReceiverInfo(7, 64, -2, 0x1_0002, 3, 4, 5)
    octets = reporter.report(block, 5 * S, feedback=b"more")
    # RR with one block (RFC 3550 section 6.4.2), and SDES with CNAME and TOOL (section 6.5).
    assert (
        octets
        == bytes.fromhex(
            "81c90007 000000ab 00000007 40fffffe 00010002 00000003 00000004 00000005"
            "81ca0009 000000ab 0112"
        )
        + b"000000ab@kontur-av"
        + b"\x06\x09kontur-av"
        + bytes(1)
        + b"more"
    )
    assert 5 * S < reporter.poll_timeout() < 7 * S
    reporter.handle_sender_report(9 * S)
    assert reporter.poll_timeout() < 7 * S
    assert reporter.report(None, 0)[:8] == bytes.fromhex("80c90001 000000ab")
    silent = ReceptionReporter(ssrc=1, interval_ns=None)
    silent.handle_sender_report(0)
    assert not silent.is_due(0) and silent.poll_timeout() is None
    assert silent.report(None, 0)[1] == 201


def test_reports_of_this_software_ask_for_nothing():
    listener = PictureLossListener(ssrc=7)
    listener.handle_feedback(receiver_report(1, RtcpReceiverInfo(7, 0, 5, 9, 0, 0, 0), b"x"), 0)
    assert not listener.take(0)
    # Another program at the same address is somebody else.
    listener.handle_feedback(report(2, 5), 0)
    assert listener.take(0)


def test_losses_are_answered_every_2_s_and_indications_every_100_ms():
    for later_ns, answered in ((2 * S - 1, False), (2 * S, True)):
        listener = PictureLossListener(ssrc=7)
        listener.handle_feedback(report(1, 0), 0)
        assert listener.take(0)
        listener.handle_feedback(report(1, 1), later_ns)
        assert listener.take(later_ns) is answered
    indication = bytes(RtcpPsfbPacket(RTCP_PSFB_PLI, 1, 7))
    for later_ns, answered in ((100 * MS - 1, False), (100 * MS, True)):
        listener = PictureLossListener(ssrc=7)
        for now_ns in (0, later_ns):
            listener.handle_feedback(indication, now_ns)
            found = listener.take(now_ns)
        assert found is answered


def test_an_indication_is_repeated_after_250_ms():
    reporter = PictureLossReporter(ssrc=1)
    reporter.handle_picture(damaged=True, media_ssrc=2, now_ns=3)
    assert reporter.poll_timeout() == 3 and reporter.poll_transmit(2) is None
    assert reporter.poll_transmit(3) is not None
    assert reporter.poll_timeout() == 3 + 250 * MS
    # Another kind of payload-specific feedback asks for no picture.
    listener = PictureLossListener(ssrc=7)
    listener.handle_feedback(bytes(RtcpPsfbPacket(2, 1, 7, bytes(8))), 0)
    assert (listener.received, listener.take(0)) == (0, False)
