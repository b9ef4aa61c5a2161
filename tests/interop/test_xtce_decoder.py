"""space_packet_parser of LASP reads our telemetry by our XTCE, and knows nothing else of us."""

from pathlib import Path

import pytest
from battery import Mission
from tmtc_session import Session
from xtce_decoder import decoded

from pipelines.mission.tmtc_messages import Reported
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary

pytestmark = pytest.mark.interop


def test_it_reads_every_packet_of_a_session_in_both_directions(tmp_path: Path) -> None:
    """Telecommands and telemetry, as the radio carried them, with the values that were told."""
    session = Session("taskboard")
    session.run(3)
    select = {"name": "select", "application": "camera", "verb": "call"}
    session.command(Segment.SPACE, 1, arguments=("static",), **select)
    session.command(Segment.GROUND, 1, "joystick", "call", "halt")
    session.run(2)
    session.command(Segment.SPACE, 2, arguments=("stereo",), **select)
    session.command(Segment.SPACE, 3, "camera", "parameters", arguments=("camera",))
    session.command(Segment.SPACE, 4, "robot", "ping")
    session.say(Segment.SPACE, 5, "ready")
    session.run(11)
    up, down = session.packets[Segment.SPACE], session.packets[Segment.GROUND]
    assert all(len(session.carried[one]) == len(session.packets[one]) for one in Segment)
    packets = decoded(built_in_dictionary(), b"".join([*down, *up]), tmp_path)
    assert len(packets) == len(up) + len(down) >= 30
    commands = [packet for packet in packets if packet["TYPE"] == 1]
    selected = [command["camera_camera"] for command in commands if "camera_camera" in command]
    assert selected == ["static", "stereo"]
    kinds = {(packet["SERVICE"], packet["SUBTYPE"]) for packet in packets}
    assert {(1, 1), (1, 3), (1, 7), (3, 25), (8, 1), (17, 1), (17, 2), (20, 1), (129, 1)} <= kinds
    about = [(one["SERVICE"], one["SUBTYPE"]) for one in packets if one["PKT_APID"] == 0x133]
    assert [about.count((1, subtype)) for subtype in (1, 3, 7)] == [3, 3, 3]
    reports = [one for one in session.of(Segment.GROUND, Reported) if one.application == "joystick"]
    told = [report.values for report in reports if report.name == "state"]
    read = [
        {name: packet[f"joystick_{name}"] for name in told[0]}
        for packet in packets
        if packet["PKT_APID"] == 0x120 and "joystick_state" in packet and packet["SERVICE"] == 3
    ]
    assert len(read) == len(told) >= 11
    for one, other in zip(read, told, strict=True):
        assert one["state"] == other["state"]
        for name in ("force_limit", "temperature"):
            assert one[name] == pytest.approx(other[name])


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
    reports = [packet for packet in packets if "STRUCTURE" in packet]
    assert {(one["battery_voltage"], one["battery_limit"]) for one in reports} == {(11.0, 20)}
    (low,) = [packet for packet in packets if "EVENT" in packet]
    assert (low["SUBTYPE"], low["battery_voltage"]) == (3, 11.0)
    assert [packet["battery_cell"] for packet in packets if "battery_cell" in packet] == ["b"]
    (failure,) = [packet for packet in packets if "REASON" in packet]
    assert failure["REASON"] == "target is 99: give at least 11.1 and at most 14.4"
