"""Matroska files have the recorded units octet by octet, at their instants."""

from dataclasses import replace

import av
import numpy as np
import pytest
from synthetic_recording import (
    BEGIN_NS,
    CAMERA,
    LOST_PICTURE,
    MS,
    VIDEO,
    spoken,
    wall_ns,
    write_recording,
)

from kontur_av.media import CaptureStamp
from kontur_av.rtp.annex_b import split_annex_b
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.bench.course import marks
from pipelines.cli import main
from pipelines.recording.export.films import FilmClock, FilmUnits
from pipelines.recording.joined import JoinedMessage
from pipelines.recording.recorded_messages import VIDEO as PICTURES
from pipelines.recording.recorded_messages import RecordedPicture, UnitMetadata, pack

SECONDS = 3.0


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    directory = tmp_path_factory.mktemp("films")
    recording = write_recording(directory / "a.mcap", seconds=SECONDS, parts=2)
    assert main(["export", str(recording.paths[0]), "--mkv", str(directory / "mkv")]) == 0
    return recording


def film(written, name):
    return written.paths[0].with_name("mkv") / name


def nal_units(packet):
    """The NAL units of a packet of Matroska, each behind its length (ISO/IEC 14496-15)."""
    octets, at, found = bytes(packet), 0, []
    while at < len(octets):
        length = int.from_bytes(octets[at : at + 4], "big")
        found.append(octets[at + 4 : at + 4 + length])
        at += 4 + length
    return found


def packets(path, kind):
    """The packets of one stream."""
    with av.open(str(path)) as container:
        stream = getattr(container.streams, kind)[0]
        return [packet for packet in container.demux(stream) if packet.size]


def test_there_is_a_film_of_each_stream_with_its_sound_and_a_player_shows_all_pictures(written):
    names = {path.name for path in film(written, ".").iterdir()}
    films = {f"{name}_{way}.mkv" for name in VIDEO for way in ("sent", "received")}
    assert names == films | {f"camera_{CAMERA}.mkv"}
    for name in names:
        with av.open(str(film(written, name))) as container:
            kinds = [stream.type for stream in container.streams]
        assert kinds == (["video"] if name.startswith("camera") else ["video", "audio"])
    for way, early_ms in (("received", 0), ("sent", 6.5)):
        found = packets(film(written, f"uplink_video_{way}.mkv"), "audio")
        assert [bytes(packet) for packet in found] == spoken(8_000, SECONDS)
        heard_ms = [20 * number - early_ms for number in range(1, len(found))]
        assert [packet.pts for packet in found[1:]] == pytest.approx(heard_ms, abs=0.5)
    with av.open(str(film(written, "downlink_video_sent.mkv"))) as container:
        pictures = [frame.to_ndarray() for frame in container.decode(video=0)]
    numbers = [marks.read_number(marks.levels(large(picture))) for picture in pictures]
    assert numbers == list(range(len(written.units["downlink_video"])))
    assert {picture.shape[1] for picture in pictures} == {320, 240}


@pytest.mark.parametrize("name", [*VIDEO, CAMERA])
def test_access_units_are_the_same_at_their_instants_without_those_that_were_lost(written, name):
    path = film(written, f"camera_{name}.mkv" if name == CAMERA else f"{name}_sent.mkv")
    found, units = packets(path, "video"), written.units[name]
    assert [nal_units(packet) for packet in found] == [split_annex_b(unit.data) for unit in units]
    instants = [round((unit.capture_ns - BEGIN_NS) / MS) for unit in units]
    assert [packet.pts for packet in found] == instants
    assert found[0].is_keyframe
    if name == "uplink_video":
        received = packets(film(written, "uplink_video_received.mkv"), "video")
        del found[LOST_PICTURE]
        assert [*map(nal_units, received)] == [*map(nal_units, found)]


def large(picture):
    """The luma of a picture in the size in which its number was drawn."""
    height, width = picture.shape[0] * 2 // 3, picture.shape[1]
    rows, columns = np.arange(240) * height // 240, np.arange(320) * width // 320
    return picture[:height][rows][:, columns]


class Channel:
    """Messages of a channel with facts."""

    def __init__(self):
        self.units = FilmUnits(with_metadata=True)
        self.shown = []

    def put(self, number, data, *, added=False, octets=None):
        value = RecordedPicture(wall_ns=wall_ns(number), frame_id="x", data=data)
        unit = CodedUnit(data=data[-(octets or 0) :], key=added, width=16, height=16)
        metadata = replace(UnitMetadata.of(unit, CaptureStamp(number, number, "x")), added=added)
        topic = "/x/sent"
        message = JoinedMessage(topic, PICTURES.full_name, number, 0, number, pack(value), 0)
        facts_message = message._replace(topic=f"{topic}/facts", data=pack(metadata))
        self.shown += [unit.data for unit in self.units.handle_picture(message)]
        self.shown += [unit.data for unit in self.units.handle_capabilities(facts_message)]


def test_where_parts_meet_the_stream_goes_on_and_instants_rise():
    channel = Channel()
    channel.put(7, b"key of the recorder", added=True)
    channel.put(8, b"sets+eight", octets=5)
    channel.put(9, b"nine")
    channel.put(9, b"key of the recorder", added=True)
    channel.put(10, b"sets+ten", octets=3)
    assert channel.shown == [b"key of the recorder", b"sets+eight", b"nine", b"ten"]
    # After a gap a player needs what the recorder has added.
    channel.put(14, b"key of the recorder", added=True)
    channel.put(15, b"sets+fifteen", octets=7)
    assert channel.shown[4:] == [b"key of the recorder", b"sets+fifteen"]
    clock = FilmClock(0)
    instants = [100.4, 133.6, 50, 80, 300]
    assert [clock.instant_ms(round(at * MS)) for at in instants] == [100, 134, 167, 168, 300]
