"""Telecommands and telemetry of a whole session on virtual time."""

import json

from tmtc_session import Session

from pipelines.mission.tmtc import PUS_RATE_BPS
from pipelines.mission.tmtc_messages import CommandUpdate, K2aciArrived, K2aciUpdate, Reported
from pipelines.seats.mission_client import MissionClient
from pipelines.seats.texts import CommandRequest
from pipelines.session.access import Role
from pipelines.session.setup.segments import Segment
from telepresence.link.radio import Blackout, RadioProfile
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary


def dead(direction, seconds=60.0, start_s=2.0):
    """A radio that loses everything in one direction, or in both, from second 2 on."""
    blackout = Blackout(start_s=start_s, seconds=seconds, direction=direction)
    return RadioProfile(name="half", blackouts=(blackout,))


def test_telecommands_and_chat_go_both_ways_and_are_verified():
    session = Session()
    session.run(1)
    session.command(Segment.GROUND, 1, "joystick", "call", "halt")
    session.command(Segment.SPACE, 1, "robot", "call", "power_off")
    session.command(Segment.SPACE, 2, "joystick", "call", "halt")
    session.command(Segment.GROUND, 2, "joystick", "call", "jump")
    session.say(Segment.SPACE, 3, "ready")
    session.run(3)
    assert session.asked == [
        ("joystick", "halt"),
        ("robot", "power_off"),
        ("joystick", "halt"),
    ]
    done = [one for one in session.of(Segment.GROUND, CommandUpdate) if one.done]
    assert [(one.id, one.ok, one.stage) for one in done] == [
        (2, False, "refused"),
        (1, True, "completed"),
    ]
    assert "no function 'jump'" in done[0].reason
    done = [one for one in session.of(Segment.SPACE, CommandUpdate) if one.done]
    assert sorted((one.id, one.ok) for one in done) == [(1, True), (2, True)]
    (chat,) = session.of(Segment.GROUND, K2aciArrived)
    assert chat.fields == {"sender": "cosmonaut", "text": "ready"}
    assert [one.state for one in session.of(Segment.SPACE, K2aciUpdate)] == ["waiting", "delivered"]
    # A request that is repeated is carried out once.
    session.command(Segment.GROUND, 1, "joystick", "call", "halt")
    session.say(Segment.SPACE, 3, "ready")
    session.run(1)
    assert len(session.asked) == 3 and len(session.of(Segment.GROUND, K2aciArrived)) == 1


def test_housekeeping_of_all_applications_reaches_the_other_end():
    session = Session()
    session.run(2)
    # Those that went out before there was a signal come again at once.
    assert ("robot", "state") in {
        (one.application, one.name) for one in session.of(Segment.SPACE, Reported)
    }
    session.run(9)
    heard = {(one.application, one.name) for one in session.of(Segment.GROUND, Reported)}
    assert heard >= {("joystick", "state"), ("space_gateway", "link"), ("robot", "state")}
    heard = {(one.application, one.name) for one in session.of(Segment.SPACE, Reported)}
    assert heard >= {("ground_gateway", "link"), ("robot", "state")}
    (*_, link) = [
        one for one in session.of(Segment.SPACE, Reported) if one.application == "ground_gateway"
    ]
    assert (link.values["state"], link.values["signal"]) == ("connected", True)


def test_a_page_says_that_a_telecommand_is_unacknowledged_until_the_direction_is_back():
    session = Session(radio=dead("downlink", seconds=10.0))
    ground = Segment.GROUND
    service = MissionClient(ground, built_in_dictionary(), client="page.1")

    def heard(news, now_ns):
        service.handle_news(news, now_ns)
        if isinstance(news, Reported) and news.application == "ground_gateway":
            service.handle_signal(news.name != "signal_lost")

    def told():
        """The telecommand's line, and what the page says of the radio."""
        service.poll_texts()
        (line,) = json.loads(service.texts["commands"])["commands"]
        return line, json.loads(service.texts["radio"])["words"]

    session.tmtc.subscribe(ground, heard)
    session.run(5)
    asked = CommandRequest(request=7, application="joystick", name="halt")
    assert service.handle_command(3, Role.SUPERVISOR, asked, session.now_ns) is None
    session.tmtc.handle_request(ground, service.poll_transmit(session.now_ns), session.now_ns)
    session.run(4)
    # Carried out, which nobody on the ground knows.
    assert session.asked == [("joystick", "halt")]
    line, radio = told()
    assert (line["stage"], line.get("done", False)) == ("unacknowledged", False)
    assert line["tries"] > 2
    assert "Nothing arrives from space: telecommands go out unacknowledged." in radio
    assert service.next_event() is None
    session.run(5)
    assert session.asked == [("joystick", "halt")]
    line, radio = told()
    assert (line["stage"], line["ok"], line["verified"]) == ("completed", True, True)
    assert radio == "Both directions carry."
    assert service.next_event()[:3] == (3, 7, "")
    assert session.tmtc.ends[Segment.SPACE].applications["joystick"].executed == 1


def test_the_worst_load_of_tmtc_takes_from_video_what_the_bucket_allows_and_nothing_from_haptics():
    """Chat floods and housekeeping asked for ten times a second, both ways, from second 2 to 6."""
    session = Session(media=True)
    session.run(2)
    for number in range(0, 160, 4):
        for segment, application, more in (
            (Segment.GROUND, "joystick", "handle"),
            (Segment.SPACE, "robot", "controller"),
        ):
            session.command(segment, number, application, "report", "state")
            session.command(segment, number + 1, application, "report", more)
            session.say(segment, number, "x" * 200)
        session.run(0.1)
    report = session.simulation.report()
    for way in ("up", "down"):
        assert report.haptic[way].latency_ms.max == 1.0
        assert report.haptic[way].receiver.lost == 0
    carried = report.link["uplink"].sender.octets["tmtc"]
    before, allowed = 200, 512 + 4 * PUS_RATE_BPS / 8
    assert 0.9 * allowed < carried < allowed + before
    video = report.streams["uplink_video"]
    assert video.rtp.rtp_lost == video.display.stale_episodes == video.display.frozen_episodes == 0
    # Whatever was sent is shown; the newest pictures are still on their way.
    assert video.sender.frames_sent - video.display.frames_displayed <= 2
