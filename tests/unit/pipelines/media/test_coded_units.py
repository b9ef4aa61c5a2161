"""What a reader of access units is told about each."""

import pytest

from kontur_av.media import CaptureStamp, Quality
from kontur_av.rtp.nal_payload import ReceivedUnit
from pipelines.media.coded_topics import received_unit


def received(*, size=(384, 288), quality=None, capture_ns=5, damaged=False):
    unit = ReceivedUnit(b"unit", 90, True, damaged, 0, 1, 2)
    shown = None if quality is None else CaptureStamp(5, 0, "uplink_video", quality, 90)
    return received_unit(
        unit,
        size=size,
        shown=shown,
        capture_ns=capture_ns,
        sequence=7,
        source="uplink_video",
        parameter_sets=b"sets",
    )


def test_the_stamp_says_when_a_unit_was_captured_and_whether_a_loss_shows():
    coded, stamp = received(quality=Quality.DAMAGED)
    assert stamp == CaptureStamp(5, 7, "uplink_video", Quality.DAMAGED, 90)
    assert (coded.key, coded.damaged, coded.refused, coded.dated) == (True, False, False, True)
    assert (coded.width, coded.height) == (384, 288)
    assert coded.parameter_sets == b"sets"


def test_an_undated_unit_can_be_decoded():
    coded, stamp = received(capture_ns=None, damaged=True)
    assert (coded.refused, coded.dated, stamp.capture_ns) == (False, False, 0)
    assert stamp.quality is Quality.DAMAGED


@pytest.mark.parametrize("size", [None, (4096, 4096)], ids=["no-picture", "too-large"])
def test_a_unit_without_a_picture_to_show_is_refused(size):
    coded, _ = received(size=size)
    assert coded.refused
    assert (coded.width, coded.height) == (0, 0)
