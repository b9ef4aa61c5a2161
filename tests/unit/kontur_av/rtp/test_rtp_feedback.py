"""Picture loss indications: on the wire, and when they are sent and answered."""

from hypothesis import given
from hypothesis import strategies as st

from kontur_av.rtp.feedback import PictureLossListener, PictureLossReporter
from kontur_av.rtp.wire import RtcpReceiverInfo, RtcpRrPacket

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
