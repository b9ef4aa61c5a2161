"""A session as a node of a ROS 2 system, beside nodes of `zenoh-ros2-sdk`."""

import os
import signal
import time
from dataclasses import replace
from itertools import count, pairwise

import av
import cv2
import numpy as np
import pytest
from mcap.records import Metadata
from ros2_peer import Ros2Peer, hash_of
from running_session import BOARD, RunningSession, assert_sound, eventually, tcp_port

from kontur_av.clock import NS_PER_S, MonotonicClock
from kontur_av.codecs.h26x import H264Decoder
from pipelines.hand.hand_topics import JOYSTICK_STATE_TOPIC
from pipelines.mission.tmtc_messages import SendK2aci
from pipelines.mission.tmtc_socket import send_to_tmtc
from pipelines.recording.metadata import METADATA, RecordingMetadata
from pipelines.recording.recorded_messages import (
    RecordedPicture,
    UnitMetadata,
    unpack,
    unpack_haptics,
)
from pipelines.recording.scan import FoundMessage, Scan
from pipelines.ros2.publications import publications_of, sources_of
from pipelines.session.mission_messages import ROBOT_TOPIC
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.setup_file import load_setup
from pipelines.session.setup.setup_text import setup_toml
from pipelines.table import topology_of
from telepresence.haptics.device.states import JoystickState

pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk: pip install zenoh-ros2-sdk")


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
        self.channels, self.capabilities = {}, None
        for item in Scan(memoryview(path.read_bytes())).items():
            if isinstance(item, FoundMessage):
                channel = self.channels.setdefault(item.channel.topic, {})
                channel.setdefault(item.message.log_time, item.message.data)
            elif isinstance(item, Metadata) and item.name == METADATA:
                self.capabilities = RecordingMetadata.of(item.metadata)

    def units(self, channel):
        """The access units of a channel by wall time, without key pictures that it added."""
        capabilities, found = self.channels[f"{channel}/facts"], {}
        for at_ns, octets in self.channels[channel].items():
            told = unpack(UnitMetadata, capabilities[at_ns])
            if not told.added:
                found[at_ns] = unpack(RecordedPicture, octets).data[-told.octets :]
        return found

    def blocks(self, channel):
        """Cycles of the hand by the wall time of the last one in each block."""
        offset_ns = self.capabilities.wall_ns - self.capabilities.session_ns
        rows = map(unpack_haptics, self.channels[channel].values())
        return {int(block["time_ns"][-1]) + offset_ns: block for block in rows}


def counted(found, came, numbers, missed):
    """Every message of the time is there, or was counted as lost."""
    within = [at_ns for at_ns in found if came[0] <= at_ns <= came[-1]]
    # Some may have been lost before the first and after the last.
    assert len(came) <= len(within) <= len(came) + lost(numbers) + missed


LATE = "/kontur_av/uplink_video/received"


class Run:
    """One recorded session beside a node of others. heard: all that came there."""

    def __init__(self, top):
        port, path = tcp_port(), top / "run.mcap"
        # With each picture recorded, whichever of them the node chooses is in the file.
        setup = setup_toml(replace(load_setup("taskboard"), recorded_cameras="all"))
        options = ("--ros2", str(port), "--record", str(path))
        with RunningSession(setup, *options, directory=top) as session:
            self.topics = topics_of(session.setup)
            self.setup_topic = next(one for one in self.topics if one.endswith("/setup"))
            own = {self.setup_topic, LATE}
            early = {key: kind for key, kind in self.topics.items() if key not in own}
            peer = Ros2Peer(port, early, top)
            session.wait_for_flow()
            peer.say("late", LATE, self.topics[LATE])
            said, numbers = {"sender": "cosmonaut", "text": "Здесь хорошо"}, count(1)
            peer.say("latched", self.setup_topic)
            with pytest.MonkeyPatch.context() as patch, session.bus(patch):

                def heard():
                    # A node that is not there yet hears nothing of a line that went.
                    # A request with the same number is a repetition.
                    line = SendK2aci("test", next(numbers), "Chat", said)
                    send_to_tmtc(session.session, Segment.SPACE, line)
                    time.sleep(1)
                    return peer.heard("/kontur_av/chat")

                eventually(heard, "the chat")
            for topic, more_than in (
                # More than two seconds, because then the second key picture comes.
                *((one, 90) for one in ("/kontur_av/camera/static/compressed", LATE)),
                *((self.setup_topic, 0), ("/diagnostics", 1)),
            ):
                eventually(lambda at=(topic, more_than): peer.heard(at[0]) > at[1], topic)
            self.report = session.finish()
            heard = peer.end()
        self.messages, self.numbers, self.tokens = (
            heard[key] for key in ("messages", "numbers", "tokens")
        )
        self.recorded = Recorded(path)

    def missed(self, topic):
        return self.report["processes"]["ros2"]["counts"].get(f"missed_{topic}", 0)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return Run(tmp_path_factory.mktemp("ros2"))


def test_the_graph_of_others_has_names_types_and_hashes_of_all_topics(run):
    assert_sound(run.report)
    ours = [token.split("/") for token in run.tokens if "%kontur_av/session" in token]
    graph = {one[9].replace("%", "/"): one[10:] for one in ours if one[5] == "MP"}
    assert {topic: told[1] for topic, told in graph.items()} == {
        topic: hash_of(kind) for topic, kind in run.topics.items()
    }


@pytest.mark.parametrize(
    ("way", "topic"), [("sent", "sent/uplink_video"), ("received", "coded/uplink_video")]
)
def test_a_node_hears_the_recorded_units_and_begins_with_a_key_picture(run, way, topic):
    name, units = f"/kontur_av/uplink_video/{way}", run.recorded.units(f"/uplink_video/{way}")
    came = {wall_ns(one["timestamp"]): one for one in run.messages[name]}
    assert len(came) == len(run.messages[name]) > 40
    own = [at_ns for at_ns in came if at_ns in units]
    for at_ns in own:
        assert came[at_ns]["data"].endswith(units[at_ns]) and came[at_ns]["format"] == "h264"
    counted(units, own, run.numbers[name], run.missed(topic))
    added = [at_ns for at_ns in came if at_ns not in units]
    assert all(at_ns - 1000 in units for at_ns in added) and added
    # From there on everything can be decoded, up to a unit that was lost.
    before = dict(pairwise(reversed(units)))
    decoder, whole = H264Decoder(), False
    for at_ns in came:
        whole = at_ns in added or (whole and before.get(at_ns) in came)
        assert not whole or len(list(decoder.decode(came[at_ns]["data"], 0))) == 1


@pytest.mark.parametrize(
    ("end", "channel", "topic"),
    [
        ("tip", "/haptic/up/sent", "haptic/robot"),
        ("handle", "/haptic/down/sent", "haptic/joystick"),
    ],
)
def test_a_node_hears_where_the_recording_has_the_hand(run, end, channel, topic):
    blocks, name = run.recorded.blocks(channel), f"/kontur_av/{end}/pose"
    stamps = [wall_ns(one["header"]["stamp"]) for one in run.messages[name]]
    counted(blocks, stamps, run.numbers[name], run.missed(topic))
    for at_ns, one in zip(stamps, run.messages[name], strict=True):
        row, told = blocks[at_ns][-1], one["pose"]["position"]
        assert (told["x"], told["y"]) == pytest.approx((float(row["x_m"]), float(row["y_m"])))


def test_a_node_sees_the_recorded_pictures_of_a_camera(run):
    pictures = run.recorded.channels["/camera/static"]
    decoder, decoded = av.CodecContext.create("h264", "r"), {}
    for at_ns in sorted(pictures):
        for picture in decoder.decode(av.Packet(unpack(RecordedPicture, pictures[at_ns]).data)):
            decoded[at_ns] = picture.to_ndarray(format="bgr24")
    images, same = run.messages["/kontur_av/camera/static/compressed"], 0
    for one in images:
        at_ns = wall_ns(one["header"]["stamp"])
        image = cv2.imdecode(np.frombuffer(one["data"], np.uint8), cv2.IMREAD_COLOR)
        if at_ns in decoded:
            same += 1
            assert cv2.PSNR(image, decoded[at_ns]) > 25
    # A busy machine does not record every picture.
    assert same > 0.5 * len(images) > 0


def test_a_node_hears_chat_setup_and_diagnostics(run):
    assert {one["data"] for one in run.messages["/kontur_av/chat"]} == {"cosmonaut: Здесь хорошо"}
    assert [one["data"] for one in run.messages[run.setup_topic]] == [
        run.recorded.capabilities.setup_toml
    ]
    status = run.messages["/diagnostics"][-1]["status"]
    first = [one["status"][0] for one in run.messages["/diagnostics"]]
    assert (0, "well") in {(one["level"], one["message"]) for one in first}
    told = {
        each["key"]: each["value"]
        for one in status
        for each in one["values"]
        if one["name"] == "kontur_av: streams uplink_video"
    }
    assert 0 < int(told["frames_sent"]) <= run.report["streams"]["uplink_video"]["frames_sent"]


#: Of the robot's own time.
HOLD_NS = 300_000_000


class Robot:
    """What moves, by the topics of the session."""

    def __init__(self, bus):
        self.clock = MonotonicClock()
        self.readers = {topic: bus.reader(topic) for topic in (ROBOT_TOPIC, JOYSTICK_STATE_TOPIC)}

    def newest(self, topic):
        return eventually(lambda: self.readers[topic].latest_octets(), f"a sample of {topic}")

    def in_application(self):
        status = JOYSTICK_STATE_TOPIC.unpack(self.newest(JOYSTICK_STATE_TOPIC))
        return status.state == JoystickState.APPLICATION

    def held(self):
        return JOYSTICK_STATE_TOPIC.unpack(self.newest(JOYSTICK_STATE_TOPIC)).dead_man

    def place(self):
        state = ROBOT_TOPIC.unpack(self.newest(ROBOT_TOPIC))
        return state.x_m, state.y_m

    def rests(self):
        """Its place, after it has come to rest and not moved for `HOLD_NS`."""
        eventually(lambda: not self.held(), "the release")

        def still():
            before = self.place()
            time.sleep(0.1)
            return self.place() == pytest.approx(before, abs=1e-5)

        eventually(still, "the rest")
        first = ROBOT_TOPIC.unpack(self.newest(ROBOT_TOPIC))
        while (
            state := ROBOT_TOPIC.unpack(self.newest(ROBOT_TOPIC))
        ).time_ns < first.time_ns + HOLD_NS:
            assert (state.x_m, state.y_m) == pytest.approx((first.x_m, first.y_m), abs=5e-5)
        return first.x_m, first.y_m


def test_a_node_of_others_moves_the_robot_under_its_dead_man_button(start, tmp_path, monkeypatch):
    port = tcp_port()
    session = start(BOARD, "--ros2", str(port), "--joystick", "ros2")
    pids = session.pids()
    peer = Ros2Peer(port, {}, tmp_path)
    with session.bus(monkeypatch) as bus:
        robot = Robot(bus)

        def steered(x, is_there):
            """Whether it is there; a press anew, for a stall lets go."""
            if not robot.held():
                for dead_man in (False, True):
                    peer.say("joy", 0.0, 0.0, dead_man)
                    time.sleep(0.5)
            peer.say("joy", x, 0.0, True)
            return robot.held() and is_there(robot.place()[0])

        eventually(robot.in_application, "the application")
        # Held from the beginning: no press.
        peer.say("joy", 0.9, 0.0, True)
        assert robot.rests() == pytest.approx((0.0, 0.0), abs=0.01)
        # To the left.
        eventually(lambda: steered(0.5, lambda x: x < -0.03), "the motion")
        # The node is silent; then it is there again, with the button held.
        peer.say("quiet")
        rest = robot.rests()
        peer.say("joy", -0.5, 0.0, True)
        assert robot.rests() == pytest.approx(rest, abs=1e-4)
        # A velocity without the button moves nothing.
        peer.say("joy", 0.5, 0.0, False)
        peer.say("twist", 0.02)
        assert robot.rests() == pytest.approx(rest, abs=1e-4)
        to_m = rest[0] + 0.02
        eventually(lambda: steered(0.5, lambda x: x > to_m), "the motion by velocity")
        # Its process dies in the motion, and comes again: the button is still held.
        os.kill(pids["ros2"], signal.SIGKILL)
        rest = robot.rests()
        assert robot.rests() == pytest.approx(rest, abs=1e-4)
        peer.say("quiet")
    report = session.finish()
    peer.end()
    assert report["joystick"]["device"] == "ROS 2 node"
    told = report["processes"]["ros2"]
    assert told["restarts"] == 1 and told["counts"]["taken"] > 0
