"""A live session and its twin over the same radio: one verdict, the same events, similar counts.

No instant is compared. A stall of the machine may add events, but takes none away.
"""

import json
import operator

import pytest
from running_session import RunningSession

from pipelines.cli import main

LOSSES = "delay_ms = 10.0\nframe_loss = 0.01\n"
#: By name: the setup, which has no more streams than are compared; what the radio file says, or
#: options; and seconds.
SCENES = {
    "losses": ("spacejustin", LOSSES, 7),
    "end of a pass": ("taskboard", ("--radio", "iss-pass", "--radio-start", "584"), 14),
}
#: A lateness of more is a stall of the machine.
STALL_MS = 20


def events(report):
    """What happened, in order, without instants."""
    gateways = report["gateways"].items()
    safety, joystick = report["safety"], report["joystick"]
    return {
        "failures": report["failures"],
        "contacts": [name for name, each in gateways for _ in each["supervision"]["contacts"]],
        "links": [each["supervision"]["state"] for _, each in gateways],
        "joystick": [(each["event"], each["state"]) for each in joystick["log"]],
        "hold": [safety["hold"]],
        "stops": ["stop"] * safety["stops"],
        "robot": [each["what"] for each in safety["events"]],
    }


def in_order(longer, shorter):
    """All of `shorter` is in `longer`, in its order."""
    rest = iter(longer)
    return all(each in rest for each in shorter)


def shares(report, scene):
    """Shares that no machine changes much, and by how much they may differ."""
    found = {}
    for name, link in report["link"].items():
        found[f"{name} frames lost"] = link["frames_lost"] / link["frames"], 0.03
    for name, stream in report["streams"].items():
        # What comes after a loss of signal may count as a gap or as a new beginning.
        if "pass" not in scene:
            found[f"{name} packets lost"] = stream["rtp_lost"] / stream["rtp_packets_sent"], 0.1
            if name.endswith("video"):
                damaged = stream["frames_damaged"] / stream["frames_sent"]
                found[f"{name} damaged"] = damaged, 0.3
    for name, haptic in report["haptic"].items():
        found[f"haptic {name} lost"] = haptic["lost"] / haptic["sent"], 0.05
    return found


def stalled(report):
    """A loop of 1 kHz began a cycle far too late."""
    loops = (*report["link"].values(), *report["haptic"].values())
    return any(each["lateness_us"]["max"] > 1000 * STALL_MS for each in loops)


@pytest.mark.parametrize("scene", SCENES)
def test_a_live_session_and_its_twin_come_to_the_same(tmp_path, scene):
    setup, radio, seconds = SCENES[scene]
    if isinstance(radio, str):
        (tmp_path / "radio.toml").write_text(radio)
        radio = ("--radio", str(tmp_path / "radio.toml"))
    path, words = tmp_path / "twin.json", [*radio, "--seconds", str(seconds), "--seed", "1"]
    options = ["--setup", setup, "--joystick", "sim", "--report", str(path), "-q"]
    code = main(["simulate", *options, *words])
    twin = json.loads(path.read_text())
    with RunningSession(setup, *words, directory=tmp_path) as session:
        live_code, live = session.end()
    assert live_code == code, live["failures"]
    compare = in_order if stalled(live) else operator.eq
    live_events, twin_events = events(live), events(twin)
    if stalled(live):
        # No events, but states at the end: a stall shortly before holds the robot, loses the link.
        del twin_events["hold"], twin_events["links"]
    differing = [what for what in twin_events if not compare(live_events[what], twin_events[what])]
    assert not differing, (live_events, twin_events)
    expected = shares(twin, scene)
    for name, (share, bound) in shares(live, scene).items():
        assert share == pytest.approx(expected[name][0], abs=bound), name
