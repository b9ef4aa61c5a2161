"""space_packet_parser of LASP reads our telemetry by our XTCE, and knows nothing else of us."""

from math import tau
from pathlib import Path

import pytest
from battery import Mission
from pus_ends import MS, Ends, oven
from tmtc_session import Session
from xtce_decoder import decoded

from pipelines.mission.tmtc_messages import Reported
from pipelines.session.setup.segments import Segment
from telepresence.haptics.mediated.wall import Wall, WallMessage, pack_wall
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary
from telepresence.tmtc.pus.xtce import dictionary_xtce

pytestmark = pytest.mark.interop

validation = pytest.importorskip("space_packet_parser.xtce.validation")


def recorded() -> bytes:
    """Ten seconds of telemetry of the oven: housekeeping, events, verification of telecommands."""
    ends = Ends()
    ends.oven.handle_values({"temperature": 21.5, "door": "closed", "lit": True}, 0)
    ends.user.set_parameters("oven", {"target": 99.5}, now_ns=0)
    ends.run(2500 * MS)
    for _ in range(2):
        ends.oven.handle_values({"temperature": 230.0}, ends.now_ns)
    ends.refusal = "no heat today"
    ends.user.call("oven", "heat", [20.0], now_ns=ends.now_ns)
    ends.user.request_housekeeping("oven", "light", now_ns=ends.now_ns)
    ends.user.request_parameters("oven", ["target"], now_ns=ends.now_ns)
    ends.user.ping("oven", now_ns=ends.now_ns)
    ends.run(4500 * MS)
    return b"".join(ends.telemetry)


def test_it_reads_every_kind_of_report(tmp_path: Path) -> None:
    packets = decoded(oven(), recorded(), tmp_path)
    states = [
        packet for packet in packets if "oven_temperature" in packet and "STRUCTURE" in packet
    ]
    assert [(p["TIME"], p["oven_temperature"], p["oven_door"]) for p in states] == [
        # As soon as the values are known, then at the interval.
        (0, 21.5, "closed"),
        (1, 21.5, "closed"),
        (2, 21.5, "closed"),
        (3, 230.0, "closed"),
        (4, 230.0, "closed"),
    ]
    (event,) = [packet for packet in packets if "EVENT" in packet]
    assert (event["SUBTYPE"], event["EVENT"], event["oven_temperature"]) == (4, 1, 230.0)
    (failure,) = [packet for packet in packets if "REASON" in packet]
    assert (failure["REASON"], failure["FAILURE"]) == ("no heat today", 4)
    (light,) = [packet for packet in packets if "oven_lit" in packet]
    assert light["oven_lit"]
    subtypes = [packet["SUBTYPE"] for packet in packets if packet["SERVICE"] == 1]
    assert sorted(subtypes) == [1, 1, 1, 1, 1, 3, 3, 3, 3, 3, 7, 7, 7, 7, 8]
    assert {(p["SERVICE"], p["SUBTYPE"]) for p in packets} >= {(17, 2), (20, 2)}


def test_the_xtce_of_the_built_in_dictionary_is_valid(tmp_path: Path) -> None:
    """By the schema of the OMG, which comes with space_packet_parser."""
    document = tmp_path / "kontur.xml"
    document.write_text(dictionary_xtce(built_in_dictionary()), encoding="utf-8")
    result = validation.validate_xtce(document, level="all")
    assert result.valid, str(result)


def test_it_reads_the_telemetry_of_a_session(tmp_path: Path) -> None:
    """All that came down in 12 s: each packet, in order, with the values that were reported."""
    session = Session()
    session.run(1)
    session.command(Segment.GROUND, 1, "joystick", "call", "halt")
    session.command(Segment.GROUND, 2, "joystick", "ping")
    session.say(Segment.SPACE, 1, "ready")
    session.run(11)
    telemetry = [packet for packet in session.packets[Segment.GROUND] if not packet[0] & 0x10]
    packets = decoded(built_in_dictionary(), b"".join(telemetry), tmp_path)
    assert len(packets) == len(telemetry) >= 20
    reports = [one for one in session.of(Segment.GROUND, Reported) if one.application == "joystick"]
    told = [one.values for one in reports if one.name == "state"]
    read = [
        {name: one[f"joystick_{name}"] for name in told[0]}
        for one in packets
        if one["PKT_APID"] == 0x120 and one["SERVICE"] == 3
    ]
    assert len(read) == len(told) >= 11
    for one, other in zip(read, told, strict=True):
        assert one["state"] == other["state"] == "application"
        assert one["force_limit"] == pytest.approx(other["force_limit"])
        assert one["temperature"] == pytest.approx(other["temperature"])
    assert {(1, 1), (1, 3), (1, 7), (3, 25), (17, 2), (129, 1)} == {
        (one["SERVICE"], one["SUBTYPE"]) for one in packets
    }


def test_it_knows_every_packet_of_a_session_with_two_switches_of_the_camera(tmp_path: Path) -> None:
    """Telecommands and telemetry, in both directions, as the radio carried them."""
    session = Session("taskboard", answers=False)
    session.run(3)
    select = {"name": "select", "application": "camera", "verb": "call"}
    session.command(Segment.SPACE, 1, arguments=("static",), **select)
    session.run(3)
    session.command(Segment.SPACE, 2, arguments=("stereo",), **select)
    session.command(Segment.SPACE, 3, "camera", "parameters", arguments=("camera",))
    session.command(Segment.SPACE, 4, "robot", "ping")
    session.run(18)
    up, down = session.packets[Segment.SPACE], session.packets[Segment.GROUND]
    assert all(
        len(session.carried[segment]) == len(session.packets[segment]) for segment in Segment
    )
    packets = decoded(built_in_dictionary(), b"".join([*down, *up]), tmp_path)
    assert len(packets) == len(up) + len(down) >= 30
    commands = [one for one in packets if one["TYPE"] == 1]
    assert [one["camera_camera"] for one in commands if "FUNCTION" in one] == ["static", "stereo"]
    assert {(one["SERVICE"], one["SUBTYPE"]) for one in commands} == {(8, 1), (17, 1), (20, 1)}
    about = [(one["SERVICE"], one["SUBTYPE"]) for one in packets if one["PKT_APID"] == 0x133]
    assert [about.count((1, subtype)) for subtype in (1, 3, 7)] == [3, 3, 3]
    states = [
        one["camera_camera"] for one in packets if one["PKT_APID"] == 0x133 and one["SERVICE"] == 3
    ]
    assert states[-1] == "stereo"


def test_it_knows_the_packets_with_walls(tmp_path: Path) -> None:
    message = WallMessage(3035, Wall(tau / 8, 0.06, 1500.0))
    (wall,) = decoded(built_in_dictionary(), pack_wall(message, 7), tmp_path)
    assert [wall[f"WALL_{name}"] for name in ("ANGLE", "STAMP_MS", "DISTANCE", "STIFFNESS")] == [
        8192,
        3035,
        3000,
        1500,
    ]


def test_it_reads_the_reports_and_calls_of_a_users_component(tmp_path: Path) -> None:
    mission = Mission()
    mission.battery.values = {"voltage": 11.0, "limit": 20}
    mission.run(3)
    mission.ask("call", "use", "b")
    mission.ask("call", "recharge", 99.0)
    packets = [
        one
        for one in decoded(mission.dictionary, b"".join(mission.packets), tmp_path)
        if one["PKT_APID"] == mission.table.apid
    ]
    reports = [one for one in packets if "STRUCTURE" in one]
    assert {(one["battery_voltage"], one["battery_limit"]) for one in reports} == {(11.0, 20)}
    (low,) = [one for one in packets if "EVENT" in one]
    assert (low["SUBTYPE"], low["battery_voltage"]) == (3, 11.0)
    assert [one["battery_cell"] for one in packets if "battery_cell" in one] == ["b"]
    (failure,) = [one for one in packets if "REASON" in one]
    assert failure["REASON"] == "target is 99: give at least 11.1 and at most 14.4"
