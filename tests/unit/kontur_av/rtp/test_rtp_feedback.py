"""Picture loss indications: on the wire, and when they are sent and answered."""

from hypothesis import given
from hypothesis import strategies as st

from kontur_av.rtp.feedback import PictureLossListener, PictureLossReporter

MS = 1_000_000


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
