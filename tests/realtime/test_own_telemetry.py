"""A user's component in a whole session, by the command that the documents give."""

import os
import signal
from pathlib import Path

from running_session import BOARD, eventually

from pipelines.mission.tmtc_messages import TMTC_TOPICS, CommandUpdate, Reported
from pipelines.recording.recorded_messages import RecordedEvent, unpack
from pipelines.recording.scan import FoundMessage, Scan
from pipelines.session.setup.segments import Segment

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "own_telemetry.py"


def process_of(session):
    """The pid of the component; names of processes are cut to 15 characters."""
    names = {Path(f"/proc/{pid}/comm").read_text().strip(): pid for pid in session.children()}
    return names["kav telemetry_b"]


def events_in(path):
    """The events that a recording has so far."""
    return [
        unpack(RecordedEvent, item.message.data).text
        for item in Scan(memoryview(path.read_bytes())).items()
        if isinstance(item, FoundMessage) and item.channel.topic == "/events"
    ]


def test_the_samples_battery_is_told_called_and_heard_and_lives_on(start, tmp_path, monkeypatch):
    # Begun nearer to its limit, so that the test waits less.
    full = SAMPLE.read_text()
    battery = full.replace("voltage_v = 12.0", "voltage_v = 11.3")
    assert battery != full
    (tmp_path / SAMPLE.name).write_text(battery)
    path = tmp_path / "run.mcap"
    routes = tmp_path / "routes.xml"
    routes.write_text('<Routes><Route from="battery" data="voltage" to="ground"/></Routes>')
    component = ("--telemetry", "own_telemetry:Battery", "--routes", str(routes))
    session = start(BOARD, *component, "--record", str(path))

    def voltage():
        return (
            "battery parameters: voltage 1" in session.ask("tc", "battery", "get", "voltage").stdout
        )

    eventually(voltage, "a value")
    assert "voltage 1" in session.ask("tc", "battery", "report", "route_1").stdout
    called = session.ask("tc", "battery", "recharge", "13")
    assert called.returncode == 0
    stages = [line.split()[1] for line in called.stdout.splitlines()]
    assert stages == ["taken", "accepted", "started", "completed"]
    refused = session.ask("tc", "battery", "recharge", "14")
    assert refused.returncode == 1
    assert "target is 14: give at least 12 and at most 13" in refused.stderr
    with session.bus(monkeypatch) as bus:
        reader = bus.reader(TMTC_TOPICS[Segment.GROUND], depth=32)
        os.kill(process_of(session), signal.SIGKILL)
        # Its next start sinks to its limit, which is an event, and recharges itself after it.
        heard = []

        def recharged():
            while (lease := reader.next()) is not None:
                with lease:
                    heard.append(TMTC_TOPICS[Segment.GROUND].unpack(lease.octets()))
            # A stalled reader loses news, and hears them when it sinks again.
            return any(isinstance(one, Reported) and one.name == "low" for one in heard) and any(
                isinstance(one, CommandUpdate) and one.client.startswith("battery ") and one.ok
                for one in heard
            )

        eventually(recharged, "the event and the action")
    report = session.finish()
    battery = report["telemetry"]["battery"]
    assert report["processes"]["telemetry_battery"]["restarts"] == 1
    assert (battery["faults"], battery["actions_failed"]) == (0, 0)
    low = battery["events"][0]["what"]
    assert low.startswith("low: voltage 10.")
    assert f"battery: {low}" in events_in(path)
