"""The counts of inputs, receivers and displays: real sockets and topics, parts in a thread."""

import secrets
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from rtp_packets import PromptSender
from running_part import CLOCK, SETUP, eventually, running, stream_gateway

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.decoder import DecoderCounts
from kontur_av.codecs.h26x import H264Encoder
from kontur_av.codecs.opus import OpusEncoder
from kontur_av.media import (
    AUDIO_CLOCK_HZ,
    VIDEO_CLOCK_HZ,
    VIDEO_PAYLOAD_TYPE,
    AudioFrame,
    CaptureStamp,
    Quality,
    VideoFrame,
    empty_picture,
)
from kontur_av.media import AUDIO_PAYLOAD_TYPE as VOICE_PAYLOAD_TYPE
from kontur_av.streams.lipsync import LAG
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.streams.staleness import State
from kontur_av.streams.video_receiver import VideoReceiverCounts
from kontur_av.streams.voice_receiver import VoiceReceiverCounts
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import remove_session
from pipelines.media.figures import CaptureFigures, DisplayFigures
from pipelines.media.process_capture import run_microphone
from pipelines.media.process_display import run_display
from pipelines.media.process_receive import run_video_receive, run_voice_receive
from pipelines.media.process_send import run_video_send
from pipelines.session.figures import ShownRow
from pipelines.session.process import Context
from pipelines.session.topology import SELECTED_TOPIC
from pipelines.table import topology_of
from telepresence.link.gateway import BACKLOG_OCTETS, Backlog

SOUND = np.zeros(960, np.int16)


@pytest.fixture
def session():
    name = f"t-{secrets.token_hex(4)}"
    yield name
    remove_session(name)


def rtp_sender(payload_type, clock_rate_hz):
    return PromptSender(
        payload_type=payload_type,
        clock_rate_hz=clock_rate_hz,
        ssrc=7,
        first_sequence=0,
        timestamp_offset=0,
        cname="gnd",
        report_interval_ns=NS_PER_S,
        wall_offset_ns=CLOCK.wall_offset_ns,
    )


def test_an_input_reports_its_last_capture(session):
    begin_ns = CLOCK.now_ns()
    with running(session, run_microphone, name="ground_mic") as listen:
        eventually(lambda: listen().figures[CaptureFigures, ""].captured or None)
    reported = listen()
    assert begin_ns <= reported.figures[CaptureFigures, ""].captured_ns <= CLOCK.now_ns()
    assert reported.figures[CaptureFigures, ""].source_faults == 0


def test_concealed_sound_is_not_displayed(session):
    stream = SETUP.uplink_voice
    with (
        running(session, run_display, streams=[stream]) as listen,
        TopicBus(session) as bus,
    ):
        writer = bus.writer(f"received/{stream.name}", max_octets=1920)
        fresh, concealed = Quality.FRESH, Quality.CONCEALED
        for number, quality in enumerate([fresh, concealed, concealed, fresh]):
            stamp = CaptureStamp(CLOCK.now_ns(), number, stream.name, quality, number)
            writer.publish_audio(AudioFrame(SOUND, stamp))
        shown = DisplayFigures, stream.name
        eventually(lambda: listen().figures[shown].frames_displayed == 2 or None)
    reported = listen()
    assert reported.figures[shown].frames_displayed == 2
    rows = [row for series in reported.series if series.kind is ShownRow for row in series.rows()]
    assert [row.timestamp for row in rows] == [0, 3]


def test_a_stale_picture_is_marked_on_the_display_and_nowhere_else(session):
    stream = SETUP.uplink_video
    limit_ns = SETUP.stale_after_ns(stream)
    picture = empty_picture(stream.width, stream.height)
    picture[:] = 128
    with (
        running(session, run_display, streams=[stream]) as listen,
        TopicBus(session) as bus,
    ):
        writer = bus.writer(f"received/{stream.name}", max_octets=picture.size)
        screen = bus.reader(f"displayed/{stream.name}")
        received = bus.reader(f"received/{stream.name}")
        lag = bus.reader(f"lag/{stream.name}")

        def shown(is_marked):
            """Wait for a displayed picture that is marked, or is not."""

            def look():
                lease = screen.latest()
                if lease is None:
                    return None
                with lease:
                    luma = int(lease.video().data[0, 0])
                    return lease.stamp if (luma == 81) is is_marked else None

            return eventually(look)

        captured_ns = CLOCK.now_ns()
        stamp = CaptureStamp(captured_ns, 7, stream.name, rtp_timestamp=2**32 - 7)
        writer.publish_video(VideoFrame(picture, stamp))
        assert shown(False) == stamp
        assert shown(True) == stamp
        assert CLOCK.now_ns() >= captured_ns + limit_ns
        shown(True)
        with received.latest() as lease:
            assert (lease.video().data == 128).all(), "the source is not marked"
        with lag.latest() as lease:
            displayed_ns, latency_ns = LAG.unpack(lease.octets())
        assert displayed_ns - latency_ns == captured_ns
        key = DisplayFigures, stream.name
        eventually(lambda: getattr(listen().figures.get(key), "state", None) is State.STALE or None)
        stamp = CaptureStamp(CLOCK.now_ns(), 8, stream.name, Quality.DAMAGED, 8)
        writer.publish_video(VideoFrame(picture, stamp))
        assert shown(False) == stamp
    reported = listen()
    counters = reported.figures[DisplayFigures, stream.name]
    assert counters.stale_episodes >= 1
    assert counters.frozen_ns > counters.stale_ns > 0
    assert counters.damaged_ns > 0
    assert reported.figures[key].age_ns > 0


def test_a_gap_in_a_voice_is_concealed_and_marked(session):
    """Of ten packets the fourth is lost and the fifth is no Opus; repeated until both are seen.

    A slow machine makes other packets late or leaves some out, so a round is repeated until all
    ten have the right quality.
    """
    stream = SETUP.uplink_voice
    rtp, encoder = rtp_sender(VOICE_PAYLOAD_TYPE, AUDIO_CLOCK_HZ), OpusEncoder(bitrate_bps=8000)
    own, made_up, lost, spoilt = Quality.FRESH, Quality.CONCEALED, 3, 4
    heard = {}
    with (
        running(session, run_voice_receive, stream=stream) as listen,
        TopicBus(session) as bus,
    ):
        reader = bus.reader(f"received/{stream.name}", depth=8)
        send_packet, send_report = stream_gateway(session, stream)
        begin_ns = CLOCK.now_ns()

        def told_apart():
            return any(
                [heard.get(first + number) for number in range(7)]
                == [own, own, own, made_up, made_up, own, own]
                for first in range(0, 10 * rounds + 1, 10)
            )

        for rounds in range(50):
            for number in range(10 * rounds, 10 * rounds + 10):
                capture_ns = begin_ns + number * 20 * NS_PER_MS
                stamp = CaptureStamp(capture_ns, number, "ground_mic")
                (packet,) = rtp.audio_packets(encoder.encode(SOUND), stamp).packets
                report = rtp.poll_report(capture_ns)
                if report is not None:
                    send_report(report)
                if number % 10 == spoilt:
                    packet = packet[:12] + b"\xff\xff"  # a packet that holds 0 of 63 frames
                if number % 10 != lost:
                    # Never a burst: what was queued before the start would be left out.
                    time.sleep(max(0, capture_ns - CLOCK.now_ns()) / NS_PER_S)
                    send_packet(packet)
                while (lease := reader.next()) is not None:
                    with lease:
                        at_ns = lease.stamp.capture_ns - begin_ns
                        heard[round(at_ns / (20 * NS_PER_MS))] = lease.stamp.quality
            if told_apart():
                break
        else:
            pytest.fail(f"they were never told apart: {heard}")
    assert all(heard.get(number) != own for number in heard if number % 10 in (lost, spoilt))
    reported = listen().figures[VoiceReceiverCounts, ""]
    assert reported.frames_concealed >= 2
    assert reported.frames_decoded <= 8 * (rounds + 1)


@pytest.mark.parametrize("size", [(2560, 1440), (2560, 1444)])
def test_pictures_of_the_setups_size_are_shown_and_larger_ones_counted(session, size):
    stream = replace(SETUP.uplink_video, width=2560, height=1440)
    width, height = size
    rtp = rtp_sender(VIDEO_PAYLOAD_TYPE, VIDEO_CLOCK_HZ)
    encoder = H264Encoder(
        width=width, height=height, fps=30, cap_bps=1_000_000, coded_size=(width, height)
    )
    picture = empty_picture(width, height)
    picture[:] = 128
    with (
        running(session, run_video_receive, stream=stream) as listen,
        TopicBus(session) as bus,
    ):
        reader = bus.reader(f"received/{stream.name}")
        send_packet, send_report = stream_gateway(session, stream)
        for number in range(3):
            now_ns = CLOCK.now_ns()
            frame = VideoFrame(picture, CaptureStamp(now_ns, number, "left"))
            packets = rtp.video_packets(encoder.encode(frame)).packets
            report = rtp.poll_report(now_ns)
            if report is not None:
                send_report(report)
            for packet in packets:
                send_packet(packet)
        key = DecoderCounts, ""
        eventually(lambda: listen().figures[key].frames_decoded == 3 or None)
        lease = reader.latest()
        if size == (stream.width, stream.height):
            with lease:
                assert (lease.width, lease.height) == size
        else:
            assert lease is None
    assert listen().figures[VideoReceiverCounts, ""].frames_oversized == (0 if lease else 3)


def test_an_encoder_that_fails_ends_its_process(session, monkeypatch):
    stream = SETUP.uplink_video

    def fail(self, *_, **__):
        raise RuntimeError("out of order")

    monkeypatch.setattr(H264Encoder, "encode", fail)
    # Ports of its own: what has failed keeps its sockets.
    setup = replace(SETUP, base_port=29_340)
    context = Context(session=session, topology=topology_of(setup), clock=CLOCK)
    over = threading.Event()
    with TopicBus(session) as bus:
        pictures = bus.writer(SELECTED_TOPIC, max_octets=stream.width * stream.height * 3 // 2)
        picture = empty_picture(stream.width, stream.height)
        picture[:] = 128

        def film():
            while not over.wait(0.02):
                stamp = CaptureStamp(CLOCK.now_ns(), 0, "static")
                pictures.publish_video(VideoFrame(picture, stamp))

        camera = threading.Thread(target=film)
        camera.start()
        try:
            with pytest.raises(RuntimeError, match="out of order"):
                run_video_send(context, stream=stream, topic=SELECTED_TOPIC)
        finally:
            over.set()
            camera.join()


def test_nothing_is_encoded_while_the_link_is_behind(session):
    """A link that leaves out slots carries less than the cap: the pacer alone would not see it."""
    stream = SETUP.uplink_video
    share_octets = stream.cap_bps // 8 // stream.fps
    with (
        TopicBus(session) as bus,
        running(session, run_video_send, stream=stream, topic=SELECTED_TOPIC) as listen,
    ):
        pictures = bus.writer(SELECTED_TOPIC, max_octets=stream.width * stream.height * 3 // 2)
        backlog = bus.writer("link/uplink", max_octets=BACKLOG_OCTETS, wake=False)
        numbers = iter(range(10_000))

        def counters():
            return listen().figures[SenderCounts, ""]

        def counted(counter, more_than):
            def look():
                picture = empty_picture(stream.width, stream.height)
                picture[:] = 128
                stamp = CaptureStamp(CLOCK.now_ns(), next(numbers), "static")
                pictures.publish_video(VideoFrame(picture, stamp))
                return counters() if getattr(counters(), counter) > more_than else None

            return eventually(look)

        for waiting_octets, counter, other in (
            (10 * share_octets, "frames_refused", "frames_encoded"),
            (0, "frames_encoded", None),
            (share_octets + 1, "frames_refused", None),
        ):
            stamp = CaptureStamp(CLOCK.now_ns(), 0, "gateway")
            backlog.publish_octets(Backlog(waiting_octets, 1, True, 0).pack(), stamp)
            totals = counted(counter, getattr(counters(), counter) + 5)
            assert other is None or getattr(totals, other) == 0
