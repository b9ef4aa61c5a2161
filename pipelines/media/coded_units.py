"""Samples of the topics that carry access units. A core."""

from kontur_av.media import AccessUnit, CaptureStamp, Quality
from kontur_av.rtp.payload_h264 import ReceivedUnit
from kontur_av.streams.coded_unit import CodedUnit


def received_unit(
    unit: ReceivedUnit,
    *,
    size: tuple[int, int] | None,
    shown: CaptureStamp | None,
    capture_ns: int | None,
    sequence: int,
    source: str,
    parameter_sets: bytes,
) -> tuple[CodedUnit, CaptureStamp]:
    """Return a received access unit and its stamp.

    size: width and height of its picture in pixels; None: the decoder returned none.
    shown: the stamp with which the picture was published; None: it was not.
    capture_ns: when it was captured; None: not known yet.
    sequence: number of the unit. source: the stream. parameter_sets: the newest of the stream.
    """
    # A dated picture that is not published is too large.
    refused = size is None or (shown is None and capture_ns is not None)
    quality = Quality.DAMAGED if unit.damaged else Quality.FRESH
    width, height = (0, 0) if size is None or refused else size
    coded = CodedUnit(
        data=unit.data,
        key=unit.keyframe,
        damaged=unit.damaged,
        refused=refused,
        dated=capture_ns is not None,
        width=width,
        height=height,
        parameter_sets=parameter_sets,
    )
    return coded, CaptureStamp(
        capture_ns or 0,
        sequence,
        source,
        quality if shown is None else shown.quality,
        unit.timestamp,
    )


def sent_unit(
    unit: AccessUnit, *, size: tuple[int, int], sequence: int, source: str, parameter_sets: bytes
) -> tuple[CodedUnit, CaptureStamp]:
    """Return an access unit and its stamp as they were sent.

    size: in which it was coded. parameter_sets: the newest of the stream.
    """
    width, height = size
    coded = CodedUnit(
        data=unit.data, key=unit.keyframe, width=width, height=height, parameter_sets=parameter_sets
    )
    return coded, CaptureStamp(unit.stamp.capture_ns, sequence, source)
