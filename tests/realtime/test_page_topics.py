"""What browser pages read and give: real topics, sockets and FIFOs, parts in a thread."""

import os
import secrets
import socket
import threading
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from flat_pictures import PAGE, PICTURE_OCTETS, STREAM, flat, newest_level, repeated
from running_part import CLOCK, SETUP, eventually, running, stream_gateway

from kontur_av.clock import NS_PER_MS
from kontur_av.codecs.h26x import H264Decoder
from kontur_av.media import AudioFrame, CaptureStamp, VideoFrame, empty_picture
from kontur_av.streams.coded_unit import CodedUnit
from kontur_av.topics.bus import TopicBus
from kontur_av.topics.session_files import remove_session
from pipelines.media.figures import CaptureFigures
from pipelines.media.process_capture import run_camera, run_microphone
from pipelines.media.process_receive import run_video_receive
from pipelines.media.process_send import run_video_send
from pipelines.session.datagrams import LOOPBACK
from pipelines.table import topology_of

INPUT, PREVIEW = "input/iss_camera", "preview/iss_camera"


@pytest.fixture
def session():
    name = f"t-{secrets.token_hex(4)}"
    yield name
    remove_session(name)


def test_a_page_takes_a_camera_over_and_the_scene_returns(session):
    with (
        TopicBus(session) as bus,
        running(session, run_camera, name="iss_camera", stream=STREAM, pages=True) as listen,
    ):
        reader, page = bus.reader(INPUT), bus.writer(PAGE, max_octets=PICTURE_OCTETS)
        eventually(lambda: newest_level(reader) == -1 or None)

        def give(number):
            stamp = CaptureStamp(CLOCK.now_ns(), number, "page_space")
            page.publish_video(VideoFrame(flat(77, 64, 48), stamp))
            page.publish_video(VideoFrame(flat(200), stamp))

        with repeated(give):
            eventually(lambda: newest_level(reader) == 200 or None)
            for _ in range(10):
                assert eventually(lambda: newest_level(reader)) == 200
            gauges = CaptureFigures, ""
            eventually(lambda: listen().figures[gauges].live_source == "page" or None)
        eventually(lambda: newest_level(reader) == -1 or None)
        eventually(lambda: listen().figures[gauges].live_source == "own" or None)
    counted = listen().figures[CaptureFigures, ""]
    assert 10 <= counted.from_page < counted.captured


def test_a_source_behind_a_page_goes_on_with_its_newest_picture(session, tmp_path):
    """A writer of pictures that nobody read would wait in the middle of the pipe."""
    fifo = tmp_path / "head.y4m"
    os.mkfifo(fifo)
    setup = replace(SETUP, sources={"iss_camera": f"pipe:{fifo}"})
    written = [0]

    def write(number):
        octets = flat(number % 200 + 20).tobytes()
        pipe.write(b"FRAME\n" + octets)
        written[0] = number % 200 + 20

    with (
        TopicBus(session) as bus,
        running(
            session, run_camera, setup=setup, name="iss_camera", stream=STREAM, pages=True
        ) as listen,
    ):
        reader, page = bus.reader(INPUT), bus.writer(PAGE, max_octets=PICTURE_OCTETS)
        with fifo.open("wb", buffering=0) as pipe:
            pipe.write(b"YUV4MPEG2 W%d H%d F30:1 Ip C420jpeg\n" % (STREAM.width, STREAM.height))
            with repeated(write):
                eventually(lambda: newest_level(reader))

                def give(number):
                    stamp = CaptureStamp(CLOCK.now_ns(), number, "page_space")
                    page.publish_video(VideoFrame(flat(240), stamp))

                with repeated(give, 0.2):
                    eventually(lambda: newest_level(reader) == 240 or None)
                    before = written[0]
                    eventually(lambda: written[0] > before + 60 or None)

                def own_level():
                    level = newest_level(reader)
                    return None if level == 240 else level

                own = eventually(own_level)
                assert written[0] - 10 < own <= written[0] + 1
    assert listen().figures[CaptureFigures, ""].source_faults <= 1


def test_previews_alone_are_drawn_and_are_small(session):
    with (
        TopicBus(session) as bus,
        running(session, run_camera, name="iss_camera", stream=STREAM) as listen,
    ):
        small = bus.reader(PREVIEW, depth=8)
        captured = CaptureFigures, ""
        eventually(lambda: small.has_new() or None)
        before = listen().figures[captured].captured
        eventually(lambda: listen().figures[captured].captured > before + 60 or None)
        stamps = []
        while (lease := small.next()) is not None:
            with lease:
                assert (lease.width, lease.height) == (160, 120)
                assert lease.video().data[:120].std() > 10
                stamps.append(lease.stamp.capture_ns)
        assert len(stamps) >= 3
        steps = [later - earlier for earlier, later in pairwise(stamps)]
        assert min(steps) > 100 * NS_PER_MS
        # Nobody read the camera itself: what it publishes are the pictures of the previews.
        whole = bus.reader(INPUT)
        with eventually(whole.latest) as lease:
            assert (lease.width, lease.height) == (STREAM.width, STREAM.height)


def test_a_page_speaks_in_place_of_a_microphone(session):
    with (
        TopicBus(session) as bus,
        running(session, run_microphone, name="iss_mic", pages=True) as listen,
    ):
        reader = bus.reader("input/iss_mic", depth=8)
        page = bus.writer("page/iss_mic", max_octets=1920)
        heard = []

        def listened():
            while (lease := reader.next()) is not None:
                with lease:
                    samples = lease.audio().samples
                    own = int(samples[0]) if np.all(samples == samples[0]) else -1
                    heard.append((own, lease.stamp))
            return heard

        def say(number):
            stamp = CaptureStamp(CLOCK.now_ns() - 25 * NS_PER_MS, number, "page_space")
            page.publish_audio(AudioFrame(np.full(960, 1000 + number, np.int16), stamp))

        with repeated(say, 0.02):
            eventually(lambda: sum(own >= 1000 for own, _ in listened()) > 30 or None)
        said = len(listened())
        eventually(lambda: any(own < 1000 for own, _ in listened()[said:]) or None)
    numbers = [own for own, _ in heard if own >= 1000]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    stamps = [stamp for _, stamp in heard]
    assert [stamp.sequence for stamp in stamps] == list(
        range(stamps[0].sequence, stamps[0].sequence + len(stamps))
    )
    assert all(a.capture_ns < b.capture_ns for a, b in pairwise(stamps))
    assert listen().figures[CaptureFigures, ""].from_page == len(numbers)


@contextmanager
def channel(stream):
    """Carry a stream's packets from its sender to its receiver, in place of the radio link."""
    topology = topology_of(SETUP)
    over = threading.Event()
    threads = []
    for name, send in zip(
        (stream.name, f"{stream.name}_rtcp"), stream_gateway("", stream), strict=True
    ):
        entry = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        entry.bind((LOOPBACK, topology.entry_port(name)))
        entry.settimeout(0.05)

        def carry(entry=entry, send=send):
            with entry:
                while not over.is_set():
                    with suppress(TimeoutError):
                        send(entry.recv(65_535))

        threads.append(threading.Thread(target=carry))
        threads[-1].start()
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


def test_coded_units_decode_to_the_pictures_that_are_shown(session):
    name = STREAM.name
    received, decoded, coded, sent = {}, {}, [], []
    with (
        TopicBus(session) as bus,
        channel(STREAM),
        running(session, run_video_receive, stream=STREAM) as _,
        running(session, run_video_send, stream=STREAM, topic=INPUT) as _,
    ):
        readers = {
            kind: bus.reader(f"{kind}/{name}", depth=8)
            for kind in ("received", "decoded", "coded", "sent")
        }
        camera = bus.writer(INPUT, max_octets=PICTURE_OCTETS)
        ramp = np.linspace(20, 220, STREAM.width, dtype=np.uint8)

        def film(number):
            picture = flat(0)
            picture[: STREAM.height] = np.roll(ramp, 8 * number)
            camera.publish_video(VideoFrame(picture, CaptureStamp(CLOCK.now_ns(), number, "cam")))

        def take():
            for kind, reader in readers.items():
                while (lease := reader.next()) is not None:
                    with lease:
                        if kind in ("received", "decoded"):
                            pictures = received if kind == "received" else decoded
                            data = lease.video().data.copy()
                            pictures[lease.stamp.rtp_timestamp] = data, lease.stamp
                        else:
                            units = coded if kind == "coded" else sent
                            units.append((CodedUnit.unpack(lease.octets()), lease.stamp))
            return len(coded)

        with repeated(film):
            eventually(lambda: take() >= 20 or None)
    assert [stamp.sequence for _, stamp in coded] == list(range(len(coded)))
    assert coded[0][0].key
    decoder = H264Decoder()
    compared = 0
    for unit, stamp in coded:
        (picture,) = decoder.decode(unit.data, stamp.rtp_timestamp)
        assert (unit.width, unit.height) == (picture.width, picture.height)
        assert not (unit.refused or unit.damaged)
        if stamp.rtp_timestamp not in received:
            assert not unit.dated
            continue
        shown = empty_picture(STREAM.width, STREAM.height)
        picture.scale_into(shown)
        whole, shown_stamp = received[stamp.rtp_timestamp]
        assert np.array_equal(shown, whole)
        assert np.array_equal(picture.to_i420(), decoded[stamp.rtp_timestamp][0])
        assert stamp.capture_ns == shown_stamp.capture_ns and unit.dated
        compared += 1
    assert compared >= 10
    # What arrived is what was sent, and was captured when it was.
    for unit, stamp in coded[:-1]:
        # Pictures of a film that repeats itself may have the same octets.
        same = [(one, when) for one, when in sent if one.data == unit.data]
        whole, sent_stamp = min(same, key=lambda one: abs(one[1].capture_ns - stamp.capture_ns))
        assert (whole.key, whole.width, whole.height) == (unit.key, unit.width, unit.height)
        assert not unit.dated or abs(stamp.capture_ns - sent_stamp.capture_ns) < NS_PER_MS
