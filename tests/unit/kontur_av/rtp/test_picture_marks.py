"""Numbers and sizes of pictures, as their sender's packets tell them."""

from rtp_packets import make_sender

from kontur_av.media import AccessUnit, CaptureStamp
from kontur_av.rtp.annex_b import join_annex_b
from kontur_av.rtp.header_extensions import PICTURE, elements_of, picture_element, read_picture
from kontur_av.rtp.picture_marks import PictureMarks

FRAME_NS = 33_333_333
SLICE, SPS = b"\x41\x88", b"\x67\x42\xc0\x1e\x11"


def packets(numbers, *, begins=(), **changes):
    """Return the first packets of pictures with these numbers; some have parameter sets."""
    sender = make_sender(picture_id=2, size=(1280, 722), **changes)
    for number in numbers:
        data = join_annex_b([*([SPS] if number in begins else []), SLICE])
        stamp = CaptureStamp(number * FRAME_NS, number, "test")
        yield (
            number,
            sender.timestamp(stamp.capture_ns),
            sender.video_packets(AccessUnit(data, stamp, False)).packets[0],
        )


def test_the_element_has_these_octets():
    assert PICTURE == "urn:x-kontur-av:picture"
    assert picture_element(0x1_0005) == bytes.fromhex("0005")
    assert picture_element(0x1_0005, (1280, 722)) == bytes.fromhex("00010005 0500 02d2")
    assert read_picture(bytes.fromhex("00010005 0500 02d2")) == (0x1_0005, (1280, 722))
    assert read_picture(b"") is read_picture(bytes(3)) is None


def test_who_joins_late_or_loses_packets_knows_every_number():
    marks = PictureMarks(2)
    sent = list(packets(range(65_500, 65_570), begins={65_510}, ssrc=7))
    # In the order of a path that loses, repeats and overtakes; the first one begins its second.
    for at in (5, 10, 12, 11, 11, *range(40, 70)):
        number, timestamp, packet = sent[at]
        marks.handle_packet(packet, None)
        if number < 65_510:
            assert marks.number(7, timestamp) is marks.size(7) is None
        else:
            assert (marks.number(7, timestamp), marks.size(7)) == (number, (1280, 722))
    # Where nothing begins, a long element is due once a second.
    long = [number for number, _, packet in sent if len(elements_of(packet)[2]) == 8]
    assert long == [65_500, 65_510, 65_541]


def test_an_unknown_sender_changes_nothing_of_the_accepted_one():
    marks = PictureMarks(2)
    (number, timestamp, packet), *_ = packets([5], ssrc=7)
    marks.handle_packet(packet, None)
    for ssrc in range(100, 110):
        for _, _, other in packets(range(300), ssrc=ssrc):
            marks.handle_packet(other, 7)
    assert len(marks._sources) == 2 and marks.number(7, timestamp) == number
    # Sizes that no picture can have, and elements that are cut off.
    for wrong in ("0000ffff", "05010280", "00000000"):
        marks.handle_packet(packet.replace(bytes.fromhex("050002d2"), bytes.fromhex(wrong)), 7)
        assert marks.size(7) == (1280, 722)
    marks.handle_packet(packet[:20], 7)
    assert marks.number(7, timestamp + 1) is marks.number(None, timestamp) is None
