"""The processes that code for partners while any of them watches, and decode what one sends."""

from dataclasses import replace

from kontur_av.codecs.coding import SLOW_REFRESH_S
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.codecs.opus import OpusEncoder, heard_stamp
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp, Quality
from kontur_av.rtp.nal_depacketizer import ReceivedUnit
from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.streams.encoding_thread import EncodingThread, switch_threads_often
from kontur_av.topics.bus import Lease, Reader, TopicBus
from pipelines.media.coded_topics import ReceivedTopic, SentTopic
from pipelines.media.following import SELECTED_TOPIC
from pipelines.partner.decisions import RTC_REQUEST_TOPIC, CodingRequest, PicturePlan
from pipelines.session.process import TIMEOUT_NS, Context
from pipelines.session.setup.table import GROUND_MIC
from pipelines.session.topic_ends import TopicReader, TopicWriter
from pipelines.session.topology.streams import partner_camera
from pipelines.session.topology.topics import (
    RTC_CAMERA,
    RTC_CAMERA_TOPIC,
    RTC_CODED_CAMERA_TOPIC,
    RTC_SPEECH_TOPIC,
    RTC_UNITS_TOPIC,
    RTC_VIDEO,
    RTC_VIDEO_TOPIC,
)


def run_rtc_encode(context: Context) -> None:
    """Encode the newest picture of the selected camera, and each block of sound."""
    switch_threads_often()
    leg, stream, clock = context.setup.rtc, context.setup.uplink_video, context.clock
    assert leg is not None
    encoder = H264Encoder(
        width=stream.width,
        height=stream.height,
        fps=stream.fps,
        cap_bps=leg.video_bps,
        refresh_s=SLOW_REFRESH_S,
    )
    plan = PicturePlan(bps=leg.video_bps)
    speaks = context.setup.uplink_voice is not None
    voice = OpusEncoder(bitrate_bps=leg.voice_bps) if speaks else None
    with context.open_bus() as bus, EncodingThread(encoder, clock) as encoding:
        camera = _SelectedCamera(context, bus)
        requests = TopicReader(bus, RTC_REQUEST_TOPIC)
        request = CodingRequest(0, 0)
        microphone = (
            bus.reader(context.topology.input(GROUND_MIC).topic, depth=8) if speaks else None
        )
        pictures = SentTopic(bus, RTC_VIDEO, RTC_VIDEO_TOPIC)
        packets = TopicWriter(bus, RTC_SPEECH_TOPIC, wake=True) if speaks else None
        others = [requests.open(), *([] if microphone is None else [microphone])]
        waiter = bus.waiter([*others, *camera.readers], [encoding.fileno()])
        encoded: Lease | None = None
        numbers = 0
        while not context.stopping:
            context.tick(clock.now_ns())
            waiter.wait(TIMEOUT_NS)
            if camera.handle_choice():
                plan.handle_key_request()
                del waiter
                waiter = bus.waiter([*others, *camera.readers], [encoding.fileno()])
            if (newest := requests.latest()) is not None:
                if newest.keys != request.keys or not request.bps:
                    plan.handle_key_request()
                request = newest
                if request.bps:
                    plan.handle_rate(request.bps)
            done = encoding.poll()
            if done is not None and encoded is not None:
                plan.handle_coded(len(done.unit.data), done.encoded_ns)
                pictures.handle_unit(done.unit, encoder.unit_size, encoded.video().data)
                encoded.release()
                encoded = None
                camera.close_retired()
            pictures.poll(clock.now_ns())
            lease = None if encoded is not None else camera.newest()
            if lease is not None:
                coding = plan.handle_picture(clock.now_ns()) if request.bps else None
                if coding is None:
                    lease.release()
                else:
                    frame = lease.video()
                    stamp = CaptureStamp(frame.stamp.capture_ns, numbers, RTC_VIDEO)
                    numbers += 1
                    encoding.submit(replace(frame, stamp=stamp), coding)
                    encoded = lease
            while microphone is not None and (block := microphone.next()) is not None:
                with block:
                    if not request.bps or voice is None or packets is None:
                        continue
                    sound = block.audio()
                    octets = voice.encode(sound.samples)
                packets.publish_read(octets, heard_stamp(sound.stamp).capture_ns)
        encoding.close()
        if encoded is not None:
            encoded.release()
        camera.close_retired()
        del waiter


class _SelectedCamera:
    """The pictures of the selected camera; it follows the selector, and confirms nothing."""

    def __init__(self, context: Context, bus: TopicBus) -> None:
        self._topology, self._bus = context.topology, bus
        self._choices = TopicReader(bus, SELECTED_TOPIC)
        self._camera = ""
        self._reader: Reader | None = None
        #: Readers of earlier cameras, one of whose pictures may still be in the encoder.
        self._retired: list[Reader] = []

    @property
    def readers(self) -> list[Reader]:
        """The readers whose new samples matter."""
        return [self._choices.open(), *([] if self._reader is None else [self._reader])]

    def handle_choice(self) -> bool:
        """Read the newest choice; True if another camera is selected now."""
        choice = self._choices.latest()
        chosen = self._camera if choice is None else choice.camera
        if chosen == self._camera:
            return False
        self._camera = chosen
        if self._reader is not None:
            self._retired.append(self._reader)
        self._reader = self._bus.reader(self._topology.camera(chosen).topic)
        return True

    def newest(self) -> Lease | None:
        return None if self._reader is None else self._reader.latest()

    def close_retired(self) -> None:
        """No picture of an earlier camera is used any more."""
        for reader in self._retired:
            reader.close()
        self._retired.clear()


_DEPTH = 8


def run_rtc_camera(context: Context) -> None:
    """Decode every access unit, and publish its picture in the usual size."""
    clock, leg = context.clock, context.setup.rtc
    assert leg is not None
    stream = partner_camera(leg)
    decoder = H264Decoder(size=(stream.width, stream.height))
    most_pixels = 4 * stream.width * stream.height
    shown = 0
    with context.open_bus() as bus:
        units = bus.reader(RTC_UNITS_TOPIC, depth=_DEPTH)
        writer = bus.writer(RTC_CAMERA_TOPIC, max_octets=stream.width * stream.height * 3 // 2)
        topic = ReceivedTopic(bus, RTC_CAMERA, RTC_CODED_CAMERA_TOPIC)
        while not context.stopping:
            context.tick(clock.now_ns())
            units.wait(TIMEOUT_NS)
            while (lease := units.next()) is not None:
                with lease:
                    stamp, octets = lease.stamp, lease.octets()
                try:
                    unit = CodedUnit.unpack(octets)
                except ProtocolError:
                    continue
                timestamp = stamp.rtp_timestamp or 0
                for picture in decoder.decode(unit.data, timestamp):
                    # An unknown sender's picture must not make shared memory grow.
                    if picture.width * picture.height > most_pixels:
                        topic.handle_picture(picture, None)
                        continue
                    corrupted = picture.corrupt or stamp.quality is Quality.DAMAGED
                    quality = Quality.DAMAGED if corrupted else Quality.FRESH
                    seen = CaptureStamp(stamp.capture_ns, shown, RTC_CAMERA, quality, timestamp)
                    shown += 1
                    loan = writer.loan_picture(stream.width, stream.height)
                    picture.scale_into(loan.picture)
                    loan.publish(seen)
                    topic.handle_picture(picture, seen)
                came = ReceivedUnit(
                    unit.data, timestamp, unit.key, unit.damaged, 0, clock.now_ns(), clock.now_ns()
                )
                topic.handle_unit(came, stamp.capture_ns)
            topic.poll(clock.now_ns())
