"""The recorder's core on virtual time, its files read back with the plain `mcap` package."""

from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction
from io import BytesIO

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.codecs.h26x import H264Decoder, H264Encoder
from kontur_av.media import CaptureStamp, VideoFrame, empty_picture
from kontur_av.rtp.nal_formats import H264
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.hand.haptic_trace import CONTACT, ROW
from pipelines.link.gateway_end import GatewayEnd
from pipelines.media.joined_units import MOST_KEPT_NS
from pipelines.media.key_picture_maker import key_of
from pipelines.recording.camera_reader import CameraReader
from pipelines.recording.channels import sources_of
from pipelines.recording.mcap_stream import MAGIC
from pipelines.recording.metadata import METADATA, RecordingMetadata
from pipelines.recording.part_streams import RETRY_NS
from pipelines.recording.recorded_messages import (
    LinkReceived,
    LinkSent,
    RecordedEvent,
    RecordedFrames,
    RecordedPacket,
    RecordedPicture,
    RecordedSound,
    RecorderLosses,
    UnitMetadata,
    unpack,
    unpack_haptics,
)
from pipelines.recording.recorder import TURN_NS, Recorder
from pipelines.recording.scan import FoundMessage, Scan
from pipelines.session.probe import Probe
from pipelines.session.recording_requests import PartLimits
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import BUILT_IN
from pipelines.session.setup.setup_text import setup_toml
from pipelines.table import topology_of
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

SETUP = BUILT_IN["spacejustin"]
TOPOLOGY = topology_of(SETUP, recorder=True)
OFFSET_NS = 1_800_000_000 * NS_PER_S
SENT, ROBOT = "sent/uplink_video", "haptic/robot"
SOURCES = {source.topic: source for source in sources_of(TOPOLOGY)}
METADATA_OF_TEST = RecordingMetadata(
    session="test",
    setup=SETUP.name,
    setup_toml=setup_toml(SETUP),
    version="0",
    seed=3,
    command="kontur-av stream",
    part=1,
    session_ns=0,
    wall_ns=OFFSET_NS,
)


class Disk:
    """Drives a recorder as its process does; `files` is what a disk would hold."""

    def __init__(self, topology=TOPOLOGY, **options):
        self.recorder = Recorder(
            topology, METADATA_OF_TEST, built_in_dictionary(), wall_offset_ns=OFFSET_NS, **options
        )
        self.files = {}
        self.full = False

    def pump(self, now_ns):
        recorder = self.recorder
        if recorder.wants_part(now_ns):
            if self.full:
                recorder.parts.handle_fault(None, "full", now_ns)
            else:
                part = len(self.files) + 1
                self.files[part] = bytearray()
                recorder.handle_opened(part, now_ns)
        recorder.handle_time(now_ns)
        while (piece := recorder.parts.poll_transmit(now_ns)) is not None:
            if self.full:
                recorder.parts.handle_fault(piece.part, "full", now_ns)
            else:
                self.files[piece.part] += piece.octets
                recorder.parts.handle_written()

    def end(self, now_ns):
        self.recorder.handle_end(now_ns)
        self.pump(now_ns)
        return [read(bytes(octets)) for octets in self.files.values() if octets[8:].endswith(MAGIC)]

    def robot(self, number, now_ns, rows=None, **options):
        """A sample of the robot: 20 cycles."""
        octets = (block(now_ns) if rows is None else rows).tobytes()
        self.recorder.handle_sample(SOURCES[ROBOT], octets, stamp(number), now_ns, **options)

    def counts(self, fate):
        """By channel, how many messages had a fate, if any."""
        channels = self.recorder.metrics(None).channels
        return {name: getattr(one, fate) for name, one in channels.items() if getattr(one, fate)}


def read(octets):
    """By channel: its messages, in the order of the file."""
    found = {}
    messages = make_reader(BytesIO(octets)).iter_messages(log_time_order=False)
    for _, channel, message in messages:
        found.setdefault(channel.topic, []).append(message)
    return found


def stamp(number, capture_ns=0):
    return CaptureStamp(capture_ns, number, "test")


def block(first_ns, *, touch=(), noise=None):
    rows = np.zeros(20, ROW)
    rows["time_ns"] = first_ns + np.arange(20) * NS_PER_MS
    rows["fx_n"] = rows["time_ns"] % 97 if noise is None else noise.random(20)
    rows["flags"][list(touch)] = CONTACT
    return rows


def coded(count):
    """A stream as it is sent: a key picture once, then refresh waves; with its pictures."""
    encoder = H264Encoder(width=160, height=120, fps=Fraction(30), cap_bps=200_000, refresh_s=1)
    decoder, units = H264Decoder(), []
    for number in range(count):
        picture = empty_picture(160, 120)
        picture[:120] = (np.arange(160) * 2 + np.arange(120)[:, None] + 3 * number) % 200 + 20
        picture[120:] = 128
        at_ns = number * NS_PER_S // 30
        unit = encoder.encode(VideoFrame(picture, stamp(number, at_ns)))
        width, height = encoder.unit_size
        (shown,) = decoder.decode(unit.data, number)
        room = empty_picture(width, height)
        shown.copy_to(room)
        units.append((unit, (width, height), room))
    return units


def test_each_message_has_its_wall_time_and_contacts_are_events():
    disk, now_ns = Disk(), 10 * NS_PER_S
    disk.pump(now_ns - NS_PER_S)
    rows = block(now_ns - 20 * NS_PER_MS)
    published_ns = now_ns - 3 * NS_PER_MS
    disk.robot(7, now_ns, rows, published_ns=published_ns)
    event = RecordedEvent(session_ns=now_ns, number=4, what="link", text="signal lost")
    disk.recorder.handle_event(event, now_ns)
    (file,) = disk.end(now_ns + NS_PER_S)
    (message,) = file["/haptic/up/sent"]
    instants = message.log_time - OFFSET_NS, message.publish_time - OFFSET_NS
    assert instants == (now_ns - 20 * NS_PER_MS, published_ns)
    assert message.sequence == 7
    assert unpack_haptics(message.data)["fx_n"].tolist() == rows["fx_n"].tolist()
    assert unpack(RecordedEvent, file["/events"][0].data) == event
    assert len(file["/log"]) == 1
    disk = Disk()
    disk.pump(0)
    touches = [(), (5, 6, 9), (0,), (), (), (), (3,)]
    for number, touch in enumerate(touches):
        disk.robot(number, 0, block(number * 20 * NS_PER_MS, touch=touch))
    (file,) = disk.end(NS_PER_S)
    events = [unpack(RecordedEvent, each.data) for each in file["/events"]]
    assert [(each.session_ns // NS_PER_MS, each.text) for each in events] == [
        (25, "touch begins"),
        (40, "touch ends"),
        (123, "touch begins"),
    ]
    # A writer counts while nobody reads, and a topic gives a new reader its newest sample.
    disk, now_ns = Disk(), 100 * NS_PER_S
    disk.pump(now_ns)
    for number, at_ns in ((3, 90 * NS_PER_S), (800, now_ns), (801, now_ns)):
        disk.robot(number, now_ns, block(at_ns), published_ns=at_ns)
    (file,) = disk.end(now_ns + NS_PER_S)
    assert [each.sequence for each in file["/haptic/up/sent"]] == [800, 801]
    assert not disk.counts("missed")


def streamed(disk, count, *, first=0, late=0, without=()):
    """Record a stream, and a sample of the robot beside each unit.

    late: a key picture that is asked for comes so many units later; without: not for these.
    """
    units, due = coded(count), {}
    sets = H264.parameter_sets(units[0][0].data)

    def give(number, **changes):
        unit, (width, height), _ = units[number]
        size = {"width": width, "height": height, "parameter_sets": sets}
        whole = CodedUnit(**{"data": unit.data, "key": unit.keyframe} | size | changes)
        at = stamp(number, number * NS_PER_S // 30)
        disk.recorder.handle_sample(SOURCES[SENT], whole.pack(), at, at_ns)

    for number in range(first, count):
        at_ns = number * NS_PER_S // 30
        disk.pump(at_ns)
        give(number)
        disk.robot(number, at_ns)
        if disk.recorder.poll_ask(SOURCES[SENT], at_ns) and number not in without:
            due[number + late] = number
        if number in due:
            _, size, picture = units[due[number]]
            give(due[number], data=key_of(picture, *size), key=True, added=True)
        disk.pump(at_ns)
    return units


def told(file):
    """Number of each unit in the file, and whether it is a key picture that was added."""
    video, metadata = (file.get(f"/uplink_video/sent{name}", []) for name in ("", "/facts"))
    assert [each.log_time for each in video] == sorted(each.log_time for each in video)
    assert [each.sequence for each in metadata] == [each.sequence for each in video]
    added = [unpack(UnitMetadata, each.data).added for each in metadata]
    return list(zip([each.sequence for each in video], added, strict=True))


def plain(numbers):
    return [(number, False) for number in numbers]


def shown(file, size):
    """The pictures of a file."""
    decoder, found = H264Decoder(), []
    for message in file["/uplink_video/sent"]:
        (picture,) = decoder.decode(unpack(RecordedPicture, message.data).data, 0)
        room = empty_picture(*size)
        picture.copy_to(room)
        found.append(room.astype(int))
    return found


def test_a_recording_that_joins_begins_with_a_key_picture_and_is_right_after_a_wave():
    disk = Disk()
    disk.pump(20 * NS_PER_S // 30)
    units = streamed(disk, 70, first=20, late=2)
    (file,) = disk.end(3 * NS_PER_S)
    assert told(file) == [(20, True), *plain(range(21, 70))]
    *_, last = shown(file, units[-1][1])
    assert np.array_equal(last, units[-1][2])
    assert disk.recorder.metrics(None).lost == 0


@pytest.mark.parametrize("late", [0, 1, 20])
def test_each_part_begins_with_a_key_picture_and_no_unit_is_lost_however_late_it_comes(late):
    disk, count = Disk(limits=PartLimits(ns=2 * NS_PER_S)), 115
    units = streamed(disk, count, late=late)
    first, second = disk.end(4 * NS_PER_S)
    assert told(first) == plain(range(61))
    assert told(second) == [(60, True), *plain(range(61, count))]
    for picture, (_, _, right) in zip(shown(second, units[0][1]), units[60:], strict=True):
        assert np.abs(picture - right).mean() < 2
    metrics = disk.recorder.metrics(None)
    assert (metrics.lost, metrics.late_keys) == (0, 0)


def test_before_a_new_part_the_others_do_not_wait_and_what_waits_on_a_failing_disk_is_kept():
    disk = Disk(limits=PartLimits(ns=2 * NS_PER_S))
    streamed(disk, 80, late=1000)
    assert len(disk.files) == 1
    disk.recorder.parts.handle_fault(1, "full", 80 * NS_PER_S // 30)
    disk.pump(80 * NS_PER_S // 30 + RETRY_NS)
    *_, file = disk.end(6 * NS_PER_S)
    assert told(file) == plain(range(60, 80))
    counts = disk.recorder.metrics(None).channels
    for channel in ("/uplink_video/sent", "/uplink_video/sent/facts", "/haptic/up/sent"):
        assert counts[channel].kept + counts[channel].dropped == 80
    assert counts["/haptic/up/sent"].kept > 60


@pytest.mark.parametrize("end", ["turn", "time", "octets", "recording"])
def test_units_whose_key_picture_never_comes_are_recorded_without(end, monkeypatch):
    if end == "octets":
        monkeypatch.setattr("pipelines.media.joined_units.MOST_KEPT_OCTETS", 5_000)
    count = 60 + {"turn": 40, "time": 160, "octets": 40, "recording": 10}[end]
    disk = Disk(limits=PartLimits(ns=2 * NS_PER_S))
    streamed(disk, count, without=range(1000))
    late_keys = disk.recorder.metrics(None).late_keys
    files = disk.end(count * NS_PER_S // 30)
    assert [each for file in files for each in told(file)] == plain(range(count))
    assert (late_keys > 0) == (end in ("time", "octets"))
    # A new part does not wait for them for ever.
    assert (len(files) > 1) == (count > 60 + TURN_NS * 30 // NS_PER_S)
    assert MOST_KEPT_NS > TURN_NS and disk.recorder.metrics(None).lost == 0


@pytest.mark.rule("4")
def test_a_disk_that_stands_still_costs_messages_but_no_memory():
    disk, noise = Disk(most_waiting_octets=100_000), np.random.default_rng(0)
    disk.pump(0)
    for number in range(400):
        disk.robot(number, number * NS_PER_S, block(number, noise=noise))
    dropped = disk.counts("dropped")["/haptic/up/sent"]
    assert 0 < dropped < 400
    (file,) = disk.end(400 * NS_PER_S)
    assert len(file["/haptic/up/sent"]) + dropped == 400
    assert disk.counts("kept")["/haptic/up/sent"] == len(file["/haptic/up/sent"])


@pytest.mark.rule("4")
@pytest.mark.parametrize("chunks_before", [0, 3])
def test_on_a_full_disk_every_message_is_kept_or_counted_as_dropped(chunks_before):
    disk, handled = Disk(), 0
    for number in range(1000):
        now_ns = number * 20 * NS_PER_MS
        disk.full = chunks_before * NS_PER_S < now_ns < 8 * NS_PER_S
        disk.pump(now_ns)
        disk.robot(number, now_ns)
        handled += 1
    assert disk.recorder.parts.fault == ""
    *_, last = disk.end(20 * NS_PER_S)
    torn = Scan(memoryview(bytes(disk.files[1])))
    found = [each for each in torn.items() if isinstance(each, FoundMessage)]
    kept = sum(each.channel.topic == "/haptic/up/sent" for each in found)
    assert (kept > 0) == (chunks_before > 0)
    counted = disk.recorder.metrics(None).channels["/haptic/up/sent"]
    assert counted.kept == kept + len(last["/haptic/up/sent"])
    assert counted.kept + counted.dropped == handled
    # The new part begins with the first try after the disk has room.
    assert len(last["/haptic/up/sent"]) * 20 * NS_PER_MS >= 12 * NS_PER_S - RETRY_NS
    assert unpack(RecorderLosses, last["/recorder/losses"][0].data).losses


def test_a_part_ends_at_its_size_and_missed_samples_are_counted_by_channel():
    disk = Disk(limits=PartLimits(octets=20_000))
    noise = np.random.default_rng(0)
    for number in range(600):
        now_ns = number * 20 * NS_PER_MS
        disk.pump(now_ns)
        disk.robot(number, now_ns, block(now_ns, noise=noise))
    files = disk.end(12 * NS_PER_S)
    assert len(files) > 3
    sequences = [each.sequence for file in files for each in file["/haptic/up/sent"]]
    assert sequences == list(range(600))
    for part, octets in disk.files.items():
        (record,) = make_reader(BytesIO(bytes(octets))).iter_metadata()
        assert record.name == METADATA
        metadata = RecordingMetadata.of(record.metadata)
        assert metadata.part == part
        assert metadata.wall_ns - metadata.session_ns == OFFSET_NS

    # Missed samples are counted by channel in the file and in the report.
    disk = Disk()
    disk.pump(0)
    for number in (5, 6, 9, 0, 1, 3):  # its writer was started again
        disk.robot(number, 0)
    (file,) = disk.end(NS_PER_S)
    told = unpack(RecorderLosses, file["/recorder/losses"][-1].data)
    missed = {"/haptic/up/sent": 3, "/haptic/down/received": 3}
    assert {loss.channel: loss.missed for loss in told.losses} == missed == disk.counts("missed")
    assert not any(loss.dropped for loss in told.losses)


@given(st.lists(st.tuples(st.integers(0, 900), st.integers(0, 2900)), max_size=12))
def test_events_are_in_the_order_of_their_instants(told):
    """Each came up to 3 s after its instant; a part ends meanwhile."""
    disk = Disk(limits=PartLimits(ns=2 * NS_PER_S))
    disk.pump(0)
    came = sorted((at + late, at) for at, late in told)
    for now_ms, at_ms in came:
        disk.pump(now_ms * NS_PER_MS)
        event = RecordedEvent(session_ns=at_ms * NS_PER_MS, number=0, what="link", text="")
        disk.recorder.handle_event(event, now_ms * NS_PER_MS)
        disk.recorder.handle_time(now_ms * NS_PER_MS)
    files = disk.end(5 * NS_PER_S)
    for channel in ("/events", "/log"):
        found = [each.log_time - OFFSET_NS for file in files for each in file.get(channel, ())]
        assert found == sorted(at * NS_PER_MS for at, _ in told)


class Camera(nullcontext):
    """A bus with one topic, which is its reader and the lease of its newest picture, too."""

    def __init__(self):
        super().__init__(self)
        self.stamp, self.unread = None, False

    @property
    def published_ns(self):
        return self.stamp.capture_ns

    def reader(self, topic, *, depth=1):
        return self

    def next(self):
        unread, self.unread = self.unread, False
        return self if unread else None

    latest = next

    def video(self):
        return VideoFrame(empty_picture(64, 48), self.stamp)

    def close(self): ...


@pytest.mark.parametrize(("cameras", "kept", "lost"), [("one_idle", 10, 0), ("all", 59, 1)])
def test_cameras_are_coded_cheaply_or_whole_as_the_setup_wants(cameras, kept, lost):
    whole = cameras == "all"
    setup = replace(SETUP, recorded_cameras="all") if whole else SETUP
    disk = Disk(topology_of(setup, recorder=True))
    disk.pump(0)
    source = SOURCES["input/head"]
    assert source.is_camera
    camera = Camera()
    reader = CameraReader(camera, source, disk.recorder.coder(source), NS_PER_S, whole=whole)
    reader.handle_carried(whole)
    # The first is of an earlier recording, which the topic has kept: it is neither a picture of
    # this one, nor are those between them lost.
    for number in (-900, *sorted({*range(60)} - {7})):
        at_ns = NS_PER_S + number * NS_PER_S // 30
        camera.stamp, camera.unread = stamp(900 + number, at_ns), True
        # One that is idle opens its reader first.
        for _ in range(2):
            if (coded := reader.poll(max(at_ns, NS_PER_S))) is not None:
                disk.recorder.handle_camera(source, *coded, at_ns)
    (file,) = disk.end(3 * NS_PER_S)
    units = [unpack(RecordedPicture, each.data) for each in file["/camera/head"]]
    assert (len(units), disk.recorder.metrics("").lost) == (kept, lost)
    assert H264.parameter_sets(units[0].data)
    assert {unit.frame_id for unit in units} == {"head"}


def test_sounds_packets_metrics_and_frames_are_recorded_as_they_were():
    disk = Disk(link_frames=True)
    disk.pump(0)
    sources = {source.topic: source for source in sources_of(TOPOLOGY, link_frames=True)}
    numbers = {"boot_id": 1, "secret": 1, "seed": 1, "epoch_ns": 0, "now_ns": 0, "first_ns": 0}
    gateway = GatewayEnd(TOPOLOGY, Segment.GROUND, Probe(), **numbers).gateway
    gateway.frames_sent = []
    for number in range(3):
        gateway.handle_slot(number * NS_PER_MS)
    metrics = gateway.report(3 * NS_PER_MS)
    given = {
        "sent/uplink_voice": b"opus",
        "tm/space/sent": b"no packet",
        "metrics/ground": msgspec.msgpack.encode(metrics),
        "frames/uplink/sent": msgspec.msgpack.encode(gateway.frames_sent),
    }
    for topic, octets in given.items():
        disk.recorder.handle_sample(sources[topic], octets, stamp(0, 5 * NS_PER_MS), 6 * NS_PER_MS)
    (found,) = disk.end(NS_PER_S)

    def only(kind, channel):
        (message,) = found[channel]
        return unpack(kind, message.data)

    assert only(RecordedSound, "/uplink_voice/sent").data == b"opus"
    assert only(RecordedSound, "/uplink_voice/sent").wall_ns == OFFSET_NS + 5 * NS_PER_MS
    assert only(RecordedPacket, "/telemetry/space/sent").data == b"no packet"
    assert only(LinkSent, "/link/uplink/sent").frames == metrics.transmit.frames == 3
    assert only(LinkReceived, "/link/downlink/received").frames == 0
    frames = only(RecordedFrames, "/link/uplink/frames/sent")
    assert list(zip(frames.time_ns, frames.data, strict=True)) == gateway.frames_sent
    assert disk.counts("kept")["/link/uplink/frames/sent"] == 1
