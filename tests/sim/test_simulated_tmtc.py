"""Telecommands and telemetry of a whole session on virtual time."""

from tmtc_session import Session

from pipelines.mission.tmtc import PUS_RATE_BPS
from pipelines.mission.tmtc_messages import CommandUpdate, K2aciArrived, K2aciUpdate, Reported
from pipelines.session.setup.segments import Segment


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
