"""A session as a node of a ROS 2 system, beside nodes of `zenoh-ros2-sdk`."""

import os
import signal
import time
from dataclasses import replace

import av
import cv2
import numpy as np
import pytest
from janus_room import free_port
from mcap.records import Metadata
from ros2_peer import Ros2Peer, hash_of
from running_session import assert_sound, eventually

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.codecs.h26x import H264Decoder
from pipelines.hand.hand_topics import unpack_status
from pipelines.hand.haptic_trace import DEAD_MAN
from pipelines.mission.tmtc_messages import SendK2aci
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.recording.facts import FACTS, RecordingFacts
from pipelines.recording.messages import RecordedPicture, UnitFacts, unpack, unpack_haptics
from pipelines.recording.scan import FoundMessage, Scan
from pipelines.ros2.publications import publications_of, sources_of
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.setup_text import setup_toml
from pipelines.session.topic_ends import unpack_state
from pipelines.session.topology import JOYSTICK_STATE_TOPIC, ROBOT_TOPIC
from pipelines.table import topology_of
from telepresence.haptics.device.page import FACTS as HANDLE
from telepresence.haptics.device.states import JoystickState

pytestmark = pytest.mark.realtime

pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is not installed")


def topics_of(setup):
    """What a session publishes: types by topic."""
    return {one.topic: one.type for one in publications_of(sources_of(topology_of(setup)))}


def wall_ns(stamp):
    return stamp["sec"] * NS_PER_S + stamp["nanosec"]


def lost(numbers):
    """How many messages of one publisher did not come, by the numbers of those that came."""
    counted = [number for number, _, _ in numbers]
    assert counted == sorted(set(counted)) and len({gid for _, _, gid in numbers}) == 1
    return counted[-1] - counted[0] + 1 - len(counted)


class Recorded:
    """A recording: octets by channel and wall time."""

    def __init__(self, path):
        self.channels, self.facts = {}, None
        for item in Scan(memoryview(path.read_bytes())).items():
            if isinstance(item, FoundMessage):
                channel = self.channels.setdefault(item.channel.topic, {})
                channel.setdefault(item.message.log_time, item.message.data)
            elif isinstance(item, Metadata) and item.name == FACTS:
                self.facts = RecordingFacts.of(item.metadata)

    def units(self, channel):
        """The access units of a channel by wall time, without key pictures that it added."""
        facts, found = self.channels[f"{channel}/facts"], {}
        for at_ns, octets in self.channels[channel].items():
            told = unpack(UnitFacts, facts[at_ns])
            if not told.added:
                found[at_ns] = unpack(RecordedPicture, octets).data[-told.octets :]
        return found

    def blocks(self, channel):
        """Cycles of the hand by the wall time of the last one in each block."""
        offset_ns = self.facts.wall_ns - self.facts.session_ns
        rows = map(unpack_haptics, self.channels[channel].values())
        return {int(block["time_ns"][-1]) + offset_ns: block for block in rows}


def counted(found, came, numbers, missed):
    """Every message of the time is there, or was counted as lost."""
    within = [at_ns for at_ns in found if came[0] <= at_ns <= came[-1]]
    assert len(within) == len(came) + lost(numbers) + missed


def test_a_node_of_others_hears_what_is_recorded(start, tmp_path, monkeypatch):
    port, path = free_port(), tmp_path / "run.mcap"
    # With each picture recorded, whichever of them the node chooses is in the file.
    setup = tmp_path / "whole.toml"
    setup.write_text(setup_toml(replace(load_setup("taskboard"), recorded_cameras="all")))
    session = start(str(setup), "--ros2", str(port), "--record", str(path))
    topics = topics_of(session.setup)
    setup_topic = next(topic for topic in topics if topic.endswith("/setup"))
    late = "/kontur_av/uplink_video/received"
    early = {key: topics[key] for key in topics if key not in (setup_topic, late)}
    peer = Ros2Peer(port, early, tmp_path)
    session.wait_for_flow()
    peer.say("late", late, topics[late])
    for topic in ("/kontur_av/camera/static/compressed", late):
        eventually(lambda topic=topic: peer.heard(topic) > 40, f"messages of {topic}")
    said = SendK2aci("test", 1, "Chat", {"sender": "cosmonaut", "text": "Здесь хорошо"})
    with session.bus(monkeypatch):
        assert send_to_tmtc(session.session, Segment.SPACE, said)
    peer.say("latched", setup_topic)
    eventually(lambda: peer.heard(setup_topic), "the latched setup")
    eventually(lambda: peer.heard("/diagnostics") > 1, "diagnostics")
    eventually(lambda: peer.heard("/kontur_av/chat"), "the chat")
    code, report = session.interrupt()
    heard = peer.end()
    assert code == 0, (session.errors(), report["failures"])
    assert_sound(report)
    messages, numbers = heard["messages"], heard["numbers"]
    counts, recorded = report["processes"]["ros2"]["counts"], Recorded(path)

    def missed(topic):
        return counts.get(f"missed_{topic}", 0)

    # Names, types, hashes: all topics are in the graph of the other side.
    ours = [token.split("/") for token in heard["tokens"] if "%kontur_av/session" in token]
    graph = {one[9].replace("%", "/"): one[10:] for one in ours if one[5] == "MP"}
    assert {topic: told[1] for topic, told in graph.items()} == {
        topic: hash_of(kind) for topic, kind in topics.items()
    }

    for way, topic in (("sent", "sent/uplink_video"), ("received", "coded/uplink_video")):
        name, units = f"/kontur_av/uplink_video/{way}", recorded.units(f"/uplink_video/{way}")
        came = {wall_ns(one["timestamp"]): one for one in messages[name]}
        assert len(came) == len(messages[name]) > 40
        own = [at_ns for at_ns in came if at_ns in units]
        for at_ns in own:
            assert came[at_ns]["data"].endswith(units[at_ns]) and came[at_ns]["format"] == "h264"
        counted(units, own, numbers[name], missed(topic))
        # Whoever comes late gets a key picture, from which on everything can be decoded.
        added = [at_ns for at_ns in came if at_ns not in units]
        assert all(at_ns + 1000 in own for at_ns in added) and 0 < len(added) <= 4
        decoder, since = H264Decoder(), list(came).index(added[0])
        for at_ns in list(came)[since:]:
            assert len(list(decoder.decode(came[at_ns]["data"], 0))) == 1
        assert len(came) - since > 30

    for end, channel, topic in (
        ("tip", "/haptic/up/sent", "haptic/robot"),
        ("handle", "/haptic/down/sent", "haptic/joystick"),
    ):
        blocks = recorded.blocks(channel)
        for kind in ("pose", "twist", "wrench"):
            came = messages[f"/kontur_av/{end}/{kind}"]
            stamps = [wall_ns(one["header"]["stamp"]) for one in came]
            counted(blocks, stamps, numbers[f"/kontur_av/{end}/{kind}"], missed(topic))
            for at_ns, one in zip(stamps, came, strict=True):
                row, first = blocks[at_ns][-1], blocks[at_ns][0]
                if kind == "pose":
                    told, value = one["pose"]["position"], (row["x_m"], row["y_m"])
                elif kind == "wrench":
                    told, value = one["wrench"]["force"], (row["fx_n"], row["fy_n"])
                else:
                    seconds = (row["time_ns"] - first["time_ns"]) / NS_PER_S
                    moved = (float(row[key]) - float(first[key]) for key in ("x_m", "y_m"))
                    told, value = one["twist"]["linear"], [each / seconds for each in moved]
                assert (told["x"], told["y"]) == pytest.approx(tuple(map(float, value)))
    blocks, halves = recorded.blocks("/haptic/down/sent"), []
    for one in messages["/kontur_av/handle/joy"]:
        row, (left, up) = blocks[wall_ns(one["header"]["stamp"])][-1], one["axes"]
        if min(abs(left), abs(up)) > 0.01:
            halves.append((-row["x_m"] / left, row["y_m"] / up))
        assert one["buttons"] == [0, 0, 0, 0, int(bool(row["flags"] & DEAD_MAN))]
    # Shares of the workspace that the calibration has found.
    assert len(halves) > 10 and np.allclose(halves, halves[0], rtol=1e-3)
    assert halves[0] == pytest.approx((HANDLE.half_width_m, HANDLE.half_height_m), rel=0.03)

    # The picture of the static camera is as its recorded one.
    pictures = recorded.channels["/camera/static"]
    stamps = sorted(pictures)
    decoder, decoded = av.CodecContext.create("h264", "r"), {}
    for at_ns in stamps:
        for picture in decoder.decode(av.Packet(unpack(RecordedPicture, pictures[at_ns]).data)):
            decoded[at_ns] = picture.to_ndarray(format="bgr24")
    images = messages["/kontur_av/camera/static/compressed"]
    same = 0
    for one in images:
        at_ns = wall_ns(one["header"]["stamp"])
        image = cv2.imdecode(np.frombuffer(one["data"], np.uint8), cv2.IMREAD_COLOR)
        if at_ns in decoded:
            same += 1
            assert cv2.PSNR(image, decoded[at_ns]) > 25
    assert same > 0.9 * len(images) > 36

    assert [one["data"] for one in messages["/kontur_av/chat"]] == ["cosmonaut: Здесь хорошо"]
    assert [one["data"] for one in messages[setup_topic]] == [recorded.facts.setup_toml]
    status = messages["/diagnostics"][-1]["status"]
    assert (status[0]["level"], status[0]["message"]) == (0, "well")
    told = {
        each["key"]: each["value"]
        for one in status
        for each in one["values"]
        if one["name"] == "kontur_av: streams uplink_video"
    }
    assert 0 < int(told["frames_sent"]) <= report["streams"]["uplink_video"]["frames_sent"]


class Robot:
    """What moves, by the topics of the session."""

    def __init__(self, bus):
        self.clock = MonotonicClock()
        self.readers = {topic: bus.reader(topic) for topic in (ROBOT_TOPIC, JOYSTICK_STATE_TOPIC)}

    def newest(self, topic):
        return eventually(lambda: self.readers[topic].latest_octets(), f"a sample of {topic}")

    def in_application(self):
        status = unpack_status(self.newest(JOYSTICK_STATE_TOPIC))
        return status.state == JoystickState.APPLICATION

    def held(self):
        return unpack_status(self.newest(JOYSTICK_STATE_TOPIC)).dead_man

    def place(self):
        state = unpack_state(self.newest(ROBOT_TOPIC))
        return state.x_m, state.y_m

    def rests(self):
        """Its place, after it has come to rest and not moved for half a second."""
        eventually(lambda: not self.held(), "the release")

        def still():
            before = self.place()
            time.sleep(0.1)
            return self.place() == pytest.approx(before, abs=1e-5)

        eventually(still, "the rest")
        before = self.place()
        time.sleep(0.5)
        assert self.place() == pytest.approx(before, abs=5e-5)
        return before


def test_a_node_of_others_moves_the_robot_under_its_dead_man_button(start, tmp_path, monkeypatch):
    port = free_port()
    session = start("taskboard", "--ros2", str(port), "--joystick", "ros2")
    pids = session.pids()
    peer = Ros2Peer(port, {}, tmp_path)
    with session.bus(monkeypatch) as bus:
        robot = Robot(bus)
        eventually(robot.in_application, "the application")
        # Held from the beginning: no press.
        peer.say("joy", 0.9, 0.0, True)
        assert robot.rests() == pytest.approx((0.0, 0.0), abs=0.01)
        peer.say("joy", 0.0, 0.0, False)
        time.sleep(0.5)
        peer.say("joy", 0.0, 0.0, True)
        eventually(robot.held, "the press")
        # To the left.
        peer.say("joy", 0.5, 0.0, True)
        eventually(lambda: robot.place()[0] < -0.03, "the motion")
        # The node is silent; then it is there again, with the button held.
        peer.say("quiet")
        rest = robot.rests()
        peer.say("joy", -0.5, 0.0, True)
        assert robot.rests() == pytest.approx(rest, abs=1e-4)
        peer.say("joy", 0.5, 0.0, False)
        time.sleep(0.5)
        # A velocity without the button moves nothing.
        peer.say("twist", 0.02)
        assert robot.rests() == pytest.approx(rest, abs=1e-4)
        peer.say("joy", 0.5, 0.0, True)
        eventually(lambda: robot.place()[0] > rest[0] + 0.02, "the motion by velocity")
        # Its process dies in the motion, and comes again: the button is still held.
        os.kill(pids["ros2"], signal.SIGKILL)
        rest = robot.rests()
        assert robot.rests() == pytest.approx(rest, abs=1e-4)
        peer.say("quiet")
    code, report = session.interrupt()
    peer.end()
    assert code == 0, (session.errors(), report["failures"])
    assert report["joystick"]["device"] == "ROS 2 node"
    told = report["processes"]["ros2"]
    assert told["restarts"] == 1 and told["counts"]["taken"] > 100
