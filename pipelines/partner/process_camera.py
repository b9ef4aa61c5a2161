"""Decodes a partner's pictures: access units from the process with the connections -> topics."""

from kontur_av.codecs.h264 import H264Decoder
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp, Quality
from kontur_av.rtp.payload_h264 import ReceivedUnit
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.media.coded_topics import ReceivedTopics
from pipelines.session.process import PATIENCE_NS, Context
from pipelines.session.topology import (
    RTC_CAMERA,
    RTC_CAMERA_TOPIC,
    RTC_CODED_CAMERA_TOPIC,
    RTC_DECODED_CAMERA_TOPIC,
    RTC_UNITS_TOPIC,
    partner_camera,
)

_DEPTH = 8


def run_rtc_camera(context: Context) -> None:
    """Decode every access unit, and publish its picture in the usual size."""
    clock, leg = context.clock, context.setup.rtc
    assert leg is not None
    stream = partner_camera(leg)
    decoder = H264Decoder()
    most_pixels = 4 * stream.width * stream.height
    shown = 0
    with context.open_bus() as bus:
        units = bus.reader(RTC_UNITS_TOPIC, depth=_DEPTH)
        writer = bus.writer(RTC_CAMERA_TOPIC, max_octets=stream.width * stream.height * 3 // 2)
        topics = ReceivedTopics(
            bus, stream, coded=RTC_CODED_CAMERA_TOPIC, decoded=RTC_DECODED_CAMERA_TOPIC
        )
        while not context.stopping:
            context.tick(clock.now_ns())
            units.wait(PATIENCE_NS)
            while (lease := units.next()) is not None:
                with lease:
                    stamp, octets = lease.stamp, lease.octets()
                try:
                    unit = CodedUnit.unpack(octets)
                except ProtocolError:
                    continue
                timestamp = stamp.rtp_timestamp or 0
                for picture in decoder.decode(unit.data, timestamp):
                    # A stranger's picture must not make shared memory grow.
                    if picture.width * picture.height > most_pixels:
                        topics.handle_picture(picture, None)
                        continue
                    hurt = picture.corrupt or stamp.quality is Quality.DAMAGED
                    quality = Quality.DAMAGED if hurt else Quality.FRESH
                    seen = CaptureStamp(stamp.capture_ns, shown, RTC_CAMERA, quality, timestamp)
                    shown += 1
                    loan = writer.loan_picture(stream.width, stream.height)
                    picture.scale_into(loan.picture)
                    loan.publish(seen)
                    topics.handle_picture(picture, seen)
                came = ReceivedUnit(
                    unit.data, timestamp, unit.key, unit.damaged, 0, clock.now_ns(), clock.now_ns()
                )
                topics.handle_unit(came, stamp.capture_ns)
