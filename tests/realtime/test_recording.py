"""Sessions that are recorded: what the file holds, and that neither kill nor full disk ends it."""

import os
import re
import resource
import signal
import subprocess
from collections import Counter

import av
import numpy as np
from mcap.reader import make_reader
from mcap.records import Metadata
from running_session import COMMAND, eventually
from xtce_decoder import decoded

from pipelines.cli import main
from pipelines.recording.metadata import METADATA, RecordingMetadata
from pipelines.recording.recorded_messages import (
    RecordedEvent,
    RecordedPacket,
    unpack,
    unpack_haptics,
)
from pipelines.recording.scan import FoundMessage, Scan
from telepresence.haptics.device.states import JoystickState
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.head import is_packet

SIDES = ("sent", "received")


def counted(path):
    """By channel, how many messages a whole file has, by the plain `mcap` package."""
    with path.open("rb") as file:
        return Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages())


def scanned(path):
    """A scan of a file that may be torn, its messages, and the facts of the recording."""
    scan, messages, capabilities = Scan(memoryview(path.read_bytes())), [], None
    for item in scan.items():
        if isinstance(item, FoundMessage):
            messages.append(item)
        elif isinstance(item, Metadata) and item.name == METADATA:
            capabilities = RecordingMetadata.of(item.metadata)
    return scan, messages, capabilities


def kept(report):
    return {
        name: channel["kept"]
        for name, channel in report["recorder"]["channels"].items()
        if channel["kept"]
    }


def record(session, *words):
    return session.ask("record", *map(str, words))


def parts_of(path):
    """The parts of a recording in their order."""
    return [path, *sorted(path.parent.glob(f"{path.stem}-*.mcap"))]


def test_the_file_has_what_the_report_says(start, tmp_path):
    path = tmp_path / "run.mcap"
    cameras = ("--record-cameras", "all")
    session = start(
        "spacejustin", "--record", str(path), "--link-frames", "--part-mb", "1", *cameras
    )
    session.wait_for_flow()
    assert session.select("head").returncode == 0
    busy = record(session, tmp_path / "other.mcap")
    _, told = busy.stderr.splitlines()
    assert busy.returncode == 2 and str(path) in told
    assert not (tmp_path / "other.mcap").exists()
    eventually((tmp_path / "run-2.mcap").exists, "a second part after 1 MB")
    session.wait_for_flow()
    report = session.finish(clean=True, sound=True)
    found = sum(map(counted, parts_of(path)), Counter())
    assert found == kept(report)
    scans = [scanned(part) for part in parts_of(path)]
    assert all(scan.metrics.sound for scan, _, _ in scans)

    def octets(topic):
        return [
            each.message.data
            for _, messages, _ in scans
            for each in messages
            if each.channel.topic == topic
        ]

    for name in ("uplink_video", "downlink_video"):
        assert found[f"/{name}/sent"] == found[f"/{name}/sent/facts"] > 0
    for topic in (
        *("/uplink_video/received", "/downlink_video/received", "/camera/static"),
        *(f"/haptic/{way}" for way in ("up/sent", "up/received", "down/sent", "down/received")),
        *(f"/{way}_voice/{what}" for way in ("uplink", "downlink") for what in SIDES),
        *(f"/link/{way}/{what}" for way in ("uplink", "downlink") for what in SIDES),
        *(f"/link/{way}/frames/{what}" for way in ("uplink", "downlink") for what in SIDES),
    ):
        assert found[topic] > 0, topic
    for above, below in (("space", "ground"), ("ground", "space")):
        assert 0 < found[f"/telemetry/{below}/received"] <= found[f"/telemetry/{above}/sent"]
    assert 0 < found["/telecommand/ground/received"] <= found["/telecommand/space/sent"]
    assert any("head" in unpack(RecordedEvent, data).text for data in octets("/events"))
    # The telemetry that came down is read by a decoder of others.
    packets = [unpack(RecordedPacket, data).data for data in octets("/telemetry/ground/received")]
    telemetry = b"".join(packet for packet in packets if is_packet(packet))
    states = [
        packet["joystick_state"]
        for packet in decoded(built_in_dictionary(), telemetry, tmp_path)
        if "joystick_state" in packet and packet["SERVICE"] == 3
    ]
    assert states and {*states} <= {one.words for one in JoystickState}
    # Each sample of the hand has a number, and none is missing that is not counted.
    rows = [unpack_haptics(data)["sequence"] for data in octets("/haptic/down/sent")]
    numbers = np.concatenate(rows)
    gaps = (np.diff(numbers[numbers >= 0]) % 65_536 != 1).sum()
    told = report["recorder"]["channels"]["/haptic/down/sent"]
    assert gaps <= told["dropped"] + told["missed"], told
    films, tables = tmp_path / "films", tmp_path / "tables"
    assert main(["export", str(path), "--mkv", str(films), "--csv", str(tables)]) == 0
    with (tables / "haptic_down_sent.csv").open() as lines:
        assert sum(1 for _ in lines) - 1 == len(numbers)
    with av.open(str(films / "downlink_video_sent.mkv")) as film:
        packets = Counter(packet.stream.type for packet in film.demux() if packet.size)
    # A part may begin with a key picture that was added, of a picture that is there already.
    sent = found["/downlink_video/sent"]
    assert sent - len(scans) <= packets["video"] <= sent
    assert packets["audio"] == found["/downlink_voice/sent"]


def test_a_killed_recorder_goes_on_in_a_new_part(start, tmp_path):
    path, second = tmp_path / "run.mcap", tmp_path / "run-2.mcap"
    session = start("taskboard", "--record", str(path))
    pids = session.pids()
    session.wait_for_flow()
    eventually(lambda: path.exists() and path.stat().st_size > 100_000, "a second in the file")
    os.kill(pids["recorder"], signal.SIGKILL)
    eventually(lambda: second.exists() and second.stat().st_size > 100_000, "a second part")
    report = session.finish(clean=True)
    assert report["recorder"]["parts"] == 2
    scan, messages, capabilities = scanned(path)
    assert not scan.metrics.closed and not scan.metrics.orphans
    later = scanned(second)[2]
    assert later.part == 2
    assert later.wall_ns - later.session_ns == capabilities.wall_ns - capabilities.session_ns
    both = Counter(each.channel.topic for each in messages) + counted(second)
    # The killed one's last report may be half a second old.
    assert all(both[name] >= count for name, count in kept(report).items())


def test_a_terminal_joins_a_session_and_leaves_it_again(start, tmp_path):
    session = start("taskboard")
    session.wait_for_flow()
    first, second = tmp_path / "a.mcap", tmp_path / "b.mcap"
    done = record(session, first, "--seconds", "1")
    assert done.returncode == 0, done
    assert re.fullmatch(r"session taskboard-\d+\n", done.stderr)
    assert scanned(first)[0].metrics.sound
    again = record(session, first, "--seconds", "1")
    assert again.returncode == 2 and "--overwrite" in again.stderr
    replaced = record(session, first, *["--seconds", "3", "--part-seconds", "1", "--overwrite"])
    assert replaced.returncode == 0, replaced.stdout + replaced.stderr
    parts = [scanned(part)[2].part for part in parts_of(first)]
    assert parts == [*range(1, len(parts) + 1)] != [1]
    nowhere = record(session, tmp_path / "none" / "c.mcap")
    assert nowhere.returncode == 2 and nowhere.stderr.count("\n") == 1
    # A terminal that is killed does not end the session, but its recording.
    process = subprocess.Popen(
        [*COMMAND, "record", str(second)], stdout=subprocess.DEVNULL, env=session.environment
    )
    eventually(lambda: second.exists() and second.stat().st_size > 10_000, "the second recording")
    process.kill()
    process.wait()
    eventually(lambda: scanned(second)[0].metrics.sound, "the end of the second recording")
    session.wait_for_flow()
    report = session.finish(clean=True)
    assert report["recorder"]["parts"] == 2 + len(parts)


def test_a_full_disk_does_not_end_the_session(start, tmp_path, monkeypatch):
    # The limit holds for shared memory, too: iceoryx2 then leaves recorder and camera stuck.
    monkeypatch.setenv("KONTUR_AV_TOPICS", "files")
    path = tmp_path / "run.mcap"
    session = start("taskboard", "--record", str(path))
    pids = session.pids()
    session.wait_for_flow()
    resource.prlimit(pids["recorder"], resource.RLIMIT_FSIZE, (150_000, resource.RLIM_INFINITY))
    eventually(lambda: "File too large" in session.lines()[-1], "the fault in the live view")
    session.wait_for_flow()
    unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    resource.prlimit(pids["recorder"], resource.RLIMIT_FSIZE, unlimited)

    def newest():
        return max(tmp_path.glob("run-*.mcap"), key=lambda each: int(each.stem[4:]), default=None)

    eventually(lambda: newest() is not None and newest().stat().st_size > 200_000, "a new part")
    report = session.finish(clean=True)
    assert report["processes"]["recorder"]["restarts"] == 0
    recorder = report["recorder"]
    assert recorder["disk_faults"] >= 1 and recorder.get("fault") is None
    assert sum(channel["dropped"] for channel in recorder["channels"].values()) > 0
    assert [one["what"] for one in report["warnings"] if one["where"] == "recorder"] == [
        "not_recorded"
    ]
    scans = [scanned(each) for each in tmp_path.glob("run*.mcap")]
    assert all(not scan.metrics.holes for scan, _, _ in scans)
    total = Counter(each.channel.topic for _, messages, _ in scans for each in messages)
    assert total == kept(report)
