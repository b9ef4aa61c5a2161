"""YAMCS reads a session's telemetry and commands it; all it has is what the recording has."""

import base64
import os
import time
from collections import Counter, defaultdict
from datetime import UTC, datetime
from math import isnan

import pytest
from janus_room import free_port
from running_session import assert_sound, eventually, free_pair
from yamcs import Yamcs, milliseconds, new_instance, value_of

from pipelines.recording.joined import JoinedRecording, read_part
from pipelines.recording.messages import SPACE_PACKET, RecordedFrames, RecordedPacket, unpack
from telepresence.link.frame import COUNT_MODULUS
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.head import is_packet
from telepresence.tmtc.pus.node import K2ACI_SERVICE
from telepresence.tmtc.pus.packets import ns_from_cuc, parse_packet
from telepresence.tmtc.pus.user import EventReport, HousekeepingReport, ParameterReport, PusUser

pytestmark = pytest.mark.realtime

#: Of telemetry that is compared.
SECONDS = int(os.environ.get("KONTUR_YAMCS_SECONDS", "20"))
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
        if packet.service == K2ACI_SERVICE:
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
        assert here.total() >= count > 500 * SECONDS
        lost = here.total() - count
        for vcid in here:
            told = yamcs.selected(f"select count(*) from {way}_kept where vcid = {vcid}")
            assert here[vcid] - lost <= told <= here[vcid], (way, vcid)
        print(f"{way}: {lost} lost of {dict(sorted(here.items()))} by virtual channel")


def assert_calibration_is_refused(yamcs):
    """The joystick is in use, and says so in its report."""
    told = yamcs.do("joystick_calibrate")
    assert told["Verifier_Accepted_Status"] == "OK"
    assert "not in the state application" in told["CommandComplete_Message"]


def equal(one, other):
    if isinstance(one, float) and isinstance(other, float):
        return (isnan(one) and isnan(other)) or one == pytest.approx(other, rel=1e-6, abs=1e-9)
    return one == other


def test_yamcs_has_what_the_recording_has_and_its_telecommands_are_verified(start, tmp_path):
    port, http, path = free_port(), free_port(), tmp_path / "run.mcap"
    frames = f"udp:127.0.0.1:{free_pair()}"
    ground = tmp_path / "ground"
    options = ("--setup", "taskboard", "--packets", f"tcp:{port}", "--http-port", http)
    new_instance(ground, *options, "--frames", frames)
    session = start(
        "taskboard",
        *("--packets", f"tcp:{port}", "--packets-allow", "joystick", "--tasks"),
        *("--record", str(path), "--link-frames", "--frames", frames),
        *("--packets-allow", "camera.select", "--packets-allow", "tasks"),
    )
    session.wait_for_flow()
    with Yamcs(ground, http) as yamcs:
        eventually(yamcs.is_linked, "YAMCS' connection")
        for way in WAYS:
            yamcs.keep_frames(way)
        begin_ms = time.time_ns() // MS + 100
        time.sleep(0.2)
        assert_calibration_is_refused(yamcs)
        for name, arguments in (
            ("joystick_halt", {}),
            ("joystick_resume", {}),
            ("camera_select", {"camera": "static"}),
            ("tasks_select", {"task": 0}),
            ("robot_get", {"which": "x"}),
        ):
            told = yamcs.do(name, **arguments)
            message = told.get("CommandComplete_Message")
            assert [told[f"{stage}_Status"] for stage in STAGES] == ["OK"] * 4, (name, message)
        # Refused where it is carried out, and because --packets-allow does not name it.
        told = yamcs.do("tasks_select", task=200)
        assert told["CommandComplete_Status"] == "NOK"
        assert "no task 200" in told["CommandComplete_Message"]
        told = yamcs.do("robot_power_off")
        assert told["Verifier_Accepted_Status"] == told["CommandComplete_Status"] == "NOK"
        assert "--packets-allow" in told["Verifier_Accepted_Message"]
        time.sleep(max(0, SECONDS + begin_ms / 1000 - time.time()))
        end_ms = time.time_ns() // MS
        time.sleep(1)
        for way in WAYS:
            assert yamcs.links()[way]["extra"]["Invalid frames"] == "0"
    with Yamcs(ground, http) as yamcs:
        # Its counts begin anew, so that this is the very telecommand of its last life.
        eventually(yamcs.is_linked, "the connection of the restarted YAMCS")
        assert_calibration_is_refused(yamcs)
        code, report = session.interrupt()
        assert code == 0, (session.errors(), report["failures"])
        assert_sound(report)
        compare_frames(yamcs, path)
        packets, values = recorded(path, begin_ms, end_ms)
        window = {"start": iso(begin_ms), "stop": iso(end_ms), "order": "asc"}
        rows = yamcs.all("archive/kontur_av/packets", "packet", **window, limit=1000)
        got = [base64.b64decode(row["packet"]) for row in rows]
        refusals = [one for one in got if one[7:9] == bytes([1, 2])]
        assert sorted(packets) == sorted(set(got) - set(refusals))
        assert len(packets) > 2 * SECONDS
        assert len(refusals) == 1
        # The archive replays: every parameter has each value, at its instant.
        compared = 0
        for application in built_in_dictionary().applications:
            for parameter in application.parameters:
                name = f"{application.name}_{parameter.name}"
                replayed = yamcs.all(
                    f"archive/kontur_av/parameters/kontur_av/{name}",
                    "parameter",
                    **window,
                    source="replay",
                    limit=1000,
                )
                told = sorted(values[name], key=lambda one: one[0])
                assert len(replayed) == len(told), name
                for row, (unix_ns, one) in zip(replayed, told, strict=True):
                    assert abs(milliseconds(row["generationTime"]) - unix_ns / MS) < 2, name
                    assert equal(value_of(row["engValue"]), one), (name, row, one)
                compared += len(told)
        print(f"{len(packets)} packets and {compared} values are equal")
    counts = report["processes"]["packets"]["counts"]
    assert counts["outside_commands"] == 8
    assert counts["outside_refused"] == 1
    assert counts["outside_packets"] >= len(packets)
    for name in ("dropped", "excess", "garbage"):
        assert counts[f"outside_{name}"] == 0
    # Repetitions across the radio alone were known.
    told = Counter()
    for process in report["processes"].values():
        told.update(process["counts"])
    assert told["pus_duplicates"] <= told["pus_telecommands_repeated"]
    assert report["processes"]["frames"]["counts"]["copies_unsent"] == 0
