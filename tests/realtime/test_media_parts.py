"""The counts of inputs, receivers and displays: real sockets and topics, parts in a thread."""

import secrets
import threading
from dataclasses import replace

import numpy as np
import pytest
from running_part import CLOCK, SETUP, eventually, running

from kontur_av.codecs.h26x import H264Encoder
from kontur_av.media import AudioFrame, CaptureStamp, Quality, VideoFrame, empty_picture
from kontur_av.streams.paced_sender import SenderCounts
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import remove_session
from pipelines.media.following import SELECTED_TOPIC
from pipelines.media.media_metrics import CaptureMetrics, DisplayMetrics
from pipelines.media.process_capture import run_microphone
from pipelines.media.process_display import run_display
from pipelines.media.process_send import run_video_send
from pipelines.session.process import Context
from pipelines.session.session_metrics import ShownRow
from pipelines.session.setup.segments import Direction
from pipelines.session.topic_ends import TopicWriter
from pipelines.session.topology.rows import backlog_topic
from pipelines.table import topology_of
from telepresence.link.gateway import Backlog

SOUND = np.zeros(960, np.int16)


@pytest.fixture
def session():
    name = f"t-{secrets.token_hex(4)}"
    yield name
    remove_session(name)


def test_an_input_reports_its_last_capture(session):
    begin_ns = CLOCK.now_ns()
    with running(session, run_microphone, name="ground_mic") as listen:
        eventually(lambda: listen().metrics[CaptureMetrics, ""].captured or None)
    reported = listen()
    assert begin_ns <= reported.metrics[CaptureMetrics, ""].captured_ns <= CLOCK.now_ns()
    assert reported.metrics[CaptureMetrics, ""].source_faults == 0


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
        shown = DisplayMetrics, stream.name
        eventually(lambda: listen().metrics[shown].frames_displayed == 2 or None)
    reported = listen()
    assert reported.metrics[shown].frames_displayed == 2
    rows = [row for series in reported.series if series.kind is ShownRow for row in series.rows()]
    assert [row.timestamp for row in rows] == [0, 3]


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
        backlog = TopicWriter(bus, backlog_topic(Direction.UPLINK))
        numbers = iter(range(10_000))

        def counters():
            return listen().metrics[SenderCounts, ""]

        def counted(counter, more_than, waiting_octets):
            def look():
                backlog.publish(Backlog(waiting_octets, 1, True, 0), CLOCK.now_ns())
                picture = empty_picture(stream.width, stream.height)
                picture[:] = 128
                stamp = CaptureStamp(CLOCK.now_ns(), next(numbers), "static")
                pictures.publish_video(VideoFrame(picture, stamp))
                return counters() if getattr(counters(), counter) > more_than else None

            return eventually(look)

        for waiting_octets, counter, other in (
            # It drains in the sender's reckoning, so it is told again, and is long at first.
            (1000 * share_octets, "frames_refused", "frames_encoded"),
            (0, "frames_encoded", None),
            (share_octets + 1, "frames_refused", None),
        ):
            totals = counted(counter, getattr(counters(), counter) + 5, waiting_octets)
            assert other is None or getattr(totals, other) == 0
