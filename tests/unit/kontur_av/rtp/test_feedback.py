"""Picture loss indications and receiver reports: their octets, when they go, what answers them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.rtp.feedback import (
    PictureLossListener,
    PictureLossReporter,
    ReceptionReporter,
    WholePicture,
    rate_message,
    told_rate,
)
from kontur_av.rtp.rtcp import (
    RTCP_PSFB_PLI,
    RtcpPsfbPacket,
    RtcpReceiverInfo,
    RtcpRrPacket,
    parse_rtcp,
    receiver_report,
)

MS = 1_000_000
S = 1000 * MS


def report(lost, *, receiver=1, ssrc=7):
    return bytes(RtcpRrPacket(receiver, [RtcpReceiverInfo(ssrc, 0, lost, 9, 0, 0, 0)]))


def indication(ssrc=7):
    return bytes(RtcpPsfbPacket(RTCP_PSFB_PLI, 1, ssrc))


def answers(listener, *feedback, at_ns):
    """Return whether the sender answers with a key picture."""
    for datagram in feedback:
        listener.handle_feedback(datagram, at_ns)
    return listener.take(at_ns)


@pytest.fixture
def listener():
    return PictureLossListener(ssrc=7)


def test_reports_of_a_receiver_without_indications_ask_for_pictures(listener):
    told = ((1, 0), (2, 0), (4, 3), (5, 6), (7, 6), (9, 6))
    answered = [at_s for at_s, lost in told if answers(listener, report(lost), at_ns=at_s * S)]
    # It joined; it lost; it lost again too soon to be answered before the next report.
    assert answered == [1, 4, 7]
    assert not answers(listener, report(99, ssrc=8), at_ns=20 * S)
    assert listener.heard_ns == 20 * S


def test_of_many_receivers_the_one_that_was_new_first_is_forgotten(listener):
    def new(receiver, at_s):
        return answers(listener, report(0, receiver=receiver), at_ns=at_s * S)

    assert all(new(receiver, 3 * receiver) for receiver in range(17))
    assert not any(new(receiver, 60 + 3 * receiver) for receiver in range(1, 17))
    assert new(0, 200)


def test_reports_of_this_software_or_with_indications_ask_for_nothing(listener):
    own = receiver_report(1, RtcpReceiverInfo(7, 0, 5, 9, 0, 0, 0), b"x")
    assert not answers(listener, own, at_ns=0)
    # Another program at the same address is somebody else.
    assert answers(listener, report(5, receiver=2), at_ns=0)
    listener = PictureLossListener(ssrc=7)
    assert answers(listener, indication(), at_ns=0)
    assert not any(answers(listener, report(at_s), at_ns=at_s * S) for at_s in range(3, 30))


def test_an_indication_has_the_twelve_octets_of_the_rfc_and_is_repeated_after_250_ms():
    reporter = PictureLossReporter(ssrc=0x01020304)
    reporter.handle_picture(damaged=True, media_ssrc=0xA1B2C3D4, now_ns=3)
    assert reporter.poll_timeout() == 3 and reporter.poll_transmit(2) is None
    # Version 2, no padding, FMT 1; PT 206; length 2; sender; media source (RFC 4585 clause 6.1).
    assert reporter.poll_transmit(3) == bytes.fromhex("81ce0002 01020304 a1b2c3d4")
    assert reporter.poll_timeout() == 3 + 250 * MS
    # It is repeated until the picture is whole.
    reporter, asked = PictureLossReporter(ssrc=1), []
    for k in range(40):
        reporter.handle_picture(damaged=3 <= k < 20, media_ssrc=2, now_ns=k * 33 * MS)
        if reporter.poll_transmit(k * 33 * MS):
            asked.append(k)
    assert asked == [3, 11, 19]
    assert (reporter.sent, reporter.poll_timeout()) == (3, None)


def test_the_sender_answers_once_and_only_for_its_own_stream(listener):
    assert not listener.take(0)
    assert not answers(listener, indication(8), at_ns=0)
    assert answers(listener, indication(), indication(), at_ns=0)
    assert not listener.take(0)
    # The same loss, reported again before the answer had arrived.
    assert not answers(listener, indication(), at_ns=100 * MS - 1)
    assert answers(listener, indication(), at_ns=200 * MS)
    assert listener.received == 4
    # Another kind of payload-specific feedback asks for no picture.
    assert not answers(listener, bytes(RtcpPsfbPacket(2, 1, 7, bytes(8))), at_ns=S)
    assert listener.received == 4


@pytest.mark.parametrize(
    ("feedback", "wait_ns"), [((report(0), report(1)), 2 * S), ((indication(),) * 2, 100 * MS)]
)
def test_losses_are_answered_every_2_s_and_indications_every_100_ms(feedback, wait_ns):
    for later_ns in (wait_ns - 1, wait_ns):
        listener = PictureLossListener(ssrc=7)
        assert answers(listener, feedback[0], at_ns=0)
        assert answers(listener, feedback[1], at_ns=later_ns) is (later_ns == wait_ns)


def test_what_a_receiver_has_stands_behind_its_indication_in_24_octets():
    reporter = PictureLossReporter(ssrc=0x01020304)
    reporter.handle_picture(damaged=True, media_ssrc=7, now_ns=0)
    # FMT 15 is application layer feedback (RFC 4585 section 6.4).
    assert reporter.poll_transmit(0, WholePicture(0xA0, 0xFFFFFFFE)) == bytes.fromhex(
        "81ce0002 01020304 00000007 8fce0005 01020304 00000007 4b41564c 000000a0 fffffffe"
    )


def asks(*has, receiver=1):
    reporter = PictureLossReporter(ssrc=receiver)
    reporter.handle_picture(damaged=True, media_ssrc=7, now_ns=0)
    return reporter.poll_transmit(0, WholePicture(*has))


def test_a_loss_is_answered_once_with_what_is_whole_for_all_receivers(listener):
    assert answers(listener, asks(9, 5), asks(9, 2**32 - 3, receiver=2), at_ns=0)
    assert listener.whole == 2**32 - 3
    listener.handle_answer(12, 0, key=False)
    # It has not seen the answer, then the answer did not help, then it lost another one at once.
    assert [answers(listener, asks(at, 5), at_ns=S) for at in (11, 13, 12)] == [False, True, True]
    # One that does not say what it has needs a key picture, and so all get one.
    assert answers(listener, asks(13, 5), indication(), at_ns=2 * S) and listener.whole is None
    assert not listener.take(2 * S)
    # After a key picture the next loss waits; so nobody can have only key pictures.
    listener.handle_answer(20, 3 * S, key=True)
    assert not answers(listener, asks(21, 20), at_ns=3 * S + 100 * MS - 1)
    assert listener.take(3 * S + 100 * MS) and listener.whole == 20
    listener.handle_answer(22, 4 * S, key=False)
    assert answers(listener, asks(22, 21), at_ns=4 * S)


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
    # RR with one block (RFC 3550 section 6.4.2), and SDES with CNAME and TOOL (section 6.5).
    head = bytes.fromhex(
        "81c90007 000000ab 00000007 40fffffe 00010002 00000003 00000004 00000005"
        "81ca0009 000000ab 0112"
    )
    octets = reporter.report(RtcpReceiverInfo(7, 64, -2, 0x1_0002, 3, 4, 5), 5 * S, feedback=b"pli")
    assert octets == head + b"000000ab@kontur-av\x06\x09kontur-av\x00pli"
    assert 5 * S < reporter.poll_timeout() < 7 * S
    reporter.handle_sender_report(9 * S)
    assert reporter.poll_timeout() < 7 * S
    assert reporter.report(None, 0)[:8] == bytes.fromhex("80c90001 000000ab")
    silent = ReceptionReporter(ssrc=1, interval_ns=None)
    silent.handle_sender_report(0)
    assert not silent.is_due(0) and silent.poll_timeout() is None
    assert silent.report(None, 0)[1] == 201
