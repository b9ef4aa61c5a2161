"""YAMCS reads a session's telemetry and commands it; all it has is what the recording has."""

import base64
import time
from collections import Counter, defaultdict
from datetime import UTC, datetime
from math import isnan
from types import SimpleNamespace

import pytest
from common import repeats
from running_session import RunningSession, assert_sound, eventually, free_pair, tcp_port
from yamcs import Yamcs, milliseconds, new_instance, value_of

from pipelines.recording.joined import JoinedRecording, read_part
from pipelines.recording.recorded_messages import (
    SPACE_PACKET,
    RecordedFrames,
    RecordedPacket,
    unpack,
)
from telepresence.link.frame import COUNT_MODULUS
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.head import is_packet
from telepresence.tmtc.pus.node import K2ACI_SERVICE
from telepresence.tmtc.pus.packets import ns_from_cuc, parse_packet
from telepresence.tmtc.pus.user import EventReport, HousekeepingReport, ParameterReport, PusUser

#: Of telemetry that is compared.
SECONDS = repeats(5)
STAGES = ("Acknowledge_Sent", "Verifier_Accepted", "Verifier_Started", "CommandComplete")
MS = 1_000_000
#: Frames that the ground's gateway handles.
WAYS = {"uplink": "sent", "downlink": "received"}


def iso(unix_ms):
    instant = datetime.fromtimestamp(unix_ms / 1000, UTC)
    return instant.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def recorded(path, begin_ms, end_ms):
    """The ground's telemetry of these instants: packets, and values by application and name."""
    recording = JoinedRecording(parts=[read_part(memoryview(path.read_bytes()))])
    packets, values = [], defaultdict(list)
    applications = built_in_dictionary().applications
    # Their events are of a session's own processes, and come where one is too busy.
    supervisors = [one.apid for one in applications if one.name.endswith("supervisor")]
    user = PusUser(built_in_dictionary(), source=1, first_count=0)
    for message in recording.messages():
        if message.schema != SPACE_PACKET.full_name:
            continue
        if not message.topic.startswith("/telemetry/ground/"):
            continue
        octets = bytes(unpack(RecordedPacket, message.data).data)
        packet = parse_packet(octets) if is_packet(octets) else None
        if packet is None or not begin_ms * MS <= ns_from_cuc(packet.cuc) < end_ms * MS:
            continue
        packets.append(octets)
        own = packet.service == 5 and packet.apid in supervisors
        if packet.service == K2ACI_SERVICE or own:
            continue
        user.handle_telemetry(packet, 0)
        while (event := user.next_event()) is not None:
            if isinstance(event, HousekeepingReport | EventReport | ParameterReport):
                for name, value in event.values.items():
                    values[f"{event.application}_{name}"].append((event.unix_ns, value))
    assert not user.garbage
    return packets, values


def compare_frames(yamcs, path):
    """YAMCS has as many frames of each virtual channel as the recording, in the same span.

    What a busy machine loses on the way by UDP, it has not; then the rest fits.
    """
    recording = JoinedRecording(parts=[read_part(memoryview(path.read_bytes()))])
    recorded = {f"/link/{way}/frames/{what}": [] for way, what in WAYS.items()}
    for message in recording.messages():
        if message.topic in recorded:
            batch = unpack(RecordedFrames, message.data)
            recorded[message.topic] += [
                (int.from_bytes(one[:2], "big") & 0x3F, int.from_bytes(one[2:5], "big"))
                for one in map(bytes, batch.data)
            ]
    for way, what in WAYS.items():
        count = yamcs.selected(f"select count(*) from {way}_kept")
        first, last = (
            yamcs.selected(f"select frameSeq from {way}_kept order {order} limit 1")
            for order in ("asc", "desc")
        )
        span = (last - first) % COUNT_MODULUS
        here = Counter(
            vcid
            for vcid, number in recorded[f"/link/{way}/frames/{what}"]
            if (number - first) % COUNT_MODULUS <= span
        )
        assert here.total() >= count > 0
        lost = here.total() - count
        for vcid in here:
            told = yamcs.selected(f"select count(*) from {way}_kept where vcid = {vcid}")
            assert here[vcid] - lost <= told <= here[vcid], (way, vcid)
        print(f"{way}: {lost} lost of {dict(sorted(here.items()))} by virtual channel")


def equal(one, other):
    if isinstance(one, float) and isinstance(other, float):
        return (isnan(one) and isnan(other)) or one == pytest.approx(other, rel=1e-6, abs=1e-9)
    return one == other


TELECOMMANDS = {
    "joystick_halt": {},
    "joystick_resume": {},
    "camera_select": {"camera": "static"},
    "tasks_select": {"task": 0},
    "robot_get": {"which": "x"},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A recorded session whose telemetry YAMCS has, and its second life, which is up."""
    top = tmp_path_factory.mktemp("yamcs")
    port, http = (tcp_port() for _ in range(2))
    path, ground, frames = top / "run.mcap", top / "ground", f"udp:127.0.0.1:{free_pair()}"
    options = ("--setup", "taskboard", "--packets", f"tcp:{port}", "--http-port", http)
    new_instance(ground, *options, "--frames", frames)
    with RunningSession(
        *("taskboard", "--packets", f"tcp:{port}", "--packets-allow", "joystick", "--tasks"),
        *("--record", str(path), "--link-frames", "--frames", frames),
        *("--packets-allow", "camera.select", "--packets-allow", "tasks"),
        directory=top,
    ) as session:
        session.wait_for_flow()
        with Yamcs(ground, http) as yamcs:
            eventually(yamcs.is_linked, "YAMCS' connection")
            for way in WAYS:
                yamcs.keep_frames(way)
            begin_ms = time.time_ns() // MS
            first = yamcs.do("joystick_calibrate")
            told = {name: yamcs.do(name, **arguments) for name, arguments in TELECOMMANDS.items()}
            told["no task"] = yamcs.do("tasks_select", task=200)
            told["not allowed"] = yamcs.do("robot_power_off")
            until_ms = max(begin_ms + 1000 * (SECONDS + 1), time.time_ns() // MS + 2000)
            eventually(lambda: time.time_ns() // MS > until_ms, "telemetry")
            links = yamcs.links()
            now_ms, where = time.time_ns() // MS, "archive/kontur_av/packets"
            eventually(lambda: yamcs.all(where, "packet", start=iso(now_ms)), "a later packet")
            # What was sent a second before has come.
            end_ms = now_ms - 1000
        with Yamcs(ground, http) as yamcs:
            # Its counts begin anew, so that this is the very telecommand of its last start.
            eventually(yamcs.is_linked, "the connection of the restarted YAMCS")
            again = yamcs.do("joystick_calibrate")
            report = session.finish()
            packets, values = recorded(path, begin_ms, end_ms)
            window = {"start": iso(begin_ms), "stop": iso(end_ms), "order": "asc"}
            yield SimpleNamespace(**locals())


def test_telecommands_are_verified_or_refused_where_they_belong(run):
    for name in TELECOMMANDS:
        told = run.told[name]
        message = told.get("CommandComplete_Message")
        assert [told[f"{stage}_Status"] for stage in STAGES] == ["OK"] * 4, (name, message)
    # The joystick is in use, and says so in its report; also to the next start of YAMCS.
    for told in (run.first, run.again):
        assert told["Verifier_Accepted_Status"] == "OK"
        assert "not in the state application" in told["CommandComplete_Message"]
    # Refused where it is carried out, and because --packets-allow does not name it.
    told = run.told["no task"]
    assert told["CommandComplete_Status"] == "NOK"
    assert "no task 200" in told["CommandComplete_Message"]
    told = run.told["not allowed"]
    assert told["Verifier_Accepted_Status"] == told["CommandComplete_Status"] == "NOK"
    assert "--packets-allow" in told["Verifier_Accepted_Message"]


def test_the_archive_has_the_packets_of_the_recording(run):
    rows = run.yamcs.all("archive/kontur_av/packets", "packet", **run.window, limit=1000)
    got = [base64.b64decode(row["packet"]) for row in rows]
    refusals = [one for one in got if one[7:9] == bytes([1, 2])]
    assert sorted(run.packets) == sorted(set(got) - set(refusals))
    assert run.packets and len(refusals) == 1


def test_the_archive_replays_every_value_at_its_instant(run):
    compared = 0
    for application in built_in_dictionary().applications:
        for parameter in application.parameters:
            name = f"{application.name}_{parameter.name}"
            where = f"archive/kontur_av/parameters/kontur_av/{name}"
            replayed = run.yamcs.all(where, "parameter", **run.window, source="replay", limit=1000)
            told = sorted(run.values[name], key=lambda one: one[0])
            assert len(replayed) == len(told), name
            for row, (unix_ns, one) in zip(replayed, told, strict=True):
                assert abs(milliseconds(row["generationTime"]) - unix_ns / MS) < 2, name
                assert equal(value_of(row["engValue"]), one), (name, row, one)
            compared += len(told)
    assert compared > 0


def test_it_has_the_frames_of_each_virtual_channel(run):
    assert {run.links[way]["extra"]["Invalid frames"] for way in WAYS} == {"0"}
    compare_frames(run.yamcs, run.path)


def test_the_report_counts_what_went_out_and_came_in(run):
    assert_sound(run.report)
    counts = run.report["processes"]["packets"]["counts"]
    assert counts["outside_commands"] == 8
    assert counts["outside_refused"] == 1
    assert counts["outside_packets"] >= len(run.packets)
    for name in ("dropped", "excess", "garbage"):
        assert counts[f"outside_{name}"] == 0
    # Repetitions across the radio alone were known.
    told = Counter()
    for process in run.report["processes"].values():
        told.update(process["counts"])
    assert told["pus_duplicates"] <= told["pus_telecommands_repeated"]
    assert run.report["processes"]["frames"]["counts"]["copies_unsent"] == 0
